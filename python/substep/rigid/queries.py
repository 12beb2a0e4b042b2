"""What rigid bodies touch, and what rays and shapes meet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_integer, check_real, describe
from ..base.quaternions import multiply, rotate, unit_quaternions
from ..errors import InputError
from ..geometry import Shape
from .fixtures import EVERYTHING, is_ground
from .rows import BodyRows

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where bodies touch, of `RigidBodies.contacts`: m contacts with k points.

    A contact is two shapes that touch in one plane, at up to four points. Impulses are those of the
    whole last step, bounces included: divided by the step, mean forces.

    Attributes
    ----------
    bodies : ndarray of int64, shape (m, 2)
        Ids of the two bodies.
    fixtures : ndarray of int64, shape (m, 2)
        Which of the shapes of each body.
    normals : ndarray, shape (m, 3)
        Unit vectors from the first body to the second.
    impulses : ndarray, shape (m,)
        Along the normal, on the second body [N s]; the first receives the opposite.
    friction_impulses : ndarray, shape (m, 3)
        Across the normal, on the second body [N s].
    contact : ndarray of int64, shape (k,)
        Which contact a point belongs to.
    points : ndarray, shape (k, 3)
        Midway between the surfaces, at the beginning of the last step [m].
    separations : ndarray, shape (k,)
        Distance of the surfaces along the normal then, negative where they overlap [m].
    point_impulses : ndarray, shape (k,)
        The part of `impulses` at each point [N s].
    """

    bodies: Ids
    fixtures: Ids
    normals: Array
    impulses: Array
    friction_impulses: Array
    contact: Ids
    points: Array
    separations: Array
    point_impulses: Array

    def __len__(self) -> int:
        return len(self.bodies)


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays or shapes met, one row for each.

    Attributes
    ----------
    bodies : ndarray of int64, shape (n,)
        Ids of the bodies, -1 where nothing was met.
    fixtures : ndarray of int64, shape (n,)
        Which of the shapes of the body; -1 where nothing was met.
    distances : ndarray, shape (n,)
        Along the way [m], infinite where nothing was met.
    points : ndarray, shape (n, 3)
        Where the ray, or the origin of the shape, is then [m]; NaN where nothing was met.
    normals : ndarray, shape (n, 3)
        Unit normals of the surfaces hit, against the ray; 0 where nothing was hit or the shape
        overlapped with it at the beginning.
    """

    bodies: Ids
    fixtures: Ids
    distances: Array
    points: Array
    normals: Array

    def __len__(self) -> int:
        return len(self.bodies)


class Queries(BodyRows):
    """Questions to a world of rigid bodies; make `RigidBodies`."""

    def contacts(self) -> Contacts:
        """Contacts of the last step, in an order that does not depend on threads.

        Also those of shapes that are near and not yet in touch: their impulses are 0.

        Returns
        -------
        Contacts
            Copies.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> ground = bodies.add(substep.Plane(), (0, 0, 0), motion="static")
        >>> box = bodies.add(substep.Box((1, 1, 1)), (0, 0, 0.5), mass=2.0)
        >>> bodies.advance(0.25)
        >>> report = bodies.contacts()
        >>> report.bodies.tolist(), len(report.points)
        ([[0, 1]], 4)
        >>> weight = report.impulses / bodies.step_size
        >>> weight.round(6).tolist()
        [19.62]
        """
        rows, *others = self._native.contacts()
        return Contacts(self._ids[rows], *others)

    def contact_force(self, body: int, other: int | None = None) -> Array:
        """Mean force of the last step on a body, by contacts, bounces and friction included.

        Parameters
        ----------
        body : int
            Id of the body on which the force acts.
        other : int, optional
            Id of the body that exerts it; all unless given.

        Returns
        -------
        ndarray, shape (3,)
            In the world [N]; 0 before the first step.

        Raises
        ------
        IndexError
            If there is no such body.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> ground = bodies.add(substep.Plane(), (0, 0, 0), motion="static")
        >>> box = bodies.add(substep.Box((1, 1, 1)), (0, 0, 0.5), mass=2.0)
        >>> bodies.advance(0.25)
        >>> bodies.contact_force(box, ground).round(6) + 0.0
        array([ 0.  ,  0.  , 19.62])
        """
        row = self._row("body", body)
        by = None if other is None else self._row("other", other)
        rows, _, normals, along, across, *_ = self._native.contacts()
        a, b = rows.T
        impulses = along[:, None] * normals + across
        on_second = (b == row) & (by is None or a == by)
        on_first = (a == row) & (by is None or b == by)
        total: Array = impulses[on_second].sum(axis=0) - impulses[on_first].sum(axis=0)
        return total / self._last.dt if self._last.dt > 0 else np.zeros(3)

    def ray_cast(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        length: float = math.inf,
        *,
        mask: int = EVERYTHING,
    ) -> Hits:
        """What rays meet first.

        A ray meets a surface from outside only; one that begins within a solid does not meet it.

        Parameters
        ----------
        origins : array_like, shape (3,) or (n, 3)
            Where the rays begin [m].
        directions : array_like, shape (3,) for all or (n, 3)
            Where they go; are normalised.
        length : float, optional
            How far they go at most [m].
        mask : int, optional
            Only shapes whose group has a bit of it count.

        Returns
        -------
        Hits
            One row for each ray.

        Raises
        ------
        InputError
            If an argument is wrong.
        """
        x = np.atleast_2d(check_array("origins", origins))
        x = check_array("origins", x, (None, 3))
        d = check_array("directions", directions)
        d = _unit("directions", check_array("directions", d, (3,) if d.ndim == 1 else (len(x), 3)))
        d = np.ascontiguousarray(np.broadcast_to(d, x.shape))
        reach = check_real("length", length, nonnegative=True, finite=False)
        bits = _check_mask(mask)
        return self._hits(x, d, *self._native.cast_rays(x, d, reach, bits))

    def ray_cast_all(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        length: float = math.inf,
        *,
        mask: int = EVERYTHING,
    ) -> Hits:
        """All shapes that a ray meets, each where it meets them first.

        Parameters
        ----------
        origin : array_like, shape (3,)
            Where the ray begins [m].
        direction : array_like, shape (3,)
            Where it goes; is normalised.
        length : float, optional
            How far it goes at most [m].
        mask : int, optional
            Only shapes whose group has a bit of it count.

        Returns
        -------
        Hits
            From near to far.

        Raises
        ------
        InputError
            If an argument is wrong.
        """
        x = check_array("origin", origin, (3,))
        d = _unit("direction", check_array("direction", direction, (3,)))
        reach = check_real("length", length, nonnegative=True, finite=False)
        bits = _check_mask(mask)
        return self._hits(x, d, *self._native.cast_ray_through(x, d, reach, bits))

    def shape_cast(
        self,
        shape: Shape,
        position: ArrayLike,
        direction: ArrayLike,
        length: float,
        *,
        rotation: ArrayLike = (1.0, 0.0, 0.0, 0.0),
        mask: int = EVERYTHING,
    ) -> Hits:
        """What a shape meets first on its way, without turning.

        Parameters
        ----------
        shape : Sphere, Box, Capsule, Cylinder or ConvexHull
            The shape.
        position : array_like, shape (3,)
            Where the frame begins in which the shape has its centre and rotation [m].
        direction : array_like, shape (3,)
            Where it goes; is normalised.
        length : float
            How far it goes at most [m].
        rotation : array_like, shape (4,), optional
            Quaternion (w, x, y, z) that turns that frame; is normalised.
        mask : int, optional
            Only shapes whose group has a bit of it count.

        Returns
        -------
        Hits
            One row; shapes that it overlaps at the beginning are met at 0.

        Raises
        ------
        InputError
            If an argument is wrong.
        """
        x = check_array("position", position, (3,))
        q = unit_quaternions("rotation", rotation, (4,))
        d = _unit("direction", check_array("direction", direction, (3,)))
        way = check_real("length", length, nonnegative=True)
        bits = _check_mask(mask)
        native = _convex(shape, x, q)
        return self._hits(x, d, *self._native.cast_shape(*native, d, way, bits))

    def overlapping(
        self,
        shape: Shape,
        position: ArrayLike,
        *,
        rotation: ArrayLike = (1.0, 0.0, 0.0, 0.0),
        mask: int = EVERYTHING,
    ) -> Ids:
        """Which bodies a shape overlaps with or touches.

        Parameters
        ----------
        shape : Sphere, Box, Capsule, Cylinder or ConvexHull
            The shape.
        position : array_like, shape (3,)
            Where the frame is in which the shape has its centre and rotation [m].
        rotation : array_like, shape (4,), optional
            Quaternion (w, x, y, z) that turns that frame; is normalised.
        mask : int, optional
            Only shapes whose group has a bit of it count.

        Returns
        -------
        ndarray of int64, shape (m,)
            Their ids, ascending.

        Raises
        ------
        InputError
            If an argument is wrong.
        """
        x = check_array("position", position, (3,))
        q = unit_quaternions("rotation", rotation, (4,))
        bits = _check_mask(mask)
        native = _convex(shape, x, q)
        rows = np.unique(self._native.overlapping(*native, bits))
        ids: Ids = self._ids[rows]
        return ids

    def _hits(self, x: Array, d: Array, rows: Ids, fixtures: Ids, t: Array, n: Array) -> Hits:
        met = rows >= 0
        bodies = np.full(len(rows), -1, np.int64)
        bodies[met] = self._ids[rows[met]]
        t = np.where(met, t, np.inf)
        points = np.full((len(rows), 3), np.nan)
        points[met] = (x + np.where(met, t, 0.0)[:, None] * d)[met]
        return Hits(bodies, fixtures, t, points, n)


def _unit(name: str, d: Array) -> Array:
    largest = np.abs(d).max(axis=-1, keepdims=True, initial=0.0)
    if not largest.all():
        raise InputError(f"{name}: expected vectors that are not 0")
    scaled = d / largest
    unit: Array = scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)
    unit[np.abs(unit) < 1e-150] = 0.0  # where it led to is beyond float64
    return unit


def _check_mask(mask: Any) -> int:
    return check_integer("mask", mask, minimum=0, maximum=EVERYTHING)


def _convex(shape: Any, x: Array, q: Array) -> tuple[Any, Array, Array]:
    """The shape of the native core, and its pose where its frame is at x, turned by q."""
    if not isinstance(shape, Shape):
        raise TypeError(f"shape: expected a shape, got {describe(shape)}")
    if is_ground(shape):
        raise InputError(f"shape: expected a convex shape with an end, got {describe(shape)}")
    native, center, turn = shape._rigid()
    return native, x + rotate(q, center), multiply(q, turn)
