"""Whole reads and writes, names that appear in one step, and locks between processes."""

from __future__ import annotations

import contextlib
import errno
import os

from ..errors import InputError, TruncatedError

try:
    import fcntl
except ImportError:  # not a POSIX system: no lock against a second writer
    fcntl = None  # type: ignore[assignment]

JOURNAL_SUFFIX = ".journal"


def pread_exactly(fd: int, buffer: memoryview, offset: int, where: str) -> None:
    """Fill the buffer from the file, or raise TruncatedError."""
    done = 0
    while done < len(buffer):
        got = os.preadv(fd, [buffer[done:]], offset + done)
        if got == 0:
            end = min(offset + done, os.fstat(fd).st_size)
            raise TruncatedError(f"{where}: the file ends at byte {end}", offset=end)
        done += got


def write_all(fd: int, data: bytes | memoryview, offset: int) -> None:
    """Write everything, however many calls it takes."""
    view = memoryview(data)
    while view:
        done = os.pwrite(fd, view, offset)
        view = view[done:]
        offset += done


def sync_folder(path: str) -> None:
    """Make a rename in this file's folder durable, where the system can."""
    with contextlib.suppress(OSError):
        fd = os.open(os.path.dirname(path) or ".", os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def publish(part: str, path: str, *, overwrite: bool = False) -> None:
    """Give a finished file its name in one step; FileExistsError if the name is taken."""
    if overwrite:
        os.replace(part, path)
        return
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), path) from None
        os.rename(part, path)
    else:
        os.unlink(part)


def check_not_itself(out: str | os.PathLike[str], recorded: str) -> None:
    """Refuse to write what is made of a recording over it, or where its journal will be packed."""
    name = os.path.realpath(out)
    same = name in (os.path.realpath(p) for p in (recorded, recorded.removesuffix(JOURNAL_SUFFIX)))
    with contextlib.suppress(OSError):  # there is no such file
        same = same or os.path.samefile(out, recorded)
    if same:
        raise InputError(f"out: {str(out)[-60:]!r} is the recording itself")


def lock(fd: int) -> bool:
    """Take the journal for writing until fd is closed; False if another process holds it."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EWOULDBLOCK, errno.EACCES)  # others: no locks there
    return True


def unlock(fd: int) -> None:
    """Give a journal back, whoever else has its descriptor."""
    if fcntl is not None:
        with contextlib.suppress(OSError):
            fcntl.flock(fd, fcntl.LOCK_UN)


def lock_for_packing(path: str) -> int | None:
    """Open a journal as its only packer, after waiting for others; None if there is none (more).

    This is a lock of its own: a journal can be packed while another process writes it. It goes when
    the process closes any descriptor of the journal.
    """
    while True:
        try:
            fd = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
        except FileNotFoundError:
            return None
        if fcntl is not None:
            with contextlib.suppress(OSError):  # no locks on this file system
                fcntl.lockf(fd, fcntl.LOCK_EX)
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.stat(path), os.fstat(fd)):
                return fd
        os.close(fd)  # the packer before has removed it
