"""Version, instruction level and threads of this installation, and the hash of a state."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from typing import Any

import numpy as np

from . import __version__, _core
from ._checks import check_integer


def num_threads() -> int:
    """Number of threads that native loops use by default.

    Returns
    -------
    int
        As set by `set_num_threads` or SUBSTEP_NUM_THREADS, else the cores this process may use.
    """
    return _core.num_threads()


def set_num_threads(threads: int) -> None:
    """Set the number of threads that native loops use by default.

    Results do not depend on it, bit for bit.

    Parameters
    ----------
    threads : int
        From 1 to 1024.

    Raises
    ------
    InputError
        If `threads` is not such an integer.
    """
    _core.set_num_threads(check_integer("threads", threads, minimum=1, maximum=1024))


def show_config() -> dict[str, str]:
    """Print and return version, instruction level, threads and libraries.

    Returns
    -------
    dict of str to str
        One entry per printed line.
    """
    entries = {
        "substep": __version__,
        "level": _core.level,
        "threads": str(num_threads()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "compiler": _core.compiler,
        "eigen": _core.eigen,
    }
    for name in ("h5py", "tqdm", "matplotlib", "scipy", "vtk"):
        try:
            entries[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            entries[name] = "not installed"
    for name, value in entries.items():
        print(f"{name:<11}{value}")
    return entries


def state_hash(*arrays: Any) -> str:
    """Hash of arrays: equal exactly when dtypes, shapes and all bits are equal.

    Parameters
    ----------
    *arrays : array_like
        Numbers of any shape and dtype but object.

    Returns
    -------
    str
        32 hexadecimal digits (BLAKE2b).
    """
    digest = hashlib.blake2b(digest_size=16)
    for value in arrays:
        array = np.ascontiguousarray(value)
        digest.update(f"{array.dtype.str}{array.shape};".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()
