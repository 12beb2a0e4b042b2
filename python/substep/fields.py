"""Particles in velocity fields: fields in closed form, on grids and from files, and advection.

See docs/fields.md for the equations, for what is modelled and what is not.
"""

from ._advect import AdvectionResult, advect
from ._advection import ACTIVE, ESCAPED, LANDED, Advection
from ._flows import ABC, DoubleGyre, Field, RigidRotation, Shear, TaylorGreen
from ._grid import EARTH_RADIUS, GridField
from ._open_field import open_field

__all__ = [
    "ABC",
    "ACTIVE",
    "EARTH_RADIUS",
    "ESCAPED",
    "LANDED",
    "Advection",
    "AdvectionResult",
    "DoubleGyre",
    "Field",
    "GridField",
    "RigidRotation",
    "Shear",
    "TaylorGreen",
    "advect",
    "open_field",
]
