"""Milliseconds per recorded frame: our journal and its packing beside h5py and npz, JSON lines.

Frames are n particles with float32 positions and velocities, as in the peers' crash trials. Only
the journal, a flushed HDF5 file and one renamed npz per frame hold a frame that was acknowledged
when the process is killed; plain HDF5 loses the file, a flushed one spoils some frames
(docs/recording.md). Times are the best of several rounds, in a temporary folder.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import substep
from substep.export import pack_here

PARTS = {"p": substep.Part("particles", {"velocity": "m/s"})}


def journal(
    folder: Path, x: np.ndarray, v: np.ndarray, frames: int, *, fsync: bool = False
) -> None:
    """Our running format."""
    recorder = substep.Recorder(folder / "a.vtkhdf", parts=PARTS, fsync=fsync)
    for k in range(frames):
        recorder.append(k, {"p": {"points": x, "velocity": v}})
    recorder._release()


def journal_fsync(folder: Path, x: np.ndarray, v: np.ndarray, frames: int) -> None:
    """The same, waiting for the disk."""
    journal(folder, x, v, frames, fsync=True)


def h5py_plain(
    folder: Path, x: np.ndarray, v: np.ndarray, frames: int, *, flush: bool = False
) -> None:
    """One growing dataset each."""
    with h5py.File(folder / "a.h5", "w") as file:
        sets = [
            file.create_dataset(
                name, (0, *x.shape), "f4", maxshape=(None, *x.shape), chunks=(1, *x.shape)
            )
            for name in ("x", "v")
        ]
        for k in range(frames):
            for dataset, values in zip(sets, (x, v), strict=True):
                dataset.resize(k + 1, axis=0)
                dataset[k] = values
            if flush:
                file.flush()


def h5py_flush(folder: Path, x: np.ndarray, v: np.ndarray, frames: int) -> None:
    """The same, flushed after every frame."""
    h5py_plain(folder, x, v, frames, flush=True)


def npz_rename(folder: Path, x: np.ndarray, v: np.ndarray, frames: int) -> None:
    """A file per frame, written under another name."""
    for k in range(frames):
        with open(folder / "part", "wb") as file:
            np.savez(file, x=x, v=v)
        os.replace(folder / "part", folder / f"{k:06d}.npz")


WRITERS: dict[str, Callable[..., None]] = {
    "substep journal": journal,
    "substep journal, fsync": journal_fsync,
    "h5py": h5py_plain,
    "h5py, flush per frame": h5py_flush,
    "npz per frame, renamed": npz_rename,
}


def best(action: Callable[[Path], None], prepare: Callable[[Path], None], rounds: int) -> float:
    """Shortest time of an action in a fresh folder [s]."""
    times = []
    for _ in range(rounds):
        folder = Path(tempfile.mkdtemp())
        try:
            prepare(folder)
            start = time.perf_counter()
            action(folder)
            times.append(time.perf_counter() - start)
        finally:
            shutil.rmtree(folder)
    return min(times)


def emit(n: int, peer: str, metric: str, seconds: float, frames: int) -> None:
    """One figure."""
    record = {
        "workload": f"recording {n} particles",
        "peer": peer,
        "metric": metric,
        "value": round(seconds / frames * 1e3, 4),
        "unit": "ms/frame",
        "threads": 1,
        "isa": "any",
    }
    print(json.dumps(record), flush=True)


def measure(n: int, frames: int, rounds: int) -> None:
    """Every writer, then packing and reading."""
    rng = np.random.default_rng(1)
    x, v = rng.random((2, n, 3), dtype=np.float32)

    def nothing(folder: Path) -> None:
        pass

    def record(folder: Path) -> None:
        journal(folder, x, v, frames)

    def pack(folder: Path) -> None:
        pack_here(str(folder / "a.vtkhdf"), None, False)

    def record_and_pack(folder: Path) -> None:
        record(folder)
        pack(folder)

    def read(folder: Path) -> None:
        with substep.Recording(folder / "a.vtkhdf") as recording:
            for _ in recording:
                pass

    for peer, write in WRITERS.items():
        append = functools.partial(write, x=x, v=v, frames=frames)
        emit(n, peer, "append", best(append, nothing, rounds), frames)
    emit(n, "substep", "pack", best(pack, record, rounds), frames)
    emit(n, "substep", "read journal", best(read, record, rounds), frames)
    emit(n, "substep", "read packed", best(read, record_and_pack, rounds), frames)


def main() -> None:
    """Small, middle and large frames."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    rounds = 3 if parser.parse_args().quick else 7
    for n, frames in ((2_000, 200), (20_000, 100), (200_000, 20)):
        measure(n, frames, rounds)


if __name__ == "__main__":
    main()
