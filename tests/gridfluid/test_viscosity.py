"""Viscous liquids on a grid against closed forms and published values."""

import itertools
import math

import numpy as np
import pytest
import substep

G = 9.81


def lattice(*axes):
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def half_cells(low, high, cell):
    """Middles of half cells."""
    return low + cell / 2 * (np.arange(round(2 * (high - low) / cell)) + 0.5)


def film(n, *, height=0.1, slope=0.5, viscosity=0.01, depth=None, **options):
    """A film of n cells that runs down a slope, in a box without ends, at its steady speed."""
    cell = height / n
    x = lattice(half_cells(0, 4 * cell, cell), half_cells(0, height, cell))
    pull = G * math.sin(slope)
    y = x[:, 1]
    v = np.stack([pull / viscosity * (height * y - y**2 / 2), 0 * y], axis=1)
    bounds = ((0, 0), (4 * cell, cell * math.ceil(1.4 * n)))
    return substep.GridLiquid(
        x,
        cell=cell,
        bounds=bounds,
        velocities=v,
        gravity=(pull, -G * math.cos(slope)),
        sides=("periodic", "wall"),
        viscosity=viscosity,
        **options,
    )


def surface_speed(liquid, height):
    """Of the upper tenth."""
    top = liquid.positions[:, 1] > 0.9 * height
    return liquid.velocities[top, 0].mean()


def test_a_film_has_the_speed_of_nusselt_at_second_order():
    """u = g sin(a) (h y - y^2 / 2) / nu."""
    height = 0.1
    wrong = []
    for n in (5, 10, 20):
        liquid = film(n, height=height)
        for _ in range(60):
            liquid.step(0.05)
        y = liquid.positions[:, 1]
        exact = G * math.sin(0.5) / 0.01 * (height * y - y**2 / 2)
        wrong.append(np.abs(liquid.velocities[:, 0] - exact).mean() / exact.max())
    print(wrong)
    assert wrong[-1] < 2e-3
    assert wrong[0] > 3 * wrong[1] > 9 * wrong[2]
