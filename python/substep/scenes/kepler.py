"""A planet on an elliptic orbit under the second-order methods, and RK4 for contrast."""

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
    methods = method_names(recording, METHODS)
    frames = [recording.frame(i)["particles"] for i in range(frame + 1)]
    time = recording.times[: frame + 1] / PERIOD
    x = np.array([f["points"] for f in frames])
    energy = np.array([f["energy"] for f in frames])
    error = np.abs(energy / energy[0] - 1)
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.15))
    orbit, drift = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    for k, method in enumerate(methods):
        colour = COLOURS[k % len(COLOURS)]
        orbit.plot(x[:, k, 0], x[:, k, 1], color=colour, lw=0.7, alpha=0.8)
        orbit.plot(*x[-1, k, :2], "o", color=colour, ms=5)
        drift.plot(time, np.maximum(error[:, k], 1e-16), color=colour, lw=1.1, label=method)
    orbit.plot(0, 0, "*", color="#e0a000", ms=14, mec="black", mew=0.5)
    e = recording.parameters["eccentricity"]
    reach = 1.25 * (1 + e)
    orbit.set(xlim=(-reach, 0.75 * reach), ylim=(-0.875 * reach, 0.875 * reach), aspect="equal")
    orbit.set(xlabel="x [m]", ylabel="y [m]")
    orbit.set_title(
        f"Kepler orbit, e = {e:g}, {recording.parameters['steps']} steps a period", loc="left"
    )
    drift.set(
        yscale="log", ylim=(1e-13, 10), xlabel="time [periods]", ylabel="relative energy error"
    )
    drift.set_xlim(0, recording.parameters["duration"])
    drift.set_title(f"after {time[-1]:.4g} periods", loc="left")
    drift.grid(True, which="major", color="0.9")
    drift.legend(loc="upper left", ncols=2, fontsize=8, frameon=False)


SCENE = Scene(
    name="kepler",
    doc="A planet on an elliptic orbit under the second-order methods, and RK4: orbits and energy.",
    parameters={
        "duration": Parameter("time simulated", 50.0, unit="periods", above=0),
        "eccentricity": Parameter("eccentricity of the orbit", 0.6, minimum=0, maximum=0.99),
        "steps": Parameter("steps a period", 200, minimum=1, maximum=10**7),
        "methods": Parameter("methods, separated by commas", METHODS, choices=METHODS),
    },
    build=_build,
    picture=_picture,
    frames=1001,
    time_unit="periods",
    time_scale=PERIOD,
)
