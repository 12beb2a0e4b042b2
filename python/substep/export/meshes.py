"""Recordings as sequences of files of one frame each, by meshio."""

from __future__ import annotations

import math
import os
import secrets
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.imports import needs
from ..errors import InputError
from ..recording import Part, Recording

_CELLS = {"triangles": "triangle", "edges": "line", "tetrahedra": "tetra"}
_OF = {".obj": ("triangles",), ".ply": ("triangles", "edges")}  # the other suffixes have all


def write_meshes(recording: Recording, out: Path) -> list[Path]:
    """NAME-PART-0000.SUFFIX for each frame and part that moves, NAME-PART for what does not."""
    with needs("meshio", f'meshio is missing: pip install "substep[mesh]" for {out.suffix} files'):
        import meshio

    obj = out.suffix.lower() == ".obj"  # meshio's has triangles, and no fields
    written = []
    for name, part in recording.parts.items():
        if part.kind == "grid" or (obj and part.triangles is None):
            continue
        for k in range(len(recording) if part.points is None else 1):
            columns = recording.frame(k)[name]
            points = columns.pop("points").astype(np.float64)
            points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))  # z = 0
            fields = {} if obj else _plain(columns)
            if out.suffix.lower() == ".ply":  # which has no vectors
                fields = {key: values for key, values in fields.items() if values.ndim == 1}
            mesh = meshio.Mesh(points, _cells(part, len(points), out.suffix.lower()), fields)
            number = f"-{k:04d}" if part.points is None else ""
            path = out.with_name(f"{out.stem}-{name}{number}{out.suffix}")
            if path in written:
                raise InputError(f"out: two parts would be written to {path.name}; rename one")
            partial = path.with_name(f".{secrets.token_hex(8)}{path.suffix}")
            try:
                mesh.write(partial)
                os.replace(partial, path)
            finally:
                partial.unlink(missing_ok=True)
            written.append(path)
    if not written:
        told = "has no triangles" if obj else "has grids alone"
        raise InputError(f"out: the recording {told}, so nothing to write; write .npz")
    return written


def _cells(part: Part, count: int, suffix: str) -> list[tuple[str, NDArray[np.generic]]]:
    number: Any = np.int32 if suffix == ".ply" else np.int64  # the most that it has
    cells: list[tuple[str, NDArray[np.generic]]] = [
        (_CELLS[key], np.asarray(array, number))
        for key, array in part.constants().items()
        if key in _OF.get(suffix, _CELLS)
    ]
    if not cells and suffix == ".vtu":
        cells = [("vertex", np.arange(count)[:, None])]
    return cells


def _plain(columns: dict[str, NDArray[np.generic]]) -> dict[str, NDArray[np.float64]]:
    """Fields with one row of numbers for each point."""
    return {
        name: np.asarray(v, np.float64).reshape(len(v), *[math.prod(v.shape[1:])] * (v.ndim > 1))
        for name, v in columns.items()
    }
