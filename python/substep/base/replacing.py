"""Files that appear whole under their name, or not at all."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from ..errors import InputError
from .checks import check_path, describe


def check_file_name(path: Any, name: str = "path") -> str:
    """The name of a file to write, as a string; one that ends in a slash is that of a folder."""
    text = check_path(path, name)
    if not os.path.basename(text):
        raise InputError(f"{name}: expected the name of a file, got a folder, {describe(text)}")
    return text


def check_folder(path: str | Path) -> None:
    """Refuse a file in a folder that is not there, by the name of that folder."""
    folder = Path(path).parent
    if not folder.is_dir():
        wrong = errno.ENOTDIR if folder.exists() else errno.ENOENT
        raise OSError(wrong, os.strerror(wrong), str(folder))


def replace_file(path: str, write: Callable[[IO[bytes]], object], *, mode: int = 0o666) -> None:
    """Have `write` fill a file beside the path, which then gets that name in one step.

    Whatever is raised leaves the file that there was.
    """
    target = Path(path)
    check_folder(target)
    if target.exists() and not target.is_file():  # a device or a pipe would be gone
        wrong = errno.EISDIR if target.is_dir() else errno.EINVAL
        raise OSError(wrong, "expected a file to replace", path)
    partial = target.with_name(f".{target.name[:100]}-{secrets.token_hex(8)}")
    opener = functools.partial(os.open, mode=mode)
    try:  # before there is a file, so that whatever interrupts this leaves none
        with open(partial, "xb", opener=opener) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(partial)
        if isinstance(error, OSError):
            error.filename = path  # the name that was given
        raise


def replace_bytes(path: Path, content: bytes | memoryview) -> None:
    """As `replace_file`, of bytes that are known."""
    replace_file(str(path), lambda file: file.write(content))
