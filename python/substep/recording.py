"""Recordings: written frame by frame into a journal, packed into VTKHDF, read back as arrays."""

from __future__ import annotations

import contextlib
import errno
import operator
import os
import threading
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._checks import check_integer, check_real, describe
from ._frames import Encoder, Source, Spec, encode_file_header, read_checked
from ._journal import Journal, Writer
from ._parts import (
    Part,
    check_keys,
    check_parameters,
    check_part,
    check_parts,
    check_text,
    check_values,
    metadata_of,
)
from .errors import CorruptError, FormatError, InputError, TruncatedError, VersionError

JOURNAL_SUFFIX = ".journal"
MAX_BYTES = 1 << 33

Frame = dict[str, dict[str, NDArray[Any]]]


def check_path(path: Any) -> str:
    """A file name as a string."""
    text = os.fsdecode(os.fspath(path))
    if "\0" in text or not text:
        raise InputError(f"path: expected a file name, got {describe(text)}")
    return text


class Recorder:
    """Records a run: every appended frame is safe from then on, whatever becomes of the process.

    Frames go to the journal `PATH.journal`; `close` packs it into PATH by a separate process. As a
    context manager, it closes at the end; after an exception the journal stays, and can be read,
    resumed and packed.

    Parameters
    ----------
    path : path-like
        Of the packed recording, by custom `*.vtkhdf`.
    parts : mapping of str to Part
        What every frame holds.
    scene : str
        Name of the scene.
    parameters : mapping, optional
        Of the scene; anything that JSON can hold.
    seed : int
        Of the random numbers.
    overwrite : bool
        Remove a recording that is there.
    resume : bool
        Go on with the recording that is there, if there is one: the metadata must be the same.
        What a broken write left at the end of its journal is cut off first.
    fsync : bool
        Wait for the disk after every frame, so that frames also outlive a power cut.

    Raises
    ------
    InputError
        If an argument is wrong, or the recording to resume has other metadata.
    FileExistsError
        If a recording is there, without `overwrite` or `resume`.
    FormatError
        If the recording to resume is damaged.
    OSError
        If the file cannot be written; BlockingIOError if another process records into it or packs
        it.

    Examples
    --------
    >>> import os, tempfile
    >>> import substep
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = os.path.join(folder.name, "fall.vtkhdf")
    >>> parts = {"ball": substep.Part("particles", fields={"velocity": "m/s"})}
    >>> with substep.Recorder(path, parts=parts, scene="fall") as recorder:
    ...     for k in range(3):
    ...         t, x, v = 0.1 * k, [[0.0, -0.05 * k**2]], [[0.0, -float(k)]]
    ...         recorder.append(t, {"ball": {"points": x, "velocity": v}})
    >>> with substep.Recording(path) as recording:
    ...     print(len(recording), recording["ball"].points(2))
    3 [[ 0.  -0.2]]
    >>> folder.cleanup()
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        parts: Mapping[str, Part],
        scene: str = "",
        parameters: Mapping[str, Any] | None = None,
        seed: int = 0,
        overwrite: bool = False,
        resume: bool = False,
        fsync: bool = False,
    ) -> None:
        self._parts = check_parts(parts)
        metadata = metadata_of(
            self._parts,
            check_text("scene", scene, 1000),
            check_parameters(parameters),
            check_integer("seed", seed, minimum=0, maximum=2**64 - 1),
        )
        if overwrite and resume:
            raise InputError("overwrite, resume: give one of them")
        self.path = check_path(path)
        self.journal_path = self.path + JOURNAL_SUFFIX
        self._specs: list[Spec] = []
        self._times: list[float] = []
        self._encoder = Encoder()
        self._lock = threading.Lock()
        self._writer: Writer | None = None
        header = encode_file_header(metadata, self._triangles())
        if resume and not self._resume(metadata, fsync) and os.path.lexists(self.path):
            _unpack(self.path, self.journal_path)
            self._resume(metadata, fsync)
        if self._writer is None:
            self._make_room(overwrite)
            self._writer = Writer.create(self.journal_path, header, fsync)

    def _triangles(self) -> list[NDArray[Any]]:
        return [np.asarray(p.triangles) for p in self._parts.values() if p.triangles is not None]

    def _make_room(self, overwrite: bool) -> None:
        for path in (self.journal_path, self.path):
            if os.path.lexists(path):
                if not overwrite:
                    why = "exists: choose overwrite=True or resume=True"
                    raise FileExistsError(errno.EEXIST, why, path)
                os.unlink(path)

    def _resume(self, metadata: dict[str, Any], fsync: bool) -> bool:
        """Go on with the journal; False if there is none."""
        try:
            writer, journal = Writer.resume(self.journal_path, fsync)
        except FileNotFoundError:
            return False
        try:
            for key, value in metadata.items():
                there = journal.metadata.get(key)
                if key != "substep" and there != value:
                    has = f"the recording to resume has {describe(there)}"
                    raise InputError(f"{key}: {has}, got {describe(value)}")
            for mine, theirs in zip(self._triangles(), journal.triangles, strict=True):
                if not np.array_equal(mine, theirs):
                    raise InputError("triangles: the recording to resume has others")
        except BaseException:
            writer.close()
            raise
        self._writer, self._specs, self._times = writer, journal.specs, journal.times
        return True

    def __len__(self) -> int:
        """Frames recorded so far, those of a resumed recording included."""
        return len(self._times)

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames recorded so far, shape (frames,) [s]."""
        return np.array(self._times, np.float64)

    def append(self, time: float, frame: Mapping[str, Mapping[str, ArrayLike]]) -> None:
        """Record one frame; when this returns, it is in the journal.

        Parameters
        ----------
        time : float
            Later than that of the frame before [s].
        frame : mapping
            For every part its `points`, shape (n, 2) or (n, 3) [m], and its fields, one row per
            point. n may change from frame to frame; dtypes and row shapes stay those of the first.

        Raises
        ------
        InputError
            If the time or an array is not valid, or the recorder is closed; nothing was written.
        OSError
            If the journal cannot be written (disk full, folder removed ...); the frames before
            are as they were, and the next `append` tries again.
        """
        if not self._lock.acquire(blocking=False):
            raise InputError("the recorder is in use by another thread")
        try:
            if self._writer is None:
                raise InputError("the recorder is closed")
            now = check_real("time", time)
            if self._times and now <= self._times[-1]:
                raise InputError(f"time: expected one after {self._times[-1]}, got {now}")
            specs, arrays = self._check_frame(frame)
            self._writer.append(self._encoder.encode(len(self._times), now, specs, arrays))
            self._specs = specs
            self._times.append(now)
        finally:
            self._lock.release()

    def _check_frame(self, frame: Any) -> tuple[list[Spec], list[NDArray[Any]]]:
        check_keys("frame", frame, self._parts)
        specs: list[Spec] = []
        arrays: list[NDArray[Any]] = []
        for part_name, part in self._parts.items():
            values = frame[part_name]
            names = ["points", *part.fields]
            check_keys(f"frame[{part_name!r}]", values, names)
            for name in names:
                known = self._specs[len(specs)] if self._specs else None
                array = check_values(f"{part_name}/{name}", values[name], name == "points", known)
                specs.append(Spec(part_name, name, array.dtype.str, array.shape[1:]))
                arrays.append(array)
            check_part(part_name, part, arrays[-len(names) :], names)
        return specs, arrays

    def close(self) -> None:
        """Finish: pack the journal into the recording, verify that, and remove the journal.

        A second call does nothing.

        Raises
        ------
        OSError
            If the packed file cannot be written; the journal stays, and `substep.pack` can try
            again, also to another place.
        """
        from .export import pack

        with self._lock:
            recording = self._writer is not None
            self._release()
        if recording:
            pack(self.journal_path)

    def _release(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self._release()

    def __del__(self) -> None:
        if getattr(self, "_writer", None) is not None:
            self._release()


def _unpack(path: str, journal_path: str) -> None:
    """Turn a packed recording back into a journal, to go on with it."""
    with Recording(path) as recording:
        source = recording.source
        header = encode_file_header(source.metadata, source.triangles)
        part = journal_path + ".unpack"
        if os.path.lexists(part):
            os.unlink(part)
        writer, encoder = Writer.create(part, header), Encoder()
        try:
            for i, time in enumerate(source.times):
                arrays = [read_checked(source, i, k) for k in range(len(source.specs))]
                writer.append(encoder.encode(i, time, source.specs, arrays))
        finally:
            writer.close()
        os.rename(part, journal_path)


def _open_source(path: str, max_bytes: int) -> Source:
    with open(path, "rb") as file:
        start = file.read(8)
    if start != b"\x89HDF\r\n\x1a\n":
        return Journal(path)
    from ._vtkhdf import Packed

    return Packed(path, max_bytes)


class Recording:
    """A recording as arrays, whether packed or still a journal.

    While a journal lies beside the packed file, the journal is read: it is never older. Iterating
    gives (time, frame) pairs.

    Parameters
    ----------
    path : path-like
        The recording, or its journal.
    recover : bool
        Check every frame now, and keep those before the first damaged one.
    max_bytes : int
        The largest frame that may be read, and the largest index.

    Attributes
    ----------
    times : ndarray of float64, shape (frames,)
        [s]
    parts : dict of str to Part
        Kind, fields with their units, and triangles of every part.
    scene : str
        Name of the scene.
    parameters : dict
        Of the scene.
    seed : int
        Of the random numbers.
    version : str
        Of the substep that wrote it.
    packed : bool
        Whether it is VTKHDF; else a journal.

    Raises
    ------
    CorruptError, TruncatedError, VersionError
        If the file is damaged or of another version; `offset` says where, if that is known. A
        journal that ends within a frame is not damaged: it has the frames before.
    OSError
        If it cannot be opened.

    Examples
    --------
    >>> import os, tempfile
    >>> import substep
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = os.path.join(folder.name, "run.vtkhdf")
    >>> recorder = substep.Recorder(path, parts={"p": substep.Part()}, parameters={"n": 1})
    >>> recorder.append(0.0, {"p": {"points": [[1.0, 2.0]]}})
    >>> with substep.Recording(path) as recording:  # while the run goes on
    ...     print(recording.parameters, recording.frame(0)["p"]["points"])
    {'n': 1} [[1. 2.]]
    >>> recorder.close()
    >>> folder.cleanup()
    """

    def __init__(
        self, path: str | os.PathLike[str], *, recover: bool = False, max_bytes: int = MAX_BYTES
    ) -> None:
        self._max_bytes = check_integer("max_bytes", max_bytes, minimum=1)
        name = check_path(path)
        if not name.endswith(JOURNAL_SUFFIX) and os.path.lexists(name + JOURNAL_SUFFIX):
            name += JOURNAL_SUFFIX
        self._adopt(_open_source(name, self._max_bytes), recover)

    @classmethod
    def _of(cls, source: Source) -> Recording:
        """A recording of what is open already."""
        recording = cls.__new__(cls)
        recording._max_bytes = MAX_BYTES
        recording._adopt(source, recover=False)
        return recording

    def _adopt(self, source: Source, recover: bool) -> None:
        self.source = source
        self.path = source.path
        self.packed = not isinstance(source, Journal)
        try:
            self._check_metadata(source.metadata)
            if recover:
                self._keep_valid_frames()
            elif self.source.problem is not None:
                raise self.source.problem
        except BaseException:
            self.close()
            raise

    def _check_metadata(self, metadata: dict[str, Any]) -> None:
        """Names and units come from a file that anyone may have written: check them as input."""
        try:
            triangles = iter(self.source.triangles)
            self.parts = check_parts(
                {
                    part["name"]: Part(
                        part["kind"],
                        dict(part["fields"]),
                        None if part["triangles"] is None else next(triangles),
                    )
                    for part in metadata["parts"]
                }
            )
            self.scene: str = check_text("scene", metadata["scene"], 1000)
            self.parameters: dict[str, Any] = check_parameters(metadata["parameters"])
            self.seed: int = check_integer("seed", metadata["seed"], minimum=0)
            self.version: str = check_text("substep", metadata["substep"], 64)
        except (InputError, TypeError, KeyError, ValueError) as error:
            raise CorruptError(f"{self.path}: metadata: {error}") from None

    def _keep_valid_frames(self) -> None:
        for i in range(len(self)):
            try:
                self.frame(i)
            except (CorruptError, TruncatedError, VersionError):
                self.source.forget(i)
                return

    def __len__(self) -> int:
        return len(self.source.times)

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames, shape (frames,) [s]."""
        return np.array(self.source.times, np.float64)

    def _index(self, index: int) -> int:
        number = operator.index(index)
        if not -len(self) <= number < len(self):
            raise IndexError(f"frame {number}: the recording has {len(self)} frames")
        return number % len(self)

    def _read_arrays(self, index: int, wanted: list[int]) -> list[NDArray[Any]]:
        counts, specs = self.source.counts[index], self.source.specs
        needed = sum(counts[k] * specs[k].row_bytes for k in wanted)
        if needed > self._max_bytes:
            raise FormatError(
                f"{self.path}: frame {index} needs {needed} bytes, max_bytes is {self._max_bytes}"
            )
        return [read_checked(self.source, index, k) for k in wanted]

    def frame(self, index: int) -> Frame:
        """All arrays of one frame.

        Parameters
        ----------
        index : int
            From 0; negative ones count from the end.

        Returns
        -------
        dict of str to dict of str to ndarray
            For every part its `points` and its fields, as they were recorded.

        Raises
        ------
        IndexError
            If there is no such frame.
        CorruptError
            If a checksum differs.
        FormatError
            If the frame is larger than `max_bytes`.
        """
        number = self._index(index)
        specs = self.source.specs
        result: Frame = {name: {} for name in self.parts}
        for spec, array in zip(specs, self._read_arrays(number, [*range(len(specs))]), strict=True):
            result[spec.part][spec.name] = array
        return result

    def __iter__(self) -> Iterator[tuple[float, Frame]]:
        for i in range(len(self)):
            yield self.source.times[i], self.frame(i)

    def __getitem__(self, name: str) -> RecordedPart:
        """The part of that name; KeyError if there is none."""
        if name not in self.parts:
            raise KeyError(f"{name!r}; the recording has {', '.join(self.parts)}")
        return RecordedPart(self, name)

    def close(self) -> None:
        """Close the file."""
        self.source.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # not opened, or the interpreter ends
            self.source.close()


class RecordedPart:
    """One part of a `Recording`: its arrays, one at a time.

    Attributes
    ----------
    name : str
        Of the part.
    info : Part
        Kind, fields with their units, triangles.
    """

    def __init__(self, recording: Recording, name: str) -> None:
        self._recording = recording
        self.name = name
        self.info = recording.parts[name]

    def points(self, index: int) -> NDArray[Any]:
        """Positions at one frame, shape (n, 2) or (n, 3) [m]."""
        return self.field("points", index)

    def field(self, name: str, index: int) -> NDArray[Any]:
        """A field at one frame, one row per point, in the unit of `info.fields[name]`."""
        names = ("points", *self.info.fields)
        if name not in names:
            raise KeyError(f"{name!r}; the part has {', '.join(names)}")
        number = self._recording._index(index)
        specs = self._recording.source.specs
        wanted = [k for k, s in enumerate(specs) if (s.part, s.name) == (self.name, name)]
        return self._recording._read_arrays(number, wanted)[0]
