"""Static and kinetic friction, and friction of pairs of materials, beside closed forms."""

import math
import pickle

import numpy as np
import pytest
import substep
from substep import InputError, rigid

G = 9.81
STEPS = [1 / 60, 1 / 240]
STATIC, KINETIC = 0.6, 0.4
BLOCK = rigid.Box((1, 1, 0.3))


def incline(angle, speed=0.0, shape=BLOCK, height=0.15, **surface):
    """A body on a slope: the world, the body, and the direction downhill."""
    surface = surface or {"friction": KINETIC, "static_friction": STATIC}
    normal = np.array([math.sin(angle), 0, math.cos(angle)])
    downhill = np.array([math.cos(angle), 0, -math.sin(angle)])
    turn = (math.cos(angle / 2), 0, math.sin(angle / 2), 0)
    world = substep.RigidBodies()
    world.add(rigid.Plane(normal), (0, 0, 0), motion="static", **surface)
    body = world.add(shape, height * normal, turn, speed * downhill, **surface)
    return world, body, downhill


def run(world, duration, step):
    world.step_size = step
    world.advance(duration)


def slope_of(world, body, downhill):
    return world.velocities[body] @ downhill


def acceleration(world, body, downhill, step):
    """Of the mean over half a second, downhill."""
    before = slope_of(world, body, downhill)
    run(world, 0.5, step)
    return (slope_of(world, body, downhill) - before) / 0.5


def slides_at(angle, friction=KINETIC):
    return G * (math.sin(angle) - friction * math.cos(angle))


@pytest.mark.parametrize("step", STEPS)
def test_block_holds_up_to_the_angle_of_static_friction(step):
    world, block, _ = incline(math.atan(STATIC) - math.radians(1))
    start = world.positions[block].copy()
    run(world, 5.0, step)
    assert np.abs(world.positions[block] - start).max() < 1e-6
    assert world.asleep[block]


@pytest.mark.parametrize("step", STEPS)
def test_block_slides_beyond_it_by_kinetic_friction(step):
    angle = math.atan(STATIC) + math.radians(1)
    world, block, downhill = incline(angle)
    run(world, 0.25, step)
    assert acceleration(world, block, downhill, step) == pytest.approx(slides_at(angle), rel=1e-3)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("speed", [0.03, 1.0])
def test_between_the_angles_what_slides_goes_on_and_what_rests_stays(step, speed):
    angle = math.atan(0.5)
    world, block, downhill = incline(angle, speed)
    run(world, 0.1, step)
    assert acceleration(world, block, downhill, step) == pytest.approx(slides_at(angle), rel=1e-3)
    world, block, downhill = incline(angle)
    run(world, 2.0, step)
    assert abs(slope_of(world, block, downhill)) < 1e-9


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("angle", [0.45, math.atan(0.5), math.atan(0.59)])
@pytest.mark.parametrize("speed", [0.3, 0.9, 2.02])
def test_block_pushed_uphill_comes_to_rest_and_stays(step, angle, speed):
    world, block, downhill = incline(angle, -speed)
    start = world.positions[block].copy()
    run(world, 3.0, step)
    way = speed**2 / (2 * G * (math.sin(angle) + KINETIC * math.cos(angle)))
    # The impulse of a sub-step is that of its end.
    off = speed * step / 8
    assert (start - world.positions[block]) @ downhill == pytest.approx(way, abs=off)
    assert abs(slope_of(world, block, downhill)) < 1e-9


TABLE = [rigid.Box((0.1, 0.1, 0.3), (x, y, -0.15)) for x in (-0.5, 0.5) for y in (-0.4, 0.4)]
TABLE.append(rigid.Box((1.2, 1, 0.05), (0, 0, 0.02)))


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("beyond", [-0.2, 0.2])
def test_table_holds_as_long_as_all_of_its_feet(step, beyond):
    angle = math.atan(STATIC) + math.radians(beyond)
    world, table, downhill = incline(angle, shape=TABLE, height=0.3)
    run(world, 0.5, step)
    expected = slides_at(angle) if beyond > 0 else 0.0
    found = acceleration(world, table, downhill, step)
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("height", [0.0, 0.3])
def test_table_is_pulled_off_its_place_by_what_its_feet_hold(step, height):
    surface = {"friction": KINETIC, "static_friction": STATIC}
    world = substep.RigidBodies(step=step)
    world.add(rigid.Plane(), (0, 0, 0), motion="static", **surface)
    table = world.add(TABLE, (0, 0, 0.3), **surface)
    grip, part = STATIC * world.masses[table] * G, 0.8
    while world.velocities[table, 0] < 0.03:
        part += 0.1 * step
        at = world.positions[table] + (0, 0, height - 0.3)
        world.apply_force(table, (part * grip, 0, 0), at)
        world.step()
    assert part == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("gap", [1e-6, 1e-5, 4e-5])
def test_block_put_down_with_a_gap_holds(gap):
    world, block, downhill = incline(0.5, height=0.15 + gap)
    run(world, 2.0, 1 / 60)
    assert abs(slope_of(world, block, downhill)) < 1e-9


@pytest.mark.parametrize("step", STEPS)
def test_block_that_lands_sliding_has_kinetic_friction(step):
    speeds = []
    for static in (STATIC, KINETIC):
        world = substep.RigidBodies(step=step)
        surface = {"friction": KINETIC, "static_friction": static}
        world.add(rigid.Plane(), (0, 0, 0), motion="static", **surface)
        block = world.add(BLOCK, (0, 0, 0.15 + 0.2), velocities=(5, 0, 0), **surface)
        world.advance(0.4)
        speeds.append(world.velocities[block, 0])
    # Until then the ground has given the momentum m g t.
    assert speeds[0] == speeds[1] == pytest.approx(5 - KINETIC * G * 0.4, rel=1e-2)


@pytest.mark.parametrize("step", STEPS)
def test_struck_block_slides_by_kinetic_friction(step):
    world = substep.RigidBodies(step=step)
    surface = {"friction": KINETIC, "static_friction": STATIC}
    world.add(rigid.Plane(), (0, 0, 0), motion="static", **surface)
    block = world.add(BLOCK, (0, 0, 0.15), **surface)
    world.advance(1.0)
    world.apply_impulse(block, (world.masses[block] * 3.0, 0, 0))
    world.advance(0.5)
    assert world.velocities[block, 0] == pytest.approx(3 - KINETIC * G * 0.5, rel=0.01)
    world.advance(1.0)
    assert world.velocities[block, 0] == 0
    assert world.positions[block, 0] == pytest.approx(9 / (2 * KINETIC * G), rel=0.01)


@pytest.mark.parametrize("step", STEPS)
def test_sphere_rolls_up_to_its_static_friction(step):
    kinetic, static, r = 0.15, 0.3, 0.25
    surface = {"friction": kinetic, "static_friction": static}
    for beyond in (-1, 1):
        angle = math.atan(3.5 * static) + math.radians(beyond)
        world, ball, downhill = incline(angle, shape=rigid.Sphere(r), height=r, **surface)
        run(world, 0.25, step)
        spin = world.angular_velocities[ball, 1]
        found = acceleration(world, ball, downhill, step)
        turned = (world.angular_velocities[ball, 1] - spin) / 0.5
        a, b = 5 / 7 * G * math.sin(angle), 5 / 7 * G * math.sin(angle) / r
        if beyond > 0:
            a, b = slides_at(angle, kinetic), 2.5 * kinetic * G * math.cos(angle) / r
        assert found == pytest.approx(a, rel=2e-3)
        assert turned == pytest.approx(b, rel=2e-3)


@pytest.mark.parametrize("step", STEPS)
def test_torque_about_the_normal(step):
    """Four corners hold mu m g d, d their distance from the middle."""
    for part in (0.97, 1.03):
        world = substep.RigidBodies(step=step)
        surface = {"friction": KINETIC, "static_friction": STATIC}
        world.add(rigid.Plane(), (0, 0, 0), motion="static", **surface)
        block = world.add(BLOCK, (0, 0, 0.15), **surface)
        grip = world.masses[block] * G * math.sqrt(0.5)
        torque, inertia = part * STATIC * grip, world.masses[block] / 6

        def turn(bodies, block=block, torque=torque):
            bodies.set_torques((0, 0, torque), block)

        turn(world)
        world.advance(0.25, turn)
        before = world.angular_velocities[block, 2]
        world.advance(0.25, turn)
        found = (world.angular_velocities[block, 2] - before) / 0.25
        expected = 0.0 if part < 1 else (torque - KINETIC * grip) / inertia
        assert found == pytest.approx(expected, rel=1e-2, abs=1e-9)


@pytest.mark.parametrize("step", STEPS)
def test_stick_and_slip_of_a_block_on_a_spring(step):
    """A spring of k, whose end goes on at v, pulls a block.

    It sticks until the spring is longer by mu_s m g / k, and swings by A = (mu_s - mu_k) m g / k
    about mu_k m g / k until it stands: the period is 2 A / v + (pi + 2 atan(v / w A)) / w.
    """
    mass, k, v = 2.0, 50.0, 0.1
    world = substep.RigidBodies(step=step)
    surface = {"friction": KINETIC, "static_friction": STATIC}
    world.add(rigid.Plane(), (0, 0, 0), motion="static", **surface)
    block = world.add(BLOCK, (0, 0, 0.15), mass=mass, **surface)
    lengths, speeds, times = [], [], []

    def pull(bodies):
        x, u = bodies.positions[block, 0], bodies.velocities[block, 0]
        middle = v * (bodies.time + step / 2) - (x + u * step / 2)  # of the coming step
        bodies.set_forces((k * middle, 0, 0), block)
        lengths.append(v * bodies.time - x), speeds.append(u), times.append(bodies.time)

    pull(world)
    world.advance(15.0, pull)
    lengths, speeds, times = map(np.array, (lengths, speeds, times))
    w, A = math.sqrt(k / mass), (STATIC - KINETIC) * mass * G / k
    moves = speeds > 0.2 * w * A
    starts = times[1:][moves[1:] & ~moves[:-1]]
    assert len(starts) >= 6
    period = 2 * A / v + (math.pi + 2 * math.atan(v / (w * A))) / w
    assert np.diff(starts).mean() == pytest.approx(period, rel=0.02)
    late = lengths[times > 4]
    R = math.hypot(A, v / w)
    assert late.max() - late.min() == pytest.approx(2 * R, rel=0.02)
    assert (late.max() + late.min()) / 2 == pytest.approx(KINETIC * mass * G / k, rel=0.02)
    # The speed of the block: that of the swing, and of the end of the spring.
    assert speeds.max() == pytest.approx(v + w * R, rel=0.02)


def pile(threads=None, **surface):
    rng = np.random.default_rng(5)
    world = substep.RigidBodies(threads=threads)
    world.add(rigid.Plane(), (0, 0, 0), motion="static", **surface)
    shapes = [rigid.Box((0.3, 0.2, 0.25)), rigid.Sphere(0.13), rigid.Cylinder(0.12, 0.2)]
    for k in range(90):
        x = (*rng.uniform(-0.5, 0.5, 2), 0.2 + 0.06 * k)
        world.add(shapes[k % 3], x, rng.normal(size=4), **surface)
    return world


def test_pile_gains_no_energy():
    world = pile(friction=0.3, static_friction=0.9)
    energy = world.diagnostics()["energy"]
    for _ in range(600):
        world.step()
        now = world.diagnostics()["energy"]
        assert now <= energy * (1 + 1e-4)
        energy = min(energy, now)


def state_hash(simulation):
    return substep.state_hash(*simulation.state().values())


def test_static_friction_that_is_the_kinetic_one_changes_no_bits():
    plain, same = pile(friction=0.5), pile(friction=0.5, static_friction=0.5)
    for world in (plain, same):
        world.advance(2.0)
    assert state_hash(plain) == state_hash(same)


def test_bits_do_not_depend_on_threads():
    one, two = (pile(n, friction=0.3, static_friction=0.9, material="stone") for n in (1, 2))
    for world in (one, two):
        world.advance(0.7)
        world.set_material_pair("stone", "stone", friction=0.2, static_friction=0.8)
        world.advance(0.7)
    assert state_hash(one) == state_hash(two)


def test_copies_and_files_go_on_with_the_same_bits(tmp_path):
    """Where one block slides, one has come to rest that slid up the slope, and one rests."""

    def slope():
        angle = math.atan(0.5)
        surface = {"friction": 0.7, "material": "stone"}
        world, block, downhill = incline(angle, 0.1, **surface)
        for k, speed in ((1, -1.2), (2, 0.0)):
            x = world.positions[block] + (0, 2 * k, 0)
            world.add(BLOCK, x, world.rotations[block], speed * downhill, **surface)
        world.set_material_pair("stone", "stone", friction=KINETIC, static_friction=STATIC)
        return world

    one = slope()
    one.advance(0.5)
    speeds = np.linalg.norm(one.velocities[1:], axis=1)
    assert speeds[0] > 0.4 and speeds[1:].max() < 1e-9
    one.save(tmp_path / "slope")
    restored = slope()
    restored.load(tmp_path / "slope")
    batch = substep.RigidBatch(one, 2)
    others = [restored, one.copy(), pickle.loads(pickle.dumps(one))]
    assert restored.material_pairs == one.material_pairs
    for world in (one, *others):
        world.advance(0.5)
    batch.advance(0.5)
    saved = batch.state()
    wholes = [*others, batch.copy_world(1)]
    batch.reset()
    batch.restore(saved)
    wholes.append(batch.copy_world(0))
    for world in wholes:
        assert state_hash(world) == state_hash(one)
        assert world.material_pairs == one.material_pairs


# Pairs of materials.
def on_two(first, second, angle):
    """A block of rubber on ice and one on wood, at the same slope."""
    normal = (math.sin(angle), 0, math.cos(angle))
    turn = (math.cos(angle / 2), 0, math.sin(angle / 2), 0)
    world = substep.RigidBodies()
    for k, name in enumerate(("ice", "wood")):
        ground = rigid.Box((40, 4, 1), (0, 5 * k, -0.5))
        world.add(ground, (0, 0, 0), turn, motion="static", material=name, friction=0.2)
        place = 0.15 * np.array(normal) + (0, 5 * k, 0)
        world.add(BLOCK, place, turn, material="rubber", friction=0.8)
    world.set_material_pair(*first, friction=0.1, static_friction=0.3)
    world.set_material_pair(*second, friction=0.7)
    return world


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize(
    ("angle", "ice", "wood"),
    [
        (math.atan(0.3) - 0.02, 0, 0),
        (math.atan(0.3) + 0.02, 0.1, 0),
        (math.atan(0.7) - 0.02, 0.1, 0),
        (math.atan(0.7) + 0.02, 0.1, 0.7),
    ],
)
def test_pairs_hold_and_slide_by_their_own(step, angle, ice, wood):
    worlds = [
        on_two(("rubber", "ice"), ("wood", "rubber"), angle),
        on_two(("ice", "rubber"), ("rubber", "wood"), angle),
    ]
    downhill = np.array([math.cos(angle), 0, -math.sin(angle)])
    for world in worlds:
        run(world, 0.25, step)
    for body, friction in ((1, ice), (3, wood)):
        before = slope_of(worlds[0], body, downhill)
        worlds_copy = worlds[0].copy()
        run(worlds_copy, 0.5, step)
        found = (slope_of(worlds_copy, body, downhill) - before) / 0.5
        expected = slides_at(angle, friction) if friction else 0.0
        assert found == pytest.approx(expected, rel=1e-2, abs=1e-9)
    assert state_hash(worlds[0]) == state_hash(worlds[1])


def test_what_a_pair_leaves_out_follows_the_rule():
    def world():
        made = substep.RigidBodies()
        made.add(rigid.Plane(), (0, 0, 0), motion="static", friction=0.4, material="floor")
        made.add(BLOCK, (0, 0, 0.15), velocities=(3, 0, 0), friction=0.9, material="crate")
        made.add(rigid.Sphere(0.1), (5, 5, 1.1), material="ball")
        return made

    plain = world()
    plain.advance(0.3)
    assert plain.velocities[1, 0] == pytest.approx(3 - 0.6 * G * 0.3, rel=1e-3)
    other = world()
    other.set_material_pair("floor", "ball", restitution=0.9)
    other.set_material_pair("crate", "floor", friction=0.2)
    assert other.material_pairs == {
        ("ball", "floor"): {"restitution": 0.9},
        ("crate", "floor"): {"friction": 0.2},
    }
    other.advance(0.3)
    assert other.velocities[1, 0] == pytest.approx(3 - 0.2 * G * 0.3, rel=1e-3)
    highest = 0.0
    for _ in range(60):
        other.step()
        if other.velocities[2, 2] > 0:
            highest = max(highest, other.positions[2, 2])
    assert highest == pytest.approx(0.1 + 0.81, rel=5e-3)
    again = world()
    again.set_material_pair("floor", "crate", friction=0.2)
    again.set_material_pair("floor", "crate")
    assert again.material_pairs == {}
    again.advance(0.3)
    assert state_hash(again) == state_hash(plain)


def test_another_pair_wakes_what_rested():
    angle = math.atan(0.5)
    world, block, downhill = incline(angle, friction=0.7, material="stone")
    run(world, 2.0, 1 / 60)
    assert world.asleep[block]
    world.set_material_pair("stone", "stone", friction=0.3)
    run(world, 0.5, 1 / 60)
    assert slope_of(world, block, downhill) == pytest.approx(0.5 * slides_at(angle, 0.3), rel=1e-2)


def test_fixtures_tell_their_surface():
    world = substep.RigidBodies()
    parts = [BLOCK, rigid.Fixture(rigid.Sphere(1), friction=0.9, material="rubber")]
    body = world.add(parts, (0, 0, 0), friction=0.2, material="wood")
    told = [(f.friction, f.static_friction, f.material) for f in world.fixtures(body)]
    assert told == [(0.2, 0.2, "wood"), (0.9, 0.9, "rubber")]
    body = world.add(parts[:1], (0, 0, 9), friction=0.2, static_friction=0.3)
    assert world.fixtures(body)[0].static_friction == 0.3


def test_pairs_of_a_state():
    world, *_ = incline(0.1, friction=0.7, material="stone")
    state = world.state()
    world.set_material_pair("stone", "stone", friction=0.3)
    changed = world.state()
    world.restore(state)
    assert world.material_pairs == {}
    world.restore(changed)
    assert world.material_pairs == {("stone", "stone"): {"friction": 0.3}}
    for wrong in (
        {"material_names": changed["material_names"][:-1]},
        {"material_names": changed["material_names"][:6]},
        {"material_pairs": -changed["material_pairs"]},
        {"material_pairs": changed["material_pairs"][:, :4]},
    ):
        before = state_hash(world)
        with pytest.raises(InputError):
            world.restore(changed | wrong)
        assert state_hash(world) == before
