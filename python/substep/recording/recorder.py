"""Recording a run: frames into a journal, and the journal into VTKHDF at the end."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_flag, check_integer, check_real, describe
from ..base.owned import Owned
from ..base.replacing import check_file_name
from ..errors import InputError
from .files import JOURNAL_SUFFIX
from .frames import Constants, Encoder, Spec, encode_file_header, read_checked
from .journal import Writer, open_source
from .packing import pack
from .parts import (
    Part,
    check_keys,
    check_parameters,
    check_part,
    check_parts,
    check_text,
    check_values,
    metadata_of,
)


class _Frame(NamedTuple):
    """What is known of a frame in the journal, and where it ends there."""

    time: float
    end: int
    specs: list[Spec]
    counts: tuple[int, ...]  # rows of its arrays


class Recorder(Owned):
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
        overwrite, resume = check_flag("overwrite", overwrite), check_flag("resume", resume)
        fsync = check_flag("fsync", fsync)
        if overwrite and resume:
            raise InputError("overwrite, resume: give one of them")
        self.path = check_file_name(path)
        self.journal_path = self.path + JOURNAL_SUFFIX
        self._frames: list[_Frame] = []
        self._encoder = Encoder()
        self._writer: Writer | None = None
        header = encode_file_header(metadata, self._constants())
        if resume and not self._resume(metadata, fsync) and os.path.lexists(self.path):
            _unpack(self.path, self.journal_path)
            self._resume(metadata, fsync)
        if self._writer is None:
            self._make_room(overwrite)
            self._writer = Writer.create(self.journal_path, header, fsync)
        self._begin = self._writer.end

    def _constants(self) -> list[Constants]:
        return [part.constants() for part in self._parts.values()]

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
            for mine, theirs in zip(self._constants(), journal.constants, strict=True):
                for name, array in mine.items():
                    if not np.array_equal(array, theirs[name]):
                        raise InputError(f"{name}: the recording to resume has others")
        except BaseException:
            writer.close(writer.end)
            raise
        self._writer = writer
        self._frames = [
            _Frame(time, journal.end, journal.specs, counts)
            for time, counts in zip(journal.times, journal.counts, strict=True)
        ]
        return True

    def __len__(self) -> int:
        """Frames recorded so far, those of a resumed recording included."""
        return len(self._frames)

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames recorded so far, shape (frames,) [s]."""
        return np.array([frame.time for frame in self._frames], np.float64)

    def append(self, time: float, frame: Mapping[str, Mapping[str, ArrayLike]]) -> None:
        """Record one frame; when this returns, it is in the journal.

        Parameters
        ----------
        time : float
            Later than that of the frame before [s].
        frame : mapping
            For every part its `points`, shape (n, 2) or (n, 3) [m], and its fields, one row per
            point. n may change from frame to frame; dtypes and row shapes stay those of the first.
            Parts whose points are constant are left out. A grid has fields only, of shape
            (nx, ny[, nz], ...).

        Raises
        ------
        InputError
            If the time or an array is not valid, or the recorder is closed; nothing was written.
        OSError
            If the journal cannot be written (disk full, folder removed ...); the frames before
            are as they were, and the next `append` tries again.
        """
        self._alone("append")
        if self._writer is None:
            raise InputError("the recorder is closed")
        now = check_real("time", time)
        if self._frames and now <= self._frames[-1].time:
            raise InputError(f"time: expected one after {self._frames[-1].time}, got {now}")
        specs, arrays = self._check_frame(frame)
        record = self._encoder.encode(len(self._frames), now, specs, arrays)
        end = self._writer.append(record, self._end)
        # At once, and so whole or not at all: without it, the next frame takes the place of this.
        self._frames.append(_Frame(now, end, specs, tuple(len(array) for array in arrays)))

    @property
    def _end(self) -> int:
        """Of the frames, in the journal."""
        return self._frames[-1].end if self._frames else self._begin

    def _alone(self, method: str) -> None:
        """Refuse handlers of signals, and what an array does while it is converted."""
        try:
            self._owner.begin(method)
        except InputError:
            raise InputError("the recorder is in the middle of a frame") from None

    def _check_frame(self, frame: Any) -> tuple[list[Spec], list[NDArray[Any]]]:
        moving = {name: part for name, part in self._parts.items() if part.points is None}
        check_keys("frame", frame, moving)
        specs: list[Spec] = []
        arrays: list[NDArray[Any]] = []
        for part_name, part in moving.items():
            values = frame[part_name]
            names = part.array_names
            check_keys(f"frame[{part_name!r}]", values, names)
            for name in names:
                known = self._frames[-1].specs[len(specs)] if self._frames else None
                what = f"{part_name}/{name}"
                array = check_values(what, values[name], name == "points", known, part.cells)
                specs.append(Spec(part_name, name, array.dtype.str, array.shape[1:]))
                arrays.append(array)
            check_part(part_name, part, arrays[-len(names) :], names)
            before = self._frames[-1].counts[len(specs) - len(names)] if self._frames else None
            if part.tetrahedra is not None and before not in (None, len(arrays[-1])):
                raise InputError(
                    f"{part_name}/points: tetrahedra keep their number of points, {before}; "
                    f"got {len(arrays[-1])}"
                )
        return specs, arrays

    def close(self) -> None:
        """Finish: pack the journal into the recording, verify that, and remove the journal.

        A second call does nothing.

        Raises
        ------
        InputError
            If the call comes in the middle of `append`, as from a handler of signals.
        OSError
            If the packed file cannot be written; the journal stays, and `substep.pack` can try
            again, also to another place.
        """
        self._alone("close")
        recording = self._writer is not None
        self._release()
        if recording:
            pack(self.journal_path)

    def _release(self) -> None:
        if self._writer is not None:
            self._writer.close(self._end)
            self._writer = None

    def __reduce__(self) -> Any:
        raise TypeError("a recorder can neither be copied nor pickled")

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
    with contextlib.closing(open_source(path)) as source:
        header = encode_file_header(source.metadata, source.constants)
        part = journal_path + ".unpack"
        if os.path.lexists(part):
            os.unlink(part)
        writer, encoder = Writer.create(part, header), Encoder()
        try:
            for i, time in enumerate(source.times):
                arrays = [read_checked(source, i, k) for k in range(len(source.specs))]
                record = encoder.encode(i, time, source.specs, arrays)
                writer.end = writer.append(record, writer.end)
        finally:
            writer.close(writer.end)
        os.rename(part, journal_path)
