"""Mass-spring systems (cloth, nets, chains and ropes) and soft bodies."""

from .mass_spring import MassSpring, SpringInfo, grid_springs
from .soft_body import SoftBody

__all__ = [
    "MassSpring",
    "SoftBody",
    "SpringInfo",
    "grid_springs",
]


def __dir__() -> list[str]:
    return __all__
