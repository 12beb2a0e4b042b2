"""One run of a sweep, in a process of the cluster: what it finds is in its folder when it ends."""

from __future__ import annotations

import fcntl
import functools
import io
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..base.replacing import replace_bytes
from ..errors import InputError
from ..scenes.catalogue import load
from ..scenes.declaration import Scene, shorten
from .design import Design

FUNCTION, RESULT, ERROR, BEGUN = "function.pickle", "result.npz", "error.txt", "begun.txt"
MOST_DEATHS = 3  # of processes in one run
_LONGEST = 2000  # letters of an error's line


def execute(out: str, design: Design, digest: str, folders: list[str], index: int) -> None:
    """Do a run, and leave what it found in its folder, or why it failed.

    Does nothing where it is done. A run that another process is still about is waited for.
    """
    from ..config import set_num_threads
    from ..errors import SubstepError
    from ..recording.packing import expendable

    set_num_threads(1)
    expendable.set(True)
    sys.path.extend(folder for folder in folders if folder not in sys.path)
    folder = design.folder(Path(out), index)
    folder.mkdir(exist_ok=True)
    with _alone(folder):
        if is_done(folder, design):
            return
        begun = folder / BEGUN
        deaths = int(begun.read_text() or 0) if begun.exists() else 0
        if deaths >= MOST_DEATHS:
            begun.unlink()
            write_error(folder, f"the process died {deaths} times in this run")
            return
        begun.write_text(str(deaths + 1))
        try:
            if design.kind == "scene":
                _run_scene(folder, index, design)
            else:
                _call(_function(str(Path(out) / FUNCTION), digest), folder, index, design)
        except BaseException as error:  # a function may also exit
            trace = "" if isinstance(error, SubstepError) else traceback.format_exc()
            write_error(folder, _line_of(error), trace)
        else:
            (folder / ERROR).unlink(missing_ok=True)
        finally:
            begun.unlink(missing_ok=True)


def _line_of(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:
        return f"{type(error).__name__}: it cannot tell what"


def write_error(folder: Path, line: str, trace: str = "") -> None:
    """Why a run failed, in its folder."""
    text = f"{line[:_LONGEST]}\n{trace[-100_000:]}".encode("utf-8", "replace")
    replace_bytes(folder / ERROR, text)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait for other processes at this run; one that dies lets go."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def is_done(folder: Path, design: Design) -> bool:
    """Whether the run has ended well."""
    if design.kind == "function":
        return (folder / RESULT).exists()
    recording = folder / f"{design.name}.vtkhdf"
    return recording.exists() and not recording.with_name(f"{recording.name}.journal").exists()


def _run_scene(folder: Path, index: int, design: Design) -> None:
    from ..scenes.run import run

    # A failed run is made anew: what it needs may have changed, its checkpoint has not.
    again = (folder / ERROR).exists()
    run(
        _scene(design.task),
        design.values(index),
        folder,
        seed=design.seed_of(index),
        resume=not again,
        overwrite=again,
        **design.options,
    )


@functools.lru_cache(1)
def _scene(name: str) -> Scene:
    return load(name)


@functools.lru_cache(1)
def _function(path: str, digest: str) -> Callable[..., Any]:
    """What the sweep calls; the digest is of the file that this sweep has written just now."""
    import hashlib
    import pickle

    data = Path(path).read_bytes()
    if hashlib.sha256(data).hexdigest() != digest:
        raise InputError(f"{path}: another sweep goes on in this folder")
    function: Callable[..., Any] = pickle.loads(data)
    return function


def _call(function: Callable[..., Any], folder: Path, index: int, design: Design) -> None:
    values: dict[str, Any] = design.values(index)
    if design.options["takes_seed"]:
        values["seed"] = design.seed_of(index)
    result = function(**values)
    if not isinstance(result, Mapping):
        raise InputError(
            f"function: expected a mapping of names to arrays as its result, "
            f"got {type(result).__name__}"
        )
    arrays = {}
    for name, value in result.items():
        if not (isinstance(name, str) and name.isprintable() and 0 < len(name) <= 200) or (
            name.endswith(".npy") or name in ("file", "allow_pickle")
        ):
            raise InputError(f"function: its result has the name {shorten(name)}, which is no name")
        arrays[name] = array = np.asarray(value)
        if array.dtype.kind not in "biufcUS":
            raise InputError(f"function: its result {name!r} is no array of numbers or texts")
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    replace_bytes(folder / RESULT, buffer.getbuffer())
