"""The arrays of many worlds of particles: copies, and how they are set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, first_bad_index
from ..base.rows import read_only
from ..base.worlds import Worlds, find_worlds
from ..errors import InputError

Array = NDArray[np.float64]


class BatchRows(Worlds):
    """Particles as rows of arrays by world; makes `Batch`."""

    _worlds: list[Any]

    def __len__(self) -> int:
        return len(self._worlds)

    @property
    def _class(self) -> str:
        return type(self._worlds[0]).__name__

    @property
    def counts(self) -> NDArray[np.int64]:
        """Particles of each world, shape (w,); read-only."""
        return read_only(np.array([len(one) for one in self._worlds], np.int64))

    @property
    def positions(self) -> Array:
        """Positions [m], shape (w, n, 3) or (w, n, 2); read-only; see `set_positions`."""
        return self._columns(self._native.positions())

    @property
    def velocities(self) -> Array:
        """Velocities [m/s], shape of positions; read-only; see `set_velocities`."""
        return self._columns(self._native.velocities())

    @property
    def forces(self) -> Array:
        """External forces of the next step [N], shape of positions; read-only."""
        rows = np.full((len(self), int(self.counts.max()), self._dimension), np.nan)
        for row, one in zip(rows, self._worlds, strict=True):
            row[: len(one)] = one.forces
        return read_only(rows)

    @property
    def gravity(self) -> Array:
        """Acceleration of each world [m/s^2], shape (w, 3) or (w, 2); read-only."""
        return read_only(np.array([one.gravity for one in self._worlds]))

    @property
    def _dimension(self) -> int:
        dimension: int = self._worlds[0]._dimension
        return dimension

    def _columns(self, rows: Array) -> Array:
        columns: Array = read_only(rows[:, :, : self._dimension].copy())
        return columns

    def set_positions(self, values: ArrayLike, worlds: ArrayLike | None = None) -> None:
        """Put particles somewhere; their velocities stay.

        Parameters
        ----------
        values : array_like, shape (k, n, 3) or (n, 3), in the plane 2 for 3
            Positions [m] in each of the worlds, or for all of them. Rows that a world does not have
            mean nothing.
        worlds : int or array_like of int, shape (k,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("positions", values, worlds)

    def set_velocities(self, values: ArrayLike, worlds: ArrayLike | None = None) -> None:
        """Give particles velocities.

        Parameters
        ----------
        values : array_like, shape (k, n, 3) or (n, 3), in the plane 2 for 3
            Velocities [m/s], as of `set_positions`.
        worlds : int or array_like of int, shape (k,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("velocities", values, worlds)

    def set_forces(self, values: ArrayLike, worlds: ArrayLike | None = None) -> None:
        """Set external forces of the next step, which uses them up: after it they are 0.

        Parameters
        ----------
        values : array_like, shape (k, n, 3) or (n, 3), in the plane 2 for 3
            Forces [N], as of `set_positions`.
        worlds : int or array_like of int, shape (k,), optional
            In which; in all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("forces", values, worlds)

    def _set(self, name: str, values: ArrayLike, worlds: ArrayLike | None) -> None:
        where = find_worlds("worlds", worlds, len(self))
        chosen, counts = [self._worlds[w] for w in where], self.counts
        shape: tuple[int, ...] = (int(counts.max()), self._dimension)
        there: Any = np.arange(shape[0]) < counts[where][:, None]
        given = check_array("values", values, finite=False)
        if given.ndim == 2:
            there = there.any(axis=0)
        else:
            shape = (len(chosen), *shape)
        given = check_array("values", given, shape, finite=False)
        wrong = ~np.isfinite(given) & there[..., None]
        if wrong.any():
            at = first_bad_index(wrong)
            raise InputError(f"values{at}: expected finite numbers, got {given[wrong][0]}")
        each = [given] * len(chosen) if given.ndim == 2 else list(given)
        rows = [
            one._vectors(f"values of world {w}", row[: len(one)], len(one))
            for w, one, row in zip(where, chosen, each, strict=True)
        ]
        before = [one._kept() for one in chosen]
        try:
            for one, row in zip(chosen, rows, strict=True):
                one._write(name, row, np.arange(len(one)))
        except BaseException:
            self._go_back(chosen, before)
            raise

    def _go_back(self, worlds: Sequence[Any], states: Sequence[dict[str, Any]]) -> None:
        for one, state in zip(worlds, states, strict=True):
            one._put_state(state)
