"""What mass-spring systems and soft bodies share: state, steps, contact, checkpoints."""

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
    check_real,
    check_threads,
)
from ..base.simulation import Simulation
from ..errors import InputError
from ..geometry import Collider, Shape
from ..geometry.colliders import check_colliders, collider_states
from ..stability import max_stable_step, stability_limit

Array = NDArray[np.float64]

INTEGRATORS = ("explicit_euler", "semi_implicit_euler", "rk4", "velocity_verlet", "implicit_euler")
SOLVERS = {"newton": 100, "projective": 10}  # and their iterations
ON_FAIL = ("substep", "raise")
_STATE = ("time", "positions", "velocities", "forces", "targets", "colliders")


class Deformable(Simulation):
    """Vertices with masses that forces act on; make a `MassSpring` or a `SoftBody`."""

    _native: Any

    def _set_up(
        self,
        positions: Array,
        masses: Array,
        terms: list[Any],
        *,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        drag: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        colliders: Sequence[Collider | Shape] = (),
        integrator: str = "implicit_euler",
        step: float | None = None,
        solver: str = "newton",
        tolerance: float | None = None,
        max_iterations: int | None = None,
        on_fail: str = "substep",
        contact_thickness: float = 1e-3,
        contact_stiffness: float | None = None,
        sticking_speed: float = 1e-3,
        time: float = 0.0,
        threads: int | None = None,
    ) -> None:
        n = len(positions)
        rate = check_real("drag", drag, nonnegative=True)
        if rate > 0:
            terms = [*terms, _core.drag_term(rate, masses)]
        self.colliders = check_colliders(colliders)
        self.integrator = check_choice("integrator", integrator, INTEGRATORS)
        self._masses = masses
        self._masses.flags.writeable = False
        if tolerance is None:
            # |g|_inf below a thousandth of the weight, at standard gravity, of a mean vertex.
            tolerance = 1e-3 * 9.81 * float(masses.mean()) if n else 1.0
        start = np.zeros((n, 3))
        if velocities is not None:
            start = check_array("velocities", velocities, (n, 3))
        name = check_choice("solver", solver, SOLVERS)
        if name == "projective" and self.colliders:
            raise InputError("solver: 'projective' has no contact; use 'newton' with colliders")
        self._native = _core.Deformable(
            positions,
            start,
            masses,
            check_pinned(pinned, n),
            terms,
            [collider._native for collider in self.colliders],
            integrator=self.integrator,
            solver=name,
            max_iterations=SOLVERS[name]
            if max_iterations is None
            else check_integer("max_iterations", max_iterations, minimum=1),
            gravity=check_array("gravity", gravity, (3,)).tolist(),
            tolerance=check_real("tolerance", tolerance, positive=True),
            max_halvings=8 if check_choice("on_fail", on_fail, ON_FAIL) == "substep" else 0,
            contact_thickness=check_real("contact_thickness", contact_thickness, positive=True),
            contact_stiffness=0.0
            if contact_stiffness is None
            else check_real("contact_stiffness", contact_stiffness, positive=True),
            sticking_speed=check_real("sticking_speed", sticking_speed, positive=True),
            threads=check_threads(threads),
        )
        self._gravity = check_array("gravity", gravity, (3,))
        super().__init__(self._native, time, threads)
        if step is None:
            limit = self.step_limit()[0] if self.integrator != "implicit_euler" else math.inf
            step = min(1 / 60, 0.9 * limit) if limit > 0 else 1e-3 / 60
        self.step_size = check_real("step", step, positive=True)

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
        """Which vertices are pinned, shape (n,): a copy; assign indices or flags to change it."""
        flags: NDArray[np.bool_] = self._native.pinned.astype(bool)
        return flags

    @pinned.setter
    def pinned(self, pinned: ArrayLike) -> None:
        with self._own():
            self._native.pinned = check_pinned(pinned, len(self))

    @property
    def report(self) -> Any:
        """What the last step of implicit Euler took.

        `converged`, `iterations`, `factorizations`, `backtracks`, `minimisations` (one for each
        time that friction was lagged), `failed` (steps done again in halves), `residuals` (the
        largest component of the gradient [N] at the start and after each iteration of the last
        minimisation) and `friction_converged`.
        """
        return self._native.report

    def step(self, dt: float | None = None) -> None:
        """Take one step.

        Parameters
        ----------
        dt : float, optional
            Its size [s], above 0; `step_size` unless given.

        Raises
        ------
        InputError
            If `dt` is wrong.
        NonFiniteError, ConvergenceError
            With the time, and the vertex or the residuals; the state is then unchanged.
        """
        dt = self.step_size if dt is None else check_real("dt", dt, positive=True)
        with self._own():
            self._native.step(dt)

    def advance(self, duration: float) -> None:
        """Take steps of `step_size` over a duration; the last is shortened to end there.

        Parameters
        ----------
        duration : float
            How long [s], at least 0.

        Raises
        ------
        InputError
            If `duration` is wrong.
        NonFiniteError, ConvergenceError
            As `step`; the state is then the last good step.
        """
        duration = check_real("duration", duration, nonnegative=True)
        end = self.time + duration
        if not math.isfinite(end):
            raise InputError(f"duration: the time {self.time} + {duration} is not finite")
        ratio = duration / self.step_size
        count = round(ratio) if abs(ratio - round(ratio)) <= 1e-9 * max(1, ratio) else ratio
        with self._own():
            for _ in range(math.floor(count)):
                self._native.step(self.step_size)
            if count != math.floor(count):
                self._native.step(end - self.time)
            if duration > 0:
                self._native.time = end

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
        if self.integrator in ("semi_implicit_euler", "velocity_verlet"):
            name = {"semi_implicit_euler": "symplectic_euler"}.get(self.integrator, self.integrator)
            return stability_limit(name, ratio) / omega, reason
        name = {"explicit_euler": "euler"}.get(self.integrator, self.integrator)
        root = np.sqrt(complex(ratio**2 - 1))
        return max_stable_step(name, [omega * (-ratio - root), omega * (-ratio + root)]), reason

    def diagnostics(self) -> dict[str, float]:
        """Energies, momentum and what the last step took.

        Returns
        -------
        dict of str to float
            `kinetic_energy`, `potential_energy` (of springs or elements and of contact) and
            `gravitational_energy` [J]; `momentum_x`, `_y`, `_z` [N s]; `speed`, the largest
            [m/s]; `iterations`, `factorizations`, `failed` and `residual` [N] of the last step of
            implicit Euler; with colliders `distance`, the smallest of a free vertex [m].
        """
        report = self.report
        momentum = self._masses @ self.velocities
        values = {
            "kinetic_energy": self._native.kinetic_energy(),
            "potential_energy": self._native.potential_energy(),
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
                "failed": float(report.failed),
                "residual": report.residuals[-1] if report.residuals else 0.0,
            }
        if self.colliders:
            values["distance"] = self._native.closest()
        return values

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

    def state(self) -> dict[str, Any]:
        """Copy the whole state, that of the colliders too.

        Returns
        -------
        dict
            `time`, `positions`, `velocities`, `forces`, `targets` and `colliders`; for `restore`.
        """
        native = self._native
        return {
            "time": self.time,
            "positions": native.positions.copy(),
            "velocities": native.velocities.copy(),
            "forces": native.forces.copy(),
            "targets": native.targets.copy(),
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
        missing = set(_STATE) - set(state)
        if missing:
            raise InputError(f"state: {', '.join(sorted(missing))} missing")
        time = check_real("state['time']", state["time"])
        n = len(self)
        arrays = {
            name: check_array(f"state[{name!r}]", state[name], (n, 3), finite=False)
            for name in _STATE[1:5]
        }
        shape = collider_states(self.colliders).shape
        moving = check_array("state['colliders']", state["colliders"], shape)
        with self._own():
            self._native.time = time
            for name, values in arrays.items():
                getattr(self._native, name)[:] = values
            for collider, values in zip(self.colliders, moving, strict=True):
                collider._native.state = values.tolist()
