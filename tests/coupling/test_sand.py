"""Sand on rigid bodies: pressure on walls at rest and where these yield, depths of balls."""

import numpy as np
import pytest
import substep
from substep import mpm

G, DENSITY, HEIGHT, LENGTH = 9.81, 1600.0, 0.4, 1.0
UNIT = 0.5 * DENSITY * G * HEIGHT**2  # of the thrust on a wall of 1 m, without its coefficient [N]


def wall_and_sand(degrees, poisson_ratio=0.3, cells=16, motion="kinematic", **options):
    """Sand of so many cells' height behind a smooth wall, in plane strain, brought to rest."""
    d = HEIGHT / cells / 2
    axes = [d * (np.arange(round(side / d)) + 0.5) for side in (LENGTH, HEIGHT)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    sand = mpm.Sand(
        density=DENSITY,
        young_modulus=600 * DENSITY * G * HEIGHT,
        poisson_ratio=poisson_ratio,
        friction_angle=np.radians(degrees),
    )
    bodies = substep.RigidBodies(step=1 / 240, gravity=(0, 0, 0))
    box, x_box = substep.Box((0.2, 3 * HEIGHT, 1)), (-0.1, 1.2 * HEIGHT, 0)
    wall = bodies.add(box, x_box, motion=motion, friction=0.0, **options)
    colliders = [
        *bodies.make_colliders(wall),
        substep.Collider(substep.Plane((0, 1, 0)), friction=0.6),
        substep.Collider(substep.Plane((-1, 0, 0), (LENGTH, 0, 0))),
    ]
    heap = substep.MaterialPointMethod(
        x, sand, cell=2 * d, volume=d**2, gravity=(0, 0), colliders=colliders
    )
    return substep.World({"bodies": bodies, "sand": heap})


def settle(world, push=0.0):
    """Gravity grows slowly, and with it what holds the wall [N]; what swings is stopped."""
    bodies, heap = world["bodies"], world["sand"]
    for k in range(80):
        part = min(1.0, (k + 1) / 40)
        heap.gravity = (0, -G * part)
        bodies.set_forces([[push * part, 0, 0]])
        world.step()
        if k % 2:
            heap.set_velocities(0.5 * heap.velocities)
            bodies.set_velocities([[0, 0, 0]])


def coefficient(world, steps):
    """Thrust on the wall over `UNIT`, as the mean over some steps."""
    wall = world["sand"].colliders[0]
    world.advance(steps / 240)
    return -wall.impulse[0] / wall.duration / UNIT


@pytest.mark.parametrize(
    ("degrees", "poisson_ratio"),
    [(33.0, 0.3), (33.0, 0.25), (40.0, 0.25)],
)
def test_pressure_at_rest(degrees, poisson_ratio):
    """Elastic, K_0 = nu / (1 - nu), unless the cone yields before.

    With q / p = sqrt(3) sin phi (the cone that fits plane strain) that is at 1 - K = sqrt(1/3)
    sin phi (1 + 2 K). Sands are near to 1 - sin phi (Jaky, 1944), which nu = (1 - sin phi) / (2 -
    sin phi) gives where the cone does not yield before.
    """
    lean = np.sin(np.radians(degrees)) / np.sqrt(3)
    expected = max(poisson_ratio / (1 - poisson_ratio), (1 - lean) / (1 + 2 * lean))
    world = wall_and_sand(degrees, poisson_ratio)
    settle(world)
    assert coefficient(world, 24) == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_pressure_on_a_wall_that_yields_and_on_one_that_pushes():
    """tan^2(45 -+ phi / 2) (Rankine, 1857), from 1 mm outward and 1 cm inward on, of 400 mm."""
    sine = np.sin(np.radians(33.0))
    world = wall_and_sand(33.0, cells=32)
    settle(world)
    state = world.state()
    world["bodies"].set_velocities([[-0.02, 0, 0]])
    world.advance(0.1)
    assert coefficient(world, 48) == pytest.approx((1 - sine) / (1 + sine), rel=0.06)
    world.restore(state)
    world["bodies"].set_velocities([[0.06, 0, 0]])
    world.advance(0.2)
    assert coefficient(world, 72) == pytest.approx((1 + sine) / (1 - sine), rel=0.06)


@pytest.mark.parametrize(("part", "stands"), [(1.1, True), (0.75, False)])
def test_a_wall_stands_if_it_is_held_by_more_than_the_active_pressure(part, stands):
    """On a slider: of 16 cells the sand exerts 0.83 of Rankine's active thrust, of 32 0.97."""
    sine = np.sin(np.radians(33.0))
    world = wall_and_sand(33.0, motion="dynamic", mass=60.0)
    bodies = world["bodies"]
    bodies.slider(0, None, (0, 0, 0), (1, 0, 0))
    settle(world, push=0.3 / 0.7 * UNIT)
    before = bodies.positions[0, 0]
    for _ in range(72):
        bodies.set_forces([[part * (1 - sine) / (1 + sine) * UNIT, 0, 0]])
        world.step()
    way = before - bodies.positions[0, 0]
    assert abs(way) < 2e-4 if stands else way > 4e-3


def depth_of_a_ball(fall, ratio, diameter=0.1, cells=5, width=6, depth=5, stiffness=3000):
    """How deep one of `ratio` times the density of sand gets that falls by so many diameters.

    All in diameters, as width and depth of the tray; the stiffness of the sand in its weight over a
    diameter. Softer sand takes up a part of the fall elastically, which changes the powers.
    """
    d, side, deep = diameter / cells / 2, width * diameter, depth * diameter
    sand = mpm.Sand(
        density=DENSITY,
        young_modulus=stiffness * DENSITY * G * diameter,
        poisson_ratio=0.3,
        friction_angle=np.radians(30.0),
    )
    bodies = substep.RigidBodies(step=1 / 240)
    above = (0, 0, diameter / 2 + 1e-4)
    ball = bodies.add(substep.Sphere(diameter / 2), above, density=ratio * DENSITY, friction=0.5)
    bodies.set_velocities([[0, 0, -np.sqrt(2 * G * fall * diameter)]])
    tray = substep.Collider(
        substep.Box((side, side, 20), (0, 0, 10 - deep)), hollow=True, friction=0.6
    )
    bed = substep.MaterialPointMethod(
        substep.fill_box((-side / 2, -side / 2, -deep), (side / 2, side / 2, 0), d),
        sand,
        cell=2 * d,
        volume=d**3,
        colliders=[*bodies.make_colliders(ball), tray],
    )
    world = substep.World({"ball": bodies, "bed": bed})
    world.advance(0.1)
    while abs(bodies.velocities[ball, 2]) > 0.02:
        assert world.time < 0.5
        world.advance(1 / 60)
    return 0.5 - bodies.positions[ball, 2] / diameter


@pytest.mark.slow
def test_balls_sink_as_powers_of_their_drop_and_their_density():
    """d ~ (rho_b / rho_g)^(1/2) D^(2/3) H^(1/3), H the fall and the depth together.

    (Uehara et al., Phys. Rev. Lett. 90, 194301, 2003; with the energy, H^(1/4), Walsh et al., 91,
    104301.) That of D follows from that of H: the model has no other length than the one over which
    its weight would be its stiffness, and sand is as good as rigid.
    """
    near, far = (depth_of_a_ball(fall, 2.0) for fall in (0.5, 8.0))
    power = np.log(far / near) / np.log((8.0 + far) / (0.5 + near))
    assert power == pytest.approx(1 / 3, abs=0.03)
    light, heavy = (depth_of_a_ball(2.0, ratio) for ratio in (0.5, 8.0))
    drops = (2.0 + heavy) / (2.0 + light)
    assert np.log(heavy / light / drops ** (1 / 3)) / np.log(16) == pytest.approx(0.5, abs=0.03)


def drive_up(degrees, friction, cells=10, diameter=0.2, speed=0.4):
    """A cart of 25 kg on two driven discs on a slope of sand of 33 degrees, in the plane.

    Its speed over that of the rims in the second half of 1.5 s, and how deep its wheels lie then,
    in diameters.
    """
    length, height, radius = 2.4, 0.2, diameter / 2
    d = diameter / cells / 2
    sand = mpm.Sand(
        density=DENSITY,
        young_modulus=300 * DENSITY * G * height,
        poisson_ratio=0.3,
        friction_angle=np.radians(33.0),
    )
    angle = np.radians(degrees)
    gravity = -G * np.array([np.sin(angle), np.cos(angle)])
    cart = substep.RigidBodies(step=1 / 120, gravity=(*gravity, 0))
    x, y = 0.35 * length, height + radius + 1e-3
    chassis = cart.add(substep.Box((0.5, 0.06, 0.2)), (x, y + 0.05, 0), mass=20.0)
    axles = [(x - 0.2, y, 0), (x + 0.2, y, 0)]
    wheels = cart.add(substep.Sphere(radius), axles, mass=2.5, friction=friction)
    for wheel, axle in zip(wheels, axles, strict=True):
        cart.hinge(wheel, chassis, axle, (0, 0, 1), motor=substep.rigid.SpeedMotor(-speed / radius))
    bed = substep.MaterialPointMethod(
        substep.fill_box((0, 0), (length, height), d),
        sand,
        cell=2 * d,
        volume=d**2,
        gravity=gravity,
        colliders=[
            *cart.make_colliders(wheels),
            substep.Collider(substep.Plane((0, 1, 0)), friction=0.8),
            substep.Collider(substep.Plane((1, 0, 0))),
            substep.Collider(substep.Plane((-1, 0, 0), (length, 0, 0))),
        ],
    )
    world = substep.World({"cart": cart, "bed": bed})
    world.advance(0.75)
    before = cart.positions[chassis, 0]
    world.advance(0.75)
    depth = height + radius - cart.positions[wheels, 1].mean()
    return (cart.positions[chassis, 0] - before) / 0.75 / speed, depth / diameter


@pytest.mark.slow
def test_wheels_climb_slip_and_dig_in_as_friction_allows():
    """Rough ones climb up to what sand holds, with more slip and deeper the steeper it is.

    Those with a friction of 0.3 would climb 16.7 degrees on a hard slope; less here, as they push
    sand before them. With 20 cells to a wheel the first speeds are 0.95, 0.63, 0.25.
    """
    flat, gentle, steep, too_steep = (drive_up(degrees, 0.8) for degrees in (0, 10, 20, 30))
    assert 0.8 < flat[0] <= 1 and 0.55 < gentle[0] < 0.85 and 0.1 < steep[0] < 0.45
    assert too_steep[0] < -0.1
    assert flat[1] < gentle[1] < steep[1] < too_steep[1] and steep[1] > 3 * flat[1]
    assert drive_up(0, 0.3)[0] > 0.8 and abs(drive_up(15, 0.3)[0]) < 0.05
