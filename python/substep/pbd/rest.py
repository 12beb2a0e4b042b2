"""What constraints measure on the rest shape: angles, cotangents, areas, volumes, lengths."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.topology import Array

Indices = NDArray[np.integer[Any]]


def dihedral_angles(x: Array, hinges: Indices) -> Array:
    """Angle of each hinge (a, b, c, d), as in dihedral_bending.h; 0 where there is none."""
    a, b, c, d = (x[hinges[:, k]] for k in range(4))
    e = b - a
    n, m = np.cross(e, c - a), np.cross(d - a, e)
    length = np.linalg.norm(e, axis=1)
    angles: Array = np.arctan2(_dot(e, np.cross(m, n)), length * _dot(n, m))
    return angles


def hinge_areas(x: Array, hinges: Indices) -> tuple[Array, Array]:
    """Areas of the two triangles of each hinge together, and squares of the edge between them."""
    a, b, c, d = (x[hinges[:, k]] for k in range(4))
    e = b - a
    areas = 0.5 * (_size(np.cross(e, c - a)) + _size(np.cross(e, d - a)))
    return areas, _dot(e, e)


def isometric_weights(x: Array, hinges: Indices) -> Array:
    """k_b, k_c, k_d and L_0 of isometric_bending.h, shape (m, 4); 0 for triangles without area."""
    a, b, c, d = (x[hinges[:, k]] for k in range(4))
    cotangents, flat = [], np.zeros(len(hinges), bool)
    for corner, far, other in ((a, b, c), (a, b, d), (b, a, c), (b, a, d)):
        u, v = far - corner, other - corner
        twice = _size(np.cross(u, v))
        none = twice <= 1e-14 * _size(u) * _size(v)
        flat |= none
        cotangents.append(_dot(u, v) / np.where(none, 1, twice))
    at_a_c, at_a_d, at_b_c, at_b_d = cotangents
    areas, _ = hinge_areas(x, hinges)
    scale = np.where(flat, 0, np.sqrt(1 / np.where(flat, 1, areas)))
    k = scale[:, None] * np.stack([at_a_c + at_a_d, -at_a_c - at_b_c, -at_a_d - at_b_d], axis=1)
    bent = np.einsum("mk,mkj->mj", k, np.stack([b - a, c - a, d - a], axis=1))
    size = _size(bent)
    # What rounding leaves of a flat hinge is no bend.
    least = 1e-12 * np.abs(k).sum(axis=1) * np.sqrt(np.where(flat, 0, areas))
    return np.column_stack([k, np.where(size > least, size, 0)])


def triangle_areas(x: Array, triangles: Indices) -> Array:
    """Area of each triangle."""
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return 0.5 * _size(np.cross(b - a, c - a))


def tetrahedron_volumes(x: Array, tetrahedra: Indices) -> Array:
    """Volume of each tetrahedron, negative where it is inverted."""
    a, b, c, d = (x[tetrahedra[:, k]] for k in range(4))
    return _dot(np.cross(b - a, c - a), d - a) / 6


def inverse_edges(x: Array, tetrahedra: Indices) -> Array:
    """D_m^-1 of each tetrahedron, row by row, shape (m, 9); 0 for those without volume."""
    corners = x[tetrahedra]
    rows = corners[:, 1:] - corners[:, :1]
    six_volumes = 6 * tetrahedron_volumes(x, tetrahedra)
    flat = np.abs(six_volumes) <= 1e-14 * _size(rows).prod(axis=1)
    rows[flat] = np.eye(3)
    inverse = np.linalg.inv(np.swapaxes(rows, 1, 2))
    inverse[flat] = 0
    return np.asarray(inverse, np.float64).reshape(-1, 9)


def path_lengths(x: Array, edges: Indices, sources: Indices) -> tuple[Array, Indices]:
    """Length of the shortest way along edges to a source, and which; infinite where none leads.

    Dijkstra's algorithm from all sources at once.
    """
    count = len(x)
    ends = np.concatenate([edges, edges[:, ::-1]])
    order = np.argsort(ends[:, 0], kind="stable")
    start = np.searchsorted(ends[order, 0], np.arange(count + 1)).tolist()
    to = ends[order, 1].tolist()
    length = _size(x[ends[order, 0]] - x[ends[order, 1]]).tolist()
    distance, source = [np.inf] * count, [-1] * count
    heap = [(0.0, s, s) for s in sorted(set(sources.tolist()))]
    while heap:
        reached, vertex, origin = heapq.heappop(heap)
        if source[vertex] >= 0:
            continue
        distance[vertex], source[vertex] = reached, origin
        for k in range(start[vertex], start[vertex + 1]):
            if source[to[k]] < 0:
                heapq.heappush(heap, (reached + length[k], to[k], origin))
    return np.array(distance), np.array(source)


def _dot(a: Array, b: Array) -> Array:
    products: Array = np.einsum("...i,...i->...", a, b)
    return products


def _size(a: Array) -> Array:
    return np.sqrt(_dot(a, a))
