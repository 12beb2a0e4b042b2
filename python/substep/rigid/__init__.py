"""Rigid bodies: shapes and mass, contact with friction, joints, queries.

Rotations are unit quaternions (w, x, y, z) that take the frame of the body into the world.
"""

from ..geometry import Box, Capsule, ConvexHull, Cylinder, Plane, Sphere
from .batch import RigidBatch
from .bodies import RigidBodies
from .fixtures import Fixture
from .joint import Joint, SpeedMotor, SpringMotor, TurnSpring
from .mass import MassProperties, compound, mass_properties
from .queries import Contacts, Hits
from .rotation import free_rotation

__all__ = [
    "Box",
    "Capsule",
    "Contacts",
    "ConvexHull",
    "Cylinder",
    "Fixture",
    "Hits",
    "Joint",
    "MassProperties",
    "Plane",
    "RigidBatch",
    "RigidBodies",
    "SpeedMotor",
    "Sphere",
    "SpringMotor",
    "TurnSpring",
    "compound",
    "free_rotation",
    "mass_properties",
]


def __dir__() -> list[str]:
    return __all__
