"""Ropes of light links under heavy loads, over a drum, at the default step."""

import contextlib
from itertools import pairwise

import numpy as np
import pytest
import substep
from numpy import cos, exp, linspace, pi, sin
from substep import rigid

G = 9.81
RADIUS, THICK, HANGING = 0.2, 0.004, 0.2  # of the drum, of the rope; on both sides [m]


def rope_over_drum(spin, *, friction=0.3, load=1.0, mass=0.05, links=40, step=1 / 60):
    """The bodies, and the joint that holds the rope at the other end than the load."""
    length = 2 * HANGING + pi * RADIUS
    along = linspace(0, length, links + 1)
    angle = pi - np.clip((along - HANGING) / RADIUS, 0, pi)
    below = np.maximum(HANGING - along, 0) + np.maximum(along - length + HANGING, 0)
    r = RADIUS + THICK
    x = np.stack([r * cos(angle), 0 * angle, r * sin(angle) - below], 1)
    bodies = substep.RigidBodies(step=step, sleeping=False)
    lying = (cos(pi / 4), sin(pi / 4), 0, 0)
    motion = dict(motion="kinematic", angular_velocities=(0, spin, 0))
    bodies.add(substep.Cylinder(RADIUS, 0.2), (0, 0, 0), lying, friction=friction, **motion)
    joints, last = [], None
    for start, end in pairwise(x):
        d = end - start
        half = np.arctan2(d[0], d[2]) / 2
        link = bodies.add(
            substep.Capsule(THICK, np.linalg.norm(d)),
            (start + end) / 2,
            (cos(half), 0, sin(half), 0),
            mass=mass / links,
            friction=friction,
        )
        joints.append(bodies.hinge(link, last, start, (0, 1, 0)))
        last = link
    weight = bodies.add(substep.Sphere(0.02), x[-1] - (0, 0, 0.05), mass=load, friction=0)
    bodies.ball(weight, last, x[-1])
    return bodies, joints[0]


@pytest.mark.parametrize(
    "spin, options",
    [
        (3, {}),
        (-3, {}),
        (3, {"links": 80}),
        (3, {"load": 2.0}),
        (3, {"friction": 0.1}),
        (3, {"step": 1 / 30}),
        (3, {"step": 1 / 240}),
    ],
)
def test_a_light_rope_over_a_turning_drum_holds_a_heavy_load(spin, options):
    # Euler's (capstan) ratio of the forces at both ends; half of the hanging rope is on each.
    bodies, held = rope_over_drum(spin, **options)
    forces, error = [], 0
    while bodies.time < 2:
        bodies.step()
        told = bodies.diagnostics()
        error = max(error, told["joint_error"])
        assert told["kinetic_energy"] < 0.1
        if bodies.time > 1:
            forces.append(np.linalg.norm(held.force))
    hanging = 0.05 * G * HANGING / (2 * HANGING + pi * RADIUS)
    ratio = exp(np.sign(spin) * options.get("friction", 0.3) * pi)
    load = options.get("load", 1.0) * G
    assert error < 1e-5
    assert np.mean(forces) == pytest.approx((load + hanging) * ratio - hanging, rel=0.03)


def test_a_rope_over_a_drum_at_rest_stays():
    bodies, _ = rope_over_drum(0)
    placed = bodies.positions.copy()
    bodies.advance(3)
    assert np.abs(bodies.positions - placed).max() < 2e-3
    assert bodies.diagnostics()["kinetic_energy"] < 1e-6
    assert bodies.diagnostics()["joint_error"] < 1e-7


def swing_from_level(step):
    """A chain of 10 m in 100 links, let go level: errors of joints, and energies."""
    bodies = substep.RigidBodies(step=step, sleeping=False)
    last = None
    for k in range(100):
        lying = (cos(pi / 4), 0, sin(pi / 4), 0)
        link = bodies.add(substep.Capsule(0.01, 0.08), (0.1 * k + 0.05, 0, 0), lying, mass=0.1)
        bodies.hinge(link, last, (0.1 * k, 0, 0), (0, 1, 0))
        last = link
    errors, energies = [], []
    while bodies.time < 3 - step / 2:
        bodies.step()
        told = bodies.diagnostics()
        errors.append(told["joint_error"])
        energies.append(told["energy"])
    return np.max(errors), np.array(energies)


@pytest.mark.parametrize(("step", "least"), [(1 / 60, -10.0), (1 / 240, -0.1)])
def test_a_chain_let_go_level_whips_and_holds(step, least):
    error, energies = swing_from_level(step)
    assert error < 1e-9
    assert energies.max() < 1e-3 * 490  # of m g l / 2, and at first it is 0
    assert energies.min() > least  # as its end whips round


@pytest.mark.parametrize("links", [10, 40, 80])
def test_a_light_rope_that_swings_with_a_heavy_load_keeps_its_energy(links):
    tilt, length = pi / 3, 1.0
    bodies = substep.RigidBodies(step=1 / 60, sleeping=False)
    down = np.array([sin(tilt), 0, -cos(tilt)])
    turn, last = (cos(tilt / 2), 0, -sin(tilt / 2), 0), None
    for k in range(links):
        middle = (k + 0.5) / links * length * down
        shape = substep.Capsule(THICK, length / links)
        link = bodies.add(shape, middle, turn, mass=0.05 / links)
        bodies.hinge(link, last, k / links * length * down, (0, 1, 0))
        last = link
    weight = bodies.add(substep.Sphere(0.02), 1.02 * length * down, mass=1.0)
    bodies.ball(weight, last, length * down)
    start, swing = bodies.diagnostics()["energy"], G * length * (1 - cos(tilt))
    while bodies.time < 10:
        bodies.step()
        told = bodies.diagnostics()
        assert told["joint_error"] < 1e-8
        assert -0.03 * swing < told["energy"] - start < 1e-5 * swing


def test_a_sling_of_light_links_keeps_its_energy_or_says_so():
    # A trebuchet without friction or contact: 300 kg throw 3 kg on eight links of together 4 kg.
    bodies = substep.RigidBodies(sleeping=False)
    alone = {"group": 0, "mask": 0}
    along = (cos(pi / 4), 0, sin(pi / 4), 0)
    beam = bodies.add(rigid.Box((5, 0.1, 0.1)), (1.5, 0, 3), mass=30.0, **alone)
    bodies.hinge(beam, None, (0, 0, 3), (0, 1, 0))
    weight = bodies.add(rigid.Sphere(0.3), (-1, 0, 2.4), mass=300.0, **alone)
    bodies.hinge(weight, beam, (-1, 0, 3), (0, 1, 0))
    last, n, length = beam, 8, 3.0 / 8
    for i in range(n):
        x = 4 - (i + 0.5) * length
        link = bodies.add(rigid.Capsule(0.01, length, rotation=along), (x, 0, 3), mass=0.5, **alone)
        bodies.ball(link, last, (4 - i * length, 0, 3))
        last = link
    stone = bodies.add(rigid.Sphere(0.1), (1, 0, 3), mass=3.0, **alone)
    bodies.ball(stone, last, (1, 0, 3))
    start = bodies.diagnostics()["energy"]
    with contextlib.suppress(substep.SolverError):
        while bodies.time < 6:
            bodies.step()
            assert bodies.diagnostics()["energy"] < start + 200
