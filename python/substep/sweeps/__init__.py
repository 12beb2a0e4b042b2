"""Sweeps: one scene or function over many parameters and seeds, on all cores, resumable."""

from .cluster import sweep
from .collection import Run, RunCollection
from .gns import write_gns
from .meshgraphnets import write_meshgraphnets

__all__ = ["Run", "RunCollection", "sweep", "write_gns", "write_meshgraphnets"]


def __dir__() -> list[str]:
    return __all__
