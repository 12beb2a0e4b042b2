"""The figure and the table of docs/liquids.md: a dam break by three methods, and the experiment.

python docs/figures/liquids.py FLUID.json; the latter has the rows of the experiment, "a_2.25_in"
of "martin_moyce_1952_front": [t sqrt(2 g / a), z / a].
"""

import json
import math
import sys
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep

FOLDER = Path(__file__).resolve().parent
N = 32  # cells, or pairs of particles, along the foot of the column, which is 1 m
LONG, HIGH = 4.5, 3.5  # of the tank [m]
END, DRAWN = 2.6, (0.55, 1.4, 2.5)
COLOUR = {
    "GridLiquid": "#0072b2",
    "PositionBasedFluid": "#009e73",
    "MaterialPointMethod": "#d55e00",
}


def simulations():
    """The column, 1 m x 2 m in the corner of a tank, by each method with its defaults."""
    d = 0.5 / N
    water = substep.fill_box((0, 0), (1, 2), d)
    tank = substep.Box((LONG, HIGH, 1), (LONG / 2, HIGH / 2, 0))
    yield substep.GridLiquid(water, cell=2 * d, bounds=((0, 0), (LONG, HIGH)), threads=2)
    hollow = substep.Collider(tank, hollow=True)
    yield substep.PositionBasedFluid(water, d, colliders=[hollow], threads=2)
    stiff = 100 * 1000 * 2 * 9.81 * 2  # density times 100 v^2 of the fastest flow
    yield substep.MaterialPointMethod(
        water,
        substep.mpm.Fluid(bulk_modulus=stiff),
        cell=2 * d,
        volume=d * d,
        colliders=[substep.Collider(tank, hollow=True, friction=0)],
        threads=2,
    )


def energy(simulation):
    values = simulation.diagnostics()
    return values["kinetic_energy"] + values["gravitational_energy"]


def main():
    rows = json.loads(Path(sys.argv[1]).read_text())["martin_moyce_1952_front"]["a_2.25_in"]
    t, z = np.array([row for row in rows if 0.8 <= row[0] <= 3.4]).T
    figure = plt.figure(figsize=(12, 7.6), layout="constrained")
    pictures, curves = figure.subfigures(2, 1, height_ratios=[2, 1])
    shots = pictures.subplots(3, 3, sharex=True, sharey=True)
    panels = curves.subplots(1, 2)
    for column, simulation in zip(shots.T, simulations(), strict=True):
        name = type(simulation).__name__
        start, cost, steps = energy(simulation), 0.0, 0
        times, fronts, kept, drawn = [0.0], [1.0], [1.0], 0
        while simulation.time < END - 1e-9:
            began = time.perf_counter()
            simulation.advance(0.025)
            cost += time.perf_counter() - began
            steps += simulation.report.steps
            times.append(simulation.time)
            fronts.append(np.quantile(simulation.positions[:, 0], 0.999))
            kept.append(energy(simulation) / start)
            if drawn < len(DRAWN) and simulation.time >= DRAWN[drawn] - 1e-9:
                x, v = simulation.positions, np.linalg.norm(simulation.velocities, axis=1)
                axes = column[drawn]
                points = axes.scatter(*x.T, s=1.2, c=v, cmap="viridis", vmin=0, vmax=6, lw=0)
                axes.set(aspect="equal", xlim=(0, LONG), ylim=(0, 2.4))
                axes.text(2.25, 2.1, f"{DRAWN[drawn]} s", ha="center")
                drawn += 1
        column[0].set_title(f"{name}, {steps} steps")
        scaled = np.array(times) * math.sqrt(2 * 9.81)
        shifts = np.linspace(0, 0.3, 61)
        wrong = [np.abs(np.interp(t - s, scaled, fronts) / z - 1).max() for s in shifts]
        shift = shifts[int(np.argmin(wrong))]
        panels[0].plot(scaled + shift, fronts, color=COLOUR[name], label=name)
        panels[1].plot(times, kept, color=COLOUR[name], label=name)
        print(
            f"{name}: {steps} steps, {cost:.2f} s, front {min(wrong):.3f} (shift {shift:.2f}), "
            f"energy {kept[22]:.3f} at {times[22]:.2f} s, {kept[-1]:.3f} at {END} s",
            flush=True,
        )
    pictures.colorbar(points, ax=shots, label="speed [m/s]", shrink=0.7)
    panels[0].plot(t, z, "o", color="black", ms=4, label="Martin and Moyce, 1952")
    panels[0].set(xlim=(0, 3.5), ylim=(1, 4.4), xlabel=r"$t \sqrt{2 g / a}$", ylabel="front / a")
    panels[1].set(xlabel="time [s]", ylabel="energy over that of the start", ylim=(0, 1.05))
    for axes in panels:
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(FOLDER / "liquids.png", dpi=100)


if __name__ == "__main__":
    main()
