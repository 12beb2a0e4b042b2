"""Trajectories of meshes in the form that MeshGraphNets are trained on."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_name, check_path
from ..base.replacing import replace_bytes
from ..errors import InputError
from ..recording import Recording
from .collection import Run, RunCollection
from .flow_mesh import read_flow
from .training import SPLITS, chosen_part, read_runs

NORMAL, OBSTACLE, HANDLE = 0, 1, 3  # types of nodes, as the paper's code numbers them
STATIC = ("cells", "mesh_pos", "node_type")


def write_meshgraphnets(
    runs: RunCollection,
    out: str | os.PathLike[str],
    *,
    part: str | None = None,
    fractions: Sequence[float] = (0.8, 0.1, 0.1),
) -> Path:
    """Write the runs of a scene of cloth, soft bodies or a flow as a data set of MeshGraphNets.

    The folder gets ``meta.json`` and the folders ``train``, ``valid`` and ``test`` with one
    ``trajectory_RUN.npz`` for each run, whose arrays have the names, types and shapes of the fields
    in ``meta.json``: what a record of the paper's data sets holds, in NumPy's form instead of
    TFRecord, so that TensorFlow is not needed. Runs of one seed are in one of the folders.

    - ``cells``, int32, shape (1, m, 3) or (1, m, 4): triangles or tetrahedra.
    - ``mesh_pos``, float32, shape (1, n, 3): the nodes in the first frame [m].
    - ``node_type``, int32, shape (1, n, 1): 0 normal, 1 obstacle, 3 held in its place.
    - ``world_pos``, float32, shape (frames, n, 3): the nodes in each frame [m].

    Obstacles that are recorded as triangles and never move follow the nodes of cloth.

    Of a `GridFlow` in the plane the nodes are the middles of cells outside of obstacles, two
    triangles between each four of them, and in place of ``world_pos`` there are, as far as they are
    recorded,

    - ``velocity``, float32, shape (frames, n, 2) [m/s],
    - ``pressure``, float32, shape (frames, n, 1) [Pa],
    - ``density``, float32, shape (frames, n, 1), of two fluids.

    Types are then 4 at an `Inflow`, 5 at open sides, 6 at walls and beside obstacles, which the
    scene is built again for; periodic sides are not joined.

    Parameters
    ----------
    runs : RunCollection
        Of a scene. Those that are not done are left out.
    out : path-like
        Folder, made if need be. Files of these names are replaced, and trajectories of an older
        data set in it are removed.
    part : str, optional
        Part of the recordings that is the body or the flow, where there are several.
    fractions : sequence of float
        Parts of the seeds for training, validation and test, or of the runs if all have one seed.
        Each part above 0 gets one at least, in this order, where there are enough; UserWarning
        names those that stay empty.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If an argument is wrong, the recordings have no such part or differ in their fields, the
        obstacles of a flow move, or may be moved by bodies, the scene builds another flow than was
        recorded, or frames are apart by different times.
    OSError
        If a file cannot be written.

    References
    ----------
    .. [1] T. Pfaff, M. Fortunato, A. Sanchez-Gonzalez and P. W. Battaglia, "Learning mesh-based
       simulation with graph networks", ICLR 2021.

    Examples
    --------
    >>> import json, os, tempfile
    >>> import substep
    >>> from substep.sweeps import write_meshgraphnets
    >>> folder = tempfile.TemporaryDirectory()
    >>> small = {"vertices": 6, "duration": 0.1}
    >>> runs = substep.sweep("cloth-hang", small, folder.name, repeats=3, frames=4)
    >>> data = write_meshgraphnets(runs, os.path.join(folder.name, "meshgraphnets"))
    >>> json.loads((data / "meta.json").read_text())["trajectory_length"]
    4
    >>> folder.cleanup()
    """
    folder = Path(check_path(out, "out"))
    done, read, dt, sets = read_runs(
        runs, fractions, lambda recording, run: _read(runs, recording, run, part), "other cells"
    )
    _check_fields(done, read)
    dynamic = [name for name in read[0] if name not in STATIC]
    length = min(len(arrays[dynamic[0]]) for arrays in read)
    read = [arrays | {name: arrays[name][:length] for name in dynamic} for arrays in read]
    written = set()
    for split, chosen in zip(SPLITS, sets, strict=True):
        (folder / split).mkdir(parents=True, exist_ok=True)
        for k in chosen:
            buffer = io.BytesIO()
            np.savez_compressed(buffer, allow_pickle=False, **read[k])
            path = folder / split / f"trajectory_{done[k].index}.npz"
            replace_bytes(path, buffer.getbuffer())
            written.add(path)
    for split in SPLITS:  # once the new ones are there, none of an older data set stay
        for path in set((folder / split).glob("trajectory_*.npz")) - written:
            if path.stem.removeprefix("trajectory_").isdecimal():
                path.unlink()
    meta = {
        "simulator": "substep",
        "dt": dt,
        "trajectory_length": length,
        "field_names": list(read[0]),
        "features": {
            name: {
                "type": "static" if name in STATIC else "dynamic",
                "dtype": array.dtype.name,
                "shape": [len(array), -1, array.shape[2]],
            }
            for name, array in read[0].items()
        },
    }
    replace_bytes(folder / "meta.json", json.dumps(meta, indent=1).encode())
    return folder


def _check_fields(done: list[Run], read: list[dict[str, NDArray[Any]]]) -> None:
    """Refuse runs that do not have the fields of the first one."""
    first = list(read[0])
    for run, arrays in zip(done, read, strict=True):
        if list(arrays) != first:
            own, others = (", ".join(k for k in one if k not in STATIC) for one in (arrays, first))
            raise InputError(
                f"runs: run {run.index} has {own}, but run {done[0].index} has {others}"
            )


def _read(
    runs: RunCollection, recording: Recording, run: int, part: str | None
) -> tuple[dict[str, NDArray[Any]], int]:
    """Arrays of the fields, and the number of corners of a cell."""
    grids = [name for name, one in recording.parts.items() if one.kind == "grid"]
    if part in grids or (part is None and grids and not _moving(recording)):
        name = chosen_part(part, grids, "grids")
        return read_flow(recording, name, runs._simulation(run)), 3
    if part is not None and part not in _moving(recording):
        check_name("part", part, [*grids, *_moving(recording)])
    meshes = {name: one for name, one in recording.parts.items() if one.kind == "mesh"}
    body = chosen_part(part, _moving(recording), "meshes that move")
    solid = meshes[body].tetrahedra is not None
    cells = np.asarray(meshes[body].tetrahedra if solid else meshes[body].triangles)
    x = np.stack([recording[body].points(k) for k in range(len(recording))])
    still = [one for one in meshes.values() if one.points is not None and not solid]
    held = (x == x[0]).all(axis=(0, 2))
    kinds, faces = [np.where(held, HANDLE, NORMAL)], [cells]
    for one in still:
        if one.triangles is None:
            continue
        points = np.asarray(one.points, float)
        faces.append(np.asarray(one.triangles) + x.shape[1])
        kinds.append(np.full(len(points), OBSTACLE))
        x = np.concatenate([x, np.broadcast_to(points, (len(x), *points.shape))], axis=1)
    arrays = {
        "cells": np.concatenate(faces)[None].astype(np.int32),
        "mesh_pos": x[:1].astype(np.float32),
        "node_type": np.concatenate(kinds)[None, :, None].astype(np.int32),
        "world_pos": x.astype(np.float32),
    }
    return arrays, cells.shape[1]


def _moving(recording: Recording) -> list[str]:
    """The parts that are meshes of triangles or tetrahedra, and move."""
    return [
        name
        for name, one in recording.parts.items()
        if one.kind == "mesh"
        and one.points is None
        and (one.triangles is not None or one.tetrahedra is not None)
    ]
