"""Light on the surface of a heap of particles: each is lit as the heap is where it lies.

A ball of its own shading says nothing about the shape that thousands of them make. The density of
the particles on a coarse grid does: its gradient points into the heap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

CELL = 3.0  # of the grid, in radii of a particle
BLURS = 2  # of the density, by (1, 2, 1) / 4 along each axis
_MOST_CELLS = 2**25


def heap_normals(points: Array, radius: float) -> tuple[Array, Array]:
    """Outward normals of a heap where its particles are, and how much of a surface there is.

    Parameters
    ----------
    points : ndarray of float32, shape (n, 3)
        Of the particles [m].
    radius : float
        Of a particle [m], above 0.

    Returns
    -------
    normals : ndarray of float32, shape (n, 3)
        Unit vectors, or 0 where the density is the same all around.
    weight : ndarray of float32, shape (n,)
        0 inside the heap and for lone particles, towards 1 at its surface.
    """
    low, size = points.min(axis=0), np.ptp(points, axis=0).astype(float)
    cell = CELL * radius
    while np.prod(size / cell + 5) > _MOST_CELLS:  # thrown apart
        cell *= 1.3
    counts = (size / cell).astype(int) + 5
    at = (points - low) / np.float32(cell) + np.float32(2)
    corner = at.astype(np.int32)
    rows = np.ravel_multi_index(corner.T, counts)
    density = np.bincount(rows, minlength=int(np.prod(counts))).reshape(counts).astype(np.float32)
    for _ in range(BLURS):
        for axis in range(3):
            density += 0.5 * (np.roll(density, 1, axis) + np.roll(density, -1, axis))
            density *= 0.5
    slopes = [-_sampled(np.asarray(slope), at - np.float32(0.5)) for slope in np.gradient(density)]
    gradient = np.stack(slopes, axis=1)
    length = np.linalg.norm(gradient, axis=1)
    full = max(float(np.quantile(length, 0.9)), 1e-30)
    normals = gradient / np.maximum(length, np.float32(1e-30))[:, None]
    return normals, np.minimum(length / np.float32(0.5 * full), np.float32(1))


def heap_light(
    points: Array, radius: float, lights: list[tuple[NDArray[np.float64], float]]
) -> Array:
    """How bright the heap is where its particles are, 1 where light falls on it squarely.

    Parameters
    ----------
    points, radius
        As of `heap_normals`.
    lights : list of (ndarray, float)
        Directions towards the lights, and how strong they are.

    Returns
    -------
    ndarray of float32, shape (n,)
        About 0.4 to 1.2.
    """
    if len(points) == 0:
        return np.zeros(0, np.float32)
    normals, weight = heap_normals(points, radius)
    total = np.float32(sum(strength for _, strength in lights))
    bright = np.zeros(len(points), np.float32)
    for direction, strength in lights:
        towards = (direction / np.linalg.norm(direction)).astype(np.float32)
        bright += np.float32(strength) * np.maximum(normals @ towards, np.float32(0))
    # Lone particles, and those inside that show through, have the light of no surface.
    lit = 0.38 + 1.1 * bright / total
    result: Array = (weight * lit + (1 - weight) * np.float32(0.8)).astype(np.float32)
    return result


def _sampled(values: Array, at: Array) -> Array:
    """Of an array at its nodes, linear between them."""
    flat, strides = values.ravel(), np.array(values.strides) // values.itemsize
    base = np.clip(at.astype(np.int32), 0, np.array(values.shape) - 2)
    part = at - base
    start = base @ strides
    total = np.zeros(len(at), np.float32)
    for k in range(8):
        bits = np.array([k >> 2, k >> 1, k]) & 1
        share = np.prod(np.where(bits, part, 1 - part), axis=1)
        total += share * flat[start + int(bits @ strides)]
    return total
