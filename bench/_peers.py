"""The peers that are here: Python modules, and C++ programs in SUBSTEP_PEERS.

Without that variable, the programs are those of ../shared/peers/ode/cpp/bin.
"""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "shared/peers/ode/cpp/bin"


@functools.cache
def peer_module(name: str) -> Any:
    """The module, or None (and a line that says so) where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        print(f"# {name} is left out: {error}")
        return None


def c_function(function: Callable[..., None]) -> Any:
    """numba's compiled f(t, y, dydt, parameters), as numbalsoda calls it; None without numba."""
    numba = peer_module("numba")
    if numba is None:
        return None
    pointer = numba.types.CPointer(numba.types.double)
    signature = numba.types.void(numba.types.double, pointer, pointer, pointer)
    return numba.cfunc(signature)(function)


def peer_program(name: str) -> Path | None:
    """The program, or None (and a line that says so) where it has not been built."""
    program = Path(os.environ.get("SUBSTEP_PEERS", FOLDER)) / name
    if program.exists():
        return program
    print(f"# {name} is left out: build it, and name its folder in SUBSTEP_PEERS")
    return None
