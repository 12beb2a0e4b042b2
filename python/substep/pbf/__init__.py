"""Position-based fluids: liquids of particles that keep their density."""

from ..particles.emitters import Emitter, Sink
from .fluid import PositionBasedFluid
from .seeding import fill_box, fill_mesh, relax

__all__ = [
    "Emitter",
    "PositionBasedFluid",
    "Sink",
    "fill_box",
    "fill_mesh",
    "relax",
]


def __dir__() -> list[str]:
    return __all__
