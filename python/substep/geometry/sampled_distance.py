"""Shapes of any form: a signed distance on the nodes of a grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_real, check_threads
from ..base.quaternions import IDENTITY
from ..base.rows import read_only
from .shape import ORIGIN, Shape
from .triangle_mesh import TriangleMesh, check_mesh

Array = NDArray[np.float64]


class SignedDistanceField(Shape):
    """A shape of any form, of obstacles: its signed distance on the nodes of a regular grid.

    Between the nodes the distance is the quadratic B-spline of the values, which is continuously
    differentiable and never further from the true distance than `error_bound`; edges are rounded at
    the size of the grid, a sphere of radius R loses spacing**2 / (4 R). Outside of the grid the
    distance is a lower bound of the true one, at least 0.7 of it.

    Parameters
    ----------
    values : array_like, shape (n_x, n_y, n_z)
        Signed distances [m], below 0 inside; at least 4 nodes along each axis, and above 0 on the
        outer two layers.
    spacing : float
        Distance between neighbouring nodes [m], the same along all axes.
    origin : array_like, shape (3,)
        Position of values[0, 0, 0] [m], in the frame of the field.
    center : array_like, shape (3,)
        Where the origin of that frame lies [m].
    rotation : array_like, shape (4,)
        Quaternion (w, x, y, z) that turns the field about that origin; is normalised.
    threads : int, optional
        Threads to use at construction.

    Raises
    ------
    InputError
        If a value is not finite, neighbours differ by more than twice the spacing (no distance
        does), or the surface comes too near to the border.

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = np.linspace(-2, 2, 41)
    >>> values = np.sqrt(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) - 1
    >>> ball = substep.SignedDistanceField(values, spacing=0.1, origin=(-2, -2, -2))
    >>> float(substep.Collider(ball).distance([[1.5, 0.0, 0.0]])[0].round(2))
    0.5
    """

    _field: Any
    _fields = ("values", "spacing", "origin", "center", "rotation")

    def __init__(
        self,
        values: ArrayLike,
        spacing: float,
        origin: ArrayLike = (0.0, 0.0, 0.0),
        *,
        center: ArrayLike = ORIGIN,
        rotation: ArrayLike = IDENTITY,
        threads: int | None = None,
    ) -> None:
        self._set(
            _field=_core.SampledDistance(
                check_array("values", values, (None, None, None)),
                check_array("origin", origin, (3,)).tolist(),
                check_real("spacing", spacing, positive=True),
                check_threads(threads),
            )
        )
        self._place(center, rotation)

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __repr__(self) -> str:
        shape = " x ".join(str(n) for n in self.values.shape)
        return f"SignedDistanceField({shape} nodes, spacing={self.spacing})"

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.sampled(self._field, list(self.center), hollow)

    @classmethod
    def from_mesh(
        cls,
        mesh: TriangleMesh,
        spacing: float | None = None,
        *,
        offset: float = 0.0,
        center: ArrayLike = ORIGIN,
        rotation: ArrayLike = IDENTITY,
        threads: int | None = None,
    ) -> SignedDistanceField:
        """Sample the signed distance of a mesh, which may be open, not manifold or cut itself.

        Parameters
        ----------
        mesh : TriangleMesh
            The surface; inside is where its winding number is above 1/2.
        spacing : float, optional
            Distance between neighbouring nodes [m]; by default 1/64 of the longest side of the
            mesh's bounding box, or 1/4 of the mean thickness 2 V / A of what is thin. Parts
            thinner than about two spacings get lost.
        offset : float
            Grow the solid by this much [m], at least 0: a sheet becomes a plate of thickness
            2 offset.
        center, rotation, threads
            As for the class.

        Returns
        -------
        SignedDistanceField
            Its frame is that of the mesh's vertices.

        Raises
        ------
        InputError
            If no node lies inside, or the grid would have more than 1e8 nodes.

        Examples
        --------
        >>> import substep
        >>> ball = substep.SignedDistanceField.from_mesh(substep.geometry.sphere_mesh(), 0.1)
        >>> float(substep.Collider(ball).distance([[1.2, 0.0, 0.0]])[0].round(1))
        0.2
        """
        values, h, origin = check_mesh(mesh)._sampled(spacing, offset, threads)
        return cls(values, h, origin, center=center, rotation=rotation, threads=threads)

    @property
    def values(self) -> Array:
        """Signed distances at the nodes [m], shape (n_x, n_y, n_z); a read-only copy."""
        return read_only(np.asarray(self._field.values))

    @property
    def spacing(self) -> float:
        """Distance between neighbouring nodes [m]."""
        return float(self._field.spacing)

    @property
    def origin(self) -> Array:
        """Position of the first node in the frame of the field [m], read-only."""
        return read_only(np.array(self._field.origin))

    @property
    def error_bound(self) -> float:
        """sqrt(3)/2 spacing [m]: the most by which a true distance on the nodes is missed."""
        return float(self._field.error_bound)
