"""One problem under several methods side by side, each method moving a body of its own."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import check_array, check_integer, check_real
from ...errors import FormatError, InputError

Solver = Callable[[float, int, Any, Any], tuple[Any, Any]]


class Comparison:
    """The same initial value problem x'' = a(x) under several methods of fixed step.

    It takes whole steps only, so that every method shows itself undisturbed: `advance` goes to the
    step nearest to the time wanted.

    Parameters
    ----------
    solvers : mapping of str to callable
        By method, `solver(t, steps, x, v)` returns position and velocity so many steps later.
    x, v : array_like, shape (d,)
        Initial position [m] and velocity [m/s].
    step : float
        The time step [s].
    energy : callable
        `energy(x, v)` of arrays of shape (n, d), shape (n,) [J/kg].
    """

    def __init__(
        self,
        solvers: Mapping[str, Solver],
        x: ArrayLike,
        v: ArrayLike,
        step: float,
        energy: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]],
    ) -> None:
        self._solvers = dict(solvers)
        self._step = check_real("step", step, positive=True)
        self._energy = energy
        self._steps = 0
        self._x = np.tile(check_array("x", x, (None,)), (len(self._solvers), 1))
        self._v = np.tile(check_array("v", v, self._x.shape[1:]), (len(self._solvers), 1))

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return self._steps * self._step

    def step(self, dt: float) -> None:
        """One step; dt must be the step of the comparison."""
        if dt != self._step:
            raise InputError(f"dt: the step of this comparison is {self._step}, got {dt}")
        self._take(1)

    def advance(self, duration: float) -> None:
        """Take as many whole steps as come nearest to `duration` [s]."""
        duration = check_real("duration", duration, nonnegative=True)
        steps = math.floor((self.time + duration) / self._step + 0.5) - self._steps
        if steps < 1 and duration > 0:
            raise InputError(
                f"step: {self._step:g} s is too long for frames {duration:g} s apart; "
                "take a shorter step or fewer frames"
            )
        self._take(steps)

    def _take(self, steps: int) -> None:
        x, v = np.empty_like(self._x), np.empty_like(self._v)
        for row, solver in enumerate(self._solvers.values()):
            x[row], v[row] = solver(self.time, steps, self._x[row], self._v[row])
        self._x, self._v, self._steps = x, v, self._steps + steps

    def step_limit(self) -> tuple[float, str]:
        """The step, which is fixed."""
        return self._step, "fixed"

    def diagnostics(self) -> dict[str, float]:
        """Energy of each method's body [J/kg]."""
        return dict(zip(self._solvers, self._energy(self._x, self._v).tolist(), strict=True))

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays with one row per method, and their units."""
        return {
            "position": (self._x.copy(), "m"),
            "velocity": (self._v.copy(), "m/s"),
            "energy": (self._energy(self._x, self._v), "J/kg"),
        }

    def state(self) -> tuple[int, NDArray[Any], NDArray[Any]]:
        """A copy of the whole state."""
        return self._steps, self._x.copy(), self._v.copy()

    def restore(self, state: tuple[int, NDArray[Any], NDArray[Any]]) -> None:
        """Go back to a state."""
        steps, x, v = state
        if x.shape != self._x.shape or v.shape != self._v.shape:
            raise InputError(f"state: expected shape {self._x.shape}, got {x.shape}, {v.shape}")
        self._steps, self._x, self._v = steps, x.copy(), v.copy()

    def save(self, path: str | Path) -> None:
        """Write the whole state to a file."""
        state = {"steps": self._steps, "x": self._x.tolist(), "v": self._v.tolist()}
        Path(path).write_text(json.dumps(state))  # the shortest text of a float64 is exact

    def load(self, path: str | Path) -> None:
        """Read the whole state from a file."""
        try:
            state = json.loads(Path(path).read_bytes())
            steps = check_integer("steps", state["steps"], minimum=0)
            x, v = (check_array(name, state[name], self._x.shape) for name in "xv")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise FormatError(f"{path}: not a state of this comparison ({error})") from None
        self.restore((steps, x, v))


def solver(method: str, fun: Callable[[float, Any], Any], step: float) -> Solver:
    """A one-step method of `solve_ivp` on y = (x, v)."""
    from ...ode import solve_ivp

    def solve(t: float, steps: int, x: NDArray[Any], v: NDArray[Any]) -> tuple[Any, Any]:
        y = np.concatenate([x, v])
        span = (t, t + steps * step)
        end = solve_ivp(fun, span, y, method=method, step=step, t_eval=[span[1]]).y[:, -1]
        return end[: len(x)], end[len(x) :]

    return solve


def second_order_solver(method: str, acceleration: Callable[..., Any], step: float) -> Solver:
    """A method of `solve_second_order`."""
    from ...ode.second_order import solve_second_order

    def solve(t: float, steps: int, x: NDArray[Any], v: NDArray[Any]) -> tuple[Any, Any]:
        span = (t, t + steps * step)
        end = solve_second_order(
            acceleration, span, x, v, method=method, step=step, t_eval=[span[1]]
        )
        return end.x[:, -1], end.v[:, -1]

    return solve
