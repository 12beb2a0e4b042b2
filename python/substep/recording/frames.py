"""How frames lie in a journal: headers, tables, checksums; and what both kinds of file offer.

docs/recording.md has the layout byte by byte.
"""

from __future__ import annotations

import functools
import json
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.box import check_box
from ..base.reading import check_booleans
from ..errors import CorruptError, FormatError

FORMAT_VERSION = 4
# Version 1 had meshes of triangles and nothing else, 2 no grids, 3 no shapes of bodies.
READABLE_VERSIONS = (1, 2, 3, 4)
MAGIC = b"SUBSTEPJ"
BYTE_ORDER = 0x01020304
FILE_HEADER = struct.Struct("<8sIIQQII")
FRAME_MAGIC = b"FRAM"
FRAME_HEADER = struct.Struct("<4sIQdQII")
TABLE = np.dtype([("count", "<u8"), ("dtype", "S4"), ("shape", "<u2", (2,)), ("crc32", "<u4")])
TABLE_ROW = struct.Struct("<Q4sHHI")
# What a part has once for all frames, in the order of the file: dtype and columns.
CONSTANTS = {
    "triangles": ("<i8", 3),
    "edges": ("<i8", 2),
    "tetrahedra": ("<i8", 4),
    "points": ("<f8", 3),
    "shape_vertices": ("<f8", 3),
    "shape_faces": ("<i8", 3),
    "shape_bodies": ("<i8", 1),
}
DTYPES = ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8")


Constants = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Spec:
    """One array of every frame: whose it is, its name, and what one row of it looks like."""

    part: str
    name: str
    dtype: str
    shape: tuple[int, ...]

    @functools.cached_property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return math.prod(self.shape) * int(np.dtype(self.dtype).itemsize)


class Source(Protocol):
    """What a journal and a packed recording have in common."""

    path: str
    metadata: dict[str, Any]
    constants: list[Constants]
    specs: list[Spec]
    times: list[float]
    counts: list[tuple[int, ...]]
    crcs: list[tuple[int, ...]]
    problem: FormatError | None

    def read(self, index: int, array: int) -> NDArray[Any]:
        """One array of one frame, unchecked."""

    def forget(self, frames: int) -> None:
        """Keep the first `frames` frames only."""

    def close(self) -> None:
        """Close the file."""


def read_checked(source: Source, index: int, array: int) -> NDArray[Any]:
    """One array of one frame, or CorruptError if its checksum differs."""
    data = source.read(index, array)
    crc = array_crc(index, source.times[index], data.data.cast("B") if data.size else b"")
    if crc != source.crcs[index][array]:
        raise CorruptError(f"{_place(source, index, array)}: the checksum differs")
    if data.dtype == bool:
        check_booleans(data, _place(source, index, array))
    return data


def _place(source: Source, index: int, array: int) -> str:
    spec = source.specs[array]
    return f"{source.path}: frame {index}, {spec.part}/{spec.name}"


def array_crc(index: int, time: float, data: Any) -> int:
    """CRC-32 of an array's bytes, seeded with its frame, so that a misplaced array is noticed."""
    return zlib.crc32(data, zlib.crc32(struct.pack("<Qd", index, time)))


def dump_json(value: Any) -> bytes:
    """Compact JSON without NaN or infinity."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).encode()


def encode_file_header(metadata: dict[str, Any], constants: Sequence[Constants]) -> bytes:
    """File header, metadata, and what every part has once for all frames."""
    text = dump_json(metadata)
    blob = b"".join(array.tobytes() for of_part in constants for array in of_part.values())
    crc = zlib.crc32(blob, zlib.crc32(text))
    head = FILE_HEADER.pack(MAGIC, BYTE_ORDER, FORMAT_VERSION, len(text), len(blob), crc, 0)[:-4]
    return head + struct.pack("<I", zlib.crc32(head)) + text + blob


def decode_constants(metadata: dict[str, Any], blob: bytes | bytearray) -> list[Constants]:
    """What `encode_file_header` appended to the metadata; ValueError if it is not that."""
    result: list[Constants] = []
    offset = 0
    for part in metadata["parts"]:
        of_part: Constants = {}
        for name, rows in constant_rows(part).items():
            dtype, columns = CONSTANTS[name]
            size = 8 * rows * columns
            if offset + size > len(blob):
                raise ValueError(f"{name} are missing")
            array = np.frombuffer(blob[offset : offset + size], dtype)
            of_part[name] = array.reshape(rows, columns)
            offset += size
        result.append(of_part)
    if offset != len(blob):
        raise ValueError(f"{len(blob) - offset} bytes too many")
    return result


def constant_rows(part: dict[str, Any]) -> dict[str, int]:
    """Rows of each constant array that a part has, in the order of the file."""
    rows = {name: part[name] for name in CONSTANTS if part.get(name) is not None}
    if any(type(n) is not int or n < 0 for n in rows.values()):
        raise ValueError(f"not numbers of rows: {rows}")
    return rows


class Encoder:
    """Puts frames into the form of the file.

    The arrays are copied first, so that bytes and checksums agree whatever another thread does. The
    buffer is kept: fresh memory for every frame would cost more than the checksums do.
    """

    def __init__(self) -> None:
        self._buffer = np.empty(0, np.uint8)

    def encode(
        self, index: int, time: float, specs: Sequence[Spec], arrays: Sequence[NDArray[Any]]
    ) -> memoryview:
        """One whole record, valid until the next."""
        start = FRAME_HEADER.size + TABLE.itemsize * len(arrays)
        payload = sum(array.nbytes for array in arrays)
        if len(self._buffer) < start + payload:
            self._buffer = np.empty(start + payload, np.uint8)
        record = self._buffer[: start + payload]
        table = np.zeros(len(arrays), TABLE)
        end = start
        for row, spec, array in zip(table, specs, arrays, strict=True):
            copy = record[end : end + array.nbytes]
            copy.view(array.dtype).reshape(array.shape)[...] = array
            end += array.nbytes
            row["count"] = len(array)
            row["dtype"] = spec.dtype.encode()
            row["shape"][: len(spec.shape)] = spec.shape
            row["crc32"] = array_crc(index, time, copy)
        rows = table.tobytes()
        head = FRAME_HEADER.pack(
            FRAME_MAGIC, len(arrays), index, time, payload, zlib.crc32(rows), 0
        )[:-4]
        first = head + struct.pack("<I", zlib.crc32(head)) + rows
        record[:start] = np.frombuffer(first, np.uint8)
        return record.data


def frame_names(part: dict[str, Any]) -> Iterator[str]:
    """Names of a part's arrays in a frame: points unless they are constant, then its fields."""
    if part.get("points") is None and part["kind"] != "grid":
        yield "points"
    for name, _ in part["fields"]:
        yield name


def cells_of(part: dict[str, Any]) -> tuple[int, ...] | None:
    """Cells of a grid along its axes; None for other parts."""
    return check_box(part["bounds"], part["cell"])[1] if part["kind"] == "grid" else None


def arrays_per_frame(metadata: dict[str, Any]) -> int:
    """Number of arrays in every frame."""
    return sum(len(list(frame_names(part))) for part in metadata["parts"])
