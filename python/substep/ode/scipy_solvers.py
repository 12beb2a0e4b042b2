"""Our methods as classes for ``scipy.integrate.solve_ivp(..., method=substep.RK45)``.

They are made when first asked for, so that SciPy is needed by those only who use them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _core
from ..errors import SolverError
from .jacobian import make_jacobian
from .rhs import make_system


def _class_name(method: str) -> str:
    """'rk4' -> 'RK4', 'implicit_euler' -> 'ImplicitEuler'; names with capitals stay."""
    words = method.split("_")
    return "".join(w.upper() if w.startswith("rk") else w[0].upper() + w[1:] for w in words)


METHOD_OF_CLASS = {
    _class_name(name): name
    for name in _core.ode_methods()
    if _core.ode_method(name)["family"] != "stabilized"
}
_classes: dict[str, type] = {}


def __getattr__(name: str) -> Any:
    if name not in METHOD_OF_CLASS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if not _classes:
        _make_classes()
    return _classes[name]


def _make_classes() -> None:
    try:
        from scipy.integrate import DenseOutput, OdeSolver
        from scipy.integrate._ivp.common import (
            validate_first_step,
            validate_max_step,
            validate_tol,
            warn_extraneous,
        )
    except ImportError:
        raise ImportError("the solver classes need SciPy: pip install scipy") from None

    class StepPolynomial(DenseOutput):  # type: ignore[misc]
        """The polynomial over one step."""

        def __init__(self, dense: _core.DenseSolution, t_old: float, t: float) -> None:
            super().__init__(t_old, t)
            self._dense = dense

        def _call_impl(self, t: Any) -> Any:
            states = self._dense.evaluate(np.atleast_1d(t))
            return states[:, 0] if t.ndim == 0 else states

    class ExplicitSolver(OdeSolver):  # type: ignore[misc]
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
        **extraneous
            Options without effect; they are warned of.

        Examples
        --------
        >>> import scipy.integrate, substep
        >>> scipy.integrate.solve_ivp(lambda t, y: -y, (0, 1), [1.0], method=substep.RK4,
        ...                           step=0.25).t
        array([0.  , 0.25, 0.5 , 0.75, 1.  ])
        """

        method_name = ""
        y: Any

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
            **extraneous: Any,
        ) -> None:
            warn_extraneous(extraneous)
            super().__init__(fun, t0, y0, t_bound, vectorized, support_complex=True)
            self.max_step = validate_max_step(max_step)
            self.rtol, self.atol = validate_tol(rtol, atol, self.n)
            if first_step is not None:
                validate_first_step(first_step, t0, t_bound)
            if self.n == 0 or t0 == t_bound:
                return
            # self.fun counts the evaluations, as SciPy's classes do.
            system = make_system(
                self.fun, self.n, complex_y=self.y.dtype.kind == "c", args=None, vectorized=False
            )
            y = np.ascontiguousarray(self.y)
            self._integration = _core.Integration(
                system=system,
                method=self.method_name,
                t=float(t0),
                t_bound=float(t_bound),
                y0=y,
                step=0.0 if step is None else float(step),
                rtol=np.atleast_1d(self.rtol).tolist(),
                atol=np.atleast_1d(self.atol).tolist(),
                first_step=0.0 if first_step is None else float(first_step),
                max_step=float(max_step),
                threads=0,
                every_step=False,
                t_eval=[],
                dense=False,
                interpolate=True,
                jacobian=self._jacobian(system, t0, y),
            )
            self._integration.start()

        def _jacobian(self, system: _core.System, t0: float, y: Any) -> _core.Jacobian | None:
            return None

        def _step_impl(self) -> tuple[bool, str | None]:
            try:
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

    for name, method in METHOD_OF_CLASS.items():
        table, properties = _core.tableau(method), _core.ode_method(method)
        base = ImplicitSolver if properties["family"] == "implicit" else ExplicitSolver
        _classes[name] = type(
            name,
            (base,),
            {
                "__module__": "substep",
                "__doc__": base.__doc__,
                "method_name": method,
                "order": properties["order"],
                "error_estimator_order": properties["error_order"],
                "n_stages": table["stages"],
            },
        )
