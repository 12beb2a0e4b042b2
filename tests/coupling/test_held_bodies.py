"""Light bodies that contacts, ropes and ends of joints hold against loads, as if fixed."""

import numpy as np
import pytest
import substep

G = 9.81


def lattice(low, high, spacing):
    rows = [np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*rows, indexing="ij"), -1).reshape(-1, len(low))


def board(support, density):
    """Of 0.8 x 0.1 m, in a plane, on whose top the load lies."""
    bodies = substep.RigidBodies(gravity=(0, -G, 0))
    one = bodies.add(substep.Box((0.8, 0.1, 1)), (0.4, 0.05, 0), density=density)
    if support == "contact":
        bodies.add(substep.Plane((0, 1, 0)), (0, 0, 0), motion="static")
    else:
        bodies.slider(one, None, (0.4, 0, 0), (0, 1, 0), limits=(0, 1))
    return bodies, bodies.make_colliders(one)


def loads(bodies, member, seconds, step=None):
    """Of the weight of the member, on the body, in each interval."""
    world = substep.World({"bodies": bodies, "member": member}, step=step)
    weight, given, energies = member.masses.sum() * G, [], [world.diagnostics()["energy"]]
    while world.time < seconds:
        world.step()
        given.append(-world.exchanged()["member"][1][0, 1] / weight)
        energies.append(world.diagnostics()["energy"])
    assert max(energies) < energies[0] + 1e-3
    return np.array(given)


@pytest.mark.parametrize("step", [None, 1 / 240])
@pytest.mark.parametrize("support", ["contact", "end of a slider"])
@pytest.mark.parametrize("density", [100.0, 3.0])
def test_water_on_a_light_board_is_at_rest(support, density, step):
    """320 kg on 8 kg, and on 0.24 kg, from the first interval on."""
    bodies, obstacles = board(support, density)
    water = substep.GridLiquid(
        lattice((0, 0.1), (0.8, 0.5), 0.025),
        cell=0.05,
        bounds=((0, 0), (0.8, 0.8)),
        colliders=obstacles,
    )
    given = loads(bodies, water, 0.5, step)
    assert given == pytest.approx(1, abs=1e-3)
    assert np.abs(water.velocities).max() < 1e-3


def test_sand_on_a_light_board_presses_with_its_weight():
    bodies, obstacles = board("contact", 30.0)
    sand = substep.MaterialPointMethod(
        lattice((0, 0.1), (0.8, 0.5), 0.025),
        substep.mpm.Sand(density=1600.0, young_modulus=1e6, poisson_ratio=0.3, friction_angle=0.6),
        cell=0.05,
        volume=0.025**2,
        gravity=(0, -G),
        colliders=[
            *obstacles,
            substep.Collider(substep.Plane((1, 0, 0)), friction=0.0),
            substep.Collider(substep.Plane((-1, 0, 0), (0.8, 0, 0)), friction=0.0),
        ],
    )
    given = loads(bodies, sand, 2.0)
    assert given[60:].mean() == pytest.approx(1, abs=0.02)
    assert given[60:].std() < 0.15


@pytest.mark.parametrize("ratio", [0.3, 0.03, 0.003])
def test_a_buoy_on_a_rope_pulls_by_its_lift(ratio):
    """The rope ends at the floor; of a disk of 12 cells."""
    n, r = 12, 0.15
    cell, depth = 2 * r / n, 1.0
    bodies = substep.RigidBodies(gravity=(0, -G, 0))
    disk = bodies.add(substep.Cylinder(r, 1.0), (0.5, 0.5, 0), density=1000 * ratio)
    rope = bodies.distance(disk, None, (0.5, 0.5, 0), (0.5, 0, 0), limits=(0, 0.5))
    obstacles = bodies.make_colliders(disk)
    x = lattice((0, 0), (1, depth), cell / 2)
    water = substep.GridLiquid(
        x[np.linalg.norm(x - 0.5, axis=1) > r],
        cell=cell,
        bounds=((0, 0), (1, 1.3)),
        colliders=obstacles,
    )
    world = substep.World({"bodies": bodies, "water": water})
    tensions = []
    world.advance(2.0, lambda _: tensions.append(np.linalg.norm(rope.force)))
    lift = (1 - ratio) * 1000 * np.pi * r**2 * G
    late = np.array(tensions[60:])
    assert late.mean() == pytest.approx(lift, rel=0.01)
    assert np.abs(late / lift - 1).max() < 0.02


@pytest.mark.parametrize("density", [100.0, 3.0, 1.0])
def test_a_jelly_that_bounces_off_a_light_box_leaves_it_on_the_ground(density):
    """19 kg on 1.8 kg to 18 g: what held the box down does not hold it when the jelly lifts off."""
    bodies = substep.RigidBodies()
    bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    box = bodies.add(substep.Box((0.3, 0.3, 0.2)), (0.5, 0.5, 0.1), density=density)
    jelly = substep.MaterialPointMethod(
        substep.fill_box((0.3, 0.3, 0.4), (0.7, 0.7, 0.7), 0.05),
        substep.mpm.FixedCorotated(1000.0, 1e5, 0.3),
        cell=0.1,
        volume=0.05**3,
        bounds=((-3, -3, -0.2), (4, 4, 3)),
        colliders=[*bodies.make_colliders(box), substep.Plane()],
    )
    world, fastest, rising = substep.World({"bodies": bodies, "jelly": jelly}), [], []

    def note(_):
        fastest.append(np.abs(bodies.velocities).max())
        rising.append(jelly.velocities[:, 2].mean())

    world.advance(0.5, note)
    assert max(fastest) < 0.01
    assert max(rising) > 0


# ---------------------------------------------------------------------------- what is no support


@pytest.mark.parametrize("mass", [100.0, 10.0])
def test_a_board_on_a_spring_carries_a_cube_at_rest(mass):
    """64 kg of springs, on a board whose spring is in balance with both from the start."""
    bodies = substep.RigidBodies()
    one = bodies.add(substep.Box((0.8, 0.8, 0.1)), (0, 0, -0.05), mass=mass)
    motor = substep.rigid.SpringMotor((64 + mass) * G / 2e4, 2e4, 200.0)
    spring = bodies.slider(one, None, (0, 0, -0.05), (0, 0, 1), motor=motor)
    sides = (-0.2, 0.2), (-0.2, 0.2), (0.001, 0.401)
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 3)
    edges = np.array([(i, j) for i in range(8) for j in range(i)])
    obstacles = bodies.make_colliders()
    cube = substep.MassSpring(corners, edges, 2e4, 8.0, damping=50.0, colliders=obstacles)
    world, went = substep.World({"bodies": bodies, "cube": cube}), []
    world.advance(1.5, lambda _: went.append(spring.coordinate))
    assert np.abs(went[45:]).max() < 1e-3


def sphere_under_water(density):
    bodies = substep.RigidBodies()
    ball = bodies.add(substep.Sphere(0.2), (0.5, 0.5, 0.5), density=density)
    obstacles = bodies.make_colliders()
    x = substep.fill_box((0, 0, 0), (1, 1, 0.9), 0.05)
    water = substep.GridLiquid(
        x[obstacles[0].distance(x) > 0],
        cell=0.1,
        bounds=((0, 0, 0), (1, 1, 1.2)),
        colliders=obstacles,
    )
    return bodies, ball, water


@pytest.mark.parametrize("density", [300.0, 50.0])
def test_a_spring_holds_a_float_under_water_where_it_is(density):
    bodies, ball, water = sphere_under_water(density)
    lift = (1000 - density) * 4 / 3 * np.pi * 0.2**3 * G
    motor = substep.rigid.SpringMotor(0.4 - lift / 2e3, 2e3, 100.0)
    at = (0.5, 0.5, 0.5), (0.5, 0.5, 0.1)
    spring = bodies.distance(ball, None, *at, limits=(0, np.inf), motor=motor)
    world, tension = substep.World({"bodies": bodies, "water": water}), []
    world.advance(1.5, lambda _: tension.append(-spring.effort))
    assert abs(bodies.positions[ball, 2] - 0.5) < 0.01
    assert np.mean(tension[45:]) == pytest.approx(lift, rel=0.01)


def test_a_light_float_on_a_rod_swings_without_gaining_energy():
    bodies, ball, water = sphere_under_water(20.0)
    bodies.set_velocities((0.3, 0, 0), [ball])
    bodies.ball(ball, None, (0.5, 0.5, 0.1))
    world = substep.World({"bodies": bodies, "water": water})
    start, energies = world.diagnostics()["energy"], []
    world.advance(1.0, lambda _: energies.append(world.diagnostics()["energy"]))
    assert max(energies) < start + 1e-3


@pytest.mark.parametrize("strength", [np.inf, 1.2])
@pytest.mark.parametrize("kind", ["hinge", "slider"])
def test_a_motor_holds_a_light_gate_against_still_water(kind, strength):
    """0.2 kg against a load of rho g h^2 / 2, of moment rho g h^3 / 6 about the floor."""
    h, side = 0.6, 1.0
    bodies = substep.RigidBodies(gravity=(0, -G, 0))
    gate = bodies.add(substep.Box((0.2, 1, 1)), (side + 0.1, 0.5, 0), density=1.0)
    load = 1000 * G * h**2 / 2
    most = strength * (load if kind == "slider" else load * h / 3)
    motor = substep.rigid.SpeedMotor(0.0, strength=most)
    if kind == "slider":
        joint = bodies.slider(gate, None, (side + 0.1, 0.5, 0), (1, 0, 0), motor=motor)
    else:
        joint = bodies.hinge(gate, None, (side + 0.1, 0, 0), (0, 0, 1), motor=motor)
    water = substep.GridLiquid(
        lattice((0, 0), (side, h), 0.025),
        cell=0.05,
        bounds=((0, 0), (1.6, 1.2)),
        colliders=bodies.make_colliders(gate),
    )
    world, given = substep.World({"bodies": bodies, "water": water}), []
    world.advance(0.5, lambda _: given.append(world.exchanged()["water"][1][0, 0]))
    assert np.array(given) == pytest.approx(load, rel=1e-3)
    assert abs(joint.coordinate) < 1e-9
    assert np.abs(water.velocities).max() < 1e-3


def test_a_motor_that_is_too_weak_lets_a_light_gate_go():
    h, side = 0.6, 1.0
    bodies = substep.RigidBodies(gravity=(0, -G, 0))
    gate = bodies.add(substep.Box((0.2, 1, 1)), (side + 0.1, 0.5, 0), density=1.0)
    motor = substep.rigid.SpeedMotor(0.0, strength=0.3 * 1000 * G * h**2 / 2)
    joint = bodies.slider(gate, None, (side + 0.1, 0.5, 0), (1, 0, 0), motor=motor)
    water = substep.GridLiquid(
        lattice((0, 0), (side, h), 0.025),
        cell=0.05,
        bounds=((0, 0), (2.4, 1.2)),
        colliders=bodies.make_colliders(gate),
    )
    world = substep.World({"bodies": bodies, "water": water})
    start, energies = world.diagnostics()["energy"], []
    world.advance(0.3, lambda _: energies.append(world.diagnostics()["energy"]))
    assert joint.coordinate > 0.1
    assert max(energies) < start + 1e-6 * abs(start)


@pytest.mark.parametrize("kind", ["hinge", "elastic"])
def test_a_damped_spring_holds_a_light_gate_against_still_water(kind):
    """1 kg against a moment of 0.35 kN m, on a spring that yields by 0.35 mrad."""
    h, side = 0.6, 1.0
    bodies = substep.RigidBodies(gravity=(0, -G, 0))
    gate = bodies.add(substep.Box((0.2, 1, 1)), (side + 0.1, 0.5, 0), mass=1.0)
    load = 1000 * G * h**2 / 2
    if kind == "hinge":
        motor = substep.rigid.SpringMotor(load * h / 3 / 1e6, 1e6, 500.0)
        bodies.hinge(gate, None, (side, 0, 0), (0, 0, 1), motor=motor)
    else:
        spring = substep.rigid.TurnSpring(1e6, 1e6, 500.0, 500.0)
        bodies.elastic(gate, None, (side + 0.1, 0, 0), (0, 0, 1), spring)
    water = substep.GridLiquid(
        lattice((0, 0), (side, h), 0.025),
        cell=0.05,
        bounds=((0, 0), (1.6, 1.2)),
        colliders=bodies.make_colliders(gate),
    )
    world, given = substep.World({"bodies": bodies, "water": water}), []
    world.advance(0.5, lambda _: given.append(world.exchanged()["water"][1][0, 0]))
    assert np.array(given[10:]) == pytest.approx(load, rel=0.005)
    assert np.abs(water.velocities).max() < 0.01
