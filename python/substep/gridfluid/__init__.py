"""Fluids on staggered grids: flows that fill their box, and liquids with a free surface."""

from .flow import GridFlow
from .liquid import GridLiquid
from .sides import FlowEmitter, Inflow, Wall

__all__ = ["FlowEmitter", "GridFlow", "GridLiquid", "Inflow", "Wall"]


def __dir__() -> list[str]:
    return __all__
