"""The shapes of rigid bodies: what they measure, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_real
from ..errors import InputError
from ..geometry import TriangleMesh, box_mesh
from .meshes import capsule_mesh, cylinder_mesh, hull_mesh


def _check_lengths(shape: Any, *names: str) -> None:
    for name in names:
        object.__setattr__(shape, name, check_real(name, getattr(shape, name), positive=True))


@dataclass(frozen=True)
class Sphere:
    """A ball about the origin.

    Parameters
    ----------
    radius : float
        Radius [m].

    Raises
    ------
    InputError
        If the radius is not above 0.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.Sphere(0.5)
    Sphere(radius=0.5)
    """

    radius: float

    def __post_init__(self) -> None:
        _check_lengths(self, "radius")

    def mesh(self, segments: int = 32) -> TriangleMesh:
        """The surface as triangles.

        Parameters
        ----------
        segments : int, optional
            Edges around the axis, at least 3.

        Returns
        -------
        TriangleMesh
            Closed; its vertices lie on the surface.
        """
        return capsule_mesh(self.radius, 0.0, segments)


@dataclass(frozen=True)
class Box:
    """A box about the origin, its edges along the axes.

    Parameters
    ----------
    half_lengths : tuple of three floats
        Half of the length along x, y and z [m].

    Raises
    ------
    InputError
        If a length is not above 0.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.Box((0.5, 0.25, 0.1))
    Box(half_lengths=(0.5, 0.25, 0.1))
    """

    half_lengths: Sequence[float]

    def __post_init__(self) -> None:
        h = check_array("half_lengths", self.half_lengths, (3,))
        if not (h > 0).all():
            raise InputError(f"half_lengths: expected numbers above 0, got {h.min()}")
        object.__setattr__(self, "half_lengths", tuple(h.tolist()))

    def mesh(self) -> TriangleMesh:
        """The surface as triangles.

        Returns
        -------
        TriangleMesh
            Closed.
        """
        return box_mesh([2 * h for h in self.half_lengths])


@dataclass(frozen=True)
class Capsule:
    """The points within a distance of a segment of the z axis about the origin.

    Parameters
    ----------
    radius : float
        That distance [m].
    half_length : float
        Half of the length of the segment [m].

    Raises
    ------
    InputError
        If a length is not above 0.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.Capsule(0.1, 0.4)
    Capsule(radius=0.1, half_length=0.4)
    """

    radius: float
    half_length: float

    def __post_init__(self) -> None:
        _check_lengths(self, "radius", "half_length")

    def mesh(self, segments: int = 32) -> TriangleMesh:
        """The surface as triangles.

        Parameters
        ----------
        segments : int, optional
            Edges around the axis, at least 3.

        Returns
        -------
        TriangleMesh
            Closed; its vertices lie on the surface.
        """
        return capsule_mesh(self.radius, self.half_length, segments)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about the origin with its axis along z.

    Parameters
    ----------
    radius : float
        Radius [m].
    half_length : float
        Half of the length [m].

    Raises
    ------
    InputError
        If a length is not above 0.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.Cylinder(0.1, 0.4)
    Cylinder(radius=0.1, half_length=0.4)
    """

    radius: float
    half_length: float

    def __post_init__(self) -> None:
        _check_lengths(self, "radius", "half_length")

    def mesh(self, segments: int = 32) -> TriangleMesh:
        """The surface as triangles.

        Parameters
        ----------
        segments : int, optional
            Edges around the axis, at least 3.

        Returns
        -------
        TriangleMesh
            Closed; its vertices lie on the surface.
        """
        return cylinder_mesh(self.radius, self.half_length, segments)


class ConvexHull:
    """The smallest convex solid that holds all of some points.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Points [m], not all in one plane.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        The points, read-only.

    Examples
    --------
    >>> import substep
    >>> hull = substep.rigid.ConvexHull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> round(substep.rigid.mass_properties(hull, 6.0).mass, 12)
    1.0
    """

    points: NDArray[np.float64]

    def __init__(self, points: ArrayLike) -> None:
        self.points = check_array("points", points, (None, 3)).copy()
        self.points.flags.writeable = False

    def mesh(self) -> TriangleMesh:
        """The surface as triangles: its faces, cut into them.

        Returns
        -------
        TriangleMesh
            Closed.
        """
        return hull_mesh(self.points)

    def __repr__(self) -> str:
        return f"ConvexHull({len(self.points)} points)"
