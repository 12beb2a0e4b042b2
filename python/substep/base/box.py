"""Boxes of cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .checks import check_array

_MOST_CELLS = 2**31 - 1


def check_box(bounds: ArrayLike, cell: float) -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Corners of a box, and the whole cells along its axes."""
    corners = check_array("bounds", bounds)
    if corners.shape not in ((2, 2), (2, 3)):
        raise InputError(f"bounds: expected shape (2, 3) or (2, 2), got {corners.shape}")
    if not (np.abs(corners) < 1e15 * cell).all():
        raise InputError(f"bounds: expected less than 1e15 cells of {cell:g} m from 0")
    sides = corners[1] - corners[0]
    if not (sides > 0).all():
        raise InputError("bounds: expected the lowest corner, then the highest")
    counts = sides / cell
    cells = np.rint(counts)
    wrong = (np.abs(counts - cells) > 1e-6 * counts) | (cells < 1)
    if wrong.any():
        a = int(np.argmax(wrong))
        raise InputError(
            f"bounds: expected a whole number of cells of {cell:g} m along each axis, got "
            f"{counts[a]:.6g} along axis {a}"
        )
    if float(np.prod(cells)) > _MOST_CELLS:
        raise InputError(f"bounds: expected at most {_MOST_CELLS} cells, got {np.prod(cells):.3g}")
    return corners, tuple(int(n) for n in cells)
