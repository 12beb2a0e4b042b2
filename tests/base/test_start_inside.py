"""What an obstacle is put upon comes out of it, and gets no velocity and no impulse by that.

The same way in every method that has obstacles: a sheet of points at rest, without gravity, inside
of a ground, a block and a mesh.
"""

import numpy as np
import pytest
import substep

DEPTH = 0.004  # [m] of the sheet in the ground
STILL = (0.0, 0.0, 0.0)
AXIS = 0.05 * np.arange(4)
SHEET = np.stack(np.meshgrid(AXIS, AXIS, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)


def springs(integrator):
    return lambda colliders: substep.MassSpring(
        SHEET, [], 0.0, gravity=STILL, colliders=colliders, integrator=integrator, masses=0.1
    )


def material(integrator):
    jelly = substep.mpm.NeoHookean(density=1000, young_modulus=2e4, poisson_ratio=0.3)
    return lambda colliders: substep.MaterialPointMethod(
        *(SHEET, jelly),
        cell=0.1,
        volume=0.05**3,
        gravity=STILL,
        colliders=colliders,
        integrator=integrator,
    )


METHODS = {
    "springs, implicit": springs("implicit_euler"),
    "springs, explicit": springs("velocity_verlet"),
    "position-based dynamics": lambda colliders: substep.PositionBasedDynamics(
        SHEET, 0.1, [], gravity=STILL, colliders=colliders
    ),
    "position-based fluid": lambda colliders: substep.PositionBasedFluid(
        SHEET, 0.05, gravity=STILL, colliders=colliders
    ),
    "material points, explicit": material("explicit"),
    "material points, implicit": material("implicit_euler"),
}
SLAB = substep.geometry.box_mesh((1, 1, 0.2))
GROUNDS = {
    "plane": substep.Plane,
    "box": lambda: substep.Box((1, 1, 0.2), (0, 0, -0.1)),
    "mesh": lambda: substep.TriangleMesh(SLAB.vertices - (0, 0, 0.1), SLAB.faces),
}


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("when", ["made", "moved"])
def test_comes_out_without_energy(method, ground, when):
    obstacle = substep.Collider(GROUNDS[ground]())
    below = obstacle.position
    obstacle.position = below + np.array([0, 0, DEPTH if when == "made" else -1.0])
    simulation = METHODS[method]([obstacle])
    if when == "moved":
        simulation.step(1e-3)
        obstacle.position = below + np.array([0, 0, DEPTH])
    fastest, given = 0.0, np.zeros(3)
    for _ in range(60):
        simulation.step(1e-3)
        fastest = max(fastest, np.abs(simulation.velocities).max())
        given += obstacle.impulse
    assert obstacle.distance(simulation.positions).min() > -1e-15  # explicit springs: on it
    assert fastest < 1e-3
    assert np.abs(given).max() < 1e-3 * simulation.masses.sum()


@pytest.mark.filterwarnings("ignore::substep.StartWarning")
@pytest.mark.parametrize("shape", ["ball", "block"])
@pytest.mark.parametrize("depth", [0.026, 0.03, 0.05, 0.09, 0.1])  # [m], of layers of 0.03 m
def test_a_liquid_is_parted_at_any_depth(shape, depth):
    """The neighbours of what is set off are those that it has there."""
    water = substep.fill_box((0, 0, 0), (0.3, 0.3, 0.3), spacing=0.03)
    shapes = {"ball": substep.Sphere(0.4, (0, 0, -0.4)), "block": substep.Box((2, 2, 0.5))}
    obstacle = substep.Collider(shapes[shape])
    top = depth + water[:, 2].min()
    obstacle.position = (0.15, 0.15, top if shape == "ball" else top - 0.25)
    liquid = substep.PositionBasedFluid(water, 0.03, gravity=STILL, colliders=[obstacle])
    impulse = np.zeros(3)
    for _ in range(20):
        liquid.step(2e-3)
        impulse += obstacle.impulse
    assert np.abs(liquid.velocities).max() < 0.1  # it was 4 to 20 m/s
    momentum = liquid.masses @ liquid.velocities
    assert momentum == pytest.approx(-impulse, abs=1e-3)


@pytest.mark.filterwarnings("ignore::substep.StartWarning")
@pytest.mark.parametrize("divergence_free", [False, True])
@pytest.mark.parametrize(
    ("lengths", "center"),
    [
        ((0.1, 0.1, 1), (0.8, 0.05, 0)),  # stands on the floor
        ((0.1, 0.1, 1), (0.95, 0.05, 0)),  # in a corner
        ((0.1, 0.1, 1), (0.6, 0.07, 0)),  # a spacing above the floor
        ((0.1, 0.6, 1), (0.8, 0.3, 0)),  # through all of the liquid
    ],
)
def test_liquid_in_a_block_beside_walls_finds_a_way_out(lengths, center, divergence_free):
    """The nearest face may have a wall behind it; what comes out at one place is parted too."""
    water = substep.fill_box((0, 0), (1, 0.3), 0.02)
    tank = substep.Collider(substep.Box((1, 1, 1), (0.5, 0.5, 0)), hollow=True)
    block = substep.Collider(substep.Box(lengths, center))
    liquid = substep.PositionBasedFluid(
        water, 0.02, colliders=[tank, block], divergence_free=divergence_free
    )
    energy, fastest = liquid.diagnostics()["energy"], 0.0
    for _ in range(40):
        liquid.step(2e-3)
        fastest = max(fastest, np.linalg.norm(liquid.velocities, axis=1).max())
    x = np.pad(liquid.positions, ((0, 0), (0, 1)))
    assert min(tank.distance(x).min(), block.distance(x).min()) > -1e-6
    assert fastest < 1.5  # that of falling by a fifth of the depth; it was 1e5 m/s
    assert liquid.diagnostics()["energy"] < 1.25 * energy  # what is displaced lies on top


@pytest.mark.parametrize("top", [0.45, 1.0, 10.0])
@pytest.mark.parametrize("height", [0.02, 0.05, 0.1, 0.3])
def test_a_floor_beside_a_face_is_no_wall_before_it(top, height):
    pillar = substep.Collider(substep.Box((0.3, 0.3, top), (0.5, 0.5, top / 2)))
    liquid = substep.PositionBasedFluid(
        [[0.37, 0.5, height]], 0.05, gravity=STILL, colliders=[substep.Plane(), pillar]
    )
    liquid.step(1e-5)
    assert liquid.positions[0] == pytest.approx([0.345, 0.5, height], abs=0.005)


@pytest.mark.filterwarnings("ignore::substep.StartWarning")
@pytest.mark.parametrize(
    "colliders",
    [
        (substep.Collider(substep.Box((1, 1, 1), (0, 0, 0.5)), hollow=True), substep.Plane()),
        (substep.Collider(substep.Sphere(1), hollow=True), substep.Plane()),
        (substep.Box((1, 1, 1)), substep.Collider(substep.Box((1, 1, 1)), hollow=True)),
        (substep.Plane(), substep.Plane((0, 0, -1))),
    ],
    ids=["tank on the ground", "ball on the ground", "no room", "no room between planes"],
)
def test_outside_of_a_tank_and_below_the_ground(colliders):
    colliders = [c.copy() if isinstance(c, substep.Collider) else c for c in colliders]
    points = substep.PositionBasedDynamics([[0.1, 0.2, -1.3]], 1.0, colliders=colliders)
    points.step(1e-3)
    assert np.abs(points.positions).max() < 3


LIQUID = {
    "liquid on a grid": lambda colliders: substep.GridLiquid(
        SHEET + 0.4, cell=0.1, bounds=[(0, 0, 0), (1, 1, 1)], gravity=STILL, colliders=colliders
    ),
    "flow on a grid": lambda colliders: substep.GridFlow(
        [(0, 0, 0), (1, 1, 1)], 0.25, colliders=colliders
    ),
}


@pytest.mark.parametrize("method", [*METHODS, *LIQUID])
def test_an_obstacle_is_not_carried_beyond_what_a_state_holds(method):
    ball = substep.Collider(substep.Sphere(0.1, (0.0, 0.0, 7.0)))
    simulation = (METHODS | LIQUID)[method]([ball])
    simulation.step(1e-3)
    ball.velocity = (1e150, 0.0, 0.0)
    ball.position = (9.9999e149, 0.0, 7.0)
    before = simulation.state()
    with pytest.raises(substep.SolverError, match="an obstacle would be carried") as caught:
        simulation.step(1e-3)
    assert caught.value.time == pytest.approx(simulation.time, abs=1e-3)
    after = simulation.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    simulation.copy().restore(before)
    ball.velocity, ball.position = STILL, (0.0, 0.0, 7.0)
    simulation.step(1e-3)
