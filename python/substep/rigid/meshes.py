"""Triangle meshes of the shapes of rigid bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_integer
from ..geometry import TriangleMesh


def revolved(radii: ArrayLike, heights: ArrayLike, segments: int) -> TriangleMesh:
    """Turn a profile, from the bottom to the top of the z axis, about that axis.

    Its ends are on the axis, and are one vertex each; any other point is a ring of `segments`.
    """
    n = check_integer("segments", segments, minimum=3)
    r, z = np.asarray(radii, float)[1:-1], np.asarray(heights, float)
    angle = 2 * np.pi * np.arange(n) / n
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = np.zeros((len(r), n, 3))
    rings[..., :2] = r[:, None, None] * around
    rings[..., 2] = z[1:-1, None]
    vertices = np.vstack([[[0, 0, z[0]]], rings.reshape(-1, 3), [[0, 0, z[-1]]]])
    here = 1 + np.arange(len(r) * n).reshape(-1, n)
    next_ = np.roll(here, -1, axis=1)
    bottom = np.stack([np.zeros(n, int), next_[0], here[0]], axis=-1)
    top = np.stack([np.full(n, len(vertices) - 1), here[-1], next_[-1]], axis=-1)
    a, b, c, d = here[:-1], next_[:-1], next_[1:], here[1:]
    sides = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return TriangleMesh(vertices, np.vstack([bottom, *sides, top]))


def capsule_mesh(radius: float, half_length: float, segments: int) -> TriangleMesh:
    """Of a capsule, or of a sphere if it has no length."""
    rings = max(1, check_integer("segments", segments, minimum=3) // 4)  # of half a sphere
    angle = np.linspace(0, np.pi / 2, rings + 1)
    r, z = radius * np.sin(angle), half_length + radius * np.cos(angle)
    r[0] = 0.0
    below = slice(None) if half_length > 0 else slice(None, -1)  # a sphere has one equator
    return revolved(
        np.concatenate([r[below], r[::-1]]), np.concatenate([-z[below], z[::-1]]), segments
    )


def cylinder_mesh(radius: float, half_length: float, segments: int) -> TriangleMesh:
    """Of a cylinder."""
    h = half_length
    return revolved([0, radius, radius, 0], [-h, -h, h, h], segments)


def hull_mesh(points: NDArray[np.float64]) -> TriangleMesh:
    """Of the convex hull of points."""
    vertices, faces = _core.hull_faces(points)
    return TriangleMesh(vertices, faces)
