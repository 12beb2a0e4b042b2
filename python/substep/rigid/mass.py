"""Mass, centre and inertia of rigid bodies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_real, describe, first_bad_index
from ..errors import InputError
from ..geometry import TriangleMesh
from .shapes import Box, Capsule, ConvexHull, Cylinder, Sphere

Array = NDArray[np.float64]


def unit_quaternions(name: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Quaternions as new unit rows; those of length 1 within rounding keep their bits."""
    q = check_array(name, value, shape)
    largest = np.abs(q).max(axis=-1, keepdims=True, initial=0.0)
    if not largest.all():
        where = first_bad_index(largest[..., 0] == 0) if q.ndim > 1 else ""
        raise InputError(f"{name}{where}: expected a quaternion that is not 0")
    scaled = q / largest
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    with np.errstate(over="ignore"):
        off = np.abs(largest * length - 1) > 4e-16
    unit: Array = np.where(off, scaled / length, q)
    return unit


class MassProperties:
    """Mass, centre of mass and inertia of a body.

    Parameters
    ----------
    mass : float
        Mass [kg].
    centre : array_like, shape (3,)
        Centre of mass [m].
    inertia : array_like, shape (3, 3)
        Inertia about the centre of mass, along the axes of the frame [kg m^2].

    Attributes
    ----------
    mass : float
        Mass [kg].
    centre : ndarray, shape (3,)
        Centre of mass [m].
    inertia : ndarray, shape (3, 3)
        Inertia about the centre of mass, along the axes of the frame [kg m^2].
    principal_inertia : ndarray, shape (3,)
        Inertia about the principal axes [kg m^2].
    axes : ndarray, shape (4,)
        Quaternion that takes the principal axes into the frame. Of all frames of principal axes it
        is the one nearest to the frame itself; moments that differ by rounding count as equal.

    Raises
    ------
    InputError
        If the mass or a principal moment is not above 0, one of the moments is greater than the sum
        of the other two, or the inertia is not symmetric.

    See Also
    --------
    mass_properties : Those of a shape.
    compound : Those of several bodies together.

    Examples
    --------
    >>> import substep
    >>> body = substep.rigid.MassProperties(
    ...     2.0, [0, 0, 0], [[3, 1, 0], [1, 3, 0], [0, 0, 5]]
    ... )
    >>> body.principal_inertia.round(12)
    array([2., 4., 5.])
    """

    mass: float
    centre: Array
    inertia: Array
    principal_inertia: Array
    axes: Array

    def __init__(self, mass: float, centre: ArrayLike, inertia: ArrayLike) -> None:
        rows = check_array("inertia", inertia, (3, 3))
        self._set(
            _core.MassMoments(
                check_real("mass", mass), check_array("centre", centre, (3,)), rows.ravel()
            )
        )

    @classmethod
    def _of(cls, moments: _core.MassMoments) -> MassProperties:
        properties = cls.__new__(cls)
        properties._set(moments)
        return properties

    def _set(self, moments: _core.MassMoments) -> None:
        axes, principal = moments.principal()
        self._moments = moments
        self.mass = moments.mass
        self.centre = np.array(moments.centre)
        self.inertia = np.array(moments.inertia).reshape(3, 3)
        self.principal_inertia = np.array(principal)
        self.axes = np.array(axes)

    def __reduce__(self) -> tuple[Any, ...]:
        return MassProperties, (self.mass, self.centre, self.inertia)

    def __repr__(self) -> str:
        return (
            f"MassProperties(mass={self.mass:g}, centre={self.centre.tolist()}, "
            f"principal_inertia={self.principal_inertia.tolist()})"
        )

    def moved(self, position: ArrayLike, rotation: ArrayLike = (1, 0, 0, 0)) -> MassProperties:
        """The properties of the same body placed in another frame.

        Parameters
        ----------
        position : array_like, shape (3,)
            Where the origin of the body's frame comes to lie [m].
        rotation : array_like, shape (4,), optional
            Quaternion (w, x, y, z) that turns the body's frame; is normalised.

        Returns
        -------
        MassProperties
            In the other frame.
        """
        return MassProperties._of(
            self._moments.moved(
                check_array("position", position, (3,)),
                unit_quaternions("rotation", rotation, (4,)),
            )
        )


def mass_properties(
    shape: Sphere | Box | Capsule | Cylinder | ConvexHull | TriangleMesh, density: float = 1000.0
) -> MassProperties:
    """Mass, centre of mass and inertia of a solid of uniform density.

    Parameters
    ----------
    shape : Sphere, Box, Capsule, Cylinder, ConvexHull or geometry.TriangleMesh
        The solid. A mesh must be closed, look outward, and not cut itself; it may be hollow or
        consist of several parts.
    density : float, optional
        Density [kg/m^3].

    Returns
    -------
    MassProperties
        In the frame of the shape; exact up to rounding, for meshes too.

    Raises
    ------
    InputError
        If the density is not above 0, or a mesh bounds no solid.

    References
    ----------
    Mirtich (1996), "Fast and accurate computation of polyhedral mass properties", J. Graph. Tools
    1(2); Eberly (2002), "Polyhedral mass properties (revisited)".

    Examples
    --------
    A flat box, and two of it as a cross:

    >>> import substep
    >>> plate = substep.rigid.mass_properties(substep.rigid.Box((0.5, 0.25, 0.1)), 10.0)
    >>> round(plate.mass, 12)
    1.0
    >>> plate.principal_inertia.round(6)
    array([0.024167, 0.086667, 0.104167])
    >>> cross = substep.rigid.compound([plate, plate.moved([0, 0, 0.2], [1, 0, 0, 1])])
    >>> cross.centre.round(12)
    array([0. , 0. , 0.1])
    """
    rho = check_real("density", density, positive=True)
    match shape:
        case Sphere():
            moments = _core.sphere_moments(shape.radius, rho)
        case Box():
            moments = _core.box_moments(shape.half_lengths, rho)
        case Capsule():
            moments = _core.capsule_moments(shape.radius, shape.half_length, rho)
        case Cylinder():
            moments = _core.cylinder_moments(shape.radius, shape.half_length, rho)
        case ConvexHull():
            moments = _core.hull_moments(shape.points, rho)
        case TriangleMesh():
            moments = _core.mesh_moments(shape.vertices, shape.faces, rho)
            pierced = shape.report().pierced
            if pierced:
                raise InputError(
                    f"shape: the mesh cuts itself: {pierced} edges pass through a face"
                )
        case _:
            raise TypeError(f"shape: expected a shape or a TriangleMesh, got {describe(shape)}")
    return MassProperties._of(moments)


def compound(parts: Iterable[MassProperties]) -> MassProperties:
    """Mass, centre of mass and inertia of several bodies that are one.

    Parameters
    ----------
    parts : iterable of MassProperties
        The parts, each where it is (`MassProperties.moved`) in the frame that they share.

    Returns
    -------
    MassProperties
        In that frame, by the theorem of parallel axes.

    Raises
    ------
    InputError
        If there is no part.

    Examples
    --------
    >>> import substep
    >>> ball = substep.rigid.mass_properties(substep.rigid.Sphere(0.1))
    >>> dumbbell = substep.rigid.compound([ball.moved([0, 0, -1]), ball.moved([0, 0, 1])])
    >>> dumbbell.principal_inertia.round(3)
    array([8.411, 8.411, 0.034])
    """
    listed = list(parts)
    for part in listed:
        if not isinstance(part, MassProperties):
            raise TypeError(f"parts: expected MassProperties, got {describe(part)}")
    if not listed:
        raise InputError("parts: expected at least one body")
    return MassProperties._of(_core.sum_moments([part._moments for part in listed]))
