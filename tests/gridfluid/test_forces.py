"""What a grid liquid gives obstacles at rest, wherever their faces lie in its cells of 1 m."""

import math

import numpy as np
import pytest
import substep

G, RHO = 9.81, 1000.0


def push(collider, *, sides=(14, 14), depth=12, front=None, steps=3, dt=0.02):
    """Mean force [N] in water at rest, or of a column up to `front` that breaks."""
    rows = [np.arange(0.25, end, 0.5) for end in (front or sides[0], sides[1], depth)]
    x = np.stack(np.meshgrid(*rows, indexing="ij"), -1).reshape(-1, 3)
    liquid = substep.GridLiquid(
        x[collider.distance(x) > 0],
        cell=1.0,
        bounds=((0, 0, 0), (*sides, depth + 4)),
        colliders=[collider],
        tolerance=1e-6,
    )
    force = np.zeros(3)
    for _ in range(steps):
        liquid.step(dt)
        force += collider.impulse / (steps * dt)
    return force


def box(low, high, **options):
    low, high = np.array(low, float), np.array(high, float)
    return substep.Collider(substep.Box(high - low, center=(low + high) / 2), **options)


@pytest.mark.parametrize("along", [(1, 1, 1), (0, 0, 1), (1, 0, 0)])
@pytest.mark.parametrize(("cells", "most"), [(3, 0.03), (4, 0.02), (6, 0.015), (8, 0.01)])
def test_cubes_are_lifted_by_what_they_displace(cells, most, along):
    """Archimedes: rho g V."""
    for shift in (0, 1e-6, -1e-6, 0.1, 0.2, 0.25, 0.4, 0.5, 0.75):
        low = 3 + shift * np.array(along)
        force = push(box(low, low + cells), sides=(cells + 6, cells + 6), depth=cells + 6)
        lift = force / (RHO * G * cells**3)
        assert lift[2] == pytest.approx(1, abs=most), shift
        assert np.abs(lift[:2]).max() < 1e-3, shift


@pytest.mark.parametrize("shift", [0, 0.3, 0.5])
@pytest.mark.parametrize("shape", ["ball", "capsule", 0.2, 0.5, math.pi / 4])
def test_round_and_turned_obstacles_are_lifted_by_what_they_displace(shape, shift):
    middle = (7 + shift, 7 + shift / 2, 6 + shift)
    if shape == "ball":
        obstacle, volume = substep.Collider(substep.Sphere(3.0, middle)), 36 * math.pi
    elif shape == "capsule":
        obstacle = substep.Collider(substep.Capsule(2.5, 4.0, center=middle))
        volume = math.pi * 2.5**2 * (4 + 4 / 3 * 2.5)
    else:
        obstacle, volume = substep.Collider(substep.Box((5.0, 5.0, 5.0), center=middle)), 125
        obstacle.rotation = (math.cos(shape / 2), 0, math.sin(shape / 2), 0)
    lift = push(obstacle) / (RHO * G * volume)
    assert lift[2] == pytest.approx(1, abs=0.02)
    assert np.abs(lift[:2]).max() < 0.02


@pytest.mark.parametrize("bottom", [0, -0.3, -2, 1e-6])
@pytest.mark.parametrize("shift", [0, 0.25, 0.5])
def test_a_box_on_the_floor_is_pressed_down(bottom, shift):
    """By the water above it, rho g h A: there is none under it."""
    low = np.array([5 + shift, 5 + shift, bottom])
    force = push(box(low, [*(low[:2] + 4), 5]))
    assert force[2] == pytest.approx(-RHO * G * 7 * 16, rel=0.02)
    assert np.abs(force[:2]).max() < 1e-3 * abs(force[2])


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
