"""Balls with springs: pendulums of torsion, and rods of links against the theory of beams."""

import math

import numpy as np
import pytest
import substep
from substep import rigid

E_I = 1.0  # bending stiffness [N m^2]
G_J = 0.7  # that of twisting
LENGTH = 1.0
LINEAR_DENSITY = 1.0  # [kg/m]


def cantilever(n, damping=0.0, gravity=(0, 0, 0)):
    """A rod along x that is held at its root, of n links."""
    bodies = substep.RigidBodies(gravity=gravity, sleeping=False)
    size, last = LENGTH / n, None
    for k in range(n):
        link = bodies.add(
            rigid.Box((size, 0.02, 0.02)), ((k + 0.5) * size, 0, 0), mass=LINEAR_DENSITY * size
        )
        part = size if k else size / 2  # half a link bends between its middle and the root
        swing, twist = E_I / part, G_J / part
        spring = rigid.TurnSpring(swing, twist, damping * swing, damping * twist)
        bodies.elastic(link, last, (k * size, 0, 0), (1, 0, 0), spring)
        last = link
    return bodies


def settle(bodies, force=(0, 0, 0), torque=(0, 0, 0), duration=20.0):
    """Under a force at the tip and a torque."""
    last = len(bodies.ids) - 1
    half = LENGTH / len(bodies.ids) / 2
    while bodies.time < duration:
        arm = turned(bodies.rotations[last], (half, 0, 0))
        bodies.set_forces([force], [last])
        bodies.set_torques([np.cross(arm, force) + torque], [last])
        bodies.step()


def turned(q, v):
    """A vector of a body in the world."""
    w, u = q[0], q[1:]
    return v + 2 * np.cross(u, np.cross(u, v) + w * np.asarray(v))


def tip(bodies):
    half = LENGTH / len(bodies.ids) / 2
    return bodies.positions[-1] + turned(bodies.rotations[-1], (half, 0, 0))


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0.6, 0, 0.8)])
def test_a_ball_on_springs_turns_as_a_pendulum_of_torsion(axis):
    """Linear in the rotation vector, it has one period at every amplitude: 2 pi sqrt(I / k)."""
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    ball = bodies.add(rigid.Sphere(0.5), (0, 0, 0), mass=2.0)
    moment = 0.4 * 2.0 * 0.25
    stiffness = 100 * moment
    joint = bodies.elastic(ball, None, (0, 0, 0), (1, 0, 0), rigid.TurnSpring(stiffness, stiffness))
    speed = 20.0  # 2 rad
    bodies.set_angular_velocities([speed * np.array(axis)])
    while bodies.time < 5:
        bodies.step()
        exact = speed / 10 * math.sin(10 * bodies.time) * np.array(axis)
        assert joint.coordinates == pytest.approx(exact, abs=8e-3)
        energy = bodies.diagnostics()["kinetic_energy"]
        energy += stiffness / 2 * float(joint.coordinates @ joint.coordinates)
        assert energy == pytest.approx(moment / 2 * speed**2, rel=1e-3)


def test_springs_of_bodies_that_tumble_keep_the_energy():
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    box = rigid.Box((0.3, 0.2, 0.1))
    one, two = bodies.add(box, [(-0.15, 0, 0), (0.15, 0, 0)], mass=1.0)
    spring = rigid.TurnSpring(0.3, 0.1, rest=(0.1, 0.2, -0.1))
    joint = bodies.elastic(two, one, (0, 0, 0), (1, 0, 0), spring)
    bodies.set_angular_velocities([(2.0, 1.0, -1.0), (-1.0, 0.5, 3.0)])
    k = np.array([0.1, 0.3, 0.3])
    energies = []
    bodies.step()
    while bodies.time < 20:
        bodies.step()
        stretch = joint.coordinates - spring.rest
        energies.append(bodies.diagnostics()["kinetic_energy"] + float(k @ stretch**2) / 2)
    assert np.ptp(energies) < 1e-3 * energies[0]


def test_damped_springs_come_to_their_rest():
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    box = bodies.add(rigid.Box((0.3, 0.2, 0.1)), (0, 0, 0), mass=1.0)
    spring = rigid.TurnSpring(1.0, 2.0, 0.1, 0.1, rest=(0.4, -1.0, 0.3))
    joint = bodies.elastic(box, None, (0, 0, 0), (0, 0, 1), spring)
    bodies.advance(10.0)
    assert joint.coordinates == pytest.approx(spring.rest, abs=1e-8)
    assert joint.coordinate == joint.coordinates[0] == pytest.approx(0.4)
    assert joint.spring == spring and joint.kind == "elastic" and joint.motor is None
    joint.spring = rigid.TurnSpring(1.0, 2.0, 0.1, 0.1)
    bodies.advance(10.0)
    assert joint.coordinates == pytest.approx(np.zeros(3), abs=1e-8)


@pytest.mark.parametrize("n", [2, 4, 8, 16])
def test_rods_bend_under_a_load_at_the_tip(n):
    """P L^3 / (3 E I) of Euler and Bernoulli, which links approach by 1 / (2 n^2) of it."""
    bodies = cantilever(n, damping=0.5)
    settle(bodies, force=(0, 0, -1e-3))
    beam = 1e-3 * LENGTH**3 / (3 * E_I)
    assert tip(bodies)[2] == pytest.approx(-beam * (1 + 0.5 / n**2), rel=1e-6)
    root = bodies.joints[0]
    assert root.force == pytest.approx([0, 0, 1e-3], abs=1e-9)
    assert root.torque == pytest.approx([0, -1e-3 * LENGTH, 0], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("n", [4, 16])
def test_rods_bend_under_their_weight(n):
    """w L^4 / (8 E I), which links approach by 1 / n^2 of it."""
    bodies = cantilever(n, damping=0.5, gravity=(0, 0, -1e-3))
    settle(bodies)
    beam = 1e-3 * LINEAR_DENSITY * LENGTH**4 / (8 * E_I)
    assert tip(bodies)[2] == pytest.approx(-beam * (1 + 1 / n**2), rel=1e-6)


def test_rods_twist_by_torque_and_length():
    bodies = cantilever(8, damping=0.5)
    settle(bodies, torque=(0.5, 0, 0))
    angle = 2 * math.atan2(bodies.rotations[-1, 1], bodies.rotations[-1, 0])
    assert angle == pytest.approx(0.5 * (LENGTH - LENGTH / 16) / G_J, rel=1e-9)


def test_rods_bend_to_an_arc():
    """A moment M bends a rod to an arc of the radius E I / M, however far."""
    n, moment = 40, math.pi / 2 * E_I / LENGTH
    bodies = cantilever(n, damping=0.5)
    while bodies.time < 25:
        bodies.set_torques([(0, -min(bodies.time / 5, 1) * moment, 0)], [n - 1])
        bodies.step()
    for k, joint in enumerate(bodies.joints):
        part = 1.0 if k else 0.5
        assert joint.coordinates == pytest.approx([0, -part * math.pi / 2 / n, 0], abs=1e-7)
        assert joint.torque == pytest.approx([0, moment, 0], abs=1e-6)
    radius = E_I / moment
    assert tip(bodies) == pytest.approx([radius, 0, radius], abs=0.02)


def test_rods_swing_with_the_period_of_the_beam():
    """The first mode of a cantilever, 1.87510407^2 sqrt(E I / (linear density L^4))."""
    bodies = cantilever(16, damping=0.5)
    settle(bodies, force=(0, 0, -1e-2))
    for joint in bodies.joints:
        spring = joint.spring
        joint.spring = rigid.TurnSpring(spring.swing, spring.twist)
    z = []
    bodies.advance(20.0, lambda b: z.append(b.positions[-1, 2]))
    z = np.array(z)
    k = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
    rises = (k - z[k] / (z[k + 1] - z[k])) / 60
    period = (rises[-1] - rises[0]) / (len(rises) - 1)
    exact = math.tau / (1.87510407**2 * math.sqrt(E_I / LINEAR_DENSITY) / LENGTH**2)
    assert period == pytest.approx(exact, rel=5e-3)


def test_an_elastic_joint_has_no_limits_and_no_motor():
    bodies = cantilever(2)
    joint = bodies.joints[1]
    with pytest.raises(substep.InputError, match="have no limits"):
        joint.limits = (0, 1)
    with pytest.raises(substep.InputError, match="motor: only"):
        joint.motor = rigid.SpeedMotor(1.0)
    assert joint.limits == (-math.inf, math.inf) and joint.motor is None
    assert bodies.joints[0].spring.swing == 2 * joint.spring.swing


@pytest.mark.parametrize("damping", [0.0, 1e-3])  # as a part of the stiffness [s]
def test_a_rod_of_stiff_links_that_falls_on_the_floor_gains_nothing(damping):
    # An aluminium rod of 1 m and 10 mm: its links would swing at 1000 rad/s and more.
    bodies = substep.RigidBodies()
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
    turn = (math.cos(0.15), 0, -math.sin(0.15), 0)
    spring = rigid.TurnSpring(233.0, 187.0, 233.0 * damping, 187.0 * damping)
    last = None
    for i in range(4):
        at = np.array([0.25 * i, 0, 0.5 + 0.08 * i])
        link = bodies.add(rigid.Box((0.25, 0.01, 0.01)), at, turn, mass=0.0675)
        if last is not None:
            axis = (math.cos(0.3), 0, math.sin(0.3))
            bodies.elastic(link, last, at - (0.12, 0, 0.04), axis, spring)
        last = link
    start = bodies.diagnostics()["energy"]
    while bodies.time < 2:
        bodies.step()
        assert bodies.diagnostics()["energy"] < start * (1 + 1e-6)
