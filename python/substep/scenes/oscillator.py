"""The harmonic oscillator under every explicit method: phase portraits and energy."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .comparison import Comparison, method_names, second_order_solver, solver
from .declaration import Parameter, Scene
from .style import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..recording import Recording

FIRST_ORDER = ("euler", "midpoint", "heun", "rk4", "RK45", "DOP853")
SECOND_ORDER = ("symplectic_euler", "position_verlet", "velocity_verlet", "yoshida4")
METHODS = (*FIRST_ORDER, *SECOND_ORDER)
PERIOD = 2 * math.pi  # s, at the angular frequency 1 rad/s


def _acceleration(t: float, x: NDArray[Any], v: NDArray[Any] | None = None) -> NDArray[Any]:
    return -x


def _first_order(t: float, y: NDArray[Any]) -> NDArray[Any]:
    return np.array([y[1], -y[0]])


def _energy(x: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    """Per unit of mass: (x^2 + v^2) / 2; 1/2 at the start."""
    energy: NDArray[Any] = 0.5 * (x[:, 0] ** 2 + v[:, 0] ** 2)
    return energy


def _build(parameters: dict[str, Any], seed: int) -> Comparison:
    h = parameters["step"]
    solvers = {
        method: second_order_solver(method, _acceleration, h)
        if method in SECOND_ORDER
        else solver(method, _first_order, h)
        for method in parameters["methods"]
    }
    return Comparison(solvers, (1.0,), (0.0,), h, _energy)


def _frame(simulation: Comparison) -> dict[str, dict[str, Any]]:
    """The bodies as points of the phase plane, (x, v), with their energy."""
    columns = {name: values for name, (values, _) in simulation.fields().items()}
    points = np.hstack([columns["position"], columns["velocity"]])
    return {"particles": {"points": points, "energy": columns["energy"]}}


def _parts(simulation: Comparison) -> dict[str, Any]:
    from ..recording import Part

    return {"particles": Part("particles", fields={"energy": "J/kg"})}


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    methods = method_names(recording, METHODS)
    frames = [recording.frame(i)["particles"] for i in range(frame + 1)]
    time = recording.times[: frame + 1] / PERIOD
    points = np.array([f["points"] for f in frames])
    energy = np.array([f["energy"] for f in frames])
    columns = min(5, len(methods))
    rows = -(-len(methods) // columns)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=(1,) * rows + (1.35,))
    circle = np.linspace(0, 2 * math.pi, 200)
    for k, method in enumerate(methods):
        axes = figure.add_subplot(grid[divmod(k, columns)])
        axes.plot(np.cos(circle), np.sin(circle), color="0.75", lw=2.5)
        axes.plot(*points[:, k, :2].T, color=_colour(k), lw=0.7)
        axes.plot(*points[-1, k, :2], "o", color=_colour(k), ms=4)
        axes.set(
            xlim=(-2.2, 2.2), ylim=(-2.2, 2.2), aspect="equal", xticks=(-1, 0, 1), yticks=(-1, 0, 1)
        )
        axes.set_title(method, fontsize=9)
        axes.tick_params(labelsize=7, length=2)
        if k % columns == 0:
            axes.set_ylabel("v [m/s]", fontsize=8)
        if k // columns == rows - 1:
            axes.set_xlabel("x [m]", fontsize=8)
    axes = figure.add_subplot(grid[rows, :])
    for k, method in enumerate(methods):
        style = "-" if method in FIRST_ORDER else "--"
        axes.plot(
            time,
            np.maximum(np.abs(energy[:, k] / energy[0, k] - 1), 1e-17),
            style,
            color=_colour(k),
            lw=1.1,
            label=method,
        )
    axes.set(yscale="log", ylim=(1e-17, 1e3), xlim=(0, recording.parameters["duration"]))
    axes.set(xlabel="time [periods]", ylabel="relative energy error")
    axes.grid(True, color="0.9")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    figure.suptitle(
        f"Harmonic oscillator, step {recording.parameters['step']:g} s: "
        f"phase plane after {time[-1]:.3g} periods (exact: the grey circle), and energy",
        fontsize=11,
    )


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


SCENE = Scene(
    name="oscillator",
    doc="The harmonic oscillator under every explicit method: phase portraits and energy.",
    parameters={
        "duration": Parameter("time simulated", 10.0, unit="periods", above=0),
        "step": Parameter("time step; the angular frequency is 1 rad/s", 0.1, unit="s", above=0),
        "methods": Parameter("methods, separated by commas", METHODS, choices=METHODS),
    },
    build=_build,
    parts=_parts,
    frame=_frame,
    picture=_picture,
    frames=501,
    time_unit="periods",
    time_scale=PERIOD,
)
