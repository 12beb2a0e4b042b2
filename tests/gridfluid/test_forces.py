"""What a grid liquid gives obstacles, wherever their faces lie in its cells of 1 m."""

import math

import numpy as np
import pytest
import substep

G, RHO = 9.81, 1000.0


def water(collider, *, sides=(14, 14), depth=12, front=None, **options):
    """At rest, or a column up to `front` that is about to break."""
    rows = [np.arange(0.25, end, 0.5) for end in (front or sides[0], *sides[1:], depth)]
    x = np.stack(np.meshgrid(*rows, indexing="ij"), -1).reshape(-1, len(rows))
    room = collider.distance(np.c_[x, np.zeros((len(x), 3 - len(rows)))]) > 0
    return substep.GridLiquid(
        x[room],
        cell=1.0,
        bounds=((0,) * len(rows), (*sides, depth + 4)),
        colliders=[collider],
        tolerance=1e-6,
        **options,
    )


def push(collider, *, steps=3, dt=0.02, **options):
    """Mean force [N]."""
    liquid = water(collider, **options)
    force = np.zeros(3)
    for _ in range(steps):
        liquid.step(dt)
        force += collider.impulse / (steps * dt)
    return force


def box(low, high, **options):
    low, high = np.array(low, float), np.array(high, float)
    return substep.Collider(substep.Box(high - low, center=(low + high) / 2), **options)


SHIFTS = (0, 1e-6, -1e-6, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("along", [(1, 1, 1), (0, 0, 1), (1, 0, 0)])
@pytest.mark.parametrize(("cells", "most"), [(3, 0.03), (4, 0.02), (6, 0.015), (8, 0.01)])
def test_cubes_are_lifted_by_what_they_displace(cells, most, along, dtype):
    """Archimedes: rho g V."""
    for shift in SHIFTS if cells < 6 else SHIFTS[::3]:
        low = 3 + shift * np.array(along)
        force = push(
            box(low, low + cells), sides=(cells + 6, cells + 6), depth=cells + 6, dtype=dtype
        )
        lift = force / (RHO * G * cells**3)
        assert lift[2] == pytest.approx(1, abs=most), shift
        assert np.abs(lift[:2]).max() < 1e-3, shift


@pytest.mark.parametrize(("radius", "most"), [(1.4, 0.04), (2.2, 0.008), (3.2, 0.004), (6, 0.003)])
def test_balls_are_lifted_by_what_they_displace(radius, most):
    middle = math.ceil(radius) + 4
    for shift in (0, 0.2, 0.45, 0.7, 0.9):
        ball = substep.Sphere(radius, center=(middle + shift, middle + 0.3 + shift / 2, middle))
        side = 2 * middle + 1
        force = push(substep.Collider(ball), sides=(side, side), depth=side)
        lift = force / (RHO * G * 4 / 3 * math.pi * radius**3)
        assert lift[2] == pytest.approx(1, abs=most), shift
        assert np.abs(lift[:2]).max() < 5e-3, shift


@pytest.mark.parametrize("along", [(1, 1), (0, 1), (1, 0)])
@pytest.mark.parametrize("cells", [3, 8])
def test_squares_are_lifted_by_what_they_displace(cells, along):
    for shift in SHIFTS:
        low = np.array([3, 3, -0.5]) + shift * np.array([*along, 0])
        obstacle = box(low, low + np.array([cells, cells, 1]))
        lift = push(obstacle, sides=(cells + 6,), depth=cells + 6) / (RHO * G * cells**2)
        assert lift[1] == pytest.approx(1, abs=0.01), shift
        assert abs(lift[0]) < 1e-3, shift


@pytest.mark.parametrize("shift", [0, 0.3, 0.5])
@pytest.mark.parametrize("angle", [0.2, 0.5, math.pi / 4])
def test_turned_boxes_are_lifted_by_what_they_displace(angle, shift):
    obstacle = substep.Collider(
        substep.Box((5, 5, 5), center=(7 + shift, 7 + shift / 2, 6 + shift))
    )
    obstacle.rotation = (math.cos(angle / 2), 0, math.sin(angle / 2), 0)
    lift = push(obstacle) / (RHO * G * 125)
    assert lift[2] == pytest.approx(1, abs=0.02)
    assert np.abs(lift[:2]).max() < 0.02


@pytest.mark.parametrize("bottom", [0, -0.3, -2, 1e-6])
@pytest.mark.parametrize("shift", [0, 0.1, 0.25, 0.3, 0.5, 0.9])
def test_a_box_on_the_floor_is_pressed_down(bottom, shift):
    """By the water above it, rho g h A: there is none under it."""
    low = np.array([5 + shift, 5 + shift, bottom])
    force = push(box(low, [*(low[:2] + 4), 5]))
    assert force[2] == pytest.approx(-RHO * G * 7 * 16, rel=0.02)
    assert np.abs(force[:2]).max() < 1e-3 * abs(force[2])


@pytest.mark.parametrize("cells", [2, 8])
@pytest.mark.parametrize("shift", [0, 0.2, 0.7])
def test_boxes_of_any_size_on_the_floor_are_pressed_down(cells, shift):
    low = np.array([4 + shift, 4 + shift / 2, 0])
    force = push(box(low, low + cells), sides=(cells + 8, cells + 8), depth=cells + 8)
    assert force[2] == pytest.approx(-RHO * G * 8 * cells**2, rel=0.02)


@pytest.mark.parametrize("shift", [0, 0.1, 0.3, 0.5])
def test_a_box_at_a_wall_is_pressed_to_it(shift):
    """By rho g h A with the depth h of its middle, and lifted by rho g V."""
    low = np.array([0, 5 + shift, 3 + shift])
    force = push(box(low, low + 4)) / (RHO * G * 16)
    assert force == pytest.approx([-(12 - 5 - shift), 0, 4], abs=0.1)


@pytest.mark.parametrize("shape", ["ball", "block"])
def test_what_touches_the_floor_with_an_edge_is_lifted(shape):
    """There is water under a ball, and beside the edge of a block that stands on it."""
    if shape == "ball":
        obstacle = substep.Collider(substep.Sphere(4, (7, 7, 4)))
        volume = 4 / 3 * math.pi * 64
    else:
        obstacle = substep.Collider(substep.Box((4, 6, 4), center=(7, 7, 2 * math.sqrt(2))))
        obstacle.rotation = (math.cos(math.pi / 8), 0, math.sin(math.pi / 8), 0)
        volume = 96
    assert push(obstacle)[2] == pytest.approx(RHO * G * volume, rel=0.06)


@pytest.mark.parametrize(("cells", "most"), [(4, 2e-3), (8, 5e-4)])
@pytest.mark.parametrize("depth", [16, 36])
def test_still_water_does_not_turn_cubes(depth, cells, most):
    """However deep they are, and wherever their faces lie."""
    for shift in SHIFTS:
        cube = box([3 + shift] * 3, [3 + shift + cells] * 3)
        liquid = water(cube, sides=(cells + 6, cells + 6), depth=depth)
        liquid.step(0.02)
        assert np.abs(cube.angular_impulse).max() < most * RHO * G * cells**4 * 0.02, shift


@pytest.mark.parametrize("velocity", [(0, 0, 0), (1, 2, 0.5)])
def test_water_does_not_turn_balls(velocity):
    """Which are pushed to their middle."""
    ball = substep.Collider(substep.Sphere(2.6, (6.3, 7.1, 5.7)), velocity=velocity)
    liquid = water(ball)
    for _ in range(3):
        liquid.step(0.02)
        assert np.linalg.norm(ball.impulse) > 0
        assert not ball.angular_impulse.any()


@pytest.mark.parametrize("face", [1, 1.1, 1.25, 1.5, 1.75])
def test_a_plate_on_a_wall_bears_half_the_pressure_of_the_bottom(face):
    """rho g h^2 / 2 on each metre of its width."""
    force = push(box([-1, -1, -1], [face, 15, 17]))
    assert force[0] == pytest.approx(-RHO * G * 12**2 / 2 * 14, rel=0.02)


@pytest.mark.parametrize("shift", [0, 1e-6, 0.25, 0.5])
@pytest.mark.parametrize("cells", [4, 8])
def test_a_dam_break_pushes_a_box_in_the_middle_forwards_alone(cells, shift):
    obstacle = box([20, 8 - cells / 2 + shift, -8], [20 + cells, 8 + cells / 2 + shift, 8])
    force = push(obstacle, sides=(36, 16), front=12, steps=70, dt=0.06)
    assert abs(force[1]) < 0.05 * force[0]


def behave_as(collider, mass):
    """Lets a collider stand for a body, of no mobility where the mass is infinite."""
    mobility = np.diag([1 / mass] * 3 + [1 / mass] * 3)
    collider._native.set_body(0, [0.0] * 3, mobility.ravel().tolist(), [0.0] * 6)


@pytest.mark.parametrize("viscosity", [0, 0.1])
def test_what_moves_as_it_is_told_is_pushed_alike(viscosity):
    """Obstacles, and animated surfaces, which are bodies of no mobility: the same bits."""
    given = []
    for animated in (False, True):
        piston = box([-4, -1, -1], [2.3, 9, 17])
        if animated:
            behave_as(piston, math.inf)
        piston.velocity = (0.5, 0, 0)
        liquid = water(piston, sides=(12, 8), depth=8, viscosity=viscosity)
        for _ in range(3):
            liquid.step(0.05)
        given.append(piston.impulse)
    assert np.array_equal(*given)


@pytest.mark.parametrize("bottom", [6.0, 6.25, 6.5, 6.75])
@pytest.mark.parametrize("shift", [0, 0.3])
def test_what_floats_is_lifted_by_what_it_displaces(bottom, shift):
    """Held or as heavy as a mountain: rho g times the part of it that is in the water."""
    lifts = []
    for mass in (None, 1e12):
        low = np.array([4 + shift, 4 + shift, bottom])
        floating = box(low, low + 5)
        if mass:
            behave_as(floating, mass)
        liquid = water(floating, sides=(13, 13), depth=10)
        liquid.step(0.02)
        lifts.append(floating.impulse[2] / (0.02 * RHO * G * 25 * (10 - bottom)))
    assert lifts == pytest.approx([1, 1], abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("bottom", [1, 4])
def test_a_box_that_is_pushed_into_a_tank_lifts_the_level(bottom):
    """By its volume, and is lifted by its weight in water: a cell above the floor, or half out."""
    speed, side, depth = 0.4, 8, 10
    pushed = box([6, 6, depth + 0.4], [6 + side, 6 + side, depth + 0.4 + side])
    pushed.velocity = (0, 0, -speed)
    liquid = water(pushed, sides=(20, 20), depth=depth)
    liquid.advance((depth + 0.4 - bottom) / speed)
    pushed.velocity = (0, 0, 0)
    liquid.advance(6)
    level = min((400 * depth - side**2 * bottom) / (400 - side**2), depth + side**3 / 400)
    displaced = side**2 * min(level - bottom, side)
    lift = pushed.impulse / (pushed.duration * RHO * G * displaced)
    beside = np.stack(np.meshgrid([2.0, 4.0, 16.0, 18.0], np.linspace(2, 18, 9)), -1).reshape(-1, 2)
    assert liquid.depth(beside).mean() == pytest.approx(level, rel=0.03)
    assert lift[2] == pytest.approx(1, abs=0.03)
    assert np.abs(lift[:2]).max() < 0.02


def test_bits_do_not_depend_on_threads():
    found = []
    for threads in (1, 2, 3):
        turned = box([5.2, 5.1, 4.7], [9, 8.8, 12.3])
        turned.rotation, turned.velocity = (0.9, 0.1, 0.3, 0.2), (0.5, 0, -1)
        liquid = water(turned, threads=threads)
        for _ in range(3):
            liquid.step(0.05)
        found.append(np.concatenate([turned.impulse, turned.angular_impulse]).tobytes())
    assert found[0] == found[1] == found[2]
