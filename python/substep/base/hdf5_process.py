"""Reads HDF5 for `base/hdf5.py`, which runs it as a program.

Each line of standard input asks for something, in JSON: what, of which file, with which arguments,
and how many bytes are expected. Each answer is a line of JSON, [kind and message and number of an
exception, or three empty ones; bytes that follow], and these bytes. It may take 1 GiB of memory and
2 s of processor time for an answer, besides what the expected bytes need.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import time
from typing import Any

import h5py
import numpy as np

from ..errors import CorruptError, FormatError
from .reading import DEFLATE_LIMIT, check_hdf5_storage, hdf5_errors

MEMORY = 1 << 30
SECONDS = 2
BYTES_PER_SECOND = 10_000_000
MOST_DIMENSIONS = 32  # of a variable; NumPy has 64


def header(path: str, wanted: list[str]) -> bytes:
    """Name, names of dimensions, shape and attributes of each variable, as JSON.

    Of attributes there are those that are `wanted`, in lower case; others may be of any type.
    """
    found = []
    with h5py.File(path, "r") as file:
        for name in file:
            dataset = _dataset(path, file, name)
            if dataset is None:
                continue
            if dataset.ndim > MOST_DIMENSIONS:
                raise CorruptError(f"{path}: variable {name} of {dataset.ndim} dimensions")
            dims = [_dimension_name(dataset, i) for i in range(dataset.ndim)]
            found.append((name, dims, dataset.shape, _attributes(path, dataset, wanted)))
    return json.dumps(found).encode()


def numbers(path: str, name: str, indices: dict[str, int], limit: int) -> bytes:
    """A line of JSON with dtype and shape, then the numbers at these indices of dimensions."""
    size = os.path.getsize(path)
    with h5py.File(path, "r") as file:
        dataset = _dataset(path, file, name)
        at = {int(number): index for number, index in indices.items()}
        kept = math.prod(n for d, n in enumerate(dataset.shape) if d not in at)
        count = max(kept, math.prod(dataset.chunks or ()))
        if count * dataset.dtype.itemsize > DEFLATE_LIMIT * size:
            raise CorruptError(f"{path}: {name} declares more than {size} bytes can hold")
        if count * 8 > max(limit, size * 8):  # as float64
            raise FormatError(
                f"{path}: {name} unpacks to {count * 8} bytes, more than memory_limit = {limit}"
            )
        array = np.asarray(dataset[tuple(at.get(d, slice(None)) for d in range(dataset.ndim))])
        return json.dumps([array.dtype.str, array.shape]).encode() + b"\n" + array.tobytes()


def _dataset(path: str, file: Any, name: str) -> Any:
    """What `name` is, if that is an array of numbers, and in the file itself."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise CorruptError(f"{path}: {name} is a link out of the file; refused")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
        return None
    if dataset.shape is None:
        return None
    check_hdf5_storage(dataset, f"{path}: {name}")
    return dataset


def _attributes(path: str, dataset: Any, wanted: list[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key in dataset.attrs:
        if key.lower() not in wanted:
            continue
        if dataset.attrs.get_id(key).get_storage_size() > os.path.getsize(path):
            raise CorruptError(f"{path}: attribute {key} of {dataset.name} is larger than the file")
        value = dataset.attrs[key]
        if isinstance(value, bytes):
            value = value.decode(errors="replace")
        array = np.asarray(value)
        values[key] = array.ravel().tolist() if array.dtype.kind in "fiu" else str(value)
    return values


def _dimension_name(dataset: Any, number: int) -> str:
    if dataset.is_scale:
        return str(dataset.name).lstrip("/")
    scales = dataset.dims[number]
    return str(scales[0].name).lstrip("/") if len(scales) else f"dimension {number}"


def limit_for(expected: int) -> None:
    """Let the system end this process when the next answer takes more."""
    with contextlib.suppress(ImportError, OSError, ValueError):  # where there are no limits
        import resource

        seconds = math.ceil(time.process_time()) + SECONDS + expected // BYTES_PER_SECOND
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        forever = resource.getrlimit(resource.RLIMIT_CPU)[1]
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, forever))
        with open("/proc/self/statm") as statm:
            memory = int(statm.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        most = memory + MEMORY + 3 * expected
        if hard == resource.RLIM_INFINITY or most < hard:
            resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def answer(what: str, path: str, arguments: list[Any], expected: int) -> tuple[list[Any], bytes]:
    """The first line of an answer, and what follows it."""
    limit_for(expected)
    content = b""
    try:
        with hdf5_errors(path):
            content = header(path, *arguments) if what == "header" else numbers(path, *arguments)
        exception: list[Any] = ["", "", None]
    except OSError as error:
        exception = ["OSError", error.strerror or str(error), error.errno]
    except Exception as error:
        exception = [type(error).__name__, str(error), None]
    return [*exception, len(content)], content


def main() -> None:
    """Answer until standard input ends."""
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        for line in sys.stdin.buffer:
            first, content = answer(*json.loads(line))
            answers.write(json.dumps(first).encode() + b"\n")
            answers.write(content)
            answers.flush()


if __name__ == "__main__":
    main()
