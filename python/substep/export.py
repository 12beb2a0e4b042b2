"""Packs a journal into VTKHDF, in a process of its own: HDF5 may crash on a full disk.

`python -m substep.export RECORDING [--out FILE] [--overwrite]` is that process.
"""

from __future__ import annotations

import sys

from .recording.packing import main, pack, pack_here as pack_here

__all__ = ["pack"]


def __dir__() -> list[str]:
    return __all__


if __name__ == "__main__":
    sys.exit(main())
