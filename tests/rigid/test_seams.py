"""What slides from one body onto the next whose face lies in the same plane."""

import math

import numpy as np
import pytest
import substep
from substep import geometry, rigid

G = 9.81
HULL = rigid.ConvexHull(
    [(x, y, z) for x in (-0.15, 0.15) for y in (-0.1, 0.1) for z in (-0.05, 0.05)]
)
TILE = 0.25  # length along x [m]


def tiles(step, kind, friction, lower=0.0, gap=0.0):
    """A row along x, whose top is at 0; each is lower than the last one."""
    bodies = substep.RigidBodies(step=step)
    tile = rigid.Box((TILE - gap, 2, 0.2))
    x = np.array([((k - 2) * TILE, 0, -0.1 - lower * max(k - 2, 0)) for k in range(28)])
    if kind == "compound":
        parts = [rigid.Box(tile.lengths, center=tuple(place)) for place in x]
        bodies.add(parts, (0, 0, 0), motion="static", friction=friction)
    elif kind == "mesh":
        half = TILE / 2 - gap / 2
        corners = [(x, y, 0.1) for x in (-half, half) for y in (-1, 1)]
        bodies.add(
            geometry.TriangleMesh(corners, [(0, 2, 3), (0, 3, 1)]),
            x,
            motion="static",
            friction=friction,
        )
    elif kind == "dynamic":
        bodies.add(rigid.Plane(), (0, 0, -0.2), motion="static", friction=1)
        bodies.add(tile, x, mass=1000, friction=friction)
    else:
        bodies.add(tile, x, motion="static", friction=friction)
    return bodies


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize("speed", [0.05, 1.0, 4.0])
@pytest.mark.parametrize("kind", ["static", "compound", "dynamic", "mesh"])
def test_a_box_slides_over_seams_as_over_one_face(kind, speed, step):
    """By v^2 / (2 mu g), and straight on."""
    friction = 0.2 if speed > 0.5 else 0.001
    bodies = tiles(step, kind, friction)
    box = bodies.add(
        rigid.Box((0.3, 0.3, 0.1)),
        (0.07, 0, 0.05),
        velocities=(speed, 0, 0),
        mass=1,
        friction=friction,
    )
    heights = []
    bodies.advance(3.0, lambda b: heights.append(b.positions[-1, 2]))
    way = speed**2 / (2 * friction * G) if speed > 0.5 else speed * 3 - friction * G * 4.5
    travel = bodies.positions[bodies.rows(box)] - (0.07, 0, 0.05)
    assert travel[0] == pytest.approx(way, abs=speed * step)
    assert abs(travel[1]) < 1e-3
    assert max(heights) < 0.05 + 1e-4


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize("speed", [1.0, 4.0])
@pytest.mark.parametrize("kind", ["static", "mesh"])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 1, 0), (1, 0, 0)])
@pytest.mark.parametrize("shape", [rigid.Cylinder(0.05, 0.3), rigid.Capsule(0.05, 0.3)])
def test_round_bodies_slide_over_seams_as_over_one_face(shape, axis, kind, speed, step):
    """Standing up, which only cylinders do, and lying along and across their way."""
    if axis == (0, 0, 1):
        shape = rigid.Cylinder(0.1, 0.1)
    bodies = tiles(step, kind, 0.0)
    turn = (1, -axis[1], axis[0], 0) if axis[2] == 0 else (1, 0, 0, 0)
    body = bodies.add(shape, (0.1, 0, 0.05), turn, velocities=(speed, 0, 0), friction=0)
    bodies.advance(2 / speed)
    row = bodies.rows(body)
    assert bodies.positions[row, 0] == pytest.approx(2.1, abs=1e-3)
    assert bodies.positions[row, 2] == pytest.approx(0.05, abs=1.5e-4)
    assert bodies.velocities[row] == pytest.approx((speed, 0, 0), abs=1e-3)


@pytest.mark.parametrize("kind", ["static", "mesh"])
@pytest.mark.parametrize("shape", [rigid.Cylinder(0.05, 0.3), rigid.Capsule(0.05, 0.3)])
def test_what_rolls_goes_on_over_seams(shape, kind):
    bodies = tiles(1 / 60, kind, 0.5)
    across = (1, 1, 0, 0)
    bodies.add(
        shape,
        (0.1, 0, 0.05),
        across,
        velocities=(4, 0, 0),
        angular_velocities=(0, 80, 0),
        friction=0.5,
    )
    bodies.advance(0.5)
    assert bodies.velocities[-1] == pytest.approx((4, 0, 0), abs=4e-3)
    assert bodies.positions[-1, 2] == pytest.approx(0.05, abs=1.5e-4)


@pytest.mark.parametrize("kind", ["static", "mesh"])
@pytest.mark.parametrize("lower", [1e-6, 5e-5, 1e-4])
@pytest.mark.parametrize("shape", [rigid.Box((0.3, 0.2, 0.1)), HULL], ids=["box", "hull"])
def test_steps_down_and_gaps_stop_nothing(shape, lower, kind):
    bodies = tiles(1 / 60, kind, 0.05, lower, gap=1e-3)
    one = bodies.add(shape, (0, 0, 0.05), velocities=(2, 0, 0), mass=1, friction=0.05)
    bodies.advance(2.0)
    assert bodies.positions[bodies.rows(one), 0] == pytest.approx(4 - 0.05 * G * 2, abs=0.04)


def test_a_box_is_carried_from_one_belt_to_the_next():
    bodies = substep.RigidBodies()
    belt = rigid.Box((2, 1, 0.2))
    bodies.add(belt, [(0, 0, -0.1), (2, 0, -0.1)], motion="kinematic", velocities=(1, 0, 0))
    box = bodies.add(rigid.Box((0.3, 0.3, 0.3)), (0.5, 0, 0.15), velocities=(2, 0, 0), friction=0)
    bodies.advance(0.8)
    assert bodies.velocities[bodies.rows(box)] == pytest.approx((2, 0, 0), abs=1e-3)


@pytest.mark.parametrize("height", [1e-3, 0.05])
@pytest.mark.parametrize("speed", [0.05, 2.0])
def test_a_curb_stops_what_comes(height, speed):
    """One that is higher than bodies that touch overlap."""
    bodies = substep.RigidBodies()
    bodies.add(rigid.Box((2, 2, 0.2)), (0, 0, -0.1), motion="static", friction=0)
    bodies.add(rigid.Box((2, 2, 0.2)), (2, 0, -0.1 + height), motion="static", friction=0)
    box = bodies.add(rigid.Box((0.2, 0.2, 0.01)), (0.8, 0, 0.005), velocities=(speed, 0, 0))
    bodies.advance(4.0)
    row = bodies.rows(box)
    assert abs(bodies.velocities[row, 0]) < 0.02
    assert bodies.positions[row, 0] < 0.9 + 1e-3


def test_what_comes_up_between_others_is_met():
    """A block that rises out of the floor stops a box that slides towards it."""
    bodies = substep.RigidBodies()
    floor = rigid.Box((1, 1, 0.2))
    bodies.add(floor, [(0, 0, -0.1), (1.5, 0, -0.1)], motion="static", friction=0)
    bodies.add(rigid.Box((0.5, 1, 0.2)), (0.75, 0, -0.1), motion="kinematic", velocities=(0, 0, 1))
    box = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (0.2, 0, 0.1), velocities=(1, 0, 0), friction=0)
    bodies.advance(0.15)
    assert bodies.positions[bodies.rows(box), 0] < 0.4 + 1e-3


def test_a_box_falls_past_an_edge_that_it_touches():
    """Along a wall whose ledge ends where the box begins."""
    bodies = substep.RigidBodies()
    bodies.add(
        rigid.Box((1, 1, 1)), [(-0.5, 0, z) for z in (0.5, 1.5, 2.5)], motion="static", friction=0
    )
    box = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (0.1, 0, 2.8), friction=0)
    bodies.advance(0.5)
    fallen = 2.8 - bodies.positions[bodies.rows(box), 2]
    assert fallen == pytest.approx(G * 0.125, abs=G * 0.5 / 60)
    assert math.hypot(*bodies.angular_velocities[bodies.rows(box)]) < 1e-6
