"""Draws docs/figures/mpm_materials.png: python docs/figures/mpm_materials.py (a second)."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

FOLDER = Path(__file__).resolve().parent
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#777777"
MU, LAMBDA = 58.3, 38.9  # [kPa], of E = 140 kPa and nu = 0.2


def cone(degrees, match="compression"):
    """|dev tau| / p on the yield surface of sand."""
    sine = np.sin(np.radians(degrees))
    if match == "plane_strain":
        return np.sqrt(2) * sine
    return 3 * np.sqrt(2 / 3) * 2 * sine / (3 - sine)


def corotated(sigma):
    """Principal values of tau [kPa] of snow at J_P = 1."""
    J = sigma.prod(axis=-1, keepdims=True)
    return 2 * MU * (sigma - 1) * sigma + LAMBDA * (J - 1) * J


def draw_surfaces(ax):
    """Yield surfaces by pressure and |dev tau|."""
    p = np.linspace(0, 6, 50)
    for degrees, style in ((20, ":"), (30, "-"), (40, "--")):
        ax.plot(p, cone(degrees) * p, c=ORANGE, ls=style, label=f"sand, {degrees}°")
    ax.axhline(2.0, c=GREEN, label="von Mises")
    ax.axhline(0.8, c=GREY, label="mud at rest")
    ax.axhspan(0.8, 1.4, color=GREY, alpha=0.15, lw=0)
    ax.text(-1.9, 1.1, "mud flows", fontsize=8, va="center")
    # The stresses of all stretches between the limits of snow, as a set of (p, |dev tau|).
    s = np.linspace(1 - 0.025, 1 + 0.0075, 80)
    sigma = np.stack(np.meshgrid(s, s, s), axis=-1).reshape(-1, 3)
    tau = corotated(sigma)
    pressure = -tau.mean(axis=1)
    size = np.linalg.norm(tau + pressure[:, None], axis=1)
    bins = np.linspace(pressure.min(), pressure.max(), 60)
    which = np.clip(np.digitize(pressure, bins) - 1, 0, len(bins) - 2)
    top = np.array([size[which == k].max(initial=0.0) for k in range(len(bins) - 1)])
    centre = (bins[1:] + bins[:-1]) / 2
    ax.fill_between(
        np.r_[bins[0], centre, bins[-1]], np.r_[0, top, 0], color=BLUE, alpha=0.25, lw=0
    )
    ax.plot(np.r_[bins[0], centre, bins[-1]], np.r_[0, top, 0], c=BLUE, label="snow, $J_P = 1$")
    ax.set(xlim=(-2, 6), ylim=(0, 6.5), xlabel="pressure p [kPa]", ylabel="|dev τ| [kPa]")
    ax.set_title("where materials yield")
    ax.legend(frameon=False, fontsize=8, loc="upper left", ncols=2)


def draw_octahedral(ax):
    """Sections across the axis of pressure: Mohr and Coulomb's pyramid and the cones."""
    sine = np.sin(np.radians(30))
    angle = np.linspace(0, 2 * np.pi, 721)
    # Principal stresses -p + r n; the largest admissible r.
    n = np.sqrt(2 / 3) * np.cos(angle[:, None] - np.radians([0, 120, 240]))
    high, low = n.max(axis=1), n.min(axis=1)
    r = 2 * sine / (high - low + sine * (high + low))
    ax.plot(r * np.cos(angle), r * np.sin(angle), c="k", label="Mohr and Coulomb")
    for match, style in (("compression", "-"), ("plane_strain", "--")):
        R = cone(30, match)
        ax.plot(R * np.cos(angle), R * np.sin(angle), c=ORANGE, ls=style, label=match)
    for k in range(3):
        a = np.radians(120 * k)
        ax.plot([0, 1.2 * np.cos(a)], [0, 1.2 * np.sin(a)], c=GREY, lw=0.6)
        ax.text(1.35 * np.cos(a), 1.35 * np.sin(a), f"$\\tau_{k + 1}$", ha="center", va="center")
    ax.set(xlim=(-1.5, 1.6), ylim=(-1.5, 2.1), aspect="equal", xticks=[], yticks=[])
    ax.set_title("sand of 30° across p = 1")
    ax.legend(frameon=False, fontsize=8, loc="upper left")


def draw_snow(ax):
    """Snow pressed along one axis."""
    strain = np.linspace(0, 0.35, 400)
    for xi, colour in ((0, GREY), (5, GREEN), (10, BLUE)):
        s = np.maximum(1 - strain, 1 - 0.025)
        h = np.exp(xi * (1 - (1 - strain) / s))
        ax.plot(100 * strain, -h * (2 * MU + LAMBDA) * (s - 1) * s, c=colour, label=f"ξ = {xi}")
    ax.set(xlabel="compression [%]", ylabel="-τ [kPa]", title="snow, pressed along one axis")
    ax.legend(frameon=False, fontsize=8)


def draw_flow(ax):
    """Flow curves of mud."""
    rate = np.linspace(0, 10, 300)
    for n, colour in ((0.5, GREEN), (1.0, BLUE), (1.5, ORANGE)):
        ax.plot(rate, 100 + 30 * rate**n, c=colour, label=f"n = {n:g}")
    ax.plot([0, 0], [0, 100], c="k", lw=2.5)
    ax.set(xlim=(-0.2, 10), ylim=(0, 500), xlabel="shear rate [1/s]", ylabel="shear stress [Pa]")
    ax.set_title("mud, sheared steadily")
    ax.legend(frameon=False, fontsize=8)


def main():
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), layout="constrained")
    for draw, ax in zip((draw_surfaces, draw_octahedral, draw_snow, draw_flow), axes, strict=True):
        draw(ax)
    figure.savefig(FOLDER / "mpm_materials.png", dpi=110)


if __name__ == "__main__":
    main()
