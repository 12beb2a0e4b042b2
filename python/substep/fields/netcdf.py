"""Reads NetCDF: the classic formats (CDF-1, CDF-2, CDF-5) itself, NetCDF-4 through h5py.

Format: "NetCDF Classic Format Specification" (Unidata, docs.unidata.ucar.edu/nug, file format
specifications). Only headers are read at first; sizes are compared with the file's before
anything is allocated.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CorruptError, FormatError, TruncatedError

_TYPES = {
    1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8",
    7: "u1", 8: ">u2", 9: ">u4", 10: ">i8", 11: ">u8",
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


def read_header(path: str | os.PathLike[str]) -> dict[str, Variable]:
    """List the variables of a NetCDF file by name."""
    with open(path, "rb") as file:
        magic = file.read(8)
    if magic[:3] == b"CDF" and len(magic) >= 4:
        if magic[3] not in (1, 2, 5):
            raise FormatError(f"{path}: NetCDF classic of unknown version {magic[3]}")
        return _Classic(path, magic[3]).variables
    if magic == b"\x89HDF\r\n\x1a\n":
        return _read_hdf5(path)
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
        unlimited = [i for i, (_, length) in enumerate(dimensions) if length == 0]
        bad = [i for entry in raw for i in entry[1] if i >= len(names)]
        if bad:
            raise CorruptError(f"{path}: a variable has dimension number {bad[0]} of {len(names)}")
        recorded = [entry for entry in raw if entry[1] and entry[1][0] in unlimited]

        def row_bytes(entry: Any) -> int:  # of one record, not padded
            lengths = [dimensions[i][1] for i in entry[1][1:]]
            return math.prod(lengths) * np.dtype(_TYPES[entry[3]]).itemsize

        record_bytes = sum(row_bytes(e) + -row_bytes(e) % 4 for e in recorded)
        if len(recorded) == 1:  # a single record variable is not padded
            record_bytes = row_bytes(recorded[0])
        streaming = 0xFFFFFFFF if version != 5 else 0xFFFFFFFFFFFFFFFF
        if records == streaming and recorded:
            start = min(entry[4] for entry in recorded)
            records = max(0, (self.size - start) // max(record_bytes, 1))

        self.variables: dict[str, Variable] = {}
        for entry in raw:
            name, numbers, attributes, kind, begin = entry
            dtype = np.dtype(_TYPES[kind])
            lengths = [records if i in unlimited else dimensions[i][1] for i in numbers]
            stride = math.prod(lengths[1:]) * dtype.itemsize
            if entry in recorded:
                stride = record_bytes
            rows = lengths[0] if lengths else 1
            row = math.prod(lengths[1:]) * dtype.itemsize
            end = begin + (max(rows - 1, 0) * stride + row if rows else 0)
            if end > self.size:
                raise TruncatedError(
                    f"{path}: ends at byte {self.size}, but variable {name} reaches to byte {end}"
                )
            read = self._reader(tuple(lengths), dtype, begin, stride)
            dims = tuple(names[i] for i in numbers)
            self.variables[name] = Variable(name, dims, tuple(lengths), attributes, read)

    def _reader(
        self, shape: tuple[int, ...], dtype: np.dtype[Any], begin: int, stride: int
    ) -> Callable[[dict[int, int]], NDArray[Any]]:
        path = self.path

        def read(indices: dict[int, int]) -> NDArray[Any]:
            first = indices.get(0)
            wanted = range(shape[0] if shape else 1) if first is None else [first]
            row_shape = shape[1:]
            count = math.prod(row_shape)
            rows = np.empty((len(wanted), *row_shape), dtype)
            with open(path, "rb") as file:
                for i, row in enumerate(wanted):
                    file.seek(begin + row * stride)
                    data = file.read(count * dtype.itemsize)
                    if len(data) < count * dtype.itemsize:
                        raise TruncatedError(f"{path}: ends within row {row} of a variable")
                    rows[i] = np.frombuffer(data, dtype).reshape(row_shape)
            values = rows[0] if first is not None or not shape else rows
            dropped = 0 if first is None else 1
            key = tuple(indices.get(d, slice(None)) for d in range(dropped, len(shape)))
            return values[key] if key else values

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
        if count * 4 > self.size:
            raise CorruptError(f"{self.path}: variable {name} of {count} dimensions")
        dimensions = [self._number() for _ in range(count)]
        attributes = dict(self._list(0x0C, self._attribute))
        kind = self._kind()
        self._number()  # vsize, which the specification calls redundant
        begin = self._u4() if self.version == 1 else struct.unpack(">Q", self._bytes(8))[0]
        return name, dimensions, attributes, kind, begin


def _read_hdf5(path: str | os.PathLike[str]) -> dict[str, Variable]:
    import h5py

    variables: dict[str, Variable] = {}
    try:
        with h5py.File(path, "r") as file:
            for name in file:
                if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                    raise FormatError(f"{path}: {name} is a link out of the file; refused")
                dataset = file[name]
                if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
                    continue
                if dataset.external or dataset.is_virtual:
                    raise FormatError(f"{path}: {name} is stored in other files; refused")
                filters = dataset.id.get_create_plist()
                for i in range(filters.get_nfilters()):
                    if filters.get_filter(i)[0] > 3:  # deflate, shuffle, fletcher32
                        raise FormatError(f"{path}: {name} needs a filter plugin; refused")
                attributes = {key: _attribute_value(dataset, key) for key in dataset.attrs}
                dims = tuple(_dimension_name(dataset, i) for i in range(dataset.ndim))
                read = _hdf5_reader(path, name)
                variables[name] = Variable(name, dims, dataset.shape, attributes, read)
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        if isinstance(error, FormatError) or (isinstance(error, OSError) and error.errno):
            raise
        kind = TruncatedError if "truncated" in str(error) else CorruptError
        raise kind(f"{path}: HDF5 cannot read it: {error}") from error
    return variables


def _attribute_value(dataset: Any, key: str) -> Any:
    if key in ("DIMENSION_LIST", "REFERENCE_LIST"):
        return None
    value = dataset.attrs[key]
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def _dimension_name(dataset: Any, number: int) -> str:
    if dataset.is_scale:
        return str(dataset.name).lstrip("/")
    scales = dataset.dims[number]
    return str(scales[0].name).lstrip("/") if len(scales) else f"dimension {number}"


def _hdf5_reader(path: Any, name: str) -> Callable[[dict[int, int]], NDArray[Any]]:
    def read(indices: dict[int, int]) -> NDArray[Any]:
        import h5py

        try:
            with h5py.File(path, "r") as file:
                dataset = file[name]
                key = tuple(indices.get(d, slice(None)) for d in range(dataset.ndim))
                return np.asarray(dataset[key])
        except (OSError, RuntimeError) as error:
            raise CorruptError(f"{path}: variable {name} cannot be read: {error}") from error

    return read
