"""Unit quaternions (w, x, y, z), row by row."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .checks import check_array, first_bad_index

Array = NDArray[np.float64]

IDENTITY = (1.0, 0.0, 0.0, 0.0)
_FEW = 16


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
    return _by_rows(_product, p, q)


def rotate(q: Array, v: Array) -> Array:
    """Vectors turned by unit quaternions, row by row: v + w t + u x t with t = 2 u x v."""
    return _by_rows(_turned, q, v)


def cross(u: Array, v: Array) -> Array:
    """The products u x v, row by row."""
    return _by_rows(_cross, u, v)


def _by_rows(formula: Callable[[Any, Any], list[Any]], p: Array, q: Array) -> Array:
    """The formula of components, which are floats where there are few rows.

    The bits are the same, and arrays of that size take as long as dozens of rows.
    """
    if p.ndim == q.ndim == 1:
        return np.array(formula(p.tolist(), q.tolist()))
    if p.ndim == q.ndim == 2 and 0 < len(p) == len(q) <= _FEW:
        return np.array([formula(*row) for row in zip(p.tolist(), q.tolist(), strict=True)])
    return np.stack(formula(np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)), axis=-1)


def _product(p: Any, q: Any) -> list[Any]:
    w, x, y, z = p
    a, b, c, d = q
    return [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]


def _turned(q: Any, v: Any) -> list[Any]:
    w, *u = q
    t = [2 * c for c in _cross(u, v)]
    return [x + w * s + c for x, s, c in zip(v, t, _cross(u, t), strict=True)]


def _cross(u: Any, v: Any) -> list[Any]:
    x, y, z = u
    a, b, c = v
    return [y * c - z * b, z * a - x * c, x * b - y * a]
