"""Pendulums whose bobs are small for their arms: a force off its line whirls the bob around."""

import numpy as np
import pytest
import substep

G = 9.81


def energy(bodies):
    return bodies.diagnostics()["energy"]


@pytest.mark.parametrize(
    ("radius", "arm", "degrees"), [(1e-3, 1.0, 150), (1e-4, 1.0, 5), (0.01, 20.0, 150)]
)
def test_a_small_bob_on_a_long_arm_keeps_its_energy(radius, arm, degrees):
    bodies = substep.RigidBodies()
    t = np.radians(degrees)
    bob = bodies.add(substep.Sphere(radius), (arm * np.sin(t), 0, -arm * np.cos(t)), mass=1.0)
    bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    start = energy(bodies)
    while bodies.time < 60:
        bodies.step()
        assert energy(bodies) == pytest.approx(start, abs=1e-4 * G * arm * (1 - np.cos(t)))
        assert bodies.diagnostics()["joint_error"] < 1e-5


@pytest.mark.parametrize("joint", ["hinge", "ball"])
@pytest.mark.parametrize("radius", [1e-4, 1e-3, 1e-2])
def test_a_double_pendulum_of_point_masses_keeps_its_energy(radius, joint):
    bodies = substep.RigidBodies(sleeping=False)
    t = np.radians([120, -10])
    ways = np.stack([np.sin(t), 0 * t, -np.cos(t)], axis=1)
    at = np.cumsum(ways, axis=0)
    a, b = (bodies.add(substep.Sphere(radius), x, mass=1.0) for x in at)
    if joint == "hinge":
        bodies.hinge(a, None, (0, 0, 0), (0, 1, 0))
        bodies.hinge(b, a, at[0], (0, 1, 0))
    else:
        bodies.ball(a, None, (0, 0, 0))
        bodies.ball(b, a, at[0])
    start = energy(bodies)
    while bodies.time < 10:
        bodies.step()
        assert energy(bodies) == pytest.approx(start, abs=1e-3 * 6 * G)
        assert bodies.diagnostics()["joint_error"] < 1e-5
