"""Rigid bodies from Python: arrays and frames, motion, contact, joints, queries, checkpoints."""

import gc
import math
import pickle

import numpy as np
import pytest
import substep
from substep import InputError, rigid

G = 9.81
UNIT = (1.0, 0, 0, 0)
BOX = rigid.Box((1, 1, 1))
BALL = rigid.Sphere(0.25)
KINDS = ("ball", "hinge", "slider", "fixed", "distance", "universal", "elastic")
CORNER = [[0, 0, 0], [0.6, 0, 0], [0, 0.4, 0], [0, 0, 0.3]]
SHAPES = {
    "sphere": BALL,
    "box": rigid.Box((0.6, 0.4, 0.2)),
    "capsule": rigid.Capsule(0.1, 0.6),
    "cylinder": rigid.Cylinder(0.2, 0.6),
    "hull": rigid.ConvexHull(CORNER),
}


def world(**options):
    return substep.RigidBodies(**options)


def on_ground(**options):
    bodies = world(**options)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
    return bodies


def space(**options):
    return world(gravity=(0, 0, 0), **options)


def about(axis, angle):
    """Quaternion of a turn."""
    n = np.asarray(axis, float) / np.linalg.norm(axis)
    return [math.cos(angle / 2), *(math.sin(angle / 2) * n)]


def turned(q, v):
    """Vectors turned by unit quaternions, by the definition q v q*."""
    w, u = q[..., :1], q[..., 1:]
    return (w**2 - (u**2).sum(-1, keepdims=True)) * v + 2 * (
        (u * v).sum(-1, keepdims=True) * u + w * np.cross(u, v)
    )


def state_hash(bodies):
    return substep.state_hash(*bodies.state().values())


def same_turn(p, q):
    return np.abs((np.asarray(p) * q).sum(axis=-1)) == pytest.approx(1, abs=1e-12)


def pile(n=27, seed=3, **options):
    """Boxes, balls, hulls and hammers above the ground."""
    rng = np.random.default_rng(seed)
    bodies = on_ground(**options)
    hammer = [
        rigid.Box((0.2, 0.1, 0.1), center=(0, 0, 0.2)),
        rigid.Fixture(rigid.Capsule(0.03, 0.3)),
    ]
    kinds = [rigid.Box((0.2, 0.2, 0.2)), rigid.Sphere(0.1), rigid.ConvexHull(CORNER), hammer]
    for k in range(n):
        x = 0.4 * np.array([k % 3, k // 3 % 3, 1 + k // 9]) + rng.uniform(-0.05, 0.05, 3)
        bodies.add(kinds[k % 4], x, rng.normal(size=4), friction=0.6, restitution=0.2 * (k % 2))
    return bodies


def machines(**options):
    """A chain for each kind of joint, in mid-swing."""
    bodies = substep.RigidBodies(**options)
    for row, kind in enumerate(KINDS):
        for k in range(3):
            x = np.array([0.7 * k, 2.0 * row, 0])
            link = bodies.add(rigid.Box((0.2, 0.4, 0.6)), x, mass=1.0 + k)
            join(bodies, kind, link, link - 1 if k else None, x)
    bodies.advance(0.5)
    return bodies


def join(bodies, kind, link, last, x):
    """Join the link at x to the last one, 0.7 m before it along x."""
    anchor = x - (0.35, 0, 0)
    if kind == "hinge":
        return bodies.hinge(link, last, anchor, (0, 1, 0.3 * link))
    if kind == "slider":
        return bodies.slider(link, last, anchor, (1, 0.1 * link, 0.2), limits=(-1, 1))
    if kind == "distance":
        return bodies.distance(link, last, x, x - (0.7, 0, 0))
    if kind == "universal":
        return bodies.universal(link, last, anchor, (0, 1, 0), (0, 0, 1))
    if kind == "elastic":
        spring = rigid.TurnSpring(20.0, 10.0, 0.2, 0.1)
        return bodies.elastic(link, last, anchor, (1, 0, 0), spring)
    return getattr(bodies, kind)(link, last, anchor)


# Arrays and frames.
@pytest.mark.parametrize("name", SHAPES)
def test_frames_of_shapes_come_back(name):
    rng = np.random.default_rng(1)
    x, q = rng.normal(size=(5, 3)), rng.normal(size=(5, 4))
    bodies = space()
    ids = bodies.add(SHAPES[name], x, q, mass=2.0)
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    assert ids.tolist() == [0, 1, 2, 3, 4] == bodies.ids.tolist()
    assert bodies.positions == pytest.approx(x, abs=1e-14)
    assert same_turn(bodies.rotations, unit)
    weight = rigid.mass_properties(SHAPES[name])
    assert bodies.centers_of_mass == pytest.approx(
        x + turned(unit, weight.center_of_mass), abs=1e-14
    )
    assert bodies.masses == pytest.approx(2.0)
    assert bodies.inertia == pytest.approx(
        np.tile(weight.principal_inertia * 2 / weight.mass, (5, 1))
    )


def test_velocities_are_those_of_the_centre_and_momenta_follow():
    bodies = space()
    hull = bodies.add(rigid.ConvexHull(CORNER), (1, 2, 3), velocities=(1, 0, 2), mass=3.0,
                      angular_velocities=(0.5, -1, 2))  # fmt: skip
    assert bodies.velocities[hull] == pytest.approx([1, 0, 2])
    assert bodies.angular_velocities[hull] == pytest.approx([0.5, -1, 2])
    assert bodies.momenta[hull] == pytest.approx([3, 0, 6])
    weight = rigid.mass_properties(rigid.ConvexHull(CORNER))
    L = weight.inertia * (3 / weight.mass) @ [0.5, -1, 2]
    assert bodies.angular_momenta[hull] == pytest.approx(L, rel=1e-12)
    assert bodies.diagnostics()["kinetic_energy"] == pytest.approx(
        0.5 * 3 * 5 + 0.5 * L @ [0.5, -1, 2]
    )


def test_compounds_weigh_what_their_parts_do():
    bodies = space()
    balls = [rigid.Sphere(BALL.radius, (0, 0, z)) for z in (0, 2)]
    bar = [rigid.Fixture(ball, density=d) for ball, d in zip(balls, (1000, 3000), strict=True)]
    k = bodies.add(bar, (0, 0, 0))
    m = 4 / 3 * math.pi * 0.25**3 * 1000
    assert bodies.masses[k] == pytest.approx(4 * m)
    assert bodies.positions[k].tolist() == [0, 0, 0]
    assert bodies.centers_of_mass[k] == pytest.approx([0, 0, 1.5])
    own = 0.4 * 0.25**2
    assert sorted(bodies.inertia[k]) == pytest.approx(
        sorted([4 * m * own, *[4 * m * own + m * 1.5**2 + 3 * m * 0.5**2] * 2])
    )
    assert [f.shape.center for f in bodies.fixtures(k)] == [(0, 0, 0), (0, 0, 2)]


def test_mass_and_inertia_can_be_given():
    bodies = space()
    tetrahedron = rigid.mass_properties(rigid.ConvexHull(CORNER), 500)
    for given, mass, moments in [
        ({"density": 2.0}, 2.0, [1 / 3] * 3),
        ({"mass": 6.0}, 6.0, [1.0] * 3),
        ({"mass": 6.0, "inertia": [1, 2, 2.5]}, 6.0, [1, 2, 2.5]),
        ({"inertia": [[2, 1, 0], [1, 2, 0], [0, 0, 3]]}, 1000.0, [1, 3, 3]),
        ({"mass": tetrahedron}, tetrahedron.mass, tetrahedron.principal_inertia),
    ]:
        k = bodies.add(BOX, (0, 0, 0), **given)
        assert bodies.masses[k] == pytest.approx(mass)
        assert sorted(bodies.inertia[k]) == pytest.approx(sorted(moments))
    assert bodies.centers_of_mass[k] == pytest.approx(tetrahedron.center_of_mass)


def test_one_or_many_and_none():
    bodies = space()
    assert bodies.add(BALL, (0, 0, 0)) == 0 and len(bodies) == 1
    assert bodies.add(BALL, [[1, 0, 0]]).tolist() == [1]
    assert bodies.add(BALL, np.zeros((0, 3))).tolist() == []
    q = [UNIT, about((0, 0, 1), 1.0)]
    assert bodies.add(BALL, [[2, 0, 0], [3, 0, 0]], q, (1, 0, 0)).tolist() == [2, 3]
    assert bodies.velocities[2:].tolist() == [[1, 0, 0]] * 2
    empty = world()
    empty.advance(0.5)
    assert empty.time == 0.5 and empty.positions.shape == (0, 3)
    assert empty.diagnostics()["kinetic_energy"] == 0 and len(empty.contacts()) == 0


def test_views_are_the_state():
    bodies = space()
    bodies.add(BALL, [[0, 0, 0], [5, 0, 0]], mass=2.0)
    names = ("centers_of_mass", "momenta", "principal_rotations", "angular_momenta")
    views = x, P, q, L = [getattr(bodies, name) for name in names]
    P[1] = [2, 0, 0]
    L[0] = [0, 0, 0.01]
    q[1] = [0, 3, 0, 0]  # not of length 1
    bodies.step(0.5)
    assert x[1] == pytest.approx([5.5, 0, 0]) and q[1].tolist() == [0, 1, 0, 0]
    assert q[0] == pytest.approx(about((0, 0, 1), 0.5 * 0.01 / bodies.inertia[0, 0]))
    for view, name in zip(views, names, strict=True):
        assert view.ctypes.data == getattr(bodies, name).ctypes.data and not view.flags.owndata
    before = state_hash(bodies)
    state = bodies.state()
    bodies.step(0.5)
    bodies.restore(state)
    assert state_hash(bodies) == before
    assert x.ctypes.data == bodies.centers_of_mass.ctypes.data and x[1, 0] == 5.5


def test_views_live_as_long_as_they_are_held():
    bodies = space()
    bodies.add(BALL, [[k, 0.0, 0] for k in range(1000)])
    x, q = bodies.centers_of_mass, bodies.principal_rotations
    bodies.add(BALL, (-1, 0, 0))
    bodies.remove([0, 500])
    bodies.centers_of_mass[:] += 1
    assert x[:, 0].tolist() == list(range(1000))  # what they were of, not what came later
    assert q.shape == (1000, 4) and (q == UNIT).all()
    assert bodies.positions.shape == (999, 3)
    last = bodies.centers_of_mass
    del bodies
    gc.collect()
    last[:, 1] = 7.0
    assert last[0].tolist() == [2, 7, 1]


def test_ids_stay_while_bodies_come_and_go():
    bodies = space()
    ids = bodies.add(BALL, [[k, 0.0, 0] for k in range(5)])
    bodies.remove(ids[[1, 3]])
    assert bodies.ids.tolist() == [0, 2, 4]
    assert bodies.positions[:, 0].tolist() == [0, 2, 4]
    assert bodies.rows([4, 0, 2]).tolist() == [2, 0, 1] and bodies.rows(ids[2:3]).tolist() == [1]
    assert bodies.rows(4) == 2 and isinstance(bodies.rows(ids[4]), int)
    with pytest.raises(IndexError, match="there is no body 3"):
        bodies.rows([0, 3])
    assert bodies.add(BALL, (9, 0, 0)) == 5
    bodies.set_velocities((0, 0, 1), ids=4)
    assert bodies.velocities[:, 2].tolist() == [0, 0, 1, 0]
    bodies.remove(bodies.ids)
    assert len(bodies) == 0 and bodies.add(BALL, (0, 0, 0)) == 6


def test_setters():
    bodies = space()
    hull = rigid.ConvexHull(CORNER)
    ids = bodies.add(hull, [[k, 0.0, 0] for k in range(3)])
    ground = bodies.add(BOX, (9, 9, 9), motion="static")
    q = about((1, 2, 3), 0.7)
    bodies.set_positions([0, 5, 0], ids=[0, 2])
    bodies.set_rotations(q, ids=[0, 2])
    assert bodies.positions[[0, 2]] == pytest.approx(np.array([[0, 5, 0]] * 2), abs=1e-14)
    assert same_turn(bodies.rotations[[0, 2]], q)
    bodies.set_positions([[1, 1, 1]], ids[:1])
    assert bodies.positions[0] == pytest.approx([1, 1, 1]) and same_turn(bodies.rotations[0], q)
    bodies.set_velocities((1, 2, 3))
    before = bodies.momenta.copy()
    bodies.set_angular_velocities((0.3, 0.1, 2))
    assert bodies.momenta.tolist() == before.tolist()
    spins = bodies.angular_momenta.copy()
    assert bodies.angular_velocities[ids] == pytest.approx(np.array([[0.3, 0.1, 2]] * 3))
    bodies.set_velocities([[4, 5, 6]] * 4)
    assert bodies.angular_momenta.tolist() == spins.tolist()
    assert bodies.velocities[ids] == pytest.approx(np.array([[4, 5, 6]] * 3))
    assert not bodies.velocities[ground].any() and not bodies.angular_velocities[ground].any()
    with pytest.raises(InputError, match="a static body has no velocity"):
        bodies.set_velocities((0, 0, 1), ids=ground)


def test_copies_are_read_only():
    bodies = on_ground()
    bodies.add(BALL, (0, 0, 1))
    names = ("positions", "rotations", "velocities", "angular_velocities", "masses", "inertia",
             "ids", "motions", "asleep", "gravity")  # fmt: skip
    for name in names:
        with pytest.raises(ValueError, match="read-only"):
            getattr(bodies, name)[:1] = getattr(bodies, name)[:1]


# Motion.
def test_free_fall_is_a_parabola():
    bodies = world()
    k = bodies.add(BOX, (0, 0, 100), velocities=(3, 0, 1))
    bodies.advance(2.0)
    assert bodies.time == 2.0
    assert bodies.positions[k] == pytest.approx([6, 0, 102 - G * 2], rel=1e-12)
    assert bodies.velocities[k] == pytest.approx([3, 0, 1 - 2 * G], rel=1e-12)


@pytest.mark.parametrize(("rotation", "bound"), [("exact", 1e-10), ("splitting", 1e-4)])
def test_free_rotation_keeps_the_energy(rotation, bound):
    bodies = space(rotation=rotation, step=1 / 240)
    plate = rigid.Box((1, 0.5, 0.2))
    bodies.add(plate, (0, 0, 0), mass=1.0, angular_velocities=(0.01, 5, 0))
    L = bodies.angular_momenta.copy()
    energy = bodies.diagnostics()["kinetic_energy"]
    bodies.advance(10.0)
    assert bodies.diagnostics()["kinetic_energy"] == pytest.approx(energy, rel=bound)
    assert bodies.angular_momenta.tolist() == L.tolist()


def test_forces_act_for_one_step():
    bodies = space()
    ids = bodies.add(BALL, [[0, 0, 0], [2, 0, 0], [4, 0, 0]], mass=2.0)
    bodies.forces[0] = [4, 0, 0]
    bodies.torques[1] = [0, 0, 1]
    bodies.apply_force(ids[2], (0, 3, 0), (5, 0, 0))
    bodies.step(0.5)
    assert not bodies.forces.any() and not bodies.torques.any()
    assert bodies.momenta == pytest.approx(np.array([[2, 0, 0], [0, 0, 0], [0, 1.5, 0]]))
    assert bodies.angular_momenta[:, 2] == pytest.approx([0, 0.5, 1.5])
    bodies.step(0.5)
    assert bodies.momenta[0] == pytest.approx([2, 0, 0])
    bodies.set_forces((0, 0, 6), ids=ids[1])
    bodies.set_torques([[0, 0, 2]] * 3)
    bodies.step(0.5)
    assert bodies.momenta[1] == pytest.approx([0, 0, 3])
    assert bodies.angular_momenta[:, 2] == pytest.approx([1, 1.5, 2.5])
    assert not bodies.forces.any() and not bodies.torques.any()


def test_gravity_can_be_changed():
    bodies = on_ground()
    box = bodies.add(BOX, (0, 0, 0.5), mass=2.0)
    bodies.advance(2.0)
    assert bodies.asleep[box]
    twin = bodies.copy()
    bodies.gravity = (0, 0, 3.0)
    assert bodies.gravity.tolist() == [0, 0, 3] and twin.gravity.tolist() == [0, 0, -9.81]
    bodies.step()
    assert bodies.velocities[box] == pytest.approx([0, 0, 3 * bodies.step_size])
    bodies.advance(1.0)
    again = pickle.loads(pickle.dumps(bodies))
    again.advance(0.5)
    assert again.velocities[box, 2] == pytest.approx(3 * (1.5 + bodies.step_size))
    for wrong in ((0, 0), (0, 0, math.nan)):
        with pytest.raises(InputError, match="gravity"):
            bodies.gravity = wrong


def test_impulses_act_at_once():
    bodies = space()
    ids = bodies.add(BALL, [[0, 0, 0], [2, 0, 0]], mass=2.0)
    bodies.apply_impulse(ids, (0, 4, 0), [[0, 0, 0], [3, 0, 0]])
    assert bodies.velocities.tolist() == [[0, 2, 0]] * 2
    assert bodies.angular_momenta.tolist() == [[0, 0, 0], [0, 0, 4]]
    ground = bodies.add(BALL, (9, 9, 9), motion="static")
    bodies.apply_impulse(ground, (0, 0, 1))
    bodies.apply_force(ground, (0, 0, 1))
    bodies.step()
    assert bodies.positions[2].tolist() == [9, 9, 9]


def test_kinematic_bodies_go_their_way_and_push():
    bodies = space()
    plate = bodies.add(rigid.Box((0.2, 2, 2)), (0, 0, 0), velocities=(1, 0, 0), motion="kinematic")
    ball = bodies.add(BALL, (1, 0, 0), mass=1e6)
    bodies.advance(2.0)
    assert bodies.positions[plate] == pytest.approx([2, 0, 0])
    assert bodies.positions[ball, 0] == pytest.approx(2 + 0.1 + 0.25, abs=2e-3)
    assert bodies.momenta[plate].tolist() == [1, 0, 0]
    assert bodies.motions.tolist() == ["kinematic", "dynamic"]
    assert bodies.masses.tolist() == [math.inf, 1e6]
    bodies.set_velocities((0, 0, 0), ids=plate)
    bodies.set_angular_velocities((0, 0, 1), ids=plate)
    bodies.advance(0.5)
    assert same_turn(bodies.rotations[plate], about((0, 0, 1), 0.5))


# Contact.
def test_boxes_rest_on_one_another():
    bodies = on_ground()
    stack = bodies.add(BOX, [[0, 0, 0.5], [0, 0, 1.5], [0, 0, 2.5]], mass=2.0)
    bodies.advance(0.4)
    assert bodies.positions[stack] == pytest.approx(
        np.array([[0, 0, 0.5], [0, 0, 1.5], [0, 0, 2.5]]), abs=1e-3
    )
    report = bodies.contacts()
    assert report.bodies.tolist() == [[0, 1], [1, 2], [2, 3]]
    assert report.normals == pytest.approx(np.array([[0, 0, 1.0]] * 3))
    weights = 2 * G * np.array([3, 2, 1]) * bodies.step_size
    assert report.impulses == pytest.approx(weights, rel=1e-6)
    assert report.friction_impulses == pytest.approx(0, abs=1e-9)
    assert np.bincount(report.contact).tolist() == [4, 4, 4]
    sums = np.bincount(report.contact, report.point_impulses)
    assert sums == pytest.approx(report.impulses)
    assert (np.abs(report.separations) < 1e-3).all()
    assert np.unique(report.points[:, 2].round(2)).tolist() == [0, 1, 2]
    told = bodies.diagnostics()
    assert told["contacts"] == 3 and 0 <= told["penetration"] < 1e-3


@pytest.mark.parametrize("restitution", [0.0, 0.7])
@pytest.mark.parametrize("slip", [0.0, 3.0])
def test_reported_impulses_are_all_that_contact_did(restitution, slip):
    """Of a ball that lands, bounces, slips and rolls: they are what its momentum changes by."""
    bodies = on_ground(sleeping=False)
    ball = bodies.add(BALL, (0, 0, 0.6), velocities=(slip, 0, 0), mass=2.0, restitution=restitution)
    weight, pressed = np.array([0, 0, -2 * G]), 0
    for _ in range(60):
        before = bodies.momenta[ball].copy()
        bodies.step(1 / 60)
        report = bodies.contacts()
        given = (report.impulses[:, None] * report.normals + report.friction_impulses).sum(axis=0)
        change = bodies.momenta[ball] - before
        assert given == pytest.approx(change - weight / 60, abs=1e-9)
        pressed += given[2] > 0
    assert pressed > 2


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8])
def test_bounces_follow_restitution(restitution):
    bodies = on_ground()
    ball = bodies.add(BALL, (0, 0, 0.25 + 1), restitution=restitution)
    heights = []
    bodies.advance(
        1.1, lambda b: heights.append((b.positions[ball, 2], b.velocities[ball, 2], b.time))
    )
    z = np.array(heights)
    after = z[z[:, 2] > math.sqrt(2 / G) + 0.05]
    energy = G * (after[:, 0] - 0.25) + after[:, 1] ** 2 / 2  # over the mass
    until = math.sqrt(2 / G) * (1 + 2 * restitution) - 0.05 if restitution else 9
    flight = after[:, 2] < until
    assert flight.sum() > 5
    assert energy[flight] == pytest.approx(restitution**2 * G, rel=1e-3, abs=2e-3)


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize("e", [0.5, 1.0])
@pytest.mark.parametrize("gap", [3e-5, 5e-4, 2e-3, 5e-3, 0.01, 0.02, 0.04])
def test_a_ball_bounces_off_one_that_has_just_bounced(gap, e, step):
    """One of 1 kg above one of 10 kg: two impacts, one after the other, often within a step."""
    bodies = on_ground(step=step)
    z = 1.1, 1.1 + 0.15 + gap
    for radius, height, mass in zip((0.1, 0.05), z, (10, 1), strict=True):
        bodies.add(rigid.Sphere(radius), (0, 0, height), mass=mass, restitution=e, friction=0)
    lands, v = math.sqrt(2 / G), math.sqrt(2 * G)
    meets = gap / ((1 + e) * v)
    v_low, v_high = e * v - G * meets, -v - G * meets
    after = v_high + (1 + e) * 10 / 11 * (v_low - v_high)
    bodies.advance(lands + meets + 0.05)
    assert bodies.velocities[2, 2] == pytest.approx(after - 0.05 * G, rel=1e-6)


@pytest.mark.parametrize("e", [0.5, 1.0])
def test_a_row_of_balls_with_gaps_passes_an_impact_on(e):
    bodies = substep.RigidBodies(gravity=(0, 0, 0))
    gaps = np.array([0, 2e-4, 3e-3, 0.02, 5e-5])
    x = 0.2 * np.arange(5) + np.cumsum(gaps)
    for at in x:
        bodies.add(rigid.Sphere(0.1), (at, 0, 0), restitution=e, friction=0)
    bodies.set_velocities((4, 0, 0), [0])
    bodies.advance(0.1)
    fastest = 4 * (0.5 + 0.5 * e) ** 4
    assert bodies.velocities[-1, 0] == pytest.approx(fastest, rel=1e-9)
    assert bodies.velocities[:, 0].mean() == pytest.approx(0.8, rel=1e-12)


@pytest.mark.parametrize(("friction", "slides"), [(0.3, True), (0.6, False)])
def test_boxes_on_an_incline(friction, slides):
    angle = math.atan(0.5)
    bodies = world()
    q = about((0, 1, 0), angle)
    up = turned(np.array(q), np.array([0.0, 0, 1]))
    bodies.add(rigid.Plane(up), (0, 0, 0), motion="static", friction=friction)
    box = bodies.add(rigid.Box((0.4, 0.4, 0.4)), 0.2 * up, q, friction=friction)
    bodies.advance(0.25)
    first = np.linalg.norm(bodies.velocities[box])
    bodies.advance(1.0)
    if slides:
        a = G * (math.sin(angle) - friction * math.cos(angle))
        assert np.linalg.norm(bodies.velocities[box]) - first == pytest.approx(a, rel=1e-4)
    else:
        assert np.linalg.norm(bodies.positions[box] - 0.2 * up) < 5e-5


def test_rolling_and_spinning_friction_stop():
    for option, w in (("rolling_friction", (0, 4, 0)), ("spinning_friction", (0, 0, 4))):
        for lever in (0.0, 0.01):
            bodies = on_ground()
            v = (4 * 0.25, 0, 0) if option == "rolling_friction" else (0, 0, 0)
            ball = bodies.add(
                BALL, (0, 0, 0.25), velocities=v, angular_velocities=w, **{option: lever}
            )
            bodies.advance(1.5)
            speed = np.linalg.norm(bodies.angular_velocities[ball])
            assert speed == pytest.approx(4, rel=0.02) if lever == 0 else speed < 3.2


def test_a_copy_of_jointed_bodies_in_contact_goes_on_with_the_same_bits():
    bodies = on_ground()
    light = bodies.add(rigid.Cylinder(0.1, 0.3), (0, 0, 0.7), density=10)
    ball = bodies.add(rigid.Sphere(0.1), (0.7, 0, 0.8), density=8000)
    arm = bodies.add(rigid.Capsule(0.1, 0.4), (1.05, 0, 0.85), density=8000)
    motor = rigid.SpeedMotor(2.0, 5.0)
    bodies.ball(ball, light, (0.35, 0, 0.75))
    bodies.hinge(arm, light, (0.525, 0, 0.77), (0, 1, 0), limits=(-0.5, 0.5), motor=motor)
    for _ in range(90):
        copy = bodies.copy()
        bodies.step()
        copy.step()
        assert bodies.positions.tobytes() == copy.positions.tobytes()


@pytest.mark.parametrize("shape", [rigid.Capsule(0.05, 0.4), rigid.Box((0.1, 0.1, 0.5))])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_contact_forces_are_all_that_changes_momentum(shape, restitution):
    bodies = on_ground(step=1 / 240)
    tilt = (math.cos(0.64), 0, math.sin(0.64), 0)
    body = bodies.add(shape, (0, 0, 0.5), tilt, mass=1.0, restitution=restitution)
    given = 0.0
    while bodies.time < 1:
        bodies.step()
        given += bodies.contact_force(body)[2] * bodies.report.dt
        change = G * bodies.time + bodies.momenta[body][2]
        # Bodies that stand lose what speed they have below half of what gravity gives a sub-step.
        settles = np.linalg.norm(bodies.velocities[body]) < 0.5 * G * bodies.report.dt / 8
        assert given == pytest.approx(change, rel=1e-6 if settles else 1e-9, abs=1e-12)


def test_rolling_friction_holds_a_ball_beside_one_that_rolls():
    bodies = substep.RigidBodies(gravity=(0.5, 0, -G))
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
    bodies.add(BALL, (0, 3, 0.25), velocities=(1, 0, 0), angular_velocities=(0, 4, 0))
    held = bodies.add(BALL, (0, 0, 0.25), rolling_friction=0.025)  # up to twice this slope
    bodies.advance(1.0)
    assert abs(bodies.positions[held, 0]) < 1e-5


def test_groups_and_masks_and_excluded_pairs():
    bodies = on_ground()
    sieve = bodies.add(rigid.Box((10, 10, 0.2)), (0, 0, 1), motion="static", group=2)
    held = bodies.add(BALL, (0, 0, 1.5))
    falls = bodies.add(BALL, (1, 0, 1.5), mask=1)
    excluded = bodies.add(BALL, (2, 0, 1.5))
    bodies.exclude(sieve, excluded)
    bodies.advance(1.0)
    z = bodies.positions[:, 2]
    assert z[held] == pytest.approx(1.35, abs=1e-3)
    assert z[falls] == pytest.approx(0.25, abs=1e-3)
    assert z[excluded] == pytest.approx(0.25, abs=1e-3)


def test_open_meshes_are_ground():
    bodies = world()
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
    vertices = np.stack([x.ravel(), y.ravel(), 0.2 * (x**2 + y**2).ravel()], axis=1)
    faces = []
    for i in range(8):
        for j in range(8):
            a = 9 * i + j
            faces += [[a, a + 1, a + 10], [a, a + 10, a + 9]]
    bowl = substep.geometry.TriangleMesh(vertices, faces)
    bodies.add(bowl, (0, 0, 0), motion="static")
    ball = bodies.add(rigid.Sphere(0.1), (0.4, 0.1, 0.5), rolling_friction=0.005)
    bodies.advance(6.0)
    assert np.linalg.norm(bodies.positions[ball, :2]) < 0.3
    assert bodies.positions[ball, 2] == pytest.approx(0.1, abs=0.03)


def test_a_bullet_does_not_pass_a_plate():
    for speed in (10.0, 1000.0):
        bodies = space()
        bodies.add(rigid.Box((0.01, 2, 2)), (0, 0, 0), motion="static")
        bullet = bodies.add(rigid.Sphere(0.01), (-1, 0.1, 0.2), velocities=(speed, 0, 0))
        bodies.advance(0.5)
        assert bodies.positions[bullet, 0] < 0


# Joints.
def swings(bodies, joint, bob, duration):
    """Times at which the coordinate rises through 0."""
    seen = []
    bodies.advance(duration, lambda b: seen.append((b.time, b.positions[bob, 0])))
    t, x = np.array(seen).T
    k = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    return t[k] - x[k] * (t[k + 1] - t[k]) / (x[k + 1] - x[k])


@pytest.mark.parametrize("kind", ["ball", "hinge", "distance"])
def test_pendulums_swing_in_time(kind):
    bodies = world()
    bob = bodies.add(BALL, (0.1, 0, -math.sqrt(1 - 0.01)), mass=2.0)
    if kind == "ball":
        joint = bodies.ball(bob, None, (0, 0, 0))
    elif kind == "hinge":
        joint = bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    else:
        joint = bodies.distance(bob, None, bodies.positions[bob], (0, 0, 0))
    times = swings(bodies, joint, bob, 9.0)
    moment = 1.0 if kind == "distance" else 1.0 + 0.4 * 0.25**2  # over the mass: the ball turns
    period = 2 * math.pi * math.sqrt(moment / G) * (1 + 0.1**2 / 16)
    assert np.diff(times).mean() == pytest.approx(period, rel=1e-3)
    assert max(joint.error) < 1e-4 and bodies.diagnostics()["joint_error"] < 1e-4
    assert joint.kind == kind and joint.bodies == (bob, None)
    assert np.linalg.norm(joint.force) == pytest.approx(2 * G, rel=0.05)


def test_a_fixed_joint_carries_force_and_torque():
    bodies = world()
    wall = bodies.add(BOX, (-1, 0, 0), motion="static")
    beam = bodies.add(rigid.Box((1, 0.2, 0.2)), (0, 0, 0), mass=3.0)
    joint = bodies.fixed(beam, wall, (-0.5, 0, 0))
    bodies.advance(1.0)
    assert bodies.positions[beam] == pytest.approx([0, 0, 0], abs=1e-4)
    assert joint.force == pytest.approx([0, 0, 3 * G], rel=1e-3, abs=1e-3)
    assert joint.torque == pytest.approx([0, -3 * G * 0.5, 0], rel=1e-3, abs=1e-3)
    assert joint.anchors == pytest.approx(np.array([[-0.5, 0, 0]] * 2), abs=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_joints_of_a_chain_that_swings_hold_for_a_minute(kind):
    bodies, last = world(), None
    for k in range(3):
        x = np.array([0.7 * k, 0, 0])
        link = bodies.add(rigid.Box((0.2, 0.4, 0.6)), x, mass=1.0 + k)
        join(bodies, kind, link, last, x)
        last = link
    errors = []
    bodies.advance(60.0, lambda b: errors.append(b.diagnostics()["joint_error"]))
    assert max(errors) < 1e-4


def test_limits_hold():
    bodies = world()
    flap = bodies.add(rigid.Box((1, 0.4, 0.1)), (0.5, 0, 0), mass=2.0)
    hinge = bodies.hinge(flap, None, (0, 0, 0), (0, 1, 0), limits=(-0.3, 0.3))
    ring = bodies.add(BALL, (5, 0, 0))
    slider = bodies.slider(ring, None, (5, 0, 0), (0, 0, 1), limits=(-0.4, 0.1))
    rope = bodies.distance(bodies.add(BALL, (9, 0, 0)), None, (9, 0, 0), (9, 0, 1), limits=(0, 2))
    bodies.advance(3.0)
    assert hinge.coordinate == pytest.approx(0.3, abs=1e-3)
    assert slider.coordinate == pytest.approx(-0.4, abs=1e-3)
    assert rope.coordinate == pytest.approx(2.0, abs=1e-3)
    assert bodies.positions[ring] == pytest.approx([5, 0, -0.4], abs=1e-3)
    slider.limits = (-1.0, 0.0)
    assert slider.limits == (-1.0, 0.0)
    bodies.advance(2.0)
    assert slider.coordinate == pytest.approx(-1.0, abs=1e-3)


def test_motors():
    bodies = space()
    wheel = bodies.add(rigid.Cylinder(0.5, 0.2), (0, 0, 0), mass=2.0)
    hinge = bodies.hinge(wheel, None, (0, 0, 0), (0, 0, 1), motor=rigid.SpeedMotor(3.0, 0.1))
    moment = 0.5 * 2.0 * 0.25
    bodies.advance(1.0)
    assert bodies.angular_velocities[wheel, 2] == pytest.approx(0.1 / moment, rel=1e-2)
    assert hinge.motor == rigid.SpeedMotor(3.0, 0.1)
    hinge.motor = rigid.SpeedMotor(3.0)
    bodies.advance(0.1)
    assert bodies.angular_velocities[wheel, 2] == pytest.approx(3.0, rel=1e-6)
    before = hinge.coordinate
    bodies.advance(5.0)
    assert hinge.coordinate - before == pytest.approx(15.0, rel=1e-3)  # over turns
    hinge.motor = None
    assert hinge.motor is None
    hung = world(sleeping=False)
    ball = hung.add(BALL, (0, 0, 0), mass=2.0)
    spring = rigid.SpringMotor(0.0, stiffness=200.0, damping=30.0)
    slider = hung.slider(ball, None, (0, 0, 0), (0, 0, 1), motor=spring)
    hung.advance(5.0)
    assert slider.coordinate == pytest.approx(-2 * G / 200, rel=1e-6)
    assert slider.motor == spring


def test_joined_bodies_touch_only_if_asked():
    for collide in (False, True):
        bodies = space()
        a, b = bodies.add(BOX, [[0, 0, 0], [0.9, 0, 0]])
        bodies.ball(a, b, (0.45, 0, 0), collide=collide)
        bodies.step()
        assert (len(bodies.contacts()) > 0) == collide


def test_joints_follow_their_bodies():
    bodies = space()
    ids = bodies.add(BALL, [[k, 0.0, 0] for k in range(4)])
    first = bodies.ball(ids[0], ids[1], (0.5, 0, 0))
    second = bodies.ball(ids[2], ids[3], (2.5, 0, 0))
    bodies.remove(ids[0])
    assert [joint.number for joint in bodies.joints] == [second.number] == [1]
    assert second.bodies == (2, 3)
    assert second.anchors == pytest.approx(np.array([[2.5, 0, 0]] * 2))
    with pytest.raises(IndexError, match="there is no joint 0"):
        _ = first.kind
    state = bodies.state()
    third = bodies.hinge(ids[1], None, (1, 0, 0), (0, 0, 1))
    assert third.number == 2 and len(bodies.joints) == 2
    bodies.restore(state)  # joints are part of it
    assert [joint.number for joint in bodies.joints] == [1]
    twin = pickle.loads(pickle.dumps(bodies))
    assert twin.joints[0].bodies == (2, 3)


def test_set_motion():
    bodies = world()
    ball = bodies.add(BALL, (0, 0, 5), velocities=(1, 0, 0))
    bodies.set_motion("kinematic", ball)
    bodies.advance(1.0)
    assert bodies.positions[ball] == pytest.approx([1, 0, 5])
    twin = bodies.copy()
    for one in (bodies, twin):
        one.set_motion("dynamic", ball)
        one.advance(0.5)
        assert one.positions[ball] == pytest.approx([1.5, 0, 5 - G / 8])
        one.set_motion("static", ball)
        one.advance(0.5)
        assert one.positions[ball] == pytest.approx([1.5, 0, 5 - G / 8])
    ground = bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
    post = bodies.add(BOX, (9, 0, 0), motion="static")
    for body, way, message in (
        (ground, "kinematic", "has a plane or a mesh"),
        (post, "dynamic", "has no mass"),
        (post, "flying", "motion: expected one of"),
    ):
        with pytest.raises(InputError, match=message):
            bodies.set_motion(way, [ball, body])
        assert bodies.motions.tolist() == ["static"] * 3


def test_a_joint_none_of_whose_bodies_is_dynamic_rests():
    bodies = world()
    ball = bodies.add(BALL, (1, 0, 0))
    bodies.ball(ball, None, (0, 0, 0))
    bodies.set_motion("kinematic", ball)
    for one in (bodies, bodies.copy(), pickle.loads(pickle.dumps(bodies))):
        one.advance(0.5)
        assert one.positions[ball] == pytest.approx([1, 0, 0])
        one.set_motion("dynamic", ball)
        one.advance(0.5)
        assert np.linalg.norm(one.positions[ball]) == pytest.approx(1, abs=1e-3)
        assert one.positions[ball, 2] < -0.9


# Runs.
def test_callbacks_run_after_every_step_and_may_do_everything():
    bodies = on_ground()
    times = []

    def callback(given):
        assert given is bodies
        times.append(bodies.time)
        if len(times) == 3:
            bodies.add(BALL, (0, 0, 5))
        if len(times) == 6:
            bodies.remove(1)

    bodies.advance(0.125, callback)
    assert times == pytest.approx([k / 60 for k in range(1, 8)] + [0.125])
    assert len(bodies) == 1 and bodies.ids.tolist() == [0]


def test_what_a_callback_raises_passes_and_leaves_a_good_state():
    bodies = on_ground()
    ball = bodies.add(BALL, (0, 0, 5))
    error = RuntimeError("enough")

    def callback(given):
        if bodies.time > 0.05:
            raise error

    with pytest.raises(RuntimeError) as caught:
        bodies.advance(1.0, callback)
    assert caught.value is error
    assert bodies.time == pytest.approx(4 / 60)
    assert bodies.velocities[ball, 2] == pytest.approx(-G * bodies.time)
    bodies.advance(0.5)  # and it goes on
    with pytest.raises(InputError, match="step: called by the callback"):
        bodies.advance(0.5, lambda b: b.step())
    with pytest.raises(InputError, match="advance: called by the callback"):
        bodies.advance(0.5, lambda b: b.advance(0.1))


def test_advance_takes_whole_steps_and_ends_in_time():
    bodies, twin = world(), world()
    for one in (bodies, twin):
        one.add(BOX, (0, 0, 0), angular_velocities=(1, 2, 3))
    bodies.advance(0.5)
    for _ in range(30):
        twin.step()
    assert bodies.positions.tolist() == twin.positions.tolist()
    assert bodies.rotations.tolist() == twin.rotations.tolist()
    assert bodies.time == 0.5
    bodies.advance(0.0)
    bodies.advance(0.01)
    assert bodies.time == 0.51
    assert bodies.positions[0, 2] == pytest.approx(-G / 2 * 0.51**2)


def test_the_same_bits_for_any_number_of_threads():
    for make in (pile, machines):
        hashes = set()
        for threads in (1, 2, 3):
            bodies = make(threads=threads)
            bodies.advance(1.0)
            hashes.add(state_hash(bodies))
        assert len(hashes) == 1


@pytest.mark.parametrize(
    "copied",
    [
        lambda b, folder: b.copy(),
        lambda b, folder: pickle.loads(pickle.dumps(b)),
        lambda b, folder: restored(b, folder),
    ],
    ids=["copy", "pickle", "file"],
)
def test_copies_and_checkpoints_go_on_with_the_same_bits(copied, tmp_path):
    bodies = pile()
    bodies.remove([3, 7])
    bodies.exclude(1, 2)
    bodies.advance(0.7)
    bodies.forces[:] = 0.5
    twin = copied(bodies, tmp_path)
    assert state_hash(twin) == state_hash(bodies)
    before = state_hash(bodies)
    twin.advance(0.5)
    assert state_hash(bodies) == before
    bodies.advance(0.5)
    assert state_hash(twin) == state_hash(bodies)
    assert twin.add(BALL, (0, 0, 9)) == bodies.add(BALL, (0, 0, 9)) == 28


def test_copies_and_checkpoints_of_joints_go_on_with_the_same_bits(tmp_path):
    bodies = machines()
    bodies.save(tmp_path / "checkpoint")
    twin = bodies.copy()
    other = machines()
    other.advance(0.1)
    other.load(tmp_path / "checkpoint")
    for simulation in (bodies, twin, other):
        simulation.advance(0.5)
    assert state_hash(twin) == state_hash(bodies) == state_hash(other)
    told = [(j.coordinate, j.speed, j.effort, *j.force, *j.torque) for j in bodies.joints]
    assert told == [(j.coordinate, j.speed, j.effort, *j.force, *j.torque) for j in other.joints]


def restored(bodies, folder):
    bodies.save(folder / "checkpoint")
    twin = pile()
    twin.remove([3, 7])
    twin.load(folder / "checkpoint")
    return twin


def test_islands_fall_asleep_and_wake():
    bodies = on_ground()
    stack = bodies.add(BOX, [[0, 0, 0.5], [0, 0, 1.5]])
    other = bodies.add(BOX, (5, 0, 0.5))
    bodies.advance(2.0)
    assert bodies.asleep.tolist() == [False, True, True, True]
    assert bodies.diagnostics()["awake"] == 0
    x = bodies.positions.copy()
    bodies.advance(1.0)
    assert (bodies.positions == x).all()
    for wake in (
        lambda: bodies.wake(stack[0]),
        lambda: bodies.apply_force(stack[1], (0, 0, 1)),
        lambda: bodies.apply_impulse(stack[1], (1e-3, 0, 0)),
        lambda: bodies.set_velocities((0, 0, 0.01), ids=stack[1]),
        lambda: bodies.set_positions((0, 0, 1.5001), ids=stack[1]),
        lambda: bodies.forces.__setitem__(2, 1.0),
        lambda: bodies.momenta.__setitem__(2, 1e-3),
        lambda: bodies.centers_of_mass.__setitem__((2, 2), 1.5002),
    ):
        wake()
        bodies.step()
        assert not bodies.asleep[stack].any() and bodies.asleep[other]
        assert bodies.contacts().bodies.tolist() == [[0, 1], [0, 3], [1, 2]]
        bodies.advance(2.0)
        assert bodies.asleep[stack].all()
    before = bodies.positions[stack].copy()
    bodies.set_forces((0, 0, -1.0), stack[1])
    bodies.step()
    assert np.abs(bodies.positions[stack] - before).max() < 1e-8  # contacts kept their impulses
    bodies.remove(stack[0])
    bodies.advance(1.0)
    assert bodies.positions[1] == pytest.approx([0, 0, 0.5], abs=1e-2)
    awake = on_ground(sleeping=False)
    awake.add(BOX, (0, 0, 0.5))
    awake.advance(2.0)
    assert not awake.asleep.any()


def lifted(bodies):
    """A box that sleeps on the ground is lifted; ground under another one goes down."""
    bodies.set_positions((0, 0, 2.5), ids=2)
    bodies.set_positions((5, 0, -1.0), ids=1)


def test_copies_know_what_was_moved_since_the_last_step(tmp_path):
    bodies = on_ground()
    bodies.add(BOX, (5, 0, 0.5), motion="static")
    bodies.add(BOX, [[0, 0, 0.5], [5, 0, 1.5]])
    bodies.advance(2.0)
    assert bodies.asleep.tolist() == [False, False, True, True]
    lifted(bodies)
    bodies.save(tmp_path / "moved")
    loaded, restored = bodies.copy(), bodies.copy()
    bodies.advance(0.1)  # then it has nothing more to tell
    twins = [loaded, restored]
    loaded.load(tmp_path / "moved")
    restored.restore(loaded.state())
    twins += [loaded.copy(), pickle.loads(pickle.dumps(loaded))]
    assert bodies.velocities[2:, 2].max() < -0.9  # both fall
    for twin in twins:
        twin.advance(0.1)
        assert substep.state_hash(twin.positions) == substep.state_hash(bodies.positions)
        assert not twin.asleep.any()


def test_a_step_that_fails_forgets_nothing_that_was_moved():
    bodies = on_ground()
    box, other = bodies.add(BOX, [[0, 0, 0.5], [5, 0, 0.5]])
    bodies.advance(2.0)
    bodies.set_positions((0, 0, 2.5), ids=box)
    bodies.forces[other] = 1e200
    with pytest.raises(substep.SolverError):
        bodies.step()
    bodies.forces[other] = 0.0
    bodies.advance(0.1)
    assert bodies.velocities[box, 2] == pytest.approx(-0.981, rel=0.05)


def test_recordings_hold_the_frames_of_shapes(tmp_path):
    bodies = on_ground()
    hull = bodies.add(rigid.ConvexHull(CORNER), (1, 2, 3), about((1, 0, 0), 0.3))
    units = {name: unit for name, (_, unit) in bodies.fields().items() if name != "position"}
    part = substep.Part("bodies", units)
    with substep.Recorder(tmp_path / "run", parts={"bodies": part}) as recorder:
        for _ in range(3):
            arrays = {name: values for name, (values, _) in bodies.fields().items()}
            recorder.append(bodies.time, {"bodies": {"points": arrays.pop("position"), **arrays}})
            bodies.advance(0.1)
    with substep.Recording(tmp_path / "run") as recording:
        assert recording["bodies"].points(0)[hull] == pytest.approx([1, 2, 3])
        assert same_turn(recording["bodies"].field("orientation", 0)[hull], about((1, 0, 0), 0.3))


def test_step_limit_is_that_of_the_fastest_turning_body_in_contact():
    bodies = on_ground()
    bodies.add(BALL, (5, 0, 5), angular_velocities=(0, 0, 100))
    assert bodies.step_limit() == (math.inf, "no body is in contact or has a joint")
    ball = bodies.add(BALL, (0, 0, 0.25), angular_velocities=(0, 0, 8))
    bodies.step()
    limit, reason = bodies.step_limit()
    assert limit == pytest.approx(1 / 8, rel=1e-3) and reason == f"body {ball} turns by 1 rad"


# Queries.
def test_rays():
    bodies = on_ground()
    box = bodies.add(BOX, (0, 0, 2))
    ball = bodies.add(BALL, (0, 0, 4), group=4)
    origins = [[0.1, 0, 10], [0, 0, 10], [7, 0, 1], [7, 0, 1], [0, 0, 2]]
    directions = [[0, 0, -2], [0, 0, -1], [0, 0, -1], [0, 0, 3], [1, 0, 0]]
    hits = bodies.ray_cast(origins, directions)
    assert hits.bodies.tolist() == [ball, ball, 0, -1, -1]
    assert hits.distances[[1, 2]] == pytest.approx([5.75, 1])
    assert hits.distances[3] == math.inf and np.isnan(hits.points[3]).all()
    assert hits.points[1] == pytest.approx([0, 0, 4.25])
    assert hits.normals[2] == pytest.approx([0, 0, 1])
    below = bodies.ray_cast([0, 0, 10], [0, 0, -1], mask=1)
    assert below.bodies.tolist() == [box] and below.distances == pytest.approx([7.5])
    assert bodies.ray_cast([0, 0, 10], [0, 0, -1], 5.0).bodies.tolist() == [-1]
    through = bodies.ray_cast_all([0, 0, 10], [0, 0, -1])
    assert through.bodies.tolist() == [ball, box, 0]
    assert through.distances == pytest.approx([5.75, 7.5, 10])


def test_shapes_are_cast_and_overlap():
    bodies = on_ground()
    first, second = bodies.add(BOX, [[0, 0, 2], [3, 0, 2]])
    hit = bodies.shape_cast(BALL, (-5, 0, 2), (1, 0, 0), 100)
    assert hit.bodies.tolist() == [first]
    assert hit.distances == pytest.approx([4.25], abs=1e-6)
    assert hit.normals[0] == pytest.approx([-1, 0, 0], abs=1e-6)
    assert bodies.shape_cast(BALL, (-5, 0, 2), (1, 0, 0), 4).bodies.tolist() == [-1]
    assert bodies.overlapping(rigid.Box((4, 0.2, 0.2)), (1.5, 0, 2)).tolist() == [first, second]
    turn = about((0, 1, 0), math.pi / 2)
    assert bodies.overlapping(rigid.Box((4, 0.2, 0.2)), (1.5, 0, 2), rotation=turn).tolist() == [0]
    assert bodies.overlapping(BALL, (0, 0, 0.1), mask=2).tolist() == []


def test_queries_see_what_was_moved_added_and_removed():
    bodies = space()
    box = bodies.add(BOX, (0, 0, 0))

    def down():
        return bodies.ray_cast([0, 0, 10], [0, 0, -1])

    assert down().distances == pytest.approx([9.5])
    bodies.set_positions((0, 0, 3), ids=box)
    assert down().distances == pytest.approx([6.5])
    bodies.centers_of_mass[0, 2] = 5
    assert down().distances == pytest.approx([4.5])
    ball = bodies.add(BALL, (0, 0, 8))
    assert down().bodies.tolist() == [ball]
    bodies.remove(ball)
    bodies.centers_of_mass[0, 0] = 50
    assert down().bodies.tolist() == [-1]
    assert bodies.overlapping(BALL, (50, 0, 5)).tolist() == [box]


def test_copies_of_a_pile_go_on_with_the_same_bits_at_any_time():
    # A copy knows none of the pairs that once were near.
    rng = np.random.default_rng(5)
    pile = world()
    pile.add(rigid.Plane(), (0, 0, 0), motion="static", friction=0.4)
    shapes = (rigid.Box((0.3, 0.2, 0.25)), rigid.Sphere(0.13), rigid.Cylinder(0.12, 0.2))
    for k in range(90):
        place = (*rng.uniform(-0.5, 0.5, 2), 0.2 + 0.06 * k)
        pile.add(shapes[k % 3], place, rng.normal(size=4), friction=0.4)
    pile.advance(0.7)
    for _ in range(6):
        copy = pile.copy()
        for _ in range(6):
            pile.step()
            copy.step()
        state, other = pile.state(), copy.state()
        assert all(np.array_equal(state[name], other[name], equal_nan=True) for name in state)


def test_copies_of_what_flies_fast_go_on_with_the_same_bits():
    # What stops bodies does not depend on how long the broad phase has known others.
    at = [(0.405, 0.226, 1.235), (0.265, 0.38, 0.935), (0.76, -0.282, 0.771), (0.446, 0.382, 1.292)]
    v = [(-2.877, -21.497, -31.75), (39.951, -30.452, 64.84), (-18.666, 2.727, -0.122)]
    bodies = substep.RigidBodies(substeps=1)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static", restitution=0.5)
    v.append((-9.943, -7.238, -32.443))
    bodies.add(rigid.Sphere(0.05), at, velocities=v, restitution=0.8)
    bodies.step()
    twin = bodies.copy()
    bodies.step()
    twin.step()
    assert np.array_equal(bodies.positions, twin.positions)
