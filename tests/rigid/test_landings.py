"""Impacts without restitution: what lands stays down, rows go on together, friction stops slip.

And what a load held down stays down when the load ends.
"""

from itertools import pairwise

import numpy as np
import pytest
import substep
from substep import rigid

G = 9.81
STEPS = [1 / 60, 1 / 120, 1 / 240]
CUBE = rigid.Box((1, 1, 1))
DROP = 0.16  # [m]


def on_ground(step, **options):
    bodies = substep.RigidBodies(step=step, sleeping=False, **options)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
    return bodies


def column(bodies, masses, height=0.0):
    """Cubes on one another, from this height up; their numbers."""
    return [bodies.add(CUBE, (0, 0, height + k + 0.5), mass=m) for k, m in enumerate(masses)]


def falling_column(step, masses, **options):
    bodies = on_ground(step, **options)
    return bodies, column(bodies, masses, DROP)


def heights(bodies, ids):
    """Above where the cubes of a column stand."""
    return bodies.positions[ids, 2] - 0.5 - np.arange(len(ids))


def after_landing(bodies, ids, duration=1.5):
    """The heights after each step that follows the impact."""
    bodies.advance(np.sqrt(2 * DROP / G) + 2 * bodies.step_size)
    end = bodies.time + duration
    while bodies.time < end:
        bodies.step()
        yield heights(bodies, ids)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_a_column_that_lands_does_not_rise(count, step):
    bodies, ids = falling_column(step, np.ones(count))
    energy = bodies.diagnostics()["energy"]
    rise = max(z.mean() for z in after_landing(bodies, ids))
    assert rise < 1e-5
    assert np.abs(bodies.velocities).max() < 1e-9
    assert heights(bodies, ids).min() > -1e-4 * (count + 1)  # the slop of each contact
    assert np.abs(bodies.positions[ids, :2]).max() < 1e-9
    assert bodies.diagnostics()["energy"] < energy


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("heavy", [30, 100])
def test_heavy_on_light_that_lands_does_not_rise(heavy, step):
    bodies, ids = falling_column(step, [1, heavy])
    assert max(z.max() for z in after_landing(bodies, ids)) < 1e-5
    assert np.abs(bodies.velocities).max() < 1e-7


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("heavy", [100, 1000])
def test_heavy_on_light_that_lands_is_lifted_at_once(heavy, step):
    bodies, ids = falling_column(step, [1, heavy])
    lowest = []
    bodies.advance(1.0, lambda b: lowest.append(heights(b, ids).min()))
    assert min(lowest) > -4 * DROP * step  # less than it falls in a quarter of a step
    assert max(lowest[-10:]) < 0
    assert min(lowest[-10:]) > -3.5e-4  # the slop of two contacts
    assert np.abs(bodies.velocities).max() < 1e-7


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize(
    ("mass", "at", "gap", "drop"),
    [(100, -1.0, 1e-4, 0), (50, -1.3, 1e-3, 0), (100, -1.3, 0, 0.01)],
)
def test_a_load_off_the_centre_of_a_light_plate_stays_on_it(mass, at, gap, drop, step):
    bodies = substep.RigidBodies(step=step, sleeping=False)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static", friction=0.5)
    plate = bodies.add(rigid.Box((3, 0.5, 0.1)), (0, 0, 0.05 + drop), mass=1)
    load = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (at, 0, 0.2 + gap + drop), mass=mass)
    height, floor = [], []

    def watch(b):
        height.append(b.positions[load, 2] - 0.2)
        floor.append(b.contact_force(load)[2])

    bodies.advance(3.0, watch)
    assert min(height) > -2.5e-3
    assert max(height) < gap + drop + 1e-4  # no energy from being lifted, within the slop
    assert height[-1] == pytest.approx(-1e-4, abs=2.5e-4)
    assert floor[-1] == pytest.approx(mass * G, rel=1e-6)
    assert bodies.contact_force(plate)[2] == pytest.approx(1 * G, rel=1e-3)  # of both sides
    assert np.abs(bodies.velocities).max() < 1e-5


@pytest.mark.parametrize("step", STEPS)
def test_a_load_slides_to_rest_on_a_light_plate_that_slides(step):
    # The plate has no friction with the floor: both end with their common momentum.
    bodies = substep.RigidBodies(step=step, sleeping=False)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static", material="floor")
    plate = bodies.add(rigid.Box((3, 0.5, 0.1)), (0, 0, 0.05), mass=1, material="plate")
    load = bodies.add(
        rigid.Box((0.2, 0.2, 0.2)), (-1, 0, 0.2), velocities=(2, 0, 0), mass=100, material="load"
    )
    bodies.set_material_pair("plate", "load", friction=0.4)
    bodies.set_material_pair("floor", "plate", friction=0)
    lowest = []
    bodies.advance(2.0, lambda b: lowest.append(b.positions[load, 2] - 0.2))
    assert min(lowest) > -6e-4
    assert bodies.velocities[[plate, load], 0] == pytest.approx(200 / 101, rel=1e-5)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("count", [1, 2, 5, 10])
def test_a_box_that_lands_on_a_stack_does_not_throw_it(count, step):
    bodies = on_ground(step)
    ids = column(bodies, np.ones(count))
    ids.append(bodies.add(CUBE, (0, 0, count + 0.5 + DROP), mass=1.0))
    rise = max(z[:-1].max() for z in after_landing(bodies, ids))
    assert rise < 2e-3
    assert np.abs(bodies.velocities).max() < 1e-6


@pytest.mark.parametrize("step", STEPS)
def test_columns_that_collide_go_on_together(step):
    # Of a plastic impact without gravity: the common velocity, and no momentum comes or goes.
    bodies = substep.RigidBodies(step=step, gravity=(0, 0, 0))
    masses = np.array([1.0, 2, 3])
    for side, speed in ((1, 1.0), (-1, 0.5)):
        for k, mass in enumerate(masses):
            bodies.add(CUBE, (side * (0.6 + k), 0, 0), velocities=(-side * speed, 0, 0), mass=mass)
    before = bodies.momenta.sum(axis=0)
    bodies.advance(1.0)
    assert bodies.momenta.sum(axis=0) == pytest.approx(before, abs=1e-13)
    assert bodies.velocities[:, 0] == pytest.approx(-0.25, abs=1e-6)


@pytest.mark.parametrize("step", STEPS)
def test_a_chain_of_boxes_that_lands_does_not_rise(step):
    # Upright posts whose parts are joined: the joints pass the impact on.
    bodies = on_ground(step)
    ids = column(bodies, np.ones(4), DROP)
    for lower, upper in pairwise(ids):
        z = bodies.positions[upper, 2] - 0.5
        bodies.ball(lower, upper, (0, 0, z), collide=True)
    assert max(z.mean() for z in after_landing(bodies, ids, 0.5)) < 1e-3


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("side", [0.2, 1.0])
@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
def test_what_falls_along_meets_what_is_stopped_before_it(step, side, restitution):
    # Three boxes fall together from 2 m, and do not approach until the lowest lands: those above
    # must meet it within that step. They overlapped by half of the small ones.
    for gap in (0.011, 0.021, 0.04, 0.06):
        bodies = on_ground(step)
        for k in range(3):
            at = (0, 0, 2 + k * (side + gap) + side / 2)
            bodies.add(rigid.Box((side,) * 3), at, mass=1.0, restitution=restitution)
        start = bodies.diagnostics()["energy"]
        while bodies.time < 1.0:
            bodies.step()
            assert bodies.diagnostics()["penetration"] < (4e-3 if restitution == 0 else 1e-3)
            assert bodies.diagnostics()["energy"] < start + 1e-9


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
def test_the_wagons_of_a_train_meet_those_that_a_wall_stops(step):
    # At 6 m/s and 30 mm apart; they overlapped by up to 85 mm of 300.
    bodies = substep.RigidBodies(step=step, gravity=(0, 0, 0), sleeping=False)
    bodies.add(rigid.Plane((-1, 0, 0)), (0, 0, 0), motion="static")
    for k in range(6):
        at = (-1.35 - 0.33 * k, 0, 0)
        bodies.add(rigid.Box((0.3,) * 3), at, velocities=(6, 0, 0), restitution=1.0)
    while bodies.time < 0.6:
        bodies.step()
        assert bodies.diagnostics()["penetration"] < 1e-3
    assert bodies.velocities[1:, 0] == pytest.approx(-6, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS)
def test_a_tall_column_that_lands_does_not_rise(step):
    bodies, ids = falling_column(step, np.ones(40))
    assert max(z.max() for z in after_landing(bodies, ids, 1.0)) < 1e-5


def row_on_floor(step, count):
    """Cubes that touch one another along x, from 0 on, on a floor without friction."""
    bodies = substep.RigidBodies(step=step, sleeping=False)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static", friction=0)
    ids = [bodies.add(CUBE, (k + 0.5, 0, 0.5), mass=1.0, friction=0) for k in range(count)]
    return bodies, ids


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("speed", [0.1, 1.0, 5.0])
@pytest.mark.parametrize("count", [3, 10])
def test_a_row_goes_on_with_what_pushes_it(count, speed, step):
    # Of a plastic impact: the velocity of the pusher, for each of the cubes.
    bodies, ids = row_on_floor(step, count)
    bodies.add(
        rigid.Box((0.2, 1, 0.9)),
        (-0.11, 0, 0.5),
        motion="kinematic",
        velocities=(speed, 0, 0),
        friction=0,
    )
    fastest = 0.0
    while bodies.time < 2:
        bodies.step()
        fastest = max(fastest, bodies.velocities[ids, 0].max())
    assert fastest < 1.01 * speed
    assert bodies.velocities[ids, 0] == pytest.approx(speed, rel=1e-2)


@pytest.mark.parametrize("step", STEPS)
def test_a_row_at_a_wall_that_is_struck_stays_there(step):
    # The wall takes the momentum of what strikes, and no more.
    bodies, ids = row_on_floor(step, 10)
    wall = bodies.add(rigid.Plane((1, 0, 0)), (0, 0, 0), motion="static", friction=0)
    ids.append(bodies.add(CUBE, (10.51, 0, 0.5), mass=1.0, velocities=(-2, 0, 0), friction=0))
    impulse = 0.0
    while bodies.time < 1:
        bodies.step()
        impulse -= bodies.contact_force(wall)[0] * step
    assert impulse == pytest.approx(2.0, rel=1e-2)
    assert np.abs(bodies.velocities[ids, 0]).max() < 1e-2


def assert_stays(bodies, ids, within=1e-4):
    start, end = bodies.positions[ids].copy(), bodies.time + 0.8
    while bodies.time < end:
        bodies.step()
        assert np.abs(bodies.positions[ids] - start).max() < within


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("mass", [10, 100])
@pytest.mark.parametrize("count", [3, 5, 10])
def test_a_stack_whose_load_is_removed_stays(count, mass, step):
    bodies = on_ground(step)
    ids = column(bodies, np.ones(count))
    load = bodies.add(CUBE, (0, 0, count + 0.5), mass=mass)
    bodies.advance(2.0)
    bodies.remove([load])
    assert_stays(bodies, ids)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("force", [100, 3000])
@pytest.mark.parametrize("count", [3, 10])
def test_a_stack_whose_force_ends_stays(count, force, step):
    bodies = on_ground(step)
    ids = column(bodies, np.ones(count))

    def press(bodies):
        bodies.set_forces([(0, 0, -force)], [ids[-1]])

    press(bodies)
    bodies.advance(2.0, press)
    bodies.set_forces([(0, 0, 0)], [ids[-1]])
    assert_stays(bodies, ids)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("count", [2, 5, 10])
def test_a_stack_without_weight_stays(count, step):
    bodies = on_ground(step)
    ids = column(bodies, np.ones(count))
    bodies.advance(1.0)
    bodies.gravity = (0, 0, 0)
    assert_stays(bodies, ids)


@pytest.mark.parametrize("step", STEPS)
def test_a_stack_whose_floor_is_removed_falls_together(step):
    bodies = substep.RigidBodies(step=step, sleeping=False)
    floor = bodies.add(CUBE, (0, 0, -0.5), motion="static")
    ids = column(bodies, np.ones(10))
    bodies.advance(1.0)
    bodies.remove([floor])
    bodies.advance(0.5)
    assert bodies.velocities[bodies.rows(ids), 2] == pytest.approx(-0.5 * G, abs=2e-2)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_row_that_was_pressed_at_a_wall_stays(friction, step):
    bodies = substep.RigidBodies(step=step, sleeping=False)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static", friction=friction)
    bodies.add(rigid.Plane((1, 0, 0)), (0, 0, 0), motion="static", friction=0)
    ids = [bodies.add(CUBE, (k + 0.5, 0, 0.5), mass=1.0, friction=friction) for k in range(5)]

    def press(bodies):
        bodies.set_forces([(-1000, 0, 0)], [ids[-1]])

    press(bodies)
    bodies.advance(1.0, press)
    bodies.set_forces([(0, 0, 0)], [ids[-1]])
    assert_stays(bodies, ids, within=2e-3)


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize("height", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("gap", [0, 0.03])
def test_friction_of_an_impact_stops_a_tall_box(gap, height, step):
    # A box that lands flat slips on with max(0, v_t - mu v_n) (Routh), which is 0 here.
    bodies = on_ground(step)  # mu = 0.5
    box = bodies.add(
        rigid.Box((1, 1, height)),
        (0, 0, height / 2 + gap),
        velocities=(1, 0, -3),
        mass=1.0,
    )
    fall = (np.sqrt(9 + 2 * G * gap) - 3) / G
    bodies.advance(fall + 2 * step)
    assert abs(bodies.velocities[box, 0]) < 0.03
    bodies.advance(1.0)
    assert abs(bodies.positions[box, 0] - fall) < 1.5e-3


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("slope", [0.1, 0.3, 0.5])
def test_a_cube_that_lands_on_a_slope_it_holds_on_stays(slope, step):
    # Its impulse is within the cone of friction.
    angle = np.arctan(slope)
    along, normal = (np.cos(angle), 0, np.sin(angle)), (-np.sin(angle), 0, np.cos(angle))
    bodies = substep.RigidBodies(step=step, sleeping=False)
    bodies.add(rigid.Plane(normal), (0, 0, 0), motion="static", friction=0.6)
    turned = (np.cos(angle / 2), 0, -np.sin(angle / 2), 0)
    cube = bodies.add(CUBE, 0.5 * np.array(normal) + (0, 0, 0.3), turned, mass=1.0, friction=0.6)
    bodies.advance(1.25)
    assert abs(bodies.positions[cube] @ along) < 2e-3


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize("speed", [2, 5])
def test_friction_of_an_impact_takes_its_part_of_a_fast_slip(speed, step):
    # The ground gives the momentum m g t, and friction mu of that, at whatever speed.
    bodies = on_ground(step)
    box = bodies.add(
        rigid.Box((0.4, 0.4, 0.3)),
        (0, 0, 0.15 + 0.2),
        velocities=(speed, 0, 0),
        mass=1.0,
        friction=0.4,
    )
    bodies.advance(0.4)
    mu = np.sqrt(0.4 * 0.5)
    assert bodies.velocities[box, 0] == pytest.approx(max(0, speed - mu * G * 0.4), abs=0.025)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_what_is_held_between_the_arms_of_another_is_stopped_with_it(restitution):
    # Each sets the other back by the same, round and round; turned, so that rounding is at work.
    axis = np.array([0.572532, 0.227235, 0.376193, -0.692134])
    turn = np.array(axis / np.linalg.norm(axis))
    w, v = turn[0], turn[1:]
    x = np.array([1.0, 0, 0]) + 2 * np.cross(
        v, np.cross(v, [1.0, 0, 0]) + w * np.array([1.0, 0, 0])
    )
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    bodies.add(rigid.Plane(-x), 0.55 * x, motion="static", restitution=restitution)
    arms = [rigid.Box((0.2, 1, 1), (side, 0, 0)) for side in (-0.4, 0.4)]
    held = rigid.Cylinder(0.3, 0.3)
    for shape in ([*arms, rigid.Box((1, 0.1, 1), (0, -0.55, 0))], held):
        bodies.add(shape, (0, 0, 0), turn, 100 * x, restitution=restitution)
    start = bodies.diagnostics()["kinetic_energy"]
    bodies.advance(0.1)
    assert bodies.diagnostics()["kinetic_energy"] < (1 + 1e-9) * start


def test_an_impact_is_the_same_for_any_threads_and_from_a_state():
    end = []
    for threads in (1, 2, 3):
        bodies, ids = falling_column(1 / 60, np.ones(6), threads=threads)
        bodies.ball(ids[4], ids[5], (0, 0, 5 + DROP))
        bodies.advance(0.2)  # amid the impact
        twin = on_ground(1 / 60)
        ids = column(twin, np.ones(6), DROP)
        twin.ball(ids[4], ids[5], (0, 0, 5 + DROP))
        twin.restore(bodies.state())
        for world in (bodies, twin):
            world.advance(0.3)
            end.append((world.positions.tobytes(), world.momenta.tobytes()))
    assert len(set(end)) == 1


def test_the_end_of_a_load_is_the_same_for_any_threads_and_in_a_copy():
    end = []
    for threads in (1, 2, 3):
        bodies = on_ground(1 / 60, threads=threads)
        column(bodies, np.ones(6))
        load = bodies.add(CUBE, (0, 0, 6.5), mass=100)
        bodies.advance(0.5)
        bodies.remove([load])
        for world in (bodies.copy(), bodies):
            world.advance(0.3)
            end.append((world.positions.tobytes(), world.momenta.tobytes()))
    assert len(set(end)) == 1


@pytest.mark.parametrize("hits", [False, True])
def test_what_moves_elsewhere_lets_a_stack_that_is_put_down_sink_no_more(hits):
    bodies = on_ground(1 / 60)
    stack = bodies.rows(column(bodies, [1.0] * 10))
    bodies.add(CUBE, (5, 0, 0.5), velocities=(1, 0, 0))
    if hits:  # another stack, whose impulses are no beginning for those of rest
        bodies.add(CUBE, (-5, 0, 0.5))
        bodies.add(CUBE, (-5, 0, 1.51), velocities=(0, 0, -5))
    bodies.advance(1.0)
    assert bodies.positions[stack, 2] == pytest.approx(0.5 + np.arange(10), abs=1e-6)
