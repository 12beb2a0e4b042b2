"""The arrays of many worlds: copies, and how they are set."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, check_array, describe
from ..base.quaternions import multiply, rotate, unit_quaternions
from ..base.rows import read_only, rows_of
from ..base.worlds import Worlds, check_once, find_worlds
from ..errors import InputError
from .bodies import RigidBodies
from .joint import Joint
from .rows import check_momenta, check_squares, principal_frames

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Where = tuple[Ids, Ids]  # worlds, shape (k,), and rows of bodies in each, shape (k, m)


class BatchRows(Worlds):
    """Bodies as rows of arrays by world; makes `RigidBatch`."""

    _made: list[RigidBodies]  # what each world is made of
    _ids: Ids  # this and what follows: see _remember_frames()
    _centres: Array
    _axes: Array
    _weights: Array
    _alike: bool  # the ids of all worlds
    _principal: bool  # are the frames of all bodies

    def __len__(self) -> int:
        return len(self._made)

    @property
    def _class(self) -> str:
        return "RigidBodies"

    @property
    def counts(self) -> Ids:
        """Bodies of each world, shape (w,); read-only."""
        return read_only(self._native.counts())

    @property
    def contact_counts(self) -> Ids:
        """Contacts of each world in its last step, shape (w,): pairs of shapes; read-only."""
        return read_only(self._native.contact_counts())

    @property
    def ids(self) -> Ids:
        """Numbers of the bodies in their world, shape (w, n); read-only.

        They ascend, and are the order of all arrays; -1 where a world has fewer bodies.
        """
        return read_only(self._ids.copy())

    def rows(self, ids: ArrayLike) -> Any:
        """Where bodies are in all arrays, of worlds that have the same bodies.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,)
            Which.

        Returns
        -------
        int or ndarray of int64, shape (m,)
            Their rows.

        Raises
        ------
        InputError, IndexError
            If a world has no such body, or has it in another row than others.

        Examples
        --------
        >>> import substep
        >>> world = substep.RigidBodies()
        >>> first, second = world.add(substep.rigid.Sphere(0.1), [[0, 0, 1], [0, 0, 2]])
        >>> world.remove(first)
        >>> batch = substep.RigidBatch(world, 4)
        >>> batch.positions[:, batch.rows(second), 2].tolist()
        [2.0, 2.0, 2.0, 2.0]
        """
        if ids is None:
            raise InputError("ids: expected integers, shape (m,), got None")
        _, rows = self._where(ids, None)
        if len(rows) and (rows != rows[0]).any():
            raise InputError("ids: the worlds have these bodies in different rows; see `ids`")
        if not len(rows):
            raise IndexError("ids: there is no world")
        return rows[0] if np.ndim(ids) else int(rows[0, 0])

    @property
    def positions(self) -> Array:
        """Where the bodies are, as of `RigidBodies` [m], shape (w, n, 3); read-only."""
        return read_only(self._poses()[0])

    @property
    def rotations(self) -> Array:
        """Unit quaternions (w, x, y, z) of the bodies, as of `RigidBodies`; read-only."""
        return read_only(self._poses()[1])

    @property
    def centers_of_mass(self) -> Array:
        """Centres of mass [m], shape (w, n, 3); read-only."""
        return read_only(self._native.positions())

    @property
    def principal_rotations(self) -> Array:
        """Unit quaternions (w, x, y, z) that take principal axes into the world; read-only."""
        return read_only(self._native.rotations())

    @property
    def velocities(self) -> Array:
        """Velocities of the centres of mass [m/s], shape (w, n, 3); read-only."""
        return read_only(self._native.velocities())

    @property
    def angular_velocities(self) -> Array:
        """Angular velocities in the world [rad/s], shape (w, n, 3); read-only."""
        return read_only(self._native.angular_velocities())

    @property
    def momenta(self) -> Array:
        """Momenta [kg m/s], shape (w, n, 3); read-only, as of `RigidBodies.momenta`."""
        return read_only(self._native.momenta())

    @property
    def angular_momenta(self) -> Array:
        """Angular momenta about the centres of mass [kg m^2/s], shape (w, n, 3); read-only."""
        return read_only(self._native.angular_momenta())

    @property
    def forces(self) -> Array:
        """External forces [N], shape (w, n, 3); read-only; see `set_forces`."""
        return read_only(self._native.forces())

    @property
    def torques(self) -> Array:
        """External torques [N m], shape (w, n, 3); read-only; see `set_torques`."""
        return read_only(self._native.torques())

    def set_positions(
        self, values: ArrayLike, ids: ArrayLike | None = None, *, worlds: ArrayLike | None = None
    ) -> None:
        """Put bodies elsewhere, as `RigidBodies.set_positions` does.

        Parameters
        ----------
        values : array_like, shape (k, m, 3) or (m, 3) for all worlds
            Their positions [m]; of one id standing alone also one row standing alone.
        ids : int or array_like of int, shape (m,), optional
            Bodies, by their ids in the worlds; all unless given, one for each row:
            worlds that have fewer pass over the others.
        worlds : int or array_like of int, shape (k,), optional
            Which worlds; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        where = self._where(ids, worlds)
        x = check_squares("values", self._given(values, ids, where, 3))
        self._set_frames(where, x, self._pick(self._poses()[1], where))

    def set_rotations(
        self, values: ArrayLike, ids: ArrayLike | None = None, *, worlds: ArrayLike | None = None
    ) -> None:
        """Turn bodies about their positions, as `RigidBodies.set_rotations` does.

        Parameters
        ----------
        values : array_like, shape (k, m, 4) or (m, 4) for all worlds
            Their rotations (w, x, y, z); are normalised.
        ids, worlds : int or array_like of int, optional
            As of `set_positions`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        where = self._where(ids, worlds)
        q = self._given(values, ids, where, 4)
        self._set_frames(where, self._pick(self._poses()[0], where), q)

    def set_velocities(
        self, values: ArrayLike, ids: ArrayLike | None = None, *, worlds: ArrayLike | None = None
    ) -> None:
        """Give centres of mass velocities; static bodies stand still.

        Parameters
        ----------
        values : array_like, shape (k, m, 3) or (m, 3) for all worlds
            Their velocities [m/s].
        ids, worlds : int or array_like of int, optional
            As of `set_positions`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        where = self._where(ids, worlds)
        v = self._velocities("values", rows_of(values, ids), where)
        w = self._pick(self._native.angular_velocities(), where)
        self._write("set_velocities", where, v, w)

    def set_angular_velocities(
        self, values: ArrayLike, ids: ArrayLike | None = None, *, worlds: ArrayLike | None = None
    ) -> None:
        """Let bodies turn about their centres of mass; static ones stand still.

        Parameters
        ----------
        values : array_like, shape (k, m, 3) or (m, 3) for all worlds
            Their angular velocities in the world [rad/s].
        ids, worlds : int or array_like of int, optional
            As of `set_positions`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        where = self._where(ids, worlds)
        w = self._velocities("values", rows_of(values, ids), where)
        v = self._pick(self._native.velocities(), where)
        self._write("set_velocities", where, v, w)

    def set_forces(
        self, values: ArrayLike, ids: ArrayLike | None = None, *, worlds: ArrayLike | None = None
    ) -> None:
        """Set external forces of the next step, which uses them up: after it they are 0.

        Parameters
        ----------
        values : array_like, shape (k, m, 3) or (m, 3) for all worlds
            Forces at the centres of mass [N].
        ids, worlds : int or array_like of int, optional
            As of `set_positions`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        where = self._where(ids, worlds)
        values = check_squares("values", self._given(values, ids, where, 3))
        self._write("set_forces", where, values)

    def set_torques(
        self, values: ArrayLike, ids: ArrayLike | None = None, *, worlds: ArrayLike | None = None
    ) -> None:
        """Set external torques of the next step, which uses them up: after it they are 0.

        Parameters
        ----------
        values : array_like, shape (k, m, 3) or (m, 3) for all worlds
            Torques about the centres of mass [N m].
        ids, worlds : int or array_like of int, optional
            As of `set_positions`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        where = self._where(ids, worlds)
        values = check_squares("values", self._given(values, ids, where, 3))
        self._write("set_torques", where, values)

    @property
    def joint_coordinates(self) -> Array:
        """Angles or lengths of the joints [rad or m], shape (w, j), in the order of making.

        0 for joints that have none, NaN where a world has fewer joints; read-only.
        """
        return read_only(self._native.joint_coordinates())

    def set_motor_targets(
        self, joint: Joint, targets: ArrayLike, worlds: ArrayLike | None = None
    ) -> None:
        """Give the motor of a joint another target in each world.

        Parameters
        ----------
        joint : Joint
            Of the template, with a motor.
        targets : float or array_like, shape (k,)
            Speeds of a `SpeedMotor` [rad/s or m/s], coordinates of a `SpringMotor` [rad or m].
        worlds : int or array_like of int, shape (k,), optional
            As of `set_positions`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        if not isinstance(joint, Joint):
            raise TypeError(f"joint: expected a Joint, got {describe(joint)}")
        chosen = find_worlds("worlds", worlds, len(self))
        values = as_array("targets", targets)
        values = check_array("targets", values, (len(chosen),) if values.ndim else ())
        rows = {made: made._joint_ids for made in {*(self._made[w] for w in chosen)}}
        row = joint._row()
        for ids in rows.values():
            if row >= len(ids) or ids[row] != joint.number:
                raise IndexError(f"joint: there is no joint {joint.number} in all worlds")
        if joint.motor is None:
            raise InputError("joint: expected one with a motor")
        spread = np.ascontiguousarray(np.broadcast_to(values, len(chosen)))
        self._native.set_motor_targets(chosen, row, spread)

    def _remember_frames(self) -> None:
        """Ids, centres of mass, principal axes and weights of the bodies, by world and row."""
        most = max(map(len, self._made), default=0)
        self._ids = np.full((len(self), most), -1, np.int64)
        self._centres, self._axes = np.zeros((len(self), most, 3)), np.zeros((len(self), most, 4))
        self._axes[..., 0] = 1.0
        self._weights = np.zeros((len(self), most, 4))
        for w, made in enumerate(self._made):
            n = len(made)
            self._ids[w, :n], self._centres[w, :n] = made._ids, made._centres
            self._axes[w, :n], self._weights[w, :n] = made._axes, made._weights
        self._alike = all(np.array_equal(made._ids, self._made[0]._ids) for made in self._made)
        self._principal = not self._centres.any() and not self._axes[..., 1:].any()

    def _poses(self) -> tuple[Array, Array]:
        """Positions and rotations of the bodies, as new arrays."""
        x, q = self._native.positions(), self._native.rotations()
        return self._to_frames(x, q, self._centres, self._axes)

    def _to_frames(self, x: Array, q: Array, centres: Array, axes: Array) -> tuple[Array, Array]:
        """Poses of the frames of bodies, from those of principal frames; may be the same arrays."""
        if self._principal:
            return x, q
        q = multiply(q, axes * (1.0, -1.0, -1.0, -1.0))
        return x - rotate(q, centres), q

    def _set_frames(self, where: Where, x: Array, q: Array) -> None:
        centres, axes = self._pick(self._centres, where), self._pick(self._axes, where)
        self._write("set_poses", where, *principal_frames(x, q, centres, axes))

    def _pick(self, rows: Array, where: Where) -> Array:
        """Those of these worlds and bodies."""
        worlds, places = where
        picked: Array = rows[worlds[:, None], places]
        return picked

    def _write(self, setter: str, where: Where, *values: Array) -> None:
        """Calls the setter, once for all worlds that have these bodies in the same rows."""
        worlds, places = where
        write, left = getattr(self._native, setter), np.arange(len(worlds))
        while len(left):
            same = (places[left] == places[left[0]]).all(axis=1)
            group, left = left[same], left[~same]
            parts = (np.ascontiguousarray(rows[group]) for rows in values)
            write(worlds[group], places[group[0]], *parts)

    def _where(self, ids: ArrayLike | None, worlds: ArrayLike | None) -> Where:
        """Worlds, and the rows of these bodies in each; of all, those that a world may not have."""
        chosen = find_worlds("worlds", worlds, len(self))
        if ids is None:
            every = np.arange(self._ids.shape[1])
            return chosen, np.broadcast_to(every, (len(chosen), len(every)))
        if not len(chosen):
            return chosen, np.zeros((0, as_array("ids", ids).size), np.int64)
        if self._alike:
            rows = self._made[chosen[0]]._rows(ids)
            check_once("ids", rows)
            return chosen, np.broadcast_to(rows, (len(chosen), len(rows)))
        each = []
        for w in chosen:
            try:
                each.append(self._made[w]._rows(ids))
            except IndexError as error:
                raise IndexError(f"world {w}: {error}") from None
            check_once("ids", each[-1])
        return chosen, np.array(each, np.int64)

    def _present(self, worlds: Ids) -> Ids:
        """Bodies of each of these worlds, as a column."""
        counts: Ids = self.counts[worlds][:, None]
        return counts

    def _given(self, values: ArrayLike, ids: ArrayLike | None, where: Where, columns: int) -> Array:
        return self._values("values", rows_of(values, ids), where, columns)

    def _values(self, name: str, value: ArrayLike, where: Where, columns: int) -> Array:
        """One row for each of these worlds and bodies."""
        worlds, places = where
        there = places < self._present(worlds)
        if check_array(name, value, finite=False).ndim == 3:
            rows = check_array(name, value, (*there.shape, columns), finite=False)
        else:
            rows = check_array(name, value, (there.shape[1], columns))
            rows = np.array(np.broadcast_to(rows, (*there.shape, columns)))
        rows[~there] = (1.0, 0.0, 0.0, 0.0)[:columns]  # of no body
        rows = check_array(name, rows)
        return unit_quaternions(name, rows, rows.shape) if columns == 4 else rows

    def _velocities(self, name: str, value: ArrayLike, where: Where) -> Array:
        rows = self._values(name, value, where, 3)
        check_momenta(name, rows, self._pick(self._weights, where))
        return rows
