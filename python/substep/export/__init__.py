"""Leaving with a recording: packed into VTKHDF, or written as USD, arrays, tables and meshes.

`python -m substep.export RECORDING [--out FILE] [--overwrite]` packs in a process of its own.
"""

from ..recording.packing import pack, pack_here as pack_here
from .save import save

__all__ = ["pack", "save"]


def __dir__() -> list[str]:
    return __all__
