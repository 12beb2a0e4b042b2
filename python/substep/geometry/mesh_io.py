"""Reading meshes: Wavefront .obj here, every other format by meshio (the extra `mesh`)."""

from __future__ import annotations

import os
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, SubstepError
from .tet_mesh import TetMesh
from .triangle_mesh import TriangleMesh


def read_mesh(path: str | os.PathLike[str]) -> TriangleMesh | TetMesh:
    r"""Read a mesh file.

    Wavefront .obj needs nothing else; .ply, .stl, .off, .msh (Gmsh), .vtk, .vtu, .mesh and the
    other formats of meshio need ``pip install substep[mesh]``. Polygons are cut into triangles as
    fans from their first corner. Texture coordinates and normals are left out, so that vertices are
    not split at their seams; the separate triangles of .stl are joined where their corners agree
    exactly. Faces with a corner twice are left out and counted (`TriangleMesh.dropped`).

    Parameters
    ----------
    path : path-like
        The file; its suffix tells the format.

    Returns
    -------
    TriangleMesh or TetMesh
        Tetrahedra, if the file has any; else its triangles and polygons.

    Raises
    ------
    FormatError
        If the file is not what its suffix says, or has neither triangles nor tetrahedra.
    ModuleNotFoundError
        If the format needs meshio and it is not installed.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import pathlib, substep
    >>> lines = ["v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "f 1/1 2/2 3/3 4/4"]
    >>> _ = pathlib.Path("square.obj").write_text("\n".join(lines))
    >>> mesh = substep.geometry.read_mesh("square.obj")
    >>> assert isinstance(mesh, substep.geometry.TriangleMesh)  # no tetrahedra in it
    >>> mesh.faces.tolist()
    [[0, 1, 2], [0, 2, 3]]
    """
    file = Path(path)
    if file.suffix.lower() == ".obj":
        return _read_obj(file)
    with file.open("rb"):  # a missing file is an OSError, whatever meshio makes of it
        pass
    return _read_with_meshio(file)


def _triangles(path: Path, points: Any, polygons: list[list[int]]) -> TriangleMesh:
    """Fans of the polygons, without those that have a corner twice."""
    faces, dropped = [], 0
    for polygon in polygons:
        for b, c in pairwise(polygon[1:]):
            if polygon[0] != b != c != polygon[0]:
                faces.append((polygon[0], b, c))
            else:
                dropped += 1
    if not faces:
        raise FormatError(f"{path}: no triangles and no tetrahedra")
    try:
        mesh = TriangleMesh(points, faces)
    except SubstepError as error:
        raise FormatError(f"{path}: {error}") from None
    mesh._set(dropped=dropped)
    return mesh


def _read_obj(path: Path) -> TriangleMesh:
    """Lines `v x y z` and `f v/vt/vn ...`, numbered from 1, or from the end where negative."""
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            words = line.split()
            try:
                if line.startswith("v "):
                    x, y, z = map(float, words[1:4])
                    points.append([x, y, z])
                elif line.startswith("f "):
                    polygon = [int(word.split("/", 1)[0]) for word in words[1:]]
                    if len(polygon) < 3 or 0 in polygon:
                        raise ValueError
                    polygons.append([i - 1 if i > 0 else len(points) + i for i in polygon])
            except ValueError:
                raise FormatError(f"{path}:{number}: cannot read {line[:60].strip()!r}") from None
    return _triangles(path, np.array(points).reshape(-1, 3), polygons)


def _read_with_meshio(path: Path) -> TriangleMesh | TetMesh:
    try:
        import meshio
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            f"{path}: reading {path.suffix} files needs meshio: pip install substep[mesh]"
        ) from None
    if path.suffix.lower() == ".ply":
        with path.open("rb") as file:
            if b"end_header" not in file.read(2**20):  # meshio would look for it for ever
                raise FormatError(f"{path}: the header of a .ply file ends with end_header")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # overflows while it tries what a file may be
            data = meshio.read(path)
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
        raise FormatError(f"{path}: meshio cannot read it ({reason})") from error
    points = np.asarray(data.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise FormatError(f"{path}: expected points of 3 coordinates, got shape {points.shape}")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    tets = [block.data for block in data.cells if block.type == "tetra"]
    if tets:
        try:
            return TetMesh(points, np.concatenate(tets))
        except SubstepError as error:
            raise FormatError(f"{path}: {error}") from None
    polygons = [
        [int(i) for i in polygon]
        for block in data.cells
        if block.type in ("triangle", "quad", "polygon")
        for polygon in block.data
    ]
    return _triangles(path, points, polygons)
