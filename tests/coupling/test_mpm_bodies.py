"""Bodies that yield in the material point method: momentum, weight, friction, light ones."""

import numpy as np
import pytest
import substep
from substep import mpm

G = 9.81


def yields(collider, mass, inertia=np.inf, gravity=(0, 0, -G), number=0, centre=(0, 0, 0)):
    """The collider stands for a body of this mass [kg] and moment of inertia about any axis."""
    mobility = np.diag([1 / mass] * 3 + [1 / inertia] * 3)
    acceleration = [*map(float, gravity), 0.0, 0.0, 0.0]
    collider._native.set_body(
        number, tuple(map(float, centre)), mobility.ravel().tolist(), acceleration
    )
    return collider


def received(collider):
    return np.array(collider._native.received)


def block(low, counts, spacing):
    """A lattice of particles; its corner `low` is half a spacing off the first."""
    axes = [at + spacing * (np.arange(n) + 0.5) for at, n in zip(low, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def jelly(young_modulus=1e5):
    return mpm.NeoHookean(density=1000, young_modulus=young_modulus, poisson_ratio=0.3)


def momentum(simulation):
    diagnostics = simulation.diagnostics()
    return np.array([diagnostics[f"momentum_{axis}"] for axis in "xyz"])


def falling_plate(boundary="separate", dtype="float32", threads=None, **options):
    x = block((-0.2, -0.2, 0), (16, 16, 8), 0.025)
    plate = substep.Collider(
        substep.Box((0.3, 0.3, 0.02), (0, 0, 0.225)), friction=0.4, velocity=(0.5, 0, -2)
    )
    yields(plate, 20.0, 0.4, gravity=(0, 0, 0))
    simulation = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=0.05,
        volume=0.025**3,
        gravity=(0, 0, 0),
        colliders=[plate],
        boundary=boundary,
        dtype=dtype,
        threads=threads,
        **options,
    )
    return simulation, plate


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"transfer": "aflip"},
        {"transfer": "flip"},
        {"form": "textbook"},
        {"kernel": "linear"},
        {"kernel": "cubic"},
    ],
    ids=str,
)
@pytest.mark.parametrize("boundary", ["separate", "slip", "sticky"])
@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 2e-6), ("float64", 1e-12)])
def test_a_heavy_plate_and_a_jelly_exchange_momentum(options, boundary, dtype, tolerance):
    simulation, plate = falling_plate(boundary, dtype, **options)
    before = 20 * plate.velocity
    simulation.advance(0.03)
    given = received(plate)[:3]
    size = np.abs(given).max()
    assert size > 2
    assert 20 * plate.velocity - before == pytest.approx(given, abs=1e-12 * size)
    assert momentum(simulation) == pytest.approx(-given, abs=tolerance * size)


def test_in_free_fall_nothing_is_received():
    simulation, plate = falling_plate()
    yields(plate, 20.0, 0.4, gravity=(0, 0, -G))
    plate.position, plate.velocity = (0, 0, 5), (0, 0, 0)
    simulation.advance(0.05)
    assert plate.velocity == pytest.approx([0, 0, -G * 0.05], rel=1e-12)
    assert not received(plate).any()


# Of the mass of the liquid or solid that it displaces.
@pytest.mark.parametrize("ratio", [1e-4, 0.01, 0.05, 1.0, 20.0])
@pytest.mark.parametrize("boundary", ["separate", "slip", "sticky"])
def test_no_energy_comes_from_a_ball_that_a_block_throws(ratio, boundary):
    radius = 0.1
    x = block((-0.2, -0.2, -0.2), (16, 16, 8), 0.025)
    ball = substep.Collider(substep.Sphere(radius, (0.03, 0.02, radius + 0.01)), friction=0.3)
    mass = ratio * 1000 * 4 / 3 * np.pi * radius**3
    yields(ball, mass, 0.4 * mass * radius**2, gravity=(0, 0, 0))
    simulation = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=0.05,
        volume=0.025**3,
        gravity=(0, 0, 0),
        velocities=np.broadcast_to([0, 0, 1.0], x.shape),
        colliders=[ball],
        boundary=boundary,
    )

    def energy():
        own = simulation.diagnostics()
        spin = 0.2 * mass * radius**2 * ball.angular_velocity @ ball.angular_velocity
        motion = 0.5 * mass * ball.velocity @ ball.velocity
        return own["kinetic_energy"] + own["elastic_energy"] + motion + spin

    energies = [energy()]
    for _ in range(20):
        simulation.advance(0.01)
        energies.append(energy())
    least = np.minimum.accumulate(energies)[:-1]
    assert np.all(energies[1:] < (1 + 5e-3) * least)
    # A throw gives at most twice the speed of the block.
    assert 0.2 < ball.velocity[2] < 2


def test_a_light_ball_in_a_block_moves_with_it():
    x = block((-0.3, -0.3, -0.3), (24, 24, 24), 0.025)
    ball = substep.Collider(substep.Sphere(0.12))
    x = x[ball.distance(x) > 0.005]
    yields(ball, 0.001, 1e-6, gravity=(0, 0, 0))
    simulation = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=0.05,
        volume=0.025**3,
        gravity=(0, 0, 0),
        velocities=np.broadcast_to([1.0, 0, 0], x.shape),
        colliders=[ball],
        boundary="sticky",
    )
    simulation.step(1e-4)
    assert ball.velocity == pytest.approx([1, 0, 0], abs=2e-3)
    simulation.advance(0.1)
    assert ball.velocity == pytest.approx([1, 0, 0], abs=2e-3)
    assert ball.angular_velocity == pytest.approx([0, 0, 0], abs=0.02)


def box_on_a_block(pressure, cells, boundary):
    """How far it lies below the top of the unloaded block, which cannot get wider.

    And what it was given over its weight.
    """
    side = 0.4
    spacing = side / (2 * cells)
    x = block((-side / 2, 0), (2 * cells, 2 * cells), spacing)
    mass = pressure * side / G
    box = substep.Collider(substep.Box((0.6, 0.2, 1), (0, side + 0.1, 0)))
    yields(box, mass, gravity=(0, -G, 0))
    walls = [
        substep.Collider(substep.Plane((0, 1, 0))),
        substep.Collider(substep.Plane((1, 0, 0), (-side / 2, 0, 0))),
        substep.Collider(substep.Plane((-1, 0, 0), (side / 2, 0, 0))),
    ]
    simulation = substep.MaterialPointMethod(
        x,
        jelly(1e6),
        cell=2 * spacing,
        volume=spacing**2,
        colliders=[box, *walls],
        boundary=[boundary, "slip", "slip", "slip"],
        dtype="float64",
    )
    for _ in range(120):  # what swings comes to rest
        simulation.advance(0.004)
        simulation.set_velocities(0.6 * simulation.velocities)
        box.velocity = 0.6 * box.velocity
    before = received(box)
    simulation.advance(0.05)
    weight = mass * G * 0.05
    return side + 0.1 - box.position[1], (received(box) - before)[1] / weight


@pytest.mark.parametrize("boundary", ["separate", "sticky"])
@pytest.mark.parametrize(("cells", "tolerance"), [(8, 0.07), (16, 0.04)])
def test_a_box_compresses_the_block_under_it(cells, tolerance, boundary):
    # By its pressure and the mean weight over lambda + 2 mu. The surfaces come closer by a part of
    # a cell before that.
    pressure, height, p_wave = 1e4, 0.4, 1e6 * 0.7 / (1.3 * 0.4)
    sunk, carried = box_on_a_block(pressure, cells, boundary)
    assert carried == pytest.approx(1, abs=0.01)
    mean = pressure + 0.5 * 1000 * G * height
    assert sunk == pytest.approx(mean / p_wave * height, rel=tolerance)


def ball_on_sand(drop=0.0, ratio=2.0, cells=8, width=6, depth=4, threads=None):
    """A disk of 0.1 m, `cells` cells across, that comes as from the height `drop`; and its mass."""
    diameter, density = 0.1, 1500
    spacing = diameter / cells / 2
    x = block(
        (-width * diameter / 2, -depth * diameter), (2 * width * cells, 2 * depth * cells), spacing
    )
    sand = mpm.Sand(
        density=density,
        young_modulus=200 * density * G * depth * diameter,
        poisson_ratio=0.3,
        friction_angle=np.radians(30),
    )
    ball = substep.Collider(
        substep.Sphere(diameter / 2, (0, diameter / 2 + 1e-4, 0)),
        friction=0.5,
        velocity=(0, -np.sqrt(2 * G * drop), 0),
    )
    mass = ratio * density * np.pi * diameter**2 / 4
    yields(ball, mass, mass * diameter**2 / 8, gravity=(0, -G, 0))
    tank = substep.Collider(
        substep.Box((width * diameter, 20, 20), (0, 10 - depth * diameter, 0)),
        hollow=True,
        friction=0.6,
    )
    simulation = substep.MaterialPointMethod(
        x, sand, cell=2 * spacing, volume=spacing**2, colliders=[ball, tank], threads=threads
    )
    return simulation, ball, mass


def test_a_ball_sinks_into_sand_and_stops_and_the_sand_carries_its_weight():
    simulation, ball, mass = ball_on_sand(drop=0.1)
    simulation.advance(0.6)
    depth, before = 0.05 - ball.position[1], received(ball)
    assert 0.2 < depth / 0.1 < 0.8
    simulation.advance(0.2)
    assert 0.05 - ball.position[1] == pytest.approx(depth, abs=0.001)
    assert (received(ball) - before)[1] == pytest.approx(0.2 * mass * G, rel=0.01)


@pytest.mark.parametrize(("degrees", "slides"), [(10.0, False), (26.0, True)])
def test_a_box_on_a_slope_of_sand_slides_from_its_friction_on(degrees, slides):
    # Friction 0.3, so from 16.7 degrees on; the sand itself holds 29.8. The box pushes sand before
    # it: what brakes it is up to a third more.
    angle, friction, depth, length, cell = np.radians(degrees), 0.3, 0.24, 3.2, 0.04
    x = block((-length / 2, -depth), (round(2 * length / cell), 12), cell / 2)
    sand = mpm.Sand(
        density=1500,
        young_modulus=200 * 1500 * G * depth,
        poisson_ratio=0.3,
        friction_angle=np.radians(35),
    )
    gravity = G * np.array([np.sin(angle), -np.cos(angle)])
    box = substep.Collider(substep.Box((0.4, 0.2, 1), (-0.3, 0.1 + 1e-4, 0)), friction=friction)
    mass = 60.0
    yields(box, mass, mass * 0.2 / 12, gravity=(*gravity, 0))
    walls = [
        substep.Collider(substep.Plane((0, 1, 0), (0, -depth, 0))),
        substep.Collider(substep.Plane((1, 0, 0), (-length / 2, 0, 0))),
        substep.Collider(substep.Plane((-1, 0, 0), (length / 2, 0, 0))),
    ]
    simulation = substep.MaterialPointMethod(
        x,
        sand,
        cell=cell,
        volume=cell**2 / 4,
        gravity=gravity,
        colliders=[box, *walls],
        boundary=["separate", "sticky", "separate", "separate"],
    )
    simulation.advance(0.15)
    speed, before = box.velocity[0], received(box)
    simulation.advance(0.25)
    pushed, rubbed = (received(box) - before)[1], -(received(box) - before)[0]
    assert pushed == pytest.approx(mass * G * np.cos(angle) * 0.25, rel=0.05)
    if slides:
        assert friction < rubbed / pushed < 1.33 * friction
        assert box.velocity[0] > speed + 0.1
    else:
        assert abs(box.velocity[0]) < 0.02


@pytest.mark.parametrize(("cells", "tolerance"), [(6, 0.2), (12, 0.12)])
def test_a_box_floats(cells, tolerance):
    # Half as dense as the liquid. It lies a part of a cell deeper than Archimedes says.
    side, width, height = 0.2, 1.0, 0.5
    cell = side / cells
    x = block((-width / 2, 0), (round(2 * width / cell), round(2 * height / cell)), cell / 2)
    water = mpm.Fluid(density=1000, bulk_modulus=200 * 1000 * G * height)
    box = substep.Collider(substep.Box((side, side, 1), (0, height, 0)))
    x = x[box.distance(np.c_[x, 0 * x[:, 0]]) > 0]
    yields(box, 500 * side**2, gravity=(0, -G, 0))
    walls = [
        substep.Collider(substep.Plane((0, 1, 0))),
        substep.Collider(substep.Plane((1, 0, 0), (-width / 2, 0, 0))),
        substep.Collider(substep.Plane((-1, 0, 0), (width / 2, 0, 0))),
    ]
    simulation = substep.MaterialPointMethod(
        x, water, cell=cell, volume=cell**2 / 4, colliders=[box, *walls], transfer="apic"
    )
    before, drafts = received(box), []
    for _ in range(10):
        simulation.advance(0.1)
        far = np.abs(simulation.positions[:, 0]) > 0.3
        level = 2 * simulation.positions[far, 1].mean()
        drafts.append(level - (box.position[1] - side / 2))
    assert np.mean(drafts) / side == pytest.approx(0.5, rel=tolerance)
    assert (received(box) - before)[1] == pytest.approx(500 * side**2 * G, rel=0.03)


def test_shapes_of_one_body_move_as_one():
    # A dumbbell falls with one end on a jelly: it turns, and its ends keep their distance.
    x = block((-0.2, -0.2, 0), (16, 16, 8), 0.025)
    ends = [substep.Collider(substep.Sphere(0.06, (x, 0, 0.27))) for x in (0.1, 0.4)]
    for end, arm in zip(ends, (0.15, -0.15), strict=True):
        yields(end, 2.0, 0.05, centre=(arm, 0, 0))
    simulation = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=0.05,
        volume=0.025**3,
        gravity=(0, 0, 0),
        colliders=ends,
        dtype="float64",
    )
    simulation.advance(0.3)
    assert ends[0].angular_velocity[1] > 0.3
    assert ends[1].angular_velocity == pytest.approx(ends[0].angular_velocity, rel=1e-9, abs=1e-9)
    away = ends[1].position - ends[0].position
    assert np.linalg.norm(away) == pytest.approx(0.3, rel=1e-3)
    spin = np.cross(ends[0].angular_velocity, away)
    assert ends[1].velocity - ends[0].velocity == pytest.approx(spin, abs=1e-2)


def test_threads_and_checkpoints_do_not_change_a_bit():
    def run(threads):
        simulation, ball, _ = ball_on_sand(drop=0.1, threads=threads)
        simulation.advance(0.1)
        return simulation, ball

    def numbers(simulation, ball):
        given = [ball.position, ball.velocity, ball.angular_velocity, ball.impulse]
        arrays = [simulation.positions.ravel(), simulation.velocities.ravel(), *given]
        return np.concatenate(arrays).tobytes()

    simulation, ball = run(1)
    now = numbers(simulation, ball)
    assert numbers(*run(2)) == now
    assert numbers(*run(3)) == now
    state = simulation.state()
    simulation.advance(0.05)
    after = numbers(simulation, ball)
    simulation.restore(state)
    simulation.advance(0.05)
    assert numbers(simulation, ball) == after


def test_a_step_that_fails_leaves_bodies_as_they_were():
    simulation, plate = falling_plate(step=1.0)
    simulation.step(1e-3)
    before = np.concatenate([plate.position, plate.velocity, received(plate)])
    with pytest.raises(substep.SolverError):
        simulation.step(1.0)
    assert np.array_equal(before, np.concatenate([plate.position, plate.velocity, received(plate)]))


def test_implicit_steps_refuse_bodies_that_yield():
    simulation, plate = falling_plate(integrator="implicit_euler")
    before = simulation.positions
    with pytest.raises(substep.InputError, match=r"colliders\[0\].*implicit_euler.*yields"):
        simulation.advance(0.01)
    assert np.array_equal(simulation.positions, before)
    assert plate.position[2] == 0.225
