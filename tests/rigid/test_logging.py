"""What can be logged of rigid bodies: coordinates, speeds and torques of joints, contact forces."""

import math

import numpy as np
import pytest
import substep
from substep import rigid


def test_a_pendulum_swings_at_its_period():
    """4 sqrt(l / g) K(sin(theta / 2)), of an arm so long that the bob is a point."""
    bodies, amplitude = substep.RigidBodies(step=1 / 240), 0.5
    bob = bodies.add(rigid.Sphere(0.01), (np.sin(amplitude), 0, -np.cos(amplitude)), mass=2.0)
    hinge = bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    log = substep.Logger(hinge.quantities("pivot"))
    bodies.advance(12.0, log)
    t, angle, speed = log.times, log["pivot_coordinate"] - amplitude, log["pivot_speed"]
    down = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))  # through the lowest point
    times = t[down] - angle[down] * (t[1] - t[0]) / (angle[down + 1] - angle[down])
    inertia = 1 + 0.4 * 0.01**2
    a, b = 1.0, math.cos(amplitude / 2)  # K by the arithmetic-geometric mean
    for _ in range(6):
        a, b = (a + b) / 2, math.sqrt(a * b)
    period = 2 * math.pi * math.sqrt(inertia / 9.81) / a
    np.testing.assert_allclose(np.diff(times), period, rtol=2e-5)
    fastest = math.sqrt(2 * 9.81 * (1 - math.cos(amplitude)) / inertia)
    assert speed.max() == pytest.approx(fastest, rel=1e-4)
    assert np.abs(log["pivot_torque"]).max() < 1e-12


@pytest.mark.parametrize("kind", ["hinge", "slider", "ball", "distance"])
def test_the_speed_is_the_rate_of_the_coordinate(kind):
    bodies = substep.RigidBodies(step=1 / 960, gravity=(0, 0, 0))
    a = bodies.add(rigid.Box((0.3, 0.4, 0.5)), (0, 0, 0), angular_velocities=(1, 2, 0.5))
    turn = (1, 0.2, 0.3, 0.1)
    b = bodies.add(rigid.Box((0.5, 0.2, 0.6)), (0.8, 0.1, 0.2), turn, velocities=(0.1, 0.3, 0))
    if kind == "distance":
        joint = bodies.distance(a, b, (0.1, 0.1, 0.1), (0.7, 0, 0), limits=(0, np.inf))
    elif kind == "ball":
        joint = bodies.ball(a, b, (0.4, 0.1, 0.1), axis=(1, 0.3, 0.2))
    else:
        joint = getattr(bodies, kind)(a, b, (0.4, 0.1, 0.1), (1, 0.3, 0.2))
        np.testing.assert_allclose(joint.axis, np.array([1, 0.3, 0.2]) / np.sqrt(1.13), rtol=1e-12)
    log = substep.Logger(joint.quantities())
    bodies.advance(1.0, log)
    rate = (log["joint_coordinate"][2:] - log["joint_coordinate"][:-2]) * 480
    speed = log["joint_speed"][1:-1]
    assert np.ptp(speed) > 0.01
    np.testing.assert_allclose(rate[2:-2], speed[2:-2], atol=2e-6)
    assert np.linalg.norm(joint.axis) == pytest.approx(1.0, abs=1e-12)


def test_what_motors_hold():
    """An arm of 2 kg, level, 0.5 m from its hinge; a load of 3 kg on a vertical rail."""
    bodies = substep.RigidBodies()
    arm = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (0.5, 0, 0), mass=2.0)
    hinge = bodies.hinge(arm, None, (0, 0, 0), (0, -1, 0), motor=rigid.SpeedMotor(0.0))
    load = bodies.add(rigid.Sphere(0.1), (3, 0, 0), mass=3.0)
    rail = bodies.slider(load, None, (3, 0, 0), (0, 0, 1), motor=rigid.SpeedMotor(0.25))
    hook = bodies.add(rigid.Sphere(0.1), (6, 0, -1), mass=4.0)
    rod = bodies.distance(hook, None, (6, 0, -1), (6, 0, 0))
    tied = bodies.add(rigid.Sphere(0.1), (9, 0, 0), mass=5.0)
    weld = bodies.fixed(tied, None, (8, 0, 0))
    joints = {"hinge": hinge, "rail": rail, "rod": rod, "weld": weld}
    log = substep.Logger(
        {k: v for name, j in joints.items() for k, v in j.quantities(name).items()}
    )
    bodies.advance(0.5, log)
    last = {name: values[-1] for name, values in log.arrays().items()}
    assert "weld_speed" not in last and "weld_coordinate" not in last and weld.speed == 0
    assert last["hinge_torque"] == pytest.approx(2 * 9.81 * 0.5, rel=1e-8)
    assert last["rail_force"] == pytest.approx(3 * 9.81, rel=1e-8)
    assert last["rail_speed"] == pytest.approx(0.25, abs=1e-9)
    assert last["rod_force"] == pytest.approx(-4 * 9.81, rel=1e-8)  # it holds what would go away
    np.testing.assert_allclose(last["weld_force"], [0, 0, 5 * 9.81], atol=1e-6)
    np.testing.assert_allclose(last["weld_torque"], [0, -5 * 9.81, 0], atol=1e-6)


def test_quantities_are_those_of_the_world_that_is_logged():
    bodies = substep.RigidBodies()
    bob = bodies.add(rigid.Sphere(0.1), (1, 0, 0))
    hinge = bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    other = bodies.copy()
    log = substep.Logger(hinge.quantities("a"))
    other.advance(0.25, log)
    assert hinge.coordinate == 0 and log["a_coordinate"][-1] == other.joints[0].coordinate > 0
    hinge.remove()
    for use in (hinge.quantities, lambda: hinge.speed, lambda: hinge.axis):
        with pytest.raises(IndexError, match="it was removed"):
            use()


class TestContactForces:
    def test_a_box_at_rest_weighs_what_it_should(self):
        bodies = substep.RigidBodies()
        ground = bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
        box = bodies.add(rigid.Box((1, 1, 1)), (0, 0, 0.5), mass=2.0)
        lid = bodies.add(rigid.Box((0.5, 0.5, 0.5)), (0, 0, 1.25), mass=1.0)
        log = substep.Logger(
            {
                "ground": lambda bodies: bodies.contact_force(box, ground),
                "lid": lambda bodies: bodies.contact_force(box, lid),
                "box": lambda bodies: bodies.contact_force(box),
                "on_ground": lambda bodies: bodies.contact_force(ground, box),
            }
        )
        assert bodies.contact_force(box).tolist() == [0, 0, 0]
        bodies.advance(1.0, log)
        for name, force in (("ground", 3), ("lid", -1), ("box", 2), ("on_ground", -3)):
            np.testing.assert_allclose(log[name][-1], [0, 0, force * 9.81], atol=1e-6)

    def test_friction_counts(self):
        """A box that slides is slowed by friction of 0.5 of its weight."""
        bodies = substep.RigidBodies()
        ground = bodies.add(rigid.Plane(), (0, 0, 0), motion="static", friction=0.5)
        box = bodies.add(
            rigid.Box((1, 1, 0.1)), (0, 0, 0.05), velocities=(5, 0, 0), mass=2.0, friction=0.5
        )
        bodies.advance(0.5)
        force = bodies.contact_force(box, ground)
        np.testing.assert_allclose(force, [-9.81, 0, 2 * 9.81], rtol=1e-6, atol=1e-6)

    def test_ids(self):
        bodies = substep.RigidBodies()
        box = bodies.add(rigid.Box((1, 1, 1)), (0, 0, 0.5))
        with pytest.raises(IndexError, match="other"):
            bodies.contact_force(box, 7)
        with pytest.raises(substep.InputError, match="body"):
            bodies.contact_force(1.5)
