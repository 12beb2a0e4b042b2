"""The figure of docs/grid_flow.md: heavy fluid falls through light fluid, beside published fronts.

python docs/figures/grid_flow.py GRIDFLUID.json; the latter has the rows of He, Chen and Zhang
(1999), "rayleigh_taylor_he_1999": [t sqrt(g / H), bubble / 4 H, spike / 4 H].
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from substep.gridfluid import Wall

FOLDER = Path(__file__).resolve().parent
N = 128  # cells across the box, of which half is computed
DRAWN = (1.0, 2.0, 3.0, 4.0, 5.0)


def crossing(values, heights, which):
    """Where smoke passes 1/2 on its way up."""
    k = np.flatnonzero((values[:-1] < 0.5) & (values[1:] >= 0.5))[which]
    part = (0.5 - values[k]) / (values[k + 1] - values[k])
    return heights[k] + part * (heights[k + 1] - heights[k])


def main():
    rows = json.loads(Path(sys.argv[1]).read_text())["rayleigh_taylor_he_1999"]["series"]
    time, bubble, spike = np.array(rows).T

    def smoke(x):
        return np.clip(0.5 + (x[:, 1] - 2 - 0.1 * np.cos(2 * np.pi * x[:, 0])) * N, 0, 1)

    flow = substep.GridFlow(
        [(0, 0), (0.5, 4)],
        1 / N,
        density=1.0,
        smoke=smoke,
        smoke_density=3.0,
        viscosity=1 / 256,
        gravity=(0, -1),
        sides=[Wall(slip=True), "wall"],
    )
    figure = plt.figure(figsize=(12, 5), layout="constrained")
    grid = figure.add_gridspec(1, len(DRAWN) + 1, width_ratios=[1] * len(DRAWN) + [4.5])
    y = flow.positions_of()[0, :, 1]
    found = []
    shots = list(DRAWN)
    for t in np.arange(0.05, DRAWN[-1] + 1e-9, 0.05):
        flow.advance(t - flow.time)
        s = flow.smoke
        found.append((flow.time, crossing(s[0], y, -1), crossing(s[-1], y, 0)))
        if shots and flow.time >= shots[0] - 1e-9:
            axes = figure.add_subplot(grid[0, len(DRAWN) - len(shots)])
            whole = np.concatenate([s, s[::-1]]).T
            axes.imshow(whole, origin="lower", extent=(0, 1, 0, 4), cmap="Blues", vmin=0, vmax=1)
            axes.set(title=f"t = {shots.pop(0):g}", xticks=[], yticks=[])
    axes = figure.add_subplot(grid[0, -1])
    t, top, foot = np.array(found).T
    axes.plot(t, top, color="#0072b2", label="bubble")
    axes.plot(t, foot, color="#d55e00", label="spike")
    axes.plot(time, 4 * bubble, "k.", label="He, Chen and Zhang 1999")
    axes.plot(time, 4 * spike, "k.")
    axes.set(xlabel="time [sqrt(H / g)]", ylabel="height of the front [H]")
    axes.legend()
    figure.savefig(FOLDER / "grid_flow.png", dpi=110)


if __name__ == "__main__":
    main()
