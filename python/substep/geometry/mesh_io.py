"""Reading meshes: Wavefront .obj here, every other format by meshio (the extra `mesh`)."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_path
from ..base.child_process import run_program
from ..errors import FormatError, SubstepError
from . import meshio_process
from .tet_mesh import TetMesh
from .triangle_mesh import TriangleMesh

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

_MOST = 2**53  # of what is numbered
# What meshio may take for a file: bytes of memory, and seconds of processor time.
_MEMORY, _MEMORY_PER_BYTE = 1 << 30, 64
_SECONDS, _BYTES_PER_SECOND = 5, 100_000


def read_mesh(path: str | os.PathLike[str]) -> TriangleMesh | TetMesh:
    r"""Read a mesh file.

    Wavefront .obj needs nothing else; .ply, .stl, .off, .msh (Gmsh), .vtk, .vtu, .mesh and the
    other formats of meshio need ``pip install substep[mesh]``; it runs in a process of its own.
    Polygons are cut into triangles as fans from their first corner. Texture coordinates and normals
    are left out, so that vertices are not split at their seams; the separate triangles of .stl are
    joined where their corners agree exactly. Faces with a corner twice are left out and counted
    (`TriangleMesh.dropped`).

    Parameters
    ----------
    path : path-like
        The file; its suffix determines the format.

    Returns
    -------
    TriangleMesh or TetMesh
        Tetrahedra, if the file has any; else its triangles and polygons.

    Raises
    ------
    FormatError
        If the file is not what its suffix says, has neither triangles nor tetrahedra, or meshio
        needs more for it than 1 GiB and 64 times its size of memory, or 5 s and 1 s per 100 kB.
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
    file = Path(check_path(path))
    if file.exists() and not file.is_file():  # to open a pipe would wait for ever
        raise FormatError(f"{path}: expected a file, got a folder, a pipe or a device")
    read = _read_obj if file.suffix.lower() == ".obj" else _read_with_meshio
    vertices, sizes, corners, tetrahedra = read(file)
    try:
        if len(tetrahedra):
            return TetMesh(vertices, tetrahedra)
        return _triangles(vertices, sizes, corners)
    except (SubstepError, TypeError) as error:
        raise FormatError(f"{path}: {error}") from None


class _Read(NamedTuple):
    """Vertices, the number of corners of each polygon, the corners of all, and tetrahedra."""

    vertices: Array
    sizes: Ids
    corners: Ids
    tetrahedra: Ids


def _triangles(vertices: Array, sizes: Ids, corners: Ids) -> TriangleMesh:
    """Fans of the polygons, without those that have a corner twice."""
    fans = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, fans)
    turn = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    faces = corners[np.stack([first, first + turn + 1, first + turn + 2], axis=1)]
    a, b, c = faces.T
    kept = (a != b) & (b != c) & (c != a)
    if not kept.any():
        raise FormatError("no triangles and no tetrahedra")
    mesh = TriangleMesh(vertices, faces[kept])
    mesh._set(dropped=int(len(faces) - kept.sum()))
    return mesh


def _read_obj(path: Path) -> _Read:
    """Lines `v x y z` and `f v/vt/vn ...`, numbered from 1, or from the end where negative."""
    points: list[list[float]] = []
    sizes: list[int] = []
    corners: list[int] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            try:
                if line.startswith("v "):
                    x, y, z = map(float, line.split()[1:4])
                    points.append([x, y, z])
                elif line.startswith("f "):
                    polygon = [int(word.split("/", 1)[0]) for word in line.split()[1:]]
                    if len(polygon) < 3 or 0 in polygon or max(map(abs, polygon)) > _MOST:
                        raise ValueError
                    sizes.append(len(polygon))
                    corners.extend(i - 1 if i > 0 else len(points) + i for i in polygon)
            except ValueError:
                raise FormatError(f"{path}:{number}: cannot read {line[:60].strip()!r}") from None
    vertices = np.array(points, np.float64).reshape(-1, 3)
    wrong = next((i + 1 for i in corners if not 0 <= i < len(points)), None)
    if wrong is not None:
        raise FormatError(f"{path}: a face names vertex {wrong}, and there are {len(points)}")
    none = np.empty((0, 4), np.int64)
    return _Read(vertices, np.array(sizes, np.int64), np.array(corners, np.int64), none)


def _read_with_meshio(path: Path) -> _Read:
    """What meshio makes of the file, in a process of its own: it believes what a file declares."""
    with path.open("rb") as file:  # a missing file is an OSError
        size = os.fstat(file.fileno()).st_size
        if path.suffix.lower() == ".ply" and b"end_header" not in file.read(2**20):
            raise FormatError(f"{path}: the header of a .ply file ends with end_header")
    if importlib.util.find_spec("meshio") is None:
        raise ModuleNotFoundError(
            f"{path}: reading {path.suffix} files needs meshio: pip install substep[mesh]"
        )
    memory, seconds = _MEMORY + _MEMORY_PER_BYTE * size, _SECONDS + size // _BYTES_PER_SECOND
    limits = f"{memory} bytes of memory and {seconds} s of processor time"
    with tempfile.TemporaryFile() as answer:
        code = run_program(meshio_process, [os.path.abspath(path), memory, seconds], answer=answer)
        if code == meshio_process.REFUSED:
            reason = answer.read(1000).decode(errors="replace")
            raise FormatError(f"{path}: meshio cannot read it ({reason})")
        if code != 0:
            raise FormatError(f"{path}: meshio failed with {limits} (exit code {code})")
        return _Read(*(np.load(answer, allow_pickle=False) for _ in range(4)))
