"""Obstacles along keyframes, and meshes that are scaled, turned and moved."""

import math

import numpy as np
import pytest
import substep
from substep import InputError, geometry
from substep.geometry import Keyframes, follow_keyframes

HALF = math.sqrt(0.5)


def water(collider):
    """Some drops far from the obstacle."""
    x = substep.fill_box((5, 5, 5), (5.2, 5.2, 5.2), 0.05)
    return substep.PositionBasedFluid(x, 0.05, colliders=[collider], gravity=(0, 0, 0))


def test_an_obstacle_is_where_its_keyframes_say():
    path = Keyframes(
        [0, 0.5, 1.25],
        [(0, 0, 0), (0.1, 0.2, 0), (0.1, 0, -0.3)],
        [(1, 0, 0, 0), (HALF, 0, 0, HALF), (0.5, 0.5, 0.5, 0.5)],
    )
    plate = substep.Collider(substep.Box((0.3, 0.2, 0.1)))
    liquid = water(plate)
    for duration in (0.2, 0.3, 0.33, 0.42, 0.5):
        follow_keyframes(liquid, duration, [(plate, path)])
        position, rotation = path.at(liquid.time)
        np.testing.assert_allclose(plate.position, position, atol=1e-9)
        assert abs(plate.rotation @ rotation) == pytest.approx(1, abs=1e-9)
        if liquid.time < 1.2:
            assert np.linalg.norm(plate.velocity) > 0.1
    assert liquid.time == pytest.approx(1.75)
    assert not plate.velocity.any() and not plate.angular_velocity.any()


def test_turns_go_the_shorter_way_at_a_constant_rate():
    path = Keyframes([0, 2], [(0, 0, 0)] * 2, [(1, 0, 0, 0), (-HALF, 0, -HALF, 0)])
    wheel = substep.Collider(substep.Cylinder(0.2, 0.1))
    liquid = water(wheel)
    for k in range(1, 5):
        follow_keyframes(liquid, 0.5, [(wheel, path)])
        turned = 2 * math.atan2(*abs(wheel.rotation[[2, 0]]))
        assert turned == pytest.approx(math.pi / 8 * k, abs=1e-9)
    assert len(Keyframes([0], [(1, 2, 3)]).at(7.0)[0]) == 3


def test_a_piston_raises_the_water_above_it():
    """The work of a floor that is lifted is the potential energy gained, within the splash."""
    tank = substep.Collider(substep.Box((0.4, 0.4, 4), (0.2, 0.2, 1)), hollow=True)
    floor = substep.Collider(substep.Box((0.6, 0.6, 0.2), (0.2, 0.2, -0.1)))
    path = Keyframes([0, 2], [(0.2, 0.2, -0.1), (0.2, 0.2, 0.1)])
    x = substep.fill_box((0, 0, 0), (0.4, 0.4, 0.4), 0.05)
    liquid = substep.PositionBasedFluid(x, 0.05, colliders=[tank, floor])
    before = liquid.positions[:, 2].mean()
    follow_keyframes(liquid, 3.0, [(floor, path)])
    assert liquid.positions[:, 2].mean() - before == pytest.approx(0.2, abs=0.01)
    assert np.abs(liquid.velocities).mean() < 0.1


@pytest.mark.parametrize(
    ("times", "positions", "rotations", "told"),
    [
        ([1, 2], [(0, 0, 0)] * 2, None, "times: expected ascending ones from 0"),
        ([0, 0], [(0, 0, 0)] * 2, None, "times: expected ascending ones from 0"),
        ([0, 1, 1 + 1e-9], [(0, 0, 0)] * 3, None, "times: expected .* apart by more than 2e-9"),
        ([0, 1e6, 1e6 + 1e-3], [(0, 0, 0)] * 3, None, "times: expected .* apart by more"),
        ([], np.zeros((0, 3)), None, "times"),
        ([0, 1], [(0, 0, 0)], None, "positions: expected shape"),
        ([0, 1], [(0, 0, 0), (0, 0, np.nan)], None, "positions"),
        ([0, 1], [(0, 0, 0)] * 2, [(1, 0, 0, 0), (0, 0, 0, 0)], "rotations"),
    ],
)
def test_wrong_keyframes_are_refused(times, positions, rotations, told):
    with pytest.raises(InputError, match=told):
        Keyframes(times, positions, rotations)


def test_wrong_paths_are_refused_and_nothing_moves():
    plate = substep.Collider(substep.Box((1, 1, 1)))
    liquid, path = water(plate), Keyframes([0, 1], [(1, 0, 0)] * 2)
    for wrong in ([plate], [(plate, plate)], [(path, plate)], plate):
        with pytest.raises(TypeError, match="paths"):
            follow_keyframes(liquid, 1.0, wrong)
    with pytest.raises(InputError, match="duration"):
        follow_keyframes(liquid, -1.0, [(plate, path)])
    with pytest.raises(InputError, match=r"paths\[0\]: expected an obstacle at its first keyframe"):
        follow_keyframes(liquid, 1.0, [(plate, path)])
    still, turned = (
        Keyframes([0, 1], [(0, 0, 0)] * 2, [q, (1, 0, 0, 0)])
        for q in ((-1, 0, 0, 0), (HALF, 0, 0, HALF))
    )
    other = substep.Collider(substep.Box((1, 1, 1)))
    for wrong, told in (
        ([(plate, turned)], r"paths\[0\]: expected an obstacle turned as in its first keyframe"),
        ([(plate, still), (other, still)], r"paths\[1\]: expected an obstacle of the simulation"),
        ([(plate, still), (plate, still)], r"paths\[1\]: its obstacle has a path already"),
    ):
        with pytest.raises(InputError, match=told):
            follow_keyframes(liquid, 1.0, wrong)
    with pytest.raises(InputError, match="time: expected a finite number"):
        path.next(math.nan)
    assert liquid.time == 0 and not plate.position.any()


def test_a_mesh_in_millimetres_stands_up():
    box = geometry.box_mesh((10, 30, 20))
    placed = geometry.transform_mesh(
        box, up="y", scale=1e-3, rotation=(HALF, 0, 0, HALF), translation=(1, 2, 3)
    )
    sides = np.ptp(placed.vertices, axis=0)
    np.testing.assert_allclose(sides, [0.01, 0.02, 0.03], atol=1e-12)  # y is z, then 90 degrees
    np.testing.assert_allclose(placed.vertices.mean(axis=0), [1, 2, 3], atol=1e-12)
    assert placed.volume == pytest.approx(box.volume * 1e-9)  # not inside out
    solid = geometry.box_tetrahedra((1, 2, 3), (1, 1, 1))
    assert geometry.transform_mesh(solid, up="x", scale=2).volumes.sum() == pytest.approx(48)
    for wrong in ({"up": "w"}, {"scale": 0}, {"scale": -1}, {"translation": (0, 0)}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            geometry.transform_mesh(box, **wrong)
    with pytest.raises(TypeError, match="mesh"):
        geometry.transform_mesh(box.vertices)
