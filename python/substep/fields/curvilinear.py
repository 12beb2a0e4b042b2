"""Velocities on the cells of a curvilinear grid, as ocean models have them."""

from __future__ import annotations

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
    first_bad_index,
    in_range,
)
from ..errors import InputError
from .levels import EARTH_RADIUS, LevelField, LevelSource


class CurvilinearField(LevelField):
    """Velocities on a curvilinear grid, steady or with levels in time.

    The grid has corners (i, j) and quadrilateral cells between them, in which positions are
    bilinear. On an Arakawa A grid velocities are eastward and northward, or along x and y, at the
    corners, and bilinear between them; NaN is land as in `GridField`. On a C grid they are speeds
    through the faces of the cells, and the flow through a cell is linear from face to face: no
    particle goes through a coast, and a flow without divergence is followed without any.
    Between levels the velocity is linear in time.

    Parameters
    ----------
    x, y : array_like, shape (n_x, n_y)
        Corners of the cells [m]; longitude and latitude [degrees] with `geographic`. Rows may go
        anywhere; cells that miss a corner (NaN), whose corners do not turn one way, or with a pole
        inside are none.
    values : array_like, shape (n_x, n_y[, n_z], d) or (n_t, n_x, n_y[, n_z], d)
        Velocities [m/s], NaN where missing. With `arakawa='A'` at corner (i, j). With 'C'
        values[i, j, 0] is the speed through the face from corner (i, j) to (i, j + 1), towards
        rising i, and values[i, j, 1] that through the face from (i, j) to (i + 1, j), towards
        rising j; what would be beyond the last corner is not read. In space the first two are those
        of the layer from z[k] to z[k + 1], and values[i, j, k, 2] is the velocity along z of the
        cell (i, j) at z[k]. An object with `shape` and `[level]` is read level by level.
    times : array_like, shape (n_t,), optional
        Times of the levels [s], rising. Without them the field is steady.
    z : array_like, shape (n_z,), optional
        Third coordinate of the corners [m], rising, at least 2; in two dimensions without.
    arakawa : {'A', 'C'}
        Where the velocities are.
    geographic : bool
        Positions are longitude and latitude [degrees] (and a third coordinate [m]); see
        `GridField`. Longitudes have a period of 360 degrees, and may be given in any.
    radius : float
        Radius of the Earth or planet [m].
    memory_limit : int
        Bytes of levels kept in memory; the least recently used are dropped and read again.

    Raises
    ------
    InputError
        If shapes do not go together, no cell is left, or a value is infinite.

    References
    ----------
    Delandmeter and van Sebille (2019), "The Parcels v2.0 Lagrangian framework: new field
    interpolation schemes", Geosci. Model Dev. 12, 3571, section 2.1.3.

    Examples
    --------
    >>> import numpy as np, substep
    >>> r, angle = np.meshgrid(np.linspace(1, 2, 11), np.linspace(0, np.pi, 33), indexing="ij")
    >>> x, y = r * np.cos(angle), r * np.sin(angle)
    >>> field = substep.CurvilinearField(x, y, np.stack([-y, x], axis=-1))
    >>> field(0.0, [[0.0, 1.5]]).round(12).tolist()
    [[-1.5, 0.0]]
    """

    def __init__(
        self,
        x: ArrayLike,
        y: ArrayLike,
        values: ArrayLike | LevelSource,
        times: ArrayLike | None = None,
        *,
        z: ArrayLike | None = None,
        arakawa: str = "A",
        geographic: bool = False,
        radius: float = EARTH_RADIUS,
        memory_limit: int = 1 << 31,
    ) -> None:
        self.arakawa = check_choice("arakawa", arakawa, ("A", "C"))
        self.geographic = check_flag("geographic", geographic)
        self.radius = check_real("radius", radius, positive=True)
        self._memory_limit = check_integer("memory_limit", memory_limit, minimum=1)
        if self.geographic:
            self.position_units = ("degree", "degree", "m")
        self.x = check_array("x", x, (None, None), finite=False)
        self.y = check_array("y", y, self.x.shape, finite=False)
        for name, corners in (("x", self.x), ("y", self.y)):
            if min(corners.shape) < 2:
                raise InputError(f"{name}: expected at least 2 x 2 corners, got {corners.shape}")
            if np.isinf(corners).any():
                where = first_bad_index(np.isinf(corners))
                raise InputError(f"{name}{where}: expected a finite number or NaN, got infinity")
        if self.geographic and (np.abs(self.y) > 90).any():
            where = first_bad_index(np.abs(self.y) > 90)
            raise InputError(f"y{where}: expected a latitude from -90 to 90 degrees")
        self.z = np.zeros(0) if z is None else check_array("z", z, (None,))
        with in_range("z"):
            rising = len(self.z) >= 2 and np.ptp(self.z) > 0 and (np.diff(self.z) > 0).all()
        if z is not None and not rising:
            raise InputError("z: expected at least 2 coordinates, rising")
        self.dimension = 2 if z is None else 3
        self._set_levels(values, times, self.x.shape if z is None else (*self.x.shape, len(self.z)))
        self._native(np.float64)  # refuses grids without cells

    @property
    def periods(self) -> tuple[float | None, ...]:
        """Period of each coordinate, None where the field is not periodic."""
        return (360.0 if self.geographic else None, None, None)[: self.dimension]

    @property
    def lower(self) -> tuple[float, ...]:
        """Lowest coordinates of the corners."""
        low, _ = self.bounds
        return tuple(low.tolist())

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest coordinates of the corners, shape (d,) each."""
        axes = [self.x, self.y, self.z][: self.dimension]
        return np.array([np.nanmin(a) for a in axes]), np.array([np.nanmax(a) for a in axes])

    def _make(self, dtype: str) -> Any:
        radius = self.radius if self.geographic else 0.0
        return _core.curvilinear_grid(
            self.x, self.y, self.z.tolist(), self.arakawa == "C", radius, dtype
        )
