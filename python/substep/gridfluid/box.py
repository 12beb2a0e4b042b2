"""The box of a grid: its cells, its sides, and numbers between them."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_choice, describe
from ..errors import InputError

Array = NDArray[np.float64]

SIDES = ("wall", "open", "periodic")
_BYTES = 100  # of a cell with float32, at least


def check_cells_fit(cells: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """MemoryError if so many cells cannot fit into the machine, before any is taken."""
    need = math.prod(cells) * _BYTES * dtype.itemsize // 4
    have = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if need > have:
        raise MemoryError(
            f"a grid of {' x '.join(map(str, cells))} cells needs at least {need / 1e9:.3g} GB, "
            f"the machine has {have / 1e9:.3g} GB"
        )


def time_of_way(length: float, speed: float, pull: float) -> float:
    """Time [s] in which what goes at a speed, and is pulled on, covers a length; else infinite."""
    # speed t + pull t^2 / 2 = length
    root = speed + math.sqrt(speed * speed + 2 * pull * length)
    return 2 * length / root if 0 < root < math.inf else math.inf


def check_open_sides(sides: Any, cells: tuple[int, ...]) -> tuple[tuple[str, str], ...]:
    """Kinds of the lower and upper side of each axis."""
    d = len(cells)
    per_axis = [sides] * d if isinstance(sides, str) else sides
    if not isinstance(per_axis, (list, tuple)) or len(per_axis) != d:
        raise InputError(f"sides: expected one word, or {d} words or pairs, got {describe(sides)}")
    pairs = []
    for a, given in enumerate(per_axis):
        pair = (given, given) if isinstance(given, str) else given
        if not isinstance(pair, (list, tuple)) or len(pair) != 2:
            raise InputError(f"sides[{a}]: expected a word or two, got {describe(given)}")
        low, high = (check_choice(f"sides[{a}]", side, SIDES) for side in pair)
        if (low == "periodic") != (high == "periodic"):
            raise InputError(f"sides[{a}]: both sides of an axis are periodic, or none is")
        if low == "periodic" and cells[a] < 2:
            raise InputError(f"sides[{a}]: expected at least 2 cells along a periodic axis, got 1")
        pairs.append((low, high))
    return tuple(pairs)


def interpolate(
    name: str,
    points: ArrayLike,
    bounds: Array,
    cell: float,
    values: Array,
    known: NDArray[np.bool_] | None = None,
) -> Array:
    """Values between the middles of cells, linear; constant beyond the outermost.

    Where not all of the cells around are known, the mean of those that are, with their weights.
    """
    x = check_array(name, points, (None, bounds.shape[1]))
    outside = ((x < bounds[0]) | (x > bounds[1])).any(axis=1)
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(f"{name}[{k}]: expected a point in the box, got {x[k]}")
    shape = np.array(values.shape)
    at = np.clip((x - bounds[0]) / cell - 0.5, 0, shape - 1)
    low = np.minimum(at.astype(np.int64), np.maximum(shape - 2, 0))
    part = at - low
    result, total = np.zeros(len(x)), np.zeros(len(x))
    for corner in itertools.product((0, 1), repeat=len(shape)):
        index = tuple(np.minimum(low + corner, shape - 1).T)
        weight = np.where(corner, part, 1 - part).prod(axis=1)
        if known is not None:
            weight = weight * known[index]
        result += weight * values[index]
        total += weight
    return np.divide(result, total, out=np.zeros(len(x)), where=total > 0)


def curl(velocity: Array, cell: float, periodic: Sequence[bool]) -> Array:
    """Of velocities in the middle of cells, by central differences, one-sided at sides.

    In 2D a number, v_x - u_y, else a vector.
    """

    def slope(a: int, component: int) -> Array:
        values = np.moveaxis(velocity[..., component], a, 0)
        if periodic[a]:
            values = np.concatenate([values[-1:], values, values[:1]])
        change = np.gradient(values, cell, axis=0)
        return np.moveaxis(change[1:-1] if periodic[a] else change, 0, a)

    if len(periodic) == 2:
        return slope(0, 1) - slope(1, 0)
    pairs = ((1, 2), (2, 0), (0, 1))
    return np.stack([slope(a, b) - slope(b, a) for a, b in pairs], axis=-1)
