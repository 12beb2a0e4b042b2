"""Particles in velocity fields: fields in closed form, on grids and from files, and advection.

See docs/fields.md for the equations and the limits of the model.
"""

from .advection import ACTIVE, ESCAPED, LANDED, Advection
from .curvilinear import CurvilinearField
from .files import open_field
from .flows import ABC, DoubleGyre, Field, RigidRotation, Shear, TaylorGreen
from .grid import GridField
from .levels import EARTH_RADIUS
from .paths import AdvectionResult, advect

__all__ = [
    "ABC",
    "ACTIVE",
    "EARTH_RADIUS",
    "ESCAPED",
    "LANDED",
    "Advection",
    "AdvectionResult",
    "CurvilinearField",
    "DoubleGyre",
    "Field",
    "GridField",
    "RigidRotation",
    "Shear",
    "TaylorGreen",
    "advect",
    "open_field",
]


def __dir__() -> list[str]:
    return __all__
