"""Simulations of points with mass: arrays with a row for each, and how they are set."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .checks import as_array, as_integers, check_array, describe
from .simulation import Simulation

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


def read_only(array: NDArray[Any]) -> Any:
    """The array, read-only: where writing into it would change nothing, or what was checked."""
    array.flags.writeable = False
    return array


class Numbered(Simulation):
    """What has ids: arrays have a row for each, in ascending order; a subclass has `__len__`."""

    _what = "particle"

    @property
    def ids(self) -> Ids:
        """Numbers of the rows, ascending, shape (n,): the order of all arrays; read-only."""
        ids: Ids = read_only(np.arange(len(self), dtype=np.int64))
        return ids

    def __len__(self) -> int:
        raise NotImplementedError

    def rows(self, ids: ArrayLike) -> Any:
        """Where particles or bodies are in all arrays.

        Until something is removed, the row is the id.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,)
            Which.

        Returns
        -------
        int or ndarray of int64, shape (m,)
            Their rows, as of now.

        Raises
        ------
        InputError, IndexError
            If there is no such particle or body.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> first, second = bodies.add(substep.Sphere(0.1), [[0, 0, 1], [0, 0, 2]])
        >>> bodies.remove(first)
        >>> bodies.rows(second)
        0
        >>> bodies.positions[bodies.rows(second)].tolist()
        [0.0, 0.0, 2.0]
        """
        rows = find_rows(ids, self.ids, self._what)
        return rows if np.ndim(ids) else int(rows[0])


class Points(Numbered):
    """Particles or vertices with ids; a subclass has `ids` and writes rows of its arrays."""

    _dimension: int
    _gravity: Array
    _options: dict[str, Any]

    @property
    def gravity(self) -> Array:
        """Acceleration [m/s^2], shape (3,) or (2,), read-only; assign another to change it."""
        return self._gravity

    @gravity.setter
    def gravity(self, value: ArrayLike) -> None:
        pull: Array = read_only(check_array("gravity", value, (self._dimension,)))
        self._set_gravity(pull, self._options | {"gravity": [*pull.tolist(), 0.0][:3]})

    def _set_gravity(self, pull: Array, options: dict[str, Any]) -> None:
        self._replace(_gravity=pull, _options=options)

    def _replace(self, **parts: Any) -> None:
        """Make the native simulation anew of other parts, in the same state."""
        state, native = self._state(), self._native
        kept = {name: self.__dict__[name] for name in parts}
        try:
            self.__dict__.update(parts)
            made = self._make(state)
            made.threads = native.threads
            self._native = made
            self._put_state(self._checked(state))
        except BaseException:
            self.__dict__.update(kept, _native=native)
            raise

    def set_positions(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Put particles somewhere; their velocities stay.

        Parameters
        ----------
        values : array_like, shape (m, 3) or (m, 2)
            Their positions [m]; of one id standing alone also one row standing alone.
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("positions", values, ids)

    def set_velocities(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Give particles velocities.

        Parameters
        ----------
        values : array_like, shape (m, 3) or (m, 2)
            Their velocities [m/s], as of `set_positions`.
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("velocities", values, ids)

    def set_forces(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Set external forces of the next step, which uses them up: after it they are 0.

        Parameters
        ----------
        values : array_like, shape (m, 3) or (m, 2)
            Forces [N], as of `set_positions`.
        ids : int or array_like of int, shape (m,), optional
            On which; on all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("forces", values, ids)

    def _set(self, name: str, values: ArrayLike, ids: ArrayLike | None) -> None:
        rows = find_rows_or_all(ids, self.ids)
        values = rows_of(values, ids)
        self._write(name, self._vectors("values", values, len(rows)), rows)

    def _vectors(self, name: str, values: ArrayLike, count: int) -> Array:
        vectors: Array = check_array(name, values, (count, self._dimension))
        return vectors

    def _write(self, name: str, values: Array, rows: Ids) -> None:
        """Write rows of one of the arrays."""
        getattr(self._native, f"set_{name}")(values, rows)

    def _places(self, ids: ArrayLike) -> Ids:
        """Rows of particles in the order of all arrays."""
        return find_rows(ids, self.ids)


def find_rows(ids: Any, own: Ids, what: str = "particle", name: str = "ids") -> Ids:
    """Where one id or several are among ascending ones."""
    wanted = as_integers(name, ids)
    if wanted.ndim > 1 or wanted.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integers, shape (m,), got {describe(ids)}")
    several = wanted.ndim == 1
    wanted = np.atleast_1d(wanted)
    places = np.searchsorted(own, wanted.astype(np.int64))
    wrong = places >= len(own)
    wrong[~wrong] = own[places[~wrong]] != wanted[~wrong]
    if wrong.any():
        k = int(np.argmax(wrong))
        where = f"[{k}]" if several else ""
        raise IndexError(f"{name}{where}: there is no {what} {wanted[k]}")
    return places.astype(np.int64)


def find_rows_or_all(ids: Any, own: Ids, what: str = "particle") -> Ids:
    """Where ids are among ascending ones; all unless given."""
    return np.arange(len(own)) if ids is None else find_rows(ids, own, what)


def rows_of(values: ArrayLike, ids: ArrayLike | None, dimensions: int = 1) -> ArrayLike:
    """Values as rows: for one id standing alone, one row may stand alone as well."""
    if ids is None or np.ndim(ids) > 0:
        return values
    array = as_array("values", values)
    return array[None] if array.ndim == dimensions else array
