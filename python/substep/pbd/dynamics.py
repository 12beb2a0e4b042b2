"""Position-based dynamics: ropes, cloth and soft bodies as constraints on positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_integer,
    check_pinned,
    check_positive,
    check_real,
)
from ..base.simulation import Simulation
from ..errors import InputError
from ..geometry import Collider
from ..geometry.colliders import check_colliders, collider_states
from .constraints import (
    Distance,
)
from .group import Array, Constraint
from .multilevel import use_multilevel

SOLVERS = ("gauss_seidel", "jacobi", "multilevel")
DTYPES = {"float32": "32", "float64": "64"}


class PositionBasedDynamics(Simulation):
    """Particles with masses that constraints hold together.

    Each step is cut into substeps. In each the particles move freely, the constraints are projected
    `iterations` times, and the velocities follow from where the particles came to.

    Parameters
    ----------
    positions : array_like, shape (n, 3) or (n, 2)
        Initial positions [m]; copied. Two columns are motion in the plane z = 0.
    masses : float or array_like, shape (n,)
        [kg], above 0.
    constraints : sequence of Constraint
        Groups of constraints, projected in this order.
    velocities : array_like, like `positions`, optional
        Initial velocities [m/s]; 0 unless given.
    pinned : array_like, optional
        Indices of particles that do not move, or one boolean each; see `set_targets`.
    gravity : array_like, shape (3,) or (2,), optional
        [m/s^2]; 9.81 downwards unless given.
    colliders : sequence of Collider
        Obstacles; they belong to this object from now on.
    margin : float
        Distance that particles keep from the obstacles [m], above 0.
    substeps : int
        Of each step.
    iterations : int
        Projections of all constraints in each substep. More substeps converge faster than more
        iterations, and damp less.
    solver : str
        'gauss_seidel', constraint after constraint in an order of colours, or 'jacobi', all at once
        with the mass of each particle split among its constraints: symmetric, but slow to converge.
        'multilevel' is 'gauss_seidel' after corrections on coarser and coarser levels, for large
        cloth: what is left of the error does not grow with the number of particles.
    rest_positions : array_like, like `positions`, optional
        Of 'multilevel': where the particles lie when rigid distances hold and nothing is folded,
        such as cloth laid flat; `positions` unless given.
    relaxation : float
        Scales the corrections of 'jacobi', above 0 and below 2; above 1 is over-relaxation.
    damping : float
        Rate at which all velocities decay [1/s], at least 0.
    step : float
        Size of the steps of `advance` [s].
    dtype : str or dtype
        'float32' or 'float64': of positions, which are stored relative to an origin in float64.
    threads : int, optional
        Of the native loops; results do not depend on it.
    time : float
        Initial time [s].

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    References
    ----------
    Mueller et al., "Position based dynamics", 2007; Macklin, Mueller, Chentanez, "XPBD: position-
    based simulation of compliant constrained dynamics", 2016; Macklin et al., "Small steps in
    physics simulation", 2019.

    Examples
    --------
    A pendulum keeps its length.

    >>> import substep
    >>> sim = substep.PositionBasedDynamics(
    ...     [[0, 0, 0], [1, 0, 0]], 1.0, [substep.Distance([[0, 1]])], pinned=[0]
    ... )
    >>> sim.advance(1.0)
    >>> round(float((sim.positions[1] ** 2).sum()), 5)
    1.0
    """

    def __init__(
        self,
        positions: ArrayLike,
        masses: ArrayLike,
        constraints: Sequence[Constraint] = (),
        *,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        gravity: ArrayLike | None = None,
        colliders: Sequence[Collider] = (),
        margin: float = 1e-3,
        substeps: int = 10,
        iterations: int = 1,
        solver: str = "gauss_seidel",
        rest_positions: ArrayLike | None = None,
        relaxation: float = 1.0,
        damping: float = 0.0,
        step: float = 1 / 60,
        dtype: Any = "float32",
        threads: int | None = None,
        time: float = 0.0,
    ) -> None:
        self.dtype = _check_dtype(dtype)
        shape = check_array("positions", positions).shape
        columns = 2 if len(shape) == 2 and shape[1] == 2 else 3
        self.dimension = columns
        x = self._rows("positions", positions)
        n = len(x)
        self._masses = check_positive("masses", masses, n)
        self._masses.flags.writeable = False
        v = np.zeros((n, 3)) if velocities is None else self._rows("velocities", velocities, n)
        down = (0.0, -9.81) if columns == 2 else (0.0, 0.0, -9.81)
        pull = check_array("gravity", down if gravity is None else gravity, (columns,))
        self.gravity: Array = np.append(pull, np.zeros(3 - columns))
        self.gravity.flags.writeable = False
        self.constraints = tuple(constraints)
        for k, constraint in enumerate(self.constraints):
            if not isinstance(constraint, Constraint):
                raise TypeError(f"constraints[{k}]: expected constraints, got {constraint!r}")
        self.colliders = check_colliders(colliders)
        self.substeps = check_integer("substeps", substeps, minimum=1, maximum=10**6)
        self.iterations = check_integer("iterations", iterations, minimum=1, maximum=10**6)
        self.solver = check_choice("solver", solver, SOLVERS)
        self.relaxation = check_real("relaxation", relaxation, positive=True)
        if self.relaxation >= 2:
            raise InputError(f"relaxation: expected a number below 2, got {self.relaxation}")
        self.damping = check_real("damping", damping, nonnegative=True)
        self.step_size = check_real("step", step, positive=True)
        groups = [constraint._groups(x) for constraint in self.constraints]
        ends = np.cumsum([len(own) for own in groups]).tolist()
        self._group_ranges = [range(end - len(g), end) for end, g in zip(ends, groups, strict=True)]
        options = {
            "substeps": self.substeps,
            "iterations": self.iterations,
            "solver": self.solver,
            "relaxation": self.relaxation,
            "gravity": self.gravity.tolist(),
            "damping": self.damping,
            "margin": check_real("margin", margin, positive=True),
            "dimension": columns,
        }
        native = _core.PositionBasedDynamics(
            x,
            v,
            self._masses,
            check_pinned(pinned, n),
            [group for own in groups for group in own],
            options,
            [collider._native for collider in self.colliders],
            self.dtype.name,
        )
        self._rest_lengths = {
            k: constraint._parameters(x)[:, 0]
            for k, constraint in enumerate(self.constraints)
            if isinstance(constraint, Distance)
        }
        if rest_positions is not None and self.solver != "multilevel":
            raise InputError("rest_positions: only the solver 'multilevel' has a use for them")
        if self.solver == "multilevel":
            rest = x if rest_positions is None else self._rows("rest_positions", rest_positions, n)
            use_multilevel(native, self.constraints, x, rest)
        super().__init__(native, time, threads)

    def _rows(self, name: str, values: ArrayLike, count: int | None = None) -> Array:
        """Vectors with three columns."""
        array = check_array(name, values, (count, self.dimension))
        largest = float(np.finfo(self.dtype).max)
        wrong = np.abs(array) > largest
        if wrong.any():
            raise InputError(f"{name}: {array[wrong][0]} is beyond {self.dtype}")
        if self.dimension == 2:
            return np.concatenate([array, np.zeros((len(array), 1))], axis=1)
        return array

    def _next_step(self) -> float:
        return self.step_size

    def __len__(self) -> int:
        return len(self._masses)

    @property
    def masses(self) -> Array:
        """Masses [kg], shape (n,), read-only."""
        return self._masses

    @property
    def positions(self) -> Array:
        """Positions [m], one row per particle: a copy; see `set_positions`."""
        return self._columns(self._native.positions)

    @property
    def velocities(self) -> Array:
        """Velocities [m/s], one row per particle: a copy; see `set_velocities`."""
        return self._columns(self._native.velocities)

    @property
    def forces(self) -> Array:
        """External forces of the next step [N], one row per particle: a copy; see `set_forces`."""
        return self._columns(self._native.forces)

    @property
    def targets(self) -> Array:
        """Where pinned particles go in the next step [m]: a copy; see `set_targets`."""
        return self._columns(self._native.targets)

    @property
    def pinned(self) -> NDArray[np.bool_]:
        """Which particles are pinned, shape (n,): a copy; assign indices or flags to change it."""
        flags: NDArray[np.bool_] = self._native.pinned.astype(bool)
        return flags

    @pinned.setter
    def pinned(self, pinned: ArrayLike) -> None:
        with self._own():
            self._native.pinned = check_pinned(pinned, len(self))

    def _columns(self, rows: Any) -> Array:
        return np.ascontiguousarray(rows[:, : self.dimension])

    def _some(
        self, name: str, values: ArrayLike, ids: ArrayLike | None
    ) -> tuple[NDArray[np.int64], Array]:
        """Particles and a row for each."""
        if ids is None:
            return np.arange(len(self)), self._rows(name, values, len(self))
        array = np.asarray(ids)
        if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
            raise InputError("ids: expected a list of indices")
        wrong = (array < 0) | (array >= len(self))
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"ids[{k}]: expected an index from 0 to {len(self) - 1}, got {array[k]}"
            )
        return np.ascontiguousarray(array, np.int64), self._rows(name, values, len(array))

    def set_positions(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Put particles somewhere; their velocities stay.

        Parameters
        ----------
        values : array_like, one row per particle
            Positions [m].
        ids : array_like of int, optional
            Which particles; all unless given.

        Raises
        ------
        InputError
            If an argument is wrong; nothing is changed then.
        """
        which, rows = self._some("values", values, ids)
        with self._own():
            self._native.set_positions(which, rows)

    def set_velocities(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Give particles a velocity.

        Parameters
        ----------
        values : array_like, one row per particle
            Velocities [m/s].
        ids : array_like of int, optional
            Which particles; all unless given.

        Raises
        ------
        InputError
            If an argument is wrong; nothing is changed then.
        """
        which, rows = self._some("values", values, ids)
        with self._own():
            self._native.set_velocities(which, rows)

    def set_forces(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Set external forces of the next step; after it they are 0 again.

        Parameters
        ----------
        values : array_like, one row per particle
            Forces [N].
        ids : array_like of int, optional
            Which particles; all unless given.

        Raises
        ------
        InputError
            If an argument is wrong; nothing is changed then.
        """
        which, rows = self._some("values", values, ids)
        with self._own():
            forces = self._native.forces
            forces[which] = rows
            self._native.forces = forces

    def set_targets(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Say where pinned particles go in the next step: in a straight line at constant speed.

        Parameters
        ----------
        values : array_like, one row per particle
            Positions [m]; rows of free particles mean nothing.
        ids : array_like of int, optional
            Which particles; all unless given.

        Raises
        ------
        InputError
            If an argument is wrong; nothing is changed then.
        """
        which, rows = self._some("values", values, ids)
        with self._own():
            targets = self._native.targets
            targets[which] = rows
            self._native.targets = targets

    def step_limit(self) -> tuple[float, str]:
        """Largest stable step, and why.

        Returns
        -------
        float
            The step [s]: infinite.
        str
            The reason.
        """
        return math.inf, "projections are stable at any step"

    def _of_groups(self, get: Any, constraint: int) -> Array:
        """get(group) of all groups of constraints[constraint]."""
        last = len(self.constraints) - 1
        index = check_integer("constraint", constraint, minimum=0, maximum=last)
        return np.concatenate([get(group) for group in self._group_ranges[index]])

    def values(self, constraint: int = 0) -> Array:
        """C of each constraint, at the present positions.

        Parameters
        ----------
        constraint : int
            Which of `constraints`.

        Returns
        -------
        ndarray, shape (m,)
            C, in the unit of the constraint ([m] for `Distance`). Where one class makes two kinds
            (`NeoHookean`), one kind comes after the other.

        Raises
        ------
        InputError
            If there is no such entry.
        """
        return self._of_groups(self._native.values, constraint)

    def multipliers(self, constraint: int = 0) -> Array:
        """What each constraint pulled with in the last substep: lambda / h^2.

        Constraint j pulled its particle i with the force lambda_j / h^2 grad_i C_j, so a stretched
        `Distance` has a negative one, minus its tension [N].

        Parameters
        ----------
        constraint : int
            Which of `constraints`.

        Returns
        -------
        ndarray, shape (m,)
            In [J] over the unit of C; 0 before the first step. In the order of `values`.

        Raises
        ------
        InputError
            If there is no such entry.
        """
        h = self._native.last_substep
        return self._of_groups(self._native.multipliers, constraint) / (h * h if h > 0 else 1.0)

    def diagnostics(self) -> dict[str, float]:
        """Energies, momentum, and what is left of the constraints.

        Returns
        -------
        dict of str to float
            `kinetic_energy`, `elastic_energy` (of constraints with compliance) and
            `gravitational_energy` [J]; `momentum_x`, `_y`, `_z` [N s]; `speed`, the largest [m/s];
            `strain` and `max_strain`, root mean square and largest of |C| / r over all `Distance`
            of rest length r above 0; `residual`, the same root mean square of |C + alpha lambda /
            h^2| / r, which is 0 where the equations of the last substep are solved; `skipped`,
            projections of the last step that had no gradient.
        """
        velocities = self._native.velocities
        momentum = self._masses @ velocities
        speeds = np.linalg.norm(velocities, axis=1)
        heights = self._native.positions @ self.gravity
        strain, residual = self._strains()
        return {
            "kinetic_energy": 0.5 * float(self._masses @ speeds**2),
            "elastic_energy": float(self._native.elastic_energy),
            "gravitational_energy": -float(self._masses @ heights),
            "momentum_x": float(momentum[0]),
            "momentum_y": float(momentum[1]),
            "momentum_z": float(momentum[2]),
            "speed": float(speeds.max(initial=0.0)),
            "strain": math.sqrt(float(strain @ strain) / max(1, len(strain))),
            "max_strain": float(np.abs(strain).max(initial=0.0)),
            "residual": math.sqrt(float(residual @ residual) / max(1, len(residual))),
            "skipped": float(self._native.skipped),
        }

    def _strains(self) -> tuple[Array, Array]:
        """C / r and (C + alpha lambda / h^2) / r of all distances with r above 0."""
        strains, residuals = [np.zeros(0)], [np.zeros(0)]
        for k, constraint in enumerate(self.constraints):
            if isinstance(constraint, Distance):
                c, rest = self.values(k), self._rest_lengths[k]
                left = c + constraint.compliance * self.multipliers(k)
                strains.append(c[rest > 0] / rest[rest > 0])
                residuals.append(left[rest > 0] / rest[rest > 0])
        return np.concatenate(strains), np.concatenate(residuals)

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `velocity`, one row per particle, copies.
        """
        return {"position": (self.positions, "m"), "velocity": (self.velocities, "m/s")}

    def state(self) -> dict[str, Any]:
        """Copy the whole state, that of the colliders too.

        Returns
        -------
        dict
            For `restore`; positions in it are relative to an origin.
        """
        native = self._native
        x, v, targets = native.raw()
        groups = [native.group_state(k) for k in range(native.groups)]
        return {
            "time": self.time,
            "origin": np.array(native.origin),
            "positions": x,
            "velocities": v,
            "forces": native.forces,
            "targets": targets,
            "pinned": native.pinned,
            "groups": np.concatenate([np.zeros(0), *groups]),
            "group_sizes": np.array([len(g) for g in groups], np.int64),
            "colliders": collider_states(self.colliders),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit.

        Parameters
        ----------
        state : dict
            From `state()` of an object made in the same way.

        Raises
        ------
        InputError
            If it is not such a state; nothing is changed then.
        """
        own = self.state()
        missing = set(own) - set(state)
        if missing:
            raise InputError(f"state: {', '.join(sorted(missing))} missing")
        time = check_real("state['time']", state["time"])
        arrays = {}
        for name in set(own) - {"time"}:
            shape = own[name].shape
            if name == "groups":
                shape = (int(np.sum(state["group_sizes"])),)
            elif name == "targets" and len(state[name]) in (0, len(self)):
                shape = (len(state[name]), 3)
            arrays[name] = check_array(
                f"state[{name!r}]", state[name], shape, dtype=own[name].dtype
            )
        if not np.array_equal(arrays["origin"], own["origin"]):
            raise InputError("state['origin']: of a simulation with other initial positions")
        groups = np.split(arrays["groups"], np.cumsum(arrays["group_sizes"])[:-1])
        with self._own():
            native = self._native
            native.time = time
            native.pinned = arrays["pinned"]
            native.set_raw(arrays["positions"], arrays["velocities"], arrays["targets"])
            native.forces = arrays["forces"]
            for k in range(native.groups):
                native.set_group_state(k, groups[k])
            for collider, values in zip(self.colliders, arrays["colliders"], strict=True):
                collider._native.state = values.tolist()

    def copy(self) -> PositionBasedDynamics:
        """Copy exactly, colliders too.

        Returns
        -------
        PositionBasedDynamics
            It goes on as this one does, bit for bit.
        """
        other = object.__new__(type(self))
        with self._own():
            other.__dict__.update(self.__dict__)
            other.colliders = tuple(collider.copy() for collider in self.colliders)
            native = self._native.copy([collider._native for collider in other.colliders])
            Simulation.__init__(other, native, self.time, self.threads)
        return other

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> PositionBasedDynamics:
        return self.copy()


def _check_dtype(dtype: Any) -> str:
    try:
        name = np.dtype(dtype).name
    except TypeError:
        name = str(dtype)
    return check_choice("dtype", name, DTYPES)
