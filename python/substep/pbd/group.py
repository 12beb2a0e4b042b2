"""What all constraints of position-based dynamics share: particles and how hard they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.attributes import Frozen
from ..base.checks import as_array, check_array, check_real, describe, first_bad_index, in_range
from ..base.rows import read_only
from ..errors import InputError

Array = NDArray[np.float64]


def check_particles(name: str, value: ArrayLike, columns: int) -> NDArray[np.int32]:
    """A copy of different indices of particles, `columns` for each; how large comes later."""
    array = as_array(name, value)
    if array.size == 0:
        return np.zeros((0, columns), np.int32)
    if array.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integers, got {describe(array)}")
    if array.ndim != 2 or array.shape[1] != columns:
        raise InputError(f"{name}: expected shape (n, {columns}), got {array.shape}")
    wrong = (array < 0) | (array > np.iinfo(np.int32).max)
    if wrong.any():
        index = first_bad_index(wrong)
        raise InputError(f"{name}{index}: expected an index, got {array[wrong].flat[0]}")
    ordered = np.sort(array, axis=1)
    repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if repeated.any():
        k = int(np.argmax(repeated))
        raise InputError(f"{name}[{k}]: expected different indices, got {array[k].tolist()}")
    indices: NDArray[np.int32] = read_only(np.array(array, np.int32, order="C"))
    return indices


def check_each(
    name: str, value: ArrayLike, count: int, *, low: float = 0.0, high: float = np.inf
) -> Array:
    """One number for all of `count` constraints (length 1) or one each, within bounds; a copy."""
    given = as_array(name, value)
    if given.ndim == 0:
        array = np.array([check_real(name, value)])
    else:
        array = check_array(name, given, (count,))
    wrong = (array < low) | (array > high)
    if wrong.any():
        bounds = f"at least {low:g}" if high == np.inf else f"from {low:g} to {high:g}"
        where = f"[{int(np.argmax(wrong))}]" if given.ndim else ""
        raise InputError(f"{name}{where}: expected a number {bounds}, got {array[wrong][0]}")
    numbers: Array = read_only(array)
    return numbers


@dataclass(frozen=True)
class Formula:
    """Constraints of one compiled formula."""

    kind: str
    parameters: Array
    compliance: Array
    damping: Array


class Constraint(Frozen):
    """A group of constraints of one kind.

    A subclass that is one of the compiled kinds sets `_kind` and calls `_set_up`; its
    `_parameters` may wait for the positions that the simulation starts with. Any other kind makes
    `_group` itself.
    """

    _kind: str = ""
    particles: NDArray[np.int32]
    compliance: Array
    damping: Array
    stiffness: Array | None

    def _set_up(
        self,
        name: str,
        particles: ArrayLike,
        compliance: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike | None,
    ) -> None:
        points = _core.constraint_kinds()[self._kind]["points"]
        self._name = name  # of the argument that holds the particles
        self.particles = check_particles(name, particles, points)
        self._set_softness(len(self.particles), compliance, damping, stiffness)

    def _set_softness(
        self,
        count: int,
        compliance: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike | None,
    ) -> None:
        self.compliance = check_each("compliance", compliance, count)
        self.damping = check_each("damping", damping, count)
        self.stiffness = None
        if stiffness is not None:
            if self.compliance.any() or self.damping.any():
                raise InputError("stiffness: plain PBD has neither compliance nor damping")
            self.stiffness = check_each("stiffness", stiffness, count, high=1.0)
        if self.damping.any() and not self.compliance.any():
            raise InputError("damping: expected a compliance above 0 with it")

    def __len__(self) -> int:
        return len(self.particles)

    def _parameters(self, positions: Array) -> Array:
        """Numbers of each constraint, shape (m, parameters)."""
        raise NotImplementedError

    def _formulas(self, positions: Array) -> list[Formula]:
        """What native groups are made of, with rest values of the initial positions."""
        return [Formula(self._kind, self._parameters(positions), self.compliance, self.damping)]

    def _finite_formulas(self, positions: Array) -> list[Formula]:
        name = "positions, or rest values of constraints"
        with in_range(name):
            formulas = self._formulas(positions)
        for f in formulas:
            _refuse_infinite(name, f.parameters, f.compliance, f.damping)
        return formulas

    def _groups(self, positions: Array) -> list[Any]:
        """Make the native groups."""
        self._check_count(len(positions))
        return [
            _core.ConstraintGroup(
                f.kind,
                self.particles,
                np.ascontiguousarray(f.parameters),
                f.compliance,
                f.damping,
                np.zeros(0) if self.stiffness is None else self.stiffness,
            )
            for f in self._finite_formulas(positions)
        ]

    def _check_count(self, count: int) -> None:
        wrong = (self.particles < 0) | (self.particles >= count)
        if wrong.any():
            raise InputError(
                f"{self._name}{first_bad_index(wrong)}: expected an index from 0 to "
                f"{count - 1}, got {self.particles[wrong][0]}"
            )

    def evaluate(self, positions: ArrayLike) -> tuple[Array, Array]:
        """Evaluate all constraints at positions of the particles.

        Parameters
        ----------
        positions : array_like, shape (n, 3)
            Of all particles [m]; rest values that were not given are those of these positions.

        Returns
        -------
        values : ndarray, shape (m,)
            C of each constraint.
        gradient : ndarray, shape (m, k, 3)
            Its gradient with respect to each of its particles; 0 where there is none.

        Raises
        ------
        InputError
            If `positions` is wrong or has too few rows, or constraints of this kind have no values
            of their own: `ShapeMatching` and collisions.
        """
        x = check_array("positions", positions, (None, 3))
        self._check_count(len(x))
        return self._evaluate(x)

    def _evaluate(self, x: Array) -> tuple[Array, Array]:
        if not self._kind:
            raise InputError(f"evaluate: {type(self).__name__} has no values of its own")
        parts = [
            _core.evaluate_constraints(
                f.kind, x[self.particles], np.ascontiguousarray(f.parameters)
            )
            for f in self._finite_formulas(x)
        ]
        values, gradients = (np.concatenate(part) for part in zip(*parts, strict=True))
        _refuse_infinite("positions", values, gradients)
        return values, gradients


def _refuse_infinite(name: str, *arrays: Array) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        raise InputError(f"{name}: values computed from them are not finite")
