"""Chooses the extension module of this machine's instruction level and loads it as substep._core.

The wheel carries one module per x86-64 level, all with the same name; `_cpu`, compiled for the
baseline, says which level the machine runs, and SUBSTEP_ISA overrides it. A process holds one level
for good: `_cpu` keeps which.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
import sys
import threading
from pathlib import Path
from types import ModuleType

LEVELS = ("baseline", "v2", "v3", "v4")  # in rising order

# The kernels of OpenBLAS that a level has, so that its bits do not depend on the machine. Left to
# itself it takes those for SSE3 on a processor that is newer than it: a third of the speed.
_BLAS_KERNELS = {"v3": "Haswell", "v4": "SkylakeX"}
_BLAS_VARIABLE = "OPENBLAS_CORETYPE"  # which it reads as it is loaded


def _module_path(folder: Path) -> Path | None:
    for suffix in importlib.machinery.EXTENSION_SUFFIXES:
        path = folder / f"_core{suffix}"
        if path.exists():
            return path
    return None


_loading = threading.Lock()


def load() -> ModuleType:
    """Load the best module that is installed and that this machine can run, once.

    In a thread of its own: Ctrl-C, which comes in the main one, would break off its initialization,
    and what that has registered by then keeps it from being loaded again.
    """
    if "substep._core" not in sys.modules:
        failures: list[BaseException] = []
        thread = threading.Thread(target=_load_once, args=(failures,))
        try:
            thread.start()
        except RuntimeError:  # there are no more threads to be had
            _load_once(failures)
        else:
            thread.join()
        for failure in failures:
            raise failure
    return sys.modules["substep._core"]


def _load_once(failures: list[BaseException]) -> None:
    try:
        with _loading:
            if "substep._core" not in sys.modules:
                sys.modules["substep._core"] = _load()
    except BaseException as error:
        failures.append(error)


def _load() -> ModuleType:
    from .. import _cpu

    machine = LEVELS.index(_cpu.level())
    installed = {
        level: path
        for level in LEVELS
        if (path := _module_path(Path(__file__).parents[1] / "_isa" / level)) is not None
    }
    usable = [level for level in installed if LEVELS.index(level) <= machine]
    wanted = os.environ.get("SUBSTEP_ISA")
    if wanted and wanted not in usable:
        raise ImportError(
            f"SUBSTEP_ISA={wanted}: this machine and installation offer {', '.join(usable)}"
        )
    if not usable:
        raise ImportError(
            f"substep needs x86-64-{min(installed, key=LEVELS.index, default='v2')} or better; "
            f"this machine has {_cpu.level()}"
        )
    level = _cpu.claim(wanted or usable[-1])
    if wanted and wanted != level:
        raise ImportError(f"SUBSTEP_ISA={wanted}: this process already holds level {level}")
    spec = importlib.util.spec_from_file_location("substep._core", installed[level])
    assert spec is not None and spec.loader is not None
    chosen = _BLAS_VARIABLE not in os.environ and level in _BLAS_KERNELS
    if chosen:
        os.environ[_BLAS_VARIABLE] = _BLAS_KERNELS[level]
    try:
        module = importlib.util.module_from_spec(spec)
    finally:
        if chosen:
            del os.environ[_BLAS_VARIABLE]
    spec.loader.exec_module(module)
    return module
