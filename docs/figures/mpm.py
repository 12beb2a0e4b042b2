"""The figure of docs/mpm.md: run-out of columns of sand, a collapse, and two disks that collide.

python docs/figures/mpm.py, with tests/mpm/ on PYTHONPATH, whose problems these are.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from test_granular import column, run_out
from test_physics import Disks

FOLDER = Path(__file__).resolve().parent
# Okabe and Ito's colours.
BLUE, RED, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "0.75"
CELLS = {0.5: 48, 1.0: 32, 2.0: 24}  # planar
ROUND_CELLS = {0.5: 16, 1.0: 16, 2.0: 12, 3.0: 12}


def laws(dimension, a):
    """Run-out of the laws of Lube et al. and of Lajeunesse et al."""
    if dimension == 2:
        return (
            np.where(a < 2.3, 1.2 * a, 1.9 * a ** (2 / 3)),
            np.where(a < 3, 1.8 * a, 2.3 * a ** (2 / 3)),
        )
    return (
        np.where(a < 1.7, 1.24 * a, 1.6 * a**0.5),
        np.where(a < 0.74, a, 2 * a**0.5),
    )


def draw_run_outs(axes):
    a = np.linspace(0.3, 3.3, 200)
    for dimension, color, name in ((2, BLUE, "planar"), (3, RED, "round")):
        low, high = np.sort(laws(dimension, a), axis=0)
        axes.fill_between(a, low, high, color=color, alpha=0.15, lw=0)
        cells = CELLS if dimension == 2 else ROUND_CELLS
        times = 8.0 if dimension == 2 else 6.0
        found = [run_out(column(k, n, dimension), k, times) for k, n in cells.items()]
        print(name, dict(zip(cells, np.round(found, 3), strict=True)))
        axes.plot(list(cells), found, "o", color=color, label=f"{name}; shaded: experiments")
    axes.set(xlabel="height / width of the column", ylabel="run-out / width", ylim=(0, 4.5))
    axes.set_title("columns of sand, 30 degrees")
    axes.legend(frameon=False, fontsize=8, loc="upper left")


def draw_collapse(axes):
    simulation = column(2.0, 32, 2)
    layer = simulation.positions[:, 1] // 0.2
    unit = np.sqrt(2 / 9.81)
    for k, until in enumerate((0.0, 1.2, 4.0)):
        simulation.advance(until * unit - simulation.time)
        x = simulation.positions
        axes.scatter(x[:, 0], x[:, 1] - 2.3 * k, s=0.4, c=layer % 2, cmap="copper", vmin=-0.6)
        axes.text(3.2, 0.9 - 2.3 * k, f"{until:g} $\\sqrt{{H/g}}$", fontsize=8)
    axes.set(aspect="equal", yticks=(), xlabel="x / width", title="planar column, a = 2")


def draw_disks(axes):
    for transfer, color in (("flip", GREEN), ("apic", BLUE), ("pic", RED)):
        t, kinetic, elastic = Disks(64, transfer, "mls").run()
        print(transfer, round(kinetic[-1], 4), round(kinetic[-1] + elastic[-1], 4))
        axes.plot(t, kinetic + elastic, color=color, label=transfer.upper())
        axes.plot(t, elastic, color=color, lw=0.8, ls=":")
    axes.axvline(Disks.CONTACT, color=GREY, lw=0.8)
    axes.set(xlabel="time [s]", ylabel="energy / that at the start", ylim=(0, 1.05))
    axes.set_title("disks that collide, 64 cells; dotted: elastic")
    axes.legend(frameon=False, fontsize=8)


def main():
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    draw_run_outs(panels[0])
    draw_collapse(panels[1])
    draw_disks(panels[2])
    figure.savefig(FOLDER / "mpm.png", dpi=100)


if __name__ == "__main__":
    main()
