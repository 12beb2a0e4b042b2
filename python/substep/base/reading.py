"""What readers of files share: strict JSON, how far an HDF5 file is believed."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import stat
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CorruptError, FormatError, TruncatedError

# Deflate shrinks no more than this: https://zlib.net/zlib_tech.html, Maximum Compression Factor.
DEFLATE_LIMIT = 1032
DEFLATE, SHUFFLE, FLETCHER32 = 1, 2, 3  # filters of the HDF5 library itself
CONTENT_ERRNOS = (None, errno.EINVAL, errno.EOVERFLOW, errno.EFBIG)


def check_regular(path: str) -> None:
    """Refuse a pipe or a device, which to open or to read could wait for ever."""
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):  # a folder is refused as it is opened
        raise FormatError(f"{path}: expected a file, got a pipe or a device")


def load_json(data: bytes, where: str) -> Any:
    """JSON as the standard has it: no NaN, no infinity, no key twice; else CorruptError."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len({key for key, _ in pairs}) != len(pairs):
            raise ValueError("a key is given twice")
        return dict(pairs)

    def finite(text: str) -> float:
        if not math.isfinite(value := float(text)):
            raise ValueError(f"the number {text[:20]} is not finite")
        return value

    try:
        return json.loads(
            data.decode(), object_pairs_hook=unique, parse_float=finite, parse_constant=finite
        )
    except (ValueError, RecursionError) as error:
        raise CorruptError(f"{where}: metadata is not valid JSON ({error})") from None


def check_booleans(array: NDArray[Any], where: str) -> None:
    """Refuse bytes that are taken for booleans and are neither 0 nor 1."""
    if array.dtype == bool and array.view(np.uint8).max(initial=0) > 1:
        raise CorruptError(f"{where}: expected booleans, got other bytes")


@contextlib.contextmanager
def hdf5_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """What h5py raises on a damaged file becomes CorruptError or TruncatedError."""
    try:
        yield
    except (FormatError, MemoryError):
        raise
    except (
        OSError,
        RuntimeError,
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
        IndexError,
        OverflowError,
    ) as error:
        if isinstance(error, OSError) and error.errno not in CONTENT_ERRNOS:
            raise
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        kind = TruncatedError if "truncated file" in text else CorruptError
        raise kind(f"{path}: HDF5 cannot read it: {text}") from None


def check_hdf5_storage(dataset: Any, where: str) -> set[int]:
    """The filters of a dataset, which is refused if it needs other files or foreign filters."""
    if dataset.external or dataset.is_virtual:
        raise CorruptError(f"{where}: data in other files are refused")
    properties = dataset.id.get_create_plist()
    filters = {properties.get_filter(k)[0] for k in range(properties.get_nfilters())}
    if foreign := filters - {DEFLATE, SHUFFLE, FLETCHER32}:
        raise CorruptError(f"{where}: filter {min(foreign)} is refused")
    return filters
