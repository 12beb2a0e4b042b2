"""Trees of joints, which move in the coordinates of their joints, where that is hardest."""

import numpy as np
import pytest
import substep
from substep import rigid


def rod(side, spin):
    """A rod of 1 m that spins about its middle, at a ball of the world."""
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    spins = (0.01 * spin, 0.02 * spin, spin)
    arm = bodies.add(rigid.Box((1, side, side)), (0, 0, 0), mass=1.0, angular_velocities=spins)
    bodies.ball(arm, None, (0, 0, 0))
    return bodies


@pytest.mark.parametrize(
    ("side", "spin"), [(0.1, 260), (0.02, 42), (0.02, 60), (0.005, 12), (0.005, 20)]
)
def test_thin_rods_that_turn_keep_their_energy(side, spin):
    bodies = rod(side, spin)
    start = bodies.diagnostics()["energy"]
    for _ in range(30):
        bodies.step()
        assert bodies.diagnostics()["energy"] == pytest.approx(start, rel=1e-5)


@pytest.mark.parametrize("torque", [(1, 0, 300), (30, 100, 300)])
def test_a_torque_that_spins_a_thin_rod_up_within_a_step_does_as_equations_of_its_joint_say(torque):
    def spun(rotation):
        bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False, rotation=rotation)
        arm = bodies.add(rigid.Box((1, 0.005, 0.005)), (0, 0, 0), mass=1.0)
        bodies.ball(arm, None, (0, 0, 0))
        bodies.torques[arm] = torque
        bodies.step()
        about = [bodies.diagnostics()[f"angular_momentum_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(about, np.array(torque) / 60, atol=1e-12)
        return bodies

    # The first goes from rest to thousands of rad/s, which coordinates took for four times as much.
    rod, exact = spun("splitting"), spun("exact")
    assert rod.diagnostics()["kinetic_energy"] == pytest.approx(
        exact.diagnostics()["kinetic_energy"], rel=1e-9
    )
    np.testing.assert_allclose(rod.angular_velocities, exact.angular_velocities, rtol=1e-6)


@pytest.mark.parametrize("first", ["static", "kinematic"])
def test_a_ground_that_begins_to_move_takes_along_what_hangs_from_it(first):
    bodies = substep.RigidBodies()
    base = bodies.add(substep.Sphere(0.01), (0, 0, 0), motion=first)
    arm = bodies.add(substep.Box((0.1, 0.1, 0.8)), (0, 0, -0.5), mass=1.0)
    joint = bodies.hinge(arm, base, (0, 0, 0), (0, 1, 0))
    bodies.set_angular_velocities((0, 1, 0), arm)
    bodies.set_velocities((-0.5, 0, 0), arm)
    bodies.step()
    bodies.set_motion("kinematic", base)
    bodies.set_velocities((1, 0, 0), base)
    twin = bodies.copy()
    bodies.advance(1.0), twin.advance(1.0)
    assert joint.coordinate == pytest.approx(-0.47673, abs=1e-4)  # by rotation="exact"
    np.testing.assert_array_equal(bodies.momenta, twin.momenta)


@pytest.mark.parametrize("substeps", [8, 32, 64])
def test_hinges_count_turns_however_far_a_sub_step_turns_them(substeps):
    bodies = substep.RigidBodies(gravity=(0, 0, 0), substeps=substeps)
    speed = 0.95 * 60 * substeps
    disk = bodies.add(substep.Cylinder(0.1, 0.05), (0, 0, 0), angular_velocities=(0, 0, speed))
    joint = bodies.hinge(disk, None, (0, 0, 0), (0, 0, 1))
    for _ in range(10):
        bodies.step()
    assert joint.coordinate == pytest.approx(speed * bodies.time, rel=1e-6)


def test_a_free_pair_keeps_its_momenta_and_its_centre_on_a_line():
    bodies = substep.RigidBodies(gravity=(0, 0, 0), sleeping=False)
    a = bodies.add(substep.Box((0.2, 0.3, 0.5)), (0, 0, 0), mass=1.0)
    b = bodies.add(substep.Box((0.5, 0.2, 0.3)), (0.4, 0.1, 0.3), mass=2.0)
    bodies.ball(a, b, (0.15, 0.1, 0.25))
    bodies.set_angular_velocities((5, 1, -2), a)
    bodies.step()
    weights = np.array([1.0, 2.0]) / 3

    def measured():
        d = bodies.diagnostics()
        about = [d[f"angular_momentum_{axis}"] for axis in "xyz"]
        return weights @ bodies.centers_of_mass, np.array(about)

    (x, L), v = measured(), weights @ bodies.velocities
    for _ in range(600):
        bodies.step()
    then, about = measured()
    np.testing.assert_allclose(then, x + 10 * v, atol=1e-9)
    np.testing.assert_allclose(about, L, atol=1e-8 * np.linalg.norm(L))


def test_trees_agree_with_equations_of_their_joints():
    def chain(rotation):
        bodies = substep.RigidBodies(rotation=rotation, sleeping=False)
        last = None
        for k in range(5):
            link = bodies.add(rigid.Box((0.3, 0.1, 0.05)), (0.3 * k + 0.15, 0, 0), mass=1 + k % 2)
            joint = bodies.hinge if k % 2 else bodies.ball
            joint(link, last, (0.3 * k, 0.01, 0), **({"axis": (0, 1, 0.2)} if k % 2 else {}))
            last = link
        bodies.advance(1.0)
        return bodies

    tree, general = chain("splitting"), chain("exact")
    assert max(joint.error[0] for joint in tree.joints) == 0
    assert 0 < max(joint.error[0] for joint in general.joints) < 1e-8
    assert np.abs(tree.positions - general.positions).max() < 3e-3
    for p, q in zip(tree.joints, general.joints, strict=True):
        assert p.coordinate == pytest.approx(q.coordinate, abs=2e-3)


LAWS = {
    "springs": 3 * [("hinge", {"motor": rigid.SpringMotor(0.4, 20.0, 0.5)})],
    "weak springs": 3 * [("hinge", {"motor": rigid.SpringMotor(0.4, 200.0, 2.0, strength=1.0)})],
    "speeds": [
        ("hinge", {"motor": rigid.SpeedMotor(2.0, strength=4.0)}),
        ("hinge", {"motor": rigid.SpeedMotor(0.0, strength=0.2)}),
        ("hinge", {"motor": rigid.SpeedMotor(-1.0)}),
    ],
    "limits": [
        ("hinge", {"limits": (-0.5, 0.6), "motor": rigid.SpringMotor(0.0, 3.0, 0.1)}),
        ("hinge", {"limits": (-0.2, 0.3)}),
        ("hinge", {}),
    ],
    "sliders": [
        ("slider", {"motor": rigid.SpringMotor(0.1, 200.0, 2.0)}),
        ("hinge", {"motor": rigid.SpeedMotor(0.0, strength=0.3)}),
        ("slider", {"limits": (-0.1, 0.15)}),
    ],
}


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("laws", LAWS)
def test_limits_and_motors_of_trees_agree_with_equations_of_their_joints(laws, free, reverse):
    def arm(rotation):
        bodies = substep.RigidBodies(step=1 / 240, sleeping=False, rotation=rotation)
        last, link = None, rigid.Capsule(0.03, 0.24)
        if free:
            last = bodies.add(rigid.Box((0.2, 0.2, 0.2)), (0, 0, 0), mass=3.0)
        for k, (kind, law) in enumerate(LAWS[laws]):
            at, q = (0.3 * k + 0.15, 0, 0), (0.5**0.5, 0, 0.5**0.5, 0)
            body = bodies.add(link, at, q, mass=0.5, group=0, mask=0)
            pair = (last, body) if reverse and last is not None else (body, last)
            axis = (0, 1, 0) if k % 2 == 0 else (0, 0.6, 0.8)
            getattr(bodies, kind)(*pair, (0.3 * k, 0, 0), axis, **law)
            last = body
        bodies.advance(1.0)
        return bodies

    tree, general = arm("splitting"), arm("exact")
    assert max(joint.error[0] for joint in tree.joints) < 1e-9
    for p, q in zip(tree.joints, general.joints, strict=True):
        assert p.coordinate == pytest.approx(q.coordinate, abs=3e-5)
        assert p.speed == pytest.approx(q.speed, abs=2e-4)
        assert p.effort == pytest.approx(q.effort, abs=3e-4)
        np.testing.assert_allclose(p.force, q.force, atol=3e-4)
        np.testing.assert_allclose(p.torque, q.torque, atol=3e-4)


@pytest.mark.parametrize(
    ("links", "impulse", "step"),
    [
        (5, (2.2, 0, -1.3), 1 / 60),
        (8, (0.8, 0, 2.4), 1 / 60),
        (12, (-1.0, 0, 2.0), 1 / 240),
        (15, (0, 0, 0), 1 / 240),
        (15, (0, 0, 5), 1 / 240),
        (15, (0, 1, -8), 1 / 60),
    ],
)
@pytest.mark.parametrize("rotation", ["splitting", "exact"])  # the latter by equations of joints
def test_many_limits_that_are_met_at_once_give_no_energy(links, impulse, step, rotation):
    bodies = substep.RigidBodies(step=step, sleeping=False, rotation=rotation)
    last = None
    for k in range(links):
        link = bodies.add(rigid.Box((0.3, 0.1, 0.1)), (0.3 * k + 0.15, 0, 0), mask=0, mass=1.0)
        bodies.hinge(link, last, (0.3 * k, 0, 0), (0, 1, 0), limits=(-0.3, 0.3))
        last = link
    bodies.apply_impulse(last, impulse)
    start = bodies.diagnostics()["energy"]
    for _ in range(round(2 / step)):
        bodies.step()
        assert bodies.diagnostics()["energy"] < start + 1e-9
    assert all(abs(joint.coordinate) < 0.3 + 1e-7 for joint in bodies.joints)


def test_limits_that_contacts_pass_are_taken_back():
    # A rod at a hinge with a limit, and what falls on it.
    bodies = substep.RigidBodies(sleeping=False)
    rod = bodies.add(rigid.Box((1, 0.1, 0.1)), (0.5, 0, 0), mass=0.1)
    joint = bodies.hinge(rod, None, (0, 0, 0), (0, 1, 0), limits=(-1, 0))
    bodies.add(rigid.Sphere(0.2), (0.8, 0, 0.5), mass=50.0)
    passed = []
    while bodies.time < 1:
        bodies.step()
        passed.append(joint.coordinate)
    assert max(passed) < 1e-3 and passed[-1] < 1e-6


@pytest.mark.parametrize(
    ("masses", "step", "most"),
    [
        ((1, 1, 100), 1 / 60, 0.15),
        ((1, 1, 300), 1 / 60, 0.1),
        ((1, 1, 1000), 1 / 240, 0.1),
        ((0.1, 0.1, 0.1, 0.1, 10), 1 / 240, 0.1),
        (10 * (0.1,), 1 / 60, 0.01),
    ],
)
@pytest.mark.parametrize("kind", ["ball", "hinge"])
def test_chains_that_snap_taut_gain_no_energy(masses, step, most, kind):
    """Let go level; a heavy end swings up by no more than a part of what it fell."""
    bodies, last, length = substep.RigidBodies(sleeping=False, step=step), None, 0.4
    for k, mass in enumerate(masses):
        at = (length * (k + 0.5), 0, 0)
        body = bodies.add(substep.Box((length, 0.05, 0.05)), at, mass=mass, mask=0)
        anchor = (length * k, 0, 0)
        if kind == "ball":
            bodies.ball(body, last, anchor)
        else:
            bodies.hinge(body, last, anchor, (0, 1, 0))
        last = body
    scale = sum(m * 9.81 * length * (k + 0.5) for k, m in enumerate(masses))
    highest = 0.0
    for _ in range(round(10 / step)):
        bodies.step()
        highest = max(highest, bodies.diagnostics()["energy"] / scale)
    assert highest < most
