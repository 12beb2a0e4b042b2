"""Bodies that yield in a position-based liquid: Archimedes, momentum, light bodies, friction."""

import math

import numpy as np
import pytest
import substep

G = 9.81
RHO = 1000.0


def body(collider, mass, inertia, *, number=0, acceleration=(0.0, 0.0, -G), centre=(0.0, 0.0, 0.0)):
    mobility = np.diag([1 / mass] * 3 + [1 / i for i in inertia])
    collider._native.set_body(
        number, centre, mobility.ravel().tolist(), [*acceleration, 0.0, 0.0, 0.0]
    )
    return collider


def received(collider):
    return np.array(collider._native.received)


def ball(radius, at, ratio, **options):
    """A ball of density `ratio` times that of the liquid, and its mass."""
    collider = substep.Collider(substep.Sphere(radius), **options)
    collider.position = at
    mass = ratio * RHO * 4 / 3 * math.pi * radius**3
    return body(collider, mass, [0.4 * mass * radius**2] * 3), mass


def block(size, at, ratio, **options):
    collider = substep.Collider(substep.Box(size), **options)
    collider.position = at
    mass = ratio * RHO * math.prod(size)
    inertia = [mass * (sum(b * b for b in size) - a * a) / 12 for a in size]
    return body(collider, mass, inertia), mass


def raft(width, at, ratio, **options):
    """A square in the plane, one metre deep."""
    collider = substep.Collider(substep.Box((width, width, 1.0)), **options)
    collider.position = (*at, 0.0)
    mass = ratio * RHO * width**2
    inertia = [1.0, 1.0, mass * width**2 / 6]
    return body(collider, mass, inertia, acceleration=(0.0, -G, 0.0)), mass


def pool(size, depth, d, obstacles, **options):
    """A tank, filled up to `depth` where there is no obstacle."""
    size = np.asarray(size, dtype=float)
    low, high = np.append(-size[:-1] / 2, 0.0), np.append(size[:-1] / 2, depth)
    walls = (*size, 2.0) if size.size == 2 else tuple(size)
    middle = (0.0, size[1] / 2, 0.0) if size.size == 2 else (0.0, 0.0, size[2] / 2)
    tank = substep.Collider(substep.Box(walls, middle), hollow=True)
    x = substep.fill_box(low, high, d)
    for obstacle in obstacles:
        at = np.pad(x, ((0, 0), (0, 3 - size.size)))
        x = x[obstacle.distance(at) > 0.5 * d - 1e-9]
    return substep.PositionBasedFluid(x, d, colliders=[tank, *obstacles], **options)


def ball_draft(ratio):
    """Depth of the lowest point over the diameter: h^2 (3 - 2 h) = ratio."""
    low, high = 0.0, 1.0
    for _ in range(60):
        h = (low + high) / 2
        low, high = (h, high) if h * h * (3 - 2 * h) < ratio else (low, h)
    return low


@pytest.mark.parametrize("divergence_free", [False, True])
@pytest.mark.parametrize("ratio", [0.001, 0.05, 0.5, 3.0])
def test_what_the_liquid_gains_the_body_loses(ratio, divergence_free):
    d = 0.05
    stone, mass = ball(0.15, (0.02, 0.0, 0.5), ratio, friction=0.3)
    stone.velocity = (0.3, 0.0, -1.0)
    liquid = pool(
        (0.6, 0.6, 1.0), 0.4, d, [stone], dtype="float64", divergence_free=divergence_free
    )
    tank = liquid.colliders[0]
    start = mass * np.array(stone.velocity) + liquid.masses @ liquid.velocities
    walls, dt = np.zeros(3), 4e-3
    for _ in range(25):
        liquid.step(dt)
        walls += tank.impulse
    weight = np.array([0.0, 0.0, -G * 25 * dt * (mass + liquid.masses.sum())])
    end = mass * np.array(stone.velocity) + liquid.masses @ liquid.velocities
    scale = np.abs(weight).max()
    assert end == pytest.approx(start + weight - walls, abs=1e-12 * scale)
    given = received(stone)[:3]
    assert np.linalg.norm(given) > 0
    change = mass * (np.array(stone.velocity) - (0.3, 0.0, -1.0) - np.array([0, 0, -G * 25 * dt]))
    assert given == pytest.approx(change, abs=1e-12 * scale)


@pytest.mark.parametrize("divergence_free", [False, True])
@pytest.mark.parametrize("ratio", [0.05, 0.5, 0.9])
def test_a_raft_floats_at_its_draft(ratio, divergence_free):
    d, cells = 0.05, 12
    width, size, depth = cells * d, (2.4, 2.4), 1.0
    afloat, _ = raft(width, (0.0, depth + width * (0.5 - ratio)), ratio)
    # Square rafts roll: this is about heave.
    liquid = pool(size, depth, d, [afloat], divergence_free=divergence_free)
    volume = len(liquid.positions) * d * d
    drafts = []
    for _ in range(20):
        liquid.advance(0.1)
        afloat.angular_velocity = (0, 0, 0)
        afloat.rotation = (1, 0, 0, 0)
        bottom = afloat.position[1] - width / 2
        # By volume: L level = V + w (level - bottom).
        level = (volume - width * bottom) / (size[0] - width)
        drafts.append((level - bottom) / width)
    assert np.mean(drafts[10:]) == pytest.approx(ratio, abs=0.02)


@pytest.mark.parametrize("divergence_free", [False, True])
@pytest.mark.parametrize("ratio", [0.001, 0.02])
@pytest.mark.parametrize("step", [1, 4])
def test_light_bodies_are_calm(ratio, step, divergence_free):
    d = 0.05
    width, depth = 0.4, 0.6
    afloat, _ = raft(width, (0.0, depth + width * (0.5 - ratio) + d), ratio)
    liquid = pool((1.2, 1.5), depth, d, [afloat], divergence_free=divergence_free)
    fastest = 0.0
    while liquid.time < 1.0:
        liquid.step(step * liquid.step_limit()[0])
        fastest = max(fastest, np.linalg.norm(afloat.velocity))
    assert fastest < 1.5
    assert depth - 2 * d < afloat.position[1] - width / 2 < depth + 2 * d


def test_what_is_as_heavy_as_the_liquid_stays():
    d = 0.05
    drop, _ = ball(0.15, (0.0, 0.0, 0.4), 1.0)
    liquid = pool((0.7, 0.7, 1.2), 0.8, d, [drop])
    start = np.array(drop.position)
    liquid.advance(0.5)
    assert np.linalg.norm(np.array(drop.position) - start) < 0.5 * d


@pytest.mark.parametrize("ratio", [2.0, 7.0, 20.0])
def test_heavy_bodies_sink(ratio):
    d = 0.05
    stone, _ = raft(0.3, (0.0, 0.6), ratio)
    liquid = pool((1.0, 1.6), 0.8, d, [stone])
    while stone.position[1] > 0.25 and liquid.time < 2:
        before = np.array(stone.velocity)
        liquid.step(liquid.step_limit()[0])
        assert np.linalg.norm(np.array(stone.velocity) - before) < 1
    # No faster than a fall that carries its added mass, which is at least 0.
    fall = 0.35
    assert liquid.time > math.sqrt(2 * fall / G)
    assert liquid.time < 3 * math.sqrt(2 * fall / G * (ratio + 1) / (ratio - 1))


def test_one_body_of_two_boxes_is_one_box():
    d, width, depth = 0.05, 0.4, 0.6
    results = []
    for parts in (1, 2):
        obstacles = []
        for k in range(parts):
            size = (width / parts, width, 1.0)
            shift = (k - 0.5 * (parts - 1)) * width / parts
            part = substep.Collider(substep.Box(size))
            part.position = (shift, depth, 0.0)
            mass = 0.5 * RHO * width**2
            obstacles.append(
                body(
                    part,
                    mass,
                    [1.0, 1.0, mass * width**2 / 6],
                    acceleration=(0.0, -G, 0.0),
                    centre=(-shift, 0.0, 0.0),
                )
            )
        liquid = pool((1.2, 1.4), depth, d, obstacles, dtype="float64")
        for _ in range(50):
            liquid.step(4e-3)
        results.append(np.mean([c.position for c in obstacles], axis=0))
        same = [c.velocity for c in obstacles], [c.angular_velocity for c in obstacles]
        assert np.ptp(same[1], axis=0) == pytest.approx(0, abs=1e-12)
    assert results[0] == pytest.approx(results[1], abs=0.1 * d)


@pytest.mark.parametrize("divergence_free", [False, True])
def test_threads_and_a_checkpoint_leave_the_bits(divergence_free):
    d = 0.05

    def make(threads):
        bodies = [ball(0.1, (x, 0.0, 0.35), 0.2, friction=0.5)[0] for x in (-0.12, 0.12)]
        mobility = np.diag([1 / 3.0] * 3 + [1 / 0.02] * 3).ravel().tolist()
        bodies[1]._native.set_body(1, (0, 0, 0), mobility, [0, 0, -G, 0, 0, 0])
        return pool(
            (0.6, 0.5, 0.8), 0.35, d, bodies, threads=threads, divergence_free=divergence_free
        )

    def after(liquid, steps):
        for _ in range(steps):
            liquid.step(4e-3)
        moved = [np.concatenate([c.position, c.velocity]) for c in liquid.colliders]
        return np.concatenate([liquid.positions.ravel(), *moved])

    first = make(1)
    expected = after(first, 12)
    for threads in (2, 3):
        assert np.array_equal(after(make(threads), 12), expected)
    halfway = make(1)
    after(halfway, 6)
    on = make(2)
    on.restore(halfway.state())
    assert np.array_equal(after(on, 6), expected)


def test_a_step_that_fails_leaves_the_body():
    stone, _ = ball(0.15, (0.0, 0.0, 0.4), 0.5)
    liquid = pool((0.8, 0.8, 1.2), 0.4, 0.05, [stone], bounds=((-1, -1, -1), (1, 1, 1)))
    liquid.step(2e-3)
    before = [np.array(stone.position), np.array(stone.velocity), received(stone)]
    v = np.zeros_like(liquid.velocities)
    v[0, 2] = 1e4
    liquid.set_velocities(v)
    with pytest.raises(substep.SolverError):
        liquid.step(2e-3)
    after = [np.array(stone.position), np.array(stone.velocity), received(stone)]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.1, 0.9])
def test_a_ball_floats_at_its_draft(ratio):
    d, radius, width, depth = 0.05, 0.3, 1.0, 0.7
    h = 2 * radius * ball_draft(ratio)
    afloat, _ = ball(radius, (0.0, 0.0, depth - h + radius), ratio)
    liquid = pool((width, width, 2.0), depth, d, [afloat])
    volume = len(liquid.positions) * d**3
    drafts = []
    for _ in range(12):
        liquid.advance(0.1)
        bottom = afloat.position[2] - radius
        low, high = 0.0, 2 * radius
        for _ in range(50):
            h = (low + high) / 2
            rises = width**2 * (bottom + h) - math.pi * h * h * (radius - h / 3) < volume
            low, high = (h, high) if rises else (low, h)
        drafts.append(h / (2 * radius))
    assert np.mean(drafts[6:]) == pytest.approx(ball_draft(ratio), abs=0.02)
