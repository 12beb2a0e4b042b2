"""Grid fluids: flows and liquids whose pressure lives on a staggered grid."""

from .liquid import GridLiquid

__all__ = ["GridLiquid"]


def __dir__() -> list[str]:
    return __all__
