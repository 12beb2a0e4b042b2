"""What mass-spring systems and soft bodies share: state, steps, contact, checkpoints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    MOST_INT,
    check_array,
    check_choice,
    check_integer,
    check_pinned,
    check_real,
    check_threads,
    in_range,
)
from ..base.rows import read_only
from ..base.schema import TIME, Entry, Rows
from ..base.simulation import StepReport, whole_steps, with_energy
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
from ..stability import max_stable_step, stability_limit

Array = NDArray[np.float64]

INTEGRATORS = {  # and their other names
    "euler": ("explicit_euler", "forward_euler"),
    "symplectic_euler": ("semi_implicit_euler",),
    "velocity_verlet": (),
    "rk4": (),
    "implicit_euler": ("backward_euler",),
}
_NATIVE = {"euler": "explicit_euler", "symplectic_euler": "semi_implicit_euler"}
SOLVERS = {"newton": 100, "projective": 10}  # and their iterations
ON_FAIL = ("substep", "raise")
_MARGIN = 0.5  # of the step limit at the start, which falls as a body is deformed
_ARRAYS = ("positions", "velocities", "forces", "targets")
_STATE: list[Entry] = [
    TIME,
    *(Rows(name, np.float64, ("n", 3), finite="any") for name in _ARRAYS),
    Rows("pinned", np.uint8, ("n",), high=1),
]


@dataclass
class DeformableReport(StepReport):
    """What the last step of implicit Euler took.

    Attributes
    ----------
    factorizations, backtracks : int
        Of matrices, and shorter tries of the line search.
    refinements : int
        Quasi-Newton steps between the iterations, which need no factorization.
    minimisations : int
        One for each time that friction was lagged.
    subdivided : int
        Steps that were done again in halves.
    residuals : list of float
        Largest component of the gradient [N] at the start and after each iteration of the last
        minimisation.
    friction_converged : bool
        Whether lagged friction agrees with that found.
    """

    factorizations: int = 0
    backtracks: int = 0
    refinements: int = 0
    minimisations: int = 0
    subdivided: int = 0
    residuals: Sequence[float] = ()
    friction_converged: bool = True


class Deformable(Deforming, Skinned):
    """Vertices with masses that forces act on; make a `MassSpring` or a `SoftBody`."""

    _rows_are = "vertices"

    integrator: str
    solver: str
    _dimension = 3
    _fixed_step = True
    _thinnest = 0.0

    def _set_up(
        self,
        positions: Array,
        masses: Array,
        *,
        velocities: ArrayLike | None,
        pinned: ArrayLike,
        drag: float,
        gravity: ArrayLike,
        colliders: Sequence[Collider | Shape],
        integrator: str,
        step: float | None,
        solver: str,
        tolerance: float | None,
        max_iterations: int | None,
        on_fail: str,
        contact_margin: float,
        contact_stiffness: float | None,
        sticking_speed: float,
        time: float,
        threads: int | None,
    ) -> None:
        n = len(positions)
        self._drag = check_real("drag", drag, nonnegative=True)
        self.colliders = check_colliders(colliders)
        self.integrator = check_choice("integrator", integrator, INTEGRATORS, aliases=INTEGRATORS)
        self._masses = read_only(masses)
        if tolerance is None:
            # |g|_inf below a thousandth of the weight, at standard gravity, of a mean vertex.
            with in_range("masses"):
                tolerance = 1e-3 * 9.81 * float(masses.mean()) if n else 1.0
        start = np.zeros((n, 3))
        if velocities is not None:
            start = check_array("velocities", velocities, (n, 3))
        self.solver = check_choice("solver", solver, SOLVERS)
        if self.solver == "projective" and self.colliders:
            raise InputError("solver: 'projective' has no contact; use 'newton' with colliders")
        self._gravity = read_only(check_array("gravity", gravity, (3,)))
        self._options = {
            "integrator": _NATIVE.get(self.integrator, self.integrator),
            "solver": self.solver,
            "max_iterations": SOLVERS[self.solver]
            if max_iterations is None
            else check_integer("max_iterations", max_iterations, minimum=1, maximum=MOST_INT),
            "gravity": self._gravity.tolist(),
            "tolerance": check_real("tolerance", tolerance, positive=True),
            "max_halvings": 8 if check_choice("on_fail", on_fail, ON_FAIL) == "substep" else 0,
            "contact_thickness": check_real("contact_margin", contact_margin, positive=True),
            "contact_stiffness": 0.0
            if contact_stiffness is None
            else check_real("contact_stiffness", contact_stiffness, positive=True),
            "sticking_speed": check_real("sticking_speed", sticking_speed, positive=True),
            "threads": check_threads(threads),
        }
        flags = check_pinned(pinned, n)
        native = self._make({"positions": positions, "velocities": start, "pinned": flags})
        super().__init__(native, time, threads)
        if step is None:
            limit = self.step_limit()[0] if self.integrator != "implicit_euler" else math.inf
            step = min(1 / 60, _MARGIN * limit) if limit > 0 else 1e-3 / 60
        self._step_size = check_real("step", step, positive=True)

    def _even_step(self, duration: float) -> float:
        # Steps below the limit that are not of one size may be unstable all the same: a shorter one
        # now and then swings a mode up, as a parametric resonance does.
        h = super()._even_step(duration)
        if self.integrator == "implicit_euler" or duration == 0:
            return h
        count, whole = whole_steps(duration, h)
        return duration / (count + (not whole))

    def __len__(self) -> int:
        return len(self._masses)

    @property
    def positions(self) -> Array:
        """Positions [m], shape (n, 3): a view, to be read and written between steps."""
        view: Array = self._native.positions
        return view

    @property
    def velocities(self) -> Array:
        """Velocities [m/s], shape (n, 3): a view, to be read and written between steps."""
        view: Array = self._native.velocities
        return view

    @property
    def forces(self) -> Array:
        """External forces [N], shape (n, 3): a view; the next step uses them and sets them to 0."""
        view: Array = self._native.forces
        return view

    @property
    def targets(self) -> Array:
        """Where pinned vertices go in the next step [m], shape (n, 3): a view.

        They move there in a straight line at constant speed; rows of free vertices mean nothing.
        """
        view: Array = self._native.targets
        return view

    @property
    def masses(self) -> Array:
        """Masses [kg], shape (n,), read-only."""
        return self._masses

    @property
    def pinned(self) -> NDArray[np.bool_]:
        """Which vertices are pinned, shape (n,): read-only; assign indices or flags."""
        flags: NDArray[np.bool_] = read_only(self._native.pinned.astype(bool))
        return flags

    @pinned.setter
    def pinned(self, pinned: ArrayLike) -> None:
        self._native.pinned = check_pinned(pinned, len(self))

    @property
    def report(self) -> DeformableReport:
        """What the last call of `step` or `advance` took and met."""
        native = self._native.report
        told = {field.name: field.name for field in fields(DeformableReport)[2:]}
        told["subdivided"] = "failed"
        values = {name: getattr(native, theirs) for name, theirs in told.items()}
        return DeformableReport(self._last.steps, self._last.dt, **values)

    def set_targets(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Say where pinned vertices go in the next step: in a straight line at constant speed.

        Parameters
        ----------
        values : array_like, shape (m, 3)
            Positions [m]; rows of free vertices mean nothing.
        ids : array_like of int, shape (m,), optional
            Which vertices; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("targets", values, ids)

    def _write(self, name: str, values: Array, rows: NDArray[np.int64]) -> None:
        getattr(self._native, name)[rows] = values

    def pin_forces(self) -> Array:
        """What pins hold their vertices by, at the present positions and velocities.

        Returns
        -------
        ndarray, shape (n, 3)
            Of a pinned vertex what keeps the balance of its weight and of all that pulls it:
            springs or elements, dampers and drag [N]; of a free one 0. At rest their sum is the
            weight of the body and of what lies on its free vertices, less what obstacles carry.

        Raises
        ------
        NonFiniteError
            If positions or velocities are not finite.

        Notes
        -----
        A pin that is moved by `targets` and gets faster needs the mass of its vertex times the
        acceleration in addition; `forces` on a pinned vertex, also those of what lies on it in a
        `World`, pass into the pin and are not in this either.

        Examples
        --------
        >>> import substep
        >>> lamp = substep.MassSpring([[0, 0, 0], [0, 0, -1]], [[0, 1]], 1e4, 2.0, pinned=[0])
        >>> lamp.advance(2.0)
        >>> lamp.pin_forces().round(2).tolist()
        [[0.0, 0.0, 39.24], [0.0, 0.0, 0.0]]
        """
        # A step of explicit Euler of 1 s, without pins and obstacles, changes v by a(x, v).
        v = self.velocities.copy()
        free = {"positions": self.positions, "velocities": v, "pinned": np.zeros(len(v), np.uint8)}
        body = self._make_body(free, [], self._options | {"integrator": "explicit_euler"})
        body.step(1.0)
        pulled = self._masses[:, None] * (body.velocities - v)
        forces: Array = np.where(self.pinned[:, None], 0.0 - pulled, 0.0)
        return forces

    def step_limit(self) -> tuple[float, str]:
        """Largest stable step at the present positions, and why.

        Returns
        -------
        float
            The step [s]: infinite for implicit Euler, 0 where every step lets a mode grow.
        str
            The reason.

        Notes
        -----
        From the largest eigenvalues of M^-1 K and M^-1 C, by Lanczos' method: `stability` says what
        step each integrator takes for a mode of that frequency and damping.
        """
        if self.integrator == "implicit_euler":
            return math.inf, "implicit Euler is stable at any step"
        omega, rate = self._native.spectrum()
        if omega == 0:
            return math.inf, "no elastic force"
        ratio = rate / (2 * omega)
        reason = f"the fastest mode has omega = {omega:.6g} 1/s and the damping ratio {ratio:.3g}"
        name = self.integrator
        if name in ("symplectic_euler", "velocity_verlet"):
            return stability_limit(name, ratio) / omega, reason
        root = np.sqrt(complex(ratio**2 - 1))
        return max_stable_step(name, [omega * (-ratio - root), omega * (-ratio + root)]), reason

    @np.errstate(all="ignore")  # sums that are too large are infinite
    def diagnostics(self) -> dict[str, float]:
        """Energies, momentum and figures of the last step.

        Returns
        -------
        dict of str to float
            `kinetic_energy`, `elastic_energy` (of springs or elements and of contact),
            `gravitational_energy` (0 at the origin) and `energy`, their sum [J]; `momentum_x`,
            `_y`, `_z` [N s]; `speed`, the largest [m/s]; `iterations`, `factorizations`,
            `subdivided` and `residual` [N] of the last step of implicit Euler; with colliders
            `distance`, the smallest of a free vertex [m].
        """
        report = self.report
        momentum = self._masses @ self.velocities
        values = {
            "kinetic_energy": self._native.kinetic_energy(),
            "elastic_energy": self._native.potential_energy(),
            "gravitational_energy": -float(self._masses @ (self.positions @ self._gravity)),
            "momentum_x": float(momentum[0]),
            "momentum_y": float(momentum[1]),
            "momentum_z": float(momentum[2]),
            "speed": float(np.linalg.norm(self.velocities, axis=1).max(initial=0.0)),
        }
        if self.integrator == "implicit_euler":
            values |= {
                "iterations": float(report.iterations),
                "factorizations": float(report.factorizations),
                "subdivided": float(report.subdivided),
                "residual": report.residuals[-1] if report.residuals else 0.0,
            }
        if self.colliders:
            values["distance"] = self._native.closest()
        return with_energy(values)

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `velocity`, shape (n, 3), copies.
        """
        return {
            "position": (self.positions.copy(), "m"),
            "velocity": (self.velocities.copy(), "m/s"),
        }

    def _set_gravity(self, pull: Array, options: dict[str, Any]) -> None:
        parts = {"_gravity": pull, "_options": options}
        # In place: what is a view stays one.
        self._commit(parts, setattr, self._native, "gravity", options["gravity"])

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        sizes = {"n": len(self), "colliders": len(self.colliders)}
        entries = [*_STATE, colliders_entry(self.colliders)]
        return entries, sizes, np.float64

    def _state(self) -> dict[str, Any]:
        native = self._native
        arrays = {name: getattr(native, name).copy() for name in _ARRAYS}
        own = {"pinned": native.pinned, "colliders": collider_states(self.colliders)}
        return {"time": self.time, **arrays, **own}

    def _refuse(self, given: dict[str, Any]) -> None:
        for name in _ARRAYS:
            check_array(f"state[{name!r}]", given[name])

    def _put_state(self, state: dict[str, Any]) -> None:
        self._native.time = state["time"]
        self._native.pinned = state["pinned"]
        for name in _ARRAYS:
            getattr(self._native, name)[:] = state[name]
        restore_colliders(self.colliders, state["colliders"])

    def _make(self, state: Mapping[str, Any]) -> Any:
        """With all terms and obstacles, at the positions of a state."""
        return self._make_body(state, self.colliders, self._options)

    def _make_body(
        self, state: Mapping[str, Any], colliders: Sequence[Collider], options: dict[str, Any]
    ) -> Any:
        terms = self._terms()
        if self._drag > 0:
            terms = [*terms, _core.drag_term(self._drag, self._masses)]
        return _core.Deformable(
            state["positions"],
            state["velocities"],
            self._masses,
            state["pinned"],
            terms,
            [collider._native for collider in colliders],
            **options,
        )

    def _terms(self) -> list[Any]:
        """What pulls, as native terms."""
        raise NotImplementedError
