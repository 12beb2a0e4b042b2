"""Constraints that are a function of the user's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base.checks import as_array, check_array, check_callable, check_flag
from ..base.pointers import find_address
from ..base.rows import read_only
from ..errors import InputError
from ..geometry.topology import Array
from .constraints import origin_of
from .group import Constraint, check_particles

SIGNATURE = "void(const double* x, double* c, double* gradient, double* p)"


class CustomConstraint(Constraint):
    """Constraints of one's own: a function that gives C and its gradient.

    A Python function is called with the positions of all constraints at once, and what it returns
    is projected in order: each constraint with its C moved along by its gradient for what the ones
    before it have moved. A compiled function is called for one constraint after the other, which
    is the usual Gauss-Seidel sweep, and without Python. A constraint whose gradient is 0 while C
    is not is skipped and counted.

    Parameters
    ----------
    particles : array_like of int, shape (m, k)
        The particles of each constraint.
    fun : callable or compiled function
        ``fun(x) -> (C, gradient)`` with x of shape (m, k, 3) [m], read-only, C of shape (m,) and
        gradient of shape (m, k, 3); or a function
        ``void(const double* x, double* c, double* gradient, double* p)`` of one constraint, as
        numba.cfunc, ctypes function or scipy.LowLevelCallable, with 3 k numbers at x and gradient.
        What a Python function raises passes unchanged, and the simulation is as before the step.
    parameters : array_like, shape (m, q), optional
        For compiled functions: a row of numbers for each constraint, to which p points.
    inequality : bool
        C >= 0 is satisfied: the constraint acts only while C < 0, and only pushes.
    check_gradient : bool
        Compare the gradient with central differences of C at the initial positions, and raise
        InputError if they differ; 6 k more calls, once.
    compliance : float or array_like, shape (m,)
        alpha [unit of C squared per J], at least 0.
    damping : float or array_like, shape (m,)
        beta, at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Macklin, Mueller and Chentanez, "XPBD: position-based simulation of compliant constrained
    dynamics", MIG 2016, eq. 18.

    Examples
    --------
    Beads on a circle of radius 1 m about the y axis.

    >>> import numpy as np, substep
    >>> def on_circle(x):
    ...     radius = np.hypot(x[:, 0, 0], x[:, 0, 2])
    ...     gradient = x / radius[:, None, None]
    ...     gradient[:, :, 1] = 0
    ...     return radius - 1, gradient
    >>> wire = substep.pbd.CustomConstraint([[0], [1]], on_circle, check_gradient=True)
    >>> beads = substep.PositionBasedDynamics([[1.0, 0, 0], [0.6, 0, -0.8]], 1.0, [wire])
    >>> beads.advance(0.5)
    >>> np.linalg.norm(beads.positions, axis=1).round(3).tolist()
    [1.0, 1.0]
    """

    def __init__(
        self,
        particles: ArrayLike,
        fun: Any,
        *,
        parameters: ArrayLike | None = None,
        inequality: bool = False,
        check_gradient: bool = False,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        shape = as_array("particles", particles).shape
        if len(shape) != 2 or shape[1] == 0:
            raise InputError(f"particles: expected shape (m, k), got {shape}")
        self._name = "particles"
        self.particles = check_particles("particles", particles, shape[1])
        self._set_softness(len(self.particles), compliance, damping, stiffness)
        self.fun = fun
        self.inequality = check_flag("inequality", inequality)
        self.check_gradient = check_flag("check_gradient", check_gradient)
        self._address, _ = find_address("fun", fun, SIGNATURE)
        if self._address is None:
            check_callable("fun", fun)
            if parameters is not None:
                raise InputError("parameters: only a compiled function takes them")
        self.parameters: Array = np.zeros((len(self), 0))
        if parameters is not None:
            own = check_array("parameters", parameters, (len(self), None))
            self.parameters = read_only(own)

    def _evaluate(self, positions: Array) -> tuple[Array, Array]:
        return self._call(positions[self.particles])

    def _call(self, x: Array) -> tuple[Array, Array]:
        if self._address is not None:
            found: tuple[Array, Array] = _core.call_constraint(self._address, self.parameters, x)
            return found
        return checked(self.fun)(x)

    def _groups(self, positions: Array) -> list[Any]:
        self._check_count(len(positions))
        if self.check_gradient:
            self._compare_gradient(positions[self.particles])
        m = len(self)
        return [
            _core.user_constraints(
                self.fun if self._address is not None else checked(self.fun),
                self._address,
                self.parameters,
                self.particles,
                origin_of(positions),
                np.array(np.broadcast_to(self.compliance, m)),
                np.array(np.broadcast_to(self.damping, m)),
                np.array(np.broadcast_to(1.0 if self.stiffness is None else self.stiffness, m)),
                self.inequality,
            )
        ]

    def _compare_gradient(self, x: Array) -> None:
        """Central differences; where C has no gradient, it must be 0."""
        _, gradient = self._call(x)
        size = np.abs(x - x.mean(axis=1, keepdims=True)).max() + 1e-3 * np.abs(x).max()
        h = 1e-6 * (size if size > 0 else 1.0)
        for i, axis in np.ndindex(gradient.shape[1:]):
            shift = np.zeros(x.shape)
            shift[:, i, axis] = h
            slope = (self._call(x + shift)[0] - self._call(x - shift)[0]) / (2 * h)
            limit = 1e-4 * (np.abs(gradient).max(axis=(1, 2)) + np.abs(slope))
            wrong = (np.abs(slope - gradient[:, i, axis]) > limit) & gradient.any(axis=(1, 2))
            if wrong.any():
                j = int(np.argmax(wrong))
                raise InputError(
                    f"fun: gradient[{j}, {i}, {axis}] is {gradient[j, i, axis]:g}, but differences "
                    f"of C give {slope[j]:g}"
                )


def checked(fun: Callable[[Array], Any]) -> Callable[[Array], tuple[Array, Array]]:
    """The function with read-only positions, and its answer checked."""

    def call(x: Array) -> tuple[Array, Array]:
        x.flags.writeable = False
        answer = fun(x)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise InputError(f"fun: expected a pair (C, gradient), got {type(answer).__name__}")
        values = check_array("fun: C", answer[0], x.shape[:1], finite=False)
        gradient = check_array("fun: gradient", answer[1], x.shape, finite=False)
        return values, gradient

    return call
