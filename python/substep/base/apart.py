"""Work on files in a forked process, as HDF5 may crash or hang where one is damaged."""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import signal
import warnings
from collections.abc import Callable
from typing import NoReturn

from .. import errors
from ..errors import CorruptError, FormatError

MEMORY = 1 << 30  # bytes that it may take, besides what is asked for
SECONDS = 2  # of processor time, besides 1 s for each
BYTES_PER_SECOND = 10_000_000


def apart(path: str | os.PathLike[str], work: Callable[[], bytes], expected: int) -> bytearray:
    """What `work` returns in a forked process, which has memory and time for `expected` bytes.

    Its FormatError and OSError are raised here; that it died is a CorruptError.
    """
    if not hasattr(os, "fork"):
        return bytearray(work())
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # h5py and the core survive a fork
        child = os.fork()
    if child == 0:
        _answer_and_end(writer, work, expected)
    os.close(writer)
    answer = bytearray()
    try:
        while block := os.read(reader, 1 << 20):
            answer += block
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        os.close(reader)
        _, status = os.waitpid(child, 0)
    if status or not answer:
        raise CorruptError(f"{path}: HDF5 cannot read it: it ends with status {status}")
    if answer.pop():
        kind, message, number = json.loads(answer)
        if kind == "OSError":
            raise OSError(number, message, os.fspath(path))
        if kind == "MemoryError":
            raise FormatError(f"{path}: HDF5 needs more than {expected + MEMORY} bytes for it")
        if hasattr(errors, kind):
            raise getattr(errors, kind)(message)
        raise CorruptError(f"{path}: HDF5 cannot read it: {kind}: {message}")
    return answer


def _answer_and_end(writer: int, work: Callable[[], bytes], expected: int) -> NoReturn:
    """In the child: write what came, and a last byte that tells whether it is an exception."""
    code = 1
    try:
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # the C library tells of a damaged heap
        _limit(expected)
        try:
            blocks = [work(), b"\0"]
        except Exception as error:
            kind = "OSError" if isinstance(error, OSError) else type(error).__name__
            number = error.errno if isinstance(error, OSError) else None
            text = (error.strerror or "") if isinstance(error, OSError) else str(error)
            blocks = [json.dumps([kind, text, number]).encode(), b"\1"]
        for block in blocks:
            view = memoryview(block)
            while view:
                view = view[os.write(writer, view) :]
        code = 0
    finally:
        os._exit(code)


def _limit(expected: int) -> None:
    with contextlib.suppress(ImportError, OSError, ValueError):  # where there are no limits
        import resource

        seconds = SECONDS + expected // BYTES_PER_SECOND
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        forever = resource.getrlimit(resource.RLIMIT_CPU)[1]
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, forever))
        with open("/proc/self/statm") as statm:
            pages = int(statm.read().split()[0])
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        most = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY + 3 * expected
        if hard == resource.RLIM_INFINITY or most < hard:
            resource.setrlimit(resource.RLIMIT_AS, (most, hard))
