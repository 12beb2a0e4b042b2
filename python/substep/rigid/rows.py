"""The arrays of rigid bodies: views of their state, what follows from it, and setting it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_choice
from ..base.quaternions import multiply, rotate, unit_quaternions
from ..base.simulation import Simulation
from ..errors import InputError
from .fixtures import MOTIONS, Fixture, is_ground

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

_DYNAMIC, _STATIC = MOTIONS.index("dynamic"), MOTIONS.index("static")


class BodyRows(Simulation):
    """Bodies as rows of arrays in the order of their ids; make `RigidBodies`.

    `_native` has views and setters by row; here are ids, and the frames of shapes.
    """

    _ids: Ids
    _made: list[tuple[tuple[Fixture, ...], str, Any]]
    _centres: Array  # of mass, in the frame of the shape
    _axes: Array  # that take the principal frame into that of the shape
    _weights: Array  # mass and principal moments, NaN for bodies that were added without

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def ids(self) -> Ids:
        """Numbers of the bodies, ascending, shape (n,): the order of all arrays; a copy."""
        return self._ids.copy()

    @property
    def positions(self) -> Array:
        """Centres of mass [m], shape (n, 3): a view, to be read and written between steps."""
        view: Array = self._native.positions
        return view

    @property
    def rotations(self) -> Array:
        """Unit quaternions (w, x, y, z) that take principal axes into the world, shape (n, 4).

        A view, to be read and written between steps; what is written is normalised by the next
        step.
        """
        view: Array = self._native.rotations
        return view

    @property
    def momenta(self) -> Array:
        """Momenta [kg m/s], shape (n, 3): a view, to be read and written between steps.

        Of kinematic bodies, which have no mass, the velocities [m/s].
        """
        view: Array = self._native.momenta
        return view

    @property
    def angular_momenta(self) -> Array:
        """Angular momenta about the centres of mass [kg m^2/s], shape (n, 3): a view as `momenta`.

        Of kinematic bodies the angular velocities [rad/s].
        """
        view: Array = self._native.angular_momenta
        return view

    @property
    def forces(self) -> Array:
        """External forces [N], shape (n, 3): a view; the next step uses them and sets them to 0."""
        view: Array = self._native.forces
        return view

    @property
    def torques(self) -> Array:
        """External torques about the centres [N m], shape (n, 3): a view as `forces`."""
        view: Array = self._native.torques
        return view

    @property
    def velocities(self) -> Array:
        """Velocities of the centres of mass [m/s], shape (n, 3); a copy."""
        rows: Array = self._native.velocities()
        return rows

    @property
    def angular_velocities(self) -> Array:
        """Angular velocities in the world [rad/s], shape (n, 3); a copy."""
        rows: Array = self._native.angular_velocities()
        return rows

    @property
    def orientations(self) -> Array:
        """Unit quaternions (w, x, y, z) that take the frames of the shapes into the world; a copy.

        They differ from `rotations` where principal axes are not those of the shape.
        """
        back = self._axes * (1.0, -1.0, -1.0, -1.0)
        return multiply(self._native.rotations, back)

    @property
    def origins(self) -> Array:
        """Where the origins of the frames of the shapes are [m], shape (n, 3); a copy.

        They differ from `positions` where the centre of mass is not the origin of the shape.
        """
        origins: Array = self._native.positions - rotate(self.orientations, self._centres)
        return origins

    @property
    def masses(self) -> Array:
        """Masses [kg], shape (n,), infinite unless dynamic; a copy."""
        masses: Array = self._native.masses()
        return masses

    @property
    def inertia(self) -> Array:
        """Principal moments of inertia [kg m^2], shape (n, 3), infinite unless dynamic; a copy."""
        moments: Array = self._native.inertia()
        return moments

    @property
    def motions(self) -> NDArray[np.str_]:
        """'dynamic', 'kinematic' or 'static', shape (n,); a copy."""
        return np.array(MOTIONS)[self._native.motions()]

    @property
    def asleep(self) -> NDArray[np.bool_]:
        """Which bodies sleep, shape (n,); a copy."""
        flags: NDArray[np.bool_] = self._native.asleep().astype(bool)
        return flags

    def set_velocities(
        self,
        velocities: ArrayLike | None = None,
        angular_velocities: ArrayLike | None = None,
        ids: ArrayLike | None = None,
    ) -> None:
        """Give bodies velocities; they wake. Static ones have none.

        Parameters
        ----------
        velocities : array_like, shape (3,) for all or (m, 3), optional
            Of the centres of mass [m/s]; stay as they are unless given.
        angular_velocities : array_like, shape (3,) for all or (m, 3), optional
            In the world [rad/s]; stay as they are unless given.
        ids : int or array_like of int, shape (m,), optional
            Which; all but static ones unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong, or a body is static; nothing is changed then.
        """
        with self._own():
            rows = (
                np.flatnonzero(self._native.motions() != _STATIC)
                if ids is None
                else self._rows(ids)
            )
            v = self._vectors("velocities", velocities, rows, self._native.velocities)
            w = self._vectors(
                "angular_velocities", angular_velocities, rows, self._native.angular_velocities
            )
            self._native.set_velocities(rows, v, w)

    def set_poses(
        self,
        positions: ArrayLike | None = None,
        rotations: ArrayLike | None = None,
        ids: ArrayLike | None = None,
    ) -> None:
        """Put bodies elsewhere, as `add` does: the frames of their shapes; velocities stay.

        They wake, and so do those that they touch.

        Parameters
        ----------
        positions : array_like, shape (3,) for all or (m, 3), optional
            Where the origins of their shapes come [m]; stay as they are unless given.
        rotations : array_like, shape (4,) for all or (m, 4), optional
            Quaternions (w, x, y, z) of their shapes; are normalised. They stay unless given.
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            rows = np.arange(len(self)) if ids is None else self._rows(ids)
            x = self._vectors("positions", positions, rows, lambda: self.origins)
            q = self._vectors("rotations", rotations, rows, lambda: self.orientations)
            poses = principal_frames(x, q, self._centres[rows], self._axes[rows])
            self._native.set_poses(rows, *poses)

    def set_motion(self, motion: str, ids: ArrayLike) -> None:
        """Let bodies move another way; they keep their poses and velocities, but stop if static.

        Parameters
        ----------
        motion : {'dynamic', 'kinematic', 'static'}
            As of `add`. What was added as a static or kinematic body has no mass and cannot become
            dynamic; planes and meshes stay static.
        ids : int or array_like of int, shape (m,)
            Which.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        code = MOTIONS.index(check_choice("motion", motion, MOTIONS))
        with self._own():
            rows = self._rows(ids)
            for row in rows if code != _STATIC else ():
                if any(is_ground(fixture.shape) for fixture in self._made[row][0]):
                    raise InputError(f"motion: body {self._ids[row]} has a plane or a mesh")
                if code == _DYNAMIC and np.isnan(self._weights[row, 0]):
                    raise InputError(f"motion: body {self._ids[row]} has no mass")
            self._native.set_motion(rows, code, self._weights[rows])

    def apply_force(self, ids: ArrayLike, force: ArrayLike, point: ArrayLike | None = None) -> None:
        """Add forces to those of the next step, which uses them up. Bodies wake.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,)
            On which bodies.
        force : array_like, shape (3,) for all or (m, 3)
            [N].
        point : array_like, shape (3,) for all or (m, 3), optional
            Where they act, in the world [m]; at the centres of mass unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            rows = self._rows(ids)
            F = self._vectors("force", force, rows, None)
            x = self._vectors("point", point, rows, lambda: self._native.positions)
            self._native.apply_forces(rows, F, x)

    def apply_impulse(
        self, ids: ArrayLike, impulse: ArrayLike, point: ArrayLike | None = None
    ) -> None:
        """Change momenta at once. Bodies wake.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,)
            Of which bodies.
        impulse : array_like, shape (3,) for all or (m, 3)
            [N s].
        point : array_like, shape (3,) for all or (m, 3), optional
            Where it acts, in the world [m]; at the centres of mass unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            rows = self._rows(ids)
            J = self._vectors("impulse", impulse, rows, None)
            x = self._vectors("point", point, rows, lambda: self._native.positions)
            self._native.apply_impulses(rows, J, x)

    def wake(self, ids: ArrayLike | None = None) -> None:
        """Wake bodies, and with them those that they rest on or hang from.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        IndexError
            If there is no such body.
        """
        with self._own():
            self._native.wake(np.arange(len(self)) if ids is None else self._rows(ids))

    def _vectors(self, name: str, value: ArrayLike | None, rows: Ids, present: Any) -> Array:
        """A new array of one row for each body, from one for all, one each, or as they are."""
        if value is None and present is not None:
            kept: Array = np.ascontiguousarray(present()[rows])
            return kept
        columns = 4 if name == "rotations" else 3
        shape = (columns,) if is_one(value) else (len(rows), columns)
        check: Any = unit_quaternions if columns == 4 else check_array
        return np.array(np.broadcast_to(check(name, value, shape), (len(rows), columns)))

    def _rows(self, ids: ArrayLike) -> Ids:
        """Rows of bodies, from one id or several."""
        try:
            wanted = np.asarray(ids)
        except ValueError:
            if not isinstance(ids, (list, tuple)):
                raise
            raise InputError("ids: expected integers, shape (m,)") from None
        if wanted.size == 0:
            wanted = wanted.astype(np.int64)
        if wanted.ndim > 1 or wanted.dtype.kind not in "iu":
            raise InputError("ids: expected integers, shape (m,)")
        wanted = np.atleast_1d(wanted)
        rows = np.searchsorted(self._ids, wanted.astype(np.int64))
        wrong = rows >= len(self._ids)
        wrong[~wrong] = self._ids[rows[~wrong]] != wanted[~wrong]
        if wrong.any():
            k = int(np.argmax(wrong))
            raise IndexError(f"ids[{k}]: there is no body {wanted[k]}")
        return rows.astype(np.int64)

    def _row(self, name: str, body: Any) -> int:
        """The row of one body."""
        if np.ndim(np.asarray(body)) != 0 or np.asarray(body).dtype.kind not in "iu":
            raise InputError(f"{name}: expected the id of a body, got {body!r}")
        return int(self._rows(body)[0])


def is_one(value: Any) -> bool:
    """Whether it is one vector for all, rather than rows."""
    try:
        return np.ndim(np.asarray(value)) == 1
    except ValueError:
        if not isinstance(value, (list, tuple)):  # the caller's own __array__ raised it
            raise
        return False  # rows of unequal length: check_array says so


def principal_frames(x: Array, q: Array, centres: Array, axes: Array) -> tuple[Array, Array]:
    """Poses of principal frames at the centres of mass, from those of the frames of shapes."""
    return x + rotate(q, centres), multiply(q, np.broadcast_to(axes, q.shape))
