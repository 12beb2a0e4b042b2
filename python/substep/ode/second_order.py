"""Fixed-step methods for second-order equations x'' = a(t, x, v): symplectic Euler and Verlet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_callable, check_choice, check_integer, check_real
from ..base.pictured import Pictured, outline
from ..base.pointers import ACCELERATION, find_address
from ..errors import InputError, NonFiniteError, SolverError
from .rhs import unpack_args

__all__ = ["METHODS", "SecondOrderResult", "solve_second_order"]


def __dir__() -> list[str]:
    return __all__


METHODS = tuple(entry["name"] for entry in _core.second_order_methods())

_DONE, _NOT_FINITE, _STEP_UNDERFLOW, _TOO_MANY_STEPS = range(4)


@dataclass
class SecondOrderResult(Pictured):
    """What `solve_second_order` returns.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Times [s].
    x : ndarray, shape x0.shape + (m,)
        Positions; the time is the last axis, as in `solve_ivp`.
    v : ndarray, shape x0.shape + (m,)
        Velocities.
    nfev : int
        Evaluations of the acceleration.
    nsteps : int
        Steps taken.
    status : int
        0: the end was reached; -1: failure (in an exception's `result`).
    message : str
        The same in words.
    success : bool
        Whether `status` is 0.
    """

    t: NDArray[np.float64]
    x: NDArray[np.float64]
    v: NDArray[np.float64]
    nfev: int
    nsteps: int
    status: int
    message: str

    __repr__ = outline

    @property
    def success(self) -> bool:
        """Whether the end was reached."""
        return self.status == 0


def solve_second_order(
    acceleration: Any,
    t_span: Sequence[float],
    x0: ArrayLike,
    v0: ArrayLike,
    method: str = "velocity_verlet",
    *,
    step: float,
    t_eval: ArrayLike | None = None,
    args: Any = None,
    callback: Callable[[float, NDArray[np.float64], NDArray[np.float64]], Any] | None = None,
    max_steps: int = 10_000_000,
    threads: int | None = None,
) -> SecondOrderResult:
    """Solve x'' = a(t, x, v) with steps of fixed length.

    Parameters
    ----------
    acceleration : callable, function pointer or compiled system
        One of

        - ``acceleration(t, x, v, *args)`` in Python, returning an array of the shape of `x0`; it
          sees read-only arrays;
        - a native function ``void(double t, const double *x, const double *v, double *a,
          double *p)``: a ``numba.cfunc``, a ctypes function or a ``scipy.LowLevelCallable``, called
          without the GIL;
        - a system of `substep.systems` that is of second order.
    t_span : (float, float)
        Start and end [s]; the end may lie before the start.
    x0 : array_like of float64, shape (n,), (n, 3), ...
        Positions at the start.
    v0 : array_like of float64, shape of `x0`
        Velocities at the start.
    method : str
        'symplectic_euler' (order 1), 'position_verlet' (2), 'velocity_verlet' (2) or 'yoshida4'
        (4); case does not matter. docs/second_order.md has the equations, and what each does with
        forces that depend on the velocity.
    step : float
        Length of a step [s], above 0. Steps end at ``t_span[0] + k step``; the last one is
        shortened to end at ``t_span[1]``.
    t_eval : array_like of float64, shape (m,), optional
        Times of the output [s], from start to end; between steps by cubic Hermite interpolation. By
        default the start and every step. With ``t_eval=[t_span[1]]`` large systems run many steps
        in one sweep through memory.
    args : tuple or array_like, optional
        Further arguments of a Python function, or the numbers behind `p` of a native one.
    callback : callable, optional
        ``callback(t, x, v)`` is called after every step.
    max_steps : int
        Number of steps after which `SolverError` is raised.
    threads : int, optional
        Threads for large compiled systems, by default as set by `set_num_threads`. The result does
        not depend on it.

    Returns
    -------
    SecondOrderResult
        Times, positions and velocities.

    Raises
    ------
    InputError
        If an argument, or what `acceleration` returns, is not as described.
    NonFiniteError
        If a value becomes NaN or infinite; ``result`` holds what was solved, its last time being
        the last good step, ``time`` and ``index`` say where.
    SolverError
        If `max_steps` is reached, or `step` is below the spacing of floating-point times.

    References
    ----------
    .. [1] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., Springer,
       2006, chapters I.1 and II.4.
    .. [2] H. Yoshida, "Construction of higher order symplectic integrators", Phys. Lett. A 150
       (1990) 262-268.
    .. [3] R. D. Groot, P. B. Warren, "Dissipative particle dynamics", J. Chem. Phys. 107 (1997)
       4423-4435, eq. 22.

    Examples
    --------
    A harmonic oscillator for one period:

    >>> import numpy as np
    >>> import substep
    >>> result = substep.solve_second_order(
    ...     lambda t, x, v: -x, (0, 2 * np.pi), [1.0], [0.0], step=2 * np.pi / 1000)
    >>> result.x.shape
    (1, 1001)
    >>> print(f"{result.x[0, -1]:.8f}")
    1.00000000
    """
    t0, t1 = check_array("t_span", t_span, (2,)).tolist()
    x = check_array("x0", x0)
    if x.ndim == 0:
        raise InputError("x0: expected an array of at least one dimension, got a scalar")
    v = check_array("v0", v0, x.shape)
    name = check_choice("method", method, METHODS)
    times = None if t_eval is None else _check_times(t_eval, t0, t1)
    if callback is not None:
        check_callable("callback", callback)
    limit = check_integer("max_steps", max_steps, minimum=1, maximum=2**63 - 1)
    count = 0 if threads is None else check_integer("threads", threads, minimum=1, maximum=1024)
    out = _core.solve_second_order(
        system=_as_system(acceleration, x.shape, args),
        method=name,
        t0=t0,
        t1=t1,
        x0=x,
        v0=v,
        step=check_real("step", step, positive=True),
        t_eval=times,
        max_steps=limit,
        threads=count,
        callback=callback,
    )
    return _result(out, name)


def _result(out: dict[str, Any], method: str) -> SecondOrderResult:
    status = out["status"]
    messages = {
        _DONE: "The solver successfully reached the end of the integration interval.",
        _STEP_UNDERFLOW: "step below spacing of t: t + step is t in floating-point numbers",
        _TOO_MANY_STEPS: f"max_steps: the end was not reached in {out['steps']} steps",
    }
    result = SecondOrderResult(
        t=out["t"],
        x=np.moveaxis(out["x"], 0, -1),
        v=np.moveaxis(out["v"], 0, -1),
        nfev=out["evaluations"],
        nsteps=out["steps"],
        status=0 if status == _DONE else -1,
        message=messages.get(status, out["failure"]),
    )
    if status == _NOT_FINITE:
        component = out["failure_component"]
        where = [int(i) for i in np.unravel_index(component, out["x"].shape[1:])]
        result.message = (
            f"{out['failure']} of {method} at t = {out['failure_time']!r}, component {where}, "
            f"step {out['steps']}; the last good time is {out['time']!r}"
        )
        raise NonFiniteError(
            result.message,
            time=out["failure_time"],
            index=component,
            step=out["steps"],
            result=result,
        )
    if result.status < 0:
        message = f"{result.message}; last t = {out['time']!r}"
        raise SolverError(message, time=out["time"], step=out["steps"], result=result)
    return result


def _check_times(t_eval: ArrayLike, t0: float, t1: float) -> NDArray[np.float64]:
    times = check_array("t_eval", t_eval, (None,))
    if times.size and (times.min() < min(t0, t1) or times.max() > max(t0, t1)):
        raise InputError(f"t_eval: expected times within t_span, {t0!r} to {t1!r}")
    if (np.diff(times) * (1 if t1 >= t0 else -1) <= 0).any():
        raise InputError("t_eval: expected times from the start to the end, each once")
    return times


def _as_system(acceleration: Any, shape: tuple[int, ...], args: Any) -> _core.System:
    components = int(np.prod(shape))
    native = getattr(acceleration, "native_system", acceleration)
    if isinstance(native, _core.System):
        if not native.second_order:
            raise InputError("acceleration: this system is not of second order; use solve_ivp")
        if args is not None:
            raise InputError("args: a compiled system takes its parameters when it is made")
        if native.size != 2 * components:
            raise InputError(f"x0: expected {native.size // 2} components, got {components}")
        return native
    address, user_data = find_address("acceleration", acceleration, ACCELERATION)
    if address is not None:
        numbers = user_data if args is None else check_array("args", args, (None,), finite=False)
        return _core.PointerAcceleration(address, components, numbers)
    check_callable("acceleration", acceleration)

    def convert(value: Any) -> NDArray[np.float64]:
        array = check_array("what acceleration returned", value, finite=False)
        if array.shape != shape:
            raise InputError(f"acceleration: expected an array of shape {shape}, got {array.shape}")
        return array

    return _core.PythonAcceleration(acceleration, shape, unpack_args(args), convert)
