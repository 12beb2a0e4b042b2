"""Surfaces as graphics want them: normals, and sharp edges that stay sharp."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

CREASE = 50.0  # degrees between two faces, from which on the edge between them is sharp


def in_space(points: NDArray[Any]) -> NDArray[np.float32]:
    """Points of a plane get z = 0; float32, as graphics have it."""
    result = np.zeros((len(points), 3), np.float32)
    result[:, : points.shape[1]] = points
    return result


def magnitude(values: NDArray[Any]) -> NDArray[np.float64]:
    """A number for each row: of vectors and matrices the norm."""
    flat = np.asarray(values, float).reshape(len(values), math.prod(values.shape[1:]))
    return flat[:, 0] if flat.shape[1] == 1 else np.linalg.norm(flat, axis=1)


def vertex_normals(points: NDArray[Any], faces: NDArray[np.int64]) -> NDArray[np.float32]:
    """Unit normals at the vertices: those of the faces around, weighted by area; 0 for none."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    of_faces = np.cross(b - a, c - a)
    normals = np.zeros((len(points), 3))
    for axis in range(3):
        for k in range(3):
            normals[:, axis] += np.bincount(faces[:, k], of_faces[:, axis], len(points))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return (normals / np.where(length > 0, length, 1)).astype(np.float32)


def split_at_creases(
    points: NDArray[Any], faces: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertices doubled along sharp edges, so that no normal is shared across one.

    Returns the old number of each new vertex, and the faces by new numbers; vertices without a face
    are left out.
    """
    from pyvista import PolyData

    used, local = np.unique(faces, return_inverse=True)
    data = PolyData.from_regular_faces(points[used], local.reshape(-1, 3))
    data.point_data["number"] = used
    split = data.compute_normals(
        cell_normals=False,
        split_vertices=True,
        feature_angle=CREASE,
        consistent_normals=False,
        non_manifold_traversal=False,
    )
    return np.asarray(split.point_data["number"]), split.regular_faces.astype(np.int64)
