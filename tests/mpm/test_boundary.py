"""Obstacles of the material point method: nothing passes, weight, friction, carrying, bits."""

from pathlib import Path

import numpy as np
import pytest
import substep
from substep import mpm

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"
G = 9.81


def jelly(young_modulus=1e6, density=1000):
    return mpm.NeoHookean(density=density, young_modulus=young_modulus, poisson_ratio=0.3)


def block(low, counts, spacing):
    """A lattice of particles; its corner `low` is half a spacing off the first."""
    axes = [at + spacing * (np.arange(n) + 0.5) for at, n in zip(low, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def ground(dimension, **motion):
    normal = (0, 1, 0) if dimension == 2 else (0, 0, 1)
    return substep.Collider(substep.Plane(normal), **motion)


def sampled_ball(radius, center=(0, 0, 0), **motion):
    h, n = radius / 6, 22
    nodes = h * (np.indices((n, n, n)) - (n - 1) / 2)
    values = np.linalg.norm(nodes, axis=0) - radius
    origin = np.full(3, -h * (n - 1) / 2)
    return substep.Collider(substep.SignedDistanceField(values, h, origin, center=center), **motion)


# In two dimensions they are cut at z = 0.
OBSTACLES = {
    "plane": lambda **m: substep.Collider(substep.Plane((0.6, 0.8, 0), (-0.5, 0, 0)), **m),
    "ball": lambda **m: substep.Collider(substep.Sphere(0.5), **m),
    "bowl": lambda **m: substep.Collider(substep.Sphere(1.2), hollow=True, **m),
    "block": lambda **m: substep.Collider(substep.Box((1, 0.6, 0.8)), **m),
    "plate": lambda **m: substep.Collider(substep.Box((0.01, 2, 2)), **m),
    "tank": lambda **m: substep.Collider(substep.Box((2, 1.8, 2.2)), hollow=True, **m),
    "sampled": lambda **m: sampled_ball(0.5, **m),
    "vessel": lambda **m: sampled_ball(1.2, hollow=True, **m),
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", OBSTACLES)
def test_nothing_passes_at_ten_times_the_usual_speed(name, dimension, dtype):
    # A sound wave passes a cell in 0.01 s; material comes at 8 cells in that time, and moves by
    # 0.8 cells in each step. Usual is a tenth.
    cell = 0.1
    obstacles = [OBSTACLES[name](friction=0.3), OBSTACLES[name](velocity=(4, -3, 0))]
    obstacles[1].angular_velocity = (0, 0, 3)
    for obstacle in obstacles:
        x = block([-1.0] * dimension, [16] * dimension, 0.125)
        flat = np.hstack([x, np.zeros((len(x), 3 - dimension))])
        free = obstacle.distance(flat) > 0.01
        x, flat = x[free], flat[free]
        # At the obstacle, or at the wall about it.
        towards = flat if name in ("bowl", "tank", "vessel") else -flat
        if name == "plane":
            towards = np.broadcast_to([-0.6, -0.8, 0.0], flat.shape)
        towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 0.1)
        body = substep.MaterialPointMethod(
            x,
            jelly(young_modulus=7e4),
            cell=cell,
            volume=0.125**dimension,
            velocities=80 * towards[:, :dimension],
            colliders=[obstacle],
            gravity=[0] * dimension,
            cfl=0.8,
            dtype=dtype,
            on_large_step="subdivide",
        )
        for _ in range(12):
            body.step(1e-3)
            at = np.hstack([body.positions, np.zeros((len(x), 3 - dimension))])
            assert obstacle.distance(at).min() > 0
        assert np.linalg.norm(obstacle.impulse) > 0 or obstacle.distance(at).min() < cell


def test_no_particle_crosses_a_thin_plate():
    cell = 0.05
    for speed in (0.0, 10.0):
        plate = substep.Collider(substep.Box((0.002, 4, 4)), velocity=(-speed, 0, 0))
        x = block((-0.42, -0.2, -0.2), (16, 16, 16), 0.025)
        body = substep.MaterialPointMethod(
            x,
            mpm.Fluid(density=1000, bulk_modulus=1e5),
            cell=cell,
            volume=0.025**3,
            velocities=np.broadcast_to([10.0 - speed, 0, 0], x.shape),
            colliders=[plate],
            gravity=(0, 0, 0),
            on_large_step="subdivide",
        )
        for _ in range(20):
            body.advance(2e-3)
            assert body.positions[:, 0].max() < plate.position[0] - 0.001
        assert plate.distance(body.positions).min() < cell  # it was met
        assert plate.impulse[0] > 0


@pytest.mark.parametrize("boundary", ["separate", "slip", "sticky"])
def test_the_impulse_on_the_floor_is_the_weight(boundary):
    cell = 0.1
    floor = ground(3)
    x = block((-0.2, -0.2, 0), (8, 8, 6), 0.05)
    body = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=cell,
        volume=0.05**3,
        colliders=[floor],
        boundary=boundary,
        transfer="pic",  # comes to rest quickly
    )
    body.advance(0.5)
    body.advance(0.1)
    weight = G * body.diagnostics()["mass"]
    assert floor.impulse[2] == pytest.approx(-weight * 0.1, rel=0.01)
    assert floor.angular_impulse == pytest.approx([0, 0, 0], abs=1e-3 * weight * 0.1)


def test_a_heap_of_sand_weighs_on_the_floor():
    floor = ground(2, friction=0.6)
    x, volume = mpm.sample_box((-0.1, 0.01), (0.1, 0.21), 0.01, seed=3)
    sand = mpm.Sand(density=1500, young_modulus=1e6, poisson_ratio=0.3, friction_angle=0.6)
    heap = substep.MaterialPointMethod(x, sand, cell=0.02, volume=volume, colliders=[floor])
    heap.advance(0.8)
    assert np.ptp(heap.positions[:, 0]) > 0.3  # it has collapsed
    elapsed, impulse = 0.2, np.zeros(3)
    for _ in range(4):
        heap.advance(elapsed / 4)
        impulse += floor.impulse
    weight = G * heap.diagnostics()["mass"]
    assert impulse[1] == pytest.approx(-weight * elapsed, rel=0.01)


def test_momentum_is_what_gravity_gives_and_obstacles_take():
    floor = ground(3, friction=0.4)
    ball = sampled_ball(0.15, center=(0, 0, 0.02), angular_velocity=(0, 0, 5), friction=0.5)
    x = block((-0.2, -0.2, 0.2), (16, 16, 8), 0.025)
    body = substep.MaterialPointMethod(
        x,
        jelly(young_modulus=2e5),
        cell=0.05,
        volume=0.025**3,
        velocities=np.broadcast_to([1.0, 0, -2], x.shape),
        colliders=[floor, ball],
        dtype="float64",
    )
    mass = body.diagnostics()["mass"]
    given = np.zeros(3)
    masses = mass / len(x)
    start = masses * body.velocities.sum(axis=0)
    for _ in range(5):
        body.advance(0.02)
        given -= floor.impulse + ball.impulse
    end = masses * body.velocities.sum(axis=0)
    expected = start + given + [0, 0, -mass * G * 0.1]
    assert end == pytest.approx(expected, abs=1e-10 * mass)
    assert abs(ball.angular_impulse[2]) > 0


@pytest.mark.parametrize("friction", [0.3, 0.8])
@pytest.mark.parametrize("degrees", [-1.0, 1.0])
def test_a_block_slides_from_the_angle_of_friction_on(degrees, friction):
    # The plane is tilted against the grid.
    angle = np.arctan(friction) + np.radians(degrees)
    along = np.array([np.cos(angle), -np.sin(angle)])
    normal = np.array([np.sin(angle), np.cos(angle)])
    floor = substep.Collider(substep.Plane((*normal, 0)), friction=friction)
    local = block((-0.4, 0.0), (16, 4), 0.05)
    x = local[:, :1] * along + (local[:, 1:] + 0.002) * normal
    speed = 1.0  # so that no node sticks while the block still shakes
    body = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=0.1,
        volume=0.05**2,
        velocities=np.broadcast_to(speed * along, x.shape) if degrees > 0 else None,
        colliders=[floor],
        transfer="pic",  # damps what shakes, not what slides
        dtype="float64",
    )
    body.advance(0.8 if degrees < 0 else 0.3)
    before = body.velocities.mean(axis=0) @ along
    start = body.positions.mean(axis=0) @ along
    duration = 0.4
    body.advance(duration)
    impulse = -floor.impulse[:2]
    pressed, rubbed = impulse @ normal, -(impulse @ along)
    weight = G * body.diagnostics()["mass"] * duration
    assert pressed == pytest.approx(weight * np.cos(angle), rel=0.02)
    if degrees < 0:
        assert rubbed == pytest.approx(weight * np.sin(angle), rel=0.01)
        assert body.positions.mean(axis=0) @ along - start == pytest.approx(0, abs=1e-3)
    else:
        assert rubbed == pytest.approx(friction * pressed, rel=1e-3)
        gained = body.velocities.mean(axis=0) @ along - before
        slides = G * (np.sin(angle) - friction * np.cos(angle)) * duration
        assert gained == pytest.approx(slides, abs=0.02 * G * np.sin(angle) * duration)


def test_a_disk_slides_where_nothing_rubs():
    angle, radius, spacing = np.radians(20), 0.3, 0.025
    x = block((-radius, 0.0), (24, 24), spacing)
    x = x[np.hypot(x[:, 0], x[:, 1] - radius) < radius]
    gravity = G * np.array([np.sin(angle), -np.cos(angle)])
    floor = ground(2)
    body = substep.MaterialPointMethod(
        x, jelly(), cell=0.05, volume=spacing**2, gravity=gravity, colliders=[floor]
    )
    body.advance(0.4)
    assert body.velocities[:, 0].mean() == pytest.approx(0.4 * gravity[0], rel=1e-3)
    assert floor.impulse[0] == 0


def test_a_moving_tank_takes_its_content_along():
    tank = substep.Collider(
        substep.Box((0.4, 0.4, 0.4), (0, 0, 0.2)), hollow=True, velocity=(0.5, 0, 0)
    )
    x = block((-0.2, -0.2, 0), (16, 16, 8), 0.025)
    water = mpm.Fluid(density=1000, bulk_modulus=5e4)
    body = substep.MaterialPointMethod(
        x, water, cell=0.05, volume=0.025**3, colliders=[tank], transfer="pic"
    )
    for _ in range(10):
        body.advance(0.1)
        assert tank.distance(body.positions).min() > 0
    assert tank.position[0] == pytest.approx(0.5)
    assert body.velocities[:, 0].mean() == pytest.approx(0.5, abs=0.02)
    assert body.positions[:, 0].mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_what_sticks_to_a_ceiling_hangs_and_moves_with_it(speed):
    drops = {}
    for boundary in ("separate", "slip", "sticky"):
        ceiling = substep.Collider(substep.Plane((0, 0, -1)), velocity=(0, 0, speed))
        x = block((-0.1, -0.1, -0.1), (8, 8, 4), 0.025)
        body = substep.MaterialPointMethod(
            x,
            jelly(young_modulus=2e5),
            cell=0.05,
            volume=0.025**3,
            velocities=np.broadcast_to([0, 0, speed], x.shape),
            colliders=[ceiling],
            boundary=boundary,
        )
        body.advance(0.2)
        assert ceiling.distance(body.positions).min() > 0
        drops[boundary] = (x - body.positions)[:, 2].mean() + 0.2 * speed
    assert drops["separate"] == pytest.approx(0.5 * G * 0.2**2, rel=0.01)
    assert abs(drops["slip"]) < 0.005
    assert abs(drops["sticky"]) < 0.005


def test_threads_and_checkpoints_do_not_change_a_bit(tmp_path):
    def run(threads):
        obstacles = [
            ground(3, friction=0.3),
            substep.Collider(
                substep.Sphere(0.1, (0, 0, 0.05)), velocity=(0.2, 0, 0), angular_velocity=(0, 3, 0)
            ),
            sampled_ball(0.1, center=(0.2, 0.1, 0.0), friction=0.2),
        ]
        x = block((-0.2, -0.2, 0.17), (16, 16, 8), 0.025)
        body = substep.MaterialPointMethod(
            x,
            mpm.Sand(density=1500, young_modulus=3e5, poisson_ratio=0.3, friction_angle=0.5),
            cell=0.05,
            volume=0.025**3,
            velocities=np.broadcast_to([0, 0, -1.0], x.shape),
            colliders=obstacles,
            threads=threads,
        )
        body.advance(0.1)
        return body

    def numbers(body):
        given = [np.concatenate([c.position, c.impulse, c.angular_impulse]) for c in body.colliders]
        return np.concatenate([body.positions.ravel(), body.velocities.ravel(), *given]).tobytes()

    first = run(1)
    assert numbers(run(2)) == numbers(first)
    assert numbers(run(3)) == numbers(first)
    state = first.state()
    first.advance(0.05)
    after = numbers(first)
    first.restore(state)
    first.advance(0.05)
    assert numbers(first) == after
