"""The scenes: each of them runs, records, resumes to the same bits, and shows what it should."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
import substep
from substep import scenes
from substep.cli import main
from substep.scenes import Parameter, Scene
from substep.scenes.catalogue import BUILT_IN

DATA = Path(__file__).parents[3] / "shared" / "data" / "globcurrent"

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"

# The quick sizes of sand have too large cells for its bodies, which worlds rightly say.
pytestmark = pytest.mark.filterwarnings("ignore:members. body:substep.StartWarning")


def small(name):
    """The scene and parameters for a run of a second."""
    scene = scenes.load(name)
    parameters = dict(scene.quick)
    if name == "ocean-drift":
        if not DATA.is_dir():
            pytest.skip("the ocean currents are not at hand")
        parameters["data"] = str(DATA)
    if name == "bunny-snow":
        parameters["mesh"] = str(MESHES / "spot.obj")
        if not MESHES.is_dir():
            pytest.skip("the meshes are not at hand")
    return scene, parameters


def frames_of(path):
    with substep.Recording(path) as recording:
        return [(time, {p: dict(a) for p, a in frame.items()}) for time, frame in recording]


def hash_of(path):
    frames = frames_of(path)
    return substep.state_hash(
        *(x for t, f in frames for x in (t, *(a for part in f.values() for a in part.values())))
    )


@pytest.mark.parametrize("name", scenes.names())
def test_records_what_it_declares(name, tmp_path):
    scene, parameters = small(name)
    seen = []
    outcome = scenes.run(
        scene, parameters, tmp_path, frames=5, on_frame=lambda k, n, t: seen.append((k, n, t))
    )
    assert outcome.recording == tmp_path / f"{name}.vtkhdf" and outcome.frames == 5
    assert [k for k, _, _ in seen] == [0, 1, 2, 3, 4]
    with substep.Recording(outcome.recording) as recording:
        assert recording.scene == name and len(recording) == 5
        assert recording.times.tolist() == [t for _, _, t in seen]
        assert recording.times[-1] == pytest.approx(
            parameters["duration"] * scene.time_scale, rel=0.02
        )
        for key, value in parameters.items():
            assert recording.parameters[key] == value
        assert set(recording.parameters) == {*scene.parameters, "frames", "interval", "notes"}
        for k in range(5):
            for arrays in recording.frame(k).values():
                for values in arrays.values():
                    assert np.isfinite(values).all()
        first, last = recording.frame(0), recording.frame(-1)
        name, part = next(iter(recording.parts.items()))
        # Points, or the first field of a grid; a wheel turns in its place.
        moved = [key for key in (part.array_names[0], "orientation") if key in first[name]]
        assert any(not np.array_equal(first[name][key], last[name][key]) for key in moved)


@pytest.mark.parametrize("name", scenes.names())
def test_checkpoint_is_the_whole_state(name, tmp_path):
    scene, parameters = small(name)
    complete = scene.complete(scene.check(parameters))
    one = scene.build(complete, 3)
    hop = 0.25 * complete["duration"] * scene.time_scale
    one.advance(hop)
    one.save(tmp_path / "checkpoint")
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint"]
    other, third = scene.build(complete, 3), scene.build(complete, 3)
    other.load(tmp_path / "checkpoint")
    third.restore(one.state())
    for simulation in (one, other, third):
        simulation.advance(2 * hop)
    hashes = {
        substep.state_hash(s.time, *(values for values, _ in s.fields().values()))
        for s in (one, other, third)
    }
    assert len(hashes) == 1
    for text in (
        b"",
        b"{}",
        b'{"steps": -1}',
        b"[" * 10_000,
        (tmp_path / "checkpoint").read_bytes()[:-9],
    ):
        (tmp_path / "bad").write_bytes(text)
        with pytest.raises(substep.FormatError):
            one.load(tmp_path / "bad")
    assert substep.state_hash(one.time, *(v for v, _ in one.fields().values())) in hashes


@pytest.mark.parametrize("name", scenes.names())
def test_resumes_to_the_same_bits(name, tmp_path):
    scene, parameters = small(name)
    whole = scenes.run(scene, parameters, tmp_path / "whole", frames=7, seed=4).recording

    def stop(frame, frames, time):
        if frame == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="4 of 7 frames"):
        scenes.run(scene, parameters, tmp_path / "cut", frames=7, seed=4, on_frame=stop)
    seen = []
    part = scenes.run(
        scene, {}, tmp_path / "cut", resume=True, on_frame=lambda k, n, t: seen.append(k)
    ).recording
    assert seen == [3, 4, 5, 6]  # from the checkpoint, not from the start
    assert hash_of(part) == hash_of(whole)
    assert [p.name for p in (tmp_path / "cut").iterdir()] == [f"{name}.vtkhdf"]


@pytest.mark.parametrize("name", scenes.names())
def test_threads_do_not_change_the_bits(name, tmp_path):
    scene, parameters = small(name)
    before = substep.num_threads()
    hashes = set()
    try:
        for threads in (1, 2, 3, 4):
            substep.set_num_threads(threads)
            run = scenes.run(scene, parameters, tmp_path / str(threads), frames=3)
            hashes.add(hash_of(run.recording))
    finally:
        substep.set_num_threads(before)
    assert len(hashes) == 1


@pytest.mark.parametrize("name", scenes.names())
def test_picture(name, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    _, parameters = small(name)
    sets = [word for key, value in parameters.items() for word in ("--set", f"{key}={value}")]
    assert main(["run", name, *sets, "--frames", "5", "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err == "" and out.endswith(f"picture: {tmp_path / name}.png\n")
    assert out.startswith(f"{name}: 5 frames, ")
    assert (tmp_path / f"{name}.png").stat().st_size > 20_000


@pytest.mark.parametrize("name", [n for n, folder in BUILT_IN.items() if folder in ("pbd", "pbf")])
def test_nothing_leaves_at_ten_times_the_usual_speed_and_step(name):
    scene, parameters = small(name)
    simulation = scene.build(scene.complete(scene.check(parameters)), 0)
    usual = simulation._next_step()
    fall = np.sqrt(2 * 9.81 * np.ptp(simulation.positions, axis=0).max())
    directions = np.random.default_rng(1).normal(size=(len(simulation), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    simulation.set_velocities(10 * fall * directions)
    for _ in range(8):
        simulation.step(10 * usual)
        x = simulation.positions
        assert min(collider.distance(x).min() for collider in simulation.colliders) >= 0


class TestClothHang:
    def test_it_hangs_where_implicit_euler_takes_long_steps(self, tmp_path):
        run = scenes.run(
            scenes.load("cloth-hang"),
            {"vertices": 12, "duration": 4.0, "drag": 3.0},
            tmp_path,
            frames=5,
        )
        assert "144 vertices, at rest (0.00" in run.summary
        (_, first), *_, (_, last) = frames_of(run.recording)
        start, end = (frame["cloth"]["points"].reshape(12, 12, 3) for frame in (first, last))
        np.testing.assert_array_equal(start[[0, -1], 0], end[[0, -1], 0])  # the pins
        np.testing.assert_allclose(start[0, 0, 0] - start[-1, 0, 0], -0.8, rtol=1e-12)
        along = np.linalg.norm(np.diff(start, axis=0), axis=2)
        np.testing.assert_allclose(along, 1 / 11, rtol=0.02)  # sags without a strain
        assert start[..., 1].max() == pytest.approx(0.5) and end[:, -1, 2].max() < -0.9
        stretch = np.linalg.norm(np.diff(end, axis=1), axis=2) * 11
        assert 1 < stretch[0, 0] < 1.2 and stretch.max() < 1.2

    @pytest.mark.parametrize("integrator", ["symplectic_euler", "velocity_verlet", "rk4"])
    def test_it_explodes_where_predicted(self, integrator):
        scene = scenes.load("cloth-hang")
        given = {"vertices": 8, "integrator": integrator, "damping_time": 0.0, "drag": 0.0}
        cloth = scene.build(scene.complete(scene.check(given)), 0)
        limit, _ = cloth.step_limit()
        for factor in (0.95, 1.05):
            step = factor * limit
            cloth = scene.build(scene.complete(scene.check({**given, "step": step})), 0)
            if factor < 1:
                cloth.advance(250 * step)
                continue
            with pytest.raises(substep.SolverError, match="beyond the step limit") as caught:
                cloth.advance(250 * step)
            there = float(re.search(r"in this shape is below (\S+) s", str(caught.value))[1])
            assert 0.98 * limit < there < step

    def test_the_explosion_is_told_and_the_last_good_state_drawn(self, tmp_path, capsys):
        sets = (
            "--set",
            "vertices=8",
            "--set",
            "integrator=symplectic_euler",
            "--set",
            "damping_time=0",
        )
        command = ["run", "cloth-hang", *sets, "--fps", "500", "--out", str(tmp_path)]
        assert main([*command, "--set", "step=0.002"]) == 1
        out, err = capsys.readouterr()
        assert re.match(r"substep: the step from t = 0\.\d+ s diverges, most at vertex \d+: ", err)
        assert "or use implicit_euler" in err and "; the frames before are in" in err
        assert err.count("\n") == 1
        with substep.Recording(tmp_path / "cloth-hang.vtkhdf") as recording:
            assert 1 < len(recording) < 20
            assert np.abs(recording["cloth"].points(-1)).max() < 2
        if importlib.util.find_spec("pyvista"):
            assert out == f"picture: {tmp_path / 'cloth-hang'}.png\n"

    def test_the_state_is_that_before_the_explosion(self):
        scene = scenes.load("cloth-hang")
        given = {"vertices": 8, "integrator": "rk4", "step": 0.01}
        cloth = scene.build(scene.complete(scene.check(given)), 0)
        before = substep.state_hash(cloth.time, cloth.positions, cloth.velocities)
        with pytest.raises(substep.SolverError, match="rk4 exploded at time") as caught:
            cloth.advance(1.0)
        assert 0 < caught.value.time <= 1
        assert substep.state_hash(cloth.time, cloth.positions, cloth.velocities) == before


class TestClothDrape:
    def run(self, tmp_path, **parameters):
        scene = scenes.load("cloth-drape")
        return scenes.run(scene, parameters, tmp_path, frames=6)

    def test_over_a_ball(self, tmp_path):
        run = self.run(tmp_path, vertices=16, duration=2.0)
        frames = frames_of(run.recording)
        with substep.Recording(run.recording) as recording:
            ball = np.asarray(recording.parts["obstacle"].points)
        np.testing.assert_allclose(np.linalg.norm(ball - [0, 0, 0.5], axis=1), 0.5)
        for _, frame in frames:
            points = frame["cloth"]["points"]
            assert (np.linalg.norm(points - [0, 0, 0.5], axis=1) > 0.5).all()
            assert (points[:, 2] > 0).all()
        last = frames[-1][1]["cloth"]["points"]
        assert last[:, 2].max() > 1.0 and np.ptp(last[:, 2]) > 0.5  # over it, and down its sides

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("spot", "2930 vertices, 5856 faces; closed, manifold, oriented"),
            ("stanford-bunny", "5 holes"),
            ("teapot", "21 holes"),
        ],
    )
    def test_over_a_mesh(self, tmp_path, name, words):
        path = MESHES / f"{name}.obj"
        if not path.exists():
            pytest.skip("the meshes are not at hand")
        run = self.run(tmp_path, vertices=20, cells=48, duration=1.0, mesh=str(path))
        assert words in run.summary
        with substep.Recording(run.recording) as recording:
            assert words in recording.parameters["notes"]["mesh"]
            part = recording.parts["obstacle"]
            obstacle = substep.Collider(
                substep.SignedDistanceField.from_mesh(
                    substep.geometry.TriangleMesh(part.points, part.triangles), 1 / 48
                )
            )
            assert np.ptp(np.asarray(part.points), axis=0).max() == pytest.approx(1, rel=0.1)
            for k in range(len(recording)):
                points = recording["cloth"].points(k)
                assert obstacle.distance(points).min() > 0 and points[:, 2].min() > 0
            assert points[:, 2].max() < 0.2 + np.asarray(part.points)[:, 2].max()

    def test_what_cannot_be_draped(self, tmp_path, capsys):
        for name, text in (
            ("none.obj", None),
            ("empty.obj", ""),
            ("flat.obj", "v 0 0 0\nf 1 1 1\n"),
        ):
            path = tmp_path / name
            if text is not None:
                path.write_text(text)
            command = [
                "run",
                "cloth-drape",
                "--out",
                str(tmp_path / "run"),
                "--set",
                f"mesh={path}",
            ]
            assert main(command) == 2
            err = capsys.readouterr().err
            assert name in err and err.count("\n") == 1
            assert not (tmp_path / "run").exists()


class TestJelly:
    def run(self, tmp_path, frames=6, **parameters):
        outcome = scenes.run(scenes.load("jelly"), parameters, tmp_path, frames=frames)
        with substep.Recording(outcome.recording) as recording:
            solid = np.asarray(recording.parts["jelly"].tetrahedra)
            slope = recording.parts.get("slope")
        return (
            outcome,
            solid,
            slope,
            [f["jelly"]["points"] for _, f in frames_of(outcome.recording)],
        )

    @pytest.mark.parametrize("shape", ["box", "ball"])
    def test_it_falls_and_stays_above_the_ground(self, tmp_path, shape):
        outcome, solid, slope, points = self.run(tmp_path, duration=0.3, cells=4, shape=shape)
        assert slope is None and f"{len(solid)} tetrahedra" in outcome.summary
        assert points[0][:, 2].min() == pytest.approx(0.1)
        a, b, c, d = (points[0][solid[:, k]] for k in range(4))
        volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6
        exact = 0.2**3 * (1 if shape == "box" else np.pi / 6)
        assert volume == pytest.approx(exact, rel=1e-9 if shape == "box" else 0.1)
        lowest = [p[:, 2].min() for p in points]
        assert min(lowest) > 0 and lowest[-1] < 2e-3
        # free fall until then, but for the drag of 0.1/s: the frames are 0.06 s apart
        assert points[0][:, 2].mean() - points[1][:, 2].mean() == pytest.approx(
            0.5 * 9.81 * 0.06**2, rel=0.2
        )

    @pytest.mark.parametrize(("friction", "stays"), [(0.5, True), (0.1, False)])
    def test_it_slips_on_an_incline_that_is_too_steep(self, tmp_path, friction, stays):
        _, _, slope, points = self.run(
            tmp_path, duration=0.6, cells=2, tilt=0.0, height=0.02, incline=20.0, friction=friction
        )
        down = np.array([np.cos(np.radians(20)), 0, -np.sin(np.radians(20))])
        normal = np.array([np.sin(np.radians(20)), 0, np.cos(np.radians(20))])
        np.testing.assert_allclose(np.asarray(slope.points) @ normal, 0, atol=1e-12)
        assert all((p @ normal).min() > 0 for p in points)
        way = (points[-1] - points[2]).mean(axis=0) @ down
        t = 0.36
        if stays:
            assert abs(way) < 0.01
        else:  # from rest it would be a t^2 / 2; it has slid a little before
            a = 9.81 * (np.sin(np.radians(20)) - 0.1 * np.cos(np.radians(20)))
            assert 0.8 * a * t**2 / 2 < way < 3 * a * t**2 / 2

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("name", "words"),
        [("spot", "closed, manifold"), ("stanford-bunny", "5 holes"), ("teapot", "21 holes")],
    )
    def test_of_a_mesh(self, tmp_path, name, words):
        path = MESHES / f"{name}.obj"
        if not path.exists():
            pytest.skip("the meshes are not at hand")
        outcome, _, _, points = self.run(tmp_path, mesh=str(path), cells=8, duration=0.3)
        assert words in outcome.summary and "filled with tetrahedra" in outcome.summary
        assert all(p[:, 2].min() > 0 for p in points)
        assert points[-1][:, 2].mean() < points[0][:, 2].mean() - 0.05


class TestLiquids:
    def test_a_column_collapses_and_stays_in_the_tank(self, tmp_path):
        scene = scenes.load("dam-break")
        run = scenes.run(scene, {"duration": 0.4, "particles": 1500}, tmp_path, frames=5)
        assert ", 0 of them outside" in run.summary and "99 % of it is within" in run.summary
        with substep.Recording(run.recording) as recording:
            spacing = float(recording.parameters["notes"]["spacing"])
            tank = np.asarray(recording.parts["tank"].points)
            pillar = np.asarray(recording.parts["pillar"].points)
            assert recording.parts["tank"].edges.shape == (12, 2)
            assert set(recording.parts["liquid"].fields) == {"velocity", "id"}
            first, last = (recording["liquid"].points(k).astype(float) for k in (0, -1))
        np.testing.assert_allclose(tank.max(axis=0)[[0, 2]], [3.0, 1.5])
        assert len(first) == pytest.approx(1500, rel=0.1)
        assert spacing**3 * len(first) == pytest.approx(1.0 * 1.2 * tank[:, 1].max(), rel=0.1)
        assert first[:, 0].max() < 1 and last[:, 0].max() > 1.5
        assert last[:, 2].max() < first[:, 2].max() + 0.1
        for x in (first, last):
            assert (x >= 0).all() and (x[:, :2] <= tank.max(axis=0)[:2]).all()
            assert not ((x > pillar.min(axis=0)) & (x < pillar.max(axis=0))).all(axis=1).any()

    def test_the_heavier_of_two_liquids_goes_below(self, tmp_path):
        parameters = {"duration": 2.5, "particles": 800, "ratio": 3.0, "second": 1.0}
        run = scenes.run(scenes.load("double-dam"), parameters, tmp_path, frames=3)
        frames = frames_of(run.recording)
        heights = [
            [frame[part]["points"][:, 2].mean() for part in ("left", "right")]
            for _, frame in frames
        ]
        assert heights[0][0] == pytest.approx(heights[0][1], rel=1e-3)
        assert heights[-1][1] < 0.9 * heights[-1][0]
        ids = [np.concatenate([frame[p]["id"] for p in ("left", "right")]) for _, frame in frames]
        np.testing.assert_array_equal(ids[0], ids[-1])

    def test_particles_of_a_fountain_come_and_go_with_ids_that_stay(self, tmp_path):
        parameters = {"spacing": 0.09, "nozzle": 0.07, "duration": 0.5}
        run = scenes.run(scenes.load("fountain"), parameters, tmp_path, frames=4)
        came, went = (int(word) for word in re.findall(r"^(\d+).* and (\d+) went", run.summary)[0])
        frames = [frame["liquid"] for _, frame in frames_of(run.recording)]
        assert len(frames[-1]["id"]) == len(frames[0]["id"]) + came - went
        assert came > 0 and len({len(frame["id"]) for frame in frames}) > 1
        for frame in frames:
            assert len(np.unique(frame["id"])) == len(frame["id"]) == len(frame["points"])
        pytest.importorskip("vtkmodules.vtkIOHDF", reason="VTK is not installed")
        from vtk_reading import read_by_vtk
        from vtkmodules.util.numpy_support import vtk_to_numpy

        for (_, blocks), frame in zip(read_by_vtk(run.recording), frames, strict=True):
            assert set(blocks) == {"liquid", "tank", "ball"}
            points = vtk_to_numpy(blocks["liquid"].GetPoints().GetData())
            np.testing.assert_array_equal(points, frame["points"])
            ids = vtk_to_numpy(blocks["liquid"].GetPointData().GetArray("id"))
            np.testing.assert_array_equal(ids, frame["id"])

    def test_a_column_of_water_hits_the_box_and_its_gauges_tell(self, tmp_path):
        scene = scenes.load("water-column")
        run = scenes.run(scene, {"duration": 0.6, "cells": 29}, tmp_path, frames=7)
        assert "water came to H2 after 0.4" in run.summary and "; to P1 after 0.4" in run.summary
        with substep.Recording(run.recording) as recording:
            assert {"liquid", "tank", "box", "gauges", "sensors"} == set(recording.parts)
            tank = np.asarray(recording.parts["tank"].points)
            box = np.asarray(recording.parts["box"].points)
        np.testing.assert_allclose(tank.max(axis=0), [3.22, 1.0, 1.0], rtol=1e-3)
        np.testing.assert_allclose(np.ptp(box, axis=0), [0.161, 0.403, 0.161])
        frames = [frame for _, frame in frames_of(run.recording)]
        first, last = frames[0], frames[-1]
        assert first["liquid"]["points"][:, 0].min() > 1.9
        assert last["liquid"]["points"][:, 0].min() < 0.6
        np.testing.assert_allclose(first["gauges"]["depth"], [0, 0, 0, 0.55], atol=0.03)
        assert (first["sensors"]["pressure"] == 0).all()
        assert 2000 < last["sensors"]["pressure"][0] < 12_000
        assert last["gauges"]["depth"][3] < 0.45 and last["gauges"]["depth"][1] > 0.06

    @pytest.mark.slow
    def test_a_mesh_filled_with_water(self, tmp_path):
        path = MESHES / "stanford-bunny.obj"
        if not path.exists():
            pytest.skip("the meshes are not at hand")
        parameters = {"mesh": str(path), "particles": 3000, "duration": 0.3}
        run = scenes.run(scenes.load("dam-break"), parameters, tmp_path, frames=3)
        assert "5 holes" in run.summary and ", 0 of them outside" in run.summary
        (_, first), *_, (_, last) = frames_of(run.recording)
        first, last = (frame["liquid"]["points"].astype(float) for frame in (first, last))
        assert 2000 < len(first) < 3000
        bunny = substep.geometry.read_mesh(path)
        turned = np.roll(bunny.vertices, 1, axis=1)  # y is up
        sides = np.ptp(turned[bunny.faces].reshape(-1, 3), axis=0)
        share = np.ptp(first, axis=0) / sides / (0.8 / sides[1])
        assert (share > 0.65).all() and (share < 1).all()  # ears are thin
        assert last[:, 2].mean() < 0.7 * first[:, 2].mean()

    @pytest.mark.parametrize(
        ("scene", "settings", "words"),
        [
            ("dam-break", ["particles=0"], "particles: expected an integer from 1"),
            ("dam-break", ["width=4"], "width: a column of 4 m does not fit into a tank of 3 m"),
            ("dam-break", ["width=2.5"], "pillar: it would be inside the column"),
            ("dam-break", ["mesh=none.obj"], "none.obj"),
            ("dam-break", ["speed=1"], "speed: dam-break has no such parameter"),
            ("double-dam", ["width=2"], "width: two columns of 2 m do not fit into 3 m"),
            ("double-dam", ["ratio=0"], "ratio: expected a finite number above 0"),
            ("fountain", ["nozzle=-1"], "nozzle: expected a finite number above 0"),
            ("fountain", ["jet=3"], "jet: fountain has no such parameter; did you mean jets?"),
            ("rope", ["segments=0"], "segments: expected an integer from 1"),
            ("cloth-ball", ["compliance=-1"], "compliance: expected a finite number of at least 0"),
            ("cloth-ball", ["mesh=none.obj"], "none.obj"),
            ("soft-bunny", ["poisson=0.5"], "poisson: expected a finite number from 0 to 0.49"),
            ("soft-bunny", ["mesh=none.obj"], "none.obj"),
        ],
    )
    def test_what_cannot_be_run(self, tmp_path, capsys, scene, settings, words):
        sets = [word for setting in settings for word in ("--set", setting)]
        assert main(["run", scene, *sets, "--out", str(tmp_path / "run")]) == 2
        out, err = capsys.readouterr()
        assert out == "" and words in err and err.count("\n") == 1, err
        assert not (tmp_path / "run").exists()


class TestPositionBased:
    def test_a_ball_bounces_down_the_steps_and_keeps_its_volume(self, tmp_path):
        parameters = {"cells": 5, "duration": 1.0}
        run = scenes.run(scenes.load("soft-bunny"), parameters, tmp_path, frames=6)
        volume = float(re.search(r"volume ([\d.]+) times", run.summary)[1])
        assert 0.9 < volume < 1.1
        points = [frame["body"]["points"] for _, frame in frames_of(run.recording)]
        assert points[-1][:, 0].mean() > points[0][:, 0].mean() + 0.3
        assert points[-1][:, 2].mean() < points[0][:, 2].mean() - 0.15
        assert min(p[:, 2].min() for p in points) > 0

    def test_ropes_keep_their_length_and_their_pins(self, tmp_path):
        parameters = {"ropes": 3, "segments": 20, "duration": 1.0}
        run = scenes.run(scenes.load("rope"), parameters, tmp_path, frames=3)
        assert float(re.search(r"strain ([\d.e-]+) %", run.summary)[1]) < 3
        points = [
            frame["rope"]["points"].reshape(3, 21, 3) for _, frame in frames_of(run.recording)
        ]
        np.testing.assert_array_equal(points[0][:, 0], points[-1][:, 0])
        assert points[-1][..., 2].min() > 0 and points[-1][:, -1, 2].max() < 1.0
        ball = np.linalg.norm(points[-1] - [0, 0, 0.56], axis=2)
        assert ball.min() > 0.56 + 0.014  # the thickness lies between

    def test_a_cloth_turns_with_the_ball(self, tmp_path):
        parameters = {"vertices": 16, "duration": 1.0, "spin": 2.0}
        run = scenes.run(scenes.load("cloth-ball"), parameters, tmp_path, frames=3)
        first, *_, last = (frame["cloth"]["points"] for _, frame in frames_of(run.recording))
        middle = slice(16 * 7 + 7, 16 * 7 + 9)
        turned = np.arctan2(*np.diff(last[middle], axis=0)[0, 1::-1]) - np.arctan2(
            *np.diff(first[middle], axis=0)[0, 1::-1]
        )
        assert 0.5 < turned < 2.2
        assert last[:, 2].max() > 1.0 and last[:, 2].min() < 0.6

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["spot", "cow"])
    def test_a_cloth_over_a_mesh(self, tmp_path, name):
        path = MESHES / f"{name}.obj"
        if not path.exists():
            pytest.skip("the meshes are not at hand")
        parameters = {"vertices": 24, "cells": 40, "duration": 0.6, "mesh": str(path), "spin": 1.0}
        run = scenes.run(scenes.load("cloth-ball"), parameters, tmp_path, frames=3)
        assert "vertices, " in run.summary
        clearance = float(re.search(r"to an obstacle ([-\d.e]+) mm", run.summary)[1])
        assert clearance > 0
        with substep.Recording(run.recording) as recording:
            turning = [recording["obstacle"].points(k) for k in (0, -1)]
        radii = [np.hypot(*points[:, :2].T) for points in turning]
        np.testing.assert_allclose(radii[0], radii[1], atol=1e-5)
        assert np.abs(turning[0] - turning[1]).max() > 0.1

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["spot", "stanford-bunny"])
    def test_a_soft_mesh(self, tmp_path, name):
        path = MESHES / f"{name}.obj"
        if not path.exists():
            pytest.skip("the meshes are not at hand")
        parameters = {"mesh": str(path), "cells": 8, "duration": 0.5}
        run = scenes.run(scenes.load("soft-bunny"), parameters, tmp_path, frames=3)
        assert "filled with tetrahedra" in run.summary
        assert float(re.search(r"to an obstacle ([-\d.e]+) mm", run.summary)[1]) > 0
        assert 0.85 < float(re.search(r"volume ([\d.]+) times", run.summary)[1]) < 1.15


class TestMaterialPoints:
    def run(self, tmp_path, name, frames=4, **parameters):
        scene, small_ones = small(name)
        return scenes.run(scene, small_ones | parameters, tmp_path, frames=frames)

    def test_a_column_of_sand_spreads_and_comes_to_rest(self, tmp_path):
        run = self.run(tmp_path, "sand-column", particles=4000, duration=1.6)
        assert "0 of them outside, at rest" in run.summary
        assert 1.2 < float(re.search(r"run-out ([\d.]+) radii", run.summary)[1]) < 3.0
        (_, first), *_, (_, last) = frames_of(run.recording)
        np.testing.assert_array_equal(first["sand"]["dye"], last["sand"]["dye"])
        assert first["sand"]["points"][:, 2].max() > 0.7 > 0.5 > last["sand"]["points"][:, 2].max()

    def test_a_snowball_bursts_and_sticks_to_the_wall(self, tmp_path):
        # The fewer particles, the more it takes to break them apart.
        run = self.run(tmp_path, "snowball", particles=3000, duration=0.1, stretch=0.002)
        assert "0 of them outside" in run.summary
        (_, first), *_, (_, last) = frames_of(run.recording)
        before, after = (f["snow"]["points"] for f in (first, last))
        assert np.ptp(after[:, 1]) > 2.3 * np.ptp(before[:, 1])
        stuck = (last["snow"]["speed"] < 0.1) & (after[:, 0] > -0.03)
        assert 0.04 < stuck.mean() < 0.5

    def test_firm_snow_is_flattened_by_the_wall(self, tmp_path):
        firm = {"stretch": 0.0075, "wall": "separate", "speed": 10.0}
        run = self.run(tmp_path, "snowball", particles=2000, duration=0.1, **firm)
        assert "0 of them outside" in run.summary
        (_, first), *_, (_, last) = frames_of(run.recording)
        before, after = (f["snow"]["points"] for f in (first, last))
        assert after[:, 0].mean() > before[:, 0].mean() and after[:, 0].max() < 0
        assert np.ptp(after[:, 0]) < 0.93 * np.ptp(before[:, 0])

    def test_mud_slumps_by_its_yield_stress(self, tmp_path):
        slumps = []
        for stress in (2000.0, 300.0):
            given = {"particles": 1500, "duration": 0.6, "posts": False, "yield": stress}
            run = self.run(tmp_path / f"{stress}", "mud-slump", **given)
            assert "0 of them outside, at rest" in run.summary
            slumps.append(float(re.search(r"slumped by ([\d.]+)", run.summary)[1]))
        assert 0 <= slumps[0] < 0.1 and 0.4 < slumps[1] < 0.9

    def test_cubes_fall_and_keep_their_shape(self, tmp_path):
        run = self.run(tmp_path, "jelly-cubes", particles=1500, duration=0.5, turned=False)
        assert "0 of them outside" in run.summary
        (_, first), *_, (_, last) = frames_of(run.recording)
        for k in range(3):
            x, y = (f["cubes"]["points"][first["cubes"]["dye"] == k] for f in (first, last))
            sides = np.ptp(y, axis=0)
            assert 0.08 < sides.min() and sides.max() < 0.1 * 3**0.5
            assert 0.04 < y[:, 2].mean() < x[:, 2].mean() + 0.05

    def test_a_mesh_of_snow(self, tmp_path):
        run = self.run(tmp_path, "bunny-snow", resolution=20, duration=0.4)
        assert "2930 vertices, 5856 faces" in run.summary and "0 of them outside" in run.summary
        (_, first), *_, (_, last) = frames_of(run.recording)
        wide = [np.ptp(f["snow"]["points"], axis=0) for f in (first, last)]
        assert wide[1][0] > 1.1 * wide[0][0] and wide[1][2] < wide[0][2]

    def test_a_mesh_must_be_given(self, tmp_path, capsys):
        assert main(["run", "bunny-snow", "--out", str(tmp_path / "run")]) == 2
        err = capsys.readouterr().err
        assert "mesh: bunny-snow needs it" in err and err.count("\n") == 1
        assert not (tmp_path / "run").exists()

    @pytest.mark.parametrize(
        ("name", "given", "reason"),
        [
            ("sand-column", "particles=1", "particles: 1 cannot fill a cylinder of 0.4 m radius"),
            ("mud-slump", "height=1e-6", "particles: 100000 cannot fill a cylinder"),
            ("snowball", "particles=1", "radius: no point lies inside"),
            ("jelly-cubes", "cfl=2", "--set cfl: expected a finite number above 0 of at most 1"),
        ],
    )
    def test_what_cannot_be_is_refused(self, name, given, reason, tmp_path, capsys):
        assert main(["run", name, "--set", given, "--out", str(tmp_path / "run")]) == 2
        err = capsys.readouterr().err
        assert reason in err and err.count("\n") == 1
        assert not (tmp_path / "run").exists()


def test_kepler_keeps_energy_where_it_should(tmp_path):
    run = scenes.run(scenes.load("kepler"), {"duration": 20, "steps": 500}, tmp_path, frames=101)
    frames = frames_of(run.recording)
    energy = np.array([frame["particles"]["energy"] for _, frame in frames])
    with substep.Recording(run.recording) as recording:
        methods = recording.parameters["methods"]
    np.testing.assert_allclose(energy[0], -0.5, rtol=1e-15)
    error = dict(zip(methods, np.abs(energy / energy[0] - 1).T, strict=True))
    for method in ("symplectic_euler", "velocity_verlet", "yoshida4"):
        assert error[method][51:].max() < 1.5 * error[method][:51].max(), method  # bounded
    assert error["rk4"][-1] > 3.5 * error["rk4"][20]  # grows with time
    assert (
        error["yoshida4"].max() < error["velocity_verlet"].max() < error["symplectic_euler"].max()
    )


def test_verlet_in_hops_is_verlet_in_one_go():
    """Position Verlet's central-difference velocity restarts it exactly, but for rounding."""
    scene = scenes.load("kepler")
    parameters = scene.complete(scene.check({"methods": "position_verlet", "duration": 2}))
    hops, whole = scene.build(parameters, 0), scene.build(parameters, 0)
    for k in range(1, 21):
        hops.advance(k * 0.1 * scene.time_scale - hops.time)
    whole.advance(2 * scene.time_scale)
    assert hops.time == pytest.approx(whole.time, abs=1e-12)
    np.testing.assert_allclose(
        hops.fields()["position"][0], whole.fields()["position"][0], atol=1e-10
    )


@pytest.mark.parametrize("bodies", [12, 30])
def test_bodies_that_will_float_begin_in_their_tank(bodies):
    scene = scenes.load("float")
    world = scene.build(scene.complete(scene.check({"bodies": bodies, "cells": 24})), 0)
    moving, water = world["bodies"].frame()["solids"]["points"], world["water"]
    assert (moving[:, :2] > 0).all() and (moving[:, :2] < water.tank[:2]).all()
    assert moving[:, 2].min() > 0
    world.step()
    assert len(world["bodies"].contacts()) == 0


def test_what_hangs_together_is_drawn_so(tmp_path):
    """Cloth and soft bodies of a world are meshes, nets are lines, loose particles stay such."""
    sheet = substep.geometry.grid_mesh(4, 4)
    cube = substep.geometry.box_tetrahedra((1, 1, 1), (1, 1, 1))
    solid = {"density": 1.0, "young_modulus": 1e3, "poisson_ratio": 0.3}
    bent = [*substep.pbd.cloth(sheet, rigidity=1e-3)]
    ends = [[0, 0, 0], [0, 0, 1], [0, 0, 2.0]]
    members = {
        "cloth": substep.MassSpring.from_mesh(sheet, density=1.0, stiffness=10.0),
        "net": substep.MassSpring(ends, [[0, 1], [1, 2]], 1.0, 1.0),
        "loose": substep.MassSpring(ends, [[0, 1]], 1.0, 1.0),
        "jelly": substep.SoftBody(cube.vertices, cube.tetrahedra, **solid),
        "flag": substep.PositionBasedDynamics(sheet.vertices, 1.0, bent),
        "flesh": substep.PositionBasedDynamics(cube.vertices, 1.0, substep.pbd.soft_body(cube)),
    }
    scene = Scene(
        name="all",
        doc="All of them.",
        parameters={"duration": Parameter("time", 0.01, unit="s")},
        build=lambda parameters, seed: substep.World(members),
    )
    outcome = scenes.run(scene, {}, tmp_path, frames=2)
    with substep.Recording(outcome.recording) as recording:
        parts = recording.parts
    assert {name for name, part in parts.items() if part.kind == "particles"} == {"loose"}
    faces = {tuple(row) for row in np.sort(sheet.faces, axis=1)}
    for name in ("cloth", "flag"):
        assert {tuple(row) for row in np.sort(parts[name].triangles, axis=1)} == faces
    assert np.array_equal(parts["net"].edges, [[0, 1], [1, 2]])
    assert len(parts["jelly"].tetrahedra) == len(cube.tetrahedra)
    assert len(parts["flesh"].triangles) == 12


def test_oscillator_shows_the_classical_limits(tmp_path):
    scene = scenes.load("oscillator")
    run = scenes.run(scene, {"step": 0.1, "duration": 10}, tmp_path, frames=11)
    time, last = frames_of(run.recording)[-1]
    methods = scene.parameters["methods"].default
    gain = dict(zip(methods, last["particles"]["energy"] / 0.5, strict=True))
    steps = round(time / 0.1)
    # |1 + i h|^2 = 1 + h^2 for explicit Euler, 1 + h^4 / 4 for midpoint and Heun
    assert gain["euler"] == pytest.approx(1.01**steps, rel=1e-9)
    assert gain["midpoint"] == pytest.approx((1 + 1e-4 / 4) ** steps, rel=1e-9)
    assert gain["heun"] == pytest.approx(gain["midpoint"], rel=1e-9)
    # |R|^2 = 1 - h^6 / 72 + h^8 / 576 for RK4
    assert gain["rk4"] == pytest.approx((1 - 1e-6 / 72 + 1e-8 / 576) ** steps, rel=1e-9)
    for method in ("symplectic_euler", "position_verlet", "velocity_verlet", "yoshida4"):
        assert gain[method] == pytest.approx(1, abs=0.06)


def test_steps_longer_than_frames_are_refused(tmp_path):
    with pytest.raises(substep.InputError, match="step: 3 s is too long for frames"):
        scenes.run(scenes.load("oscillator"), {"step": 3.0}, tmp_path / "run", frames=501)
    assert not (tmp_path / "run").exists()


def test_double_gyre_stays_in_its_box_and_keeps_its_dye(tmp_path):
    scene = scenes.load("double-gyre")
    run = scenes.run(scene, {"particles": 1000, "duration": 20}, tmp_path, frames=3)
    (_, first), _, (_, last) = frames_of(run.recording)
    points, start = last["particles"]["points"], last["particles"]["start"]
    assert (points >= 0).all() and (points <= [2, 1]).all()
    np.testing.assert_array_equal(start, first["particles"]["points"][:, 0])


class TestOceanDrift:
    @pytest.fixture
    def run(self, tmp_path):
        scene, parameters = small("ocean-drift")
        parameters |= {"duration": 10.0, "particles": 3000}
        return scenes.run(scene, parameters, tmp_path, frames=11).recording

    def test_drifters_start_on_water_and_stay_off_the_land(self, run):
        field = substep.open_field(DATA)
        frames = frames_of(run)
        first, last = frames[0][1]["drifters"], frames[-1][1]["drifters"]
        assert (first["status"] == 0).all()
        moving = last["status"] == 0
        assert 1000 < moving.sum() < 3000
        nodes = [
            axis[np.abs(axis[:, None] - last["points"][moving, d]).argmin(0)]
            for d, axis in enumerate(field.axes)
        ]
        assert not np.isnan(field(10 * 86400.0, np.column_stack(nodes))).any()
        assert (last["speed"][~moving] == 0).all() and (last["speed"][moving] > 0).all()

    def test_speed_is_that_of_the_currents(self, run):
        field = substep.open_field(DATA)
        for time, frame in frames_of(run)[::5]:
            drifters = frame["drifters"]
            moving = drifters["status"] == 0
            u = field(time, drifters["points"][moving].astype(float))
            np.testing.assert_allclose(drifters["speed"][moving], np.hypot(*u.T), atol=2e-4)

    def test_the_agulhas_current_is_the_fastest(self, run):
        """Off Port Elizabeth (35 S, 25 E) the current runs south-westward at over 1 m/s."""
        frames = [frame["drifters"] for _, frame in frames_of(run)]
        points = np.concatenate([f["points"] for f in frames])
        speed = np.concatenate([f["speed"] for f in frames])
        core = np.hypot(points[:, 0] - 25, points[:, 1] + 35) < 0.4
        assert core.sum() > 20 and speed[core].mean() > 1.0 > 2 * speed.mean()

    def test_land_is_where_the_data_have_none(self, run):
        field = substep.open_field(DATA)
        with substep.Recording(run) as recording:
            land = recording.frame(0)["land"]["points"]
            triangles = np.asarray(recording.parts["land"].triangles)
        nodes = np.stack(np.meshgrid(*field.axes, indexing="ij"), -1).reshape(-1, 2)
        missing = np.isnan(field(0.0, nodes)).any(axis=1)
        assert len(land) == 4 * missing.sum() and len(triangles) == 2 * missing.sum()
        a, b, c = (land[triangles[:, k], :2].astype(float) for k in range(3))
        twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        assert (twice > 0).all()
        assert twice.sum() / 2 == pytest.approx(missing.sum() * 0.25**2, rel=0.05)

    def test_vtk_reads_every_frame(self, run):
        pytest.importorskip("vtkmodules.vtkIOHDF", reason="VTK is not installed")
        from vtk_reading import read_by_vtk
        from vtkmodules.util.numpy_support import vtk_to_numpy

        steps = read_by_vtk(run)
        frames = frames_of(run)
        assert len(steps) == len(frames) == 11
        for (time, blocks), (t, frame) in zip(steps, frames, strict=True):
            assert time == t and set(blocks) == {"drifters", "land"}
            points = vtk_to_numpy(blocks["drifters"].GetPoints().GetData())
            np.testing.assert_array_equal(points[:, :2], frame["drifters"]["points"][:, :2])
            speed = vtk_to_numpy(blocks["drifters"].GetPointData().GetArray("speed"))
            np.testing.assert_array_equal(speed, frame["drifters"]["speed"])

    def test_the_recording_knows_the_date(self, run):
        with substep.Recording(run) as recording:
            assert recording.parameters["notes"] == {"origin": "2002-01-01T00:00:00"}

    def test_wrong_data_is_one_line(self, tmp_path, capsys, monkeypatch):
        small("ocean-drift")
        monkeypatch.chdir(tmp_path)
        np.savez("plane.npz", x=[0.0, 1.0], y=[0.0, 1.0], values=np.ones((2, 2, 2)))
        (tmp_path / "junk.nc").write_bytes(b"CDF\x01junk")
        (tmp_path / "empty").mkdir()
        for data, words in (
            ("plane.npz", "by longitude and latitude"),
            ("junk.nc", "junk.nc"),
            ("empty", "no NetCDF files"),
            (f"{DATA} --set duration=61", "the data covers 60 days, got 61"),
        ):
            arguments = f"run ocean-drift --out run --set data={data}".split()
            assert main(arguments) == 2
            out, err = capsys.readouterr()
            assert out == "" and words in err and err.count("\n") == 1
            assert not (tmp_path / "run").exists()


def test_the_scene_of_the_manual(tmp_path, capsys):
    manual = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
    (tmp_path / "spiral.py").write_text(manual.split("```python\n")[1].split("```")[0])
    arguments = ["run", str(tmp_path / "spiral.py"), "--out", str(tmp_path), "--no-picture"]
    assert main(arguments) == 0
    assert capsys.readouterr().out.startswith("spiral: 101 frames, 5 s, ")
    (_, first), *_, (_, last) = frames_of(tmp_path / "spiral.vtkhdf")
    radii = [np.hypot(*f["particles"]["points"].T[:2]) for f in (first, last)]
    np.testing.assert_allclose(radii[1], radii[0] * np.exp(-0.1 * 5), rtol=1e-6)


@pytest.mark.parametrize(
    ("parameter", "value", "result"),
    [
        (Parameter("n", 3), "1e6", 1_000_000),
        (Parameter("n", 3), "9007199254740993", 9007199254740993),
        (Parameter("x", 3.0), "3", 3.0),
        (Parameter("x", 3.0, above=0), "1e-300", 1e-300),
        (Parameter("b", False), "True", True),
        (Parameter("b", True), "off", False),
        (Parameter("s", "a"), "any text", "any text"),
        (Parameter("s", "a", choices=("a", "b")), "B", "b"),
        (Parameter("s", ("a",), choices=("a", "b")), "b, a", ("b", "a")),
    ],
)
def test_parameters_read_texts(parameter, value, result):
    got = parameter.parse("key", value)
    assert got == result and type(got) is type(result)


@pytest.mark.parametrize(
    ("parameter", "value", "words"),
    [
        (Parameter("n", 3), 3.0, "an integer, got 3.0"),
        (Parameter("n", 3), True, "an integer, got true"),
        (Parameter("n", 3), 10**400, "an integer, got 1000"),
        (Parameter("n", 3, minimum=1), 0, "an integer of at least 1, got 0"),
        (Parameter("n", 3, maximum=5), 6, "an integer of at most 5, got 6"),
        (Parameter("x", 3.0, unit="m"), float("nan"), "a finite number [m], got nan"),
        (Parameter("x", 3.0, above=0), 0.0, "a finite number above 0, got 0.0"),
        (Parameter("x", 3.0), "3", "got '3'"),
        (Parameter("x", 3.0), [3.0], "got a list"),
        (Parameter("b", True), 1, "true or false, got 1"),
        (Parameter("s", "a"), 1, "a text, got 1"),
        (Parameter("s", "a"), "x\0y", "without NUL"),
        (Parameter("s", "a", choices=("a", "b")), "c", "one of a, b, got 'c'"),
        (Parameter("s", "a"), {"deep": 1}, "got a table"),
        (Parameter("x", 3.0), "y" * 1000, "got 'yyy"),
    ],
)
def test_parameters_refuse(parameter, value, words):
    with pytest.raises(substep.InputError, match="key: expected") as caught:
        parameter.check("key", value)
    assert words in str(caught.value) and len(str(caught.value)) < 120


@pytest.mark.parametrize("name", ["", "A", "a b", "../a", "a/b", "é", "a" * 65, "-", "1"])
def test_names_of_scenes(name):
    with pytest.raises(substep.InputError, match="name: "):
        Scene(name, "", {"duration": Parameter("", 1.0)}, build=lambda p, seed: None)


def test_scenes_need_a_duration_and_leave_some_names_free():
    with pytest.raises(substep.InputError, match="duration"):
        Scene("a", "", {}, build=lambda p, seed: None)
    taken = {"duration": Parameter("", 1.0), "frames": Parameter("", 1)}
    with pytest.raises(substep.InputError, match="frames is taken"):
        Scene("a", "", taken, build=lambda p, seed: None)


def test_load_refuses_other_names():
    for name in ("", "Kepler", "kepler.yaml", "no-such", "substep"):
        with pytest.raises(
            substep.InputError, match="neither a built-in scene nor a file ending in"
        ):
            scenes.load(name)


@pytest.mark.parametrize(
    "odd", [{"frames": "x"}, {"frames": 1}, {"interval": 0.0}, {"interval": None}]
)
def test_a_recording_to_resume_that_no_run_wrote(tmp_path, odd):
    scene = substep.scenes.load("double-gyre")
    recorder = substep.Recorder(
        tmp_path / "double-gyre.vtkhdf",
        parts={"particles": substep.Part()},
        scene="double-gyre",
        parameters={"frames": 3, "interval": 1.0, **odd},
    )
    recorder._release()
    with pytest.raises(substep.InputError, match="was not written by a run"):
        substep.scenes.run(scene, out=tmp_path, resume=True)
