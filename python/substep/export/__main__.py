"""Packs a journal into VTKHDF: HDF5 may crash on a full disk, so it has a process of its own."""

import sys

from ..recording.packing import main

if __name__ == "__main__":
    sys.exit(main())
