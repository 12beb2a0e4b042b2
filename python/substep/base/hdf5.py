"""HDF5 in a process of its own, as it crashes or hangs on some damaged files."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from .. import errors
from ..errors import CorruptError, FormatError
from .child_process import child_environment


class _Helper:
    """The process, begun when it is first asked and again where it has died."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, question: list[Any]) -> tuple[list[Any], bytes]:
        """The first line of the answer, and what follows; EOFError if the process died of it."""
        with self._lock:
            if self._process is not None and self._process.poll() is not None:
                self.end()  # it died since
            try:
                return self._exchange(question)
            except (BrokenPipeError, ValueError, TypeError, IndexError):
                self.end()
                raise EOFError from None  # it died within its answer
            except BaseException:
                self.end()
                raise

    def _exchange(self, question: list[Any]) -> tuple[list[Any], bytes]:
        process = self._process = self._process or self._begin()
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(question).encode() + b"\n")
        process.stdin.flush()
        first = json.loads(process.stdout.readline())
        content = process.stdout.read(first[-1])
        if len(content) < first[-1]:
            raise EOFError
        return first, content

    def begin_anew(self) -> None:
        """In a forked process: leave the helper to the process that began it."""
        self._lock = threading.Lock()
        self._inherited, self._process = self._process, None

    def _begin(self) -> subprocess.Popen[bytes]:
        home = str(Path(__file__).resolve().parents[2])
        return subprocess.Popen(
            [sys.executable, "-m", "substep.base.hdf5_process"],
            cwd=home,
            env=child_environment(home),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for this process
        )

    def end(self) -> None:
        """End the process, which is no loss."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            with contextlib.suppress(OSError):
                process.communicate()


_helper = _Helper()
atexit.register(_helper.end)
if hasattr(os, "register_at_fork"):  # a forked process has a helper of its own
    os.register_at_fork(after_in_child=_helper.begin_anew)


def ask_hdf5(what: str, path: str | os.PathLike[str], arguments: list[Any], expected: int) -> bytes:
    """What `hdf5_process` finds in a file; its FormatError and OSError are raised here."""
    try:
        first, content = _helper.ask([what, os.path.abspath(path), arguments, expected])
    except EOFError:
        raise CorruptError(f"{path}: HDF5 comes to no good end with it") from None
    kind, message, number, _ = first
    if kind == "OSError":
        raise OSError(number, message, os.fspath(path))
    if kind == "MemoryError":
        raise FormatError(f"{path}: HDF5 needs more memory than {expected} bytes and 1 GiB for it")
    if hasattr(errors, kind or " "):
        raise getattr(errors, kind)(message)
    if kind:
        raise CorruptError(f"{path}: HDF5 cannot read it: {kind}: {message}")
    return content
