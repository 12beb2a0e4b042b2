"""The arrays of many worlds: copies, and how they are set."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, describe
from ..base.quaternions import multiply, rotate, unit_quaternions
from ..base.simulation import Simulation
from ..errors import InputError
from .bodies import RigidBodies
from .joint import Joint
from .rows import principal_frames

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Where = tuple[Ids, Ids]  # worlds, and rows of bodies in each


class BatchRows(Simulation):
    """Bodies as rows of arrays by world; makes `RigidBatch`."""

    _made: list[RigidBodies]  # what each world is made of
    _frames: tuple[Array, Array]  # see _gather_frames()

    def __len__(self) -> int:
        return len(self._made)

    @property
    def times(self) -> Array:
        """Time of each world [s], shape (w,): that of its own state; a copy."""
        times: Array = self._native.times
        return times

    @property
    def counts(self) -> Ids:
        """Bodies of each world, shape (w,)."""
        counts: Ids = self._native.counts()
        return counts

    @property
    def contact_counts(self) -> Ids:
        """Contacts of each world in its last step, shape (w,): pairs of shapes."""
        counts: Ids = self._native.contact_counts()
        return counts

    @property
    def failures(self) -> list[str]:
        """Why a world takes no part any more, empty if it does; of `on_fail` 'mask'."""
        failures: list[str] = self._native.failures
        return failures

    @property
    def positions(self) -> Array:
        """Centres of mass [m], shape (w, n, 3); a copy."""
        rows: Array = self._native.positions()
        return rows

    @property
    def rotations(self) -> Array:
        """Unit quaternions (w, x, y, z) that take principal axes into the world; a copy."""
        rows: Array = self._native.rotations()
        return rows

    @property
    def origins(self) -> Array:
        """Where the origins of the frames of the shapes are [m], shape (w, n, 3); a copy."""
        centres, _ = self._frames
        origins: Array = self.positions - rotate(self.orientations, centres)
        return origins

    @property
    def orientations(self) -> Array:
        """Unit quaternions (w, x, y, z) that take frames of shapes into the world; a copy."""
        _, axes = self._frames
        return multiply(self.rotations, axes * (1.0, -1.0, -1.0, -1.0))

    @property
    def velocities(self) -> Array:
        """Velocities of the centres of mass [m/s], shape (w, n, 3); a copy."""
        rows: Array = self._native.velocities()
        return rows

    @property
    def angular_velocities(self) -> Array:
        """Angular velocities in the world [rad/s], shape (w, n, 3); a copy."""
        rows: Array = self._native.angular_velocities()
        return rows

    @property
    def momenta(self) -> Array:
        """Momenta [kg m/s], shape (w, n, 3); a copy, as of `RigidBodies.momenta`."""
        rows: Array = self._native.momenta()
        return rows

    @property
    def angular_momenta(self) -> Array:
        """Angular momenta about the centres of mass [kg m^2/s], shape (w, n, 3); a copy."""
        rows: Array = self._native.angular_momenta()
        return rows

    @property
    def forces(self) -> Array:
        """External forces [N], shape (w, n, 3); a copy; see `set_forces`."""
        rows: Array = self._native.forces()
        return rows

    @property
    def torques(self) -> Array:
        """External torques about the centres [N m], shape (w, n, 3); a copy; see `set_torques`."""
        rows: Array = self._native.torques()
        return rows

    def set_poses(
        self,
        positions: ArrayLike | None = None,
        rotations: ArrayLike | None = None,
        worlds: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
    ) -> None:
        """Put bodies elsewhere: the frames of their shapes, as `RigidBodies.set_poses` does.

        Parameters
        ----------
        positions : array_like, shape (k, m, 3) or (m, 3) for all worlds, optional
            Where the origins of their shapes come [m]; stay as they are unless given.
        rotations : array_like, shape (k, m, 4) or (m, 4) for all worlds, optional
            Quaternions (w, x, y, z) of their shapes; are normalised. They stay unless given.
        worlds : int or array_like of int, shape (k,), optional
            Which worlds; all unless given.
        bodies : int or array_like of int, shape (m,), optional
            Rows of the bodies; all unless given. Worlds without a row pass over it.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            where = self._where(worlds, bodies)
            x = self._rows_of("positions", positions, where, lambda: self.origins)
            q = self._rows_of("rotations", rotations, where, lambda: self.orientations)
            centres, axes = (values[np.ix_(*where)] for values in self._frames)
            frames = principal_frames(x, q, centres, axes)
            self._native.set_poses(*where, *map(np.ascontiguousarray, frames))

    def set_velocities(
        self,
        velocities: ArrayLike | None = None,
        angular_velocities: ArrayLike | None = None,
        worlds: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
    ) -> None:
        """Give bodies velocities; those of static bodies stay 0.

        Parameters
        ----------
        velocities : array_like, shape (k, m, 3) or (m, 3) for all worlds, optional
            Of the centres of mass [m/s]; stay as they are unless given.
        angular_velocities : array_like, shape (k, m, 3) or (m, 3) for all worlds, optional
            In the world [rad/s]; stay as they are unless given.
        worlds, bodies : int or array_like of int, optional
            As of `set_poses`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            where = self._where(worlds, bodies)
            v = self._rows_of("velocities", velocities, where, lambda: self.velocities)
            w = self._rows_of(
                "angular_velocities", angular_velocities, where, lambda: self.angular_velocities
            )
            self._native.set_velocities(*where, v, w)

    def set_forces(
        self,
        forces: ArrayLike,
        worlds: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
    ) -> None:
        """Set the external forces at the centres of mass; the next step uses them up.

        Parameters
        ----------
        forces : array_like, shape (k, m, 3) or (m, 3) for all worlds
            [N].
        worlds, bodies : int or array_like of int, optional
            As of `set_poses`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            where = self._where(worlds, bodies)
            self._native.set_forces(*where, self._rows_of("forces", forces, where))

    def set_torques(
        self,
        torques: ArrayLike,
        worlds: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
    ) -> None:
        """Set the external torques about the centres of mass; the next step uses them up.

        Parameters
        ----------
        torques : array_like, shape (k, m, 3) or (m, 3) for all worlds
            [N m].
        worlds, bodies : int or array_like of int, optional
            As of `set_poses`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        with self._own():
            where = self._where(worlds, bodies)
            self._native.set_torques(*where, self._rows_of("torques", torques, where))

    @property
    def joint_coordinates(self) -> Array:
        """Angles or lengths of the joints [rad or m], shape (w, j), in the order of making; a copy.

        0 for joints that have none, NaN where a world has fewer joints.
        """
        values: Array = self._native.joint_coordinates()
        return values

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
            As of `set_poses`.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        if not isinstance(joint, Joint):
            raise TypeError(f"joint: expected a Joint, got {describe(joint)}")
        with self._own():
            chosen, _ = self._where(worlds, None)
            values = np.asarray(targets)
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

    def _gather_frames(self) -> tuple[Array, Array]:
        """Centres of mass and principal axes in the frames of the shapes, by world and body."""
        most = max(map(len, self._made), default=0)
        centres, axes = np.zeros((len(self), most, 3)), np.zeros((len(self), most, 4))
        axes[..., 0] = 1.0
        for w, made in enumerate(self._made):
            centres[w, : len(made)], axes[w, : len(made)] = made._centres, made._axes
        return centres, axes

    def _where(self, worlds: ArrayLike | None, bodies: ArrayLike | None) -> tuple[Ids, Ids]:
        most = self._frames[0].shape[1]
        return (
            self._numbers("worlds", worlds, len(self)),
            self._numbers("bodies", bodies, most),
        )

    def _numbers(self, name: str, given: ArrayLike | None, count: int) -> Ids:
        if given is None:
            return np.arange(count)
        numbers = np.asarray(given)
        if numbers.size == 0:
            numbers = numbers.astype(np.int64)
        if numbers.ndim > 1 or numbers.dtype.kind not in "iu":
            raise InputError(f"{name}: expected integers, shape (k,)")
        numbers = np.atleast_1d(numbers)
        wrong = (numbers < 0) | (numbers >= count)
        if wrong.any():
            k = int(np.argmax(wrong))
            raise IndexError(f"{name}[{k}]: expected a number below {count}, got {numbers[k]}")
        if len(np.unique(numbers)) < len(numbers):
            raise InputError(f"{name}: expected each number once")
        return numbers.astype(np.int64)

    def _rows_of(
        self, name: str, value: ArrayLike | None, where: tuple[Ids, Ids], present: Any = None
    ) -> Array:
        """One row for each of these worlds and bodies, as given or as they are."""
        there = where[1] < self.counts[where[0]][:, None]
        columns = 4 if name == "rotations" else 3
        if value is None and present is not None:
            rows = present()[np.ix_(*where)]
        elif check_array(name, value, finite=False).ndim == 3:
            rows = np.array(check_array(name, value, (*there.shape, columns), finite=False))
        else:
            rows = check_array(name, value, (there.shape[1], columns))
            rows = np.array(np.broadcast_to(rows, (*there.shape, columns)))
        rows[~there] = (1.0, 0.0, 0.0, 0.0)[:columns]  # of no body
        rows = check_array(name, rows)
        if columns == 4 and value is not None:
            return unit_quaternions(name, rows, rows.shape)
        return np.ascontiguousarray(rows)
