"""Convex parts of a surface, of which bodies that move are made."""

from __future__ import annotations

import importlib.util
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import MOST_INT, check_integer, check_real, in_range
from ..base.child_process import run_program
from ..errors import InputError, SolverError
from . import decomposition_process
from .shapes import ConvexHull
from .triangle_mesh import TriangleMesh, check_mesh

Array = NDArray[np.float64]

_CRUMB = 1e-6  # of the volume of all hulls: thinner ones are left out


def convex_decomposition(
    mesh: TriangleMesh,
    concavity: float = 0.05,
    *,
    max_hulls: int | None = None,
    seed: int = 0,
) -> list[ConvexHull]:
    """Cut a solid into convex parts, approximately (``pip install substep[decomposition]``).

    The hulls hold the whole solid, overlap little, and fill hollows by no more than the concavity.
    A list of shapes is what `RigidBodies.add` makes one body of. The mass is that of the mesh with
    `mass=substep.rigid.mass_properties(mesh)`. CoACD takes seconds to minutes, in a process of its
    own; the same input gives the same hulls.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface of a solid, closed, such as `read_mesh` gives. Where it is not manifold or cuts
        itself, CoACD makes another one of it first, which is coarser. Of an open one take
        `tetrahedralize(mesh).surface()[0]`.
    concavity : float
        How far a hull may be from the solid, in half the longest side of the mesh's bounding box,
        0.01 to 1. The smaller, the more hulls.
    max_hulls : int, optional
        The most hulls, by which concavities may become larger; without bound unless given. What is
        apart in the mesh is not joined: each such part needs one.
    seed : int
        Of CoACD's search.

    Returns
    -------
    list of ConvexHull
        In the frame of the mesh.

    Raises
    ------
    TypeError, InputError
        If an argument is wrong, the mesh is open or flat, or has more parts than `max_hulls`.
    ImportError
        If coacd is missing.
    MemoryError
        If it needs more memory than there is.
    SolverError
        If it fails at this mesh.

    References
    ----------
    X. Wei, M. Liu, Z. Ling, H. Su, "Approximate Convex Decomposition for 3D Meshes with
    Collision-Aware Concavity and Tree Search", ACM Trans. Graph. 41 (2022), 42.

    Examples
    --------
    >>> import substep
    >>> ball = substep.geometry.sphere_mesh(0.5, subdivisions=2)
    >>> hulls = substep.geometry.convex_decomposition(ball)
    >>> len(hulls)
    1
    """
    mesh = check_mesh(mesh).cleaned()
    if not (report := mesh.report()).closed:
        lacks = "; ".join(report.lacks)
        raise InputError(
            f"mesh: expected a closed one, got one with {lacks}; tetrahedralize(mesh).surface()[0] "
            "is closed"
        )
    concavity = check_real("concavity", concavity)
    if not 0.01 <= concavity <= 1:
        raise InputError(f"concavity: expected a number from 0.01 to 1, got {concavity}")
    most = -1  # without bound
    if max_hulls is not None:
        most = check_integer("max_hulls", max_hulls, minimum=1, maximum=MOST_INT)
    seed = check_integer("seed", seed, minimum=0, maximum=2**32 - 1)
    if importlib.util.find_spec("coacd") is None:
        raise ImportError(
            'coacd is missing: pip install "substep[decomposition]" to cut meshes into convex parts'
        )
    x = mesh.vertices
    with in_range("mesh"):
        center = (x.min(axis=0) + x.max(axis=0)) / 2
        half = float(np.abs(x - center).max())
        unit = (x - center) / half
    parts = _decompose(unit, mesh.faces, concavity, most, seed)
    with in_range("mesh"):
        hulls = [ConvexHull(part * half + center) for part in parts if len(part) >= 4]
    hulls = _without_crumbs(hulls)
    if max_hulls is not None and len(hulls) > most:
        raise InputError(
            f"max_hulls: expected at least {len(hulls)}, got {most}; the mesh has "
            f"{report.components} components, and those that are apart are not joined"
        )
    return hulls


def _decompose(
    vertices: Array, faces: NDArray[Any], concavity: float, most: int, seed: int
) -> list[Array]:
    """Points of the hulls of a mesh that fits into a cube of edge 2 about the origin."""
    with (
        tempfile.TemporaryFile() as question,
        tempfile.TemporaryFile() as answer,
        tempfile.TemporaryFile() as errors,
    ):
        np.save(question, vertices)
        np.save(question, faces.astype(np.int32))
        question.seek(0)
        given = [concavity, most, seed]
        code = run_program(
            decomposition_process, given, question=question, answer=answer, errors=errors
        )
        if code != 0:
            errors.seek(0)
            said = errors.read().decode(errors="replace").strip()
            if code == -9 or "memory" in said.lower() or "bad_alloc" in said:
                raise MemoryError("convex_decomposition: out of memory")
            raise SolverError(f"convex_decomposition: coacd failed ({said[-300:] or code})")
        points, counts = (np.load(answer, allow_pickle=False) for _ in range(2))
    return np.split(points, np.cumsum(counts)[:-1])


def _without_crumbs(hulls: list[ConvexHull]) -> list[ConvexHull]:
    """Leave out what is flat."""
    volumes = np.array([_volume(hull) for hull in hulls])
    kept = [h for h, volume in zip(hulls, volumes, strict=True) if volume > _CRUMB * volumes.sum()]
    if not kept:
        raise InputError("mesh: expected one that bounds a solid, and all hulls are flat")
    return kept


def _volume(hull: ConvexHull) -> float:
    try:
        return hull.mesh().volume
    except InputError:  # all of its points are in one plane
        return 0.0
