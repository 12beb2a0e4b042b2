"""A rubber gate under a column of water (Antoci, Gallati and Sibilla 2007).

Displacements of its free end in time, as digitised in ../shared/reference/coupling.json. Those who
computed it took 10 to 12 MPa for the rubber, that of small strains: it softens as it stretches.
"""

import numpy as np
import pytest
import substep

WIDTH, HEIGHT = 0.1, 0.14  # of the water [m]
LENGTH, THICKNESS, GAP = 0.079, 0.005, 0.0025  # of the gate, and below it
POISSON, DENSITY = 0.4, 1100.0
EXPERIMENT = [  # [s], [mm]
    (0.0024, -0.29),
    (0.0436, 12.89),
    (0.0835, 33.87),
    (0.1213, 43.84),
    (0.1616, 46.02),
    (0.2031, 44.0),
    (0.24, 42.79),
    (0.2792, 40.57),
    (0.3218, 39.74),
    (0.361, 36.93),
]
CELLS = 24  # along the gate


def gate(depth, modulus, **options):
    """Tetrahedra that are held at their top; their bending locks, see `bending`."""
    mesh = substep.geometry.box_tetrahedra((THICKNESS, depth, LENGTH), (2, 2, CELLS))
    x = mesh.vertices + np.array([THICKNESS / 2, depth / 2, GAP + LENGTH / 2])
    return substep.SoftBody(
        x,
        mesh.tetrahedra,
        density=DENSITY,
        young_modulus=modulus,
        poisson_ratio=0.0,
        pinned=x[:, 2] > GAP + LENGTH - 1e-9,
        **options,
    )


def wet_side(body):
    x = body.positions
    return body.faces[(x[body.faces][:, :, 0] < 1e-9).all(axis=1)]


def bending(depth, modulus):
    """How far it bends under a small even load, over w = q L^4 / 8 D of a strip."""
    body, load = gate(depth, modulus, damping_time=0.05, gravity=(0, 0, 0)), 20.0
    x, side = body.positions.copy(), wet_side(body)
    p = x[side]
    areas = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    forces = load * np.bincount(side.ravel(), np.repeat(areas / 3, 3), len(x))
    for _ in range(60):
        body.set_forces(np.outer(forces, [1, 0, 0]))
        body.step(0.02)
    end = x[:, 2] < GAP + 1e-9
    return (body.positions - x)[end, 0].mean() * 8 * modulus * THICKNESS**3 / 12 / load / LENGTH**4


def opening(young, duration):
    """Times and displacements of its free end [s], [mm].

    A sheet of the thickness of a spacing stands for its wet side. It is as stiff as a strip of the
    rubber in bending.
    """
    d, step = 0.005, 1 / 480
    depth, half = 5 * d, d / 2
    strip = young / (1 - POISSON**2)
    body = gate(depth, strip * bending(depth, strip), step=step)
    x, side = body.positions.copy(), wet_side(body)
    wet = side[(x[side][:, :, 2] > GAP + LENGTH / CELLS - 1e-9).all(axis=1)]  # its edge is round
    walls = [
        substep.Plane(),
        substep.Plane((1, 0, 0), (-WIDTH - half, 0, 0)),
        substep.Plane((0, 1, 0)),
        substep.Plane((0, -1, 0), (0, depth, 0)),
        substep.Box((THICKNESS + half, 1, 0.4), ((THICKNESS - half) / 2, 0, GAP + LENGTH + 0.2)),
    ]
    water = substep.PositionBasedFluid(
        substep.fill_box((-WIDTH - half, 0, 0), (-half, depth, HEIGHT), d),
        d,
        colliders=[*map(substep.Collider, walls), *body.make_colliders(d, faces=wet)],
    )
    world = substep.World({"water": water, "gate": body}, step=step)
    end, times, opened = x[:, 2] < GAP + 1e-9, [0.0], [0.0]
    while world.time < duration:
        world.advance(0.01)
        times.append(world.time)
        opened.append(1e3 * (body.positions - x)[end, 0].mean())
    return np.array(times), np.array(opened)


@pytest.mark.slow
def test_a_gate_of_rubber_under_a_column_of_water():
    """It opens as measured within 5 mm for 0.1 s, and by 39 mm of 46 (their own SPH: 50)."""
    times, opened = opening(1e7, 0.16)
    measured = np.interp(times, *np.transpose(EXPERIMENT))
    early = times < 0.105
    assert np.abs(opened - measured)[early].max() < 5
    assert np.abs(opened - measured)[early].mean() < 3
    assert 0.8 * 46 < max(opened) < 50
    assert 0.1 < times[int(np.argmax(opened))] < 0.16


@pytest.mark.slow
def test_a_gate_as_soft_as_stretched_rubber_follows_the_whole_series():
    """With the modulus that fits, all measurements lie within 15 % of the largest one.

    It opens by as much as the rubber, and neither closes before it nor far below it.
    """
    times, opened = opening(5.5e6, 0.365)
    when, measured = np.transpose(EXPERIMENT)
    assert np.abs(np.interp(when, times, opened) - measured).max() < 0.15 * 46
    assert max(opened) == pytest.approx(46.02, rel=0.05)
    assert times[int(np.argmax(opened))] == pytest.approx(0.1616, abs=0.025)
