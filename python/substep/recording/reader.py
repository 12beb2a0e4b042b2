"""Recordings read back as arrays, whether packed or still a journal."""

from __future__ import annotations

import contextlib
import importlib
import math
import operator
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.attributes import Checked
from ..base.checks import check_integer, check_path
from ..base.pictured import Pictured
from ..base.replacing import check_file_name
from ..errors import CorruptError, FormatError, InputError, TruncatedError, VersionError
from .files import JOURNAL_SUFFIX, check_not_itself
from .frames import Source, read_checked
from .journal import MAX_BYTES, Journal, open_source
from .parts import Part, as_cells, check_parameters, check_parts, check_text

Frame = dict[str, dict[str, NDArray[Any]]]


class Recording(Checked, Pictured):
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
        Kind, fields with their units, and topology of every part.
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
    ...     recorder.append(0.1, {"p": {"points": [[1.0, 2.5]]}})
    ...     print(recording.refresh(), recording.frame(-1)["p"]["points"])
    {'n': 1} [[1. 2.]]
    2 [[1.  2.5]]
    >>> recorder.close()
    >>> folder.cleanup()
    """

    def __init__(
        self, path: str | os.PathLike[str], *, recover: bool = False, max_bytes: int = MAX_BYTES
    ) -> None:
        self._max_bytes = check_integer("max_bytes", max_bytes, minimum=1)
        name = _newest(check_path(path))
        self._seen = _identity(name)
        self._adopt(open_source(name, self._max_bytes), recover)

    @classmethod
    def _of(cls, source: Source) -> Recording:
        """A recording of what is open already."""
        recording = cls.__new__(cls)
        recording._max_bytes = MAX_BYTES
        recording._adopt(source, recover=False)
        return recording

    def _adopt(self, source: Source, recover: bool) -> None:
        self._closed = False
        self._refreshing = threading.RLock()
        self._earlier: list[Source | Recording] = []  # which other threads may still read
        self._recover = recover
        self.source = source
        self.path = source.path
        self.packed = not isinstance(source, Journal)
        try:
            self._check_metadata(source.metadata)
            self._check_frames()
        except BaseException:
            self.close()
            raise

    def _check_frames(self) -> None:
        problem = self._check_index() or self.source.problem
        if self._recover:
            self._keep_valid_frames()
        elif problem is not None:
            raise problem

    def _check_metadata(self, metadata: dict[str, Any]) -> None:
        """Names and units come from a file that anyone may have written: check them as input."""
        try:
            self.parts = check_parts(
                {
                    part["name"]: Part(
                        part["kind"],
                        dict(part["fields"]),
                        **constants,
                        bounds=part.get("bounds"),
                        cell=part.get("cell"),
                    )
                    for part, constants in zip(
                        metadata["parts"], self.source.constants, strict=True
                    )
                }
            )
            self.scene: str = check_text("scene", metadata["scene"], 1000)
            self.parameters: dict[str, Any] = check_parameters(metadata["parameters"])
            self.seed: int = check_integer("seed", metadata["seed"], minimum=0)
            self.version: str = check_text("substep", metadata["substep"], 64)
        except (InputError, TypeError, KeyError, ValueError) as error:
            raise CorruptError(f"{self.path}: metadata: {error}") from None

    def _check_index(self) -> CorruptError | None:
        """Forget the first frame that a `Recorder` would have refused and those after; say why.

        Who draws a mesh relies on its topology.
        """
        specs, counts = self.source.specs, np.array(self.source.counts, np.int64)
        if not len(counts):
            return None
        times = self.times
        late = ~np.isfinite(times)
        late[1:] |= times[1:] <= times[:-1]
        wrong = {"its time is not after the frame before": late}
        for name, part in self.parts.items():
            columns = [k for k, spec in enumerate(specs) if spec.part == name]
            for spec in (specs[k] for k in columns):
                quaternion = spec.name == "orientation" and part.kind == "bodies"
                allowed = ((2,), (3,)) if spec.name == "points" else ((4,),)
                if (quaternion or spec.name == "points") and spec.shape not in allowed:
                    wrong[f"{name}/{spec.name} has rows of shape {spec.shape}"] = np.ones(
                        len(times), bool
                    )
            rows = counts[:, columns]
            needed = part.needed
            if columns:
                wrong[f"the arrays of {name} differ in length"] = (rows != rows[:, :1]).any(axis=1)
                wrong[f"the topology of {name} needs {needed} points"] = rows[:, 0] < needed
            if part.cells:
                number = math.prod(part.cells)
                wrong[f"the arrays of {name} need {number} cells"] = (rows != number).any(axis=1)
        found = [(int(np.argmax(bad)), why) for why, bad in wrong.items() if bad.any()]
        if not found:
            return None
        frame, reason = min(found)
        self.source.forget(frame)
        return CorruptError(f"{self.path}: frame {frame}: {reason}")

    def _keep_valid_frames(self) -> None:
        for i in range(len(self)):
            try:
                self.frame(i)
            except (CorruptError, TruncatedError, VersionError):
                self.source.forget(i)
                return

    def __len__(self) -> int:
        return len(self.source.times)

    def __repr__(self) -> str:
        frames = len(self)
        span = f", t = {self.times[0]:.6g} to {self.times[-1]:.6g} s" if frames else ""
        parts = ", ".join(f"{name}: {part.kind}" for name, part in self.parts.items())
        return f"Recording({self.scene or 'no scene'}, {frames} frames{span}; {parts})"

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames, shape (frames,) [s]."""
        return np.array(self.source.times, np.float64)

    def _index(self, index: int) -> int:
        if self._closed:
            raise InputError("the recording is closed")
        number, frames = operator.index(index), len(self)
        if not -frames <= number < frames:
            raise IndexError(f"frame {number}: the recording has {frames} frames")
        return number % frames

    def _read_arrays(self, index: int, wanted: list[int]) -> list[NDArray[Any]]:
        counts, specs = self.source.counts[index], self.source.specs
        needed = sum(counts[k] * specs[k].row_bytes for k in wanted)
        if needed > self._max_bytes:
            raise FormatError(
                f"{self.path}: frame {index} needs {needed} bytes, max_bytes is {self._max_bytes}"
            )
        arrays = []
        for k in wanted:
            rows, cells = read_checked(self.source, index, k), self.parts[specs[k].part].cells
            arrays.append(as_cells(rows, cells) if cells else rows)
        return arrays

    def frame(self, index: int) -> Frame:
        """All arrays of one frame.

        Parameters
        ----------
        index : int
            From 0; negative ones count from the end.

        Returns
        -------
        dict of str to dict of str to ndarray
            For every part its `points` and its fields, as they were recorded; of a grid its fields.
            Constant points are read-only.

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
        result: Frame = {
            name: {} if part.points is None else {"points": np.asarray(part.points)}
            for name, part in self.parts.items()
        }
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

    def refresh(self) -> int:
        """Take in the frames that a run has written since the recording was opened.

        That it is packed meanwhile, and gone on with later, is no hindrance. A recording of other
        frames that has replaced it is not taken in; one opened with `recover` keeps the frames that
        it has. Other threads may read meanwhile; an interrupt loses no frame.

        Returns
        -------
        int
            Number of frames.

        Raises
        ------
        InputError
            If the recording is closed.
        CorruptError, TruncatedError
            If what was added is damaged; the frames before it stay.
        OSError
            If it cannot be read.
        """
        if self._closed:
            raise InputError("the recording is closed")
        if not self._recover:
            with self._refreshing:
                if isinstance(self.source, Journal):
                    self.source.refresh()
                    self._check_frames()
                self._follow()
        return len(self)

    def _follow(self) -> None:
        """Go on with the file that has taken the place of the one that is open, if any has."""
        name = _newest(self.path.removesuffix(JOURNAL_SUFFIX))
        try:
            seen = _identity(name)
            if seen == self._seen:
                return
            later = Recording(name, max_bytes=self._max_bytes)
        except FileNotFoundError:  # removed, or packed this moment
            return
        if not later._goes_on_from(self):
            later.close()
            self._seen = seen
            return
        vars(self).update(
            source=later.source,
            path=later.path,
            packed=later.packed,
            _seen=seen,
            _earlier=[*self._earlier, self.source, later],  # which closes its source when it goes
        )

    def _goes_on_from(self, earlier: Recording) -> bool:
        """Whether it has the same contents, and first the frames of that."""
        mine, theirs = self.source, earlier.source
        frames = len(theirs.times)
        keys = ("parts", "scene", "parameters", "seed")
        return (
            all(mine.metadata[key] == theirs.metadata[key] for key in keys)
            and mine.times[:frames] == theirs.times
            and mine.crcs[:frames] == theirs.crcs
            and all(
                np.array_equal(one[name], other[name])
                for one, other in zip(mine.constants, theirs.constants, strict=True)
                for name in one
            )
        )

    def to_html(
        self, out: str | os.PathLike[str], *, color: str | None = None, fps: float = 25.0
    ) -> str:
        """Write one HTML file that plays the recording without Python and without a network.

        Parameters
        ----------
        out : path-like
            The file; an existing one is replaced.
        color : str, optional
            Field that colours the parts which have it.
        fps : float, optional
            Frames shown per second, above 0.

        Returns
        -------
        str
            Path of the file.

        Raises
        ------
        InputError
            If there are no frames, no such field, `fps` is not above 0, or `out` is the recording.
        FormatError
            If the recording is damaged.
        ImportError
            If viser is missing: ``pip install "substep[view]"``.
        OSError
            If the file cannot be written.
        """
        path = check_file_name(out, "out")
        check_not_itself(path, self.path)
        page = importlib.import_module("substep.view.page")  # stands above
        page.write_page(self, Path(path), color, fps)
        return path

    def close(self) -> None:
        """Close the file; arrays that were read from it stay."""
        self._closed = True
        for one in (*self._earlier, self.source):
            one.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # not opened, or the interpreter ends
            self.source.close()


def _newest(name: str) -> str:
    """The journal of a recording where there is one."""
    journal = name + JOURNAL_SUFFIX
    return journal if not name.endswith(JOURNAL_SUFFIX) and os.path.lexists(journal) else name


def _identity(name: str) -> tuple[int, int]:
    """Of the file that has this name now; no other has it while that is open."""
    status = os.stat(name)
    return status.st_dev, status.st_ino


class RecordedPart:
    """One part of a `Recording`, as `recording[name]` gives it: its arrays, one at a time.

    Parameters
    ----------
    recording : Recording
        Open.
    name : str
        Of the part.

    Attributes
    ----------
    name : str
        Of the part.
    info : Part
        Kind, fields with their units, topology.

    Examples
    --------
    >>> import os, tempfile
    >>> import substep
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = os.path.join(folder.name, "run.vtkhdf")
    >>> parts = {"p": substep.Part("particles", {"speed": "m/s"})}
    >>> with substep.Recorder(path, parts=parts) as recorder:
    ...     recorder.append(0.0, {"p": {"points": [[1.0, 2.0]], "speed": [3.0]}})
    >>> with substep.Recording(path) as recording:
    ...     print(recording["p"].points(0), recording["p"].field("speed", 0))
    [[1. 2.]] [3.]
    >>> folder.cleanup()
    """

    def __init__(self, recording: Recording, name: str) -> None:
        self._recording = recording
        self.name = name
        self.info = recording.parts[name]

    def points(self, index: int) -> NDArray[Any]:
        """Positions at one frame.

        Parameters
        ----------
        index : int
            Of the frame, from 0; negative ones count from the end.

        Returns
        -------
        ndarray, shape (n, 2) or (n, 3)
            As recorded [m].

        Raises
        ------
        IndexError
            If there is no such frame.
        CorruptError
            If its checksum differs.
        """
        return self.field("points", index)

    def field(self, name: str, index: int) -> NDArray[Any]:
        """A field at one frame.

        Parameters
        ----------
        name : str
            Of the field.
        index : int
            Of the frame, from 0; negative ones count from the end.

        Returns
        -------
        ndarray, one row per point
            As recorded, in the unit `info.fields[name]`.

        Raises
        ------
        KeyError
            If there is no such field.
        IndexError
            If there is no such frame.
        CorruptError
            If its checksum differs.
        """
        names = self.info.array_names
        if name not in names:
            raise KeyError(f"{name!r}; the part has {', '.join(names)}")
        number = self._recording._index(index)
        if name == "points" and self.info.points is not None:
            return np.asarray(self.info.points)
        specs = self._recording.source.specs
        wanted = [k for k, s in enumerate(specs) if (s.part, s.name) == (self.name, name)]
        return self._recording._read_arrays(number, wanted)[0]
