"""Ground: heights on a rectangular grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_most, check_real
from ..base.quaternions import IDENTITY, rotate
from ..base.rows import read_only
from ..errors import InputError
from .shape import ORIGIN, Shape
from .topology import Indices
from .triangle_mesh import TriangleMesh

Array = NDArray[np.float64]

_MOST = 1e50  # of lengths, whose squares and inverses are numbers then


class HeightField(Shape):
    """Ground: heights above the nodes of a rectangular grid, solid below.

    The solid has upright sides at the border of the grid, and no bottom: what is in it comes out at
    the top, or at a side that is nearer.

    Rigid bodies touch the triangles between the heights: each cell is cut along the diagonal from
    the node (i, j) to (i + 1, j + 1). For them the sides go down to the longest side of the grid
    below the lowest height. All other methods meet a smooth surface: the bicubic B-spline whose
    coefficients are the heights, with the exact distance to it. On a plane both are the same; where
    the ground is curved it differs from the heights by spacing**2 / 6 times their Laplacian, and
    never goes beyond the lowest and highest of the heights around.

    Parameters
    ----------
    heights : array_like, shape (n_x, n_y)
        Heights along z [m], above the points origin + spacing (i, j, 0); at least 2 along each
        axis. Neighbours differ by at most 1000 times the spacing.
    spacing : float
        Distance between neighbouring nodes [m], the same along x and y.
    origin : array_like, shape (3,)
        Where a height of 0 lies above the node (0, 0) [m], in the frame of the field.
    center : array_like, shape (3,)
        Where the origin of that frame lies [m].
    rotation : array_like, shape (4,)
        Quaternion (w, x, y, z) that turns the field about that origin; is normalised.

    Attributes
    ----------
    heights : ndarray, shape (n_x, n_y)
        Heights [m], read-only.
    spacing : float
        Distance between neighbouring nodes [m].
    origin : tuple of 3 floats
        Where a height of 0 lies above the node (0, 0) [m].

    Raises
    ------
    InputError
        If a number is not finite or out of range, an axis has one node, or neighbours differ by
        more.

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = np.linspace(-5, 5, 101)
    >>> hills = substep.HeightField(0.3 * np.sin(x[:, None]) * np.cos(x), 0.1, (-5, -5, 0))
    >>> hills
    HeightField(101 x 101 heights, spacing=0.1)
    >>> float(substep.Collider(hills).distance([[0.0, 0.0, 1.0]])[0].round(2))
    0.96
    """

    heights: Array
    spacing: float
    origin: tuple[float, float, float]
    _field: Any
    _fields = ("heights", "spacing", "origin", "center", "rotation")

    def __init__(
        self,
        heights: ArrayLike,
        spacing: float,
        origin: ArrayLike = ORIGIN,
        *,
        center: ArrayLike = ORIGIN,
        rotation: ArrayLike = IDENTITY,
    ) -> None:
        values = check_most("heights", check_array("heights", heights, (None, None)), _MOST)
        step = check_real("spacing", spacing, positive=True)
        if not 1 / _MOST < step < _MOST:
            raise InputError(f"spacing: {step} m is out of range")
        corner = check_most("origin", check_array("origin", origin, (3,)), _MOST)
        self._set(
            _field=_core.HeightField(values, corner.tolist(), step),
            heights=read_only(values),
            spacing=step,
            origin=tuple(corner.tolist()),
        )
        self._place(center, rotation)

    def __repr__(self) -> str:
        n_x, n_y = self.heights.shape
        return f"HeightField({n_x} x {n_y} heights, spacing={self.spacing})"

    def mesh(self) -> TriangleMesh:
        """The triangles between the heights, without the sides.

        Returns
        -------
        TriangleMesh
            Open; its vertices are the nodes, in the order of `heights`.
        """
        turned = rotate(np.array(self.rotation), self._nodes())
        return TriangleMesh(turned + self.center, self._triangles())

    def _nodes(self) -> Array:
        n_x, n_y = self.heights.shape
        points = np.empty((n_x, n_y, 3))
        points[..., 0] = self.spacing * np.arange(n_x)[:, None]
        points[..., 1] = self.spacing * np.arange(n_y)
        points[..., 2] = self.heights
        points += self.origin
        return points.reshape(-1, 3)

    def _triangles(self) -> Indices:
        number = np.arange(self.heights.size).reshape(self.heights.shape)
        a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)

    def _sides(self) -> tuple[Array, Indices]:
        """Vertices at the foot of the sides, which follow the nodes, and triangles."""
        number = np.arange(self.heights.size).reshape(self.heights.shape)
        ends = [number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]]
        top = np.concatenate(ends)  # around the border, counter-clockwise
        foot = self.heights.size + np.arange(len(top))
        points = self._nodes()[top]
        depth = self.spacing * (max(self.heights.shape) - 1)
        points[:, 2] = self.origin[2] + self.heights.min() - depth
        next_top, next_foot = np.roll(top, -1), np.roll(foot, -1)
        faces = np.stack([next_top, top, foot, next_top, foot, next_foot], axis=-1)
        return points, faces.reshape(-1, 3)

    def _obstacle(self, hollow: bool) -> Any:
        if hollow:
            raise InputError("hollow: a HeightField is ground, solid below")
        return _core.Collider.height_field(self._field, list(self.center))

    def _rigid_shape(self) -> Any:
        points, sides = self._sides()
        vertices = np.concatenate([self._nodes(), points])
        if len(vertices) > 2**31 - 1:
            raise InputError("heights: rigid bodies take at most 2**31 - 1 vertices")
        faces = np.concatenate([self._triangles(), sides]).astype(np.int32)
        return _core.RigidShape.mesh(vertices, faces)
