"""Draws the figures of the documentation with the library itself.

python docs/figures/make.py            all of them (about two minutes)
python docs/figures/make.py energy     the named ones
"""

import io
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from matplotlib.collections import LineCollection
from PIL import Image
from substep import stability

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
# Okabe and Ito's colours, told apart by colour-blind readers too; line styles repeat the message.
COLOUR = {
    "euler": "#d55e00",
    "midpoint": "#777777",
    "heun": "#e69f00",
    "rk4": "#0072b2",
    "RK45": "#009e73",
    "DOP853": "#cc79a7",
    "implicit_euler": "#000000",
    "symplectic_euler": "#cc79a7",
    "position_verlet": "#56b4e9",
    "velocity_verlet": "#009e73",
    "yoshida4": "#000000",
    "RKC2": "#56b4e9",
}
NAME = {
    "euler": "explicit Euler",
    "midpoint": "explicit midpoint",
    "heun": "Heun",
    "rk4": "RK4",
    "implicit_euler": "implicit Euler",
    "symplectic_euler": "symplectic Euler",
    "position_verlet": "position Verlet",
    "velocity_verlet": "velocity Verlet",
    "yoshida4": "Yoshida 4",
}
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "figure.dpi": 140,
    "figure.constrained_layout.use": True,
}


def stability_regions():
    """Outlines of |R(z)| = 1 and, beside them, where a damped spring chain lies in RK4's."""
    fig, (left, right) = plt.subplots(1, 2, figsize=(8.6, 4.5), width_ratios=(1.25, 1))
    for method in ("DOP853", "RK45", "rk4", "heun", "euler"):
        area = stability.region(method)
        label = "Heun, midpoint" if method == "heun" else NAME.get(method, method)
        for part, curve in enumerate(area.boundary):
            left.plot(
                curve.real, curve.imag, color=COLOUR[method], label=label if part == 0 else None
            )
        main = area.boundary[0]
        left.fill(main.real, main.imag, color=COLOUR[method], alpha=0.10)
    left.set(xlim=(-7, 5.4), ylim=(-6.9, 6.9), title="Stable inside: |R(hλ)| ≤ 1")
    left.legend(loc="center right", fontsize=8, borderaxespad=0)

    masses, stiffness, damping = 40, 100.0, 4.0  # springs of 100 / s^2, relative damping
    laplace = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    zero, one = np.zeros((masses, masses)), np.eye(masses)
    jacobian = np.block([[zero, one], [-stiffness * laplace, -damping * laplace]])
    eigenvalues = np.linalg.eigvals(jacobian)
    h = stability.max_stable_step("rk4", eigenvalues)
    area = stability.region("rk4")
    right.fill(area.boundary[0].real, area.boundary[0].imag, color=COLOUR["rk4"], alpha=0.12)
    right.plot(area.boundary[0].real, area.boundary[0].imag, color=COLOUR["rk4"], label="RK4")
    for factor, colour, mark, text in (
        (1.0, "#009e73", "o", f"largest stable step, h = {h:.3f} s"),
        (1.25, "#d55e00", "x", f"a quarter more, h = {1.25 * h:.3f} s"),
    ):
        z = factor * h * eigenvalues
        right.plot(z.real, z.imag, mark, color=colour, markersize=3.5, label=text)
    right.set(xlim=(-4.3, 1.2), ylim=(-3.6, 5.0), title="A damped chain of 40 masses and RK4")
    right.legend(loc="upper left", fontsize=8)
    for ax in (left, right):
        ax.axhline(0, color="0.8", linewidth=0.8, zorder=0)
        ax.axvline(0, color="0.8", linewidth=0.8, zorder=0)
        ax.set(xlabel="Re hλ", ylabel="Im hλ")
        ax.set_aspect("equal")
    return fig


def oscillator(method, h, steps, x0=(1.0,), v0=(0.0,)):
    """(x, v) of x'' = -x after every step, by the solver that knows the method."""
    if method in stability.second_order_methods():
        out = substep.solve_second_order(lambda t, x, v: -x, (0, h * steps), x0, v0, method, step=h)
        return out.x[0], out.v[0]
    if method == "implicit_euler":  # for comparison: (I - h J) y_{n+1} = y_n
        points = np.array([stability.amplification(method, 1j * h) ** n for n in range(steps + 1)])
        return points.real, -points.imag
    out = substep.solve_ivp(
        lambda t, y: np.array([y[1], -y[0]]), (0, h * steps), [*x0, *v0], method, step=h
    )
    return out.y


def euler_spiral():
    """Phase portraits of the oscillator, one panel a method, the same step."""
    methods = ("euler", "symplectic_euler", "velocity_verlet", "rk4")
    h, steps = 0.2, 94  # three turns
    angle = np.linspace(0, 2 * np.pi, 200)
    fig, axes = plt.subplots(1, 4, figsize=(9, 2.6))
    for ax, method in zip(axes, methods, strict=True):
        x, v = oscillator(method, h, steps)
        size = 7.2 if method == "euler" else 1.45
        ax.plot(np.cos(angle), np.sin(angle), color="0.6", linewidth=4, alpha=0.5)
        ax.plot(x, v, ".-", color=COLOUR[method], markersize=3, linewidth=0.7)
        energy = x**2 + v**2
        if method == "euler":
            text = f"energy × {energy[-1]:.0f}"
        else:
            text = f"energy within {abs(energy - 1).max():.2g}".replace("e-0", "e-")
        ax.set(title=NAME[method], xlabel="x", xlim=(-size, size), ylim=(-1.25 * size, size))
        ax.set_aspect("equal")
        ax.text(0.5, 0.03, text, transform=ax.transAxes, ha="center", fontsize=8)
    axes[0].set(ylabel="v / ω")
    return fig


def symplectic_limit():
    """Symplectic Euler just below, at and above h omega = 2."""
    fig, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.2))
    for s, colour, dash in (
        (1.99, "#009e73", "-"),
        (2.0, "#0072b2", "--"),
        (2.01, "#d55e00", "-."),
    ):
        x, v = oscillator("symplectic_euler", s, 160)
        growth = {1.99: "bounded", 2.0: "grows linearly", 2.01: "explodes"}[s]
        size = np.hypot(x, v)
        left.plot(size, dash, color=colour, label=f"hω = {s:g}: {growth}")
    left.set(yscale="log", xlabel="step n", ylabel="|(x, v / ω)|", ylim=(0.5, 1e8), xlim=(0, 160))
    left.set_title("The step decides")
    left.legend(loc="upper right")
    s = np.linspace(0, 2.4, 961)
    for method, dash in (("symplectic_euler", "-"), ("velocity_verlet", "--"), ("yoshida4", "-.")):
        radius = abs(stability.amplification_eigenvalues(method, s)).max(axis=-1)
        label = "symplectic Euler, both Verlets" if method == "symplectic_euler" else NAME[method]
        if method != "velocity_verlet":
            right.plot(s, radius, dash, color=COLOUR[method], label=label)
    for method in ("rk4", "euler"):
        radius = abs(stability.amplification(method, 1j * s))
        right.plot(s, radius, ":", color=COLOUR[method], label=NAME[method])
    right.set(xlabel="hω", ylabel="largest |eigenvalue| of a step", ylim=(0.6, 2.2), xlim=(0, 2.4))
    right.set_title("One is the limit: undamped oscillator")
    right.legend(loc="upper left", fontsize=8)
    return fig


def damping():
    """The damped oscillator with the force -c v in every method, and the limit it costs."""
    zeta, h = 0.1, 0.5
    fig, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.2), width_ratios=(1.35, 1))
    t = np.linspace(0, 25, 1000)
    damped = np.sqrt(1 - zeta**2)
    exact = np.exp(-zeta * t) * (np.cos(damped * t) + zeta / damped * np.sin(damped * t))
    left.plot(t, exact, color="0.6", linewidth=4, alpha=0.5, label="exact")
    for method, mark in (("symplectic_euler", "s"), ("velocity_verlet", "o"), ("yoshida4", "x")):
        out = substep.solve_second_order(
            lambda t, x, v: -x - 2 * zeta * v, (0, 25), [1.0], [0.0], method, step=h
        )
        left.plot(out.t, out.x[0], mark, color=COLOUR[method], markersize=3.5, label=NAME[method])
    out = substep.solve_ivp(
        lambda t, y: np.array([y[1], -y[0] - 2 * zeta * y[1]]), (0, 25), [1.0, 0.0], "euler", step=h
    )
    shown = np.logical_and.accumulate(abs(out.y[0]) < 2)
    left.plot(out.t[shown], out.y[0][shown], "v:", color=COLOUR["euler"], markersize=3)
    left.text(6.2, 2.0, "explicit Euler\nexplodes", color=COLOUR["euler"], fontsize=8)
    left.set(xlabel="ωt", ylabel="x", xlim=(0, 25), ylim=(-1.9, 2.6))
    left.set_title(f"Force −cv, ζ = {zeta:g}, step hω = {h:g}")
    left.legend(loc="upper right", fontsize=8)
    ratios = np.linspace(0, 1.5, 151)
    for method in ("symplectic_euler", "velocity_verlet", "yoshida4"):
        limits = [stability.stability_limit(method, r) for r in ratios]
        label = "both Verlets" if method == "velocity_verlet" else NAME[method]
        right.plot(ratios, limits, color=COLOUR[method], label=label)
    roots = -ratios + 1j * np.sqrt(np.maximum(1 - ratios**2, 0))
    roots = roots - np.sqrt(np.maximum(ratios**2 - 1, 0))  # overdamped: the faster of the two
    for method in ("rk4", "euler"):
        limits = [stability.max_stable_step(method, [root]) for root in roots]
        right.plot(ratios, limits, ":", color=COLOUR[method], label=NAME[method])
    right.set(xlabel="damping ratio ζ", ylabel="largest stable hω", xlim=(0, 1.5), ylim=(0, 3.9))
    right.set_title("Largest stable step with damping")
    right.legend(fontsize=8, ncols=2, loc="upper right")
    return fig


def energy():
    """Kepler's orbit of eccentricity 0.6: the energy error over 1e6 steps of 0.01."""
    h, steps = 0.01, 1_000_000
    orbit = substep.systems.Kepler(eccentricity=0.6)
    fig, ax = plt.subplots(figsize=(7.2, 4.2))
    methods = ("euler", "midpoint", "heun", "rk4", *stability.second_order_methods())
    at = np.unique(np.geomspace(10, steps, 120).astype(int)) - 1
    for method in methods:
        if method in stability.second_order_methods():
            x0, v0 = orbit.y0[:2], orbit.y0[2:]
            out = substep.solve_second_order(orbit, (0, h * steps), x0, v0, method, step=h)
            values = orbit.energy(np.concatenate([out.x, out.v]))
        else:
            values = orbit.energy(
                substep.solve_ivp(orbit, (0, h * steps), orbit.y0, method, step=h).y
            )
        error = np.maximum.accumulate(abs(values / values[0] - 1)[1:])
        dash = "--" if method in ("midpoint", "velocity_verlet") else "-"
        ax.plot(at + 1, error[at], dash, color=COLOUR[method])
        if method == "position_verlet":
            continue
        label = "both Verlets" if method == "velocity_verlet" else NAME[method]
        shift = {"heun": 3, "midpoint": -4}.get(method, 0)
        place = {"xytext": (5, shift), "textcoords": "offset points", "va": "center"}
        ax.annotate(label, (steps, error[-1]), color=COLOUR[method], fontsize=8, **place)
    ax.set(xscale="log", yscale="log", xlim=(10, steps))
    ax.set(xlabel="steps of 0.01 (628 to a revolution)", ylabel="largest |ΔE / E| so far")
    ax.set_title("Kepler's orbit, e = 0.6: energy over 10⁶ steps")
    return fig


def work_precision():
    """Arenstorf's orbit: the error at the end against the work, for the adaptive methods."""
    orbit = substep.systems.Arenstorf()
    fig, ax = plt.subplots(figsize=(6.2, 4.2))
    for method, mark in (("heun", "v"), ("rk4", "s"), ("RK45", "o"), ("DOP853", "D")):
        work, error = [], []
        for tolerance in 10.0 ** np.arange(-5, -13 if method != "heun" else -9, -0.5):
            out = substep.solve_ivp(
                orbit, (0, orbit.t_end), orbit.y0, method, rtol=tolerance, atol=tolerance
            )
            work.append(out.nfev)
            error.append(np.linalg.norm(out.y[:2, -1] - orbit.y0[:2]))
        label = NAME.get(method, method) + (
            " by step doubling" if method in ("heun", "rk4") else ""
        )
        ax.plot(work, error, f"{mark}-", color=COLOUR[method], markersize=4, label=label)
    ax.set(xscale="log", yscale="log", xlabel="evaluations of the right-hand side")
    ax.set_ylabel("distance from the start after one period")
    ax.set_title("Arenstorf's orbit: accuracy against work")
    ax.grid(which="major", color="0.9")
    ax.legend()
    return fig


def hero():
    """Drifters in the Agulhas current for a week, and the stability regions."""
    currents = ROOT.parent / "shared" / "data" / "globcurrent"
    if not currents.exists():
        print("hero.png: skipped, needs the ocean currents of", currents)
        return None
    day = 86400.0
    field = substep.open_field(currents)
    (west, east), (south, north) = field.axes[0][[0, -1]], field.axes[1][[0, -1]]
    rng = np.random.default_rng(1)
    start = rng.uniform([west, south], [east, north], (14_000, 2))
    start = start[np.isfinite(field(0.0, start)).all(axis=1)]
    days = np.linspace(23, 30, 57)
    drift = substep.advect(field, start, (23 * day, 30 * day), 3600.0, t_eval=days * day)
    paths = drift.positions.transpose(1, 0, 2)  # (particle, time, 2)

    fig = plt.figure(figsize=(10, 4.1), facecolor="white")
    left, right = fig.subplots(1, 2, width_ratios=(1.75, 1))
    left.set_facecolor("#06121f")
    nodes = np.stack(np.meshgrid(*field.axes, indexing="ij"), axis=-1)
    sea = np.isfinite(field(0.0, nodes.reshape(-1, 2))).all(axis=1).reshape(nodes.shape[:2])
    left.contourf(*field.axes, sea.T, levels=[-0.5, 0.5], colors="#b9b3a5", zorder=3)
    segments = np.stack([paths[:, :-1], paths[:, 1:]], axis=2)  # (particle, time, end, 2)
    metres = np.diff(paths, axis=1) * 111_195.0
    metres[..., 0] *= np.cos(np.deg2rad(paths[:, :-1, 1]))
    speed = np.hypot(metres[..., 0], metres[..., 1]) / (np.diff(days)[0] * day)
    age = np.broadcast_to(np.linspace(0, 1, speed.shape[1]) ** 1.5, speed.shape)
    moving = speed > 0
    colours = plt.get_cmap("viridis")(np.clip(speed[moving] / 1.6, 0, 1))
    colours[:, 3] = 0.3 + 0.7 * age[moving]
    lines = LineCollection(segments[moving], colors=colours, linewidths=0.45, capstyle="round")
    left.add_collection(lines)
    left.set(xlim=(west, east), ylim=(south, north), aspect=1 / np.cos(np.deg2rad(35)))
    left.set(xlabel="longitude [°]", ylabel="latitude [°]")
    left.set_title(f"{len(start):,} drifters in the Agulhas current: their paths of one week")
    scale = plt.cm.ScalarMappable(plt.Normalize(0, 1.6), "viridis")
    fig.colorbar(scale, ax=left, label="speed [m/s]", pad=0.01, aspect=28, shrink=0.92)

    for method in ("DOP853", "RK45", "rk4", "heun", "euler"):
        area = stability.region(method)
        main = area.boundary[0]
        label = "Heun, midpoint" if method == "heun" else NAME.get(method, method)
        right.fill(main.real, main.imag, color=COLOUR[method], alpha=0.12)
        right.plot(main.real, main.imag, color=COLOUR[method], label=label)
    right.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    right.axvline(0, color="0.8", linewidth=0.8, zorder=0)
    right.set(xlim=(-7, 6.2), ylim=(-6.9, 6.9), xlabel="Re hλ", ylabel="Im hλ", aspect="equal")
    right.set_title("Where each method is stable")
    right.legend(loc="center right", fontsize=8, borderaxespad=0)
    return fig


def stabilised():
    """Regions of RKC2 for several numbers of stages, and R on the real axis for ten."""
    fig, (top, bottom) = plt.subplots(
        2, 1, figsize=(8.6, 4.6), height_ratios=(1, 1.15), sharex=True
    )
    for stages, colour in ((10, "#0072b2"), (6, "#009e73"), (3, "#d55e00")):
        curve = stability.region(f"RKC2({stages})").boundary[0]
        top.fill(curve.real, curve.imag, color=colour, alpha=0.12)
        top.plot(curve.real, curve.imag, color=colour, label=f"{stages} stages")
    curve = stability.region("rk4").boundary[0]
    top.plot(curve.real, curve.imag, color="#000000", linestyle=":", label="RK4")
    top.set(title="RKC2 is stable inside: |R(hλ)| ≤ 1", ylabel="Im hλ", ylim=(-8.5, 12))
    top.legend(loc="upper left", ncols=4, fontsize=8)
    x = np.linspace(-67.5, 1, 4001)
    bottom.plot(x, stability.amplification("RKC2(10)", x).real, color="#0072b2", label="RKC2(10)")
    bottom.plot(x, np.exp(x), color="#777777", linestyle="--", label="exp(hλ)")
    bottom.axhspan(-1, 1, color="#009e73", alpha=0.08)
    bottom.axhline(1 - 2 / 13 / 3, color="0.6", linewidth=0.8, linestyle=":")
    bottom.set(xlim=(-68, 3), ylim=(-0.2, 1.2), xlabel="Re hλ", ylabel="R")
    bottom.legend(loc="upper left", fontsize=8, bbox_to_anchor=(0.28, 0.32), ncols=2)
    bottom.set_title("Ten stages on the real axis: below 1 - ε/3 (dotted) down to -64.6")
    for ax in (top, bottom):
        ax.axhline(0, color="0.8", linewidth=0.8, zorder=0)
        ax.axvline(0, color="0.8", linewidth=0.8, zorder=0)
    return fig


FIGURES = {
    function.__name__: function
    for function in (
        stability_regions,
        euler_spiral,
        symplectic_limit,
        damping,
        energy,
        work_precision,
        stabilised,
        hero,
    )
}


def main(names, folder=FOLDER):
    """Draw the named figures, or all, into the folder."""
    unknown = [name for name in names if name not in FIGURES]
    if unknown:
        raise SystemExit(f"{unknown[0]}: expected one of {', '.join(FIGURES)}")
    plt.switch_backend("Agg")
    for name in names or FIGURES:
        buffer = io.BytesIO()
        with plt.rc_context(STYLE):
            fig = FIGURES[name]()
            if fig is None:
                continue
            fig.savefig(buffer, format="png")
            plt.close(fig)
        path = folder / f"{name}.png"
        # 256 colours are enough, and a third of the size.
        Image.open(buffer).convert("RGB").quantize(
            256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
        ).save(path, optimize=True)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
