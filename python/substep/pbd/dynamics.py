"""Position-based dynamics: ropes, cloth and soft bodies as constraints on positions."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_dtype,
    check_integer,
    check_pinned,
    check_positive,
    check_real,
    check_sequence,
    check_within,
)
from ..base.rows import read_only
from ..base.schema import OWN, TIME, Entry, Rows
from ..base.simulation import Simulation, StepReport, with_energy
from ..errors import InputError
from ..geometry import Collider, Shape
from ..geometry.colliders import (
    check_colliders,
    collider_states,
    colliders_entry,
    restore_colliders,
)
from ..geometry.facets import Deforming
from ..geometry.skin import Skinned
from .constraints import (
    Distance,
)
from .group import Array, Constraint
from .multilevel import use_multilevel

if TYPE_CHECKING:
    from typing_extensions import Self

SOLVERS = ("gauss_seidel", "jacobi", "multilevel")


@dataclass
class ConstraintReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    skipped : int
        Projections of the last step that had no gradient.
    """

    skipped: int = 0


class PositionBasedDynamics(Deforming, Skinned):
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
    colliders : sequence of Collider or Shape
        Obstacles; they belong to this object from now on.
    contact_margin : float
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
        cloth: the remaining error does not grow with the number of particles.
    rest_positions : array_like, like `positions`, optional
        Of 'multilevel': where the particles lie when rigid distances hold and nothing is folded,
        such as cloth laid flat; `positions` unless given.
    relaxation : float
        Scales the corrections of 'jacobi', above 0 and below 2; above 1 is over-relaxation.
    drag : float
        Rate at which all velocities decay [1/s], at least 0.
    step : float
        Size of the steps of `advance` [s].
    dtype : {'float32', 'float64'}
        Of positions, which are stored relative to an origin in float64.
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

    dtype: np.dtype[Any]
    constraints: tuple[Constraint, ...]
    substeps: int
    iterations: int
    solver: str
    relaxation: float
    drag: float
    contact_margin: float
    _thinnest = 0.0
    _fixed_step = False  # two equal steps at the end, see `_sizes`

    def __init__(
        self,
        positions: ArrayLike,
        masses: ArrayLike,
        constraints: Sequence[Constraint] = (),
        *,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        gravity: ArrayLike | None = None,
        colliders: Sequence[Collider | Shape] = (),
        contact_margin: float = 1e-3,
        substeps: int = 10,
        iterations: int = 1,
        solver: str = "gauss_seidel",
        rest_positions: ArrayLike | None = None,
        relaxation: float = 1.0,
        drag: float = 0.0,
        step: float = 1 / 60,
        dtype: DTypeLike = "float32",
        threads: int | None = None,
        time: float = 0.0,
    ) -> None:
        self.dtype = check_dtype(dtype)
        shape = check_array("positions", positions).shape
        columns = 2 if len(shape) == 2 and shape[1] == 2 else 3
        self._dimension = columns
        x = self._rows("positions", positions)
        n = len(x)
        self._masses = read_only(check_positive("masses", masses, n))
        v = np.zeros((n, 3)) if velocities is None else self._rows("velocities", velocities, n)
        down = (0.0, -9.81) if columns == 2 else (0.0, 0.0, -9.81)
        pull = check_array("gravity", down if gravity is None else gravity, (columns,))
        self._gravity = read_only(pull.copy())
        self._options = {"gravity": [*pull.tolist(), 0.0][:3]}
        self.constraints = tuple(check_sequence("constraints", constraints, "constraints"))
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
        self.drag = check_real("drag", drag, nonnegative=True)
        self.contact_margin = check_real("contact_margin", contact_margin, positive=True)
        self._step_size = check_real("step", step, positive=True)
        if rest_positions is not None and self.solver != "multilevel":
            raise InputError("rest_positions: only the solver 'multilevel' has a use for them")
        self._start = read_only(x.copy())  # constraints take from it what they were not given
        self._rest: Array | None = None
        if rest_positions is not None:
            self._rest = read_only(self._rows("rest_positions", rest_positions, n).copy())
        native = self._make({"velocities": v, "pinned": check_pinned(pinned, n)})
        self._rest_lengths = {
            k: constraint._parameters(x)[:, 0]
            for k, constraint in enumerate(self.constraints)
            if isinstance(constraint, Distance)
        }
        super().__init__(native, time, threads)

    def _make(self, state: Mapping[str, Any]) -> Any:
        x = self._start
        groups = [constraint._groups(x) for constraint in self.constraints]
        ends = np.cumsum([len(own) for own in groups]).tolist()
        self._group_ranges = [range(end - len(g), end) for end, g in zip(ends, groups, strict=True)]
        options = {
            "substeps": self.substeps,
            "iterations": self.iterations,
            "solver": self.solver,
            "relaxation": self.relaxation,
            **self._options,
            "damping": self.drag,
            "margin": self.contact_margin,
            "dimension": self._dimension,
        }
        native = _core.PositionBasedDynamics(
            x,
            np.asarray(state["velocities"], np.float64),
            self._masses,
            state["pinned"],
            [group for own in groups for group in own],
            options,
            [collider._native for collider in self.colliders],
            self.dtype.name,
        )
        if self.solver == "multilevel":
            use_multilevel(native, self.constraints, x, x if self._rest is None else self._rest)
        return native

    def _rows(self, name: str, values: ArrayLike, count: int | None = None) -> Array:
        """Vectors with three columns."""
        array = check_array(name, values, (count, self._dimension))
        check_within(name, array, self.dtype)
        if self._dimension == 2:
            return np.concatenate([array, np.zeros((len(array), 1))], axis=1)
        return array

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self._dimension

    def __len__(self) -> int:
        return len(self._masses)

    @property
    def masses(self) -> Array:
        """Masses [kg], shape (n,), read-only."""
        return self._masses

    @property
    def positions(self) -> Array:
        """Positions [m], one row per particle: read-only; see `set_positions`."""
        return self._columns(self._native.positions)

    @property
    def velocities(self) -> Array:
        """Velocities [m/s], one row per particle: read-only; see `set_velocities`."""
        return self._columns(self._native.velocities)

    @property
    def forces(self) -> Array:
        """External forces of the next step [N], one row each: read-only; see `set_forces`."""
        return self._columns(self._native.forces)

    @property
    def targets(self) -> Array:
        """Where pinned particles go in the next step [m]: read-only; see `set_targets`."""
        return self._columns(self._native.targets)

    @property
    def pinned(self) -> NDArray[np.bool_]:
        """Which particles are pinned, shape (n,): read-only; assign indices or flags."""
        flags: NDArray[np.bool_] = read_only(self._native.pinned.astype(bool))
        return flags

    @pinned.setter
    def pinned(self, pinned: ArrayLike) -> None:
        self._native.pinned = check_pinned(pinned, len(self))

    def _columns(self, rows: Any) -> Array:
        columns: Array = read_only(np.array(rows[:, : self._dimension], order="C"))
        return columns

    def _vectors(self, name: str, values: ArrayLike, count: int) -> Array:
        return self._rows(name, values, count)

    def _write(self, name: str, values: Array, rows: NDArray[np.int64]) -> None:
        if name in ("forces", "targets"):
            array = getattr(self._native, name)
            array[rows] = values
            setattr(self._native, name, array)
        else:
            getattr(self._native, f"set_{name}")(rows, values)

    def _set_step_size(self, step: float | None) -> None:
        self._step_size = check_real("step_size", step, positive=True)  # None: it has no limit

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
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("targets", values, ids)

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

    @np.errstate(all="ignore")  # sums that are too large are infinite
    def diagnostics(self) -> dict[str, float]:
        """Energies, momentum, and the remaining error of the constraints.

        Returns
        -------
        dict of str to float
            `kinetic_energy`, `elastic_energy` (of constraints with compliance),
            `gravitational_energy` (0 at the origin) and `energy`, their sum [J]; `momentum_x`,
            `_y`, `_z` [N s]; `speed`, the largest [m/s];
            `strain` and `max_strain`, root mean square and largest of |C| / r over all `Distance`
            of rest length r above 0; `residual`, the same root mean square of |C + alpha lambda /
            h^2| / r, which is 0 where the equations of the last substep are solved; `skipped`,
            projections of the last step that had no gradient.
        """
        velocities = self._native.velocities
        momentum = self._masses @ velocities
        speeds = np.linalg.norm(velocities, axis=1)
        heights = self._native.positions @ [*self._gravity, 0.0][:3]
        strain, residual = self._strains()
        values = {
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
        return with_energy(values)

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

    @property
    def report(self) -> ConstraintReport:
        """What the last call of `step` or `advance` took and met."""
        done = self._last
        sweeps = self.substeps * self.iterations if done.dt > 0 else 0
        skipped = int(self._native.skipped)
        return ConstraintReport(done.steps, done.dt, sweeps, True, skipped=skipped)

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        flat = self._dimension == 2
        entries: list[Entry] = [
            TIME,
            Rows("origin", np.float64, (3,)),
            Rows("positions", OWN, ("n", 3), flat=flat),
            Rows("velocities", OWN, ("n", 3), flat=flat),
            Rows("forces", np.float64, ("n", 3), flat=flat, narrow=True),
            Rows("targets", OWN, ("n", 3), flat=flat, optional=True),
            Rows("pinned", np.uint8, ("n",), high=1),
            Rows("groups", np.float64, (None,)),
            Rows("group_sizes", np.int64, (self._native.groups,), low=0),
            colliders_entry(self.colliders),
        ]
        return entries, {"n": len(self)}, self.dtype

    def _fit(self, state: dict[str, Any]) -> None:
        if not np.array_equal(state["origin"], self._native.origin):
            raise InputError("state['origin']: of a simulation with other initial positions")
        sizes = [len(self._native.group_state(k)) for k in range(self._native.groups)]
        if state["group_sizes"].tolist() != sizes or len(state["groups"]) != sum(sizes):
            raise InputError("state['groups']: of a simulation with other constraints")

    def _state(self) -> dict[str, Any]:
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

    def _put_state(self, state: dict[str, Any]) -> None:
        native = self._native
        native.time = state["time"]
        native.pinned = state["pinned"]
        native.set_raw(state["positions"], state["velocities"], state["targets"])
        native.forces = state["forces"]
        groups = np.split(state["groups"], np.cumsum(state["group_sizes"])[:-1])
        for k in range(native.groups):
            native.set_group_state(k, groups[k])
        restore_colliders(self.colliders, state["colliders"])

    def copy(self) -> Self:
        """Copy exactly, colliders too.

        Returns
        -------
        PositionBasedDynamics
            It goes on as this one does, bit for bit.
        """
        other = type(self).__new__(type(self))
        other.__dict__.update(self._parts())
        other.__dict__["colliders"] = tuple(collider.copy() for collider in self.colliders)
        native = self._native.copy([collider._native for collider in other.colliders])
        Simulation.__init__(other, native, self.time, self.threads)
        other._last = dataclasses.replace(self._last)
        return other
