"""Reads NetCDF: the classic formats (CDF-1, CDF-2, CDF-5) itself, NetCDF-4 through h5py.

Format: "NetCDF Classic Format Specification" (Unidata, docs.unidata.ucar.edu/nug, file format
specifications). Only headers are read at first; sizes are compared with the file's before
anything is allocated, in NetCDF-4, which compresses, with a limit too.
"""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.hdf5 import ask_hdf5
from ..base.reading import DEFLATE_LIMIT
from ..errors import CorruptError, FormatError, TruncatedError

_TYPES = {
    1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8",
    7: "u1", 8: ">u2", 9: ">u4", 10: ">i8", 11: ">u8",
}  # fmt: skip
_MOST_DIMENSIONS = 32  # of a variable; NumPy has 64
_BLOCK = 1 << 22  # bytes that are read at once
# What is read of the attributes of NetCDF-4, in lower case; others may be of any type.
_ATTRIBUTES = {
    "standard_name", "units", "unit", "axis", "positive", "calendar", "_fillvalue", "missing_value",
    "valid_min", "valid_max", "valid_range", "scale_factor", "add_offset", "coordinates",
}  # fmt: skip


@dataclass
class Variable:
    """A variable: names and lengths of its dimensions, attributes, and how to read it."""

    name: str
    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    attributes: dict[str, Any]
    read: Callable[[dict[int, int]], NDArray[Any]] = field(repr=False)
    """read({dimension number: index, ...}) gives the raw numbers, these dimensions dropped."""


def read_header(path: str | os.PathLike[str], limit: int) -> dict[str, Variable]:
    """List the variables of a NetCDF file by name.

    What a compressed one unpacks to may be larger than the file up to `limit` bytes.
    """
    with open(path, "rb") as file:
        magic = file.read(8)
    if magic[:3] == b"CDF" and len(magic) >= 4:
        if magic[3] not in (1, 2, 5):
            raise FormatError(f"{path}: NetCDF classic of unknown version {magic[3]}")
        return _Classic(path, magic[3]).variables
    if magic == b"\x89HDF\r\n\x1a\n":
        return _read_hdf5(path, limit)
    if not magic:
        raise TruncatedError(f"{path}: the file is empty")
    raise FormatError(f"{path}: neither NetCDF nor .npz")


class _Classic:
    def __init__(self, path: str | os.PathLike[str], version: int) -> None:
        self.path, self.version = path, version
        self.size = os.path.getsize(path)
        with open(path, "rb") as self.file:
            self.file.seek(4)
            records = self._number()
            dimensions = self._list(0x0A, lambda: (self._name(), self._number()))
            self._list(0x0C, self._attribute)
            raw = self._list(0x0B, self._variable)
        names = [name for name, _ in dimensions]
        for what, listed in (("dimensions", names), ("variables", [entry[0] for entry in raw])):
            if len(set(listed)) != len(listed):
                raise CorruptError(f"{path}: two {what} have the same name")
        unlimited = {i for i, (_, length) in enumerate(dimensions) if length == 0}
        if len(unlimited) > 1:
            raise CorruptError(f"{path}: {len(unlimited)} record dimensions; there can be one")
        for name, numbers, _, _, _ in raw:
            if bad := [i for i in numbers if i >= len(names)]:
                raise CorruptError(f"{path}: {name} has dimension {bad[0]} of {len(names)}")
            if unlimited.intersection(numbers[1:]):
                raise CorruptError(f"{path}: the record dimension is not the first of {name}")
        recorded = [entry for entry in raw if unlimited.intersection(entry[1])]

        def row_bytes(entry: Any) -> int:  # of one record or row, not padded; at least 1
            lengths = [dimensions[i][1] for i in entry[1][1:]]
            return math.prod(lengths) * np.dtype(_TYPES[entry[3]]).itemsize

        record_bytes = sum(row_bytes(e) + -row_bytes(e) % 4 for e in recorded)
        if len(recorded) == 1:  # a single record variable is not padded
            record_bytes = row_bytes(recorded[0])
        streaming = 0xFFFFFFFF if version != 5 else 0xFFFFFFFFFFFFFFFF
        if records == streaming and recorded:
            start = min(entry[4] for entry in recorded)
            records = max(0, (self.size - start) // record_bytes)

        self.variables: dict[str, Variable] = {}
        for entry in raw:
            name, numbers, attributes, kind, begin = entry
            lengths = [records if i in unlimited else dimensions[i][1] for i in numbers]
            rows, row = lengths[0] if lengths else 1, row_bytes(entry)
            stride = record_bytes if unlimited.intersection(numbers) else row
            end = begin + (max(rows - 1, 0) * stride + row if rows else 0)
            if end > self.size:
                raise TruncatedError(
                    f"{path}: ends at byte {self.size}, but variable {name} reaches to byte {end}"
                )
            read = self._reader(tuple(lengths), np.dtype(_TYPES[kind]), begin, stride)
            dims = tuple(names[i] for i in numbers)
            self.variables[name] = Variable(name, dims, tuple(lengths), attributes, read)

    def _reader(
        self, shape: tuple[int, ...], dtype: np.dtype[Any], begin: int, stride: int
    ) -> Callable[[dict[int, int]], NDArray[Any]]:
        """How to read a variable whose rows lie `stride` bytes apart, as records do."""
        path, count = self.path, math.prod(shape[1:])

        def read(indices: dict[int, int]) -> NDArray[Any]:
            first = indices.get(0)
            rows = (shape[0] if shape else 1) if first is None else 1
            start = begin + (first or 0) * stride
            values = np.empty((rows, count), dtype)
            step = max(1, _BLOCK // stride)
            with open(path, "rb") as file:
                for row in range(0, rows, step):
                    number = min(step, rows - row)
                    length = (number - 1) * stride + count * dtype.itemsize
                    file.seek(start + row * stride)
                    data = file.read(length)
                    if len(data) < length:
                        raise TruncatedError(f"{path}: ends within a variable")
                    spaced = (stride, dtype.itemsize)
                    block = np.ndarray((number, count), dtype, data, strides=spaced)
                    values[row : row + number] = block
            shaped = values.reshape(rows, *shape[1:])
            if first is not None or not shape:
                shaped = shaped[0]
            dropped = 0 if first is None else 1
            key = tuple(indices.get(d, slice(None)) for d in range(dropped, len(shape)))
            return shaped[key] if key else shaped

        return read

    def _bytes(self, count: int) -> bytes:
        at = self.file.tell()
        if at + count > self.size:
            raise TruncatedError(f"{self.path}: ends at byte {self.size}, within its header")
        return self.file.read(count)

    def _u4(self) -> int:
        return int(struct.unpack(">I", self._bytes(4))[0])

    def _number(self) -> int:
        return int(struct.unpack(">Q", self._bytes(8))[0]) if self.version == 5 else self._u4()

    def _name(self) -> str:
        length = self._number()
        text = self._bytes(length + -length % 4)[:length]
        try:
            return text.decode()
        except UnicodeDecodeError:
            raise CorruptError(f"{self.path}: a name in the header is not UTF-8") from None

    def _list(self, tag: int, entry: Callable[[], Any]) -> list[Any]:
        at = self.file.tell()
        found, count = self._u4(), self._number()
        if found not in (0, tag) or (found == 0 and count):
            raise CorruptError(f"{self.path}: expected list {tag:#x} at byte {at}, got {found:#x}")
        if count * 8 > self.size:
            raise CorruptError(f"{self.path}: {count} entries at byte {at} do not fit in the file")
        return [entry() for _ in range(count)]

    def _kind(self) -> int:
        kind = self._u4()
        if kind not in _TYPES:
            raise CorruptError(f"{self.path}: unknown type {kind} at byte {self.file.tell() - 4}")
        return kind

    def _attribute(self) -> tuple[str, Any]:
        name, kind, count = self._name(), self._kind(), self._number()
        length = count * np.dtype(_TYPES[kind]).itemsize
        data = self._bytes(length + -length % 4)[:length]
        if kind == 2:
            return name, data.decode(errors="replace").rstrip("\0")
        return name, np.frombuffer(data, _TYPES[kind])

    def _variable(self) -> tuple[str, list[int], dict[str, Any], int, int]:
        name = self._name()
        count = self._number()
        if count > _MOST_DIMENSIONS:
            raise CorruptError(f"{self.path}: variable {name} of {count} dimensions")
        dimensions = [self._number() for _ in range(count)]
        attributes = dict(self._list(0x0C, self._attribute))
        kind = self._kind()
        self._number()  # vsize, which the specification calls redundant
        begin = self._u4() if self.version == 1 else struct.unpack(">Q", self._bytes(8))[0]
        return name, dimensions, attributes, kind, begin


def _read_hdf5(path: str | os.PathLike[str], limit: int) -> dict[str, Variable]:
    variables: dict[str, Variable] = {}
    found = json.loads(ask_hdf5("header", path, [sorted(_ATTRIBUTES)], os.path.getsize(path)))
    for name, dims, shape, attributes in found:
        read = _hdf5_reader(path, name, shape, limit)
        variables[name] = Variable(name, tuple(dims), tuple(shape), attributes, read)
    return variables


def _hdf5_reader(
    path: str | os.PathLike[str], name: str, shape: list[int], limit: int
) -> Callable[[dict[int, int]], NDArray[Any]]:
    def read(indices: dict[int, int]) -> NDArray[Any]:
        size = os.path.getsize(path)
        expected = min(8 * math.prod(shape), max(limit, 8 * size), DEFLATE_LIMIT * size)
        answer = ask_hdf5("numbers", path, [name, indices, limit], expected)
        begin = answer.index(b"\n") + 1
        dtype, found = json.loads(answer[:begin])
        return np.frombuffer(answer, dtype, math.prod(found), begin).reshape(found)

    return read
