"""Initial value problems y' = f(t, y): explicit and implicit methods with one entry point."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base.checks import (
    check_array,
    check_callable,
    check_choice,
    check_flag,
    check_integer,
    check_real,
)
from ..base.pictured import Pictured
from ..errors import InputError, SolverError
from .events import EventLog
from .jacobian import check_consistent, make_jacobian, make_mass
from .rhs import make_system, unpack_args

MESSAGES = {
    0: "The solver successfully reached the end of the integration interval.",
    1: "A termination event occurred.",
}
SMALLEST_RTOL = 100 * float(np.finfo(float).eps)


def methods() -> list[str]:
    """List the names that `method` of `solve_ivp` takes.

    Returns
    -------
    list of str
        The explicit ones in rising order of accuracy, then the implicit ones.

    Examples
    --------
    >>> import substep
    >>> [name for name in substep.ode.methods() if name.startswith("RK")]
    ['RK45', 'RKC2']
    """
    return _core.ode_methods()


class OdeResult(dict, Pictured):  # type: ignore[type-arg]
    """What `solve_ivp` returns: a dictionary whose entries are attributes too.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Times.
    y : ndarray, shape (n, m)
        States at `t`.
    sol : OdeSolution or None
        The solution as a function of time, with ``dense_output=True``.
    t_events, y_events : list of ndarray, or None
        Times, shape (k,), and states, shape (k, n), of each event.
    nfev, njev, nlu : int
        Evaluations of f and of its Jacobian, and LU decompositions.
    status : int
        0: the end was reached; 1: a terminal event; -1: failure (in an exception's `result`).
    message : str
        The same in words.
    success : bool
        Whether `status` is at least 0.

    Examples
    --------
    >>> import substep
    >>> result = substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], "rk4", step=0.5)
    >>> result.t, result["status"]
    (array([0. , 0.5, 1. ]), 0)
    """

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None

    def __setattr__(self, name: str, value: Any) -> None:
        self[name] = value

    def __dir__(self) -> Iterator[str]:
        return iter(sorted([*super().__dir__(), *self]))

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        return "\n".join(f"{name:>{width}}: {value!r}" for name, value in self.items())


class OdeSolution:
    """A solution as a function of time, made of one polynomial per step.

    At the end of a step that step's polynomial counts; outside `t_min` and `t_max` the outer
    polynomials are continued, without a promise of accuracy.

    Parameters
    ----------
    dense : _core.DenseSolution or ndarray
        The polynomials; an array, shape (n,), where no step was made.
    ts : ndarray, shape (steps + 1,)
        Where the steps begin and end.

    Attributes
    ----------
    ts : ndarray, shape (steps + 1,)
        Where the steps begin and end.
    t_min, t_max : float
        The range in time.

    Examples
    --------
    >>> import substep
    >>> result = substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], "DOP853", dense_output=True,
    ...                            rtol=1e-9, atol=1e-9)
    >>> result.sol([0.25, 0.5]).round(6)
    array([[0.778801, 0.606531]])
    """

    def __init__(self, dense: Any, ts: np.ndarray[Any, Any]) -> None:
        self._dense = dense
        self.ts = ts
        self.t_min = float(min(ts[0], ts[-1]))
        self.t_max = float(max(ts[0], ts[-1]))

    def __call__(self, t: ArrayLike) -> np.ndarray[Any, Any]:
        """Evaluate at one or many times.

        Parameters
        ----------
        t : float or array_like, shape (m,)
            Times.

        Returns
        -------
        ndarray, shape (n,) or (n, m)
            States.
        """
        times = check_array("t", t, finite=False)
        if times.ndim > 1:
            raise InputError(f"t: expected a number or shape (n,), got {times.shape}")
        flat = np.atleast_1d(times)
        if isinstance(self._dense, np.ndarray):
            states = np.repeat(self._dense[:, None], flat.size, axis=1)
        else:
            states = self._dense.evaluate(flat)
        return states[:, 0] if times.ndim == 0 else states


def solve_ivp(
    fun: Any,
    t_span: ArrayLike,
    y0: ArrayLike,
    method: Any = "RK45",
    t_eval: ArrayLike | None = None,
    dense_output: bool = False,
    events: Any = None,
    vectorized: bool = False,
    args: Any = None,
    *,
    step: float | None = None,
    rtol: ArrayLike = 1e-3,
    atol: ArrayLike = 1e-6,
    first_step: float | None = None,
    max_step: float = np.inf,
    local_extrapolation: bool = True,
    max_steps: int = 10_000_000,
    event_samples: int = 4,
    callback: Callable[[float, np.ndarray[Any, Any]], Any] | None = None,
    threads: int | None = None,
    spectral_radius: float | Callable[[float, np.ndarray[Any, Any]], float] | None = None,
    jac: Any = None,
    jac_sparsity: Any = None,
    mass: Any = None,
    linear_solver: str = "auto",
    check_jacobian: bool = False,
) -> OdeResult:
    """Solve y' = f(t, y), y(t0) = y0, or M y' = f(t, y) by an implicit method.

    Takes the arguments of `scipy.integrate.solve_ivp` and returns the same fields. Failures raise;
    the exception's `result` holds the part solved.

    Parameters
    ----------
    fun : callable, compiled function or system
        f as ``fun(t, y)`` that returns shape (n,); y is read-only and good for this call (keep a
        copy, or keep y itself: the next call then gets another array). Or, to run without the
        interpreter: a `numba.cfunc`, a `scipy.LowLevelCallable` or a ctypes function
        ``void(double t, double* y, double* dydt, double* p)``, or a system of `substep.systems`.
    t_span : tuple of two floats
        Start and end; the end may be the earlier one.
    y0 : array_like, shape (n,)
        Initial state, real or complex.
    method : str
        'euler', 'midpoint', 'heun', 'rk4' (orders 1, 2, 2, 4), 'RK45' (Dormand and Prince 5(4)) or
        'DOP853'; for stiff problems 'implicit_euler' (order 1), 'Radau' (Radau IIA of order 5) or,
        for diffusion, 'RKC2' (stabilised explicit, order 2). Upper or lower case.
    t_eval : array_like, shape (m,), optional
        Times to return, within `t_span` and in its direction; without it every step is returned.
    dense_output : bool
        Return the solution as a function of time too.
    events : callable or list of callables, optional
        Functions ``event(t, y)`` whose zeros are found; their attributes `terminal` (True, or the
        number of zeros after which to stop) and `direction` (sign of the crossing) are heeded.
    vectorized : bool
        `fun` takes and returns columns, shape (n, k).
    args : tuple, optional
        Further arguments of `fun` and of the events; for a compiled function the numbers that p
        points to.
    step : float, optional
        Fixes the step; the last one is shortened to end at the end. Without it the step adapts:
        'RK45' and 'DOP853' by their own error estimates, the others by step doubling.
    rtol, atol : float or array_like, shape (n,)
        The RMS norm of error / (atol + rtol |y|) is kept below 1 in each step.
    first_step : float, optional
        Length of the first step.
    max_step : float
        Greatest length of a step.
    local_extrapolation : bool
        Whether step doubling of 'euler', 'midpoint', 'heun' and 'rk4' adds the estimated error to
        the result, which is then of one order more. False keeps the finer result as it is.
    max_steps : int
        Number of steps after which `SolverError` is raised.
    event_samples : int
        Points per step at which the sign of an event is tested, the step's end among them; SciPy
        tests at 1.
    callback : callable, optional
        ``callback(t, y)`` is called after every step.
    threads : int, optional
        For systems with many components; results do not depend on it.
    spectral_radius : float or callable, optional
        For 'RKC2': an upper bound of the greatest |eigenvalue| of df/dy [1/s], or a function
        (t, y) of it. By default the system's own, or else estimated by a power method.
    jac : array_like, sparse matrix, callable or compiled function, optional
        df/dy of shape (n, n), for implicit methods: constant, or as ``jac(t, y)`` that returns an
        array or a sparse matrix, or compiled with the signature of `fun`: it writes
        ``J[i * n + j]``, or the nonzeros of `jac_sparsity` column by column. Without it the
        system's own is used, else finite differences.
    jac_sparsity : array_like or sparse matrix, shape (n, n), optional
        Nonzero where df/dy may be. Finite differences then take as many evaluations as there are
        groups of columns that share no row, and the linear systems are solved sparse.
    mass : array_like or sparse matrix, shape (n, n) or (n,), optional
        M, constant. It may be singular: a differential-algebraic system of index 1, whose
        algebraic equations y0 must satisfy.
    linear_solver : {'auto', 'direct', 'krylov'}
        LU decompositions, or BiCGSTAB on products with df/dy, preconditioned by its diagonal
        blocks. 'auto' begins with the latter where df/dy is sparse and its decomposition dear, as
        on grids of two and three dimensions, and goes over to the former where that is quicker.
    check_jacobian : bool
        Compare `jac` with finite differences at the start.

    Returns
    -------
    OdeResult
        With t, y, sol, t_events, y_events, nfev, njev, nlu, status, message, success.

    Raises
    ------
    InputError
        An argument, or what `fun` returned, is wrong.
    NonFiniteError
        `fun` returned NaN or infinity, whatever the step; the error has time and component.
    SolverError
        The step fell below the spacing of t (a singularity, or tolerances out of reach), or
        `max_steps` were not enough.
    ConvergenceError
        Newton's iteration of an implicit method failed however short the step was made.
    SingularMatrixError
        So did its linear systems; `index` is the row.

    References
    ----------
    .. [1] E. Hairer, S. P. Norsett, G. Wanner, "Solving Ordinary Differential Equations I:
       Nonstiff Problems", 2nd ed., Springer, 1993, sections II.1, II.4, II.5, II.6, II.10.
    .. [2] J. R. Dormand, P. J. Prince, "A family of embedded Runge-Kutta formulae", J. Comput.
       Appl. Math. 6 (1980), 19-26.
    .. [3] B. P. Sommeijer, L. F. Shampine, J. G. Verwer, "RKC: an explicit solver for parabolic
       PDEs", J. Comput. Appl. Math. 88 (1998), 315-326.
    .. [4] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II: Stiff and
       Differential-Algebraic Problems", 2nd ed., Springer, 1996, sections IV.8 and VI.1.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> result = substep.solve_ivp(lambda t, y: [y[1], -y[0]], (0, 3), [1, 0], rtol=1e-8, atol=1e-8)
    >>> result.y[:, -1].round(6)
    array([-0.989992, -0.14112 ])
    >>> substep.solve_ivp(substep.systems.Lorenz(), (0, 1), [1, 1, 1], "rk4", t_eval=[1.0],
    ...                   step=1e-3).y.ravel().round(5)
    array([-9.37857, -8.35703, 29.36233])
    >>> stiff = substep.solve_ivp(lambda t, y: -1e6 * (y - np.cos(t)), (0, 3), [0.0], "Radau")
    >>> stiff.y[0, -1].round(4), stiff.t.size < 100
    (np.float64(-0.99), True)
    """
    name = _method_name(method)
    t0, t_bound = _check_span(t_span)
    y = check_array("y0", y0, (None,), complex_ok=True)
    times = _check_t_eval(t_eval, t0, t_bound)
    control = check_control(step, rtol, atol, first_step, max_step, y.size, abs(t_bound - t0))
    control |= check_extrapolation(name, local_extrapolation)
    limit = check_integer("max_steps", max_steps, minimum=1)
    dense = check_flag("dense_output", dense_output)
    log = None
    if events is not None:
        samples = check_integer("event_samples", event_samples, minimum=1)
        log = EventLog(events, unpack_args(args), samples)
    if callback is not None:
        check_callable("callback", callback)
    columns = check_flag("vectorized", vectorized)
    system = make_system(fun, y.size, complex_y=y.dtype.kind == "c", args=args, vectorized=columns)
    if log is not None:
        log.start(t0, y.copy())
    if y.size == 0 or t0 == t_bound:
        return _nothing_to_do(t0, t_bound, y, times, dense, log)
    implicit = _implicit_options(
        name, jac, jac_sparsity, mass, linear_solver, check_jacobian, system, t0, y, args, control
    )
    integration = _core.Integration(
        system=system,
        method=name,
        t=t0,
        t_bound=t_bound,
        y0=y,
        threads=0 if threads is None else check_integer("threads", threads, minimum=1),
        every_step=times is None,
        t_eval=[] if times is None else times.tolist(),
        dense=dense,
        interpolate=log is not None,
        spectral_radius=_check_spectral_radius(spectral_radius, name),
        **implicit,
        **control,
    )
    end = None
    try:
        if log is None and callback is None:
            integration.run(limit)
        else:
            end = _run_step_by_step(integration, limit, log, callback)
        if end is None and not integration.finished:
            raise SolverError(
                f"max_steps: {limit} steps were not enough; they came to t = {integration.t}",
                time=integration.t,
                step=limit,
            )
    except SolverError as error:
        error.result = _result(integration, -1, str(error), log, None, times is None, dense)
        raise
    except OverflowError as error:
        *_, (frame, _) = traceback.walk_tb(error.__traceback__)
        if frame.f_globals is not globals():  # fun, or another callable, raised it
            raise
        raise InputError(f"fun: expected numbers that float64 can hold; {error}") from error
    status = 0 if end is None else 1
    return _result(integration, status, MESSAGES[status], log, end, times is None, dense)


def _method_name(method: Any) -> str:
    """The name as listed; our classes for SciPy carry theirs."""
    return check_choice("method", getattr(method, "method_name", method), methods())


def _check_span(t_span: Any) -> tuple[float, float]:
    if type(t_span) is tuple and len(t_span) == 2:
        start, end = t_span
        if type(start) in (int, float) and type(end) in (int, float):
            if -1e300 < start < 1e300 and -1e300 < end < 1e300:
                return float(start), float(end)  # the usual case, quickly
    start, end = check_array("t_span", t_span, (2,)).tolist()
    check_real("t_span", end - start)
    return start, end


def _check_t_eval(t_eval: Any, t0: float, t_bound: float) -> np.ndarray[Any, Any] | None:
    if t_eval is None:
        return None
    times = check_array("t_eval", t_eval, (None,))
    if np.any(times < min(t0, t_bound)) or np.any(times > max(t0, t_bound)):
        raise InputError(f"t_eval: expected times within t_span ({t0}, {t_bound})")
    forward = times if t_bound >= t0 else -times
    if np.any(forward[1:] <= forward[:-1]):
        raise InputError("t_eval: expected times in the order of t_span, without repetition")
    return times


def _check_tolerance(name: str, value: Any, size: int) -> list[float]:
    if isinstance(value, float) and SMALLEST_RTOL <= value < np.inf:
        return [value]  # the usual case, quickly
    array = check_array(name, value, finite=False)
    if array.ndim and array.shape != (size,):
        raise InputError(f"{name}: expected a number or shape ({size},), got {array.shape}")
    least = SMALLEST_RTOL if name == "rtol" else 0.0
    if not np.all((array >= least) & np.isfinite(array)):
        raise InputError(f"{name}: expected finite numbers of at least {least:.3g}, got {value}")
    return list(np.atleast_1d(array).tolist())


def check_control(
    step: Any, rtol: Any, atol: Any, first_step: Any, max_step: Any, size: int, span: float
) -> dict[str, Any]:
    """How steps are chosen, for the native core."""
    max_step = check_real("max_step", max_step, positive=True, finite=False)
    if step is not None and (first_step is not None or max_step != np.inf):
        raise InputError("step: fixes the step, so first_step and max_step have no meaning")
    if first_step is not None:
        first_step = check_real("first_step", first_step, positive=True)
        if first_step > span:
            raise InputError(f"first_step: {first_step} is longer than t_span, {span}")
    return {
        "step": 0.0 if step is None else check_real("step", step, positive=True),
        "rtol": _check_tolerance("rtol", rtol, size),
        "atol": _check_tolerance("atol", atol, size),
        "first_step": 0.0 if first_step is None else first_step,
        "max_step": max_step,
    }


def check_extrapolation(method: str, local_extrapolation: Any) -> dict[str, bool]:
    """Whether step doubling adds its estimate, for the native core."""
    wanted = check_flag("local_extrapolation", local_extrapolation)
    if not wanted:
        properties = _core.ode_method(method)
        if not properties["doubling"] or properties["family"] != "explicit":
            raise InputError(
                "local_extrapolation: only explicit methods with step doubling can do without it, "
                f"the method is {method}"
            )
    return {"local_extrapolation": wanted}


def _check_spectral_radius(value: Any, method: str) -> Any:
    """None, a float or a callable, as the core takes it."""
    if value is None:
        return None
    if method != "RKC2":
        raise InputError(f"spectral_radius: only RKC2 uses it, the method is {method}")
    if not callable(value):
        return check_real("spectral_radius", value, nonnegative=True)

    def bound(t: float, y: np.ndarray[Any, Any]) -> float:
        return check_real("spectral_radius", value(t, y), nonnegative=True)

    return bound


def _implicit_options(
    method: str,
    jac: Any,
    jac_sparsity: Any,
    mass: Any,
    linear_solver: Any,
    check_jacobian: Any,
    system: _core.System,
    t0: float,
    y0: np.ndarray[Any, Any],
    args: Any,
    control: dict[str, Any],
) -> dict[str, Any]:
    """What an implicit method is told; nothing may be given to the others."""
    solver = check_choice("linear_solver", linear_solver, ("auto", "direct", "krylov"))
    compared = check_flag("check_jacobian", check_jacobian)
    if _core.ode_method(method)["family"] != "implicit":
        given = {
            "jac": jac is not None,
            "jac_sparsity": jac_sparsity is not None,
            "mass": mass is not None,
            "linear_solver": solver != "auto",
            "check_jacobian": compared,
        }
        for name, present in given.items():
            if present:
                raise InputError(
                    f"{name}: has no meaning for {method!r}; implicit methods take it, as 'Radau'"
                )
        return {}
    native_mass = make_mass(mass, y0.size, y0.dtype.kind == "c")
    if mass is not None:
        check_consistent(mass, system, t0, y0, control["rtol"], control["atol"])
    return {
        "jacobian": make_jacobian(jac, jac_sparsity, system, t0, y0, args, check=compared),
        "mass": native_mass,
        "linear_solver": solver,
    }


def _run_step_by_step(
    integration: _core.Integration,
    limit: int,
    log: EventLog | None,
    callback: Callable[[float, np.ndarray[Any, Any]], Any] | None,
) -> tuple[float, Any] | None:
    """Steps with events and callback; time and state of a terminal event, else None."""

    def at(t: Any) -> Any:
        states = integration.interpolate(np.atleast_1d(t))
        return states if np.ndim(t) else states[:, 0]

    for _ in range(limit):
        integration.run(1)
        end = None
        if log is not None:
            end = log.step(integration.t_old, integration.t, integration.y, at)
        if callback is not None:
            callback(*((integration.t, integration.y) if end is None else end))
        if end is not None or integration.finished:
            return end
    return None


def _result(
    integration: _core.Integration,
    status: int,
    message: str,
    log: EventLog | None,
    end: tuple[float, Any] | None,
    every_step: bool,
    dense_output: bool,
) -> OdeResult:
    if end is not None:
        integration.truncate(end[0])
    t, y = integration.take_times(), integration.take_states()
    if end is not None and every_step and t[-1] != end[0]:
        t, y = np.append(t, end[0]), np.vstack([y, end[1]])
    sol = None
    if dense_output:
        dense = integration.take_dense()
        sol = OdeSolution(dense if dense.times.size > 1 else integration.y, dense.times)
    counts = (integration.evaluations, integration.jacobians, integration.factorizations)
    return _make_result(t, y.T, sol, log, counts, status, message)


def _make_result(
    t: Any,
    y: Any,
    sol: Any,
    log: EventLog | None,
    counts: tuple[int, int, int],
    status: int,
    message: str,
) -> OdeResult:
    t_events, y_events = (None, None) if log is None else log.results()
    return OdeResult(
        t=t,
        y=y,
        sol=sol,
        t_events=t_events,
        y_events=y_events,
        nfev=counts[0],
        njev=counts[1],
        nlu=counts[2],
        status=status,
        message=message,
        success=status >= 0,
    )


def _nothing_to_do(
    t0: float, t_bound: float, y: Any, times: Any, dense_output: bool, log: EventLog | None
) -> OdeResult:
    """No components, or no time between start and end."""
    if times is None:
        times = np.array([t0] if t0 == t_bound else [t0, t_bound])
    states = np.repeat(y[:, None], times.size, axis=1)
    sol = OdeSolution(y, np.array([t0, t_bound])) if dense_output else None
    return _make_result(times, states, sol, log, (0, 0, 0), 0, MESSAGES[0])
