"""Shapes in closed form, and convex hulls."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_real
from ..base.quaternions import IDENTITY, rotate
from ..errors import InputError
from .primitives import box_mesh, capsule_mesh, cylinder_mesh
from .shape import ORIGIN, Shape
from .triangle_mesh import TriangleMesh

Array = NDArray[np.float64]


class Solid(Shape):
    """A shape whose mesh is made about the origin."""

    def _surface(self) -> TriangleMesh:
        """The mesh about the origin, of which obstacles without a closed form are made."""
        raise NotImplementedError

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.sampled(self._surface()._field, list(self.center), hollow)

    def _moments(self, density: float) -> Any:
        return self._rigid_shape().moments(density)

    def _placed(self, mesh: TriangleMesh) -> TriangleMesh:
        if self.center == ORIGIN and self.rotation == IDENTITY:
            return mesh
        turned = rotate(np.array(self.rotation), mesh.vertices)
        return TriangleMesh(turned + self.center, mesh.faces)


class Sphere(Solid):
    """A ball.

    Parameters
    ----------
    radius : float
        Radius [m], above 0.
    center : array_like, shape (3,)
        Centre [m].

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> substep.Sphere(0.5)
    Sphere(radius=0.5)
    """

    radius: float
    _fields = ("radius", "center")
    _kind = "sphere"

    def __init__(self, radius: float, center: ArrayLike = ORIGIN) -> None:
        self._set(radius=check_real("radius", radius, positive=True))
        self._place(center)

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
        return self._placed(capsule_mesh(self.radius, 0.0, segments))

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.sphere(list(self.center), self.radius, hollow)

    def _numbers(self) -> dict[str, float]:
        return {"radius": self.radius}


class Box(Solid):
    """A box.

    Parameters
    ----------
    lengths : array_like, shape (3,)
        Full lengths of the edges along x, y and z [m], above 0.
    center : array_like, shape (3,)
        Centre [m].
    rotation : array_like, shape (4,)
        Quaternion (w, x, y, z) that turns the box about its centre; is normalised.

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> substep.Box((1, 0.5, 0.2), center=(0, 0, 0.1))
    Box(lengths=(1.0, 0.5, 0.2), center=(0.0, 0.0, 0.1))
    """

    lengths: tuple[float, float, float]
    _fields = ("lengths", "center", "rotation")
    _kind = "box"

    def __init__(
        self, lengths: ArrayLike, center: ArrayLike = ORIGIN, rotation: ArrayLike = IDENTITY
    ) -> None:
        sides = check_array("lengths", lengths, (3,))
        if not (sides > 0).all():
            raise InputError(f"lengths: expected numbers above 0, got {sides.tolist()}")
        self._set(lengths=tuple(sides.tolist()))
        self._place(center, rotation)

    def mesh(self) -> TriangleMesh:
        """The surface as triangles.

        Returns
        -------
        TriangleMesh
            Closed.
        """
        return self._placed(box_mesh(self.lengths))

    @property
    def _half(self) -> list[float]:
        return [side / 2 for side in self.lengths]

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.box(list(self.center), self._half, hollow)

    def _numbers(self) -> dict[str, float]:
        return dict(zip(("half_x", "half_y", "half_z"), self._half, strict=True))


class Capsule(Solid):
    """The points within a distance of a segment, which lies along z.

    Parameters
    ----------
    radius : float
        That distance [m], above 0.
    length : float
        Of the segment [m], above 0: the capsule is longer by twice the radius.
    center : array_like, shape (3,)
        Middle of the segment [m].
    rotation : array_like, shape (4,)
        Quaternion (w, x, y, z) that turns the segment about its middle; is normalised.

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> substep.Capsule(0.1, 0.8)
    Capsule(radius=0.1, length=0.8)
    """

    radius: float
    length: float
    _fields = ("radius", "length", "center", "rotation")
    _kind = "capsule"

    def __init__(
        self,
        radius: float,
        length: float,
        center: ArrayLike = ORIGIN,
        rotation: ArrayLike = IDENTITY,
    ) -> None:
        self._set(
            radius=check_real("radius", radius, positive=True),
            length=check_real("length", length, positive=True),
        )
        self._place(center, rotation)

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
        return self._placed(capsule_mesh(self.radius, self.length, segments))

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.capsule(list(self.center), self.radius, self.length / 2, hollow)

    def _numbers(self) -> dict[str, float]:
        return {"radius": self.radius, "half_length": self.length / 2}


class Cylinder(Solid):
    """A cylinder with its axis along z.

    Parameters
    ----------
    radius : float
        Radius [m], above 0.
    length : float
        Length [m], above 0.
    center : array_like, shape (3,)
        Middle of the axis [m].
    rotation : array_like, shape (4,)
        Quaternion (w, x, y, z) that turns the cylinder about its middle; is normalised.

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> substep.Cylinder(0.1, 0.8)
    Cylinder(radius=0.1, length=0.8)
    """

    radius: float
    length: float
    _fields = ("radius", "length", "center", "rotation")
    _kind = "cylinder"

    def __init__(
        self,
        radius: float,
        length: float,
        center: ArrayLike = ORIGIN,
        rotation: ArrayLike = IDENTITY,
    ) -> None:
        self._set(
            radius=check_real("radius", radius, positive=True),
            length=check_real("length", length, positive=True),
        )
        self._place(center, rotation)

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
        return self._placed(cylinder_mesh(self.radius, self.length, segments))

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.cylinder(list(self.center), self.radius, self.length / 2, hollow)

    def _numbers(self) -> dict[str, float]:
        return {"radius": self.radius, "half_length": self.length / 2}


class Plane(Shape):
    """A half space without end: everything on the side that the normal points away from.

    Parameters
    ----------
    normal : array_like, shape (3,)
        Outward normal, of any length above 0; is normalised.
    point : array_like, shape (3,)
        A point of the plane [m].

    Raises
    ------
    InputError
        If the normal is zero, or a number is not finite.

    Examples
    --------
    >>> import substep
    >>> substep.Plane((0, 0, 2), point=(0, 0, 1))
    Plane(normal=(0.0, 0.0, 1.0), point=(0.0, 0.0, 1.0))
    """

    normal: tuple[float, float, float]
    point: tuple[float, float, float]
    _fields = ("normal", "point")
    _kind = "plane"

    def __init__(self, normal: ArrayLike = (0.0, 0.0, 1.0), point: ArrayLike = ORIGIN) -> None:
        direction = check_array("normal", normal, (3,))
        length = math.hypot(*direction)
        if not 1e-300 < length < math.inf:  # its square, or an inverse, would not be a number
            largest = float(np.abs(direction).max())
            if largest == 0:
                raise InputError("normal: expected a vector that is not 0")
            direction = direction / largest
            length = math.hypot(*direction)
        self._set(
            normal=tuple((direction / length).tolist()),
            point=tuple(check_array("point", point, (3,)).tolist()),
        )

    def _obstacle(self, hollow: bool) -> Any:
        if hollow:
            raise InputError("hollow: turn the normal of the Plane")
        return _core.Collider.plane(list(self.point), list(self.normal))

    def _numbers(self) -> dict[str, float]:
        offset = sum(n * x for n, x in zip(self.normal, self.point, strict=True))
        x, y, z = self.normal
        return {"normal_x": x, "normal_y": y, "normal_z": z, "offset": offset}


class ConvexHull(Solid):
    """The smallest convex solid that holds all of some points.

    As an obstacle its signed distance is sampled, with the spacing that
    `SignedDistanceField.from_mesh` chooses.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Points [m], not all in one plane.
    center : array_like, shape (3,)
        Where the origin of the points' frame lies [m].
    rotation : array_like, shape (4,)
        Quaternion (w, x, y, z) that turns the points about that origin; is normalised.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        The points, read-only.

    Raises
    ------
    InputError
        If a number is not finite, or there are fewer than 4 points. That all are in one plane is
        found where the hull is made: by `mesh`, or what is given the shape.

    Examples
    --------
    >>> import substep
    >>> hull = substep.ConvexHull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> round(substep.rigid.mass_properties(hull, 6.0).mass, 12)
    1.0
    """

    points: Array
    _fields = ("points", "center", "rotation")

    def __init__(
        self, points: ArrayLike, center: ArrayLike = ORIGIN, rotation: ArrayLike = IDENTITY
    ) -> None:
        own = check_array("points", points, (None, 3))
        if len(own) < 4:
            raise InputError(f"points: expected at least 4, not all in one plane, got {len(own)}")
        own.flags.writeable = False
        self._set(points=own)
        self._place(center, rotation)

    def mesh(self) -> TriangleMesh:
        """The surface as triangles: its faces, cut into them.

        Returns
        -------
        TriangleMesh
            Closed.
        """
        return self._placed(self._surface())

    def _surface(self) -> TriangleMesh:
        return TriangleMesh(*_core.hull_faces(self.points))

    def _rigid_shape(self) -> Any:
        return _core.RigidShape.hull(self.points)
