"""Version, instruction level and threads of this installation, and the hash of a state."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from typing import Any

import numpy as np

from . import __version__, _core
from .base.checks import MOST_THREADS, check_integer

__all__ = ["num_threads", "set_num_threads", "show_config", "state_hash"]


def __dir__() -> list[str]:
    return __all__


def num_threads() -> int:
    """Number of threads that native loops use by default.

    Returns
    -------
    int
        As set by `set_num_threads` or SUBSTEP_NUM_THREADS, else the cores that this process may
        use (affinity and, in a container, quota).

    Raises
    ------
    InputError
        If SUBSTEP_NUM_THREADS is not an integer from 1 to 1024.

    Examples
    --------
    >>> import substep
    >>> substep.num_threads() >= 1
    True
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

    Examples
    --------
    >>> import substep
    >>> before = substep.num_threads()
    >>> substep.set_num_threads(2)
    >>> substep.num_threads()
    2
    >>> substep.set_num_threads(before)
    """
    _core.set_num_threads(check_integer("threads", threads, minimum=1, maximum=MOST_THREADS))


def show_config() -> dict[str, str]:
    """Print and return version, instruction level, threads and libraries.

    Returns
    -------
    dict of str to str
        One entry per printed line.

    Examples
    --------
    >>> import substep
    >>> config = substep.show_config()  # doctest: +ELLIPSIS
    substep     ...
    >>> config["substep"] == substep.__version__
    True
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
    versions = _core.library_versions()
    modules = "with" if versions["gpl"] else "without"
    entries["suitesparse"] = f"{versions['suitesparse']}, {modules} supernodal CHOLMOD and UMFPACK"
    entries["blas"] = versions["blas"]
    if not versions["blas_is_serial"]:
        entries["blas"] += " (not the serial OpenBLAS: bits may depend on its number of threads)"
    for name in ("h5py", "tqdm", "matplotlib", "scipy", "vtk"):
        try:
            entries[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            entries[name] = "not installed"
    for name, value in entries.items():
        print(f"{name:<12}{value}")
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

    Raises
    ------
    TypeError
        If an array holds Python objects.

    Examples
    --------
    >>> import substep
    >>> substep.state_hash([1.0, 2.0]) == substep.state_hash([1.0, 2.0])
    True
    >>> substep.state_hash(0.0) == substep.state_hash(-0.0)
    False
    """
    digest = hashlib.blake2b(digest_size=16)
    for value in arrays:
        array = np.asarray(value, order="C")
        if array.dtype.hasobject:
            raise TypeError(f"arrays: expected numbers, got dtype {array.dtype}")
        digest.update(f"{array.dtype.str}{array.shape};".encode())
        digest.update(array.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()
