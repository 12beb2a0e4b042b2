"""Reads velocity fields on rectilinear grids from .npz."""

from __future__ import annotations

import math
import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.reading import CONTENT_ERRNOS, DEFLATE_LIMIT
from ..errors import CorruptError, FormatError, TruncatedError

_NAMES = ("x", "y", "z", "lon", "lat", "depth", "times", "values")


def read_npz(path: Path, memory_limit: int) -> tuple[list[Any], Any, Any, bool]:
    """Axes, values, times (or None), and whether the axes are longitude and latitude."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            declared, size = (
                sum(entry.file_size for entry in entries.values()),
                os.path.getsize(path),
            )
            if declared > max(memory_limit, size) or declared > DEFLATE_LIMIT * size:
                raise CorruptError(
                    f"{path}: unpacks to {declared} bytes, more than memory_limit = "
                    f"{memory_limit} or than a file of {size} bytes can hold"
                )
            arrays = {
                name: _read_npy(f"{path}: {name}", archive, entries[name])
                for name in _NAMES
                if name in entries
            }
    except (
        *(zipfile.BadZipFile, zlib.error, struct.error),
        *(OSError, ValueError, EOFError, RuntimeError, KeyError, OverflowError),
    ) as error:
        system = isinstance(error, OSError) and error.errno not in CONTENT_ERRNOS
        if system or isinstance(error, FormatError):
            raise
        kind = TruncatedError if "File is not a zip file" in str(error) else CorruptError
        raise kind(f"{path}: cannot be read as .npz: {error}") from error
    geographic = "lon" in arrays
    names = ("lon", "lat", "depth") if geographic else ("x", "y", "z")
    axes = [arrays[name] for name in names if name in arrays]
    if len(axes) < 2 or "values" not in arrays:
        found = ", ".join(entries)
        raise FormatError(f"{path}: expected x, y or lon, lat, and values; it has {found}")
    return axes, arrays["values"], arrays.get("times"), geographic


def _read_npy(where: str, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """An array of numbers, as long as its header says.

    NEP 1, "A Simple File Format for NumPy Arrays".
    """
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FormatError(f"{where}: compressed otherwise than by deflate; refused")
    with archive.open(entry) as file:
        try:
            version = np.lib.format.read_magic(file)
            if version == (1, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
            else:
                shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
        except Exception as error:  # it parses at most 10,000 characters of Python
            raise CorruptError(f"{where}: not an array of NumPy ({error})") from error
        data = file.read()  # at most entry.file_size bytes, whose checksum agrees
    if dtype.kind not in "fiub":
        raise FormatError(f"{where}: expected numbers, got dtype {dtype}")
    if min(shape, default=0) < 0 or len(data) != math.prod(shape) * dtype.itemsize:
        raise CorruptError(f"{where}: {len(data)} bytes are no array of shape {shape}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
