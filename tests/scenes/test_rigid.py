"""The scenes of rigid bodies show what they should."""

from types import SimpleNamespace

import numpy as np
import pytest
import substep
from substep import rigid, scenes


def run(name, tmp_path, frames=6, **parameters):
    return scenes.run(scenes.load(name), parameters, tmp_path, frames=frames)


def built(name, seed=0, **parameters):
    scene = scenes.load(name)
    return scene.build(scene.complete(scene.check(parameters)), seed)


def test_surfaces_are_where_the_bodies_are(tmp_path):
    outcome = run("pile", tmp_path, bodies=30, duration=0.5, shapes="boxes", frames=3)
    with substep.Recording(outcome.recording) as recording:
        assert recording.parts["bodies"].kind == "bodies"
        assert {"pile", "wall0", "wall3"} <= set(recording.parts)
        corners = rigid.Box((0.2, 0.2, 0.2)).mesh().vertices
        for k in range(3):
            frame = recording.frame(k)
            x, q = frame["bodies"]["points"], frame["bodies"]["orientation"]
            points = frame["pile"]["points"].reshape(30, 8, 3)
            assert points.dtype == np.float32 and frame["pile"]["dye"].dtype == np.uint8
            w, a, b, c = q.T
            turn = np.array(
                [
                    [1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)],
                    [2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)],
                    [2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)],
                ]
            )
            expected = x[:, None] + np.einsum("ijn,kj->nki", turn, corners)
            np.testing.assert_allclose(points, expected, atol=1e-6)
            dye = frame["pile"]["dye"].reshape(30, 8)
            assert (dye == dye[:, :1]).all() and len(np.unique(dye)) > 15


class TestBoxStack:
    def test_it_stands(self):
        stack = built("box-stack", boxes=10, speed=0.0)
        stack.advance(3.0)
        assert stack.measured["drift"][0] < 1e-6
        assert 0 <= stack.measured["sinking"][0] < 5e-3
        assert stack.words().startswith("after 3 s, drift of the boxes ")
        assert "ball" not in stack.words()

    def test_the_ball_is_thrown_and_hits(self):
        stack = built("box-stack", boxes=6, side=0.5, stand=0.5, speed=12.0, radius=0.4)
        start = stack.positions[stack.thrown[0]]
        stack.advance(0.5)
        np.testing.assert_array_equal(stack.positions[stack.thrown[0]], start)
        measured = {name: values.copy() for name, values in stack.measured.items()}
        assert measured["drift"][0] < 1e-6
        stack.advance(1.1)
        np.testing.assert_allclose(stack.positions[stack.boxes], stack.start, atol=5e-3)
        np.testing.assert_allclose(
            stack.positions[stack.thrown[0]], [-1.2, 0, 2.1 + 0.5 * 9.81 * 1.1 * 0.1], atol=0.03
        )
        stack.advance(1.5)
        assert np.abs(stack.positions[stack.boxes] - stack.start).max() > 0.5
        assert stack.measured == measured  # from before it was thrown
        assert "; the ball brought " in stack.words()


class TestPyramid:
    def test_it_stands_and_the_ball_breaks_it(self):
        pyramid = built("pyramid", rows=6, stand=1.5, radius=0.8, speed=25.0)
        assert len(pyramid.boxes) == 21
        pyramid.advance(4.2)
        assert pyramid.measured["drift"][0] < 1e-3
        away = np.abs(pyramid.positions[pyramid.boxes] - pyramid.start).max(axis=1)
        assert (away > 0.5).sum() > 5

    @pytest.mark.slow
    def test_210_boxes_stand_still(self):
        """They settle within a second, as impacts of 20 rows are not solved to the end."""
        pyramid = built("pyramid", speed=0.0)
        pyramid.advance(1.0)
        settled = pyramid.positions[pyramid.boxes]
        pyramid.advance(4.0)
        assert np.abs(pyramid.positions[pyramid.boxes] - settled).max() < 5e-4
        assert pyramid.measured["drift"][0] < 9e-3  # Box3D's
        assert 0 < pyramid.measured["sinking"][0] < 5e-3


class TestCardHouse:
    @pytest.mark.parametrize("angle", [65.0, 75.0])
    def test_it_stands(self, angle):
        house = built("card-house", levels=3, angle=angle, speed=0.0)
        assert len(house.boxes) == 15 and house.start[:, 2].min() > 0
        house.advance(2.0)
        assert house.measured["drift"][0] < 2e-4
        assert house.words().startswith("after 2 s, drift of the cards ")

    def test_each_card_lies_on_others(self):
        house = built("card-house", levels=3, speed=0.0)
        house.advance(1.0)
        weight = 9.81 * house.masses[house.boxes].sum()
        force = house.contact_force(0)
        np.testing.assert_allclose(force, [0, 0, -weight], atol=1e-3 * weight)

    def test_the_ball_brings_it_down(self):
        house = built("card-house", levels=3, stand=0.25)
        house.advance(3.0)
        assert house.measured["drift"][0] < 1e-4
        assert house.words().endswith("; the ball brought 15 of 15 down")

    def test_the_ball_comes_from_near_and_the_picture_shows_the_fall(self):
        house = built("card-house", stand=0.1)
        ball = house.rows(house.thrown)
        far = np.linalg.norm(house.positions[ball] - house.start.mean(axis=0))
        assert 1.5 < far < 2.5
        scene = scenes.load("card-house")
        parameters = scene.complete({"stand": 0.1})
        still = scene.still(SimpleNamespace(parameters=parameters))
        moved = []
        for duration in (still - 0.3, 0.3):
            house.advance(duration)
            moved.append(np.linalg.norm(house.positions[house.boxes] - house.start, axis=1).max())
        assert moved[0] < 1e-4 and 0.05 < moved[1] < 0.5


class TestRagdolls:
    def test_they_hold_together_and_come_down(self):
        dolls = built("ragdolls", dolls=4)
        assert len(dolls.joints) == 4 * 13 and dolls.masses[-1] == 1.5
        assert dolls.diagnostics()["joint_error"] < 1e-12  # they are put together without gaps
        start = dolls.positions[dolls.motions == "dynamic"]
        dolls.advance(4.0)
        last = dolls.positions[dolls.motions == "dynamic"]
        assert last[:, 2].min() > 0.03  # a foot's radius is 0.04
        assert last[:, 2].mean() < start[:, 2].mean() - 2 and np.isfinite(last).all()
        assert dolls.measured["joint_error"][0] < 0.2  # of a foot for a moment
        assert dolls.diagnostics()["joint_error"] < 1e-6
        assert np.linalg.norm(dolls.velocities, axis=1).mean() < 0.2
        assert dolls.words().startswith("4 ragdolls, joints off by at most ")

    def test_limits_hold(self):
        dolls = built("ragdolls", dolls=2)
        dolls.advance(1.0)
        beyond = 0.0

        def look(dolls):
            nonlocal beyond
            for joint in dolls.joints:
                lower, upper = joint.limits
                beyond = max(beyond, lower - joint.coordinate, joint.coordinate - upper)

        dolls.advance(2.0, look)
        assert beyond < 0.05

    def test_the_seed_turns_the_dolls(self):
        one, other, third = (built("ragdolls", seed, dolls=2) for seed in (1, 1, 2))
        np.testing.assert_array_equal(one.rotations, other.rotations)
        assert not np.array_equal(one.rotations, third.rotations)


class TestPile:
    @pytest.mark.parametrize("shapes", ["mixed", "boxes", "hulls"])
    def test_nothing_leaves_the_bin(self, shapes, tmp_path):
        outcome = run("pile", tmp_path, bodies=120, shapes=shapes, duration=2.0, frames=9)
        assert outcome.summary.startswith("120 bodies, ")
        with substep.Recording(outcome.recording) as recording:
            half = np.abs(recording.parts["wall0"].points).max(axis=0)[0]
            for k in range(9):
                points = recording["pile"].points(k)
                assert np.abs(points[:, :2]).max() < half + 0.02 and points[:, 2].min() > -0.02
            first, last = (recording["bodies"].points(k) for k in (0, -1))
        assert last[:, 2].max() < 0.8 * first[:, 2].max()
        assert np.ptp(last[:, 0]) > np.ptp(first[:, 0])

    def test_the_seed_places_the_bodies(self):
        one, other, third = (built("pile", seed, bodies=20) for seed in (1, 1, 2))
        np.testing.assert_array_equal(one.rotations, other.rotations)
        assert not np.array_equal(one.rotations, third.rotations)


class TestDominoes:
    @pytest.mark.parametrize("path", ["line", "spiral"])
    def test_they_fall_one_after_the_other(self, path):
        scene = built("dominoes", dominoes=30, path=path)
        x = scene.positions[scene.dominoes]
        gaps = np.linalg.norm(np.diff(x[1:], axis=0), axis=1)
        np.testing.assert_allclose(gaps, 0.1, rtol=1e-12 if path == "line" else 5e-3)
        scene.advance(4.0)
        fell = scene.measured["fell"]
        assert np.isfinite(fell).all() and (np.diff(fell) > 0).all()
        assert scene.words().startswith("30 of 30 dominoes fell; the wave went at ")
        assert 0.5 < scene.wave_speed() / np.sqrt(9.81 * 0.25) < 2

    def test_they_stand_where_none_leans(self):
        scene = built("dominoes", dominoes=10, lean=0.0)
        scene.advance(1.0)
        assert np.isinf(scene.measured["fell"]).all()
        assert scene.words() == "0 of 10 dominoes fell"

    @pytest.mark.slow
    def test_the_wave_is_as_fast_as_that_of_other_engines(self):
        """PyBullet 3.35 m/s, MuJoCo 3.37 m/s at a step of 1/240 s, between dominoes 10 and 20."""
        scene = built(
            "dominoes",
            dominoes=30,
            path="line",
            height=1.0,
            width=0.5,
            thickness=0.1,
            pitch=0.5,
            lean=0.3,
            friction=0.5,
            step=1 / 240,
        )
        scene.advance(8.0)
        assert scene.wave_speed() == pytest.approx(3.36, rel=0.03)


class TestCradle:
    def test_the_last_ball_takes_it_all(self):
        cradle = built("cradle")
        start = cradle.energy_at_start
        cradle.advance(2.0)
        first, last, others = (values[0] for values in cradle.measured.values())
        drop = 0.5 * (1 - np.cos(np.radians(40.0)))
        assert first == pytest.approx(np.sqrt(2 * 9.81 * drop), rel=5e-3)
        assert last / first > 0.98 and others / first < 0.05
        assert cradle._energy() == pytest.approx(start, rel=0.05)
        assert "the last ball left at 0.9" in cradle.words() or "at 1.0" in cradle.words()

    def test_two_make_two_move(self):
        cradle = built("cradle", lifted=2)
        cradle.advance(1.2 * cradle.quarter)
        speeds = np.linalg.norm(cradle.velocities[cradle.balls], axis=1)
        assert speeds[-2:].min() > 0.9 * speeds.max() and speeds[:3].max() < 0.05 * speeds.max()

    def test_more_than_there_are(self):
        with pytest.raises(substep.InputError, match="lifted: expected fewer than the 3 balls"):
            built("cradle", balls=3, lifted=3)


class TestTumblingTop:
    def test_it_flips_when_elliptic_functions_say(self):
        """By DOP853 at a tolerance of 1e-12: at 2.269436 s, and every 4.538872 s."""
        top = built("tumbling-top", shape="plate")
        np.testing.assert_allclose(top.inertia, [0.02416667, 0.08666667, 0.10416667], rtol=1e-6)
        top.advance(20.0)
        exact = top.methods.index("exact")
        assert top.flips[exact] == 4
        assert top.first[exact] == pytest.approx(2.269436, abs=1e-5)
        assert top.last[exact] == pytest.approx(15.886053, abs=2e-5)
        drift = np.abs(top.energies() / top._energy_at_start - 1)
        errors = dict(zip(top.methods, drift, strict=True))
        assert errors["exact"] < 1e-12 and errors["splitting"] < 1e-4
        assert errors["quaternion"] > 0.01 and errors["matrix"] > 0.01
        assert top.words().startswith("exact 4 flips, one in 4.5388")

    def test_only_some_methods(self, tmp_path):
        outcome = run("tumbling-top", tmp_path, methods=("splitting",), duration=1.0)
        assert outcome.summary.startswith("splitting 0 flips, energy ")
        with substep.Recording(outcome.recording) as recording:
            assert set(recording.parts) == {"tops", "splitting"}


class TestRover:
    def test_on_the_flat_it_goes_at_its_speed_and_stands_level_on_its_springs(self):
        rover = built("rover", hills=0.0, stones=0.0, speed=0.8)
        rover.advance(3.0)
        row = rover.rows(rover.chassis)
        x, height = rover.positions[row][[0, 2]]
        rover.advance(1.0)
        assert rover.positions[row][0] - x == pytest.approx(0.8, rel=0.01)
        assert rover.positions[row][2] == pytest.approx(height, abs=5e-3)
        assert np.abs(2 * rover.rotations[row][1:]).max() < 0.03  # [rad]
        assert rover.diagnostics()["penetration"] < 2e-3

    def test_it_crosses_the_hills(self):
        rover = built("rover")
        rover.advance(10.0)
        way, high = (rover.positions[rover.rows(rover.chassis)] - rover.start)[[0, 2]]
        assert way > 7 and rover.measured["climbed"][0] > 0.8 > high - 1
        assert np.degrees(rover.measured["lean"][0]) < 60
        wheels = rover.positions[rover.rows(rover.wheels)]
        heights = rover.obstacles["hills"].vertices[:, 2]
        assert (wheels[:, 2] > 0.2).all() and heights.max() > 0.7
        assert rover.words().startswith("drove ")

    def test_the_seed_makes_the_hills(self):
        hills = [built("rover", seed=k).obstacles["hills"].vertices for k in (0, 0, 1)]
        np.testing.assert_array_equal(hills[0], hills[1])
        assert not np.array_equal(hills[0], hills[2])
