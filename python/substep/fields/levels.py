"""Velocities known at levels in time, which are read when they are needed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.attributes import Frozen
from ..base.checks import check_array, check_real, describe, first_bad_index
from ..errors import InputError, NonFiniteError
from .flows import Field, Moved, Particles, Steps

EARTH_RADIUS = 6371008.8  # [m], mean radius of GRS80 (Moritz 2000, Journal of Geodesy 74, 128)
_SORT_STEPS = 32  # steps after which the particles are sorted by cell again
_SORT_BYTES = 1 << 19  # smaller levels stay in the second-level cache anyway
_SORT_PARTICLES = 20_000


class LevelSource(Protocol):
    """Velocities read level by level: shape (levels, n_x, n_y[, n_z], d)."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of all levels."""

    def __getitem__(self, level: int) -> Any:
        """Velocities of one level."""


class LevelField(Frozen, Field):
    """What fields on grids of any form have in common: levels in time, and how particles move.

    Attributes
    ----------
    times : ndarray, shape (n_t,)
        Times of the levels [s].
    steady : bool
        Whether there is one level, for all times.
    geographic : bool
        Whether positions are longitude and latitude [degrees].
    """

    geographic: bool
    _memory_limit: int

    def __repr__(self) -> str:
        times = self.times
        span = "steady" if self.steady else f"{len(times)} times, {times[0]:g} to {times[-1]:g} s"
        units = ", geographic" if self.geographic else ""
        return f"{type(self).__name__}({self.dimension}D, {span}{units})"

    def _make(self, dtype: str) -> Any:
        """The native grid."""
        raise NotImplementedError

    def _arranged(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of a level as the native grid has them."""
        return values

    def _set_levels(
        self,
        values: ArrayLike | LevelSource,
        times: ArrayLike | None,
        shape: tuple[int, ...],
    ) -> None:
        """Check velocities on nodes of that shape."""
        lazy = not isinstance(values, (np.ndarray, list, tuple)) or isinstance(values, np.memmap)
        steady = times is None
        self.times = np.zeros(1) if times is None else check_array("times", times, (None,))
        if len(self.times) < 1 or not (self.times[1:] > self.times[:-1]).all():
            raise InputError("times: expected at least one, rising")
        wanted = self._level_shape = (*shape, self.dimension)
        if not steady:
            wanted = (len(self.times), *wanted)
        if lazy and hasattr(values, "shape"):
            if not np.array_equal(values.shape, wanted):
                raise InputError(f"values: expected shape {wanted}, got {describe(values.shape)}")
            self._source: Any = [values] if steady else values
        else:
            array = check_array("values", values, wanted, finite=False)
            if np.isinf(array).any():
                where = first_bad_index(np.isinf(array))
                raise InputError(f"values{where}: expected a finite number or NaN, got infinity")
            self._source = array[None] if steady else array
        self.steady = steady
        self._origin: np.datetime64 | None = None
        self._sources: tuple[str, ...] = ()
        self._natives: dict[str, Any] = {}
        self._levels: OrderedDict[tuple[str, int], Any] = OrderedDict()
        self._lock = threading.RLock()  # a source may ask the field itself

    @property
    def origin(self) -> np.datetime64 | None:
        """When time 0 is, where a file tells."""
        return self._origin

    @property
    def sources(self) -> tuple[str, ...]:
        """The files that it was read from."""
        return self._sources

    def __len__(self) -> int:
        return len(self.times)

    def __call__(self, t: float, x: ArrayLike) -> NDArray[np.float64]:
        """Velocities [m/s] at the positions x and the time t; NaN on land and outside.

        Parameters
        ----------
        t : float
            Time [s].
        x : array_like, shape (n, d)
            Positions [m or degrees].

        Returns
        -------
        ndarray, shape (n, d)
            Velocities [m/s].
        """
        x = check_array("x", x, (None, self.dimension))
        t = check_real("t", t)
        self._check_time("t", t)
        levels, times = self._between(t, t, x.dtype)
        return self._native(x.dtype).velocity(levels, times, t, x, 0)

    def _check_time(self, name: str, t: float) -> None:
        """Refuse times before the first and after the last level."""
        slack = 1e-9 * self.times[-1] - 1e-9 * self.times[0]
        if not self.steady and not self.times[0] - slack <= t <= self.times[-1] + slack:
            raise InputError(
                f"{name}: expected a time from {self.times[0]} to {self.times[-1]}, got {t}"
            )

    def _native(self, dtype: Any) -> Any:
        name = "float64" if dtype == np.float64 else "float32"
        if name not in self._natives:
            self._natives[name] = self._make(name)
        return self._natives[name]

    def _level(self, number: int, dtype: Any) -> Any:
        native = self._native(dtype)
        key = (np.dtype(dtype).str, number)
        if key in self._levels:
            self._levels.move_to_end(key)
            return self._levels[key]
        values: Any = self._source[number]
        if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":  # as netCDF4 reads
            values = np.ma.filled(values.astype(np.float64), np.nan)
        values = check_array(f"level {number}", values, self._level_shape, finite=False)
        values = self._arranged(values)
        try:
            level = native.pack(np.require(values, requirements=["C", "ALIGNED"]), 0)
        except InputError as error:
            raise InputError(f"level {number}: {error}") from None
        while self._levels and (len(self._levels) + 1) * native.level_bytes > self._memory_limit:
            self._levels.popitem(last=False)
        self._levels[key] = level
        return level

    def _between(self, t0: float, t1: float, dtype: Any) -> tuple[list[Any], list[float]]:
        """Levels that the times from t0 to t1, in either order, need."""
        if self.steady:
            with self._lock:
                return [self._level(0, dtype)], [0.0]
        low, high = min(t0, t1), max(t0, t1)
        first = max(int(np.searchsorted(self.times, low, side="right")) - 1, 0)
        last = min(int(np.searchsorted(self.times, high, side="left")), len(self.times) - 1)
        numbers = range(min(first, last), max(first, last) + 1)
        with self._lock:
            return [self._level(k, dtype) for k in numbers], self.times[list(numbers)].tolist()

    def _move(
        self, particles: Particles, steps: Steps, method: str, threads: int, memo: dict[str, Any]
    ) -> Moved:
        """Take the steps natively, in parts where the levels do not fit in memory."""
        moved = Moved(particles.copy())
        done = 0
        while True:
            part = steps._replace(
                first=steps.first + done, number=self._part(steps, done, particles)
            )
            try:
                landed, escaped = self._move_part(moved.particles, part, method, threads, memo)
            except NonFiniteError as error:
                error.step = done + (error.step or 0)
                raise
            moved = Moved(
                moved.particles,
                _first(moved.landed, landed, done),
                _first(moved.escaped, escaped, done),
            )
            done += part.number
            if done >= steps.number:
                return moved

    def _part(self, steps: Steps, done: int, particles: Particles) -> int:
        count = steps.number - done
        native = self._native(particles.x.dtype)
        if native.level_bytes * len(self.times) > self._memory_limit:
            with np.errstate(over="ignore"):
                spacing = float(np.diff(self.times).min())
            count = int(min(count, max(1.0, spacing / abs(steps.h))))
        if self._sorted(particles):
            count = min(count, _SORT_STEPS)
        return count

    def _sorted(self, particles: Particles) -> bool:
        large = self._native(particles.x.dtype).level_bytes > _SORT_BYTES
        return large and _SORT_PARTICLES <= len(particles.x) < 1 << 31

    def _move_part(
        self, particles: Particles, steps: Steps, method: str, threads: int, memo: dict[str, Any]
    ) -> tuple[tuple[int, int], tuple[int, int]]:
        x = particles.x
        native = self._native(x.dtype)
        order = None
        if self._sorted(particles) and steps.number:
            order = memo.get("order")
            if order is None or len(order) != len(x) or memo["age"] + steps.number > _SORT_STEPS:
                order, memo["age"] = native.order(x, threads), 0
                memo["order"] = order
            memo["age"] += steps.number
        levels, times = self._between(steps.time(0), steps.time(steps.number), x.dtype)
        landed, escaped, not_finite = native.advect(
            levels, times, x, particles.status, particles.stop_time, order, *steps, method, threads
        )
        if not_finite[0] >= 0:
            step, index = not_finite
            raise NonFiniteError(
                f"position of particle {index} is no longer finite in step {step}; "
                "take a smaller step",
                time=steps.time(step),
                index=index,
                step=step,
            )
        return landed, escaped

    def __getstate__(self) -> dict[str, Any]:
        kept = super().__getstate__()
        return {**kept, "_natives": {}, "_levels": OrderedDict(), "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self._lock = threading.RLock()


def _first(event: tuple[int, int], later: tuple[int, int], done: int) -> tuple[int, int]:
    return event if event[0] >= 0 or later[0] < 0 else (later[0] + done, later[1])
