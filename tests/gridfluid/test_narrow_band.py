"""Liquids whose particles are near the surface only, beside those that are full of them."""

import math

import numpy as np
import pytest
import substep

from .test_liquid import G, half_cells, lattice, pool


def mass(liquid):
    """Of particles and deep cells, in full cells."""
    told = liquid.diagnostics()
    return told["count"] / 2 ** len(liquid.shape) + told["deep_cells"]


def test_a_deep_pool_stays_at_rest_under_its_hydrostatic_pressure():
    """As with particles everywhere; deep is what is more than 4 cells below the surface."""
    liquid = pool(32, narrow_band=4, tolerance=1e-7)
    for _ in range(100):
        liquid.step(0.005)
    assert liquid.diagnostics()["deep_cells"] == 32 * 12
    assert len(liquid) == 4 * 32 * 4
    assert np.abs(liquid.velocities).max() < 2e-5 * math.sqrt(G * 0.5)
    assert np.abs(liquid.cell_velocities).max() < 2e-5 * math.sqrt(G * 0.5)
    z = (np.arange(16) + 0.5) / 32
    assert np.allclose(liquid.pressure[:, :16], 1000 * G * (0.5 - z), atol=1e-4 * 1000 * G * 0.5)
    assert liquid.depth([[0.5]]) == pytest.approx(0.5, abs=0.05 / 32)


@pytest.mark.figure
@pytest.mark.parametrize("depth", [0.5, 1.0])
@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_deep_water_sloshes_with_the_period_of_linear_waves(depth, transfer):
    """w^2 = g k tanh(k h), k = pi / L (Lamb, Hydrodynamics, art. 228), by the depths."""
    n, k = 64, np.pi
    period = 2 * np.pi / math.sqrt(G * k * math.tanh(k * depth))
    liquid = pool(n, depth, amplitude=2 / n, transfer=transfer, narrow_band=4)
    x = ((np.arange(n) + 0.5) / n)[:, None]
    times, heights = [], []

    def note(at):
        times.append(at.time)
        heights.append(at.depth(x))

    liquid.advance(5.3 * period, note)
    t, h = np.array(times), np.array(heights)
    mode = h @ np.cos(k * x[:, 0])
    at = np.flatnonzero((mode[:-1] > 0) != (mode[1:] > 0))
    zeros = t[at] - mode[at] * (t[at + 1] - t[at]) / (mode[at + 1] - mode[at])
    assert 2 * np.diff(zeros).mean() == pytest.approx(period, rel=5e-3)
    assert np.abs(mode[at[-2] : at[-1]]).max() > 0.85 * np.abs(mode).max()
    assert np.abs(h.mean(axis=1) / depth - 1).max() < 0.005
    assert mass(liquid) == pytest.approx(n * n * depth, rel=0.005)
    assert len(liquid) < 0.2 * 4 * n * n * depth


def test_the_volume_does_not_drift():
    """Waves of three cells, half a minute."""
    n = 32
    liquid = pool(n, 0.5, amplitude=3 / n, narrow_band=4)
    x = ((np.arange(n) + 0.5) / n)[:, None]
    for _ in range(6):
        liquid.advance(5.0)
        assert liquid.depth(x).mean() == pytest.approx(0.5, rel=0.01)
        assert mass(liquid) == pytest.approx(n * n / 2, rel=0.01)


@pytest.mark.parametrize("transfer", ["apic", "flip", "pic"])
def test_totals_are_those_of_particles_everywhere(transfer):
    """What stands on the grid counts: after one step what is told is the same."""
    told = []
    for band in (None, 3):
        liquid = pool(64, amplitude=2 / 64, transfer=transfer, narrow_band=band)
        liquid.step(0.01)
        told.append(liquid.diagnostics())
    full, narrow = told
    assert narrow["count"] < 0.3 * full["count"]
    assert narrow["kinetic_energy"] == pytest.approx(full["kinetic_energy"], rel=5e-3)
    for name in ("gravitational_energy", "momentum_x"):
        assert narrow[name] == pytest.approx(full[name], rel=2e-3)
    lever = 0.5 * abs(full["momentum_x"])
    assert narrow["angular_momentum_z"] == pytest.approx(
        full["angular_momentum_z"], abs=5e-3 * lever
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_stream_keeps_its_momentum(dimension):
    """A layer that flows through a periodic box, the deep part as the rest."""
    cell = 1 / 16
    x = lattice(*[half_cells(0, 1, cell)] * dimension)
    v = np.zeros(x.shape)
    v[:, 0] = 1.0
    liquid = substep.GridLiquid(
        x,
        cell=cell,
        bounds=((0,) * dimension, (1,) * (dimension - 1) + (1.5,)),
        velocities=v,
        sides=["periodic"] + ["wall"] * (dimension - 1),
        narrow_band=3,
        tolerance=1e-7,
    )
    for _ in range(20):
        liquid.step(0.03)
    assert liquid.diagnostics()["deep_cells"] > 0.7 * 16**dimension
    assert liquid.diagnostics()["momentum_x"] == pytest.approx(1000, rel=1e-4)
    assert np.abs(liquid.velocities - v[0]).max() < 2e-4


def test_a_vortex_below_keeps_more_of_its_energy_than_with_particles():
    """Steady for Euler's equations: u = (sin cos, -cos sin) in a square that is full."""
    n, kept = 32, []
    axis = half_cells(0, 1, 1 / n)
    a, b = (np.pi * lattice(axis, axis)).T
    v = np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], axis=1)
    for band in (None, 4):
        liquid = substep.GridLiquid(
            lattice(axis, axis),
            cell=1 / n,
            bounds=((0, 0), (1, 1)),
            velocities=v,
            gravity=(0, 0),
            narrow_band=band,
        )
        before = liquid.diagnostics()["kinetic_energy"]
        liquid.advance(1.0)
        kept.append(liquid.diagnostics()["kinetic_energy"] / before)
    assert len(liquid) == 0
    assert kept[1] > 0.85
    assert kept[1] > kept[0]


@pytest.mark.figure
def test_a_dam_break_has_the_front_of_particles_everywhere():
    a, n = 1.0, 32
    x = lattice(half_cells(0, a, a / n), half_cells(0, 2 * a, a / n))
    fronts = []
    for band in (None, 4):
        liquid = substep.GridLiquid(
            x, cell=a / n, bounds=((0, 0), (6 * a, 2.5 * a)), narrow_band=band
        )
        front = []
        for _ in range(8):
            liquid.advance(0.08)
            wet = liquid.level_set[:, 0] < 0
            ends = np.flatnonzero(wet)[-1]
            phi = liquid.level_set[ends : ends + 2, 0]
            front.append((ends + 0.5) * a / n + a / n * phi[0] / (phi[0] - phi[1]))
        fronts.append(front)
    assert np.abs(np.array(fronts[1]) / fronts[0] - 1).max() < 0.03
    assert fronts[0][-1] > 2.5 * a


def test_a_ball_in_deep_water_is_lifted_as_with_particles():
    """Particles are around it; Archimedes, and the same within half a percent."""
    cell, lifts = 1 / 24, []
    x = lattice(*[half_cells(0, high, cell) for high in (1, 1, 1)])
    for band in (None, 3):
        ball = substep.Collider(substep.Sphere(0.2, center=(0.5, 0.5, 0.35)))
        liquid = substep.GridLiquid(
            x[ball.distance(x) > 0],
            cell=cell,
            bounds=((0, 0, 0), (1, 1, 1.25)),
            colliders=[ball],
            narrow_band=band,
        )
        liquid.advance(0.2)
        lifts.append(ball.impulse[2] / ball.duration / (1000 * G * 4 / 3 * np.pi * 0.2**3))
    assert liquid.diagnostics()["deep_cells"] > 3000
    near = np.linalg.norm(liquid.positions - (0.5, 0.5, 0.35), axis=1)
    assert (near < 0.2 + 2 * cell).any()
    assert lifts[1] == pytest.approx(lifts[0], rel=5e-3)
    assert lifts[1] == pytest.approx(1, abs=0.03)


def test_a_sink_drains_deep_water_and_an_emitter_fills_it():
    """The level by what went, and as with particles everywhere by what came."""
    cell = 1 / 32
    x = lattice(half_cells(0, 1, cell), half_cells(0, 1, cell))
    options = {"cell": cell, "bounds": ((0, 0), (1, 1.25)), "narrow_band": 3}
    columns = ((np.arange(32) + 0.5) / 32)[:, None]
    drain = substep.Sink(substep.Sphere(0.06, (0.5, 0.1, 0)))
    liquid = substep.GridLiquid(x, sinks=[drain], **options)
    liquid.advance(0.3)
    gone = liquid.absorbed[0] * cell**2 / 4
    assert gone > 0.02
    assert liquid.depth(columns).mean() == pytest.approx(1 - gone, abs=0.01)
    levels = []
    for band in (None, 3):
        tap = substep.Emitter((0.5, 0.3), (0, 1), 0.1, radius=0.1)
        liquid = substep.GridLiquid(x, emitters=[tap], **(options | {"narrow_band": band}))
        liquid.advance(1.0)
        levels.append(liquid.depth(columns).mean())
    assert liquid.emitted[0] * cell**2 / 4 > 0.02
    assert levels[1] == pytest.approx(levels[0], abs=0.003)
    assert levels[1] > 1.015


def breaking(**options):
    """A step of water that falls into a deep pool."""
    cell = 1 / 16
    x = lattice(half_cells(0, 1, cell), half_cells(0, 0.5, cell), half_cells(0, 1, cell))
    x = x[(x[:, 2] < 0.75) | (x[:, 0] < 0.5)]
    bounds = ((0, 0, 0), (1, 0.5, 1.25))
    return substep.GridLiquid(x, cell=cell, bounds=bounds, narrow_band=3, **options)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_bits_do_not_depend_on_threads_nor_on_a_checkpoint(dtype, tmp_path):
    runs = []
    for threads in (1, 2, 3):
        liquid = breaking(threads=threads, dtype=dtype)
        for k in range(20):
            liquid.step(0.02)
            if threads == 2 and k == 9:
                liquid.save(tmp_path / "state")
                liquid = breaking(threads=2, dtype=dtype)
                liquid.load(tmp_path / "state")
        runs.append(liquid.state())
    assert runs[0]["deep"].sum() > 100 and runs[0]["seeded"] > 1000
    for other in runs[1:]:
        assert all(np.array_equal(runs[0][name], other[name]) for name in runs[0])


def test_what_cannot_be_is_refused():
    for wrong, told in ((2, "from 3 to"), (2.5, "integer"), (True, "integer")):
        with pytest.raises(substep.InputError, match=f"narrow_band.*{told}"):
            pool(8, narrow_band=wrong)
    with pytest.raises(substep.InputError, match="narrow_band"):
        pool(8, narrow_band=4, viscosity=0.1)
    liquid = breaking()
    with pytest.raises(substep.InputError, match=r"forces.*narrow_band"):
        liquid.set_forces(np.zeros(liquid.positions.shape))
    liquid.step(0.01)
    before = liquid.state()
    state = dict(before)
    state["deep"] = state["deep"] + np.uint8(2)
    with pytest.raises(substep.InputError, match="deep"):
        liquid.restore(state)
    after = liquid.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)
