"""Checkpoint files: named arrays and numbers, bit for bit, with a checksum over everything.

Layout, little-endian: magic (8 bytes), version (u32), CRC-32 of all that follows (u32), length of
the header (u64), length of the data (u64), header (JSON: kind, values, arrays with dtype and
shape), data (the arrays, one after the other). Nothing in it is ever executed.
"""

from __future__ import annotations

import json
import math
import os
import struct
import zlib
from collections.abc import Callable
from typing import IO, Any

import numpy as np

from ..errors import CorruptError, FormatError, InputError, TruncatedError, VersionError
from .checks import check_path
from .reading import check_booleans, check_regular, load_json
from .replacing import check_file_name, replace_file

_MAGIC = b"SUBSTEPC"
_VERSION = 1
_HEAD = struct.Struct("<8sIIQQ")
_DTYPES = ("<f8", "<f4", "<i8", "<i4", "|i1", "|u1", "|b1")


def write_checkpoint(path: str | os.PathLike[str], kind: str, state: dict[str, Any]) -> None:
    """Write `state` (arrays, finite floats, integers, strings) atomically."""
    path = check_file_name(path)
    values: dict[str, Any] = {}
    arrays: list[tuple[str, np.ndarray[Any, Any]]] = []
    for name, value in state.items():
        if isinstance(value, np.ndarray):
            little = value.dtype.newbyteorder("<")
            arrays.append((name, np.ascontiguousarray(value, dtype=little)))
        else:
            values[name] = value.hex() if isinstance(value, float) else value
    floats = [name for name, value in state.items() if isinstance(value, float)]
    described = [(name, array.dtype.str, array.shape) for name, array in arrays]
    header = json.dumps(
        {"kind": kind, "values": values, "floats": floats, "arrays": described}
    ).encode()
    data = b"".join(array.tobytes() for _, array in arrays)
    lengths = struct.pack("<QQ", len(header), len(data))
    crc = zlib.crc32(data, zlib.crc32(header, zlib.crc32(lengths)))

    def write(file: IO[bytes]) -> None:
        file.write(struct.pack("<8sII", _MAGIC, _VERSION, crc) + lengths + header + data)

    replace_file(path, write, mode=0o600)


def read_checkpoint(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Read what `write_checkpoint` wrote, or raise one of the FormatError family."""
    path = check_path(path)
    check_regular(path)
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(_HEAD.size)
        if head[:8] != _MAGIC[: len(head[:8])]:
            raise FormatError(f"{path}: not a checkpoint of substep")
        if len(head) < _HEAD.size:
            raise TruncatedError(f"{path}: ends at byte {len(head)}, within its head")
        _, version, crc, header_length, data_length = _HEAD.unpack(head)
        if version != _VERSION:
            raise VersionError(
                f"{path}: written in version {version}; this substep reads {_VERSION}"
            )
        expected = _HEAD.size + header_length + data_length
        if size < expected:
            raise TruncatedError(f"{path}: ends at byte {size} of {expected}")
        if size > expected:
            raise CorruptError(f"{path}: {size - expected} bytes too many from byte {expected}")
        body = file.read()
    if zlib.crc32(body, zlib.crc32(head[16:])) != crc:
        raise CorruptError(f"{path}: the checksum at byte 12 does not agree with the content")
    try:
        header = load_json(body[:header_length], str(path))
        if header["kind"] != kind:
            raise FormatError(f"{path}: holds the state of {header['kind']}, not of {kind}")
        state: dict[str, Any] = dict(header["values"])
        for name in header["floats"]:
            state[name] = float.fromhex(state[name])
        offset = header_length
        for name, dtype, shape in header["arrays"]:
            if dtype not in _DTYPES or min(shape, default=0) < 0:
                raise CorruptError(f"{path}: array {name} of dtype {dtype} and shape {shape}")
            count = math.prod(shape)
            array = np.frombuffer(body, dtype, count, offset).reshape(shape)
            check_booleans(array, f"{path}: array {name}")
            state[name] = array.astype(array.dtype.newbyteorder("="))
            offset += array.nbytes
        if offset != len(body):
            raise CorruptError(f"{path}: {len(body) - offset} bytes belong to no array")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, FormatError):
            raise
        raise CorruptError(f"{path}: the header at byte {_HEAD.size} is not as written") from error
    return state


def restore_checkpoint(
    path: str | os.PathLike[str], kind: str, restore: Callable[[dict[str, Any]], None]
) -> None:
    """Pass the contents of a file to `restore`; if that refuses them, the file is corrupt."""
    state = read_checkpoint(path, kind)
    try:
        restore(state)
    except (InputError, TypeError) as error:
        raise CorruptError(
            f"{os.fspath(path)}: does not fit what this object is made of: {error}"
        ) from error
