"""Rigid bodies on height fields, against closed forms."""

import numpy as np
import pytest
import substep
from numpy import arctan, cos, pi, sin, sqrt, tan

G = 9.81


def field(heights, x, y, spacing):
    """Of a function over the rectangle from -x to x and -y to y."""
    along = np.arange(-x, x + spacing / 2, spacing)
    across = np.arange(-y, y + spacing / 2, spacing)
    return substep.HeightField(
        heights(along[:, None], across) + 0 * (along[:, None] + across),
        spacing,
        (along[0], across[0], 0.0),
    )


def on(ground, friction=0.8, **options):
    bodies = substep.RigidBodies(sleeping=False, **options)
    bodies.add(ground, (0, 0, 0), motion="static", friction=friction)
    return bodies


@pytest.mark.parametrize("heading", [0.0, 0.5, pi / 4, 3 * pi / 4])
@pytest.mark.parametrize("radius", [0.03, 0.4])
def test_a_ball_rolls_down_at_five_sevenths_and_nothing_catches_it(heading, radius):
    angle = 0.3
    way = np.array([cos(heading), sin(heading)])
    ground = field(lambda x, y: -tan(angle) * (x * way[0] + y * way[1]), 6, 6, 0.1)
    bodies = on(ground)
    normal = np.array([*(sin(angle) * way), cos(angle)])
    start = np.array([*(-3 * way), 3 * tan(angle)]) + radius * normal
    k = bodies.add(substep.Sphere(radius), start, friction=0.8)
    energy = bodies.diagnostics()["energy"]
    lost = []
    while bodies.time < 1.6 - 1e-9:
        bodies.step()
        lost.append(energy - bodies.diagnostics()["energy"])
    down = np.array([*(cos(angle) * way), -sin(angle)])
    s = (bodies.positions[k] - start) @ down
    expected = 5 / 7 * G * sin(angle) * bodies.time**2 / 2
    assert s == pytest.approx(expected, rel=0.01)
    assert np.abs(bodies.positions[k] - start - s * down).max() < 2e-3  # straight, on the ground
    fallen = bodies.masses[k] * G * s * sin(angle)
    assert np.abs(lost).max() < 0.01 * fallen


@pytest.mark.parametrize("offset, rests", [(-0.01, True), (0.01, False)])
def test_a_box_rests_up_to_the_friction_angle(offset, rests):
    friction = 0.5
    angle = arctan(friction) + offset
    bodies = on(field(lambda x, y: -tan(angle) * x, 3, 2, 0.07), friction)
    turn = (cos(angle / 2), 0, sin(angle / 2), 0)
    start = 0.0501 * np.array([sin(angle), 0, cos(angle)])
    k = bodies.add(substep.Box((0.4, 0.3, 0.1)), start, turn, friction=friction)
    bodies.advance(2.0)
    moved = np.linalg.norm(bodies.positions[k] - start)
    slide = G * (sin(angle) - friction * cos(angle)) * 2.0**2 / 2
    assert moved < 2e-3 if rests else moved == pytest.approx(slide, rel=0.05)


@pytest.mark.parametrize("spacing", [0.02, 0.05])
def test_a_ball_in_a_parabolic_bowl_has_its_period(spacing):
    """Rolling, its centre on a curve of radius 1 / c - R: T = 2 pi sqrt(7 (1 / c - R) / (5 g))."""
    c, radius, swing = 0.5, 0.1, 0.15
    bodies = on(field(lambda x, y: c * (x**2 + y**2) / 2, 1, 1, spacing), step=1 / 240)
    start = (swing, 0, c * swing**2 / 2 + radius)
    k = bodies.add(substep.Sphere(radius), start, friction=0.8)
    t, x = [], []
    while bodies.time < 12:
        bodies.step()
        t.append(bodies.time)
        x.append(bodies.positions[k])
    t, x = np.array(t), np.array(x)
    i = np.flatnonzero((x[:-1, 0] > 0) & (x[1:, 0] <= 0))
    crossings = t[i] + x[i, 0] / (x[i, 0] - x[i + 1, 0]) * (t[i + 1] - t[i])
    period = 2 * pi * sqrt(7 * (1 / c - radius) / (5 * G))
    assert np.diff(crossings).mean() == pytest.approx(period, rel=0.01)
    assert x[-800:, 0].max() > 0.9 * swing
    assert np.abs(x[:, 1]).max() < 0.01 * swing


def test_the_sides_are_walls_and_beyond_them_is_nothing():
    bodies = on(field(lambda x, y: 0 * x + 1.0, 1, 1, 0.25))
    wall = bodies.add(substep.Sphere(0.1), (-2, 0, 0.5), velocities=(4, 0, 0))
    edge = bodies.add(substep.Sphere(0.1), (0, 0, 1.1), velocities=(4, 0, 0))
    bodies.gravity = (0, 0, 0)
    bodies.advance(0.5)
    assert bodies.positions[wall, 0] == pytest.approx(-1.1, abs=0.02)
    bodies.gravity = (0, 0, -G)
    bodies.advance(0.5)
    assert bodies.positions[edge, 0] > 1.1 and bodies.positions[edge, 2] < 0.5


def test_a_fast_body_does_not_pass():
    bodies = on(field(lambda x, y: 0.1 * sin(3 * x) * cos(2 * y), 2, 2, 0.1))
    shots = bodies.add(
        substep.Sphere(0.02),
        [[0.3 * i, 0.2 * i, 5] for i in range(-5, 6)],
        velocities=(0, 0, -300),
    )
    bodies.advance(0.1)
    assert (bodies.positions[shots, 2] > -0.1).all()


def test_rays_and_casts_meet_the_triangles():
    bodies = on(field(lambda x, y: 0.2 * x, 2, 2, 0.5))
    hits = bodies.ray_cast([[0.3, 0.1, 3], [5, 0, 3], [-4, 0, -1]], [[0, 0, -1]] * 2 + [[1, 0, 0]])
    assert hits.bodies.tolist() == [0, -1, 0]
    np.testing.assert_allclose(hits.distances[[0, 2]], [3 - 0.06, 2])


def test_same_bits_for_any_number_of_threads_and_through_a_checkpoint():
    def world(threads):
        bodies = on(field(lambda x, y: 0.2 * sin(3 * x) * cos(2 * y), 2, 2, 0.1), threads=threads)
        random = np.random.default_rng(0)
        x = random.uniform((-1, -1, 0.4), (1, 1, 1.5), (60, 3))
        bodies.add(substep.Box((0.2, 0.15, 0.1)), x[:30], friction=0.5)
        bodies.add(substep.Sphere(0.08), x[30:], friction=0.5)
        return bodies

    one = world(1)
    one.advance(0.5)
    state = one.state()
    one.advance(0.5)
    two, three = world(2), world(3)
    two.restore(state)
    two.advance(0.5)
    three.advance(1.0)
    assert one.positions.tobytes() == two.positions.tobytes() == three.positions.tobytes()
