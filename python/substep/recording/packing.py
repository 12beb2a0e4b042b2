"""Packs a journal into VTKHDF, in a process of its own: HDF5 may crash on a full disk.

`python -m substep.export RECORDING [--out FILE] [--overwrite]` is that process; it runs `main`.
"""

from __future__ import annotations

import argparse
import builtins
import contextlib
import contextvars
import errno
import json
import os
import subprocess
import sys
from pathlib import Path

from .. import errors
from ..base.checks import check_flag, check_path
from ..base.replacing import check_file_name, check_folder
from ..errors import CorruptError, SubstepError
from .files import JOURNAL_SUFFIX, lock, lock_for_packing, publish, sync_folder
from .frames import Source, read_checked
from .journal import Journal
from .reader import Recording

# Whether this process may die of a crash of HDF5: it then packs itself, 0.5 s sooner.
expendable = contextvars.ContextVar("expendable", default=False)


def pack(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> str:
    """Pack a recording's journal into a VTKHDF file, which ParaView and VTK open.

    The file is written under another name, read back, and renamed. The journal is removed if `out`
    is not given and no process records into it any more.

    Parameters
    ----------
    path : path-like
        The recording, or its journal.
    out : path-like, optional
        File to write; by default the recording's own name.
    overwrite : bool
        Replace `out` if it is there.

    Returns
    -------
    str
        The packed file.

    Raises
    ------
    FormatError
        If the journal is damaged.
    FileExistsError
        If `out` is there, without `overwrite`.
    OSError
        If the file cannot be written; the journal is as it was.

    Examples
    --------
    >>> import os, tempfile
    >>> import substep
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = os.path.join(folder.name, "run.vtkhdf")
    >>> recorder = substep.Recorder(path, parts={"p": substep.Part()})
    >>> recorder.append(0.0, {"p": {"points": [[1.0, 2.0]]}})
    >>> os.path.basename(substep.pack(path, os.path.join(folder.name, "copy.vtkhdf")))
    'copy.vtkhdf'
    >>> recorder.close()
    >>> sorted(os.listdir(folder.name))
    ['copy.vtkhdf', 'run.vtkhdf']
    >>> folder.cleanup()
    """
    name = check_path(path)
    target = name.removesuffix(JOURNAL_SUFFIX)
    if out is not None:
        target = check_file_name(out, "out")
        check_folder(target)
    overwrite = check_flag("overwrite", overwrite)
    if expendable.get():
        pack_here(name, None if out is None else target, overwrite)
        return target
    command = [sys.executable, "-m", "substep.export", os.path.abspath(name)]
    if out is not None:
        command += ["--out", os.path.abspath(target)]
    if overwrite:
        command += ["--overwrite"]
    # The same modules as here, and none that happen to lie in the working directory.
    home = str(Path(__file__).resolve().parents[2])
    folders = os.pathsep.join([*(os.path.abspath(p) for p in sys.path if p), home])
    done = subprocess.run(
        command,
        cwd=home,
        env={**os.environ, "PYTHONPATH": folders, "PYTHONSAFEPATH": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise _error_of(done, target)
    return target


def _error_of(done: subprocess.CompletedProcess[str], target: str) -> Exception:
    """The exception that the process reported, or what can be said if it died."""
    try:
        report = json.loads(done.stderr.splitlines()[-1])
    except (ValueError, IndexError):
        with contextlib.suppress(OSError):
            os.unlink(part_of(target))
        return OSError(
            errno.EIO, f"packing ended with exit code {done.returncode}; the journal stays", target
        )
    if report["errno"] is not None:
        return OSError(report["errno"], report["message"], target)
    name = report["kind"]
    kind: type[Exception] = getattr(errors, name, getattr(builtins, name, SubstepError))
    return kind(report["message"])


def part_of(target: str) -> str:
    """Where a file is written before it gets its name."""
    return target + ".part"


def pack_here(path: str, out: str | None, overwrite: bool) -> None:
    """What `pack` does, in this process."""
    if out is None:
        _pack_in_place(path.removesuffix(JOURNAL_SUFFIX))
    else:
        with Recording(path) as recording:
            _write_file(recording.source, out, overwrite)


def _pack_in_place(target: str) -> None:
    """Turn a journal into the recording it belongs to."""
    journal = target + JOURNAL_SUFFIX
    fd = lock_for_packing(journal)
    if fd is None:
        Recording(target).close()  # packed already, else an error
        return
    try:
        nobody_records = lock(fd)  # before the frames are counted: none can follow
        recording = Recording._of(Journal(journal, fd))
        _write_file(recording.source, target, overwrite=True)
        if nobody_records:
            os.unlink(journal)
    finally:
        os.close(fd)


def _write_file(source: Source, target: str, overwrite: bool) -> None:
    """Write under another name, read back, make durable, rename."""
    from . import vtkhdf

    if not overwrite and os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), target)
    part = part_of(target)
    with contextlib.suppress(FileNotFoundError):
        os.unlink(part)
    _check_space(source, target)
    try:
        vtkhdf.write(source, part)
        _verify(source, part)
        fd = os.open(part, os.O_RDWR)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
        publish(part, target, overwrite=overwrite)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part)
        raise
    sync_folder(target)


def _check_space(source: Source, target: str) -> None:
    """Find a full disk before HDF5 does."""
    needed = sum(
        n * s.row_bytes
        for counts in source.counts
        for n, s in zip(counts, source.specs, strict=True)
    )
    disk = os.statvfs(os.path.dirname(target) or ".")
    if needed > disk.f_bavail * disk.f_frsize:
        raise OSError(
            errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: packing needs {needed} bytes", target
        )


def _verify(source: Source, part: str) -> None:
    """Read every frame back: its checksums are those of the journal."""
    from .packed import Packed

    packed = Packed(part, sys.maxsize)
    try:
        if packed.times != source.times or packed.crcs != source.crcs:
            raise CorruptError(f"{part}: what was written reads back differently")
        for i in range(len(packed.times)):
            for k in range(len(packed.specs)):
                read_checked(packed, i, k)
    finally:
        packed.close()


def main(arguments: list[str] | None = None) -> int:
    """Run as a program; a failure is reported as one line of JSON."""
    parser = argparse.ArgumentParser(prog="python -m substep.export")
    parser.add_argument("recording")
    parser.add_argument("--out")
    parser.add_argument("--overwrite", action="store_true")
    options = parser.parse_args(arguments)
    try:
        pack_here(options.recording, options.out, options.overwrite)
    except Exception as error:
        text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        number = error.errno if isinstance(error, OSError) else None
        report = {"kind": type(error).__name__, "message": text, "errno": number}
        print(json.dumps(report), file=sys.stderr)
        return 1
    return 0
