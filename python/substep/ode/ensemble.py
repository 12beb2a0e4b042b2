"""Many initial value problems at once: initial values or parameters over threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_integer, check_sequence, describe
from ..base.pictured import Pictured, outline
from ..base.pointers import RHS, find_address
from ..errors import InputError, NonFiniteError, SolverError
from .ivp import _check_t_eval, _method_name, check_control, check_extrapolation

__all__ = ["EnsembleResult", "solve_ensemble"]


def __dir__() -> list[str]:
    return __all__


_DONE, _FAILED, _NOT_FINITE, _TOO_MANY_STEPS = range(4)


@dataclass
class EnsembleResult(Pictured):
    """What `solve_ensemble` returns.

    Attributes
    ----------
    t : float or ndarray, shape (k,)
        The end, or the times of `t_eval`.
    y : ndarray, shape (m, n) or (m, n, k)
        States of the members at the end, or at the k times of `t_eval`. Where a member failed, its
        last good state, or NaN at the times that it did not reach.
    t_end : ndarray, shape (m,)
        Where each member ended.
    nfev : ndarray of int, shape (m,)
        Evaluations of f.
    nsteps : ndarray of int, shape (m,)
        Steps taken.
    status : ndarray of int, shape (m,)
        0: the end was reached; -1: failure.
    messages : list of str
        What went wrong; empty where nothing did.
    success : bool
        Whether all members reached the end.
    """

    t: Any
    y: NDArray[np.float64]
    t_end: NDArray[np.float64]
    nfev: NDArray[np.int64]
    nsteps: NDArray[np.int64]
    status: NDArray[np.int64]
    messages: list[str]

    __repr__ = outline

    @property
    def success(self) -> bool:
        """Whether all members reached the end."""
        return not self.status.any()


def solve_ensemble(
    fun: Any,
    t_span: ArrayLike,
    Y0: ArrayLike,
    params: ArrayLike | None = None,
    method: str = "RK45",
    *,
    step: float | None = None,
    rtol: ArrayLike = 1e-3,
    atol: ArrayLike = 1e-6,
    t_eval: ArrayLike | None = None,
    first_step: float | None = None,
    max_step: float = np.inf,
    local_extrapolation: bool = True,
    max_steps: int = 10_000_000,
    threads: int | None = None,
) -> EnsembleResult:
    """Solve y' = f(t, y, p) for many initial values, parameters or both, over threads.

    Each member is solved as `solve_ivp` would, with steps of its own; its result depends neither on
    the other members nor on the number of threads.

    Parameters
    ----------
    fun : compiled function, system or sequence of systems
        A native function ``void(double t, double* y, double* dydt, double* p)`` (`numba.cfunc`,
        ctypes, `scipy.LowLevelCallable`), where p points to the member's row of `params`; or a
        system of `substep.systems` for all members; or a list of systems, one per member.
    t_span : tuple of two floats
        Start and end; the end may be the earlier one.
    Y0 : array_like, shape (m, n) or (n,)
        Initial states, one row per member; a single one serves all members.
    params : array_like, shape (m, q) or (m,), optional
        Parameters of native functions, one row per member; (m,) is one number for each.
    method : str
        As in `solve_ivp`.
    step, rtol, atol, first_step, max_step, local_extrapolation, max_steps
        As in `solve_ivp`, for each member.
    t_eval : array_like, shape (k,), optional
        Times to return; by default the end alone.
    threads : int, optional
        Number of threads, by default as set by `set_num_threads`.

    Returns
    -------
    EnsembleResult
        States, and for each member counts and status.

    Raises
    ------
    InputError
        An argument is wrong.
    TypeError
        `fun` is a Python function: threads cannot run it.
    NonFiniteError, SolverError
        A member failed. The others are done all the same: `result` holds everything, `index` is
        the first member that failed.

    Examples
    --------
    >>> import substep
    >>> growth = [substep.systems.HarmonicOscillator(omega) for omega in (1.0, 2.0, 3.0)]
    >>> result = substep.solve_ensemble(growth, (0, 1), [1.0, 0.0], rtol=1e-8, atol=1e-8)
    >>> result.y[:, 0].round(6)
    array([ 0.540302, -0.416147, -0.989992])
    """
    t0, t1 = check_array("t_span", t_span, (2,)).tolist()
    name = _method_name(method)
    times = _check_t_eval(t_eval, t0, t1)
    systems, address, rows = _right_hand_sides(fun, params)
    wanted = None  # the number of members, where systems or parameters give it
    if isinstance(fun, Sequence) and systems:
        wanted = len(systems)
    elif params is not None:
        wanted = len(rows)
    y0 = _initial_states(Y0, wanted)
    members, size = y0.shape
    if wanted is not None and wanted != members:
        what = "systems" if systems else "rows of params"
        raise InputError(f"Y0: expected {wanted} rows, as many as {what}, got {members}")
    for system in systems:
        if system.size != size:
            raise InputError(f"Y0: expected rows of {system.size} components, got {size}")
    control = check_control(step, rtol, atol, first_step, max_step, size, abs(t1 - t0))
    control |= check_extrapolation(name, local_extrapolation)
    limit = check_integer("max_steps", max_steps, minimum=1, maximum=2**63 - 1)
    count = 0 if threads is None else check_integer("threads", threads, minimum=1, maximum=1024)
    if t0 == t1 or size == 0:
        y = y0 if times is None else np.repeat(y0[:, :, None], times.size, axis=2)
        reports = [(_DONE, "", t1, -1, 0, 0)] * members
    elif times is not None and times.size == 0:
        raise InputError("t_eval: expected at least one time")
    else:
        y, reports = _core.solve_ensemble(
            systems=systems,
            address=address,
            parameters=rows,
            method=name,
            t0=t0,
            t1=t1,
            y0=y0,
            t_eval=[] if times is None else times.tolist(),
            max_steps=limit,
            threads=count,
            **control,
        )
    return _result(t1 if times is None else times, y, reports)


def _right_hand_sides(
    fun: Any, params: ArrayLike | None
) -> tuple[list[_core.System], int, NDArray[np.float64]]:
    """Compiled systems, or the address of a function and the rows of parameters."""
    no_rows = np.zeros((0, 0))
    several = isinstance(fun, Sequence) and not hasattr(fun, "signature")  # LowLevelCallable
    functions = check_sequence("fun", fun, "systems") if several else [fun]
    systems = [getattr(f, "native_system", f) for f in functions]
    if systems and all(isinstance(system, _core.System) for system in systems):
        if params is not None:
            raise InputError(
                "params: a compiled system takes its parameters when it is made; pass a list of "
                "systems, one per member"
            )
        return systems, 0, no_rows
    address, user_data = find_address("fun", fun, RHS)
    if address is not None:
        if params is None:
            return [], address, user_data  # for all members
        rows = check_array("params", params, finite=False)
        if rows.ndim not in (1, 2):
            raise InputError(f"params: expected shape (m, q) or (m,), got {rows.shape}")
        return [], address, rows.reshape(rows.shape[0], -1)
    if callable(fun):
        raise TypeError(
            "fun: a Python function cannot run on several threads; make it native with "
            "@numba.cfunc('void(float64, CPointer(float64), CPointer(float64), CPointer(float64))')"
            ", or solve the members one by one with solve_ivp"
        )
    raise TypeError(
        f"fun: expected a compiled function {RHS}, a system of substep.systems or a list of "
        f"systems, got {describe(fun)}"
    )


def _initial_states(Y0: ArrayLike, members: int | None) -> NDArray[np.float64]:
    y0 = check_array("Y0", Y0)
    if y0.ndim == 1:
        y0 = np.repeat(y0[None, :], 1 if members is None else members, axis=0)
    if y0.ndim != 2:
        raise InputError(f"Y0: expected shape (m, n) or (n,), got {y0.shape}")
    return y0


def _result(
    t: Any, y: NDArray[np.float64], reports: list[tuple[int, str, float, int, int, int]]
) -> EnsembleResult:
    statuses = [report[0] for report in reports]
    messages = [report[1] for report in reports]
    t_end = [report[2] for report in reports]
    nsteps = [report[4] for report in reports]
    result = EnsembleResult(
        t=t,
        y=y,
        t_end=np.array(t_end, dtype=np.float64),
        nfev=np.array([report[5] for report in reports], dtype=np.int64),
        nsteps=np.array(nsteps, dtype=np.int64),
        status=np.array([0 if s == _DONE else -1 for s in statuses], dtype=np.int64),
        messages=messages,
    )
    if not result.success:
        failed = np.flatnonzero(result.status)
        first = int(failed[0])
        kind = NonFiniteError if statuses[first] == _NOT_FINITE else SolverError
        raise kind(
            f"{failed.size} of {len(reports)} members failed, the first of them member {first}: "
            f"{messages[first]}",
            time=t_end[first],
            index=first,
            step=nsteps[first],
            result=result,
        )
    return result
