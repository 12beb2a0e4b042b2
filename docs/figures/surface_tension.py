"""The figure of docs/grid_liquid.md: what surface tension does to a square, and to a drop.

python docs/figures/surface_tension.py
"""

import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep

FOLDER = Path(__file__).resolve().parent
SHADES = ("#bbbbbb", "#56b4e9", "#0072b2", "#000000")


def liquid(inside, half, cell, **options):
    """Density and surface tension 1, about 0."""
    half = cell * math.ceil(half / cell)
    x = substep.fill_box((-half, -half), (half, half), cell / 2)
    x += np.random.default_rng(0).uniform(-0.2, 0.2, x.shape) * cell / 2
    return substep.GridLiquid(
        x[inside(x)],
        cell=cell,
        bounds=((-half, -half), (half, half)),
        density=1.0,
        surface_tension=1.0,
        gravity=(0, 0),
        **options,
    )


def stretch(of):
    squares = ((of.positions - of.positions.mean(axis=0)) ** 2).mean(axis=0)
    return squares[1] - squares[0]


def main():
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9, 3.4), layout="constrained", width_ratios=(1, 1.7)
    )
    side = math.sqrt(math.pi)
    square = liquid(lambda x: np.abs(x).max(axis=1) < side / 2, 1.4, 1 / 24, viscosity=0.05)
    axis = [square.bounds[0, 0] + square.cell * (np.arange(n) + 0.5) for n in square.shape]
    for until, shade in zip((0.0, 0.2, 0.5, 10.0), SHADES, strict=True):
        square.advance(until - square.time)
        left.contour(*axis, square.level_set.T, [0], colors=[shade])
        left.plot([], [], color=shade, label=f"{until:g}")
    left.set(aspect="equal", xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), title="A square becomes round")
    left.legend(frameon=False, loc="center", title="time")

    def drop(x):
        r = np.linalg.norm(x, axis=1)
        return r < 1 + 0.05 * (2 * (x[:, 1] / r) ** 2 - 1)

    for cells, shade in zip((8, 16, 32), SHADES, strict=False):
        made = liquid(drop, 1.3, 1 / cells)
        times, values = [0.0], [stretch(made)]
        while made.time < 5:
            made.advance(0.05)
            times.append(made.time)
            values.append(stretch(made))
        right.plot(times, np.array(values) / values[0], color=shade, label=f"{cells} cells")
    t = np.linspace(0, 5, 300)
    right.plot(t, np.cos(math.sqrt(6) * t), "--", color="#d55e00", label="Rayleigh")
    right.set(title="A drop swings: cells to its radius", xlabel="time", ylabel="stretch")
    right.legend(frameon=False, loc="upper left", ncols=4)
    right.set_ylim(-1.3, 1.6)
    for panel in (left, right):
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(FOLDER / "surface_tension.png", dpi=110)


if __name__ == "__main__":
    main()
