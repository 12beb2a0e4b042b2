"""Bodies that yield to springs and soft bodies: closed forms, momentum, energy, determinism."""

import numpy as np
import pytest
import substep
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import brentq
from substep.geometry import Box, Collider, Sphere, box_tetrahedra

G = 9.81
ONLY_HEAVE = np.diag([0.0, 0, 1, 0, 0, 0])


def mobility(mass, inertia):
    return np.diag([1 / mass] * 3 + list(1 / np.broadcast_to(inertia, 3)))


def body(shape, mass, inertia=None, *, number=0, gravity=G, free=None, **options):
    """A collider that stands for a rigid body of this mass, free or with the mobility `free`."""
    collider = Collider(shape, **options)
    w = mobility(mass, inertia) if free is None else free / mass
    collider._native.set_body(number, (0, 0, 0), w.ravel().tolist(), (0, 0, -gravity, 0, 0, 0))
    return collider


def ball(mass, position, radius=0.1, **options):
    return body(Sphere(radius, position), mass, 0.4 * mass * radius**2, **options)


def received(collider):
    return np.array(collider._native.received)


def two_springs(colliders, mass=0.01, **options):
    """A vertex between two springs of length 1 m and 100 N/m, stretched from 0.9 m."""
    x = [(-1.0, 0, 0), (0, 0, 0), (1, 0, 0)]
    options = {"gravity": (0, 0, 0), "pinned": [0, 2], "rest_lengths": [0.9, 0.9], **options}
    edges = [(0, 1), (1, 2)]
    return substep.MassSpring(x, edges, 100.0, [mass] * 3, colliders=colliders, **options)


def cloth(colliders, n=13, mass=0.1, stiffness=200.0, rim=True, **options):
    edges, k = substep.springs.grid_springs(n, n, stiffness=stiffness)
    axis = np.linspace(-0.5, 0.5, n)
    x = np.array([(a, b, 0.0) for b in axis for a in axis])
    held = np.flatnonzero(np.abs(x[:, :2]).max(axis=1) > 0.499) if rim else []
    options = {"pinned": held, "contact_margin": 0.01, **options}
    return substep.MassSpring(x, edges, k, masses=mass / n**2, colliders=colliders, **options)


def settle(sim, step=0.02, steps=2000, speed=1e-7):
    """Steps until nothing has been faster than `speed` for 25 of them."""
    quiet = 0
    for _ in range(steps):
        sim.step(step)
        moving = max(np.abs(c.velocity).max() for c in sim.colliders)
        quiet = quiet + 1 if max(np.abs(sim.velocities).max(), moving) < speed else 0
        if quiet == 25:
            return
    raise AssertionError(f"still moves at {np.abs(sim.velocities).max()} m/s")


@pytest.mark.parametrize("free", [None, ONLY_HEAVE])
@pytest.mark.parametrize("mass", [1.0, 1e-4, 1e-5])
def test_a_ball_between_two_springs_rests_where_they_carry_it(mass, free):
    """2 k (l - r) w / l = m g with l^2 = 1 + w^2, for 100 to 0.001 times the mass of the vertex."""
    sphere = ball(mass, (0, 0, 0.1005), free=free)
    sim = two_springs([sphere], tolerance=1e-6 * mass * G, damping=2.0, drag=2.0)
    settle(sim, speed=max(1e-4 * mass, 4e-9))

    def too_deep(w):
        length = np.hypot(1, w)
        return 200 * (length - 0.9) * w / length - mass * G

    sag = brentq(too_deep, 0, 1)
    assert_allclose(-sim.positions[1, 2], sag, rtol=1e-4)
    gap = sphere.position[2] - 0.1 - sim.positions[1, 2]
    assert 0 < gap < 1e-3
    assert_allclose(sphere.impulse / 0.02, (0, 0, mass * G), atol=1e-3 * mass * G)


@pytest.mark.parametrize("mass", [10.0, 0.1, 1e-3, 1e-4])
def test_a_ball_on_a_trampoline_never_gains_energy(mass):
    """A ball of 100 to 0.001 times the mass of the cloth falls 0.2 m and bounces."""
    sphere = ball(mass, (0.013, -0.021, 0.3), friction=0.3)
    stiffness = 200.0 if mass < 1 else 5000.0
    sim = cloth([sphere], stiffness=stiffness, step=0.01)

    def energy():
        v, spin = sphere.velocity, sphere.angular_velocity
        of_ball = mass * (v @ v / 2 + 0.4 * 0.1**2 * spin @ spin / 2 + G * sphere.position[2])
        return sim.diagnostics()["energy"] + of_ball

    energies, heights = [energy()], []
    for _ in range(100):
        sim.step(0.01)
        energies.append(energy())
        heights.append(sphere.position[2] - 0.1)
    assert np.diff(energies).max() < 1e-4 * mass * G * 0.2
    assert -0.4 < min(heights) < 0.02
    assert max(heights) < 0.2
    assert np.abs(sim.positions).max() < 0.6


def test_a_resting_ball_gives_its_weight_to_the_cloth():
    sphere = ball(1.0, (0, 0, 0.105))
    sim = cloth([sphere], stiffness=2000.0, drag=3.0, tolerance=1e-5)
    settle(sim, speed=1e-4)
    assert_allclose(sphere.impulse / 0.02, (0, 0, G), atol=1e-3 * G)


def test_momentum_is_exchanged_to_rounding():
    """A spinning ball hits a free cloth: what it gets is what the vertices lose, torques too."""
    sphere = ball(0.05, (0.1, 0.05, 0.13), gravity=0, friction=0.5)
    sphere.velocity, sphere.angular_velocity = (0.3, 0.2, -2.0), (3.0, -8.0, 5.0)
    sim = cloth([sphere], rim=False, gravity=(0, 0, 0), step=0.01)
    given, scale = np.zeros(6), 0.0
    start = np.array(sphere.velocity)
    for _ in range(12):
        before, had = sim.velocities.copy(), received(sphere)
        sim.step(0.01)
        change = sim.masses[:, None] * (sim.velocities - before)
        arms = sim.positions - sphere.position
        lost = -np.concatenate([change.sum(axis=0), np.cross(arms, change).sum(axis=0)])
        step = received(sphere) - had
        given += step
        scale += np.abs(step).max()
        assert_allclose(step, lost, atol=1e-12 * max(scale, 0.01))
    assert scale > 0.05
    assert np.abs(given[3:]).max() > 1e-4
    assert_allclose(np.array(sphere.velocity) - start, given[:3] / 0.05, rtol=1e-12, atol=1e-12)


def block(colliders, lengths=(0.2, 0.2, 0.2), cells=(2, 2, 2), **options):
    mesh = box_tetrahedra(lengths, cells)
    options = {"density": 100.0, "young_modulus": 2e4, "poisson_ratio": 0.0, **options}
    held = np.flatnonzero(mesh.vertices[:, 2] < mesh.vertices[:, 2].min() + 1e-9)
    return substep.SoftBody(
        mesh.vertices, mesh.tetrahedra, pinned=held, colliders=colliders, **options
    )


def test_a_box_compresses_a_soft_block_as_a_column():
    """m g / A = E strain, to first order in a strain of 1 %."""
    mass = 0.01 * 2e4 * 0.04 / G
    top = box_tetrahedra((0.2, 0.2, 0.2), (2, 2, 2)).vertices[:, 2].max()
    plate = body(Box((0.4, 0.4, 0.1), (0, 0, top + 0.0505)), mass, 0.05, friction=1.0)
    sim = block([plate], gravity=(0, 0, 0), drag=5.0, tolerance=1e-6)
    upper = sim.positions[:, 2] > top - 1e-9
    settle(sim, speed=1e-6)
    assert_allclose(top - sim.positions[upper, 2].mean(), 0.01 * 0.2, rtol=0.02)
    assert_allclose(plate.impulse / 0.02, (0, 0, mass * G), atol=1e-3 * mass * G)


def test_a_fixed_number_of_threads_changes_no_bit():
    def run(threads, again=False):
        sphere = ball(0.02, (0.02, 0.01, 0.12), friction=0.4)
        sphere.angular_velocity = (4.0, 3, 1)
        sim = cloth([sphere], step=0.01, threads=threads)
        for k in range(20):
            if again and k == 10:
                saved = sim.state()
                sim.step(0.01)
                sim.restore(saved)
            sim.step(0.01)
        assert np.abs(received(sphere)).min() > 0
        return np.concatenate(
            [sim.positions.ravel(), sphere.position, sphere.velocity, sphere.angular_velocity]
        )

    one = run(1)
    for other in (run(2), run(3), run(1, again=True)):
        assert_array_equal(other, one)


def test_a_step_that_fails_leaves_the_body():
    sphere = ball(0.05, (0, 0, 0.11))
    sphere.velocity = (0, 0, -3.0)
    sim = cloth([sphere], max_iterations=1, on_fail="raise", tolerance=1e-12)
    before = sim.state(), received(sphere)
    with pytest.raises(substep.ConvergenceError):
        sim.step(0.02)
    assert_array_equal(received(sphere), before[1])
    assert_allclose(sphere.position, (0, 0, 0.11), atol=0)
    assert_allclose(sphere.velocity, (0, 0, -3.0), atol=0)


@pytest.mark.parametrize("mass", [1.0, 1e-5])
def test_explicit_integrators_exchange_momentum(mass):
    """A vertex at rest, hit by a ball on the line of its centre, takes (1 + e) m / (m + M) of u."""
    sphere = ball(mass, (0, 0, 0.1), gravity=0, restitution=0.5)
    sphere.velocity = (0, 0, -1.0)
    x = [(-1.0, 0, 0), (0, 0, 0), (1, 0, 0)]
    options = {"gravity": (0, 0, 0), "integrator": "symplectic_euler", "step": 1e-4}
    sim = substep.MassSpring(x, [(0, 1), (1, 2)], 1e-9, [0.01] * 3, colliders=[sphere], **options)
    sim.step(1e-4)
    share = 1.5 * mass / (mass + 0.01)
    assert_allclose(sim.velocities[1], (0, 0, -share), atol=1e-12)
    assert_allclose(sphere.velocity, (0, 0, -1 + 1.5 * 0.01 / (mass + 0.01)), atol=1e-10)


def test_a_stack_of_jelly_box_jelly_box_stands():
    """The lower block carries two boxes and the upper block, the upper one a box."""
    mesh = box_tetrahedra((0.2, 0.2, 0.2), (3, 3, 3))
    n = len(mesh.vertices)
    low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    up = np.array([0, 0, 0.31])
    plates = [
        body(Box((0.25, 0.25, 0.1), (0, 0, high + 0.055 + 0.31 * k)), 2.0, 0.013,
             number=k, friction=1.0)
        for k in range(2)
    ]  # fmt: skip
    sim = substep.SoftBody(
        np.concatenate([mesh.vertices, mesh.vertices + up]),
        np.concatenate([mesh.tetrahedra, mesh.tetrahedra + n]),
        density=300.0,
        young_modulus=3e4,
        poisson_ratio=0.3,
        pinned=np.flatnonzero(mesh.vertices[:, 2] < low + 1e-9),
        colliders=plates,
        contact_margin=5e-3,
        damping_time=0.02,
        drag=1.0,
    )
    for _ in range(150):
        sim.step(0.02)
    for k, plate in enumerate(plates):
        assert_allclose(plate.position[:2], 0, atol=2e-3)
        assert_allclose(plate.position[2], high + 0.055 + 0.31 * k, atol=0.035)
        assert np.abs(plate.velocity).max() < 0.01
    assert_allclose(plates[1].impulse[2] / 0.02, 2 * G, rtol=1e-2)


def test_a_body_of_two_shapes_stays_rigid():
    """A dumbbell falls on the cloth: its balls keep their distance, and its weight is carried."""
    masses, offset = 0.1, np.array([0.12, 0, 0])
    inertia = masses * np.array([0.001, 0.015, 0.015])
    w = np.diag([1 / masses] * 3 + list(1 / inertia)).ravel().tolist()
    balls = [Collider(Sphere(0.08, (0, 0.02, 0.15) + sign * offset)) for sign in (1, -1)]
    for sign, end in zip((1, -1), balls, strict=True):
        end._native.set_body(5, (-sign * offset).tolist(), w, (0, 0, -G, 0, 0, 0))
        end.friction = 0.3
        end.angular_velocity = (0, 2.0, 0)
        end.velocity = np.cross((0, 2.0, 0), sign * offset)
    sim = cloth(balls, stiffness=500.0, drag=2.0, step=0.01)
    for _ in range(100):
        sim.step(0.01)
        apart = np.subtract(balls[0].position, balls[1].position)
        assert_allclose(np.linalg.norm(apart), 0.24, atol=1e-12)
    assert_array_equal(balls[0].angular_velocity, balls[1].angular_velocity)
    carried = sum(end.impulse[2] for end in balls) / 0.01
    assert_allclose(carried, masses * G, rtol=0.1)


def test_a_body_on_a_hinge_only_turns():
    """Its mobility is that about the hinge: whatever falls on it, the hinge stays where it is."""
    arm = np.array([0.1, 0, 0])  # from the hinge, about y, to the centre of mass
    about = np.array([0.0, 1, 0])
    column = np.concatenate([np.cross(about, arm), about])
    w = np.outer(column, column) / (0.2 * 0.02)
    lever = Collider(Box((0.4, 0.3, 0.05), (0.1, 0, -0.05)))
    fall = (column * (column[:3] @ [0, 0, -G]) * 0.2 / (0.2 * 0.02)).tolist()
    lever._native.set_body(0, (0, 0, 0), w.ravel().tolist(), fall)
    sim = cloth([lever], n=7, stiffness=20.0, step=0.01)
    for _ in range(20):
        sim.step(0.01)
        turn = lever.angular_velocity
        assert_allclose(turn[[0, 2]], 0, atol=1e-12)
        assert_allclose(lever.velocity, turn[1] * column[:3], atol=1e-9)
    assert np.abs(received(lever)).max() > 0
