"""What a liquid says of starts that cannot be meant, and that it is silent of all others."""

import warnings

import numpy as np
import pytest
import substep

D = 0.05
BLOCK = substep.fill_box((0, 0, 0), (0.4, 0.4, 0.4), spacing=D)
FLAT = BLOCK[:64, 1:]
TANK = substep.Box((1, 1, 1), (0.5, 0.5, 0.5))


def start(x, spacing=D, **options):
    return substep.PositionBasedFluid(x, spacing, **options)


@pytest.mark.parametrize("x", [BLOCK, FLAT], ids=["3D", "2D"])
@pytest.mark.parametrize("kernel", ["cubic_spline", "poly6_spiky"])
def test_overlapping_blocks_and_spacings_ten_times_off(x, kernel):
    with pytest.warns(substep.StartWarning, match=r"of \d+ particles are too close.* at [12]\."):
        start(np.concatenate([x, x]), kernel=kernel)
    with pytest.warns(substep.StartWarning, match=r"too close to others.* is spacing = 0\.5 m"):
        start(x, 10 * D, kernel=kernel)
    with pytest.warns(substep.StartWarning, match="most particles have no other within"):
        start(x, D / 10, kernel=kernel)


def test_a_part_that_overlaps_is_enough():
    part = np.concatenate([BLOCK, BLOCK[:50]])
    with pytest.warns(substep.StartWarning, match=r"50 of 562 .*too close.*positions\[9\]"):
        start(part)


@pytest.mark.parametrize("dimension", [2, 3])
def test_inside_of_an_obstacle_and_outside_of_a_tank(dimension):
    x = BLOCK if dimension == 3 else FLAT
    obstacle = substep.Box((1, 1, 0.5) if dimension == 3 else (1, 0.5, 1))
    message = r"inside colliders\[1\] by more than a spacing, positions\[\d+\] by 0\.\d+ m"
    with pytest.warns(substep.StartWarning, match=message):
        start(x, colliders=[substep.Plane((1, 0, 0)), obstacle])
    small = substep.Collider(substep.Box((0.4, 0.4, 0.4), (0.2, 0.1, 0)), hollow=True)
    with pytest.warns(substep.StartWarning, match=r"outside of colliders\[0\] by more than"):
        start(x, colliders=[small])


@pytest.mark.parametrize("x", [BLOCK, FLAT], ids=["3D", "2D"])
def test_lattices_that_are_a_little_too_dense_or_begin_on_walls(x):
    with pytest.warns(substep.StartWarning, match=r"positions\[\d+\] at 1\.1\d* times"):
        start(0.95 * x)
    corner = x - D / 2  # a lattice of np.arange(8) * D
    floor = substep.Plane((0, 0, 1)) if x.shape[1] == 3 else substep.Plane((0, 1, 0))
    with pytest.warns(substep.StartWarning, match="are they half of it from walls"):
        start(corner, colliders=[floor, substep.Plane((1, 0, 0))])


def test_a_forgotten_hollow_is_named():
    with pytest.warns(substep.StartWarning) as caught:
        start(BLOCK, colliders=[TANK])
    assert "hollow=True" in str(caught[0].message)


def test_the_warning_points_at_the_line_of_the_user():
    with pytest.warns(substep.StartWarning) as caught:
        substep.PositionBasedFluid(BLOCK, 10 * D)
    assert [warning.filename for warning in caught] == [__file__]


def test_other_starts_say_nothing():
    tank = substep.Collider(TANK, hollow=True)
    rng = np.random.default_rng(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        start(BLOCK, colliders=[tank])
        start(BLOCK + rng.normal(0, 0.1 * D, BLOCK.shape), colliders=[substep.Plane()])
        start(np.concatenate([BLOCK, BLOCK[:1]]))  # one that falls together with another
        start(BLOCK[::101])  # a few drops
        start(BLOCK[:0])
        start(BLOCK - (0, 0, 0.04), colliders=[substep.Plane()])  # within a spacing
        liquid = start(BLOCK)
        liquid.add(BLOCK)  # looked at in no case
        substep.relax(rng.uniform(0, 1, (1000, 3)), 0.1)
        ball = substep.Collider(substep.Sphere(0.2, (0.3, 0.3, 0.3)))
        substep.relax([[0.3, 0.3, 0.3], [0.6, 0.6, 0.6]], D, colliders=[ball])
    assert len(liquid) == 2 * len(BLOCK)
