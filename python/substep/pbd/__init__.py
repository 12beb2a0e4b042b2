"""Position-based dynamics: ropes, cloth and soft bodies as constraints on positions."""

from .bodies import cloth, rope, soft_body, tethers
from .clusters import ShapeMatching, vertex_clusters
from .collision import ParticleCollision, SelfCollision
from .constraints import (
    Attachment,
    Bending,
    Distance,
    IsometricBending,
    NeoHookean,
    Tether,
    TetrahedronVolume,
    TriangleArea,
)
from .custom import CustomConstraint
from .dynamics import PositionBasedDynamics

__all__ = [
    "Attachment",
    "Bending",
    "CustomConstraint",
    "Distance",
    "IsometricBending",
    "NeoHookean",
    "ParticleCollision",
    "PositionBasedDynamics",
    "SelfCollision",
    "ShapeMatching",
    "Tether",
    "TetrahedronVolume",
    "TriangleArea",
    "cloth",
    "rope",
    "soft_body",
    "tethers",
    "vertex_clusters",
]


def __dir__() -> list[str]:
    return __all__
