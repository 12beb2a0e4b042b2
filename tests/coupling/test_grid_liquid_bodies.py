"""Bodies that yield to a liquid on a grid: floating, added mass, drag, and what must not change."""

import math

import numpy as np
import pytest
import substep

G, RHO = 9.81, 1000.0


def behave_as(collider, mass, inertia, *, number=0, dimension=3, gravity=G):
    """Lets a collider stand for a body with its centre of mass in its position."""
    inverse = np.zeros(6)
    inverse[:dimension] = 1 / mass
    inverse[5 if dimension == 2 else slice(3, 6)] = 1 / inertia
    pull = np.zeros(6)
    pull[dimension - 1] = -gravity
    collider._native.set_body(number, [0.0] * 3, np.diag(inverse).ravel().tolist(), pull.tolist())


def lattice(*ends, cell):
    """Particles in rows, two to a cell along each axis, from 0 to the ends."""
    rows = [np.arange(cell / 4, end, cell / 2) for end in ends]
    return np.stack(np.meshgrid(*rows, indexing="ij"), -1).reshape(-1, len(ends))


def tank(shape, ratio, height, n, *, side=2.0, depth=2.0, air=0.5, **options):
    """A body of 1 m, of n cells, with its middle so high in water, and its collider."""
    cell, middle = 1 / n, np.array([side / 2, side / 2, height])
    if shape == "sphere":
        collider = substep.Collider(substep.Sphere(0.5, middle))
        mass = ratio * RHO * math.pi / 6
        inertia = mass / 10
    else:
        collider = substep.Collider(substep.Box((1, 1, 1), middle))
        mass = ratio * RHO
        inertia = mass / 6
    x = lattice(side, side, depth, cell=cell)
    x = x[collider.distance(x) > 0]
    liquid = substep.GridLiquid(
        x, cell=cell, bounds=((0, 0, 0), (side, side, depth + air)), colliders=[collider], **options
    )
    behave_as(collider, mass, inertia)
    return liquid, collider


def draft(shape, ratio):
    """Archimedes': of a box, or of a sphere, s = d^2 (3 - 2 d)."""
    if shape == "box":
        return ratio
    roots = np.roots([-2, 3, 0, -ratio])
    return float(min(roots[(roots.real > 0) & (roots.real < 1)].real))


def mean_draft(shape, ratio, n, duration, *, factor=1):
    depth = 1.5
    liquid, collider = tank(
        shape, ratio, depth - draft(shape, ratio) + 0.5, n, depth=depth, air=1.0
    )
    heights, end = [], duration
    while liquid.time < end:
        liquid.step(factor * liquid.step_limit()[0])
        heights.append(collider.position[2])
    assert np.abs(liquid.velocities).max() < 2
    return depth + 0.5 - np.mean(heights[len(heights) // 2 :])


@pytest.mark.parametrize("ratio", [0.05, 0.5, 0.9])
def test_spheres_float_as_deep_as_archimedes_says(ratio):
    """Within 2 % of their diameter at 12 cells."""
    assert abs(mean_draft("sphere", ratio, 12, 2) - draft("sphere", ratio)) < 0.02
