"""Which tetrahedron holds a point."""

from __future__ import annotations

import numpy as np

from .topology import Array, Indices


def barycentric(vertices: Array, tetrahedra: Indices, points: Array) -> Array:
    """Barycentric coordinates of each point in a tetrahedron of its own, shape (n, 4)."""
    x = vertices[tetrahedra]
    edges = np.swapaxes(x[:, 1:] - x[:, :1], 1, 2)
    last = np.linalg.solve(edges, (points - x[:, 0])[..., None])[..., 0]
    return np.concatenate([1 - last.sum(axis=1, keepdims=True), last], axis=1)


def locate(vertices: Array, tetrahedra: Indices, points: Array) -> Indices:
    """Number of the tetrahedron that holds each point, -1 outside; on borders the lowest.

    The tetrahedra are listed under the boxes of a regular grid that they reach into.
    """
    corners = vertices[tetrahedra]
    low, high = corners.min(axis=1), corners.max(axis=1)
    origin, size = low.min(axis=0), (high - low).mean(axis=0)
    count = np.ceil((high.max(axis=0) - origin) / size).astype(np.int64) + 1

    def box(x: Array) -> Indices:
        index: Indices = np.floor((x - origin) / size).astype(np.int64)
        return index

    first, reach = box(low), box(high) - box(low) + 1
    entries = reach.prod(axis=1)
    tet = np.repeat(np.arange(len(entries)), entries)
    within = np.arange(len(tet)) - np.repeat(np.cumsum(entries) - entries, entries)
    shape = reach[tet]
    offset = np.stack(
        [
            within // (shape[:, 1] * shape[:, 2]),
            within // shape[:, 2] % shape[:, 1],
            within % shape[:, 2],
        ],
        axis=1,
    )
    keys = _key(first[tet] + offset, count)
    order = np.argsort(keys, kind="stable")
    keys, tet = keys[order], tet[order]

    found = np.full(len(points), -1, np.int64)
    inside = np.flatnonzero(((points >= origin) & (points <= high.max(axis=0))).all(axis=1))
    wanted = _key(box(points[inside]), count)
    start, stop = np.searchsorted(keys, wanted, "left"), np.searchsorted(keys, wanted, "right")
    for step in range(int((stop - start).max(initial=0))):
        open_ = (found[inside] < 0) & (start + step < stop)
        rows, candidates = inside[open_], tet[start[open_] + step]
        hit = barycentric(vertices, tetrahedra[candidates], points[rows]).min(axis=1) >= -1e-12
        found[rows[hit]] = candidates[hit]
    return found


def _key(index: Indices, count: Indices) -> Indices:
    key: Indices = (index[:, 0] * count[1] + index[:, 1]) * count[2] + index[:, 2]
    return key
