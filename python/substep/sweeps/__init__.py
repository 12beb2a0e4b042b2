"""Sweeps: one scene or function over many parameters and seeds, on all cores, resumable."""

from .cluster import sweep
from .collection import Run, RunCollection
from .gns import write_gns

__all__ = ["Run", "RunCollection", "sweep", "write_gns"]


def __dir__() -> list[str]:
    return __all__
