"""Unit quaternions (w, x, y, z), row by row."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .checks import check_array, first_bad_index

Array = NDArray[np.float64]

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def unit_quaternions(name: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Quaternions as new unit rows; those of length 1 within rounding keep their bits."""
    q = check_array(name, value, shape)
    largest = np.abs(q).max(axis=-1, keepdims=True, initial=0.0)
    if not largest.all():
        where = first_bad_index(largest[..., 0] == 0) if q.ndim > 1 else ""
        raise InputError(f"{name}{where}: expected a quaternion that is not 0")
    scaled = q / largest
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    with np.errstate(over="ignore"):
        off = np.abs(largest * length - 1) > 4e-16
    unit: Array = np.where(off, scaled / length, q)
    return unit


def multiply(p: Array, q: Array) -> Array:
    """The products p q of quaternions (w, x, y, z), row by row; first q turns, then p."""
    w, x, y, z = np.moveaxis(p, -1, 0)
    a, b, c, d = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=-1,
    )


def rotate(q: Array, v: Array) -> Array:
    """Vectors turned by unit quaternions, row by row: v + w t + u x t with t = 2 u x v."""
    u = q[..., 1:]
    t = 2 * np.cross(u, v)
    turned: Array = v + q[..., :1] * t + np.cross(u, t)
    return turned
