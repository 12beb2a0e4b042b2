"""Many simulations of particles or springs that know nothing of each other, in one call."""

from .batch import Batch

__all__ = ["Batch"]


def __dir__() -> list[str]:
    return __all__
