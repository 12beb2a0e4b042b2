"""Our methods as classes for ``scipy.integrate.solve_ivp(..., method=substep.RK45)``.

`substep.RK45` and the others import this module when first asked for, so that SciPy is needed by
those only who use them.
"""

from __future__ import annotations

import weakref
from typing import Any, ClassVar

import numpy as np

from .. import _core
from ..base.checks import check_array, check_flag, check_real
from ..base.imports import needs
from ..errors import InputError, SolverError
from .ivp import check_control, check_extrapolation
from .jacobian import make_jacobian
from .rhs import make_system

with needs("scipy", "the solver classes need SciPy: pip install scipy"):
    from scipy.integrate import DenseOutput, OdeSolver
    from scipy.integrate._ivp.common import validate_tol, warn_extraneous

__all__ = [
    "DOP853",
    "RK4",
    "RK45",
    "Euler",
    "Heun",
    "ImplicitEuler",
    "Midpoint",
    "Radau",
]


def __dir__() -> list[str]:
    return __all__


class StepPolynomial(DenseOutput):
    """The polynomial over one step."""

    def __init__(self, dense: _core.DenseSolution, t_old: float, t: float) -> None:
        super().__init__(t_old, t)
        self._dense = dense

    def _call_impl(self, t: Any) -> Any:
        states = self._dense.evaluate(np.atleast_1d(t))
        return states[:, 0] if t.ndim == 0 else states


class ExplicitSolver(OdeSolver):
    """Explicit Runge-Kutta solver with SciPy's `OdeSolver` interface.

    Parameters
    ----------
    fun : callable
        ``fun(t, y)``.
    t0, t_bound : float
        Start and end.
    y0 : array_like, shape (n,)
        Initial state, real or complex.
    max_step, rtol, atol, vectorized, first_step
        As in `scipy.integrate.RK45`.
    step : float, optional
        Fixes the step.
    local_extrapolation : bool
        As in `substep.solve_ivp`.
    **extraneous
        Options without effect; they are warned of.

    Examples
    --------
    >>> import scipy.integrate, substep
    >>> scipy.integrate.solve_ivp(lambda t, y: -y, (0, 1), [1.0], method=substep.RK4,
    ...                           step=0.25).t
    array([0.  , 0.25, 0.5 , 0.75, 1.  ])
    """

    method_name: ClassVar[str]
    order: ClassVar[int]
    error_estimator_order: ClassVar[int]
    n_stages: ClassVar[int]
    t: float
    y: Any

    def __init_subclass__(cls, *, method: str = "") -> None:
        if not method:
            return
        cls.method_name, properties = method, _core.ode_method(method)
        cls.order, cls.error_estimator_order = properties["order"], properties["error_order"]
        cls.n_stages = _core.tableau(method)["stages"]
        # What it is, in its own words, then what all of them take.
        _, _, shared = (cls.__base__.__doc__ or "").partition("\n\n")
        cls.__doc__ = f"{cls.__doc__}\n\n{shared}"

    def __init__(
        self,
        fun: Any,
        t0: float,
        y0: Any,
        t_bound: float,
        max_step: float = np.inf,
        rtol: Any = 1e-3,
        atol: Any = 1e-6,
        vectorized: bool = False,
        first_step: float | None = None,
        step: float | None = None,
        local_extrapolation: bool = True,
        **extraneous: Any,
    ) -> None:
        warn_extraneous(extraneous)
        t0, t_bound = check_real("t0", t0), check_real("t_bound", t_bound, finite=False)
        y0 = check_array("y0", y0, complex_ok=True, finite=False)
        rtol = check_array("rtol", rtol)
        if (rtol > 0).all():  # SciPy warns of what is too small, and takes more
            rtol, _ = validate_tol(rtol, 0.0, y0.size)
        vectorized = check_flag("vectorized", vectorized)
        control = check_control(step, rtol, atol, first_step, max_step, y0.size, abs(t_bound - t0))
        control |= check_extrapolation(self.method_name, local_extrapolation)
        try:
            super().__init__(fun, t0, y0, t_bound, vectorized, support_complex=True)
        except ValueError as error:  # SciPy's own name the argument too
            raise InputError(str(error)) from None
        self.max_step = control["max_step"]
        self.rtol, self.atol = np.squeeze(control["rtol"]), np.squeeze(control["atol"])
        if self.n == 0 or t0 == t_bound:
            return
        # self.fun counts the evaluations, as SciPy's classes do. The native side must not keep the
        # solver alive, which keeps that: no collector sees such a circle.
        own = weakref.proxy(self)
        system = make_system(
            lambda t, y: own.fun(t, y),
            self.n,
            complex_y=self.y.dtype.kind == "c",
            args=None,
            vectorized=False,
        )
        y = np.ascontiguousarray(self.y)
        self._integration = _core.Integration(
            system=system,
            method=self.method_name,
            t=float(t0),
            t_bound=float(t_bound),
            y0=y,
            threads=0,
            every_step=False,
            t_eval=[],
            dense=False,
            interpolate=True,
            jacobian=self._jacobian(system, t0, y),
            **control,
        )
        self._integration.start()

    def _jacobian(self, system: _core.System, t0: float, y: Any) -> _core.Jacobian | None:
        return None

    def _step_impl(self) -> tuple[bool, str | None]:
        try:
            if self._integration.t == self.t:  # else it is ahead of a call that was broken off
                self._integration.run(1)
        except SolverError as error:
            return False, f"{self.TOO_SMALL_STEP} {error}"
        self.t, self.y = self._integration.t, self._integration.y
        self.njev = self._integration.jacobians
        self.nlu = self._integration.factorizations
        return True, None

    def _dense_output_impl(self) -> StepPolynomial:
        return StepPolynomial(self._integration.step_dense(), self.t_old, self.t)


class ImplicitSolver(ExplicitSolver):
    """Implicit Runge-Kutta solver with SciPy's `OdeSolver` interface.

    Parameters
    ----------
    fun : callable
        ``fun(t, y)``.
    t0, t_bound : float
        Start and end.
    y0 : array_like, shape (n,)
        Initial state, real or complex.
    max_step, rtol, atol, jac, jac_sparsity, vectorized, first_step
        As in `scipy.integrate.Radau`.
    step : float, optional
        Fixes the step.
    **extraneous
        Options without effect; they are warned of.

    Examples
    --------
    >>> import scipy.integrate, substep
    >>> scipy.integrate.solve_ivp(lambda t, y: -1e4 * y, (0, 1), [1.0], method=substep.Radau,
    ...                           jac=[[-1e4]]).success
    True
    """

    def __init__(
        self,
        fun: Any,
        t0: float,
        y0: Any,
        t_bound: float,
        max_step: float = np.inf,
        rtol: Any = 1e-3,
        atol: Any = 1e-6,
        jac: Any = None,
        jac_sparsity: Any = None,
        vectorized: bool = False,
        first_step: float | None = None,
        step: float | None = None,
        **extraneous: Any,
    ) -> None:
        self._given = jac, jac_sparsity
        super().__init__(
            fun,
            t0,
            y0,
            t_bound,
            max_step,
            rtol,
            atol,
            vectorized,
            first_step,
            step,
            **extraneous,
        )

    def _jacobian(self, system: _core.System, t0: float, y: Any) -> _core.Jacobian | None:
        jac, jac_sparsity = self._given
        return make_jacobian(jac, jac_sparsity, system, t0, y, None, check=False)


class Euler(ExplicitSolver, method="euler"):
    """Euler's method, of order 1, with SciPy's `OdeSolver` interface."""


class Midpoint(ExplicitSolver, method="midpoint"):
    """The midpoint method, of order 2, with SciPy's `OdeSolver` interface."""


class Heun(ExplicitSolver, method="heun"):
    """Heun's method, of order 2, with SciPy's `OdeSolver` interface."""


class RK4(ExplicitSolver, method="rk4"):
    """The classical method of order 4, with SciPy's `OdeSolver` interface."""


class RK45(ExplicitSolver, method="RK45"):
    """The method of order 5(4) of Dormand and Prince, with SciPy's `OdeSolver` interface."""


class DOP853(ExplicitSolver, method="DOP853"):
    """The method of order 8 of Dormand and Prince, with SciPy's `OdeSolver` interface."""


class ImplicitEuler(ImplicitSolver, method="implicit_euler"):
    """The implicit Euler method, of order 1, with SciPy's `OdeSolver` interface."""


class Radau(ImplicitSolver, method="Radau"):
    """Radau IIA, of order 5, with SciPy's `OdeSolver` interface."""


METHOD_OF_CLASS = {
    solver.__name__: solver.method_name
    for solver in (*ExplicitSolver.__subclasses__(), *ImplicitSolver.__subclasses__())
    if hasattr(solver, "method_name")
}
