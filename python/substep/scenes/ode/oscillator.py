"""The harmonic oscillator under every explicit method: phase portraits and energy."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..declaration import Parameter, Scene
from .comparison import Comparison, second_order_solver, solver
from .portraits import draw_portraits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Recording

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
    from ...recording import Part

    return {"particles": Part("particles", fields={"energy": "J/kg"})}


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    angle = np.linspace(0, 2 * math.pi, 200)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    labels = ("x [m]", "v [m/s]")
    draw_portraits(figure, recording, frame, PERIOD, circle, (-2.2, 2.2, -2.2, 2.2), labels)
    figure.suptitle(
        f"Harmonic oscillator, step {recording.parameters['step']:g} s: phase plane "
        f"after {recording.times[frame] / PERIOD:.1f} periods (exact: grey)",
        fontsize=11,
    )


SCENE = Scene(
    name="oscillator",
    doc="The harmonic oscillator under every explicit method: phase portraits and energy.",
    parameters={
        "duration": Parameter("time simulated", 10.0, unit="periods", above=0),
        "step": Parameter("time step; the angular frequency is 1 rad/s", 0.1, unit="s", above=0),
        "methods": Parameter("methods, separated by commas", METHODS, choices=METHODS),
    },
    quick={"duration": 1.0},
    build=_build,
    parts=_parts,
    frame=_frame,
    picture=_picture,
    frames=501,
    time_unit="periods",
    time_scale=PERIOD,
)
