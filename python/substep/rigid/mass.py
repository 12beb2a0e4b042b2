"""Mass, centre and inertia of rigid bodies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_real, check_sequence, describe
from ..base.quaternions import unit_quaternions
from ..errors import InputError
from ..geometry import Shape

Array = NDArray[np.float64]


class MassProperties:
    """Mass, centre of mass and inertia of a body.

    Parameters
    ----------
    mass : float
        Mass [kg].
    center_of_mass : array_like, shape (3,)
        Centre of mass [m].
    inertia : array_like, shape (3, 3)
        Inertia about the centre of mass, along the axes of the frame [kg m^2].

    Attributes
    ----------
    mass : float
        Mass [kg].
    center_of_mass : ndarray, shape (3,)
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
    center_of_mass: Array
    inertia: Array
    principal_inertia: Array
    axes: Array

    def __init__(self, mass: float, center_of_mass: ArrayLike, inertia: ArrayLike) -> None:
        rows = check_array("inertia", inertia, (3, 3))
        self._set(
            _core.MassMoments(
                check_real("mass", mass),
                check_array("center_of_mass", center_of_mass, (3,)),
                rows.ravel(),
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
        self.center_of_mass = np.array(moments.centre)
        self.inertia = np.array(moments.inertia).reshape(3, 3)
        self.principal_inertia = np.array(principal)
        self.axes = np.array(axes)

    def __reduce__(self) -> tuple[Any, ...]:
        return MassProperties, (self.mass, self.center_of_mass, self.inertia)

    def __repr__(self) -> str:
        return (
            f"MassProperties(mass={self.mass:g}, center_of_mass={self.center_of_mass.tolist()}, "
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


def mass_properties(shape: Shape, density: float = 1000.0) -> MassProperties:
    """Mass, centre of mass and inertia of a solid of uniform density.

    Parameters
    ----------
    shape : Sphere, Box, Capsule, Cylinder, ConvexHull or TriangleMesh
        The solid. A mesh must be closed, look outward, and not cut itself; it may be hollow or
        consist of several parts.
    density : float, optional
        Density [kg/m^3].

    Returns
    -------
    MassProperties
        In the frame in which the shape has its centre and rotation; exact up to rounding, for
        meshes too.

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
    >>> plate = substep.rigid.mass_properties(substep.Box((1, 0.5, 0.2)), 10.0)
    >>> round(plate.mass, 12)
    1.0
    >>> plate.principal_inertia.round(6)
    array([0.024167, 0.086667, 0.104167])
    >>> cross = substep.rigid.compound([plate, plate.moved([0, 0, 0.2], [1, 0, 0, 1])])
    >>> cross.center_of_mass.round(12)
    array([0. , 0. , 0.1])
    """
    rho = check_real("density", density, positive=True)
    if not isinstance(shape, Shape):
        raise TypeError(f"shape: expected a shape, got {describe(shape)}")
    return MassProperties._of(shape._moments(rho)).moved(shape.center, shape.rotation)


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
    >>> ball = substep.rigid.mass_properties(substep.Sphere(0.1))
    >>> dumbbell = substep.rigid.compound([ball.moved([0, 0, -1]), ball.moved([0, 0, 1])])
    >>> dumbbell.principal_inertia.round(3)
    array([8.411, 8.411, 0.034])
    """
    listed = check_sequence("parts", parts, "MassProperties")
    for part in listed:
        if not isinstance(part, MassProperties):
            raise TypeError(f"parts: expected MassProperties, got {describe(part)}")
    if not listed:
        raise InputError("parts: expected at least one body")
    return MassProperties._of(_core.sum_moments([part._moments for part in listed]))
