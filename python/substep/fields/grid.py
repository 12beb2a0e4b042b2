"""Velocities on the nodes of a grid, with levels in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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
    in_range,
)
from ..base.rows import read_only
from ..errors import InputError
from .levels import EARTH_RADIUS, LevelField, LevelSource


class GridField(LevelField):
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
            with in_range(f"axes[{i}]"):
                steps = np.diff(axis) if len(axis) and np.ptp(axis) else np.zeros(1)
            if not ((steps > 0).all() or (steps < 0).all()):
                raise InputError(
                    f"axes[{i}]: expected at least 2 coordinates, rising or falling throughout, "
                    f"got {np.array2string(axis, threshold=6)}"
                )
            self._flip.append(bool(axis[0] > axis[-1]))
            nodes[i] = axis[::-1].copy() if self._flip[-1] else axis.copy()
        with in_range("periodic"):
            wrap, closed = self._periods(nodes, periodic)
        self._keep = [
            len(axis) - 1 if close and axis[-1] - axis[0] > period * (1 - 1e-9) else len(axis)
            for axis, period, close in zip(nodes, wrap, closed, strict=True)
        ]
        self._axes = [axis[:keep] for axis, keep in zip(nodes, self._keep, strict=True)]
        self._wrap, self._closed = wrap, closed

        self._set_levels(values, times, shape)

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
                if not isinstance(period, bool) and check_real("periodic[0]", period) != 360:
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
            check_real(f"periodic[{i}]", wrap[i] + float(axis[0]))
            closed[i] = True
            if span > wrap[i] * (1 + 1e-9):
                raise InputError(f"periodic[{i}]: the axis is longer than the period {wrap[i]}")
        if self.geographic and max(abs(nodes[1][0]), abs(nodes[1][-1])) > 90:
            raise InputError("axes[1]: expected latitudes from -90 to 90 degrees")
        return wrap, closed

    @property
    def axes(self) -> tuple[NDArray[np.float64], ...]:
        """Coordinates of the nodes along each axis, rising; read-only."""
        return tuple(read_only(axis.view()) for axis in self._axes)

    @property
    def periods(self) -> tuple[float | None, ...]:
        """Period of each coordinate, None where the field is not periodic."""
        return tuple(period or None for period in self._wrap)

    @property
    def lower(self) -> tuple[float, ...]:
        """First coordinate along each axis."""
        return tuple(float(axis[0]) for axis in self._axes)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest coordinates inside, shape (d,) each; of closed axes, one period."""
        ends = zip(self._axes, self._wrap, self._closed, strict=True)
        upper = [axis[0] + wrap if closed else axis[-1] for axis, wrap, closed in ends]
        return np.array(self.lower), np.array(upper, dtype=float)

    def _make(self, dtype: str) -> Any:
        nodes = [axis.tolist() for axis in self._axes]
        radius = self.radius if self.geographic else 0.0
        cubic = self.interpolation == "cubic"
        return _core.Grid(nodes, self._wrap, self._closed, cubic, radius, dtype)

    def _arranged(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        flips = tuple(slice(None, None, -1 if flip else 1) for flip in self._flip)
        return values[flips][tuple(slice(keep) for keep in self._keep)]
