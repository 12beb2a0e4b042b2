"""Reads packed recordings, which anyone may have written, and trusts nothing in them."""

from __future__ import annotations

import contextlib
import math
import os
import struct
import zlib
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..base.reading import DEFLATE, DEFLATE_LIMIT, check_hdf5_storage, hdf5_errors, load_json
from ..errors import CorruptError, FormatError, TruncatedError, VersionError
from .frames import (
    CONSTANTS,
    DTYPES,
    READABLE_VERSIONS,
    Constants,
    Spec,
    arrays_per_frame,
    cells_of,
    constant_rows,
    frame_names,
)
from .vtkhdf import CHUNK_BYTES, PLACES, grid_shape, index_crc, stored_dtype, stored_shape

LARGEST_CHUNK = 1 << 26


class Packed:
    """The frames of a packed recording; the attributes are those of `Source`.

    Only what `write` makes is read: hard links, chunked or contiguous data within the file, gzip,
    shuffle and Fletcher-32 filters. Sizes are compared with the file before anything is allocated.
    """

    def __init__(self, path: str, max_bytes: int) -> None:
        self.path = path
        self._max_bytes = max_bytes
        self.problem: FormatError | None = None
        self.size = os.path.getsize(path)
        self._check_superblock()
        with hdf5_errors(path):
            self._file = h5py.File(path, "r", locking=False)
        try:
            with hdf5_errors(path):
                self._read_index()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(RuntimeError, OSError):
            self._file.close()

    def _check_superblock(self) -> None:
        """The length in superblocks 2 and 3 (HDF5 File Format Specification 3.0, II.A)."""
        with open(self.path, "rb") as file:
            head = file.read(48)
        if len(head) < 48:
            raise TruncatedError(
                f"{self.path}: the file ends at byte {len(head)}", offset=len(head)
            )
        end = struct.unpack_from("<Q", head, 28)[0]
        if head[8] in (2, 3) and head[9] == 8 and end > self.size:
            raise TruncatedError(
                f"{self.path}: the file ends at byte {self.size} of {end}", offset=self.size
            )

    def _dataset(
        self, name: str, dtype: str, columns: tuple[int, ...], rows: int | None = None
    ) -> h5py.Dataset:
        """A dataset that is safe to read, with the dtype and the shape it must have."""
        where = f"{self.path}: {name}"
        node: Any = self._file
        for step in name.split("/"):
            link = node.get(step, getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise CorruptError(f"{where}: only hard links are followed")
            node = node[step]
        if not isinstance(node, h5py.Dataset):
            raise CorruptError(f"{where}: not a dataset")
        _check_storage(node, where, self.size)
        found, wanted = node.dtype, np.dtype(dtype)
        if found != wanted:
            if found.kind == wanted.kind:
                raise VersionError(f"{where}: stored as {found.str}, expected {wanted.str}")
            raise CorruptError(f"{where}: stored as {found.str}, expected {wanted.str}")
        if node.shape[1:] != columns or rows not in (None, node.shape[0]):
            raise CorruptError(f"{where}: its shape is {node.shape}")
        return node

    def _load(
        self, name: str, dtype: str, columns: tuple[int, ...], rows: int | None = None
    ) -> NDArray[Any]:
        """A whole dataset."""
        dataset = self._dataset(name, dtype, columns, rows)
        if dataset.size * dataset.dtype.itemsize > self._max_bytes:
            raise FormatError(f"{self.path}: {name}: larger than max_bytes, {self._max_bytes}")
        return dataset[...]

    def _read_index(self) -> None:
        name = "substep/metadata"
        if not isinstance(self._file.get("substep", getlink=True), h5py.HardLink):
            raise CorruptError(f"{self.path}: an HDF5 file, but not a recording of substep")
        self._check_version()
        raw = self._load(name, "|u1", ()).tobytes()
        if len(raw) < 4 or zlib.crc32(raw[:-4]) != struct.unpack("<I", raw[-4:])[0]:
            raise CorruptError(f"{self.path}: the checksum of the metadata differs")
        self.metadata = load_json(raw[:-4], self.path)
        self.specs = [Spec(p, n, d, tuple(s)) for p, n, d, s in self.metadata["arrays"]]
        self._check_specs()
        frames, arrays = self.metadata["frames"], arrays_per_frame(self.metadata)
        prefix = self._prefix(self.metadata["parts"][0]["name"])
        times = self._load(f"{prefix}/Steps/Values", "<f8", (), frames)
        counts = self._load("substep/counts", "<i8", (arrays,), frames)
        crcs = self._load("substep/crc32", "<u4", (arrays,), frames)
        self.times: list[float] = times.tolist()
        self.counts: list[tuple[int, ...]] = [tuple(row) for row in counts.tolist()]
        self.crcs: list[tuple[int, ...]] = [tuple(row) for row in crcs.tolist()]
        if index_crc(self) != self.metadata["index_crc32"]:
            raise CorruptError(f"{self.path}: the checksum of the index differs")
        if counts.size and not 0 <= counts.min() <= counts.max() <= DEFLATE_LIMIT * self.size:
            raise CorruptError(f"{self.path}: numbers of rows that no file of this size has")
        self._offsets = (np.cumsum(counts, axis=0) - counts).tolist()
        self._rows = counts.sum(axis=0).tolist() if frames else [0] * arrays
        self._datasets: dict[int, h5py.Dataset] = {}
        self._chunks: dict[int, tuple[int, NDArray[Any]]] = {}
        self._read_constants()

    def _check_version(self) -> None:
        attributes = self._file["substep"].attrs
        found = attributes.get_id("format_version")  # a text would be read from elsewhere
        if found.dtype.kind not in "iu" or found.shape != ():
            raise CorruptError(f"{self.path}: its format version is no number")
        if (version := int(attributes["format_version"])) not in READABLE_VERSIONS:
            raise VersionError(
                f"{self.path}: format version {version}; this substep reads {READABLE_VERSIONS}"
            )

    def _check_specs(self) -> None:
        wanted = [(p["name"], n) for p in self.metadata["parts"] for n in frame_names(p)]
        empty = not self.specs and self.metadata["frames"] == 0
        if not empty and [(s.part, s.name) for s in self.specs] != wanted:
            raise CorruptError(f"{self.path}: the arrays are not those of the parts")
        for spec in self.specs:
            sizes = all(type(n) is int and 1 <= n < 1 << 16 for n in spec.shape)
            if spec.dtype not in DTYPES or len(spec.shape) > 2 or not sizes:
                raise CorruptError(f"{self.path}: {spec.part}/{spec.name}: unknown kind of array")

    def _prefix(self, part: str) -> str:
        return "VTKHDF" if len(self.metadata["parts"]) == 1 else f"VTKHDF/{part}"

    def _read_constants(self) -> None:
        self.constants: list[Constants] = []
        only_triangles = "triangles_crc32" in self.metadata  # version 1
        crcs = list(self.metadata["triangles_crc32" if only_triangles else "constants_crc32"])
        for part in self.metadata["parts"]:
            of_part: Constants = {}
            for name, rows in constant_rows(part).items():
                dtype, columns = CONSTANTS[name]
                place = f"{self._prefix(part['name'])}/{PLACES[name]}"
                if name == "points" or name.startswith("shape_"):
                    data = self._load(place, dtype, (columns,), rows)
                else:
                    data = self._load(place, dtype, (), rows * columns).reshape(rows, columns)
                if zlib.crc32(data.tobytes()) != crcs.pop(0):
                    raise CorruptError(f"{self.path}: {place}: the checksum differs")
                of_part[name] = data
            self.constants.append(of_part)

    def forget(self, frames: int) -> None:
        """Keep the first `frames` frames only."""
        for column in (self.times, self.counts, self.crcs):
            del column[frames:]  # type: ignore[attr-defined]

    def read(self, index: int, array: int) -> NDArray[Any]:
        """One array of one frame, unchecked."""
        spec = self.specs[array]
        part = next(part for part in self.metadata["parts"] if part["name"] == spec.part)
        with hdf5_errors(self.path):
            if cells := cells_of(part):
                return self._read_cells(index, array, cells)
            if array not in self._datasets:
                dimension = next(s.shape[0] for s in self.specs if s.part == spec.part)
                leaf = "Points" if spec.name == "points" else f"PointData/{spec.name}"
                self._datasets[array] = self._dataset(
                    f"{self._prefix(spec.part)}/{leaf}",
                    stored_dtype(spec),
                    stored_shape(spec, dimension),
                    self._rows[array],
                )
            start, count = self._offsets[index][array], self.counts[index][array]
            return _recorded(self._read_rows(array, start, start + count), spec)

    def _read_cells(self, index: int, array: int, cells: tuple[int, ...]) -> NDArray[Any]:
        """One array of a grid in one frame, a row for each cell."""
        spec = self.specs[array]
        frames, row = self.metadata["frames"], stored_shape(spec, len(cells))
        if array not in self._datasets:
            name = f"{self._prefix(spec.part)}/CellData/{spec.name}"
            shape = grid_shape(frames, cells, row)
            self._datasets[array] = self._dataset(name, stored_dtype(spec), shape[1:], shape[0])
        data = self._datasets[array][index if frames != 1 else ...]
        return _recorded(data.reshape(-1, *row), spec)

    def _read_rows(self, array: int, start: int, stop: int) -> NDArray[Any]:
        """Rows of a dataset. Of small frames the whole chunks are read, and kept for the next."""
        dataset = self._datasets[array]
        row_bytes = dataset.dtype.itemsize * math.prod(dataset.shape[1:])
        if dataset.chunks is None or (stop - start) * row_bytes >= CHUNK_BYTES:
            return dataset[start:stop]
        first, rows = self._chunks.get(array, (0, dataset[:0]))
        if start < first or stop > first + len(rows):
            step = dataset.chunks[0]
            first = start // step * step
            rows = dataset[first : -(-stop // step) * step]
            self._chunks[array] = (first, rows)
        return rows[start - first : stop - first].copy()


def _recorded(rows: NDArray[Any], spec: Spec) -> NDArray[Any]:
    """Rows of the file as they were recorded."""
    count = len(rows)
    flat = rows.reshape(count, math.prod(rows.shape[1:]))[:, : math.prod(spec.shape)]
    return np.ascontiguousarray(flat).view(spec.dtype).reshape(count, *spec.shape)


def _check_storage(dataset: h5py.Dataset, where: str, file_size: int) -> None:
    """Refuse data elsewhere, foreign filters, and more data than the file can hold."""
    if dataset.id.get_type().get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        raise CorruptError(f"{where}: not an array of numbers")
    filters = check_hdf5_storage(dataset, where)
    if dataset.shape is None or len(dataset.shape) < 1:
        raise CorruptError(f"{where}: not an array of rows")
    declared = dataset.dtype.itemsize * math.prod(dataset.shape)
    stored = dataset.id.get_storage_size()
    limit = stored * (DEFLATE_LIMIT if DEFLATE in filters else 1)
    if stored > file_size or declared > limit:
        raise CorruptError(f"{where}: declares {declared} bytes, the file holds {stored}")
    if dataset.chunks is not None:
        if dataset.dtype.itemsize * math.prod(dataset.chunks) > LARGEST_CHUNK:
            raise CorruptError(f"{where}: its chunks are larger than {LARGEST_CHUNK} bytes")
        wanted = math.prod(-(-n // c) for n, c in zip(dataset.shape, dataset.chunks, strict=True))
        if declared and dataset.id.get_num_chunks() != wanted:
            raise CorruptError(f"{where}: chunks are missing")
