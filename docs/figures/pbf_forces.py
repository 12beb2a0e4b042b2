"""Draws docs/figures/pbf_forces.png: python docs/figures/pbf_forces.py (about a minute)."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep

FOLDER = Path(__file__).resolve().parent
BLUE, ORANGE, GREEN = "#0072b2", "#d55e00", "#009e73"


def draw_drop(axes):
    """A cube of water of 12 mm without gravity; the half behind the cut."""
    d = 0.012 / 16
    drop = substep.PositionBasedFluid(
        substep.fill_box([-0.006] * 3, [0.006] * 3, d),
        d,
        gravity=(0, 0, 0),
        surface_tension=0.0728,
        viscosity=2e-4,
        tolerance=1e-4,
        max_iterations=30,
    )
    for ax, time in zip(axes, (0.0, 0.015, 0.15), strict=True):
        drop.advance(time - drop.time)
        x = 1e3 * drop.positions
        x = x[x[:, 1] > -0.2]
        x = x[np.argsort(-x[:, 1])]
        ax.scatter(
            x[:, 0], x[:, 2], s=26, c=-x[:, 1], cmap="Blues", vmin=-8, vmax=2, lw=0.2, ec="w"
        )
        ax.set(xlim=(-8, 8), ylim=(-8, 8), aspect="equal", title=f"{1e3 * time:.0f} ms")
        ax.set_xlabel("x [mm]")
    axes[0].set_ylabel("z [mm]")


def draw_wave(ax):
    """u_x = cos(pi z) in a block of 3 m x 1 m of 32 particles a metre."""
    d = 1 / 32
    x = substep.fill_box((0, 0), (3, 1), d)
    v = np.zeros_like(x)
    v[:, 0] = np.cos(np.pi * x[:, 1])
    for nu, colour in ((0.0, GREEN), (0.02, BLUE), (0.1, ORANGE)):
        fluid = substep.PositionBasedFluid(x, d, velocities=v, gravity=(0, 0), viscosity=nu)
        time, amplitude = [0.0], [1.0]
        for _ in range(48):
            fluid.step(0.2 * d)
            y, u = fluid.positions, fluid.velocities
            middle = np.abs(y[:, 0] - 1.5) < 0.2
            wave = np.cos(np.pi * (y[middle, 1] - y[:, 1].mean() + 0.5))
            time.append(fluid.time)
            amplitude.append((wave @ u[middle, 0]) / (wave @ wave))
        t = np.array(time)
        ax.plot(t, np.exp(-nu * np.pi**2 * t), "k", lw=0.8)
        ax.plot(t[::4], amplitude[::4], "o", c=colour, ms=4, label=f"{nu:g} m²/s")
    ax.set(xlabel="time [s]", ylabel="amplitude", ylim=(0.6, 1.05), title="shear wave")
    ax.legend(frameon=False)


def main():
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), layout="constrained")
    draw_drop(axes[:3])
    draw_wave(axes[3])
    figure.savefig(FOLDER / "pbf_forces.png", dpi=110)


if __name__ == "__main__":
    main()
