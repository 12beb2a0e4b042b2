"""The figures of docs/pbd.md.

python docs/figures/pbd.py [FILE.jsonl]: the second one from what bench/pbd.py printed.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from substep import Distance

FOLDER = Path(__file__).resolve().parent
BLUE, ORANGE, GREEN, YELLOW, GREY = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#777777"


def cloth(n, substeps, iterations):
    ids = np.arange(n * n).reshape(n, n)
    ends = (
        (ids[:, :-1], ids[:, 1:]),
        (ids[:-1], ids[1:]),
        (ids[:-1, :-1], ids[1:, 1:]),
        (ids[:-1, 1:], ids[1:, :-1]),
        (ids[:, :-2], ids[:, 2:]),
        (ids[:-2], ids[2:]),
    )
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ends])
    u = np.linspace(0, 1, n)
    x = np.stack([np.tile(u, n), np.repeat(u, n), np.zeros(n * n)], axis=1)
    return substep.PositionBasedDynamics(
        x,
        0.3 / n**2,
        [Distance(pairs)],
        pinned=[0, n - 1],
        substeps=substeps,
        iterations=iterations,
    )


def substeps_or_iterations():
    n, figure = 60, plt.figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.3))
    for substeps, iterations, color in ((10, 1, BLUE), (1, 10, ORANGE)):
        sim = cloth(n, substeps, iterations)
        for _ in range(40):
            sim.step()
        x = sim.positions.reshape(n, n, 3)
        label = f"{substeps} x {iterations}"
        for line in range(0, n, 3):
            left.plot(*x[:, line, 1:].T, color=color, lw=0.6, alpha=0.8)
        left.plot([], [], color=color, label=label)
    left.set(title="seen from the side", xlabel="y [m]", ylabel="z [m]", aspect="equal")
    left.set_xlim(-0.8, 1.0)
    left.legend(frameon=False, fontsize=8, title="substeps x iterations", loc="upper right")
    work = np.array([4, 8, 16, 32, 64])
    for label, split, style, color in (
        ("substeps, one iteration", lambda k: (int(k), 1), "o-", BLUE),
        ("four iterations in each substep", lambda k: (int(k) // 4, 4), "s-", GREEN),
        ("iterations, one substep", lambda k: (1, int(k)), "D-", ORANGE),
    ):
        strains = []
        for k in work:
            sim = cloth(n, *split(k))
            strain = []
            for _ in range(40):
                sim.step()
                strain.append(sim.diagnostics()["strain"])
            strains.append(np.mean(strain[20:]))
        right.loglog(work, strains, style, color=color, label=label)
    right.set(
        title=f"cloth of {n} x {n}, mean of 1/3 s", xlabel="projections of each constraint a frame"
    )
    right.set(ylabel="strain, root mean square")
    right.set_xticks(work, [str(k) for k in work])
    right.minorticks_off()
    right.grid(alpha=0.3)
    right.legend(frameon=False, fontsize=8)
    figure.savefig(FOLDER / "pbd.png", dpi=110)


def speed(path):
    records = [json.loads(line) for line in Path(path).read_text().splitlines()]
    figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
    for peer, kind, threads, label, style, color in (
        ("substep", "float32", 2, "substep", "o-", BLUE),
        ("substep", "float32", 1, "substep, one thread", "o--", BLUE),
        ("substep", "float64", 2, "substep, float64", "s-", GREEN),
        ("substep", "float64", 1, "substep, float64, one thread", "s--", GREEN),
        ("xpbd_ref", "float32", 2, "written by hand for this cloth", "D-", GREY),
        ("xpbd_ref", "float32", 1, "written by hand for this cloth, one thread", "D--", GREY),
        ("pyPBD", "float32", 2, "pyPBD", "^-", ORANGE),
        ("Taichi", "float32", 2, "Taichi", "v-", YELLOW),
    ):
        points = {}
        for r in records:
            if r.get("metric") != "ns_per_projection" or "jacobi" in r["workload"]:
                continue
            if (r["peer"], r["threads"]) == (peer, threads) and kind in r["workload"]:
                n = int(r["workload"].split()[2].removesuffix("^2"))
                points[n * n] = min(r["value"], points.get(n * n, np.inf))
        if points:
            axes.loglog(*zip(*sorted(points.items()), strict=True), style, color=color, label=label)
    axes.set(xlabel="particles", ylabel="whole frame / projections [ns]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(FOLDER / "pbd_speed.png", dpi=110)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        speed(sys.argv[1])
    else:
        substeps_or_iterations()
