"""The material point method: solids, liquids, snow, sand and mud as particles on a grid."""

from .materials import FixedCorotated, Fluid, NeoHookean
from .method import MaterialPointMethod, StepReport
from .plastic import HerschelBulkley, Sand, Snow, VonMises
from .seeding import sample_box, sample_mesh, sample_sphere

__all__ = [
    "FixedCorotated",
    "Fluid",
    "HerschelBulkley",
    "MaterialPointMethod",
    "NeoHookean",
    "Sand",
    "Snow",
    "StepReport",
    "VonMises",
    "sample_box",
    "sample_mesh",
    "sample_sphere",
]


def __dir__() -> list[str]:
    return __all__
