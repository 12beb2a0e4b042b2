"""The arrays of rigid bodies: views of their state, what follows from it, and setting it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, check_array, check_choice, in_range, is_callers
from ..base.quaternions import multiply, rotate, unit_quaternions
from ..base.rows import Numbered, find_rows, find_rows_or_all, read_only
from ..errors import InputError
from .fixtures import MOTIONS, Fixture, is_ground

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

_SEVERAL = 4.0  # whose square is more than the vectors of a body, whose squares are added up
_DYNAMIC, _STATIC = MOTIONS.index("dynamic"), MOTIONS.index("static")


class BodyRows(Numbered):
    """Bodies as rows of arrays in the order of their ids; make `RigidBodies`.

    `_native` has views and setters of principal frames, by row; here are ids, and the frames that
    the user has put in.
    """

    _what = "body"
    _ids: Ids
    _made: list[tuple[tuple[Fixture, ...], str, Any]]
    _centres: Array  # of mass, in the frame of the body
    _axes: Array  # that take the principal frame into that of the body
    _weights: Array  # mass and principal moments, NaN for bodies that were added without

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def ids(self) -> Ids:
        """Numbers of the bodies, ascending, shape (n,): the order of all arrays; read-only."""
        ids: Ids = read_only(self._ids.copy())
        return ids

    @property
    def positions(self) -> Array:
        """Where the bodies are, as `add` put them [m], shape (n, 3); read-only.

        The origins of their frames, in which their shapes are given; `set_positions` moves them.
        """
        back = rotate(self._frame_rotations(), self._centres)
        return read_only(self._native.positions - back)

    @property
    def rotations(self) -> Array:
        """Unit quaternions (w, x, y, z) of the bodies, as `add` turned them; read-only.

        They take the frames of the bodies into the world, shape (n, 4); `set_rotations` turns them.
        """
        return read_only(self._frame_rotations())

    def _frame_rotations(self) -> Array:
        return multiply(self._native.rotations, self._axes * (1.0, -1.0, -1.0, -1.0))

    @property
    def centers_of_mass(self) -> Array:
        """Centres of mass [m], shape (n, 3): a view, to be read and written between steps.

        They differ from `positions` where a body's centre of mass is not the origin of its frame.
        """
        view: Array = self._native.positions
        return view

    @property
    def principal_rotations(self) -> Array:
        """Unit quaternions (w, x, y, z) that take principal axes into the world, shape (n, 4).

        A view, to be read and written between steps; what is written is normalised by the next
        step. They differ from `rotations` where principal axes are not those of the frame.
        """
        view: Array = self._native.rotations
        return view

    @property
    def momenta(self) -> Array:
        """Momenta [kg m/s], shape (n, 3): a view, to be read and written between steps.

        Of kinematic bodies, which have no mass, the velocities [m/s]. Static ones stand still: what
        is written there moves nothing.
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
        """External forces at the centres of mass [N], shape (n, 3): a view.

        The next step uses them up: after it they are 0.
        """
        view: Array = self._native.forces
        return view

    @property
    def torques(self) -> Array:
        """External torques about the centres of mass [N m], shape (n, 3): a view as `forces`."""
        view: Array = self._native.torques
        return view

    @property
    def velocities(self) -> Array:
        """Velocities of the centres of mass [m/s], shape (n, 3); read-only."""
        return read_only(self._native.velocities())

    @property
    def angular_velocities(self) -> Array:
        """Angular velocities in the world [rad/s], shape (n, 3); read-only."""
        return read_only(self._native.angular_velocities())

    @property
    def masses(self) -> Array:
        """Masses [kg], shape (n,), infinite unless dynamic; read-only."""
        return read_only(self._native.masses())

    @property
    def inertia(self) -> Array:
        """Principal moments [kg m^2], shape (n, 3), infinite unless dynamic; read-only."""
        return read_only(self._native.inertia())

    @property
    def motions(self) -> NDArray[np.str_]:
        """'dynamic', 'kinematic' or 'static', shape (n,); read-only."""
        return read_only(np.array(MOTIONS)[self._native.motions()])

    @property
    def asleep(self) -> NDArray[np.bool_]:
        """Which bodies sleep, shape (n,); read-only."""
        return read_only(self._native.asleep().astype(bool))

    def set_positions(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Move bodies; rotations and velocities stay. They and bodies that they touch wake.

        Parameters
        ----------
        values : array_like, shape (3,) for all or (m, 3)
            Their positions, as of `add` [m].
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        rows = self._rows_or_all(ids)
        x = check_squares("values", self._vectors("values", values, rows))
        self._set_frames(rows, x, self._frame_rotations()[rows])

    def set_rotations(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Turn bodies about their positions; velocities stay. They and bodies in contact wake.

        Parameters
        ----------
        values : array_like, shape (4,) for all or (m, 4)
            Their rotations (w, x, y, z), as of `add`; are normalised.
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        rows = self._rows_or_all(ids)
        q = self._quaternions("values", values, rows)
        self._set_frames(rows, self.positions[rows], q)

    def _set_frames(self, rows: Ids, x: Array, q: Array) -> None:
        poses = principal_frames(x, q, self._centres[rows], self._axes[rows])
        self._native.set_poses(rows, *poses)

    def set_velocities(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Give centres of mass velocities. Bodies wake.

        Parameters
        ----------
        values : array_like, shape (3,) for all or (m, 3)
            Their velocities [m/s].
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given, of whom static ones stand still.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong, or a body of `ids` is static; nothing is changed then.
        """
        self._native.set_velocities(*self._moving(values, ids))

    def set_angular_velocities(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Let bodies turn about their centres of mass. They wake.

        Parameters
        ----------
        values : array_like, shape (3,) for all or (m, 3)
            Their angular velocities in the world [rad/s].
        ids : int or array_like of int, shape (m,), optional
            As of `set_velocities`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong, or a body of `ids` is static; nothing is changed then.
        """
        self._native.set_angular_velocities(*self._moving(values, ids))

    def _moving(self, values: ArrayLike, ids: ArrayLike | None) -> tuple[Ids, Array]:
        """Rows that are not static unless they are asked for, and their values."""
        rows = self._rows_or_all(ids)
        vectors = self._vectors("values", values, rows)
        check_momenta("values", vectors, self._weights[rows])
        if ids is None:
            rows = np.flatnonzero(self._native.motions() != _STATIC)
            vectors = vectors[rows]
        return rows, vectors

    def set_forces(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Set external forces of the next step, which uses them up: after it they are 0.

        Parameters
        ----------
        values : array_like, shape (3,) for all or (m, 3)
            Forces at the centres of mass [N].
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        rows = self._rows_or_all(ids)
        self._native.forces[rows] = check_squares("values", self._vectors("values", values, rows))

    def set_torques(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Set external torques of the next step, which uses them up: after it they are 0.

        Parameters
        ----------
        values : array_like, shape (3,) for all or (m, 3)
            Torques about the centres of mass [N m].
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        rows = self._rows_or_all(ids)
        self._native.torques[rows] = check_squares("values", self._vectors("values", values, rows))

    def set_motion(self, motion: str, ids: ArrayLike) -> None:
        """Let bodies move another way; they keep their poses and velocities, but stop if static.

        Parameters
        ----------
        motion : {'dynamic', 'kinematic', 'static'}
            As of `add`. What was added as a static or kinematic body has no mass and cannot become
            dynamic; planes, meshes and height fields stay static.
        ids : int or array_like of int, shape (m,)
            Which.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        code = MOTIONS.index(check_choice("motion", motion, MOTIONS))
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
        rows = self._rows(ids)
        F = self._vectors("force", force, rows)
        x = self._points(point, rows)
        self._check_added("force", self._native.forces, self._native.torques, rows, F, x)
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
        rows = self._rows(ids)
        J = self._vectors("impulse", impulse, rows)
        x = self._points(point, rows)
        momenta, angular = self._native.momenta, self._native.angular_momenta
        self._check_added("impulse", momenta, angular, rows, J, x)
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
        self._native.wake(self._rows_or_all(ids))

    def _check_added(
        self, name: str, linear: Array, angular: Array, rows: Ids, pushes: Array, x: Array
    ) -> None:
        """Refuse pushes at points that make sums whose squares are not finite."""
        bodies, of = np.unique(rows, return_inverse=True)
        with np.errstate(over="ignore", invalid="ignore"):
            turns = np.cross(x - self._native.positions[rows], pushes)
            for kept, added in ((linear, pushes), (angular, turns)):
                total = kept[bodies]
                np.add.at(total, of, added)
                if not np.isfinite(np.square(_SEVERAL * total).sum(axis=-1)).all():
                    raise InputError(
                        f"{name}: expected numbers of a size that can be computed with"
                    )

    def _points(self, point: ArrayLike | None, rows: Ids) -> Array:
        if point is not None:
            return self._vectors("point", point, rows)
        centers: Array = self._native.positions[rows]
        return centers

    def _vectors(self, name: str, value: ArrayLike, rows: Ids) -> Array:
        """A new array of one row for each body, from one for all or one each."""
        shape = (3,) if is_one(value) else (len(rows), 3)
        return np.array(np.broadcast_to(check_array(name, value, shape), (len(rows), 3)))

    def _quaternions(self, name: str, value: ArrayLike, rows: Ids) -> Array:
        """As `_vectors`, of length 1."""
        shape = (4,) if is_one(value) else (len(rows), 4)
        return np.array(np.broadcast_to(unit_quaternions(name, value, shape), (len(rows), 4)))

    def _rows(self, ids: ArrayLike) -> Ids:
        """Rows of bodies, from one id or several."""
        return find_rows(ids, self._ids, self._what)

    def _rows_or_all(self, ids: ArrayLike | None) -> Ids:
        return find_rows_or_all(ids, self._ids, self._what)

    def _row(self, name: str, body: Any) -> int:
        """The row of one body."""
        number = as_array(name, body)
        if number.ndim or number.dtype.kind not in "iu":
            raise InputError(f"{name}: expected the id of a body, got {body!r}")
        return int(find_rows(number, self._ids, self._what, name)[0])


def is_one(value: Any) -> bool:
    """Whether it is one vector for all, rather than rows."""
    try:
        return np.ndim(np.asarray(value)) == 1
    except ValueError as error:
        if is_callers(error):
            raise
        return False  # no array, or rows of unequal length: check_array says so


def check_squares(name: str, vectors: Array) -> Array:
    """The vectors, where the squares of their lengths are finite, and sums of some such squares."""
    with in_range(name):
        np.square(_SEVERAL * vectors).sum(axis=-1)
    return vectors


def check_momenta(name: str, velocities: Array, weights: Array) -> None:
    """Refuse velocities, or angular ones, that give bodies of these weights too large momenta."""
    with in_range(name):
        # Of those without mass, which have NaN, the velocities are what is kept.
        momenta = velocities * np.fmax(weights.max(axis=-1), 1.0)[..., None]
    check_squares(name, momenta)


def principal_frames(x: Array, q: Array, centres: Array, axes: Array) -> tuple[Array, Array]:
    """Poses of principal frames at the centres of mass, from those of the frames of bodies."""
    return x + rotate(q, centres), multiply(q, np.broadcast_to(axes, q.shape))
