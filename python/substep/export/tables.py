"""Recordings as arrays of NumPy and as tables."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..base.replacing import replace_file
from ..errors import InputError
from ..recording import Recording


def write_arrays(recording: Recording, out: Path) -> list[Path]:
    """All frames in one file of NumPy."""
    arrays: dict[str, Any] = {"times": recording.times}
    for name, part in recording.parts.items():
        for field in part.array_names if part.points is None else ["points"]:
            frames = [recording[name].field(field, k) for k in range(len(recording))]
            if part.points is not None:
                arrays[f"{name}/{field}"] = frames[0]
            elif len({frame.shape for frame in frames}) == 1:
                arrays[f"{name}/{field}"] = np.stack(frames)
            else:
                arrays |= {f"{name}/{field}/{k:04d}": frame for k, frame in enumerate(frames)}
        arrays |= {
            f"{name}/mesh/{key}": array
            for key, array in part.constants().items()
            if key != "points"
        }
    replace_file(str(out), lambda file: np.savez_compressed(file, **arrays))
    return [out]


def write_tables(recording: Recording, out: Path) -> list[Path]:
    """A row for each point and frame, a file for each part that moves."""
    names = [n for n, p in recording.parts.items() if p.kind != "grid" and p.points is None]
    if not names:
        raise InputError("out: the recording has grids alone, which no table holds; write .npz")
    written = []
    for name in names:
        path = out if len(names) == 1 else out.with_name(f"{out.stem}-{name}{out.suffix}")

        def write(file: IO[bytes], name: str = name) -> None:
            _write_table(recording, name, file)

        replace_file(str(path), write)
        written.append(path)
    return written


def _write_table(recording: Recording, name: str, file: IO[bytes]) -> None:
    text = io.TextIOWrapper(file, "utf-8", newline="")
    table = csv.writer(text)
    for k, (time, frame) in enumerate(recording):
        columns = frame[name]
        if k == 0:
            table.writerow(["frame", "time", "index", *_headings(columns)])
        count = len(columns["points"])
        rows = [v.reshape(count, math.prod(v.shape[1:])).tolist() for v in columns.values()]
        for index in range(count):
            table.writerow([k, time, index, *(x for column in rows for x in column[index])])
    text.detach()


def _headings(columns: dict[str, Any]) -> list[str]:
    """`x`, `y`, `z` of points; FIELD, or FIELD_0 ... of the numbers of a field."""
    headings: list[str] = []
    for name, values in columns.items():
        name += "_field" * (name in ("frame", "time", "index", "x", "y", "z"))
        numbers = int(np.prod(values.shape[1:]))
        if name == "points":
            headings += list("xyz"[:numbers])
        elif values.ndim == 1:
            headings.append(name)
        else:
            headings += [f"{name}_{k}" for k in range(numbers)]
    return headings
