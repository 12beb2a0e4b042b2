"""Measured for `substep validate`: orders, stability, orbits and stiff problems of integrators."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import systems
from ..ode import solve_ivp, solve_second_order
from ..stability import amplification, real_limit

Array = NDArray[np.float64]

_COUNTS = {1: (800, 1600), 2: (200, 400), 3: (120, 240), 4: (80, 160), 5: (144, 192)}


def order(method: str, nominal: int) -> float:
    """Slope of the error against the step, for a forced and damped pendulum."""

    def pendulum(t: float, y: Array) -> Array:
        return np.array([y[1], -np.sin(y[0]) + 0.5 * np.cos(1.3 * t) - 0.1 * y[1] * y[0]])

    def end(method: str, count: int) -> Array:
        solved = solve_ivp(pendulum, (0, 3), [1.0, 0.2], method, step=3 / count, t_eval=[3.0])
        return solved.y[:, 0]

    exact = end("DOP853", 384)
    counts = (24, 48) if method == "Radau" else _COUNTS.get(nominal, (6, 8, 10, 12))
    errors = [np.linalg.norm(end(method, count) - exact) for count in counts]
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0])


def second_order_order(method: str, counts: tuple[int, int]) -> float:
    """Slope of the error against the step, for x'' = -x + 2 cos t, whose solution is known."""
    errors = []
    for count in counts:
        solved = solve_second_order(
            lambda t, x, v: -x + 2 * np.cos(t), (0, 3), [0.0], [1.0], method, step=3 / count
        )
        errors.append(abs(solved.x[0, -1] - 4 * math.sin(3)))
    return math.log(errors[0] / errors[1]) / math.log(counts[1] / counts[0])


def growth(method: str, z: complex) -> float:
    """Factor by which one step multiplies the solution of y' = lambda y, z = h lambda."""
    solved = solve_ivp(
        lambda t, y: z * y, (0, 8), np.array([1.0 + 0j]), method, step=1.0, t_eval=[8.0]
    )
    return float(abs(solved.y[0, -1]) ** (1 / 8))


def largest_step(method: str, direction: complex, most: float) -> float:
    """Largest h |lambda| for which 400 steps leave y' = lambda y bounded, by bisection."""
    low, high = 0.0, most
    while high - low > 1e-5:
        z = (low + high) / 2
        solved = solve_ivp(
            lambda t, y, z=z: z * direction * y,
            (0, 400),
            np.array([1.0 + 0j]),
            method,
            step=1.0,
            t_eval=[400.0],
        )
        low, high = (z, high) if abs(solved.y[0, -1]) <= 1 + 1e-9 else (low, z)
    return low


def damping_left(stages: int) -> float:
    """Reach of RKC2 along the negative real axis over the squared number of stages."""
    reach = real_limit(f"RKC2({stages})")
    assert abs(amplification(f"RKC2({stages})", -0.999 * reach)) <= 1
    return reach / stages**2


def bounded_decay(method: str, z: float) -> float:
    """|y| after 100 steps of y' = -y with steps of length z."""
    solved = solve_ivp(lambda t, y: -y, (0, 100 * z), [1.0], method, step=z, t_eval=[100 * z])
    return float(abs(solved.y[0, -1]))


def end_value(system: Any, duration: float, method: str, tolerance: float, row: int) -> float:
    """A component of the solution at the end."""
    solved = solve_ivp(
        system, (0, duration), system.y0, method, rtol=tolerance, atol=1e-3 * tolerance
    )
    return float(solved.y[row, -1])


def arenstorf() -> float:
    """Distance from its start after one period."""
    system = systems.Arenstorf()
    period = 17.0652165601579625588917206249
    solved = solve_ivp(system, (0, period), system.y0, "DOP853", rtol=1e-12, atol=1e-12)
    return float(np.linalg.norm(solved.y[:2, -1] - system.y0[:2]))


def pleiades() -> float:
    """Where the first star is at t = 3."""
    return end_value(systems.Pleiades(), 3.0, "DOP853", 1e-10, 0)


def robertson(method: str = "Radau") -> float:
    """Concentration of the first species at t = 1e11."""
    system = systems.Robertson()
    solved = solve_ivp(system, (0, 1e11), system.y0, method, rtol=1e-8, atol=1e-20)
    return float(solved.y[0, -1])


def kepler_energy(method: str, step: float) -> float:
    """Largest relative error of the energy over 100 orbits of eccentricity 0.5."""

    def pull(t: float, x: Array, v: Array) -> Array:
        return -x / np.hypot(*x) ** 3

    solved = solve_second_order(
        pull, (0, 200 * math.pi), [0.5, 0.0], [0.0, math.sqrt(3.0)], method, step=step
    )
    energy = (solved.v**2).sum(axis=0) / 2 - 1 / np.hypot(*solved.x)
    return float(np.abs(energy / -0.5 - 1).max())
