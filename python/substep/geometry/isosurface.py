"""The surface of a liquid made of particles, by pysplashsurf."""

from __future__ import annotations

import importlib.util
import tempfile
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_integer, check_real, in_range
from ..base.child_process import run_program
from ..errors import InputError, SolverError
from . import surface_process

MOST_CELLS = 2**20  # along an axis: float32 has 24 bits, of which 4 are left within a cell
# Of the cell, one after the other until a surface is made. At a few lattices of some particles
# pysplashsurf panics; its lattice begins at the particles, so that other cubes shift it.
FINENESS = (1.0, 0.98, 0.95, 0.9)


@dataclass(frozen=True)
class LiquidSurface:
    """Triangles around a liquid, as `liquid_surface` returns them.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Positions [m].
    faces : ndarray of int64, shape (m, 3)
        Vertices of the triangles, counter-clockwise seen from outside.
    normals : ndarray of float32, shape (n, 3)
        Unit normals at the vertices, outwards.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float32]


def liquid_surface(
    positions: ArrayLike, radius: float, *, cell: float = 1.0, smoothing: int = 25
) -> LiquidSurface:
    """Wrap the particles of a liquid in a smooth, closed surface.

    Marching cubes on the level set 0.6 of the particles' smoothed indicator, with the slivers
    removed, then Laplacian smoothing that moves the vertices least where there are few particles,
    so that drops and sheets do not shrink away. It runs in a process of its own, on one thread: the
    same particles give the same bits. Where it fails, it is made again with cubes up to a tenth
    smaller, which lie elsewhere.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        Of the particles [m].
    radius : float
        Half the distance between neighbours at rest [m].
    cell : float
        Edge of the cubes over the radius, from 0.1 to 4. Time and triangles grow as 1/cell^2 to
        1/cell^3.
    smoothing : int
        Passes of the smoothing; 0 leaves the marching cubes as they are.

    Returns
    -------
    LiquidSurface
        Vertices, faces and normals; without particles there are none.

    Raises
    ------
    InputError
        If an argument is wrong, or the particles are spread over more than 2^20
        cells.
    ImportError
        If pysplashsurf is missing.
    MemoryError
        If it needs more memory than there is.
    SolverError
        If it fails at these particles with all these cubes.

    References
    ----------
    F. Löschner, T. Böttcher, S. R. Jeske, J. Bender, "Weighted Laplacian Smoothing for Surface
    Reconstruction of Particle-based Fluids", VMV 2023; D. Moore, J. Warren, "Compact Isocontours
    from Sampled Data", Graphics Gems III, 1992.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> grid = np.stack(np.meshgrid(*3 * [np.arange(12.0)]), axis=-1).reshape(-1, 3)
    >>> ball = grid[np.linalg.norm(grid - 5.5, axis=1) < 5.5]
    >>> surface = substep.liquid_surface(ball, 0.5)
    >>> mesh = substep.geometry.TriangleMesh(surface.vertices, surface.faces)
    >>> mesh.report().closed
    True
    """
    points = check_array("positions", positions, (None, 3))
    radius = check_real("radius", radius, positive=True)
    cell = check_real("cell", cell)
    if not 0.1 <= cell <= 4:
        raise InputError(f"cell: expected a number from 0.1 to 4, got {cell}")
    smoothing = check_integer("smoothing", smoothing, minimum=0, maximum=10_000)
    if importlib.util.find_spec("pysplashsurf") is None:
        raise ImportError(
            'pysplashsurf is missing: pip install "substep[surface]" for surfaces of liquids'
        )
    if not len(points):
        return LiquidSurface(
            np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.float32)
        )
    with in_range("positions"):
        center = (points.min(axis=0) + points.max(axis=0)) / 2
    extent = float(np.abs(points - center).max())
    if not extent <= 0.5 * MOST_CELLS * cell * radius:
        raise InputError(
            f"positions: spread over {2 * extent:.3g} m, which is more than {MOST_CELLS} cells of "
            f"{cell * radius:.3g} m"
        )
    # In units of the radius about the middle, where float32 is as fine as it can be.
    shifted = ((points - center) / radius).astype(np.float32)
    for fineness in FINENESS:
        try:
            vertices, faces, normals = _reconstruct(shifted, fineness * cell, smoothing)
            break
        except SolverError:
            if fineness == FINENESS[-1]:
                raise
    with in_range("radius"):
        return LiquidSurface(vertices * radius + center, faces, normals)


def _reconstruct(points: NDArray[np.float32], cell: float, smoothing: int) -> list[NDArray[Any]]:
    """Vertices, triangles and normals of particles of radius 1."""
    with (
        tempfile.TemporaryFile() as question,
        tempfile.TemporaryFile() as answer,
        tempfile.TemporaryFile() as errors,
    ):
        np.save(question, points)
        question.seek(0)
        code = run_program(
            surface_process, [cell, smoothing], question=question, answer=answer, errors=errors
        )
        if code != 0:
            errors.seek(0)
            said = errors.read().decode(errors="replace").strip()
            if code == -9 or "memory" in said.lower():  # killed by the system
                raise MemoryError("liquid_surface: out of memory")
            raise SolverError(f"liquid_surface: pysplashsurf failed ({said[-300:]})")
        return [np.load(answer, allow_pickle=False) for _ in range(3)]
