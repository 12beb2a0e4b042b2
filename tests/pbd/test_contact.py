"""Contact of position-based bodies with colliders: friction, restitution, speed, weight."""

from pathlib import Path

import numpy as np
import pytest
import substep
from substep import geometry

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"
G = 9.81


def lattice(counts, spacing, low):
    axes = [at + spacing * np.arange(n) for n, at in zip(counts, low, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def braces(x, spacing):
    """Pairs along the edges and face diagonals of a lattice."""
    distances = np.linalg.norm(x[:, None] - x[None], axis=-1)
    return np.argwhere(np.triu(distances < 1.8 * spacing, 1))


def block(counts=(4, 4, 3), spacing=0.1, low=(0.0, 0.0, 0.02), **options):
    x = lattice(counts, spacing, low)
    springs = substep.Distance(braces(x, spacing))
    options = {"contact_margin": 0.02} | options
    return substep.PositionBasedDynamics(x, 0.1, [springs], **options)


def dust(positions, **options):
    return substep.PositionBasedDynamics(positions, 0.1, [], **options)


@pytest.mark.parametrize("friction", [0.2, 0.5, 1.0])
def test_a_block_slips_at_the_angle_of_friction(friction):
    for degrees in (-0.5, 0.5):
        angle = np.arctan(friction) + np.radians(degrees)
        gravity = G * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        body = block(
            gravity=gravity, colliders=[substep.Collider(substep.Plane(), friction=friction)]
        )
        body.advance(1.0)
        velocity = body.velocities.mean(0)[0]
        if degrees < 0:
            assert abs(velocity) < 1e-4
        else:
            expected = G * (np.sin(angle) - friction * np.cos(angle))
            assert velocity > 0.8 * expected


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])
def test_a_bounce_has_restitution_squared_of_the_height(restitution):
    floor = substep.Collider(substep.Plane(), restitution=restitution)
    ball = dust([[0.0, 0.0, 1.01]], contact_margin=0.01, colliders=[floor], dtype="float64")
    fall = np.sqrt(2 / G)
    heights = []
    while ball.time < fall * (1 + 2 * restitution) - 0.02:
        ball.step(1e-3)
        heights.append(ball.positions[0, 2] - 0.01)
    after = heights[int(fall / 1e-3) + 5 :]
    assert (max(after) if after else 0.0) == pytest.approx(restitution**2, rel=2e-3, abs=1e-6)


def test_an_elastic_bounce_neither_gains_nor_loses():
    floor = substep.Collider(substep.Plane(), restitution=1.0)
    ball = dust([[0.0, 0.0, 1.01]], contact_margin=0.01, colliders=[floor], dtype="float64")
    top = 0.0
    while ball.time < 9:
        ball.step(1 / 120)
        if ball.time > 7.5:
            top = max(top, ball.positions[0, 2] - 0.01)
    assert top == pytest.approx(1.0, abs=5e-3)


def obstacles():
    return {
        "plane": substep.Collider(substep.Plane((1, 0, 0))),
        "ball": substep.Collider(substep.Sphere(0.4)),
        "plate": substep.Collider(substep.Box((0.001, 3, 3))),
        "tank": substep.Collider(substep.Box((2, 2, 2)), hollow=True),
    }


@pytest.mark.parametrize("name", obstacles())
@pytest.mark.parametrize("moves", ["particles", "obstacle"])
def test_nothing_tunnels_at_a_thousand_metres_per_second(name, moves):
    obstacle = obstacles()[name]
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.3, 0.3, (200, 3))
    x[:, 0] += 0.0 if name == "tank" else 0.9
    assert (obstacle.distance(x) > 0).all()
    fast = np.tile([-1000.0, 30.0, -20.0], (200, 1))
    if moves == "obstacle":
        obstacle.velocity = -fast[0]
    bodies = dust(
        x,
        velocities=fast if moves == "particles" else None,
        gravity=(0, 0, 0),
        colliders=[obstacle],
        contact_margin=0.005,
        substeps=2,
    )
    for _ in range(5):
        bodies.step(1 / 60)
        assert obstacle.distance(bodies.positions).min() > 0
        if name in ("plane", "plate"):  # still on the side where they began
            ahead = bodies.positions[:, 0] - obstacle.position[0]
            assert (ahead > 0).all() or name == "plate"
            near = np.abs(bodies.positions - obstacle.position)[:, 1:].max(1) < 1.4
            assert (ahead[near] > 0).all()


def test_a_turntable_carries_a_block():
    rate = 0.8
    table = substep.Collider(substep.Plane(), friction=1.0, angular_velocity=(0, 0, rate))
    body = block(low=(0.2, -0.15, 0.02), colliders=[table])
    start = body.positions.mean(0)
    body.advance(2.0)
    c, s = np.cos(2 * rate), np.sin(2 * rate)
    expected = [c * start[0] - s * start[1], s * start[0] + c * start[1]]
    assert body.positions.mean(0)[:2] == pytest.approx(expected, abs=0.02)


def test_a_rotating_box_throws_what_it_hits():
    bat = substep.Collider(substep.Box((1.0, 0.05, 0.2)), angular_velocity=(0, 0, 30))
    balls = dust([[0.4, 0.1, 0.0]], gravity=(0, 0, 0), colliders=[bat], contact_margin=0.01)
    given = np.zeros(3)
    torque = 0.0
    for _ in range(12):
        balls.step(1 / 240)
        given += bat.impulse
        torque += bat.angular_impulse[2]
        assert bat.distance(balls.positions)[0] > 0
    momentum = 0.1 * balls.velocities[0]
    assert np.linalg.norm(balls.velocities[0]) > 0.3 * 30
    assert momentum == pytest.approx(-given, abs=1e-4)
    assert torque < 0


def test_a_block_rests_with_its_weight_on_the_floor():
    floor = substep.Collider(substep.Plane(), friction=0.5)
    body = block(colliders=[floor])
    body.advance(1.0)
    total = np.zeros(3)
    for _ in range(60):
        body.step(1 / 60)
        total += floor.impulse
    weight = G * body.masses.sum()
    assert -total[2] == pytest.approx(weight, rel=1e-3)
    assert total[:2] == pytest.approx([0, 0], abs=1e-3 * weight)
    assert np.abs(body.velocities).max() < 0.01


def test_a_block_comes_to_rest_on_a_mesh():
    path = MESHES / "spot.obj"
    if not path.is_file():
        pytest.skip("needs the meshes beside the repository")
    cow = substep.Collider(
        substep.SignedDistanceField.from_mesh(geometry.read_mesh(path), 0.05), friction=0.8
    )
    top = geometry.read_mesh(path).vertices[:, 1].max()
    body = block((4, 4, 4), 0.06, (-0.1, top + 0.05, -0.2), gravity=(0, -G, 0), colliders=[cow])
    lowest = np.inf
    for _ in range(90):
        body.step(1 / 60)
        lowest = min(lowest, cow.distance(body.positions).min())
    assert lowest > 0.9 * 0.02
    assert np.isfinite(body.positions).all()


def test_particles_placed_on_a_surface_do_not_jump():
    """They are set off to the margin, which is no motion."""
    grains = dust(
        [[0.1 * k, 0, 0.0] for k in range(5)], contact_margin=0.02, colliders=[substep.Plane()]
    )
    grains.step(1 / 60)
    assert grains.positions[:, 2] == pytest.approx(0.02, abs=1e-6)
    assert np.abs(grains.velocities).max() < 1e-3


def test_pinned_particles_pass_through_and_nothing_else():
    body = dust([[0, 0, 1], [0.5, 0, 1]], pinned=[0], colliders=[substep.Plane()])
    body.set_targets([[0, 0, -1]], ids=[0])
    body.step(1 / 60)
    assert body.positions[0, 2] == pytest.approx(-1)
    for _ in range(60):
        body.step(1 / 60)
    assert body.positions[1, 2] > 0


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_same_bits_for_any_threads_and_through_a_checkpoint(tmp_path, dtype):
    def start(threads):
        ball = substep.Collider(
            substep.Sphere(0.25, (0.3, 0.3, 0.0)), friction=0.4, angular_velocity=(0, 3, 0)
        )
        floor = substep.Collider(substep.Plane((0.1, 0, 1), (0, 0, -0.1)), restitution=0.3)
        return block(
            (12, 12, 4), 0.05, (0, 0, 0.3), colliders=[ball, floor], dtype=dtype, threads=threads
        )

    hashes = set()
    for threads in (1, 2, 3):
        body = start(threads)
        body.advance(0.2)
        body.save(tmp_path / "a")
        other = start(threads)
        other.load(tmp_path / "a")
        for sim in (body, other):
            sim.advance(0.2)
            state = sim.state()
            moving = (state[name] for name in ("positions", "velocities", "colliders"))
            hashes.add(substep.state_hash(*moving))
    assert len(hashes) == 1


@pytest.mark.parametrize("tilt", [0.2, 0.6, 1.0])
def test_a_tilted_obstacle_is_cut_by_the_plane_of_motion(tilt):
    """Particles bounce as off a level one, and stay in their plane: they were thrown out of it."""
    fallen = {}
    for normal in ((0, 1, 0), (0, np.cos(tilt), np.sin(tilt))):
        ground = substep.Collider(substep.Plane(normal), friction=0.5, restitution=0.5)
        ball = substep.PositionBasedDynamics(
            [[0.0, 0.3]], 1.0, [], colliders=[ground], gravity=(0, -9.81)
        )
        ball.step_size = 1e-3
        ball.advance(0.35)
        fallen[normal] = ball.positions[0, 1]
        state = ball.state()
        assert not state["positions"][:, 2].any() and not state["velocities"][:, 2].any()
        ball.restore(state)
    level, tilted = fallen.values()
    assert level == pytest.approx(0.25 * 0.3, rel=0.03)
    assert tilted == pytest.approx(level, rel=0.05)


def test_what_rests_on_a_ball_gives_it_nothing():
    """In float32 the rounding of every step was an impulse."""
    axis = 0.05 * np.arange(4)
    sheet = np.stack(np.meshgrid(axis, axis, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    ball = substep.Collider(substep.Sphere(0.5, (0.07, 0.07, 0.02)), friction=1.0)
    dynamics = substep.PositionBasedDynamics(sheet, 0.1, [], gravity=(0, 0, 0), colliders=[ball])
    dynamics.step(1e-3)
    impulse = np.zeros(3)
    for _ in range(200):
        dynamics.step(1e-3)
        impulse += ball.impulse
    assert np.abs(impulse).max() < 1e-7  # it was 0.03 N s
