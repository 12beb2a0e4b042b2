"""Blender, as the module bpy, in a process of its own: what it prints or breaks stays there."""

from __future__ import annotations

import importlib.util
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..base.child_process import run_program
from ..errors import InputError, SolverError
from ..recording import Recording
from ..view.surfaces import in_space
from . import blender_process
from .usd import prim_names, widths_of, write_usd

MISSING = (
    'bpy is missing: pip install "substep[blender]" in Python 3.11, the one that Blender 5.0 is for'
)


def check_blender() -> None:
    """Refuse to begin where there is no Blender."""
    if importlib.util.find_spec("bpy") is None:
        raise ImportError(MISSING, name="bpy")


def run_blender(task: dict[str, Any]) -> None:
    """Do a task of `blender_process`."""
    check_blender()
    with (
        tempfile.TemporaryDirectory() as folder,
        tempfile.TemporaryFile() as answer,
        tempfile.TemporaryFile() as errors,
    ):
        path = Path(folder) / "task.json"
        path.write_text(json.dumps(task), encoding="utf-8")
        code = run_program(blender_process, [path], answer=answer, errors=errors)
        if code != 0:
            errors.seek(0)
            said = errors.read().decode(errors="replace").strip()
            if code == -9:  # killed by the system
                raise MemoryError("Blender: out of memory")
            raise SolverError(f"Blender failed ({said.rpartition('failed: ')[2][:300]})")


def write_alembic(
    recording: Recording, out: Path, liquids: dict[str, float] | None = None
) -> list[Path]:
    """What the USD holds, by Blender's exporter of Alembic."""
    check_blender()
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        [usd] = write_usd(recording, Path(folder) / "stage.usdc", liquids)
        names = prim_names(recording)
        rate = 1 / float(np.diff(recording.times).mean()) if len(recording) > 1 else 24.0
        partial = Path(folder) / "stage.abc"
        task = {
            "do": "alembic",
            "usd": str(usd),
            "out": str(partial),
            "rate": rate,
            "widths": {names[part]: w for part, w in widths_of(recording).items()},
        }
        run_blender(task)
        if not partial.exists():
            raise OSError(f"{out}: Blender wrote no Alembic file")
        os.replace(partial, out)
    return [out]


def write_volumes(recording: Recording, out: Path, frames: list[int] | None = None) -> list[Path]:
    """NAME-PART-0000.vdb for each frame and grid: fields of one number, or of a vector."""
    check_blender()
    grids = {name: part for name, part in recording.parts.items() if len(part.cells) == 3}
    if not grids:
        raise InputError("out: the recording has no grids in three dimensions; write .usdc")
    files, written = [], []
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        for name, part in grids.items():
            origin = in_space(np.asarray(part.bounds))[0] + 0.5 * float(part.cell or 1)
            for k in range(len(recording)) if frames is None else frames:
                arrays = {
                    field: np.asarray(values, np.float32)
                    for field, values in recording.frame(k)[name].items()
                    if values.ndim == 3 or values.shape[3:] == (3,)
                }
                path = out.with_name(f"{out.stem}-{name}-{k:04d}{out.suffix}")
                held = Path(folder) / f"{name}-{k}.npz"
                np.savez(held, **arrays)  # type: ignore[arg-type]
                files.append(
                    {
                        "arrays": str(held),
                        "out": str(Path(folder) / path.name),
                        "cell": part.cell,
                        "origin": origin.tolist(),
                    }
                )
                written.append(path)
        run_blender({"do": "volumes", "files": files})
        for path in written:
            os.replace(Path(folder) / path.name, path)
    return written
