"""Velocities on the nodes of a grid, with levels in time."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_flag,
    check_integer,
    check_real,
    check_sequence,
    first_bad_index,
)
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


class GridField(Field):
    """Velocities on the nodes of a rectilinear grid, steady or with levels in time.

    Between levels the velocity is linear in time. In space it is linear, or by cubic convolution:
    continuously differentiable, exact for quadratic data, error of third order. Nodes with NaN
    (in any component) are missing: land. A position is on land where its nearest node, of the level
    nearest in time, is missing. In other cells with missing corners the weights of the
    remaining corners are scaled to sum to 1, so a current along a coast is not slowed down by it;
    with 'cubic' a cell with missing nodes in its stencil of 4 x 4 (x 4) is interpolated linearly.

    Parameters
    ----------
    axes : sequence of array_like
        Coordinates of the nodes along x, y and, in space, z, equally spaced or not, rising or
        falling, at least 2 each [m]; longitude and latitude [degrees] with `geographic`.
    values : array_like, shape (n_x, n_y[, n_z], d) or (n_t, n_x, n_y[, n_z], d)
        Velocities [m/s], NaN where missing; d is 2 or 3 as there are axes. An array is copied; a
        numpy.memmap, an h5py dataset or any object with `shape` and `[level]` is read level by
        level when needed.
    times : array_like, shape (n_t,), optional
        Times of the levels [s], rising. Without them the field is steady. Outside of them the
        field is not known, and asking for it raises InputError.
    interpolation : {'linear', 'cubic'}
        In space.
    periodic : sequence of bool or float, optional
        Along each axis: False, a period, or True for an equally spaced axis, whose period is then
        its number of nodes times the spacing. A last node one period after the first is dropped.
        Geographic longitudes need none: they have a period of 360 degrees, and the grid is closed
        around the Earth where its nodes go all the way round.
    geographic : bool
        Positions are longitude and latitude [degrees] (and a third coordinate [m]), velocities
        eastward and northward [m/s]: dlon/dt = u / (R cos lat), dlat/dt = v / R. At the poles
        dlon/dt is singular: near them (within a few steps' way) paths are inaccurate, and at
        latitude 90 the grid ends.
    radius : float
        R, the radius of the Earth or planet [m].
    memory_limit : int
        Bytes of levels kept in memory; the least recently used are dropped and read again.

    Raises
    ------
    InputError
        If shapes do not go together, an axis or the times are not monotonic, or a value is
        infinite.

    References
    ----------
    Keys (1981), "Cubic convolution interpolation for digital image processing", IEEE Trans. ASSP
    29, 1153, eq. (15), (19), (25).

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = y = np.linspace(-1, 1, 21)
    >>> rotation = np.stack(np.broadcast_arrays(-y, x[:, None]), axis=-1)
    >>> field = substep.GridField((x, y), rotation)
    >>> field(0.0, [[0.25, 0.5]]).round(12).tolist()
    [[-0.5, 0.25]]
    """

    def __init__(
        self,
        axes: Sequence[ArrayLike],
        values: ArrayLike | LevelSource,
        times: ArrayLike | None = None,
        *,
        interpolation: str = "linear",
        periodic: Sequence[bool | float] | None = None,
        geographic: bool = False,
        radius: float = EARTH_RADIUS,
        memory_limit: int = 1 << 31,
    ) -> None:
        listed = check_sequence("axes", axes, "coordinates")
        self.dimension = check_integer("number of axes", len(listed), minimum=2, maximum=3)
        self.interpolation = check_choice("interpolation", interpolation, ("linear", "cubic"))
        self.geographic = check_flag("geographic", geographic)
        self.radius = check_real("radius", radius, positive=True)
        self._memory_limit = check_integer("memory_limit", memory_limit, minimum=1)
        if self.geographic:
            self.position_units = ("degree", "degree", "m")

        nodes = [check_array(f"axes[{i}]", axis, (None,)) for i, axis in enumerate(listed)]
        shape = tuple(map(len, nodes))
        self._flip: list[bool] = []
        for i, axis in enumerate(nodes):
            if len(axis) < 2 or not ((np.diff(axis) > 0).all() or (np.diff(axis) < 0).all()):
                raise InputError(
                    f"axes[{i}]: expected at least 2 coordinates, rising or falling throughout, "
                    f"got {np.array2string(axis, threshold=6)}"
                )
            self._flip.append(bool(axis[0] > axis[-1]))
            nodes[i] = axis[::-1].copy() if self._flip[-1] else axis.copy()
        wrap, closed = self._periods(nodes, periodic)
        self._keep = [
            len(axis) - 1 if close and axis[-1] - axis[0] > period * (1 - 1e-9) else len(axis)
            for axis, period, close in zip(nodes, wrap, closed, strict=True)
        ]
        self.axes = [axis[:keep] for axis, keep in zip(nodes, self._keep, strict=True)]
        self._wrap, self._closed = wrap, closed

        lazy = not isinstance(values, (np.ndarray, list, tuple)) or isinstance(values, np.memmap)
        steady = times is None
        self.times = np.zeros(1) if times is None else check_array("times", times, (None,))
        if len(self.times) < 1 or not (np.diff(self.times) > 0).all():
            raise InputError("times: expected at least one, rising")
        wanted = (*shape, self.dimension)
        if not steady:
            wanted = (len(self.times), *wanted)
        if lazy and hasattr(values, "shape"):
            if tuple(values.shape) != wanted:
                raise InputError(f"values: expected shape {wanted}, got {tuple(values.shape)}")
            self._source: Any = [values] if steady else values
        else:
            array = check_array("values", values, wanted, finite=False)
            if np.isinf(array).any():
                where = first_bad_index(np.isinf(array))
                raise InputError(f"values{where}: expected a finite number or NaN, got infinity")
            self._source = array[None] if steady else array
        self.steady = steady
        self.origin: np.datetime64 | None = None
        self.sources: tuple[str, ...] = ()
        self._natives: dict[str, Any] = {}
        self._levels: OrderedDict[tuple[str, int], Any] = OrderedDict()
        self._lock = threading.RLock()  # a source may ask the field itself

    def _periods(
        self, nodes: list[NDArray[np.float64]], periodic: Sequence[bool | float] | None
    ) -> tuple[list[float], list[bool]]:
        none = [False] * self.dimension
        asked = none if periodic is None else check_sequence("periodic", periodic, "periods")
        if len(asked) != self.dimension:
            raise InputError(f"periodic: expected {self.dimension} entries, got {len(asked)}")
        wrap, closed = [0.0] * self.dimension, [False] * self.dimension
        for i, (axis, period) in enumerate(zip(nodes, asked, strict=True)):
            spacing, span = (axis[-1] - axis[0]) / (len(axis) - 1), axis[-1] - axis[0]
            if self.geographic and i == 0:
                if period is not False and period is not True and period != 360:
                    raise InputError(f"periodic[0]: longitudes have a period of 360, got {period}")
                if span > 360 * (1 + 1e-9):
                    raise InputError(f"axes[0]: expected longitudes within 360 degrees, got {span}")
                wrap[0] = 360.0
                closed[0] = 360 - span <= 1.001 * spacing
                continue
            if period is False or period is None:
                continue
            if period is True:
                if np.abs(np.diff(axis) - spacing).max() > 1e-9 * spacing * len(axis):
                    raise InputError(f"periodic[{i}]: give the period of the unequally spaced axis")
                period = span + spacing
            wrap[i] = check_real(f"periodic[{i}]", period, positive=True)
            closed[i] = True
            if span > wrap[i] * (1 + 1e-9):
                raise InputError(f"periodic[{i}]: the axis is longer than the period {wrap[i]}")
        if self.geographic and max(abs(nodes[1][0]), abs(nodes[1][-1])) > 90:
            raise InputError("axes[1]: expected latitudes from -90 to 90 degrees")
        return wrap, closed

    @property
    def periods(self) -> tuple[float | None, ...]:
        """Period of each coordinate, None where the field is not periodic."""
        return tuple(period or None for period in self._wrap)

    @property
    def lower(self) -> tuple[float, ...]:
        """First coordinate along each axis."""
        return tuple(float(axis[0]) for axis in self.axes)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest coordinates inside, shape (d,) each; of closed axes, one period."""
        ends = zip(self.axes, self._wrap, self._closed, strict=True)
        upper = [axis[0] + wrap if closed else axis[-1] for axis, wrap, closed in ends]
        return np.array(self.lower), np.array(upper, dtype=float)

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
        slack = 1e-9 * (self.times[-1] - self.times[0])
        if not self.steady and not self.times[0] - slack <= t <= self.times[-1] + slack:
            raise InputError(
                f"{name}: expected a time from {self.times[0]} to {self.times[-1]}, got {t}"
            )

    def _native(self, dtype: Any) -> Any:
        bits = "64" if dtype == np.float64 else "32"
        if bits not in self._natives:
            nodes = [axis.tolist() for axis in self.axes]
            radius = self.radius if self.geographic else 0.0
            cubic = self.interpolation == "cubic"
            self._natives[bits] = _core.Grid(
                nodes, self._wrap, self._closed, cubic, radius, f"float{bits}"
            )
        return self._natives[bits]

    def _level(self, number: int, dtype: Any) -> Any:
        native = self._native(dtype)
        key = (np.dtype(dtype).str, number)
        if key in self._levels:
            self._levels.move_to_end(key)
            return self._levels[key]
        with np.errstate(invalid="ignore"):  # a signaling NaN
            values = np.asarray(self._source[number], dtype=np.float64)
        flips = tuple(slice(None, None, -1 if flip else 1) for flip in self._flip)
        values = values[flips][tuple(slice(keep) for keep in self._keep)]
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
            spacing = float(np.diff(self.times).min())
            count = min(count, max(1, math.floor(spacing / abs(steps.h))))
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
        return {**self.__dict__, "_natives": {}, "_levels": OrderedDict(), "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = threading.RLock()


def _first(event: tuple[int, int], later: tuple[int, int], done: int) -> tuple[int, int]:
    return event if event[0] >= 0 or later[0] < 0 else (later[0] + done, later[1])
