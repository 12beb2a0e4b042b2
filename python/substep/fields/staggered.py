"""Brings velocities that lie on the same, or on different points, onto one grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from .layout import Component

Array = NDArray[np.float64]


class Stack:
    """One velocity at all its times, from one file or many."""

    def __init__(self, parts: Sequence[Component]) -> None:
        self.first = first = parts[0]
        self.name, self.geographic, self.dated = first.name, first.geographic, first.dated
        for other in parts[1:]:
            if not first.same_points(other):
                raise FormatError(f"{other.name}: its grid is not that of {first.name}")
            if other.dated != first.dated:
                raise FormatError(f"{other.name}: its times have a date, or none, unlike others")
        self._entries = sorted(
            ((time, number, part) for part in parts for number, time in enumerate(part.times)),
            key=lambda entry: entry[0],
        )
        self.times = np.array([time for time, _, _ in self._entries])
        same = np.flatnonzero(np.diff(self.times) <= 0)
        if len(same):
            one, two = (self._entries[int(same[0]) + k][2].name for k in (0, 1))
            raise FormatError(f"{two}: has the same time as {one}")

    @property
    def points(self) -> tuple[Array, Array]:
        """Coordinates of the points, shape (n_x, n_y) each."""
        x, y = self.first.x, self.first.y
        if x.ndim == 2:
            return x, y
        both = np.meshgrid(x, y, indexing="ij")
        return both[0], both[1]

    def read(self, level: int) -> Array:
        """Velocities at a level, shape (n_x, n_y[, n_z])."""
        _, number, part = self._entries[level]
        return part.read(number)


class Levels:
    """Velocities of a grid, read when asked for; see LevelSource."""

    def __init__(self, count: int, shape: tuple[int, ...], read: Callable[[int, int], Array]):
        self.shape = (count, *shape)
        self._read = read  # (component, level)

    def __getitem__(self, level: int) -> Array:
        values = np.full(self.shape[1:], np.nan)
        for d in range(values.shape[-1]):
            part = self._read(d, level)
            values[..., d][tuple(slice(n) for n in part.shape)] = part
        return values


@dataclass
class Grid:
    """Axes, or corners and where the velocities are, and the velocities."""

    levels: Any
    axes: list[Array] | None = None
    corners: tuple[Array, Array] | None = None
    z: Array | None = None
    arakawa: str = "A"


def arrange(stacks: Sequence[Stack], corners: tuple[Array, Array] | None) -> Grid:
    """The grid of velocities along x, y and perhaps z."""
    u, v = stacks[:2]
    for other in stacks[1:]:
        if other.dated != u.dated or not np.array_equal(other.times, u.times):
            raise FormatError(f"{other.name}: its times are not those of {u.name}")
    sign = -1.0 if len(stacks) == 3 and stacks[2].first.upward and u.first.downward else 1.0
    # Velocities on the same points are those of an A grid, whatever corners the files have too. But
    # speeds along the rows may have the coordinates of the middle of cells, as NEMO's U and V, and
    # go with corners by their numbers alone.
    numbered = corners is not None and corners[0].shape == u.points[0].shape
    if u.first.same_points(v.first, vertical=False) and not (u.first.along_the_grid and numbered):
        corners = None
    if corners is not None or not all(u.first.same_points(s.first) for s in stacks):
        return _staggered(stacks, corners, sign)
    dimension = 2 if u.first.z is None else 3
    x, y, z = u.first.x, u.first.y, u.first.z
    axes = _axes(x, y)
    if axes is None:
        if u.first.along_the_grid:
            raise FormatError(
                f"{u.name}: {u.first.variable.name} is along the rows of a curvilinear grid, and "
                "at the points of the other velocity; expected eastward and northward velocities"
            )
        closed = _closing(x, u.geographic)
    else:
        closed = slice(None)
    backwards = slice(None, None, -1 if axes is None and z is not None and z[0] > z[-1] else 1)
    points = (len(axes[0]), len(axes[1])) if axes else x[closed].shape
    shape = (*points, *(() if z is None else z.shape), dimension)

    def read(d: int, level: int) -> Array:
        if d >= len(stacks):
            return np.zeros(shape[:-1])
        part = stacks[d].read(level)[closed]
        return (sign if d == 2 else 1.0) * (part if z is None else part[..., backwards])

    levels = Levels(len(u.times), shape, read)
    if axes is not None:
        return Grid(levels, axes=axes if z is None else [*axes, z])
    return Grid(levels, corners=(x[closed], y[closed]), z=None if z is None else z[backwards])


def _axes(x: Array, y: Array) -> list[Array] | None:
    """Coordinates along straight axes, where they are."""
    if x.ndim == 1:
        return [x, y]
    if (x == x[:, :1]).all() and (y == y[:1]).all():
        return [x[:, 0].copy(), y[0].copy()]
    return None


def _closing(x: Array, geographic: bool) -> Any:
    """Rows of a grid that goes round the Earth, the first one once more at the end."""
    rows = np.arange(len(x))
    if not geographic or len(x) < 3:
        return rows
    step = _median(_reduced(np.diff(x, axis=0)))
    gap, spacing = _median(_reduced(x[0] - x[-1])) * np.sign(step), abs(step)
    return np.append(rows, 0) if 0 < gap < 1.5 * spacing and len(x) * spacing > 180 else rows


def _reduced(dx: Array) -> Array:
    """Differences of longitudes, within 180 degrees."""
    return (dx + 180) % 360 - 180


def _median(a: Array) -> float:
    """Of the numbers that there are, NaN of none."""
    known = a[np.isfinite(a)]
    return float(np.median(known)) if known.size else math.nan


def _staggered(stacks: Sequence[Stack], corners: tuple[Array, Array] | None, sign: float) -> Grid:
    """Velocities on the faces of the cells of an Arakawa C grid."""
    u, v = stacks[:2]
    z = None
    if u.first.z is not None:
        if len(stacks) < 3 or stacks[2].first.z is None:
            raise FormatError(
                f"{u.name}: a C grid in space needs the velocity along z, on the faces of layers; "
                "give depth= for one layer"
            )
        z = stacks[2].first.z
        between = z[: len(u.first.z)][:-1] <= u.first.z[: len(z) - 1]
        if not ((np.diff(z) > 0).all() and between.all()):
            raise FormatError(f"{stacks[2].name}: expected depths of the faces above each layer")
    east = north = True
    if corners is None:
        x, y, east, north = _corners_between(u, v)
    else:
        x, y = corners
        (n, m), shapes = x.shape, (u.points[0].shape, v.points[0].shape)
        if shapes not in (((n, m), (n, m)), ((n, m + 1), (n + 1, m))):
            raise FormatError(
                f"{u.name}: U, V and the corners have shapes {shapes} and {x.shape}, which do not "
                "go together"
            )

    rows = _closing(x, u.geographic)
    x, y = x[rows], y[rows]
    # Speeds on straight axes are towards rising coordinates, be they eastward or, as CF defines
    # "x_velocity", along x; those along the rows of a curvilinear grid are towards rising numbers.
    signs = [1.0, 1.0, sign]
    if (axes := _axes(x, y)) is not None:
        for d, step in enumerate(map(np.diff, axes)):
            if _median(_reduced(step) if u.geographic else step) < 0:
                signs[d] = -1.0

    # What is added to the numbers of a corner: U is on the face that begins there, and so on.
    first, second = (1 if east else 0), (0 if north else 1)
    offsets = [(0, 1), (first, second), (first, 1)]
    shape = (*x.shape, *(() if z is None else z.shape), len(stacks))

    def read(d: int, level: int) -> Array:
        part = stacks[d].read(level)[rows]
        i, j = offsets[d]
        ends = (i + shape[0], j + shape[1])
        part = part[i : ends[0], j : ends[1]]
        return signs[d] * (part if z is None else part[..., : len(z)])

    return Grid(Levels(len(u.times), shape, read), corners=(x, y), z=z, arakawa="C")


def _corners_between(u: Stack, v: Stack) -> tuple[Array, Array, bool, bool]:
    """Corners half way between the points of U, and whether U is east and V north of the cells."""
    (x_u, y_u), (x_v, y_v) = u.points, v.points
    if x_u.shape != x_v.shape:
        raise FormatError(
            f"{v.name}: its points are not those of {u.name}, and of another shape, {x_v.shape} "
            f"for {x_u.shape}; give the file with the corners (glamf, gphif) too"
        )
    if min(x_u.shape) < 3:
        raise FormatError(f"{u.name}: expected at least 3 x 3 cells, got {x_u.shape}")

    def reduced(dx: Array) -> Array:
        return _reduced(dx) if u.geographic else dx

    # v - u = alpha e_i + beta e_j, with alpha -1/2 where U is east and beta 1/2 where V is north.
    inner = (slice(1, -1), slice(1, -1))
    e_i = reduced(x_u[2:, 1:-1] - x_u[:-2, 1:-1]) / 2, (y_u[2:, 1:-1] - y_u[:-2, 1:-1]) / 2
    e_j = reduced(x_u[1:-1, 2:] - x_u[1:-1, :-2]) / 2, (y_u[1:-1, 2:] - y_u[1:-1, :-2]) / 2
    to_v = reduced(x_v[inner] - x_u[inner]), y_v[inner] - y_u[inner]
    with np.errstate(all="ignore"):
        area = e_i[0] * e_j[1] - e_i[1] * e_j[0]
        alpha = _median((to_v[0] * e_j[1] - to_v[1] * e_j[0]) / area)
        beta = _median((e_i[0] * to_v[1] - e_i[1] * to_v[0]) / area)
    if not (abs(abs(alpha) - 0.5) < 0.2 and abs(abs(beta) - 0.5) < 0.2):
        raise FormatError(
            f"{v.name}: its points are not those of {u.name}, nor those of a C grid: they lie "
            f"{alpha:.2g} and {beta:.2g} cells beside them"
        )
    x = x_u[:, :-1] + reduced(x_u[:, 1:] - x_u[:, :-1]) / 2
    return x, (y_u[:, :-1] + y_u[:, 1:]) / 2, bool(alpha < 0), bool(beta > 0)
