"""Draws docs/figures/springs.png: python docs/figures/springs.py (about a minute)."""

import io
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from PIL import Image
from substep import _core, springs

FOLDER = Path(__file__).resolve().parent
H = 1 / 60
SIZES = (32, 64, 128, 256)


def cloth(n, **options):
    """0.3 kg, 1 m x 1 m, held at two corners, flat."""
    axis = np.linspace(0, 1, n)
    x = np.array([(b, a, 0.0) for a in axis for b in axis])
    edges, stiffness = springs.grid_springs(n, n, stiffness=1e4)
    return substep.MassSpring(
        x, edges, stiffness, 0.3 / n**2, pinned=[0, n - 1], step=H, threads=1, **options
    )


def processor_ms(work, repeats):
    """Shortest processor time."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def costs(n):
    """What each part of a step takes."""
    net = cloth(n, solver="projective")
    net.step()
    start, row = net._native.pattern()
    values, x = np.zeros(len(row)), np.ones(3 * n * n)
    factor = _core.SupernodalCholesky(start, row, 3)
    flat = cloth(n)._native
    flat.assemble(H, values)
    assert factor.factorize(values, 1) == -1
    return {
        "numeric factorization": processor_ms(lambda: factor.factorize(values, 1), 3),
        "ten projective iterations": processor_ms(net.step, 3),
        "solve": processor_ms(lambda: factor.solve(x, 1), 3),
        "assembly": processor_ms(lambda: flat.assemble(H, values), 5),
    }


def main():
    """Cloth that hangs, and how the cost grows."""
    figure = plt.figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.add_subplot(1, 2, 1, projection="3d")
    net = cloth(32, damping=0.01)
    net.advance(20 * H)
    triangles = np.arange(32 * 32).reshape(32, 32)
    lines = [*net.positions[triangles], *net.positions[triangles.T]]
    axes.add_collection3d(Line3DCollection(lines, colors="#0072b2", linewidths=0.5))
    axes.set(xlim=(0, 1), ylim=(0, 1), zlim=(-0.9, 0.1), box_aspect=(1, 1, 1))
    axes.set_title("after 20 steps of 1/60 s", fontsize=10)
    axes.tick_params(labelsize=7)

    axes = figure.add_subplot(1, 2, 2)
    rows = [costs(n) for n in SIZES]
    styles = zip(("#000000", "#d55e00", "#0072b2", "#009e73"), "os^D", strict=True)
    for name, (colour, marker) in zip(rows[0], styles, strict=True):
        axes.loglog(SIZES, [row[name] for row in rows], marker=marker, color=colour, label=name)
    guide = np.array([40.0, 220.0])
    axes.loglog(guide, 0.02 * (guide / 40) ** 2, "--", color="#777777", lw=1)
    axes.text(100, 0.07, "n²", color="#777777")
    axes.set_xticks(SIZES, [str(n) for n in SIZES])
    axes.minorticks_off()
    axes.set(xlabel="n, of n x n vertices", ylabel="processor time, one thread [ms]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    Image.open(buffer).convert("P", palette=Image.Palette.ADAPTIVE).save(FOLDER / "springs.png")
    for n, row in zip(SIZES, rows, strict=True):
        print(n, {name: round(value, 2) for name, value in row.items()})


if __name__ == "__main__":
    main()
