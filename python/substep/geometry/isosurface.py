"""The surface of a liquid that particles stand for, by pysplashsurf."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_integer, check_real, in_range
from ..errors import InputError

# Of the kernel, as multiples of the radius: its support is twice that, so two spacings. The
# docstring of reconstruct_surface calls its lengths absolute; they are multiples all the same.
SMOOTHING_LENGTH = 2.0
THRESHOLD = 0.6  # of the indicator that is 1 inside and 0 outside
NORMAL_SMOOTHING = 3  # passes over the normals; drops of one particle would lose theirs by many
MOST_CELLS = 2**20  # along an axis: float32 has 24 bits, of which 4 are left within a cell


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


@functools.cache
def import_pysplashsurf() -> Any:
    """Import pysplashsurf, with its thread pool started, or say what to install.

    On several threads it adds up in another order each time, also with its `multi_threading=False`;
    its pool takes the number of threads from the environment when it is first used.
    """
    try:
        import pysplashsurf
    except ImportError:
        raise ImportError(
            'pysplashsurf is missing: pip install "substep[surface]" for surfaces of liquids'
        ) from None
    name = "RAYON_NUM_THREADS"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        pysplashsurf.reconstruct_surface(
            np.zeros((1, 3), np.float32), particle_radius=1.0, smoothing_length=2.0, cube_size=1.0
        )
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
    return pysplashsurf


def liquid_surface(
    positions: ArrayLike, radius: float, *, cell: float = 1.0, smoothing: int = 25
) -> LiquidSurface:
    """Wrap the particles of a liquid in a smooth, closed surface.

    Marching cubes on the level set 0.6 of the particles' smoothed indicator, with the slivers
    removed, then Laplacian smoothing that moves the vertices least where there are few particles,
    so that drops and sheets do not shrink away. The same particles give the same bits, for which
    it runs on one thread (but on those of pysplashsurf's pool if the process used it before).

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
        If an argument is not what it must be, or the particles are spread over more than 2^20
        cells.
    ImportError
        If pysplashsurf is missing.

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
    pysplashsurf = import_pysplashsurf()
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
    mesh, _ = pysplashsurf.reconstruction_pipeline(
        ((points - center) / radius).astype(np.float32),
        particle_radius=1.0,
        smoothing_length=SMOOTHING_LENGTH,
        cube_size=cell,
        iso_surface_threshold=THRESHOLD,
        mesh_cleanup=True,
        mesh_smoothing_iters=smoothing,
        mesh_smoothing_weights=True,
        compute_normals=True,
        normals_smoothing_iters=NORMAL_SMOOTHING,
    )
    with in_range("radius"):
        vertices = np.asarray(mesh.mesh.vertices) * radius + center
    return LiquidSurface(
        vertices,
        np.asarray(mesh.mesh.triangles).astype(np.int64),
        np.asarray(mesh.point_attributes["normals"], np.float32),
    )
