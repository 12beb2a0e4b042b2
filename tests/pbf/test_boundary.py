"""Liquids at walls: no leaks, weight, rest, friction and moving walls."""

from pathlib import Path

import numpy as np
import pytest
import substep
from substep import geometry

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"
G = 9.81


def block(counts, spacing, low=(0.0, 0.0, 0.0)):
    axes = [at + spacing * (np.arange(n) + 0.5) for n, at in zip(counts, low, strict=False)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def column(width, height, spacing, *, dimension=3, **options):
    """A column at rest that fills the floor of its tank."""
    counts = (width,) * (dimension - 1) + (height,)
    size = spacing * np.array(counts)
    size[-1] *= 2
    center = np.append(size / 2, [0.0] * (3 - dimension))
    tank = substep.Collider(
        substep.Box(np.append(size, [1.0] * (3 - dimension)), center), hollow=True
    )
    positions = block(counts, spacing)
    return substep.PositionBasedFluid(positions, spacing, colliders=[tank], **options)


@pytest.mark.slow
def test_a_column_rests_at_its_height_with_its_weight_on_the_tank():
    d, height = 0.05, 32
    liquid = column(7, height, d, max_iterations=100, max_tolerance=0.01)
    weight = G * liquid.masses.sum()
    heights, impulse, elapsed = [], 0.0, 0.0
    for step in range(int(10 / 4e-3)):
        liquid.step(4e-3)
        if liquid.time > 3:
            impulse -= liquid.colliders[0].impulse[2]
            elapsed += 4e-3
            assert liquid.report.mean_error <= 1e-3
            assert liquid.report.max_error <= 1e-2
        if step % 25 == 24:
            heights.append(2 * liquid.positions[:, 2].mean())
    # The height of a column of that centre of mass; the liquid stays as it is.
    assert heights[-1] == pytest.approx(height * d, rel=0.01)
    assert np.ptp(heights[len(heights) // 2 :]) < 1e-3 * height * d
    assert impulse == pytest.approx(weight * elapsed, rel=1e-3)


@pytest.mark.parametrize("divergence_free", [False, True])
def test_momentum_is_what_gravity_gives_and_the_walls_take(divergence_free):
    d = 0.05
    ball = substep.Collider(substep.Sphere(0.1, (0.2, 0.25, 0.3)), velocity=(0.5, 0.0, 0.0))
    tank = substep.Collider(
        substep.Box((0.5, 0.5, 1.0), (0.25, 0.25, 0.5)), hollow=True, friction=0.3
    )
    x = block((10, 10, 8), d)
    x = x[ball.distance(x) > d / 2]
    liquid = substep.PositionBasedFluid(
        x, d, colliders=[tank, ball], dtype="float64", divergence_free=divergence_free
    )
    given = np.zeros(3)
    turned = np.zeros(3)

    def angular_momentum():
        return np.cross(liquid.positions, liquid.masses[:, None] * liquid.velocities).sum(0)

    for _ in range(20):
        before = angular_momentum()
        center = liquid.positions.mean(0)
        liquid.step(3e-3)
        given += sum(c.impulse for c in liquid.colliders)
        turned += angular_momentum() - before
        for c in liquid.colliders:
            turned += c.angular_impulse + np.cross(c.position, c.impulse)
        turned -= np.cross(center, [0.0, 0.0, -G * 3e-3 * liquid.masses.sum()])
    mass = liquid.masses.sum()
    momentum = liquid.masses @ liquid.velocities
    expected = np.array([0.0, 0.0, -G * mass * 0.06]) - given
    scale = G * mass * 0.06
    assert momentum == pytest.approx(expected, abs=2e-6 * scale)
    # Torques act where particles end, not where they began: right to first order of the step.
    assert np.abs(turned).max() < 0.02 * scale * 0.25


def worst_clearance(liquid):
    return min(c.distance(liquid.positions).min() for c in liquid.colliders)


def tank(**options):
    return substep.Collider(substep.Box((1, 1, 1), (0.5, 0.5, 0.5)), hollow=True, **options)


def paddle():
    blade = substep.Collider(substep.Box((0.03, 0.9, 0.9), (0.1, 0.5, 0.5)), velocity=(1, 0, 0))
    blade.angular_velocity = (0, 0, 20)
    return [tank(), blade]


def ball():
    return [
        tank(friction=0.5),
        substep.Collider(substep.Sphere(0.15, (0.5, 0.5, 0.8)), velocity=(0, 0, -1.5)),
    ]


def bowl():
    return [
        substep.Collider(
            substep.Sphere(0.5, (0.5, 0.5, 0.5)), hollow=True, angular_velocity=(0, 5, 0)
        )
    ]


def bunny(hollow):
    path = MESHES / "stanford-bunny.obj"
    if not path.is_file():
        pytest.skip("needs the meshes beside the repository")
    mesh = geometry.read_mesh(path)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    mesh = geometry.TriangleMesh((mesh.vertices - low) / (high - low).max(), mesh.faces)
    return substep.Collider(substep.SignedDistanceField.from_mesh(mesh, 1 / 40), hollow=hollow)


def vessel():
    return [bunny(True)]


def flying_bunny():
    obstacle = bunny(False)
    obstacle.velocity = (0, 0, -1)
    obstacle.angular_velocity = (0, 3, 10)
    obstacle.position = (0.2, 0.2, 1.2)
    return [tank(), obstacle]


@pytest.mark.parametrize("divergence_free", [False, True])
@pytest.mark.parametrize("obstacles", [tank, paddle, ball, bowl, vessel, flying_bunny])
def test_nothing_passes_at_ten_times_the_usual_speed_and_step(obstacles, divergence_free):
    d = 0.05
    colliders = obstacles()
    colliders = colliders if isinstance(colliders, list) else [colliders]
    x = block((20, 20, 20), d)
    x = x[np.min([c.distance(x) for c in colliders], axis=0) > 0.4 * d]
    x = x[x[:, 2] < 0.6]
    assert len(x) > 1000
    # 4 m/s is what a fall of the height of the tank gives.
    velocities = np.random.default_rng(1).normal(size=x.shape) * 40
    liquid = substep.PositionBasedFluid(
        x, d, velocities=velocities, colliders=colliders, divergence_free=divergence_free
    )
    for _ in range(8):
        liquid.step(10 * 0.4 * d / 4)
        assert worst_clearance(liquid) > 0


@pytest.mark.parametrize("divergence_free", [False, True])
def test_friction_drags_a_puddle_as_coulomb_says(divergence_free):
    d, friction, h = 0.02, 0.2, 2e-3
    for mu in (0.0, friction):
        floor = substep.Collider(substep.Plane(), friction=mu, velocity=(2, 0, 0))
        liquid = substep.PositionBasedFluid(
            block((12, 12, 4), d), d, colliders=[floor], divergence_free=divergence_free
        )
        for _ in range(100):
            liquid.step(h)
        start = liquid.velocities[:, 0].mean()
        for _ in range(100):
            liquid.step(h)
        gained = liquid.velocities[:, 0].mean() - start
        # While all of it slides, friction is mu times the weight.
        assert gained == pytest.approx(mu * G * 100 * h, rel=0.03, abs=1e-4)


def test_a_moving_tank_carries_its_liquid():
    d = 0.05
    liquid = column(6, 8, d, dimension=3)
    liquid.colliders[0].velocity = (1.0, 0.5, 0.0)
    liquid.advance(3.0)
    assert liquid.positions.mean(0)[:2] == pytest.approx([0.15 + 3, 0.15 + 1.5], abs=0.2 * d)
    assert liquid.velocities.mean(0)[:2] == pytest.approx([1, 0.5], abs=0.02)
    assert worst_clearance(liquid) > 0


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_density_beside_walls_is_that_of_the_liquid(dimension):
    """A lattice that fills a corner of its tank is at rest there, too."""
    liquid = column(8, 8, 0.1, dimension=dimension)
    low = (liquid.positions < 0.35).all(1)
    assert liquid.densities[low] == pytest.approx(1.0, abs=0.015)


def test_colliders_put_upon_particles_set_them_free():
    liquid = column(6, 6, 0.05)
    obstacle = substep.Collider(substep.Sphere(0.1, (0.15, 0.15, 5.0)))
    both = substep.PositionBasedFluid(
        liquid.positions, 0.05, colliders=[liquid.colliders[0], obstacle], gravity=(0, 0, 0)
    )
    both.step(1e-3)
    obstacle.position = (0.15, 0.15, 0.1)
    both.step(1e-3)
    assert worst_clearance(both) > 0
    assert np.abs(both.velocities).max() < 0.5


def test_a_wall_put_into_a_pool_raises_it_without_speed():
    pool = column(32, 16, 0.025, dimension=2)
    wall = substep.Collider(substep.Plane((1, 0, 0)))
    wall.position = (-1, 0, 0)
    liquid = substep.PositionBasedFluid(
        pool.positions, 0.025, colliders=[*pool.colliders, wall], gravity=(0, -9.81)
    )
    liquid.advance(0.05)
    wall.position = (0.35, 0, 0)
    liquid.step(3e-3)
    assert np.abs(liquid.velocities).max() < 0.5
    assert liquid.diagnostics()["kinetic_energy"] < 0.01 * liquid.masses.sum()
    # It stands as high as 0.32 m2 of water in 0.45 m do.
    assert liquid.positions[:, 1].max() == pytest.approx(0.711, abs=0.05)
    assert liquid.positions[:, 1].mean() == pytest.approx(0.3556, abs=0.01)


def test_same_bits_for_any_threads_and_through_a_checkpoint(tmp_path):
    def start(threads):
        d = 0.05
        ball = substep.Collider(
            substep.Sphere(0.1, (0.2, 0.25, 0.3)), velocity=(0.5, 0, 0), friction=0.2
        )
        tank = substep.Collider(
            substep.Box((1.0, 0.5, 1.0), (0.5, 0.25, 0.5)), hollow=True, restitution=0.5
        )
        x = block((10, 10, 8), d)
        x = x[ball.distance(x) > d / 2]
        return substep.PositionBasedFluid(x, d, colliders=[tank, ball], threads=threads)

    hashes = set()
    for threads in (1, 2, 3):
        liquid = start(threads)
        for _ in range(5):
            liquid.step(4e-3)
        liquid.save(tmp_path / "a")
        other = start(threads)
        other.load(tmp_path / "a")
        for sim in (liquid, other):
            for _ in range(5):
                sim.step(4e-3)
            hashes.add(substep.state_hash(*sim.state().values()))
    assert len(hashes) == 1
