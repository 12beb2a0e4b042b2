"""The journal: the append-only file that a running recording is written to.

A file header (metadata, and what parts have once for all frames), then one record per frame:
header, table of arrays, payload, each with its length and CRC-32, all little-endian;
docs/recording.md has the layout byte by byte.
A frame counts from the moment its last byte is written. A file that ends within a record is what a
killed writer leaves, and one that ends in zeros what a power cut does: both are read up to the last
whole frame.
"""

from __future__ import annotations

import contextlib
import copy
import errno
import math
import os
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.reading import check_regular, load_json
from ..base.replacing import check_folder
from ..errors import CorruptError, FormatError, InputError, TruncatedError, VersionError
from .files import lock, pread_exactly, publish, sync_folder, unlock, write_all
from .frames import (
    BYTE_ORDER,
    DTYPES,
    FILE_HEADER,
    FRAME_HEADER,
    FRAME_MAGIC,
    MAGIC,
    READABLE_VERSIONS,
    TABLE,
    TABLE_ROW,
    Source,
    Spec,
    arrays_per_frame,
    decode_constants,
    frame_names,
    read_checked,
)

MAX_BYTES = 1 << 33


class Journal:
    """The frames of a journal, found by walking its record headers.

    Attributes
    ----------
    metadata : dict
        As written.
    constants : list of dict of str to ndarray
        Of each part: what it has once for all frames.
    specs : list of Spec
        The arrays of a frame; empty before the first frame.
    times, counts, crcs : list
        Per frame: time, rows of each array, CRC-32 of each array.
    end : int
        Offset behind the last whole frame.
    problem : FormatError or None
        What ended the walk, unless that was the end of the file, an incomplete last record, or
        zeros.
    removable : bool
        What lies behind `end` is the tail of a broken write and nothing else.
    """

    def __init__(self, path: str, fd: int | None = None) -> None:
        self.path = path
        self.fd = os.open(path, os.O_RDONLY) if fd is None else fd
        self._owned = fd is None
        try:
            self.size = os.fstat(self.fd).st_size
            self._read_file_header()
            self.specs: list[Spec] = []
            self.times: list[float] = []
            self.counts: list[tuple[int, ...]] = []
            self.crcs: list[tuple[int, ...]] = []
            self._offsets: list[int] = []
            self._walk()
        except BaseException:
            self.close()
            raise

    def refresh(self) -> None:
        """Take the frames that were written since into the index, in one step.

        An interrupt leaves the index as it was, and a thread that reads sees it whole.
        """
        size = os.fstat(self.fd).st_size
        if size != self.size or self.problem is not None:
            later = copy.copy(self)
            later.size = size
            later.forget(len(self.times))  # gives it lists of its own
            later._walk()
            found = vars(later)
            del found["fd"]  # that may have been closed
            vars(self).update(found)

    def close(self) -> None:
        """Close the file."""
        if self._owned and self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def _read_file_header(self) -> None:
        head = os.pread(self.fd, FILE_HEADER.size, 0)
        if head[: len(MAGIC)] != MAGIC[: len(head)]:
            raise CorruptError(f"{self.path}: neither a substep journal nor HDF5", offset=0)
        if len(head) < FILE_HEADER.size:
            raise TruncatedError(
                f"{self.path}: the file ends at byte {len(head)}, within its header",
                offset=len(head),
            )
        _, order, version, text_bytes, blob_bytes, crc, head_crc = FILE_HEADER.unpack(head)
        if order == int.from_bytes(BYTE_ORDER.to_bytes(4, "little"), "big"):
            raise VersionError(f"{self.path}: written in the other byte order", offset=8)
        if zlib.crc32(head[:-4]) != head_crc or order != BYTE_ORDER:
            raise CorruptError(f"{self.path}: the header's checksum differs", offset=0)
        if version not in READABLE_VERSIONS:
            raise VersionError(
                f"{self.path}: format version {version}; this substep reads {READABLE_VERSIONS}",
                offset=12,
            )
        self.end = FILE_HEADER.size + text_bytes + blob_bytes
        if self.end > self.size:
            raise TruncatedError(
                f"{self.path}: the file ends at byte {self.size}, its header at {self.end}",
                offset=self.size,
            )
        body = bytearray(text_bytes + blob_bytes)
        pread_exactly(self.fd, memoryview(body), FILE_HEADER.size, self.path)
        if zlib.crc32(body) != crc:
            raise CorruptError(
                f"{self.path}: the checksum of the metadata differs", offset=FILE_HEADER.size
            )
        self.metadata = load_json(bytes(body[:text_bytes]), self.path)
        try:
            self.arrays_per_frame = arrays_per_frame(self.metadata)
            self._names = [(p["name"], n) for p in self.metadata["parts"] for n in frame_names(p)]
            self.constants = decode_constants(self.metadata, body[text_bytes:])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CorruptError(f"{self.path}: metadata is incomplete ({error})") from None

    def _walk(self) -> None:
        """Take the frames behind `end` into the index."""
        self.problem: FormatError | None = None
        self.removable = True
        head_bytes = FRAME_HEADER.size + TABLE.itemsize * self.arrays_per_frame
        while self.problem is None:
            head = os.pread(self.fd, head_bytes, self.end)
            if len(head) < FRAME_HEADER.size:
                break
            magic, arrays, index, time, payload, table_crc, head_crc = FRAME_HEADER.unpack_from(
                head
            )
            if zlib.crc32(head[: FRAME_HEADER.size - 4]) != head_crc or magic != FRAME_MAGIC:
                if self._zeros_from(self.end):
                    break
                self._stop("the header's checksum differs", removable=False)
            elif arrays != self.arrays_per_frame or index != len(self.times):
                self._stop("the header belongs to another frame", removable=False)
            elif len(head) < head_bytes or self.end + head_bytes + payload > self.size:
                break
            else:
                last = self.end + head_bytes + payload == self.size
                rows = head[FRAME_HEADER.size :]
                if zlib.crc32(rows) != table_crc:
                    self._stop("the table's checksum differs", removable=last)
                elif reason := self._add(time, payload, rows):
                    self._stop(reason, removable=False)
                else:
                    self._offsets.append(self.end + head_bytes)
                    self.end += head_bytes + payload
        self._check_last()
        if not self.times:
            self.specs = []  # those of a frame that is none

    def _add(self, time: float, payload: int, table: bytes) -> str | None:
        """Take a frame into the index, or say what is wrong with it."""
        if not math.isfinite(time) or (self.times and time <= self.times[-1]):
            return "its time is not after the frame before"
        rows = list(TABLE_ROW.iter_unpack(table))
        kinds = [row[1:4] for row in rows]
        if not self.times:
            self._kinds = kinds
            self.specs = self._specs_of(kinds)
        if kinds != self._kinds:
            return "dtypes or shapes differ from those of the first frame"
        if any(spec.dtype not in DTYPES for spec in self.specs):
            return "a dtype is unknown"
        counts = tuple(row[0] for row in rows)
        if payload != sum(n * s.row_bytes for n, s in zip(counts, self.specs, strict=True)):
            return "the length of the payload differs from that of its arrays"
        self.times.append(time)
        self.counts.append(counts)
        self.crcs.append(tuple(row[4] for row in rows))
        return None

    def _specs_of(self, kinds: list[tuple[bytes, int, int]]) -> list[Spec]:
        return [
            Spec(*name, code.rstrip(b"\0").decode("ascii", "replace"), tuple(n for n in shape if n))
            for name, (code, *shape) in zip(self._names, kinds, strict=True)
        ]

    def _stop(self, reason: str, *, removable: bool) -> None:
        where = f"{self.path}: frame {len(self.times)} at byte {self.end}"
        self.problem = CorruptError(f"{where}: {reason}", offset=self.end)
        self.removable = removable

    def _zeros_from(self, offset: int) -> bool:
        """Whether only zeros follow: what a power cut leaves of data that was not yet on disk."""
        while block := os.pread(self.fd, 1 << 20, offset):
            if block.count(0) != len(block):
                return False
            offset += len(block)
        return True

    def _check_last(self) -> None:
        """Only the last frame can be half written: check its payload now, others when read."""
        last = len(self.times) - 1
        try:
            for k in range(len(self.specs) if self.times else 0):
                read_checked(self, last, k)
        except CorruptError:
            head_bytes = FRAME_HEADER.size + TABLE.itemsize * self.arrays_per_frame
            removable = self.removable
            self.end = self._offsets[-1] - head_bytes
            self.forget(last)
            self._stop("the payload's checksum differs", removable=removable)

    def forget(self, frames: int) -> None:
        """Keep the first `frames` frames only, in one step."""
        vars(self).update(
            times=self.times[:frames],
            counts=self.counts[:frames],
            crcs=self.crcs[:frames],
            _offsets=self._offsets[:frames],
        )

    def read(self, index: int, array: int) -> NDArray[Any]:
        """One array of one frame, unchecked."""
        counts = self.counts[index]
        skip = sum(n * s.row_bytes for n, s in zip(counts[:array], self.specs, strict=False))
        spec = self.specs[array]
        result = np.empty((counts[array], *spec.shape), spec.dtype)
        if result.size:
            where = f"{self.path}: frame {index}"
            pread_exactly(self.fd, result.data.cast("B"), self._offsets[index] + skip, where)
        return result


class Writer:
    """Appends to a journal; every failure leaves the frames before it as they were."""

    def __init__(self, fd: int, path: str, end: int, fsync: bool) -> None:
        self.path = path
        self._fd = fd
        self.end = end  # of the frames that it was opened with
        self._fsync = fsync
        self._process = os.getpid()

    @classmethod
    def create(cls, path: str, header: bytes, fsync: bool = False) -> Writer:
        """Make a journal, whole from the moment it exists; FileExistsError if there is one."""
        check_folder(path)
        part = path + ".part"
        with contextlib.suppress(FileNotFoundError):
            os.unlink(part)
        fd = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            lock(fd)
            write_all(fd, header, 0)
            if fsync:
                os.fsync(fd)
            publish(part, path)
        except BaseException:
            os.close(fd)
            with contextlib.suppress(OSError):
                os.unlink(part)
            raise
        if fsync:
            sync_folder(path)
        return cls(fd, path, len(header), fsync)

    @classmethod
    def resume(cls, path: str, fsync: bool = False) -> tuple[Writer, Journal]:
        """Open a journal to go on with it; what a broken write left at its end is cut off."""
        fd = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
        try:
            if not lock(fd):
                raise BlockingIOError(
                    errno.EWOULDBLOCK, "another process records into it or packs it", path
                )
            if os.fstat(fd).st_nlink == 0:
                raise FileNotFoundError(errno.ENOENT, "packed and removed just now", path)
            journal = Journal(path, fd)
            if journal.problem is not None and not journal.removable:
                raise journal.problem
            os.ftruncate(fd, journal.end)
        except BaseException:
            os.close(fd)
            raise
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path + ".part")
        return cls(fd, path, journal.end, fsync), journal

    def append(self, record: bytes | memoryview, end: int) -> int:
        """Write one record behind the end of the frames, and tell where it ends.

        When this returns, it outlives this process; what else is behind that end is cut off.
        """
        if os.getpid() != self._process:
            raise InputError("the recorder belongs to the process that this one was forked from")
        status = os.fstat(self._fd)
        if status.st_nlink == 0:
            raise FileNotFoundError(
                errno.ENOENT, "the journal was removed while recording", self.path
            )
        if status.st_size != end:
            os.ftruncate(self._fd, end)
        try:
            write_all(self._fd, record, end)
            if self._fsync:
                os.fsync(self._fd)
        except BaseException:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, end)
            raise
        return end + len(record)

    def close(self, end: int) -> None:
        """Close the file, which ends there; again is harmless."""
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            if os.getpid() == self._process:
                with contextlib.suppress(OSError):
                    if os.fstat(fd).st_size > end:
                        os.ftruncate(fd, end)
                unlock(fd)  # a forked process may hold a copy of fd
            os.close(fd)


def open_source(path: str, max_bytes: int = MAX_BYTES) -> Source:
    """Open a journal or a packed file, whichever it is."""
    check_regular(path)
    with open(path, "rb") as file:
        start = file.read(8)
    if start != b"\x89HDF\r\n\x1a\n":
        return Journal(path)
    from .packed import Packed

    return Packed(path, max_bytes)
