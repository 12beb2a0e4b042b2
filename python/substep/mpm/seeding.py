"""Filling regions with particles of the material point method: their positions and volumes."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_integer,
    check_real,
    check_threads,
    in_range,
)
from ..errors import InputError
from ..geometry import TriangleMesh
from ..geometry.triangle_mesh import check_mesh

Array = NDArray[np.float64]

PATTERNS = ("jittered", "poisson")
_MOST = 2**31 - 1  # cells of a lattice
# Darts that each cell gets, and points that they make, n r^d / V, measured away from walls.
_TRIALS, _FILLED = 8, {2: 0.6133, 3: 0.6037}


def sample_box(
    low: ArrayLike,
    high: ArrayLike,
    spacing: float,
    *,
    pattern: str = "jittered",
    jitter: float = 0.5,
    seed: int = 0,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Fill a box with particles.

    Parameters
    ----------
    low, high : array_like, shape (3,) or (2,)
        Lowest and highest corner [m].
    spacing : float
        A particle has about `spacing` cubed (in 2D squared) of the volume [m]; half a cell of the
        grid gives 8 (in 2D 4) a cell.
    pattern : {'jittered', 'poisson'}
        One particle in each cube of a lattice, whose sides are stretched to fit the box; or random
        ones of which no two are closer than 0.85 (in 2D 0.78) spacings (Poisson-disk).
    jitter : float
        Share of its cube in which a jittered particle is drawn, from 0 (a lattice) to 1.
    seed : int
        Of the random numbers, at least 0; the same gives the same particles.
    threads : int, optional
        Threads to use; the result does not depend on them.

    Returns
    -------
    positions : ndarray, shape (n, 3) or (n, 2)
        Where they are [m].
    volumes : ndarray, shape (n,)
        All the same; their sum is the volume of the box [m^3; in 2D m^2].

    Raises
    ------
    InputError
        If an argument is wrong, or there would be 2**31 points.

    References
    ----------
    Wei, "Parallel Poisson disk sampling", ACM Trans. Graph. 27(3), 2008.

    Examples
    --------
    >>> import substep
    >>> x, volumes = substep.mpm.sample_box((0, 0, 0), (1, 1, 0.5), 0.1)
    >>> len(x), round(float(volumes.sum()), 12)
    (500, 0.5)
    """
    first = check_array("low", low)
    d = 2 if first.shape == (2,) else 3
    first = check_array("low", first, (d,))
    last = check_array("high", high, (d,))
    if not (first < last).all():
        raise InputError("high: expected numbers above those of low")
    h = check_real("spacing", spacing, positive=True)
    with in_range("low, high, spacing"):
        volume = float(np.prod(last - first))
        if check_choice("pattern", pattern, PATTERNS) == "jittered":
            counts = np.maximum(1, np.rint((last - first) / h))
            x = _jittered(first, (last - first) / counts, counts, jitter, seed)
        else:
            x = _poisson(first, last, h, seed, threads)
            x = x[((x >= first) & (x <= last)).all(axis=1)]
    return x, _shares("high", x, volume)


def sample_sphere(
    center: ArrayLike,
    radius: float,
    spacing: float,
    *,
    pattern: str = "jittered",
    jitter: float = 0.5,
    seed: int = 0,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Fill a sphere, in 2D a disk, with particles.

    Parameters
    ----------
    center : array_like, shape (3,) or (2,)
        Middle [m].
    radius : float
        Its radius [m], above 0.
    spacing, pattern, jitter, seed, threads
        As of `sample_box`; the cubes of the lattice are not stretched.

    Returns
    -------
    positions : ndarray, shape (n, 3) or (n, 2)
        Where they are [m].
    volumes : ndarray, shape (n,)
        All the same; their sum is the volume of the sphere [m^3; in 2D m^2].

    Raises
    ------
    InputError
        If an argument is wrong, no point lies inside, or there would be 2**31 points.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> x, areas = substep.mpm.sample_sphere((0, 0), 0.5, 0.05, pattern="poisson", seed=1)
    >>> bool(np.linalg.norm(x, axis=1).max() <= 0.5), bool(np.isclose(areas.sum(), np.pi / 4))
    (True, True)
    """
    middle = check_array("center", center)
    d = 2 if middle.shape == (2,) else 3
    middle = check_array("center", middle, (d,))
    r = check_real("radius", radius, positive=True)

    def inside(x: Array) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = ((x - middle) ** 2).sum(axis=1) <= r * r
        return found

    with in_range("center, radius, spacing"):
        volume = math.pi * r**2 if d == 2 else 4 / 3 * math.pi * r**3
        x = _within(middle - r, middle + r, inside, spacing, pattern, jitter, seed, threads)
    return x, _shares("radius", x, volume)


def sample_mesh(
    mesh: TriangleMesh,
    spacing: float,
    *,
    pattern: str = "jittered",
    jitter: float = 0.5,
    seed: int = 0,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Fill a surface with particles.

    Inside is where the winding number is above 1/2, so the surface may have holes.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    spacing, pattern, jitter, seed, threads
        As of `sample_box`; the cubes of the lattice are not stretched.

    Returns
    -------
    positions : ndarray, shape (n, 3)
        Where they are [m].
    volumes : ndarray, shape (n,)
        All the same [m^3]. Their sum is the volume of the mesh where it is closed and does not cut
        itself; else each is `spacing` cubed.

    Raises
    ------
    InputError
        If an argument is wrong, no point lies inside, or there would be 2**31 points.

    Examples
    --------
    >>> import substep
    >>> ball = substep.geometry.sphere_mesh(subdivisions=3)
    >>> x, volumes = substep.mpm.sample_mesh(ball, 0.1)
    >>> round(float(volumes.sum() / ball.volume), 12), round(float(volumes[0] / 0.1**3), 2)
    (1.0, 1.0)
    """
    check_mesh(mesh)
    corners = mesh.vertices[mesh.faces]

    def inside(x: Array) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = mesh.signed_distance(x, threads) < 0
        return found

    low, high = corners.min((0, 1)), corners.max((0, 1))
    with in_range("spacing"):
        x = _within(low, high, inside, spacing, pattern, jitter, seed, threads)
    report = mesh.report()
    solid = report.closed and not report.pierced
    return x, _shares("mesh", x, abs(report.volume) if solid else len(x) * float(spacing) ** 3)


def _within(
    low: Array,
    high: Array,
    inside: Callable[[Array], NDArray[np.bool_]],
    spacing: float,
    pattern: str,
    jitter: float,
    seed: int,
    threads: int | None,
) -> Array:
    """Points of a region, of those of its bounding box."""
    h = check_real("spacing", spacing, positive=True)
    if check_choice("pattern", pattern, PATTERNS) == "jittered":
        counts = np.maximum(1, np.ceil((high - low) / h))
        x = _jittered((low + high - counts * h) / 2, np.full(len(low), h), counts, jitter, seed)
    else:
        x = _poisson(low, high, h, seed, threads)
    return x[inside(x)]


def _jittered(low: Array, sides: Array, counts: Array, jitter: float, seed: int) -> Array:
    """One point in each cell of a lattice of cells with these sides."""
    share = check_real("jitter", jitter, nonnegative=True)
    if share > 1:
        raise InputError(f"jitter: expected a number from 0 to 1, got {share}")
    key = check_integer("seed", seed, minimum=0, maximum=2**64 - 1)
    if not np.prod(counts) <= _MOST:
        raise InputError(f"spacing: it gives a lattice of {np.prod(counts):.1e} points")
    axes = [np.arange(int(n)) + 0.5 for n in counts]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
    if share > 0:
        drawn = np.random.Generator(np.random.Philox(key=key)).random(x.shape)
        x += share * (drawn - 0.5)
    return low + sides * x


def _poisson(low: Array, high: Array, h: float, seed: int, threads: int | None) -> Array:
    """Points in and around a box; those around it make the density up to its sides the same."""
    d = len(low)
    radius = h * _FILLED[d] ** (1 / d)
    size = high - low + 4 * radius
    key = check_integer("seed", seed, minimum=0, maximum=2**64 - 1)
    if not np.prod(np.ceil(size / radius * math.sqrt(d))) <= _MOST:
        raise InputError(f"spacing: {h} gives more than {_MOST} cells")
    x = _core.poisson_disk(size.tolist(), radius, _TRIALS, key, check_threads(threads))
    shifted: Array = x + (low - 2 * radius)
    return shifted


def _shares(name: str, x: Array, volume: float) -> Array:
    """Of a volume, the same for each point."""
    if len(x) == 0:
        raise InputError(f"{name}: no point lies inside; is the spacing too large?")
    return np.full(len(x), volume / len(x))
