"""The figure of docs/pbf.md: a dam break, its front and the experiment, and the time of a step.

python docs/figures/pbf.py bench/results/FILE.jsonl FRONT.json; the latter has the rows of the
experiment, "a_2.25_in" of "martin_moyce_1952_front": [t sqrt(2 g / a), z / a].
"""

import json
import math
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep

FOLDER = Path(__file__).resolve().parent
N = 98_000
STEPS = {  # peer, metric, threads: label, colour, marker. Okabe and Ito's colours.
    ("substep", "step", 2): ("substep, two threads", "#0072b2", "o-"),
    ("substep", "step", 1): ("substep, one thread", "#56b4e9", "o--"),
    ("pbf_reach", "step", 2): ("reference kernel, two threads", "#009e73", "s:"),
    ("taichi", "step", 2): ("kernel in Taichi, two threads", "#d55e00", "D:"),
}


def dam(n):
    """A column of 1 m x 0.5 m x 2 m in a tank of 4 m."""
    d = 1 / round(n ** (1 / 3))
    counts = (round(1 / d), round(0.5 / d), round(2 / d))
    axes = [d * (np.arange(count) + 0.5) for count in counts]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    tank = substep.Collider(
        substep.Box((4, counts[1] * d, 8), (2, counts[1] * d / 2, 4)), hollow=True
    )
    step = 0.4 * d / math.sqrt(4 * 9.81)
    return substep.PositionBasedFluid(x, d, colliders=[tank], max_iterations=5, step=step)


def collapse(n, axes):
    """Times and fronts; draws a slice at two of them."""
    liquid = dam(n)
    time, front, wanted = [0.0], [1.0], [0.0, 0.45]
    while time[-1] < 2.9:
        if wanted and liquid.time >= wanted[0]:
            wanted.pop(0)
            x, v = liquid.positions, np.linalg.norm(liquid.velocities, axis=1)
            middle = np.abs(x[:, 1] - x[:, 1].mean()) < 2 * liquid.spacing
            shift = 0 if len(wanted) else 1.2
            drawn = axes.scatter(
                x[middle, 0] + shift,
                x[middle, 2],
                s=0.6,
                c=v[middle],
                cmap="viridis",
                vmin=0,
                vmax=5,
            )
        for _ in range(5):
            liquid.step()
        time.append(liquid.time * math.sqrt(2 * 9.81))
        front.append(np.quantile(liquid.positions[:, 0], 0.999) + liquid.spacing / 2)
    axes.set(aspect="equal", xlabel="x / a", ylabel="z / a", title="at 0 and 0.45 s")
    axes.figure.colorbar(drawn, ax=axes, label="speed [m/s]", shrink=0.7)
    return np.array(time), np.array(front)


def main():
    records = [json.loads(line) for line in Path(sys.argv[1]).read_text().splitlines()]
    rows = json.loads(Path(sys.argv[2]).read_text())["martin_moyce_1952_front"]["a_2.25_in"]
    t, z = np.array([row for row in rows if row[0] <= 3.4]).T
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    time, front = collapse(N, panels[0])
    fitted = (t >= 0.8) & (t <= 2.6)
    shifts = np.arange(0, 0.3001, 0.005)
    worst = [
        np.abs(np.interp(t[fitted] - shift, time, front) / z[fitted] - 1).max() for shift in shifts
    ]
    shift = shifts[int(np.argmin(worst))]
    panels[1].plot(time + shift, front, color="#0072b2", label=f"substep, shifted by {shift:.2f}")
    panels[1].plot(time, front, color="#0072b2", lw=0.8, ls=":", label="substep, not shifted")
    panels[1].plot(t, z, "o", color="#d55e00", label="Martin and Moyce, 1952")
    panels[1].set(xlabel=r"$t \sqrt{2 g / a}$", ylabel="front / a", title="front of a dam break")
    panels[1].legend(frameon=False, fontsize=8)
    for wanted, (label, color, style) in STEPS.items():
        points = sorted(
            (int(r["workload"].removeprefix("dam break ")), r["value"])
            for r in records
            if (r.get("peer"), r.get("metric"), r.get("threads")) == wanted
        )
        if points:
            panels[2].loglog(*zip(*points, strict=True), style, color=color, label=label)
    panels[2].set(
        xlabel="particles", ylabel="time [ms]", title="a step of five iterations, float32"
    )
    panels[2].grid(alpha=0.3)
    panels[2].legend(frameon=False, fontsize=8)
    figure.savefig(FOLDER / "pbf.png", dpi=100)
    print(f"shift {shift:.3f}, largest error {min(worst):.4f}")


if __name__ == "__main__":
    main()
