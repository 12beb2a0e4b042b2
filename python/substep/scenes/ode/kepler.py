"""A planet on an elliptic orbit under the second-order methods, and RK4 for contrast."""

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

SECOND_ORDER = ("symplectic_euler", "position_verlet", "velocity_verlet", "yoshida4")
METHODS = (*SECOND_ORDER, "rk4")
PERIOD = 2 * math.pi  # s, at the semi-major axis 1 m and the gravitational parameter 1 m^3/s^2


def _acceleration(t: float, x: NDArray[Any], v: NDArray[Any] | None = None) -> NDArray[Any]:
    """Newton's law of gravitation with GM = 1: a = -x / |x|^3."""
    return -x / math.hypot(x[0], x[1]) ** 3


def _first_order(t: float, y: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate([y[2:], _acceleration(t, y[:2])])


def _energy(x: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    """Per unit of mass: |v|^2 / 2 - 1 / |x|; -1/2 on this orbit."""
    return 0.5 * np.sum(v * v, axis=1) - 1 / np.hypot(x[:, 0], x[:, 1])


def _build(parameters: dict[str, Any], seed: int) -> Comparison:
    e = parameters["eccentricity"]
    solvers = {
        method: second_order_solver(method, _acceleration, PERIOD / parameters["steps"])
        if method in SECOND_ORDER
        else solver(method, _first_order, PERIOD / parameters["steps"])
        for method in parameters["methods"]
    }
    # At the pericentre of an ellipse with semi-major axis 1 (Hairer, Lubich, Wanner, "Geometric
    # Numerical Integration", 2006, I.2.3, eq. (2.11)).
    x, v = (1 - e, 0.0), (0.0, math.sqrt((1 + e) / (1 - e)))
    return Comparison(solvers, x, v, PERIOD / parameters["steps"], _energy)


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    e = recording.parameters["eccentricity"]
    angle = np.linspace(0, 2 * math.pi, 400)
    ellipse = np.column_stack([np.cos(angle) - e, math.sqrt(1 - e * e) * np.sin(angle)])
    r = 1.15 * (1 + e)
    reach, labels = (-r, 0.6 * r, -0.8 * r, 0.8 * r), ("x [m]", "y [m]")
    draw_portraits(figure, recording, frame, PERIOD, ellipse, reach, labels)
    for axes in figure.axes[:-1]:
        axes.plot(0, 0, "*", color="#e0a000", ms=9, mec="black", mew=0.4)
    figure.suptitle(
        f"Kepler orbit, eccentricity {e:g}, {recording.parameters['steps']} steps a period, "
        f"after {recording.times[frame] / PERIOD:.1f} periods (exact: grey)",
        fontsize=11,
    )


SCENE = Scene(
    name="kepler",
    doc="A planet on an elliptic orbit under the second-order methods, and RK4: orbits and energy.",
    parameters={
        "duration": Parameter("time simulated", 20.0, unit="periods", above=0),
        "eccentricity": Parameter("eccentricity of the orbit", 0.6, minimum=0, maximum=0.99),
        "steps": Parameter("steps a period", 200, minimum=1, maximum=10**7),
        "methods": Parameter("methods, separated by commas", METHODS, choices=METHODS),
    },
    quick={"duration": 2.0},
    build=_build,
    picture=_picture,
    frames=1001,
    time_unit="periods",
    time_scale=PERIOD,
)
