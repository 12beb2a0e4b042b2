"""Neighbour lists of points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_choice, check_real, check_threads
from ..errors import InputError


def neighbour_lists(
    points: ArrayLike, radius: float, *, pairs: str = "full", threads: int | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Which points are closer to each other than a radius.

    The points are sorted into cells of the radius' size, and each is compared with those of the
    cells about it. Neither the extent of the domain nor its position matters.

    Parameters
    ----------
    points : array_like, shape (n, 3) or (n, 2)
        Positions [m]. float32 is searched in float32, everything else in float64.
    radius : float
        The points at a distance below the radius [m] are neighbours.
    pairs : {"full", "half"}, optional
        "full": each pair stands in both rows; "half": only in that of the lower index.
    threads : int, optional
        Threads to use; the result does not depend on them.

    Returns
    -------
    offsets : ndarray of int64, shape (n + 1,)
        The neighbours of point i are ``indices[offsets[i]:offsets[i + 1]]``.
    indices : ndarray of int32, shape (offsets[-1],)
        Indices of points, row after row; within a row in the order of their cells. A point is not
        its own neighbour; points at the same place are neighbours.

    Raises
    ------
    InputError
        If a coordinate is not finite or further from the origin than 2**24 radii (float32) or
        2**53 radii (float64); if the radius is not above 0 or its square leaves the numbers.

    References
    ----------
    Ihmsen, Akinci, Becker and Teschner (2011), "A parallel SPH implementation on multi-core CPUs",
    Computer Graphics Forum 30, 99: cells by (index) sort.

    Examples
    --------
    >>> import numpy as np
    >>> from substep.geometry import neighbour_lists
    >>> offsets, indices = neighbour_lists([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]], radius=1.5)
    >>> offsets
    array([0, 1, 2, 2])
    >>> indices
    array([1, 0], dtype=int32)
    >>> np.diff(offsets)  # how many neighbours each has
    array([1, 1, 0])
    """
    rows = _check_points(points)
    chosen = check_choice("pairs", pairs, ("full", "half"))
    r = check_real("radius", radius, positive=True)
    if not _is_normal(r, rows.dtype):
        raise InputError(f"radius: its square must be a number of {rows.dtype}, got {r}")
    offsets, indices = _core.neighbour_lists(rows, r, chosen == "half", check_threads(threads))
    return offsets, indices


def _is_normal(radius: float, dtype: np.dtype[Any]) -> bool:
    """Whether the square of the radius is neither infinite nor denormal."""
    info = np.finfo(dtype)
    return float(info.tiny) <= radius * radius <= float(info.max)


def _check_points(points: ArrayLike) -> NDArray[Any]:
    single = isinstance(points, np.ndarray) and points.dtype.newbyteorder("=") == np.float32
    rows = check_array("points", points, (None, None), dtype=np.float32 if single else np.float64)
    if rows.shape[1] not in (2, 3):
        raise InputError(f"points: expected shape (n, 3) or (n, 2), got {rows.shape}")
    return rows
