"""Universal joints, and what joints tell: reactions, efforts, speeds."""

import math

import numpy as np
import pytest
import substep
from substep import rigid

G = 9.81
BEND = math.radians(30)
SHAFT = rigid.Box((1, 0.1, 0.1))


def shafts(motor=None, speed=0.0):
    """A shaft along x, and one that is bent by 30 degrees, by hinges and a universal joint."""
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    way = np.array([math.cos(BEND), math.sin(BEND), 0])
    driver = bodies.add(SHAFT, (-0.5, 0, 0), angular_velocities=(speed, 0, 0))
    turned = (math.cos(BEND / 2), 0, 0, math.sin(BEND / 2))
    spin = speed * math.cos(BEND) * way
    driven = bodies.add(SHAFT, 0.5 * way, turned, angular_velocities=spin)
    first = bodies.hinge(driver, None, (0, 0, 0), (1, 0, 0), motor=motor)
    last = bodies.hinge(driven, None, (0, 0, 0), way)
    across = np.cross((0, 0, 1), way)
    return bodies, first, last, bodies.universal(driven, driver, (0, 0, 0), across, (0, 0, 1))


def ratio(angle):
    """Of the speeds of a cardan joint: tan(out) = tan(in) cos(bend)."""
    c = math.cos(BEND)
    return c / (math.cos(angle) ** 2 + (c * math.sin(angle)) ** 2)


def test_a_cardan_shaft_turns_by_its_closed_form():
    bodies, first, last, cross = shafts(rigid.SpeedMotor(4.0), speed=4.0)
    while bodies.time < 5:
        bodies.step()
        t = first.coordinate
        assert t == pytest.approx(4 * bodies.time, abs=1e-8)
        out = math.atan2(math.sin(t) * math.cos(BEND), math.cos(t))
        assert math.remainder(last.coordinate - out, math.tau) == pytest.approx(0, abs=1e-9)
        assert last.speed == pytest.approx(4 * ratio(t), abs=1e-9)
        assert max(cross.error) < 1e-8
        # Both turns of the cross make up the bend; that in b was 0 where the joint was made.
        turn, bend = cross.coordinates
        assert turn == pytest.approx(cross.coordinate, abs=1e-9)
        assert math.cos(turn) * math.cos(bend + BEND) == pytest.approx(math.cos(BEND), abs=1e-7)
    assert last.coordinate == pytest.approx(20, abs=0.2)  # over turns


def test_a_cardan_shaft_that_turns_freely_keeps_its_energy():
    bodies, first, last, cross = shafts(speed=4.0)
    start = bodies.diagnostics()["energy"]
    while bodies.time < 20:
        bodies.step()
        assert bodies.diagnostics()["energy"] == pytest.approx(start, rel=2e-7)
        # Both shafts have one inertia, so that the energy says how fast they are.
        r = ratio(first.coordinate)
        speed = 4 * math.sqrt((1 + math.cos(BEND) ** 2) / (1 + r * r))
        assert first.speed == pytest.approx(speed, rel=1e-6)
        assert last.speed == pytest.approx(r * speed, rel=1e-6)
    assert max(cross.error) < 1e-8


def test_a_universal_joint_bends_both_ways_and_does_not_twist():
    for axis in ((1, 0, 0), (0, 1, 0)):
        bodies = substep.RigidBodies(sleeping=False)
        rod = bodies.add(rigid.Box((0.1, 0.1, 1)), (0, 0, -0.5), mass=2.0)
        joint = bodies.universal(rod, None, (0, 0, 0), (1, 0, 0), (0, 1, 0))
        for _ in range(60):
            bodies.set_torques([[0, 0, 3.0]])
            bodies.step()
        assert np.abs(bodies.rotations - (1, 0, 0, 0)).max() < 1e-9
        assert joint.torque == pytest.approx([0, 0, -3], abs=1e-7)
        bodies.set_torques([3.0 * np.array(axis)])
        coordinates = []
        bodies.advance(20.0, lambda b, j=joint, c=coordinates: c.append(j.coordinates))
        swing = np.array(coordinates)
        way = int(axis[1])
        assert np.abs(swing[:, 1 - way]).max() < 1e-9
        rises = np.flatnonzero((swing[:-1, way] < 0) & (swing[1:, way] >= 0))
        y = swing[:, way]
        t = (rises - y[rises] / (y[rises + 1] - y[rises])) / 60
        moment = 2 * (1 + 0.01) / 12 + 2 * 0.25
        exact = math.tau * math.sqrt(moment / (2 * G * 0.5))
        assert np.diff(t).mean() == pytest.approx(exact, rel=1e-4)


def test_limits_and_motors_of_a_universal_joint_turn_it_about_the_first_axis():
    bodies = substep.RigidBodies(gravity=(0, 0, 0))
    rod = bodies.add(rigid.Box((0.1, 0.1, 1)), (0, 0, -0.5))
    joint = bodies.universal(rod, None, (0, 0, 0), (0, 1, 0), (1, 0, 0), limits=(-1, 0.5))
    joint.motor = rigid.SpeedMotor(0.25)
    bodies.advance(1.0)
    assert joint.coordinates == pytest.approx([0.25, 0], abs=1e-8)
    assert joint.speed == pytest.approx(0.25, abs=1e-8)
    bodies.advance(2.0)
    assert joint.coordinate == pytest.approx(0.5, abs=1e-8) and joint.kind == "universal"


# What joints tell of themselves.
def test_joints_of_a_hanging_chain_carry_what_is_below():
    bodies, last = substep.RigidBodies(sleeping=False), None
    masses = [1.0, 5.0, 0.1, 20.0, 2.0]
    for k, mass in enumerate(masses):
        link = bodies.add(rigid.Box((0.1, 0.1, 0.2)), (0, 0, -0.1 - 0.2 * k), mass=mass)
        bodies.ball(link, last, (0, 0, -0.2 * k))
        last = link
    for _ in range(3):
        bodies.step()
        for k, joint in enumerate(bodies.joints):
            assert joint.force == pytest.approx([0, 0, G * sum(masses[k:])], abs=1e-8)
            assert joint.torque == pytest.approx([0, 0, 0], abs=1e-8)


def test_a_cantilever_carries_weight_times_length():
    bodies = substep.RigidBodies(sleeping=False)
    load = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (1.5, 0, 0), mass=4.0)
    joint = bodies.fixed(load, None, (0, 0, 0))
    for _ in range(3):
        bodies.step()
        assert joint.force == pytest.approx([0, 0, 4 * G], abs=1e-8)
        assert joint.torque == pytest.approx([0, -4 * G * 1.5, 0], abs=1e-8)
    assert joint.coordinates.shape == (0,) and joint.speed == joint.effort == 0


@pytest.mark.parametrize("kind", ["ball", "hinge", "distance"])
def test_a_pendulum_pulls_by_its_weight_and_by_what_turns_it(kind):
    bodies = substep.RigidBodies(sleeping=False)
    m, v, arm = 2.0, 3.0, 1.5
    turning = (0, -v / arm, 0) if kind != "distance" else (0, 0, 0)
    bob = bodies.add(
        rigid.Sphere(0.1), (0, 0, -arm), mass=m, velocities=(v, 0, 0), angular_velocities=turning
    )
    if kind == "distance":
        joint = bodies.distance(bob, None, (0, 0, -arm), (0, 0, 0))
    else:
        axis = (0, -1, 0)
        joint = getattr(bodies, kind)(bob, None, (0, 0, 0), axis=axis)
    bodies.step(1e-4)
    assert joint.force[2] == pytest.approx(m * (G + v * v / arm), rel=1e-6)
    if kind == "hinge":
        assert joint.speed == pytest.approx(v / arm, rel=1e-6)
        assert joint.effort == 0


def test_forces_of_joints_are_what_momentum_says():
    bodies = substep.RigidBodies(sleeping=False)
    boxes = bodies.add(rigid.Box((0.2, 0.4, 0.6)), [(0.7, 0, 0), (1.4, 0, 0)], mass=3.0)
    inner = bodies.hinge(boxes[0], None, (0.35, 0, 0), (0, 1, 0.3))
    outer = bodies.universal(boxes[1], boxes[0], (1.05, 0, 0), (0, 1, 0), (0, 0, 1))
    weight = np.array([0, 0, -3 * G])
    for _ in range(120):
        before = bodies.momenta.copy()
        bodies.step()
        rate = 60 * (bodies.momenta - before)
        assert outer.force + weight == pytest.approx(rate[1], abs=1e-7)
        assert inner.force - outer.force + weight == pytest.approx(rate[0], abs=1e-7)


def test_efforts_are_what_motors_springs_and_limits_do():
    bodies = substep.RigidBodies(sleeping=False)
    arm, box, flap, weight = bodies.add(
        rigid.Box((0.2, 0.2, 0.2)), [(1, 0, 0), (3, 0, 0), (6, 0, 0), (9, 0, 0)], mass=2.0
    )
    holds = bodies.hinge(arm, None, (0, 0, 0), (0, 1, 0), motor=rigid.SpeedMotor(0.0))
    spring = rigid.SpringMotor(0.0, stiffness=100.0, damping=25.0)
    sags = bodies.slider(box, None, (3, 0, 0), (0, 0, 1), motor=spring)
    stops = bodies.hinge(flap, None, (5.5, 0, 0), (0, 1, 0), limits=(0, 0))
    rope = bodies.distance(weight, None, (9, 0, 0), (9, 0, 1), limits=(0, 1))
    bodies.advance(5.0)
    assert holds.effort == pytest.approx(-2 * G, abs=1e-8)
    assert holds.torque == pytest.approx([0, holds.effort, 0], abs=1e-8)
    assert sags.effort == pytest.approx(2 * G, abs=1e-7)
    assert sags.coordinate == pytest.approx(-2 * G / 100, abs=1e-9)
    assert stops.effort == pytest.approx(-2 * G * 0.5, abs=1e-7)
    assert rope.effort == pytest.approx(-2 * G, abs=1e-8)
    assert all(abs(joint.speed) < 1e-8 for joint in (holds, sags, stops, rope))


def doll(bodies):
    """15 capsules that 14 joints connect, standing 5 cm above the floor."""
    y, z, limbs = (0, 1, 0), (0, 0, 1), []

    def add(parent, axis, anchor, ends, radius, mass):
        first, last = np.add(ends, (0, 0, 0.05))
        d = last - first
        length = np.linalg.norm(d)
        q = (1, 0, 0, 0) if d[2] else np.array([length, -d[1], d[0], 0]) / length / 2**0.5
        limb = bodies.add(substep.Capsule(radius, length), (first + last) / 2, q, mass=mass)
        anchor = np.add(anchor, (0, 0, 0.05))
        if axis is not None:
            bodies.hinge(limb, parent, anchor, axis)
        elif parent is not None:
            bodies.ball(limb, parent, anchor)
        limbs.append(limb)
        return limb

    pelvis = add(None, None, (0, 0, 1), [(0, -0.08, 1), (0, 0.08, 1)], 0.1, 10)
    spine = add(pelvis, None, (0, 0, 1.12), [(0, 0, 1.16), (0, 0, 1.24)], 0.1, 8)
    chest = add(spine, None, (0, 0, 1.33), [(0, -0.08, 1.42), (0, 0.08, 1.42)], 0.11, 12)
    head = add(chest, None, (0, 0, 1.57), [(0, 0, 1.66), (0, 0, 1.72)], 0.09, 5)
    add(head, y, (0, 0, 1.82), [(0, 0, 1.86), (0, 0, 1.88)], 0.03, 0.3)
    for s in (1, -1):
        x = 0.1 * s
        thigh = add(pelvis, None, (0, x, 0.92), [(0, x, 0.56), (0, x, 0.84)], 0.06, 7)
        shin = add(thigh, y, (0, x, 0.5), [(0, x, 0.17), (0, x, 0.43)], 0.05, 4)
        add(shin, y, (0, x, 0.09), [(0, x, 0.05), (0.12, x, 0.05)], 0.04, 1)
        arm = [(0, r * s, 1.45) for r in (0.26, 0.46, 0.57, 0.75)]
        upper = add(chest, None, (0, 0.2 * s, 1.45), arm[:2], 0.045, 2.5)
        add(upper, z, (0, 0.52 * s, 1.45), arm[2:], 0.04, 1.5)
    return limbs


@pytest.mark.parametrize(("step", "least"), [(1 / 30, 0), (1 / 60, 2), (1 / 240, 2)])
def test_ragdolls_lie_still_in_the_end(step, least):
    # How a doll falls is chaos: the nose of one goes on as a pendulum without friction, a limb of
    # another spins between its joints. Others lie without any motion. None gains energy.
    still = 0
    for seed in range(12):
        bodies = substep.RigidBodies(step=step, sleeping=False)
        bodies.add(substep.Plane(), (0, 0, 0), motion="static")
        limbs = doll(bodies)
        bodies.set_velocities(np.random.default_rng(seed).normal(0, 0.02, (15, 3)), limbs)
        bodies.advance(10)
        energy, off = bodies.diagnostics()["energy"], 0.0
        for _ in range(30):
            x, v = bodies.positions[limbs].copy(), bodies.velocities[limbs].copy()
            bodies.step()
            moved = (bodies.positions[limbs] - x) / step
            off = max(off, np.abs(moved - (v + bodies.velocities[limbs]) / 2).max())
        assert bodies.diagnostics()["energy"] < energy + 0.02
        assert max(joint.error[0] for joint in bodies.joints) < 1e-6
        still += off < 1e-9
    assert still >= least


def four_bar(bodies):
    links = (0.05, 0.05, 0.5), (0.05, 0.05, 0.7), (1.02, 0.05, 0.05)
    crank = bodies.add(rigid.Box(links[0]), (0, 0, 0.25))
    rocker = bodies.add(rigid.Box(links[1]), (1, 0, 0.35))
    turn = (math.cos(0.1), 0, -math.sin(0.1), 0)
    coupler = bodies.add(rigid.Box(links[2]), (0.5, 0, 0.6), turn)
    for one, other, at in (
        (crank, None, (0, 0, 0)),
        (rocker, None, (1, 0, 0)),
        (coupler, crank, (0, 0, 0.5)),
        (coupler, rocker, (1, 0, 0.7)),
    ):
        bodies.hinge(one, other, at, (0, 1, 0))


def slider_crank(bodies):
    crank = bodies.add(rigid.Box((0.3, 0.05, 0.05)), (0.15, 0, 0))
    rod = bodies.add(rigid.Box((1, 0.05, 0.05)), (0.8, 0, 0))
    piston = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (1.3, 0, 0))
    bodies.hinge(crank, None, (0, 0, 0), (0, 1, 0))
    bodies.hinge(rod, crank, (0.3, 0, 0), (0, 1, 0))
    bodies.hinge(piston, rod, (1.3, 0, 0), (0, 1, 0))
    bodies.slider(piston, None, (1.3, 0, 0), (1, 0, 0))


def bars(join):
    def build(bodies):
        a, b = bodies.add(rigid.Box((0.4, 0.2, 0.2)), [(0, 0, 0), (0.5, 0, 0)])
        bodies.hinge(a, None, (-0.2, 0, 0), (0, 1, 0))
        bodies.fixed(b, a, (0.25, 0, 0))
        join(bodies, b, a)

    return build


LOOPS = {
    "four-bar": four_bar,
    "slider-crank": slider_crank,
    "fixed and slider": bars(lambda w, b, a: w.slider(b, a, (0.25, 0, 0), (1, 0, 0))),
    "fixed and rod": bars(lambda w, b, a: w.distance(b, a, (0.4, 0, 0.1), (0.1, 0, 0.1))),
}


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("loop", LOOPS.values(), ids=LOOPS)
def test_a_loop_that_asks_for_the_same_twice_is_not_thrown_apart_by_a_hit(loop, seed):
    rng = np.random.default_rng(seed)
    bodies = substep.RigidBodies(sleeping=False)
    bodies.add(substep.Plane(), (0, 0, -2), motion="static")
    loop(bodies)
    for k in range(5):
        at = (rng.uniform(0, 1), rng.uniform(-0.1, 0.1), 1 + 0.5 * k)
        speed = (0, 0, -rng.uniform(0, 10))
        bodies.add(substep.Sphere(0.1), at, mass=3, velocities=speed)
    start = bodies.diagnostics()["energy"]
    while bodies.time < 3:
        bodies.step()
        assert bodies.diagnostics()["energy"] < start + 0.01
    assert bodies.diagnostics()["joint_error"] < 1e-5


def test_a_distance_without_limits_changes_nothing():
    def falls(joined):
        bodies = substep.RigidBodies(sleeping=False)
        a, b = bodies.add(substep.Sphere(0.1), [(0, 0, 0), (1, 0, 0)])
        bodies.hinge(a, None, (-0.5, 0, 0), (0, 1, 0))
        if joined:
            bodies.distance(b, a, (1, 0, 0), (0, 0, 0), limits=(-math.inf, math.inf))
        bodies.advance(1)
        return bodies.positions

    np.testing.assert_allclose(falls(True), falls(False), atol=1e-6)


@pytest.mark.parametrize("stiffness", [1e3, 1e4, 1e6, 1e9])
def test_a_spring_too_stiff_for_the_step_keeps_its_joint(stiffness):
    # sqrt(k / I) h is 2 to 2000: such a spring turns its bodies as far as sub-steps can follow.
    bodies = substep.RigidBodies(sleeping=False)
    arm = bodies.add(rigid.Capsule(0.02, 0.2), (0, 0, -0.1), mass=0.1)
    motor = rigid.SpringMotor(1.0, stiffness)
    joint = bodies.hinge(arm, None, (0, 0, 0), (0, 1, 0), motor=motor)
    most = 0.5 / (bodies.step_size / 8)
    for _ in range(150):
        bodies.step()
        assert max(joint.error) < 1e-8 and abs(joint.speed) < 1.01 * most
        assert abs(joint.coordinate) < 4


def test_a_soft_motor_in_series_with_light_links_is_none_of_those():
    # The small body between the axes has a hundredth of the inertia that the spring moves.
    energies = []
    for light in (1e-3, 1e-5):
        bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
        cross = bodies.add(
            substep.Sphere(0.01),
            (0, 0, 0),
            mass=rigid.MassProperties(light, (0, 0, 0), light * np.eye(3)),
        )
        arm = bodies.add(SHAFT, (0.5, 0, 0))
        bodies.hinge(cross, None, (0, 0, 0), (0, 0, 1), motor=rigid.SpringMotor(0.4, 20.0))
        bodies.hinge(arm, cross, (0, 0, 0), (0, 1, 0), motor=rigid.SpringMotor(0.4, 20.0))
        start = bodies.diagnostics()["kinetic_energy"]
        bodies.advance(0.5)
        energies.append(bodies.diagnostics()["kinetic_energy"] - start)
        assert bodies.diagnostics()["joint_error"] < 1e-8
    assert energies[0] == pytest.approx(energies[1], rel=1e-2) and energies[0] > 0.1


def test_a_joint_that_a_step_would_tear_apart_is_named_and_the_step_is_not_taken():
    bodies = substep.RigidBodies(sleeping=False)
    arm = bodies.add(rigid.Capsule(0.02, 0.2), (0, 0, -0.1), mass=0.1)
    bodies.ball(bodies.add(rigid.Sphere(0.1), (3, 0, 0)), None, (3, 0, 0)).remove()
    joint = bodies.hinge(arm, None, (0, 0, 0), (0, 1, 0), motor=rigid.SpeedMotor(3000.0))
    with pytest.raises(substep.SolverError, match=f"joint {joint.number}: .*take a shorter step"):
        while bodies.time < 0.5:
            before = bodies.positions.copy(), bodies.momenta.copy()
            bodies.step()
    assert np.array_equal((bodies.positions, bodies.momenta), before)
    joint.motor = None
    bodies.advance(0.1)
    # Bodies that were put apart come together instead.
    bodies.set_positions([(1, 0, 0)], [arm])
    bodies.advance(2)
    assert max(joint.error) < 1e-8
    joint.motor = rigid.SpeedMotor(3000.0)
    with pytest.raises(substep.SolverError, match="world 0: joint 0: ") as raised:
        substep.RigidBatch(bodies, 2).advance(1.0)
    assert raised.value.index == 0


@pytest.mark.parametrize("limits", [(0.5, 1.0), (-1.0, -0.5)])
def test_a_limit_that_is_passed_where_it_is_set_is_kept_again(limits):
    bodies = substep.RigidBodies(sleeping=False, gravity=(0, 0, 0))
    arm = bodies.add(SHAFT, (0.5, 0, 0))
    joint = bodies.hinge(arm, None, (0, 0, 0), (0, 1, 0), limits=limits)
    bead = bodies.add(substep.Sphere(0.1), (0, 3, 0))
    slider = bodies.slider(bead, None, (0, 3, 0), (0, 1, 0), limits=limits)
    bodies.advance(1)
    nearest = min(limits, key=abs)
    assert joint.coordinate == pytest.approx(nearest, abs=1e-7)
    assert slider.coordinate == pytest.approx(nearest, abs=1e-7)
    assert bodies.diagnostics()["kinetic_energy"] < 1e-12


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("mass", [0.01, 0.5, 50.0])
@pytest.mark.parametrize("acceleration", [4.0, 20.0, 40.0, 200.0])
def test_a_weak_motor_leaves_the_limit_at_which_it_begins(acceleration, mass, side):
    """Also where an impulse at the anchor would move a body without a joint otherwise."""
    bodies = substep.RigidBodies(sleeping=False, gravity=(0, 0, 0))
    cube = bodies.add(rigid.Box((0.1, 0.1, 0.1)), (0, 0, 0), mass=mass)
    motor = rigid.SpeedMotor(0.1 * side, strength=acceleration * mass)
    limits = sorted((0, 0.07 * side))
    slider = bodies.slider(cube, None, (0, 0, 0.14), (1, 0, 0), limits=limits, motor=motor)
    bodies.advance(0.4)
    way = 0.04 - 0.5 * 0.1**2 / acceleration
    assert slider.coordinate * side == pytest.approx(way, abs=0.1 / 480)
    bodies.advance(0.4)
    assert slider.coordinate * side == pytest.approx(0.07, abs=1e-9)


@pytest.mark.parametrize("rate", [8.0, 12.0, 20.0])
def test_a_ball_on_a_light_stick_whirls_on(rate):
    # Under m r w^2 the stick of 10 g would swing at up to 3000 rad/s; its ball weighs 4 kg.
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    along = (math.sqrt(0.5), 0, math.sqrt(0.5), 0)
    turn = {"angular_velocities": (0, 0, rate)}
    ball = bodies.add(rigid.Sphere(0.2), (0.8, 0, 0), mass=4, velocities=(0, 0.8 * rate, 0), **turn)
    stick = bodies.add(
        rigid.Capsule(0.01, 0.75, rotation=along),
        (0.4, 0, 0),
        mass=0.01,
        velocities=(0, 0.4 * rate, 0),
        **turn,
    )
    bodies.ball(stick, None, (0, 0, 0))
    bodies.hinge(ball, stick, (0.8, 0, 0), (1, 0, 0), collide=False)
    start = bodies.diagnostics()["energy"]
    bodies.advance(10)
    assert bodies.diagnostics()["energy"] == pytest.approx(start, rel=2e-3)
    assert bodies.angular_velocities[ball] == pytest.approx((0, 0, rate), rel=1e-3)


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize(
    ("mass", "finger", "slip"), [(10, 0.1, 2e-3), (10, 1, 2e-4), (10, 10, 2e-5), (1, 0.1, 2e-4)]
)
@pytest.mark.parametrize("moving", [False, True])
def test_fingers_on_sliders_hold_what_their_friction_carries(moving, finger, mass, slip, step):
    # Two motors press by F with 2 mu F = 2 m g while the table below goes away. Nothing slips, but
    # where the hand goes up at once at v: then by v^2 / 2 g, as friction accelerates the box by g.
    bodies = substep.RigidBodies(step=step, sleeping=False)
    mu = 0.5
    force = mass * G / mu
    table = bodies.add(rigid.Box((2, 2, 0.1)), (0, 0, -0.05), motion="kinematic", friction=0.5)
    hand = bodies.add(rigid.Box((1, 0.1, 0.1)), (0, 0, 0.8), motion="kinematic", mask=0)
    pads = []
    for side in (-1, 1):
        at = (side * 0.111, 0, 0.15)
        pad = bodies.add(rigid.Box((0.02, 0.1, 0.2)), at, mass=finger, friction=mu)
        motor = rigid.SpeedMotor(-0.5 * side, strength=force)
        bodies.slider(pad, hand if moving else None, at, (1, 0, 0), motor=motor)
        pads.append(pad)
    box = bodies.add(rigid.Box((0.2, 0.1, 0.2)), (0, 0, 0.1), mass=mass, friction=mu)
    bodies.advance(0.5)
    bodies.set_velocities((0, 0, 0.1 if moving else 0), hand)
    bodies.set_velocities((0, 0, 0 if moving else -0.1), table)

    def height():
        return bodies.positions[box, 2] - bodies.positions[pads, 2].mean()

    start = height()
    bodies.advance(1.0)
    held = height()
    assert start - held < slip + (0.1**2 / (2 * G) if moving else 0)
    assert held - start < 1e-5
    bodies.advance(2.0)
    assert height() == pytest.approx(held, abs=1e-5)  # no creep
    assert bodies.contact_force(box)[2] == pytest.approx(mass * G, rel=1e-3)
    assert abs(bodies.contact_force(box, pads[0])[0]) == pytest.approx(force, rel=1e-3)


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
def test_fingers_on_sliders_let_go_of_what_their_friction_does_not_carry(step):
    # With half of the force that holds, the box falls at g (1 - 2 mu F / m g).
    bodies = substep.RigidBodies(step=step, sleeping=False)
    mu, mass = 0.5, 10.0
    force = 0.5 * mass * G / (2 * mu)
    for side in (-1, 1):
        at = (side * 0.11, 0, 0)
        pad = bodies.add(rigid.Box((0.02, 0.1, 0.8)), at, mass=1.0, friction=mu)
        motor = rigid.SpeedMotor(-0.5 * side, strength=force)
        bodies.slider(pad, None, at, (1, 0, 0), motor=motor)
    box = bodies.add(rigid.Box((0.2, 0.1, 0.2)), (0, 0, 0), mass=mass, friction=mu)
    bodies.advance(0.1)
    start = bodies.velocities[box, 2]
    bodies.advance(0.1)
    assert bodies.velocities[box, 2] - start == pytest.approx(-0.05 * G, rel=1e-3)
