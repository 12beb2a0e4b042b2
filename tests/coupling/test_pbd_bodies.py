"""Bodies that yield to position-based bodies: closed forms, momentum, weight, determinism."""

import numpy as np
import pytest
import substep
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import brentq
from substep.geometry import Collider, Sphere, grid_mesh

G = 9.81
ONLY_HEAVE = np.diag([0, 0, 1.0, 0, 0, 0])
DOUBLE = {"dtype": "float64", "contact_margin": 1e-3}


def ball(mass, position, *, radius=0.1, gravity=G, free=None, **options):
    """A collider that stands for a ball, free or with the mobility `free` / mass."""
    collider = Collider(Sphere(radius, position), **options)
    w = np.diag([1 / mass] * 3 + [2.5 / (mass * radius**2)] * 3) if free is None else free / mass
    collider._native.set_body(0, (0, 0, 0), w.ravel().tolist(), (0, 0, -gravity, 0, 0, 0))
    return collider


def received(collider):
    return np.array(collider._native.received)


def momentum(sim):
    return sim.masses @ sim.velocities


def trampoline(colliders, n=13, mass=0.1, rim=True, **options):
    mesh = grid_mesh(n, n)
    x = mesh.vertices
    held = np.flatnonzero(np.abs(x[:, :2]).max(axis=1) > 0.499) if rim else []
    edges = substep.pbd.Distance(mesh.edges, compliance=1e-4)
    options = {"pinned": held, "substeps": 10, **DOUBLE, **options}
    return substep.PositionBasedDynamics(x, mass / len(x), [edges], colliders=colliders, **options)


@pytest.mark.parametrize("mass", [1.0, 1e-2, 1e-5])
def test_a_hit_particle_and_a_ball_go_on_together(mass):
    """Without restitution both have the velocity of their centre of mass."""
    sphere = ball(mass, (0, 0, 0.102), gravity=0)
    sphere.velocity = (0, 0, -1.0)
    sim = substep.PositionBasedDynamics(
        [[0.0, 0, 0]], 0.01, [], gravity=(0, 0, 0), colliders=[sphere], **DOUBLE
    )
    for _ in range(3):
        sim.step(0.01)
    both = -mass / (mass + 0.01)
    assert_allclose(sim.velocities[0], (0, 0, both), rtol=1e-9, atol=1e-12)
    assert_allclose(sphere.velocity, (0, 0, both), rtol=1e-9, atol=1e-9)
    assert_allclose(received(sphere)[:3], -momentum(sim), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("mass", [1.0, 1e-2, 1e-5])
def test_a_ball_between_two_springs_rests_where_they_carry_it(mass):
    """2 k (l - r) w / l = m g with l^2 = 1 + w^2, for 100 to 0.001 times the particle's mass."""
    sphere = ball(mass, (0, 0, 0.101), free=ONLY_HEAVE, friction=1.0)
    springs = substep.Distance([(0, 1), (1, 2)], compliance=0.01, rest_lengths=[0.9, 0.9])
    x = [(-1.0, 0, 0), (0, 0, 0), (1, 0, 0)]
    sim = substep.PositionBasedDynamics(
        x,
        0.01,
        [springs],
        pinned=[0, 2],
        colliders=[sphere],
        drag=4 + 200 * mass,
        substeps=40,
        **DOUBLE,
    )
    sim.advance(8.0)
    weight = (mass + 0.01) * G

    def too_deep(w):
        length = np.hypot(1, w)
        return 200 * (length - 0.9) * w / length - weight

    assert_allclose(-sim.positions[1, 2], brentq(too_deep, 0, 1), rtol=2e-3)
    assert_allclose(sphere.position[2] - sim.positions[1, 2], 0.101, atol=1e-5)
    assert_allclose(sphere.impulse[2] / sphere.duration, mass * G, rtol=1e-3)


@pytest.mark.parametrize("mass", [1.0, 0.1, 1e-4])
def test_a_ball_falls_on_a_trampoline_and_stays(mass):
    """A ball of ten to 0.001 times the mass of the cloth: it never rises above where it was."""
    sphere = ball(mass, (0.013, -0.021, 0.3), friction=0.3)
    sim = trampoline([sphere], drag=1.0, iterations=4)
    heights = []
    for _ in range(240):
        sim.step(1 / 60)
        heights.append(sphere.position[2])
    assert -0.2 < min(heights) < 0.15
    assert max(heights) < 0.3
    assert max(heights[-60:]) < 0.15
    assert np.abs(sim.positions[:, 2]).max() < 0.3


def test_what_particles_lose_a_ball_gains():
    sphere = ball(0.05, (0.1, 0.05, 0.13), gravity=0, friction=0.5)
    sphere.velocity, sphere.angular_velocity = (0.3, 0.2, -2.0), (3.0, -8.0, 5.0)
    sim = trampoline([sphere], rim=False, gravity=(0, 0, 0))
    start, spin = np.array(sphere.velocity), np.array(sphere.angular_velocity)
    for _ in range(6):
        sim.step(0.01)
    given = received(sphere)
    assert np.abs(given).min() > 1e-6
    assert_allclose(given[:3], -momentum(sim), atol=1e-12)
    assert_allclose(sphere.velocity - start, given[:3] / 0.05, atol=1e-12)
    assert_allclose(sphere.angular_velocity - spin, given[3:] / (0.4 * 0.05 * 0.01), atol=1e-10)


def test_a_resting_ball_gives_its_weight_to_the_cloth():
    sphere = ball(0.1, (0, 0, 0.102), free=ONLY_HEAVE, friction=0.3)
    sim = trampoline([sphere], drag=60.0)
    sim.advance(8.0)
    sim.advance(0.5)
    assert_allclose(sphere.impulse[2] / sphere.duration, 0.1 * G, rtol=1e-4)


def test_the_number_of_threads_changes_no_bit():
    def run(threads, again=False):
        sphere = ball(0.02, (0.02, 0.01, 0.12), friction=0.4)
        sphere.angular_velocity = (4.0, 3, 1)
        sim = trampoline([sphere], threads=threads, dtype="float32")
        for k in range(10):
            if again and k == 5:
                saved = sim.state()
                sim.step(0.02)
                sim.restore(saved)
            sim.step(0.02)
        assert np.abs(received(sphere)).min() > 0
        return np.concatenate(
            [sim.positions.ravel(), sphere.position, sphere.velocity, sphere.angular_velocity]
        )

    one = run(1)
    for other in (run(2), run(3), run(1, again=True)):
        assert_array_equal(other, one)
