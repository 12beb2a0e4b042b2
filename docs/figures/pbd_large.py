"""The figure of docs/pbd_large.md, from what bench/pbd_large.py printed, and two cloths.

python docs/figures/pbd_large.py bench/results/FILE.jsonl
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from substep import Distance, PositionBasedDynamics

FOLDER = Path(__file__).resolve().parent
# Solver, substeps x iterations: label, colour, marker. Okabe and Ito's colours.
BY_SIZE = {
    ("gauss_seidel", "1x10"): ("ten sweeps in one step", "#e69f00", "s-"),
    ("gauss_seidel", "10x1"): ("a sweep in each of ten substeps", "#d55e00", "o-"),
    ("multilevel", "4x1"): ("multilevel, four substeps", "#0072b2", "o-"),
}


def value(records, workload, metric, threads=1):
    found = [
        r["value"]
        for r in records
        if (r["workload"], r["peer"], r["metric"], r["threads"])
        == (workload, "substep", metric, threads)
    ]
    return found[0] if found else None


def by_size(axes, records, sizes):
    for (solver, how), (label, color, style) in BY_SIZE.items():
        points = [(n, value(records, f"cloth {n}^2 {solver} {how}", "strain")) for n in sizes]
        points = [p for p in points if p[1] is not None]
        axes.loglog(*zip(*points, strict=True), style, color=color, label=label)
    axes.set(xlabel="particles along an edge", ylabel="rms strain after 30 frames", ylim=(1e-3, 3))
    axes.set_xticks(sizes, [str(n) for n in sizes])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=8, loc="center right", bbox_to_anchor=(1, 0.44))


def by_cost(axes, records, n):
    for solver, label, color in (
        ("gauss_seidel", "sweeps", "#d55e00"),
        ("multilevel", "multilevel", "#0072b2"),
    ):
        start = f"cloth {n}^2 {solver} "
        hows = {r["workload"].removeprefix(start) for r in records if start in r["workload"]}
        points = sorted(
            (
                value(records, start + how, "frame"),
                value(records, start + how, "strain"),
                int(how.split("x")[0]),
            )
            for how in hows
            if how.endswith("x1")
        )
        cost, strain, _ = zip(*points, strict=True)
        axes.loglog(cost, strain, "o-", color=color, label=f"{label}, by number of substeps")
        for x, y, k in points:
            axes.annotate(str(k), (x, y), (4, 4), textcoords="offset points", fontsize=7)
    axes.set(xlabel="time of a frame [ms], one thread", ylabel="rms strain", ylim=(1e-3, 3))
    axes.set_xticks([3, 10, 30, 100], ["3", "10", "30", "100"])
    axes.minorticks_off()
    axes.set_title(f"{n} x {n} particles", fontsize=10)
    axes.legend(frameon=False, fontsize=8, loc="lower left")


def hang(n, solver, substeps):
    """A cloth after 30 frames: positions, and the largest strain at each particle."""
    i = np.arange(n * n).reshape(n, n)
    near = [
        (i[:, :-1], i[:, 1:]),
        (i[:-1], i[1:]),
        (i[:-1, :-1], i[1:, 1:]),
        (i[:-1, 1:], i[1:, :-1]),
    ]
    far = [(i[:, :-2], i[:, 2:]), (i[:-2], i[2:])]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in near + far])
    u = np.linspace(0, 1, n)
    x = np.stack([np.tile(u, n), np.repeat(u, n), np.zeros(n * n)], axis=1)
    cloth = PositionBasedDynamics(
        x,
        0.3 / n**2,
        [Distance(pairs)],
        pinned=[0, n - 1],
        solver=solver,
        substeps=substeps,
    )
    for _ in range(30):
        cloth.step(1 / 60)
    at = cloth.positions

    def lengths(p):
        return np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1)

    strain = np.abs(lengths(at) / lengths(x) - 1)
    worst = np.zeros(n * n)
    np.maximum.at(worst, pairs.ravel(), np.repeat(strain, 2))
    return at.reshape(n, n, 3), worst.reshape(n, n)


def main():
    lines = Path(sys.argv[1]).read_text().splitlines()
    records = [r for r in map(json.loads, lines) if "workload" in r]
    figure = plt.figure(figsize=(9, 7.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.25, 1))
    for k, (solver, substeps, title) in enumerate(
        (
            ("gauss_seidel", 10, "sweeps, ten substeps"),
            ("multilevel", 4, "multilevel, four substeps"),
        )
    ):
        axes = figure.add_subplot(grid[0, k])
        x, strain = hang(300, solver, substeps)
        drawn = axes.pcolormesh(
            x[..., 0],
            x[..., 2],
            np.maximum(strain, 1e-4),
            shading="gouraud",
            cmap="magma_r",
            norm=LogNorm(1e-3, 1),
            rasterized=True,
        )
        axes.set(aspect="equal", xlim=(-0.05, 1.05), ylim=(-1.3, 0.05), xlabel="x [m]")
        axes.set_ylabel("z [m]")
        axes.set_title(f"300 x 300: {title}", fontsize=10)
    figure.colorbar(drawn, ax=figure.axes, label="largest strain at each particle", shrink=0.8)
    sizes = sorted({int(r["workload"].split()[1].removesuffix("^2")) for r in records})
    by_size(figure.add_subplot(grid[1, 0]), records, sizes)
    by_cost(figure.add_subplot(grid[1, 1]), records, 300)
    for axes in figure.axes[-2:]:
        axes.grid(alpha=0.3)
    figure.savefig(FOLDER / "pbd_large.png", dpi=100)


if __name__ == "__main__":
    main()
