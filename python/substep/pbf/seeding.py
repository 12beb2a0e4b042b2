"""Filling boxes and surfaces with the particles of a liquid at rest density."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_integer, check_real, in_range
from ..errors import ConvergenceError, InputError
from ..geometry import Collider, Shape, TriangleMesh
from ..geometry.colliders import check_colliders
from ..geometry.triangle_mesh import check_mesh

if TYPE_CHECKING:
    from .fluid import PositionBasedFluid

Array = NDArray[np.float64]

# A step of creeping: iterations, fall from rest in spacings, velocity that is kept.
_SWEEPS, _CREEP, _KEPT = 20, 0.05, 0.5
_CREEPING_STEPS = 60


def fill_box(low: ArrayLike, high: ArrayLike, spacing: float) -> Array:
    """Fill a box with a lattice, half a spacing off its sides.

    Parameters
    ----------
    low, high : array_like, shape (3,) or (2,)
        Lowest and highest corner [m].
    spacing : float
        Distance of neighbours [m], above 0. Where it does not divide a side, the lattice has as
        many points as fit and stands in the middle.

    Returns
    -------
    ndarray, shape (n, 3) or (n, 2)
        Positions [m].

    Raises
    ------
    InputError
        If an argument is wrong, or there would be more than 2**31 - 1 points.

    Examples
    --------
    >>> import substep
    >>> substep.fill_box((0, 0), (0.3, 0.2), 0.1).round(2).tolist()
    [[0.05, 0.05], [0.05, 0.15], [0.15, 0.05], [0.15, 0.15], [0.25, 0.05], [0.25, 0.15]]
    """
    first = check_array("low", low)
    d = 2 if first.shape == (2,) else 3
    first = check_array("low", first, (d,))
    last = check_array("high", high, (d,))
    h = check_real("spacing", spacing, positive=True)
    if not (first <= last).all():
        raise InputError("high: expected numbers not below those of low")
    with in_range("low, high, spacing"):
        counts = np.floor((last - first) / h + 1e-9)
        points = np.prod(counts)
    most = max(points, counts.max())  # a side of no points may stand across long ones
    if not most < 2**31:
        raise InputError(f"spacing: {h} gives a lattice of {most:.1e} points")
    margins = 0.5 * (last - first - counts * h)
    axes = [
        a + m + h * (np.arange(int(n)) + 0.5)
        for a, m, n in zip(first, margins, counts, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)


def fill_mesh(
    mesh: TriangleMesh, spacing: float, *, margin: float = 0.5, threads: int | None = None
) -> Array:
    """Fill a surface with a lattice.

    Inside is where the winding number is above 1/2, so the surface may have holes.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    spacing : float
        Distance of neighbours [m], above 0.
    margin : float
        Spacings that the points keep from the surface, at least 0.
    threads : int, optional
        Threads to use; the result does not depend on them.

    Returns
    -------
    ndarray, shape (n, 3)
        Positions [m], of which `relax` makes the liquid at rest.

    Raises
    ------
    InputError
        If an argument is wrong, no point lies inside, or the lattice would have more than 1e8.

    Examples
    --------
    >>> import substep
    >>> ball = substep.geometry.sphere_mesh(subdivisions=3)
    >>> x = substep.fill_mesh(ball, 0.1)
    >>> round(len(x) * 0.1**3 / ball.volume, 1)
    0.9
    """
    check_mesh(mesh)
    h = check_real("spacing", spacing, positive=True)
    away = h * check_real("margin", margin, nonnegative=True)
    corners = mesh.vertices[mesh.faces]
    low, high = corners.min((0, 1)), corners.max((0, 1))
    with in_range("spacing"):
        points = np.prod((high - low) / h + 1)
    if not points <= 1e8:
        raise InputError(f"spacing: {h} gives a lattice of more than 1e8 points")
    x = fill_box(low, high, h)
    x = x[mesh.signed_distance(x, threads) < -away]
    if len(x) == 0:
        raise InputError(f"mesh: no point of the lattice lies inside; spacing is {h}")
    return x


def relax(
    positions: ArrayLike,
    spacing: float,
    *,
    gravity: ArrayLike | None = None,
    colliders: Sequence[Collider | Shape] = (),
    support: float = 2.0,
    tolerance: float = 1e-2,
    max_iterations: int = 2000,
    threads: int | None = None,
) -> Array:
    """Move particles until the liquid is at rest and nowhere denser than `tolerance` allows.

    A lattice fits a box; along curved walls it is too dense here and leaves gaps there, so it pops
    and sinks. Here the steps of `PositionBasedFluid` lose most of their velocity: the liquid creeps
    to where it stays. Without gravity, particles only move apart.

    Parameters
    ----------
    positions : array_like, shape (n, 3) or (n, 2)
        Where the particles are [m].
    spacing : float
        As of the `PositionBasedFluid` [m].
    gravity : array_like, shape (3,) or (2,), optional
        Acceleration [m/s^2] under which the liquid is to rest; only of use where colliders hold it.
        None unless given.
    colliders : sequence of Collider or Shape
        Walls and obstacles; they are not changed.
    support : float
        As of the `PositionBasedFluid`.
    tolerance : float
        Largest density error of a particle, relative.
    max_iterations : int
        Limit of iterations to reach it after the creeping, at least 1.
    threads : int, optional
        Threads to use; the result does not depend on them.

    Returns
    -------
    ndarray, shape of positions
        New positions [m].

    Raises
    ------
    InputError
        If an argument is wrong.
    ConvergenceError
        If the limit is reached: there may be more particles than the walls have room for.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> x = np.random.default_rng(0).uniform(0, 1, (1000, 3))
    >>> y = substep.relax(x, 0.1)
    >>> liquid = substep.PositionBasedFluid(y, 0.1)
    >>> bool(liquid.densities.max() < 1.01)
    True
    """
    from .fluid import PositionBasedFluid

    x = check_array("positions", positions)
    d = 2 if x.ndim == 2 and x.shape[1] == 2 else 3
    still = [collider.copy() for collider in check_colliders(colliders, d)]
    for collider in still:
        collider.velocity, collider.angular_velocity = np.zeros(3), np.zeros(3)
    limit = check_real("tolerance", tolerance, positive=True)
    rounds = -(-check_integer("max_iterations", max_iterations, minimum=1) // _SWEEPS)

    def liquid(at: Array, g: Array) -> PositionBasedFluid:
        made = PositionBasedFluid(
            at[:0],
            spacing,
            gravity=g,
            colliders=still,
            support=support,
            tolerance=0.1 * limit,
            max_tolerance=limit,
            min_iterations=0,
            max_iterations=_SWEEPS,
            compliance=0.0,
            dtype="float64",
            threads=threads,
        )
        made.add(at)  # without a warning: what is too dense is what it is for
        return made

    if gravity is not None:
        g = check_array("gravity", gravity, (d,))
        with in_range("gravity"):
            pull = float(np.linalg.norm(g))
        if pull > 0:
            creeping = liquid(x, g)
            for _ in range(_CREEPING_STEPS):
                creeping.step(np.sqrt(_CREEP * spacing / pull))
                creeping.set_velocities(_KEPT * creeping.velocities)
            x = creeping.positions
    resting = liquid(x, np.zeros(d))
    for _ in range(rounds):
        resting.step(1.0)
        resting.set_velocities(np.zeros_like(resting.positions))
        if resting.densities.max(initial=0.0) <= 1 + limit:
            return resting.positions
    error = 100 * resting.report.max_error
    raise ConvergenceError(
        f"relax: the density is {error:.2g} % above the rest density after {max_iterations} "
        "iterations; are there more particles than there is room?"
    )
