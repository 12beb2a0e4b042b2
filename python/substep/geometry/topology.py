"""What every mesh needs: checked indices, connected components."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import as_array, check_array, check_most, describe, first_bad_index
from ..errors import InputError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


MOST = 1e75  # [m] of a vertex, so that squares of areas are finite


def check_vertices(name: str, value: Any) -> Array:
    """Points as new rows."""
    return check_most(name, check_array(name, value, (None, 3)), MOST)


def check_indices(name: str, value: Any, columns: int, count: int) -> Indices:
    """Rows of `columns` different integers in [0, count), as a new array; at least one row."""
    array = as_array(name, value)
    if array.dtype.kind not in "iufb":
        raise TypeError(f"{name}: expected integers, got dtype {array.dtype}")
    if array.ndim != 2 or array.shape[1] != columns or array.shape[0] == 0:
        raise InputError(
            f"{name}: expected at least one row of {columns} indices, got {describe(array)}"
        )
    if array.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integers, got dtype {array.dtype}")
    wrong = (array < 0) | (array >= count)
    if wrong.any():
        raise InputError(
            f"{name}{first_bad_index(wrong)}: expected an index from 0 to {count - 1}, "
            f"got {array[wrong][0]}"
        )
    indices: Indices = array.astype(np.int64, copy=False)
    ordered = np.sort(indices, axis=1)
    repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if repeated.any():
        row = int(np.argmax(repeated))
        raise InputError(f"{name}[{row}]: expected different indices, got {indices[row].tolist()}")
    return indices


def equal_rows(rows: NDArray[Any]) -> tuple[Indices, Indices, Indices]:
    """Of the distinct rows, sorted: the first place and the count of each; and which each row is.

    NumPy's `unique` with axis=0 compares rows as structures: slow, and a Ctrl-C in it is lost.
    """
    order = np.lexsort(rows.T[::-1])
    sorted_rows = rows[order]
    begins = np.ones(len(rows), bool)
    begins[1:] = (sorted_rows[1:] != sorted_rows[:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(begins) - 1
    return order[begins], np.bincount(number), number


def components(count: int, pairs: Indices) -> Indices:
    """Number of the connected component of each of `count` nodes, rising with the lowest node."""
    label = np.arange(count)
    while True:
        low = np.minimum(label[pairs[:, 0]], label[pairs[:, 1]])
        new = label.copy()
        for side in (0, 1):
            np.minimum.at(new, pairs[:, side], low)
            np.minimum.at(new, label[pairs[:, side]], low)
        new = new[new]
        if (new == label).all():
            return np.unique(label, return_inverse=True)[1].astype(np.int64)
        label = new
