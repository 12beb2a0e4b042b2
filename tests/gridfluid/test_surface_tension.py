"""Liquids on a grid that their surface tension moves, against closed forms."""

import math

import numpy as np
import pytest
import substep

from .test_liquid import half_cells, lattice

# All have density 1 and surface tension 1, drops a radius of 1: speeds are in sqrt(sigma / rho R).


def liquid_of(inside, half, cell, **options):
    """What of a box about 0 is inside, at rest; particles moved by a fifth of their spacing."""
    half = cell * np.ceil(np.asarray(half) / cell)
    x = lattice(*(half_cells(-h, h, cell) for h in half))
    x += np.random.default_rng(0).uniform(-0.2, 0.2, x.shape) * cell / 2
    settings = {"density": 1.0, "surface_tension": 1.0, "gravity": np.zeros(len(half))}
    bounds = (-half, half)
    return substep.GridLiquid(x[inside(x)], cell=cell, bounds=bounds, **settings | options)


def drop(cells, dimension, stretch=0.0, **options):
    """A drop with so many cells to its radius, stretched along its last axis in mode 2."""

    def inside(x):
        r = np.linalg.norm(x, axis=1)
        c = x[:, -1] / r
        wave = 2 * c**2 - 1 if dimension == 2 else (3 * c**2 - 1) / 2
        return r < 1 + stretch * wave

    half = np.full(dimension, 1 + abs(stretch) + 4 / cells)
    return liquid_of(inside, half, 1 / cells, **options)


def rms_speed(liquid):
    return math.sqrt((liquid.velocities**2).sum(axis=1).mean())


def radius_of(liquid):
    """Of a round drop with so many particles."""
    volume = len(liquid) * (liquid.cell / 2) ** liquid.bounds.shape[1]
    if liquid.bounds.shape[1] == 2:
        return math.sqrt(volume / math.pi)
    return math.cbrt(0.75 * volume / math.pi)


def mean_pressure(liquid, steps=10):
    inside = []
    for _ in range(steps):
        liquid.step(liquid.step_limit()[0])
        inside.append(liquid.pressure[liquid.level_set < -liquid.cell].mean())
    return np.mean(inside)


@pytest.mark.parametrize(
    ("dimension", "cells"), [(2, 8), (2, 16), (2, 32), (3, 6), (3, 8), (3, 12)]
)
def test_a_drop_at_rest_has_the_pressure_of_laplace(dimension, cells):
    liquid = drop(cells, dimension)
    liquid.advance(0.2)
    should = (dimension - 1) / radius_of(liquid)
    assert mean_pressure(liquid) == pytest.approx(should, rel=0.02)
    assert rms_speed(liquid) < 0.04


def test_spurious_currents_do_not_grow():
    """Without viscosity, over six of the times that waves take along a radius."""
    liquid = drop(16, 2)
    speeds = []
    for _ in range(6):
        liquid.advance(1.0)
        speeds.append(rms_speed(liquid))
    assert max(speeds) < 0.03
    assert np.mean(speeds[3:]) < 1.2 * np.mean(speeds[:3])
    assert np.abs(liquid.velocities.mean(axis=0)).max() < 0.01


def frequency(times, values):
    """Of a damped cosine that starts with its crest: from where it crosses 0."""
    sign = np.sign(values)
    at = np.flatnonzero(sign[1:] != sign[:-1])
    crossings = times[at] + (times[at + 1] - times[at]) * values[at] / (values[at] - values[at + 1])
    return math.pi * (len(crossings) - 1) / (crossings[-1] - crossings[0])


def swing(liquid, measure, duration):
    times, values = [liquid.time], [measure(liquid)]
    while liquid.time < duration:
        liquid.advance(duration / 60)
        times.append(liquid.time)
        values.append(measure(liquid))
    return frequency(np.array(times), np.array(values))


def stretched(liquid):
    squares = ((liquid.positions - liquid.positions.mean(axis=0)) ** 2).mean(axis=0)
    return squares[-1] - squares[:-1].mean()


@pytest.mark.figure
def test_a_drop_in_the_plane_swings_as_rayleigh_says():
    """Mode 2: omega^2 = 6 sigma / (rho R^3) (Rayleigh 1879)."""
    wrong = []
    for cells in (8, 16, 32):
        liquid = drop(cells, 2, 0.05)
        omega = math.sqrt(6 / radius_of(liquid) ** 3)
        found = swing(liquid, stretched, 1.5 * 2 * math.pi / omega)
        wrong.append(abs(found / omega - 1))
    assert np.all(wrong < np.array([0.07, 0.03, 0.02]))


@pytest.mark.figure
@pytest.mark.parametrize(("cells", "error"), [(6, 0.12), (10, 0.06)])
def test_a_drop_swings_as_lamb_says(cells, error):
    """Mode 2: omega^2 = 8 sigma / (rho R^3) (Lamb, Hydrodynamics, 1932, art. 275)."""
    liquid = drop(cells, 3, 0.08)
    omega = math.sqrt(8 / radius_of(liquid) ** 3)
    found = swing(liquid, stretched, 1.1 * 2 * math.pi / omega)
    assert found == pytest.approx(omega, rel=error)


@pytest.mark.parametrize(("cells", "error"), [(16, 0.07), (32, 0.03)])
def test_capillary_waves(cells, error):
    """omega^2 = sigma k^3 tanh(k h) / rho, between walls, met at a right angle (Lamb, art. 266)."""
    h, a, k = 0.5, 0.03, math.pi

    def inside(x):
        return x[:, 1] < a * np.cos(k * (x[:, 0] + 0.5))

    liquid = liquid_of(inside, (0.5, h), 1 / cells)
    omega = math.sqrt(k**3 * math.tanh(k * h))

    def height(liquid):
        left, right = liquid.depth([[-0.5], [0.5]])
        return left - right

    assert swing(liquid, height, 1.5 * 2 * math.pi / omega) == pytest.approx(omega, rel=error)


@pytest.mark.figure
def test_a_square_becomes_round_and_keeps_its_volume():
    cells, side = 16, math.sqrt(math.pi)

    def inside(x):
        return np.abs(x).max(axis=1) < side / 2

    liquid = liquid_of(inside, (1.5, 1.5), 1 / cells, viscosity=0.2)
    liquid.advance(5.0)
    radii = np.linalg.norm(liquid.positions - liquid.positions.mean(axis=0), axis=1)
    angle = np.arctan2(*liquid.positions.T)
    rims = [radii[np.abs(angle - at) < 0.2].max() for at in np.linspace(-2.8, 2.8, 15)]
    assert max(rims) - min(rims) < 1.5 / cells
    assert np.mean(rims) == pytest.approx(radius_of(liquid), rel=0.03)


def test_a_jet_that_breaks_up_gains_no_energy():
    """What moves is what the surface has lost (Rayleigh and Plateau)."""
    radius, half = 0.25, 1.2

    def inside(x):
        r = np.hypot(x[:, 0], x[:, 1])
        return r < radius * (1 + 0.2 * np.cos(math.pi * x[:, 2] / half))

    liquid = liquid_of(inside, (0.8, 0.8, half), 0.08, sides=("wall", "wall", "periodic"))
    volume = len(liquid) * 0.04**3
    surface = 2 * math.pi * radius * 2 * half
    least = (36 * math.pi * volume**2) ** (1 / 3)  # of one drop
    energies = []
    for _ in range(15):
        liquid.advance(0.1)
        energies.append(liquid.diagnostics()["kinetic_energy"])
        if len(energies) == 7:  # it has torn
            # A small drop stays where it tore.
            assert np.mean(np.abs(liquid.positions[:, 2]) > 0.6 * half) < 0.03
    assert 0.7 * (surface - least) < max(energies) < surface - least


def test_capillary_waves_limit_the_step():
    liquid = drop(8, 2)
    limit, reason = liquid.step_limit()
    assert limit == pytest.approx(math.sqrt((1 / 8) ** 3 / (2 * math.pi)))
    assert reason == "capillary waves of a cell's size, with a surface tension of 1 N/m"


@pytest.mark.parametrize("dimension", [2, 3])
def test_bits_do_not_depend_on_threads_or_checkpoints(dimension):
    ends = []
    for threads in (1, 2, 3):
        liquid = drop(6, dimension, 0.3, threads=threads)
        for step in range(4):
            if step == 2 and threads == 2:
                state, liquid = liquid.state(), drop(6, dimension, 0.3, threads=2)
                liquid.restore(state)
            liquid.step(0.01)
        ends.append(substep.state_hash(liquid.positions, liquid.velocities))
    assert len(set(ends)) == 1


@pytest.mark.parametrize("wrong", [-1.0, math.nan, math.inf, "much"])
def test_a_wrong_surface_tension_is_refused(wrong):
    with pytest.raises((substep.InputError, TypeError), match="surface_tension"):
        drop(4, 2, surface_tension=wrong)


@pytest.mark.parametrize(("dimension", "cells"), [(2, 2), (3, 1.5), (3, 2), (3, 2.5)])
@pytest.mark.parametrize("viscosity", [0.0, 0.05])
def test_small_drops_stay_together(dimension, cells, viscosity):
    """Of three to five cells across: too stiff or too soft, but they gain no energy."""
    size = np.full(dimension, 2 + 4 / cells)
    liquid = liquid_of(
        lambda x: np.linalg.norm(x, axis=1) < 1, size, 1 / cells, viscosity=viscosity
    )
    for _ in range(6):
        liquid.advance(2.0 if dimension == 2 else 0.5)
        assert rms_speed(liquid) < 0.1
    x = liquid.positions - liquid.positions.mean(axis=0)
    assert np.linalg.norm(x, axis=1).max() < 1 + 0.8 / cells
