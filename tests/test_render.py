"""Pictures and movies of recordings."""

import gc
import itertools
import sys
from pathlib import Path

import numpy as np
import pytest
import substep
from substep import render
from substep.cli import main

pytest.importorskip("matplotlib")


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "run.vtkhdf"
    parts = {
        "grains": substep.Part("particles", fields={"velocity": "m/s"}),
        "floor": substep.Part("mesh", triangles=[[0, 1, 2]]),
    }
    with substep.Recorder(path, parts=parts) as recorder:
        for k in range(4):
            grains = {"points": np.arange(8.0).reshape(4, 2) + k, "velocity": np.ones((4, 2))}
            floor = {"points": [[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]}
            recorder.append(0.1 * k, {"grains": grains, "floor": floor})
    return path


def pixels(path):
    from matplotlib.image import imread

    return imread(path)


def test_picture_of_a_recording_without_a_scene(recording, capsys):
    assert main(["render", str(recording)]) == 0
    assert capsys.readouterr().out == f"picture: {recording.with_suffix('.png')}\n"
    image = pixels(recording.with_suffix(".png"))
    assert image.shape[:2] == (810, 1440)
    assert image[..., :3].std() > 0.01
    assert sorted(p.name for p in recording.parent.iterdir()) == ["run.png", "run.vtkhdf"]


def test_frames_differ_and_the_last_is_the_default(recording, tmp_path, capsys):
    for frame, name in ((0, "a"), (3, "b"), (-1, "c")):
        arguments = [
            "render",
            str(recording),
            "--frame",
            str(frame),
            "--out",
            str(tmp_path / f"{name}.png"),
        ]
        assert main(arguments) == 0
    first, last, default = (pixels(tmp_path / f"{name}.png") for name in "abc")
    assert not np.array_equal(first, last) and np.array_equal(last, default)
    for frame in (4, -5):
        with pytest.raises(substep.InputError, match="from -4 to 3"):
            render.save_picture(recording, tmp_path / "x.png", frame=frame)
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize(("time", "frame"), [(0.0, 0), (0.14, 1), (9.0, 3)])
def test_a_scene_chooses_the_frame_of_its_picture(recording, time, frame):
    shown = []
    scene = substep.scenes.Scene(
        name="grains",
        doc="Grains.",
        parameters={"duration": substep.scenes.Parameter("time simulated", 0.3, unit="s")},
        build=lambda parameters, seed: None,
        picture=lambda recording, frame, figure: shown.append(frame),
        still=lambda recording: time,
    )
    with substep.Recording(recording) as run:
        render.draw(run, scene=scene)
        render.draw(run, -1, scene=scene)
    assert shown == [frame, 3]


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # imageio-ffmpeg's pipes
def test_movie_has_every_frame(recording, tmp_path, capsys):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "run.mp4"
    assert main(["render", str(recording), "--out", str(out), "--fps", "2"]) == 0
    assert capsys.readouterr().out == f"movie: {out}\n"
    reader = imageio_ffmpeg.read_frames(str(out))
    meta = next(reader)
    assert meta["size"] == (960, 540) and meta["fps"] == 2 and meta["codec"] == "h264"
    frames = [np.frombuffer(frame, np.uint8) for frame in reader]
    assert len(frames) == 4
    assert all(np.any(a != b) for a, b in itertools.pairwise(frames))
    assert not list(tmp_path.glob(".*"))
    del reader
    gc.collect()


def test_a_film_that_ffmpeg_cannot_write_is_an_error(recording, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    resource = pytest.importorskip("resource")
    out = tmp_path / "run.mp4"
    out.write_bytes(b"a film")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
    try:
        with pytest.raises(OSError, match="ffmpeg failed") as error:
            render.save_movie(recording, out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert error.value.filename == str(out) and out.read_bytes() == b"a film"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mp4", "run.vtkhdf"]


def test_a_recording_is_not_written_over(recording, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    film, linked = tmp_path / "run.mp4", tmp_path / "linked.png"
    film.write_bytes(recording.read_bytes())
    linked.hardlink_to(recording)
    journal = substep.Recorder(tmp_path / "live.vtkhdf", parts={"p": substep.Part()})
    journal.append(0.0, {"p": {"points": np.zeros((1, 3))}})
    before = recording.read_bytes()
    with substep.Recording(recording) as opened:
        for write, *where in (
            (render.save_picture, recording, recording),
            (render.save_picture, recording, linked),
            (render.save_picture, tmp_path / "live.vtkhdf", tmp_path / "live.vtkhdf"),
            (render.save_movie, film, film),
            (opened.to_html, recording),
        ):
            with pytest.raises(substep.InputError, match=r"^out: .* is the recording itself"):
                write(*where)
    journal.close()
    assert recording.read_bytes() == film.read_bytes() == before


def test_arguments_that_are_wrong(recording, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    for name in ("q.gif", "q.png", "q"):
        with pytest.raises(substep.InputError, match=r"^out: .* ending in \.mp4, got '"):
            render.save_movie(recording, tmp_path / name)
    for scene in (render.View(), "dam-break"):
        with pytest.raises(TypeError, match=r"^scene: expected a Scene, got "):
            render.save_picture(recording, tmp_path / "q.png", scene=scene)
    assert [path.name for path in tmp_path.iterdir()] == ["run.vtkhdf"]


def test_empty_recording(tmp_path):
    path = tmp_path / "run.vtkhdf"
    with substep.Recorder(path, parts={"p": substep.Part()}):
        pass
    with pytest.raises(substep.InputError, match="no frame"):
        render.save_picture(path, tmp_path / "x.png")


def test_no_points(tmp_path):
    path = tmp_path / "run.vtkhdf"
    with substep.Recorder(path, parts={"p": substep.Part(fields={"speed": "m/s"})}) as recorder:
        recorder.append(0, {"p": {"points": np.empty((0, 2)), "speed": np.empty(0)}})
    render.save_picture(path, tmp_path / "x.png")
    assert (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("module", "out", "words"),
    [("matplotlib", "x.png", "matplotlib"), ("imageio_ffmpeg", "x.mp4", "imageio-ffmpeg")],
)
def test_a_missing_extra_is_named(recording, tmp_path, capsys, monkeypatch, module, out, words):
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["render", str(recording), "--out", str(tmp_path / out)]) == 1
    err = capsys.readouterr().err
    assert words in err and 'pip install "substep[plot]"' in err and err.count("\n") == 1
    assert not (tmp_path / out).exists()


def test_run_without_matplotlib_still_records(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    toy = Path(__file__).parent / "scenes/toy_scene.py"
    assert main(["run", str(toy), "--out", str(tmp_path / "run")]) == 0
    out, err = capsys.readouterr()
    assert "recording: " in out and "no picture: matplotlib is missing" in err
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["walkers.vtkhdf"]


def test_a_picture_that_cannot_be_written(recording, tmp_path, capsys):
    (tmp_path / "folder.png").mkdir()
    assert main(["render", str(recording), "--out", str(tmp_path / "folder.png")]) == 2
    assert main(["render", str(recording), "--out", str(tmp_path / "none" / "x.png")]) == 2
    assert not [p for p in tmp_path.iterdir() if "part" in p.name]


def test_a_recording_of_a_scene_file_is_drawn_by_it(tmp_path, capsys):
    toy = Path(__file__).parent / "scenes/toy_scene.py"
    scene = tmp_path / "scene.py"
    picture = (
        "\ndef picture(recording, frame, figure):\n    figure.set_facecolor((1.0, 0.0, 0.0))\n"
    )
    text = toy.read_text().replace(
        "SCENE = Scene(", picture + "\n\nSCENE = Scene(\n    picture=picture,"
    )
    scene.write_text(text)
    assert main(["run", str(scene), "--out", str(tmp_path / "run")]) == 0
    np.testing.assert_array_equal(pixels(tmp_path / "run/walkers.png")[0, 0, :3], [1, 0, 0])
    recording = str(tmp_path / "run/walkers.vtkhdf")
    assert main(["render", recording, "--out", str(tmp_path / "a.png")]) == 0  # never runs a file
    np.testing.assert_array_equal(pixels(tmp_path / "a.png")[0, 0, :3], [1, 1, 1])
    assert main(["render", recording, "--out", str(tmp_path / "b.png"), "--scene", str(scene)]) == 0
    np.testing.assert_array_equal(pixels(tmp_path / "b.png")[0, 0, :3], [1, 0, 0])


def test_a_simulation_without_a_recording(tmp_path, monkeypatch):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    monkeypatch.chdir(tmp_path)
    drift = substep.Advection(substep.DoubleGyre(), [[0.5, 0.5], [1.5, 0.3]], step=0.05)
    before = drift.positions.copy()
    render.save_picture(drift, tmp_path / "a.png", size=(320, 180))
    assert pixels(tmp_path / "a.png").shape[:2] == (180, 320)
    np.testing.assert_array_equal(drift.positions, before)
    out = render.save_movie(drift, tmp_path / "a.mp4", 0.5, fps=4, size=(320, 180))
    assert drift.time == pytest.approx(0.5) and np.any(drift.positions != before)
    assert imageio_ffmpeg.count_frames_and_secs(str(out))[0] == 3  # at 0, 0.25 and 0.5 s
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "a.png"]
    for options, told in (
        ({}, "duration: expected how long"),
        ({"duration": -1.0}, "duration: expected"),
        ({"duration": 1.0, "size": (321, 180)}, "size: expected even"),
        ({"duration": 1.0, "engine": "eevee"}, "engine: expected"),
    ):
        with pytest.raises(substep.InputError, match=told):
            render.save_movie(drift, tmp_path / "b.mp4", **options)
    with pytest.raises(TypeError, match="source: expected a recording or a simulation, got"):
        render.save_picture(7, tmp_path / "b.png")


def test_frames_that_are_too_many_or_too_near_leave_nothing(tmp_path):
    bodies = substep.RigidBodies()
    bodies.add(substep.Box((1, 1, 1)), (0, 0, 2))
    for duration, fps in ((1e300, 1e300), (1e-12, 1e15), (1e9, 1e9)):
        with pytest.raises(substep.InputError, match="fps: "):
            substep.scenes.record(bodies, tmp_path / "a.vtkhdf", duration, fps=fps)
    with pytest.raises(TypeError, match="simulation: expected a simulation, got <class"):
        substep.scenes.record(substep.RigidBodies, tmp_path / "a.vtkhdf", 1.0)
    for out in ("", "a\0.png", b""):
        with pytest.raises(substep.InputError, match="out: expected a file name"):
            render.save_picture(bodies, out)
    with pytest.raises(IsADirectoryError):
        render.save_picture(bodies, ".")
    assert bodies.time == 0 and not list(tmp_path.iterdir())
    bodies = substep.Advection(substep.DoubleGyre(), [[0.5, 0.5]], step=0.05)
    render.save_picture(bodies, bytes(tmp_path / "a.png"), size=(320, 180))
    assert (tmp_path / "a.png").exists()


def test_a_recording_has_its_own_times(recording, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    with pytest.raises(substep.InputError, match="duration: a recording has its own times"):
        render.save_movie(recording, tmp_path / "a.mp4", 1.0)
    arguments = ["render", str(recording), "--out", str(tmp_path / "a.png")]
    assert main([*arguments, "--size", "400x200"]) == 0
    assert pixels(tmp_path / "a.png").shape[:2] == (200, 400)
    for wrong in (["--size", "200"], ["--engine", "eevee"], ["--samples", "0"]):
        assert main([*arguments, *wrong]) == 2
    assert main([*arguments, "--engine", "cycles"]) in (1, 2)  # no Blender, or no third dimension
