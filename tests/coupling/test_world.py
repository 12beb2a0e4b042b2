"""Worlds of several simulations: what they exchange, refuse, keep and restore."""

import itertools
import pickle
import signal

import numpy as np
import pytest
import substep
from substep import InputError, NonFiniteError
from test_conformance import example

small_world = example(substep.World)


def mobilities_of(bodies, ids):
    native = bodies._native
    return native.mobilities(bodies.rows(ids), native.parts_of_strength() < 0.5, 1 / 60)


def digest(world):
    return substep.state_hash(
        *(
            np.frombuffer(str(v).encode(), np.uint8) if np.ndim(v) == 0 else v.ravel().astype("f8")
            for _, v in sorted(world.state().items())
        )
    )


# ---------------------------------------------------------------------------- obstacles


def test_an_obstacle_stays_where_its_body_is_but_for_rounding():
    """So that the distances found for its pose still hold; any other pose it takes."""
    bodies = substep.RigidBodies(gravity=(0, 0, 0))
    ball = bodies.add(substep.Sphere(0.1), (0.1, 0.5, 0.7), (0.6, 0, 0.8, 0), density=300.0)
    (collider,) = bodies.make_colliders(ball)
    native = collider._native

    def placed(shift):
        position, rotation = bodies.positions[ball] + shift, bodies.rotations[ball]
        substep._core.place_bodies(
            [native],
            [0],
            np.concatenate([position, rotation])[None],
            np.zeros((1, 6)),
            np.zeros((1, 3)),
            np.eye(6).reshape(1, 36),
            np.zeros((1, 6)),
        )
        return np.array(collider.position)

    start = placed(0.0)
    assert (placed(1e-16) == start).all()
    assert (placed(1e-12) != start).all()


# ---------------------------------------------------------------------------- mobilities


def test_mobility_of_a_free_body():
    bodies = substep.RigidBodies()
    turn = np.array([np.cos(0.3), 0, np.sin(0.3), 0])
    box = bodies.add(substep.Box((0.2, 0.4, 0.6)), (1, 2, 3), turn, mass=2.0)
    W = mobilities_of(bodies, [box])[0]
    np.testing.assert_allclose(W[:3, :3], np.eye(3) / 2.0, atol=1e-15)
    c, s = np.cos(0.6), np.sin(0.6)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    inertia = 2.0 / 12 * np.array([0.4**2 + 0.6**2, 0.2**2 + 0.6**2, 0.2**2 + 0.4**2])
    np.testing.assert_allclose(W[3:, 3:], R @ np.diag(1 / inertia) @ R.T, rtol=1e-12, atol=1e-12)
    assert np.abs(W[:3, 3:]).max() == 0


def test_mobility_of_a_pendulum():
    """About a hinge at the distance r, I + m r^2 answers; along and across it nothing does."""
    bodies = substep.RigidBodies()
    bob = bodies.add(substep.Sphere(0.1), (0.7, 0, 0), mass=3.0)
    bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    W = mobilities_of(bodies, [bob])[0]
    about = 0.4 * 3.0 * 0.1**2 + 3.0 * 0.7**2
    expected = np.zeros((6, 6))
    expected[2, 2], expected[4, 4] = 0.7**2 / about, 1 / about
    expected[2, 4] = expected[4, 2] = -0.7 / about
    np.testing.assert_allclose(W, expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["ball", "fixed", "slider", "distance", "universal"])
def test_mobility_is_what_an_impulse_does(kind):
    """A short step after an impulse, over one without, in a chain of three."""
    W, moved = None, []
    for impulse in (0.0, 1e-3):
        bodies = substep.RigidBodies(step=1e-7, gravity=(0, 0, 0), sleeping=False)
        a, b, c = bodies.add(
            substep.Box((0.3, 0.2, 0.1)), [(0, 0, 0), (0.4, 0.1, 0), (0.8, 0, 0.1)], density=500.0
        )
        bodies.hinge(int(b), int(c), (0.6, 0, 0), (0, 0, 1))
        anchor = (0.2, 0, 0.05)
        if kind == "distance":
            bodies.distance(int(a), int(b), (0.1, 0, 0), (0.3, 0.1, 0))
        elif kind == "universal":
            bodies.universal(int(a), int(b), anchor, (1, 0, 0), (0, 1, 0))
        elif kind == "slider":
            bodies.slider(int(a), int(b), anchor, (1, 0, 0))
        else:
            getattr(bodies, kind)(int(a), int(b), anchor)
        W = mobilities_of(bodies, [b])[0]
        bodies.apply_impulse(b, (0.2 * impulse, impulse, -0.5 * impulse))
        bodies.step()
        moved.append(np.r_[bodies.velocities[1], bodies.angular_velocities[1]])
    response = (moved[1] - moved[0]) / 1e-3
    expected = W @ [0.2, 1, -0.5, 0, 0, 0]
    np.testing.assert_allclose(response, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


def test_mobility_of_a_loop_that_says_things_twice():
    """A four-bar linkage in the plane has redundant rows; a door on two hinges too."""
    bodies = substep.RigidBodies()
    door = bodies.add(substep.Box((1.0, 0.05, 2.0)), (0.5, 0, 1.0), mass=20.0)
    for z in (0.3, 1.7):
        bodies.hinge(door, None, (0, 0, z), (0, 0, 1))
    W = mobilities_of(bodies, [door])[0]
    about = 20 / 12 * (1 + 0.05**2) + 20 * 0.25
    expected = np.zeros((6, 6))
    expected[1, 1], expected[5, 5], expected[1, 5] = 0.25 / about, 1 / about, 0.5 / about
    expected[5, 1] = expected[1, 5]
    np.testing.assert_allclose(W, expected, atol=1e-7)


def test_mobilities_of_bodies_that_are_pushed_together_are_at_least_theirs():
    """Less the whole W, which impulses show in a short step, nothing negative is left."""

    def chain():
        bodies = substep.RigidBodies(step=1e-7, gravity=(0, 0, 0), sleeping=False)
        links = bodies.add(substep.Box((0.3, 0.2, 0.1)), [(0.4 * k, 0, 0) for k in range(3)])
        bodies.hinge(int(links[0]), int(links[1]), (0.2, 0, 0), (0, 0, 1))
        bodies.fixed(int(links[1]), int(links[2]), (0.6, 0, 0))
        return bodies, links

    bodies, links = chain()
    blocks = mobilities_of(bodies, links)
    W = np.zeros((18, 18))
    for column in range(18):
        bodies, links = chain()
        body, unit = links[column // 6], np.eye(3)[column % 3]
        if column % 6 < 3:
            bodies.apply_impulse(body, unit)
        else:
            bodies.angular_momenta[column // 6] += unit
        bodies.step()
        W[:, column] = np.hstack([bodies.velocities, bodies.angular_velocities]).ravel()
    own = np.concatenate([mobilities_of(bodies, [b]) for b in links])
    lowest = []
    for each in (blocks, own):
        excess = -W / np.abs(W).max()
        for k in range(3):
            excess[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += each[k] / np.abs(W).max()
        lowest.append(np.linalg.eigvalsh(excess).min())
    assert lowest[0] > -2e-3 and lowest[1] < -0.1


# ---------------------------------------------------------------------------- exchange


@pytest.mark.parametrize("mass", [1.0, 0.01, 0.001])
def test_a_light_ball_that_hits_a_free_block_makes_no_energy(mass):
    """Vertices weigh about 1 kg; the obstacle is where its body is."""
    bodies = substep.RigidBodies(gravity=(0, 0, 0))
    ball = bodies.add(substep.Sphere(0.2), (-0.25, 0.05, 0.1), mass=mass, velocities=(1, 0, 0.3))
    mesh = substep.geometry.box_tetrahedra((0.4, 0.6, 0.6), (3, 5, 5))
    obstacles = bodies.make_colliders(ball)
    block = substep.SoftBody(
        mesh.vertices + np.array([0.2, 0, 0]),
        mesh.tetrahedra,
        density=1000.0,
        young_modulus=1e4,
        poisson_ratio=0.3,
        gravity=(0, 0, 0),
        colliders=obstacles,
    )
    world = substep.World({"bodies": bodies, "block": block})
    energy, apart = [world.diagnostics()["energy"]], []

    def momentum():
        return mass * bodies.velocities[0] + block.masses @ block.velocities

    def look(_):
        energy.append(world.diagnostics()["energy"])
        apart.append(np.abs(obstacles[0].position - bodies.positions[0]).max())

    before = momentum()
    world.advance(0.5, look)
    assert max(energy) <= energy[0] * (1 + 1e-9)
    assert max(apart) < 1e-5
    assert np.abs(block.velocities).max() > 1e-3 * mass
    np.testing.assert_allclose(momentum(), before, atol=1e-12)


@pytest.mark.parametrize("steps_per_second", [60, 240])
def test_a_raft_of_planks_floats_as_one_of_the_same_shapes(steps_per_second):
    heights = []
    for joined in (True, False):
        bodies = substep.RigidBodies(sleeping=False)
        shapes = [substep.Box((0.2, 0.4, 0.2), (x, 0, 0)) for x in (-0.3, -0.1, 0.1, 0.3)]
        if joined:
            planks = [
                bodies.add(
                    substep.Box((0.2, 0.4, 0.2)), (0.5 + s.center[0], 0.3, 0.55), density=300
                )
                for s in shapes
            ]
            for a, b in itertools.pairwise(planks):
                bodies.fixed(a, b, (bodies.positions[a] + bodies.positions[b]) / 2)
        else:
            planks = [bodies.add(shapes, (0.5, 0.3, 0.55), density=300)]
        water = substep.GridLiquid(
            substep.fill_box((0, 0, 0), (1, 0.6, 0.4), 0.05),
            cell=0.1,
            bounds=((0, 0, 0), (1, 0.6, 1)),
            colliders=bodies.make_colliders(planks),
        )
        world = substep.World({"bodies": bodies, "water": water}, step=1 / steps_per_second)
        energy, high = [world.diagnostics()["energy"]], []
        for _ in range(6):
            world.advance(0.1)
            energy.append(world.diagnostics()["energy"])
            high.append(bodies.positions[:, 2].mean())
        assert max(energy) < energy[0] + 0.01 * abs(energy[0])
        heights.append(high)
    np.testing.assert_allclose(*heights, atol=0.01)


def test_bodies_get_what_the_water_gives():
    """Momenta of the bodies change by gravity, joints and what was exchanged, to rounding."""
    world = small_world()
    bodies = world["bodies"]
    ball = bodies.rows(0)
    for _ in range(40):
        before = bodies.velocities[ball] * bodies.masses[ball]
        start = world.time
        world.step()
        ids, forces = world.exchanged()["water"]
        dt = world.time - start
        own = forces[list(ids).index(0), :3] * dt
        if len(bodies.contacts()):
            continue
        gained = bodies.velocities[ball] * bodies.masses[ball] - before
        weight = bodies.masses[ball] * np.array([0, 0, -9.81]) * dt
        np.testing.assert_allclose(gained, own + weight, atol=1e-13 * max(1, np.abs(own).max()))
    assert world.time > 0.3 and np.abs(forces).max() > 0.1


def test_obstacles_follow_their_bodies():
    bodies = substep.RigidBodies(gravity=(0, 0, 0), step=0.01)
    parts = [substep.Box((0.2, 0.1, 0.1), (0.1, 0, 0)), substep.Sphere(0.08, (-0.1, 0.05, 0))]
    club = bodies.add(parts, (0, 0, 1), angular_velocities=(1, 2, 3), velocities=(0.5, 0, 0))
    cloth = substep.MassSpring(
        [(5, 0, 0), (6, 0, 0)],
        [(0, 1)],
        10.0,
        1.0,
        gravity=(0, 0, 0),
        colliders=bodies.make_colliders(club),
        step=0.01,
    )
    world = substep.World({"club": bodies, "cloth": cloth})
    world.advance(0.2)
    probe = substep.RigidBodies(gravity=(0, 0, 0), step=0.01)
    probe.add(parts, (0, 0, 1), angular_velocities=(1, 2, 3), velocities=(0.5, 0, 0))
    probe.advance(0.2)
    np.testing.assert_allclose(probe.positions, bodies.positions, atol=1e-14)
    for mine, free in zip(cloth.colliders, probe.make_colliders(), strict=True):
        # One interval's turn is between the obstacle's own motion and the body's.
        np.testing.assert_allclose(mine.position, free.position, atol=1e-4)


def test_worlds_without_bodies_advance_members():
    world = substep.World(
        {
            "a": substep.MassSpring([(0, 0, 0), (1, 0, 0)], [(0, 1)], 10.0, 1.0, step=0.01),
            "b": substep.PositionBasedFluid(np.zeros((1, 3)), 0.1),
        }
    )
    world.advance(0.1)
    assert world["a"].time == world["b"].time == world.time == 0.1
    np.testing.assert_allclose(world["b"].velocities[0, 2], -0.981, rtol=1e-5)


def test_a_member_that_there_is_not():
    with pytest.raises(KeyError, match="'watr'; the world has bodies, water"):
        small_world()["watr"]


def test_diagnostics_are_sums():
    world = small_world()
    values = world.diagnostics()
    for key in ("kinetic_energy", "energy", "momentum_z", "angular_momentum_x"):
        parts = [values[f"{name}.{key}"] for name in world.members]
        assert values[key] == sum(parts)


def test_a_logger_of_a_joint_reads_it_in_a_world():
    world = small_world()
    [rope] = world["bodies"].joints
    log = substep.Logger(rope.quantities("rope"))
    world.advance(0.05, log)
    assert log["rope_coordinate"][-1] == rope.coordinate


def test_threads_reach_all_members():
    world = small_world()
    world.threads = 2
    assert {member.threads for member in world.members.values()} == {2}


# ---------------------------------------------------------------------------- what is refused


def test_members_at_different_times():
    a, b = (substep.RigidBodies(time=t) for t in (0.0, 1.0))
    spring = substep.MassSpring([(0, 0, 0)], np.zeros((0, 2)), 1.0, 1.0, time=1.0)
    with pytest.raises(InputError, match="expected all at one time, got 'a' at 0 s, 'b' at 1 s"):
        substep.World({"a": a, "b": spring})
    substep.World({"a": b, "b": spring})


def test_a_member_twice_and_in_two_worlds():
    bodies = substep.RigidBodies()
    with pytest.raises(InputError, match=r"members\['b'\]: is given twice"):
        substep.World({"a": bodies, "b": bodies})
    world = substep.World({"a": bodies})
    with pytest.raises(InputError, match=r"members\['b'\]: is in another world"):
        substep.World({"b": bodies})
    del world
    substep.World({"b": bodies})


@pytest.mark.parametrize(
    ("members", "error", "told"),
    [
        ({}, InputError, "at least one"),
        ([], TypeError, "simulations by name"),
        ({"a b": substep.RigidBodies()}, InputError, "letters, digits"),
        ({1: substep.RigidBodies()}, InputError, "letters, digits"),
        ({"exchanged": substep.RigidBodies()}, InputError, "'exchanged' is a name in states"),
        ({"a": 3}, TypeError, r"members\['a'\]: expected a simulation, got"),
        ({"a": substep.RigidBodies(), "b": substep.RigidBodies()}, InputError, "one RigidBodies"),
    ],
)
def test_wrong_members(members, error, told):
    with pytest.raises(error, match=told):
        substep.World(members)


def test_obstacles_of_bodies_that_are_no_member():
    bodies = substep.RigidBodies()
    bodies.add(substep.Sphere(0.1), (0, 0, 0))
    cloth = substep.MassSpring(
        [(5, 0, 0)], np.zeros((0, 2)), 1.0, 1.0, colliders=bodies.make_colliders()
    )
    with pytest.raises(InputError, match=r"colliders\[0\] of 'cloth' represents a body of no mem"):
        substep.World({"cloth": cloth})
    with pytest.raises(InputError, match="no member"):
        substep.World({"cloth": cloth, "bodies": substep.RigidBodies()})


def test_flows_take_kinematic_bodies_only():
    bodies = substep.RigidBodies(gravity=(0, 0, 0))
    ball = bodies.add(
        substep.Sphere(0.2), (0.3, 0.5, 0), velocities=(0.5, 0, 0), motion="kinematic"
    )
    flow = substep.GridFlow(
        [(0, 0), (1, 1)], 1 / 16, colliders=bodies.make_colliders(ball), viscosity=0.01
    )
    world = substep.World({"bodies": bodies, "air": flow})
    world.advance(0.2)
    assert flow.colliders[0].position[0] == pytest.approx(0.4)
    assert flow.diagnostics()["kinetic_energy"] > 0.01
    bodies = substep.RigidBodies()
    bodies.add(substep.Sphere(0.2), (0.3, 0.5, 0))
    flow = substep.GridFlow([(0, 0), (1, 1)], 1 / 16, colliders=bodies.make_colliders())
    with pytest.raises(InputError, match="body 0: 'air' has no way to push dynamic bodies"):
        substep.World({"bodies": bodies, "air": flow})


def test_gravity_does_not_pull_bodies_out_of_the_plane():
    bodies = substep.RigidBodies()
    bodies.add(substep.Sphere(0.2), (0.5, 0.5, 0))
    box = ((0, 0), (1, 1))
    water = substep.GridLiquid(
        substep.fill_box((0, 0), (1, 0.3), 0.05),
        cell=0.1,
        bounds=box,
        colliders=bodies.make_colliders(),
    )
    with pytest.raises(InputError, match="none along z, as 'water' has two dimensions, got"):
        substep.World({"bodies": bodies, "water": water})
    bodies.gravity = (0, -9.81, 0)
    substep.World({"bodies": bodies, "water": water}).step()


def test_a_body_that_was_removed():
    world = small_world()
    world.step()
    world["bodies"].remove(1)
    before = digest(world)
    with pytest.raises(InputError, match="body 1, which an obstacle of 'water' stands for, has"):
        world.step()
    assert digest(world) == before


def test_the_last_body_was_removed():
    world = small_world()
    world["bodies"].remove(world["bodies"].ids)
    with pytest.raises(InputError, match="body 0, which an obstacle of 'water' stands for, has"):
        world.step()


def test_batches_are_no_members():
    bodies = substep.RigidBodies()
    with pytest.raises(TypeError, match=r"members\['batch'\]: expected a simulation, got"):
        substep.World({"bodies": bodies, "batch": substep.RigidBatch(bodies, 2)})


def test_a_member_keeps_its_threads_until_the_world_has_some():
    a, b = (
        substep.RigidBodies(threads=1),
        substep.MassSpring([(0, 0, 0)], np.zeros((0, 2)), 1.0, 1.0, threads=2),
    )
    world = substep.World({"a": a, "b": b})
    assert (a.threads, b.threads) == (1, 2)
    world.threads = 3
    assert (a.threads, b.threads) == (3, 3)


def test_a_callback_that_restores_a_member_alone_is_noticed():
    world = small_world()
    world.advance(0.05)
    state = world["water"].state()
    with pytest.raises(InputError, match=r"'water' is at 0\.05 s, the world at"):
        world.advance(0.05, lambda w: w["water"].restore(state))


def test_members_without_their_world_have_no_bodies_and_may_go_into_another():
    world = small_world()
    world.advance(0.2)
    water = world["water"].copy()
    velocity = water.colliders[0].velocity
    water.step(0.01)
    assert np.array_equal(water.colliders[0].velocity, velocity)
    twin = world.copy()
    bodies, water = twin["bodies"], twin["water"]
    del twin
    again = substep.World({"bodies": bodies, "water": water})
    again.advance(0.1)
    assert np.abs(again.exchanged()["water"][1]).max() > 0.1


def test_a_world_cannot_be_made_of_a_member_in_a_call():
    spring = substep.MassSpring([(0, 0, 0)], np.zeros((0, 2)), 1.0, 1.0, step=0.01)
    with pytest.raises(InputError, match="callback of advance"):
        spring.advance(0.05, lambda one: substep.World({"spring": one}))


def test_interrupts_leave_bodies_and_world_together():
    """At moments all over an interval; the trial of the bodies is no exception."""
    bodies = substep.RigidBodies(step=1 / 120)
    bodies.add(substep.Sphere(0.15), (0.5, 0.5, 0.6))
    spring = substep.MassSpring(
        [(5.0, 0, 0)], np.zeros((0, 2)), 1.0, 1.0, step=0.01, colliders=bodies.make_colliders()
    )
    world = substep.World({"bodies": bodies, "spring": spring})
    handler, interrupts = signal.signal(signal.SIGALRM, signal.default_int_handler), 0
    try:
        for k in range(150):
            state, before = world.state(), digest(world)
            try:
                try:
                    signal.setitimer(signal.ITIMER_REAL, 2e-5 * (1 + k % 50))
                    world.step()
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
            except KeyboardInterrupt:
                interrupts += 1
            if world.time == state["time"]:
                assert digest(world) == before
            world.restore(state)
    finally:
        signal.signal(signal.SIGALRM, handler)
    assert interrupts > 20


def test_members_that_were_stepped_alone():
    world = small_world()
    for call in (lambda: world["water"].step(0.001), lambda: world["bodies"].advance(0.1)):
        with pytest.raises(InputError, match="a member of a World, which alone steps it"):
            call()
    state = world["water"].state()
    world["water"].restore({**state, "time": 0.001})
    for call in (world.step, world.state, world.copy, lambda: world.save("never.h5")):
        with pytest.raises(InputError, match=r"'water' is at 0\.001 s, the world at 0 s"):
            call()
    world["water"].restore(state)
    world.step()


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan, np.inf])
def test_wrong_steps(step):
    with pytest.raises(InputError, match="step"):
        substep.World({"bodies": substep.RigidBodies()}, step=step)
    world = small_world()
    with pytest.raises(InputError, match="step"):
        world.step_size = step
    assert world.step_size is None


# ---------------------------------------------------------------------------- nothing is lost


def test_an_error_in_one_member_leaves_all_as_they_were():
    world = small_world()
    world.advance(0.05)
    world["bodies"].forces[0] = 1e308, 0, 0
    before = digest(world)
    with pytest.raises(NonFiniteError, match="bodies: body 0"):
        world.step(1 / 120)
    assert digest(world) == before


def test_an_error_in_the_last_member_takes_the_others_back():
    world = small_world()
    world.advance(0.05)
    world["water"].set_velocities(np.full((len(world["water"]), 3), 1e30))
    before = digest(world)
    with pytest.raises(substep.SolverError, match="water: "):
        world.step(1 / 120)
    assert digest(world) == before


def test_no_memory_at_the_end_of_an_interval_leaves_all_as_they_were(monkeypatch):
    world = small_world()
    world.advance(0.05)
    before, calls = digest(world), []
    release = type(world._links[0]).release

    def fail_once(link):
        calls.append(link)
        if len(calls) == 1:
            raise MemoryError
        release(link)

    monkeypatch.setattr(type(world._links[0]), "release", fail_once)
    with pytest.raises(MemoryError):
        world.step(1 / 120)
    assert digest(world) == before
    twin = world.copy()
    for one in (world, twin):
        one.step(1 / 120)
    assert digest(world) == digest(twin) != before


@pytest.mark.parametrize("narrow_band", [None, 3])
def test_liquids_go_back_from_several_steps_of_their_own(narrow_band):
    """With particles that came meanwhile, as a liquid that went no further goes on."""
    bodies = substep.RigidBodies(step=1 / 30)
    ball = bodies.add(substep.Sphere(0.2), (0.5, 0.5, 0.9), density=300.0)
    tap = substep.Emitter((0.2, 0.2, 0.9), (0, 0, -1), 2.0, radius=0.1)
    water = substep.GridLiquid(
        substep.fill_box((0, 0, 0), (1, 1, 0.6), 0.05),
        cell=0.1,
        bounds=((0, 0, 0), (1, 1, 1.2)),
        colliders=bodies.make_colliders(ball),
        emitters=[tap],
        narrow_band=narrow_band,
    )
    oil = substep.GridLiquid(
        substep.fill_box((0, 0, 0), (1, 1, 0.4), 0.05), cell=0.1, bounds=((0, 0, 0), (1, 1, 1))
    )
    world = substep.World({"bodies": bodies, "water": water, "oil": oil})
    world.advance(0.2)
    twin, before, count = world.copy(), digest(world), len(water)
    oil.set_velocities(np.full((len(oil), 3), 1e30))
    held = digest(world)
    for _ in range(2):
        with pytest.raises(substep.SolverError, match="oil: "):
            world.step(1 / 15)
        assert digest(world) == held
    oil.restore(twin["oil"].state())
    assert (digest(world), len(water)) == (before, count)
    for one in (world, twin):
        one.advance(0.1)
    assert digest(world) == digest(twin)
    assert len(water) > count
    assert water.report.steps > 1


@pytest.mark.parametrize("plane", [False, True])
@pytest.mark.parametrize("kind", ["water", "sand"])
def test_bodies_that_are_small_beside_the_cells_are_told(kind, plane):
    def world(across, motion="dynamic"):
        bodies = substep.RigidBodies(gravity=(0, -9.81, 0) if plane else (0, 0, -9.81))
        disk = substep.Cylinder(across / 2, 1.0)
        middle = (0.5, 0.6, 0) if plane else (0.5, 0.5, 0.6)
        ball = disk if plane else substep.Sphere(across / 2)
        bodies.add(substep.Box((1, 1, 1)), (5, 5, 5))  # which nothing meets
        bodies.add(ball, middle, density=2000.0, motion=motion)
        met = bodies.make_colliders([1])
        d = 2 if plane else 3
        x = substep.fill_box((0,) * d, (1, 0.2) if plane else (1, 1, 0.2), 0.05)
        if kind == "water":
            other = substep.GridLiquid(x, cell=0.1, bounds=((0,) * d, (1,) * d), colliders=met)
        else:
            other = substep.MaterialPointMethod(
                x, substep.mpm.Sand(), cell=0.1, volume=0.05**d, colliders=met
            )
        return substep.World({"bodies": bodies, "bed": other})

    for made in (world(0.3 if kind == "sand" else 0.15), world(0.12, "kinematic")):
        assert len(made.members) == 2
    cell = r"0\.04" if kind == "sand" else r"0\.08"
    told = rf"members: body 1 is 0\.12 m across, 1\.2 cells of 'bed', .* cell={cell} or less"
    with pytest.warns(substep.StartWarning, match=told) as caught:
        made = world(0.12)
    assert caught[0].filename == __file__
    made.copy()  # tells nothing: it is no start


def test_callbacks_cannot_step_a_member():
    world = small_world()
    with pytest.raises(InputError, match="step"):
        world.advance(0.1, callback=lambda w: w.step())
    with pytest.raises(InputError, match="step"):
        world.advance(0.1, callback=lambda w: w["water"].step())


def test_states_of_other_worlds_are_refused():
    world, state = small_world(), small_world().state()
    before = digest(world)
    for key, value in (("water.time", 1.0), ("interval", -1.0), ("bodies.ids", np.arange(9))):
        with pytest.raises(InputError):
            world.restore({**state, key: value})
    del state["water.pressure"]
    with pytest.raises(InputError, match=r"state: water\.pressure missing"):
        world.restore(state)
    assert digest(world) == before


def test_what_does_not_fit_in_a_checkpoint_is_told(tmp_path):
    """Which member, what it should be and what it is, of worlds that were made otherwise."""

    def world(balls=2, met=None, **others):
        bodies = substep.RigidBodies()
        ids = [bodies.add(substep.Sphere(0.2), (0.5 * k, 0, 0), density=1.0) for k in range(balls)]
        net = substep.MassSpring([(9, 9, 9)], [], 1.0, 1.0, colliders=bodies.make_colliders(met))
        assert len(ids) == balls
        return substep.World({"bodies": bodies, "net": net, **others})

    def point():
        return substep.MassSpring([(0, 0, 0)], [], 1.0, 1.0)

    for made, saved, told in (
        (world(), world(3), r"state\['bodies\.ids'\]: expected 2 bodies, got 3"),
        (world(3), world(2), r"state\['bodies\.ids'\]: expected 3 bodies, got 2"),
        (
            world(),
            world(met=[0]),
            r"state\['net\.colliders'\]: expected shape \(2, 15\), got \(1, 15\)",
        ),
        (world(), world(flag=point()), "members bodies, net, got that of bodies, net, flag"),
        (world(flag=point()), world(), "members bodies, net, flag, got that of bodies, net$"),
        (world(a=point()), world(b=point()), "members bodies, net, a, got that of bodies, net, b"),
    ):
        before = digest(made)
        saved.save(tmp_path / "saved")
        with pytest.raises(substep.CorruptError, match=told):
            made.load(tmp_path / "saved")
        assert digest(made) == before


def test_copies_pickles_and_checkpoints_go_on_alike(tmp_path):
    world = small_world()
    world.advance(0.1)
    others = [world.copy(), pickle.loads(pickle.dumps(world)), small_world()]
    world.save(tmp_path / "world")
    others[2].load(tmp_path / "world")
    world.advance(0.1)
    for other in others:
        other.advance(0.1)
        assert digest(other) == digest(world)
    assert others[0]["water"] is not world["water"]
