"""Particles that drift in a velocity field over a span of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..base.checks import check_array, check_callable
from ..base.pictured import Pictured, outline
from ..errors import InputError, SolverError
from .advection import Advection
from .flows import Field


@dataclass(frozen=True)
class AdvectionResult(Pictured):
    """Where the particles were, and what became of them.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Times of the positions [s].
    positions : ndarray, shape (m, n, d)
        Positions at these times; those of a stopped particle no longer change.
    status : ndarray of int8, shape (n,)
        0 active, 1 landed, 2 escaped.
    stop_time : ndarray, shape (n,)
        Time at which each particle stopped [s]; the final time where it did not.
    """

    t: NDArray[np.float64]
    positions: NDArray[Any]
    status: NDArray[np.int8]
    stop_time: NDArray[np.float64]

    __repr__ = outline

    @property
    def final(self) -> NDArray[Any]:
        """Positions at the last of the times, shape (n, d)."""
        return self.positions[-1]


def advect(
    field: Field | Callable[[float, NDArray[Any]], ArrayLike],
    positions: ArrayLike,
    t_span: tuple[float, float],
    step: float,
    method: str = "rk4",
    *,
    t_eval: ArrayLike | None = None,
    on_land: str = "stop",
    on_escape: str = "stop",
    threads: int | None = None,
    dtype: DTypeLike = np.float64,
    callback: Callable[[float, NDArray[Any]], object] | None = None,
) -> AdvectionResult:
    """Let particles drift in a velocity field over a span of time: dx/dt = u(t, x).

    Parameters
    ----------
    field : Field or callable
        A field of substep, or `velocity(t, x)` on arrays x of shape (n, d) that returns the
        velocities in the same shape.
    positions : array_like, shape (n, 2) or (n, 3)
        Initial positions [m, or degrees of longitude and latitude].
    t_span : (float, float)
        Initial and final time [s]; the final one may be the earlier.
    step : float
        Size of the steps [s], above 0; a step that would pass an output time ends there.
    method : str
        An explicit Runge-Kutta method of fixed step: 'euler', 'midpoint', 'heun' or 'rk4', of order
        1, 2, 2 and 4.
    t_eval : array_like, shape (m,), optional
        Times of output [s], in the order of t_span and within it; the final time unless given.
    on_land, on_escape : {'stop', 'raise'}
        What happens to particles that land or leave the grid; see `Advection`.
    threads : int, optional
        Threads of the native loops. Results do not depend on it.
    dtype : {numpy.float64, numpy.float32}
        Precision of positions and arithmetic.
    callback : callable, optional
        `callback(t, positions)` after every step; positions are a copy.

    Returns
    -------
    AdvectionResult
        `t`, `positions`, `status`, `stop_time`, and `final`.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.
    SolverError
        With 'raise', if a particle lands or leaves; `result` then holds the part solved, up to
        the last good step.
    NonFiniteError
        If a position overflows, or the callable returns NaN; likewise.

    References
    ----------
    Hairer, Norsett and Wanner (1993), "Solving Ordinary Differential Equations I", section II.1.

    Examples
    --------
    >>> import substep
    >>> result = substep.advect(substep.Shear(1.0), [[0.0, 1.0]], (0, 2), step=0.5, t_eval=[1, 2])
    >>> result.positions.round(9).tolist()
    [[[1.0, 1.0]], [[2.0, 1.0]]]
    """
    span = check_array("t_span", t_span, (2,))
    t0, t1 = float(span[0]), float(span[1])
    sign = -1.0 if t1 < t0 else 1.0
    times = span[1:] if t_eval is None else check_array("t_eval", t_eval, (None,))
    if len(times) and (
        (np.diff(times) * sign < 0).any()
        or not ((times - t0) * sign >= 0).all()
        or not ((t1 - times) * sign >= 0).all()
    ):
        raise InputError("t_eval: expected times within t_span, in its order")
    drift = Advection(
        field,
        positions,
        time=t0,
        step=step,
        method=method,
        on_land=on_land,
        on_escape=on_escape,
        threads=threads,
        dtype=dtype,
    )
    drift.field._check_time("t_span[1]", t1)
    after = None
    if callback is not None:
        call = check_callable("callback", callback)

        def after() -> None:
            call(drift.time, drift.positions)

    step_size = drift._step_size
    kept = np.empty((len(times), *drift.positions.shape), drift.positions.dtype)
    done = 0
    try:
        with drift._owner:
            for done, time in enumerate(times):
                drift._go(float(time) - drift.time, sign * step_size, after)
                drift._native.time = float(time)
                kept[done] = drift._particles.x
            done = len(times)
            drift._go(t1 - drift.time, sign * step_size, after)
    except SolverError as error:
        error.result = AdvectionResult(
            np.append(times[:done], drift.time),
            np.concatenate([kept[:done], drift.positions[None]]),
            drift.status,
            drift.stop_time,
        )
        raise
    return AdvectionResult(times, kept, drift.status, drift.stop_time)
