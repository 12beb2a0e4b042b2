"""The command line as a user meets it: output, exit codes, interruptions, resuming."""

import errno
import fcntl
import os
import pty
import re
import shlex
import signal
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import substep
from substep.cli import main

TOY = Path(__file__).parent / "scenes/toy_scene.py"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    package = str(Path(substep.__file__).parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([package, os.environ.get("PYTHONPATH", "")]))
    return tmp_path


def call(capsys, *arguments):
    """Exit code, standard output, and standard error, which is one line at most."""
    code = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert err.count("\n") <= 1 and "Traceback" not in err
    return code, out, err.rstrip("\n")


def command(*arguments):
    return [sys.executable, "-m", "substep", *map(str, arguments)]


def hashes(path):
    """Hash of every frame of a recording, with its time."""
    with substep.Recording(path) as recording:
        return [
            substep.state_hash(time, *(a for part in frame.values() for a in part.values()))
            for time, frame in (
                (recording.times[i], recording.frame(i)) for i in range(len(recording))
            )
        ]


def start(*options, frames=2, out="run"):
    """A running toy scene that has recorded some frames."""
    process = subprocess.Popen(
        command("run", TOY, "--out", out, "--no-picture", *options),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and process.poll() is None:
        try:
            with substep.Recording(f"{out}/walkers.vtkhdf") as recording:
                if len(recording) >= frames:
                    return process
        except (OSError, substep.FormatError):
            pass
        time.sleep(0.01)
    process.kill()
    raise AssertionError(process.communicate())


def test_version_and_help(capsys):
    assert call(capsys, "--version") == (0, f"substep {substep.__version__}\n", "")
    code, out, err = call(capsys, "--help")
    assert code == 0 and err == ""
    for name in ("run", "sweep", "scenes", "info", "render", "export", "config"):
        assert re.search(rf"^    {name} ", out, re.MULTILINE)


def test_config_prints_the_installation(capsys):
    code, out, _ = call(capsys, "config")
    assert code == 0 and re.search(
        rf"^substep +{re.escape(substep.__version__)}$", out, re.MULTILINE
    )


def test_module_is_the_command():
    done = subprocess.run(command("--version"), capture_output=True, text=True, check=True)
    assert done.stdout == f"substep {substep.__version__}\n"


def test_scenes_lists_every_scene_with_units(capsys):
    code, out, _ = call(capsys, "scenes")
    assert code == 0
    for name in substep.scenes.names():
        scene = substep.scenes.load(name)
        assert f"{name}: {scene.doc}\n" in out
        for key, parameter in scene.parameters.items():
            assert re.search(rf"^    {key} +{re.escape(parameter.doc)} \(", out, re.MULTILINE)
    assert "required" in out


def test_command_line_starts_without_numpy():
    code = "import sys, substep.cli; substep.cli.main(['--help']); sys.exit('numpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("", "COMMAND"),
        ("rnu", "did you mean run?"),
        ("run", "which SCENE"),
        ("run keplr", "did you mean kepler?"),
        ("run kepler twice", "unrecognized arguments: twice"),
        ("run kepler --frmes 3", "unrecognized arguments: --frmes"),
        ("run kepler --frame 3", "unrecognized arguments: --frame"),
        ("run kepler --set", "--set"),
        ("run kepler --set steps", "--set steps: expected KEY=VALUE"),
        ("run kepler --set =3", "expected KEY=VALUE"),
        ("sweep kepler --to mgn", "argument --to: unknown 'mgn': did you mean gns?"),
        ("export a.vtkhdf --out a.usdc --liquid water", "--liquid water: expected PART=RADIUS"),
        ("run kepler --set stpes=3", "stpes: kepler has no such parameter; did you mean steps?"),
        ("run kepler --set steps=3 --set steps=4", "--set steps: given twice"),
        ("run kepler --set steps=3.5", "--set steps: expected an integer from 1 to 1e+07, got 3.5"),
        ("run kepler --set steps=", "got ''"),
        ("run kepler --set duration=nan", "--set duration: expected a finite number above 0 [per"),
        ("run kepler --set duration=1e999", "got inf"),
        ("run kepler --set 'duration=50 s'", "[periods], got '50 s'"),
        ("run kepler --set duration=0", "got 0"),
        ("run kepler --set methods=rk4,leapfrog", "expected some of symplectic_euler"),
        ("run kepler --frames 1", "--frames: expected an integer of at least 2, got 1"),
        ("run kepler --frames x", "--frames: expected an integer of at least 2, got 'x'"),
        ("run kepler --fps 0", "--fps: expected a finite number above 0, got 0"),
        ("run kepler --fps 1e300", "over 1e9 frames"),
        ("run kepler --fps 1e-300", "expected frames 2 or more"),
        ("run kepler --threads 0", "--threads: expected an integer from 1 to 1024, got 0"),
        ("run kepler --seed -1", "--seed: expected"),
        ("run kepler --resume --overwrite", "not allowed with argument"),
        ("run kepler --config none.toml", "none.toml: No such file"),
        ("run none.py", "none.py: No such file"),
        ("run ocean-drift", "data: ocean-drift needs it"),
        ("run ocean-drift --set data=none", "none"),
        ("info none.vtkhdf", "none.vtkhdf: No such file"),
        ("export none.journal", "none: No such file"),
        ("render none.vtkhdf", "none.vtkhdf: No such file"),
        ("render none.vtkhdf --out x.gif", "--out: expected a file ending in .png or .mp4"),
        ("render none.vtkhdf --frame x", "--frame: expected an integer, got 'x'"),
        ("render none.vtkhdf --fps 9", "--fps: a picture has no frame rate"),
        ("render none.vtkhdf --out x.mp4 --frame 1", "--frame: a movie shows every frame"),
        ("validate --out none/page.html", "none: No such file"),
        ("scenes keplr", "did you mean kepler?"),
    ],
)  # fmt: skip
def test_wrong_input_is_one_line_and_leaves_nothing(capsys, folder, arguments, words):
    code, out, err = call(capsys, *shlex.split(arguments))
    assert (code, out) == (2, "") and err.startswith("substep: ") and words in err
    assert not list(folder.iterdir())


def test_run_records_and_tells(capsys, folder):
    code, out, err = call(capsys, "run", TOY, "--no-picture", "--set", "count=1e1", "--seed", "3")
    assert (code, err) == (0, "")
    assert re.match(
        r"walkers: 21 frames, 10 s, in \d+\.\d s, .*\nrecording: runs/walkers/walkers", out
    )
    assert [p.name for p in (folder / "runs/walkers").iterdir()] == ["walkers.vtkhdf"]
    with substep.Recording("runs/walkers/walkers.vtkhdf") as recording:
        assert (len(recording), recording.scene, recording.seed) == (21, "walkers", 3)
        assert recording.parameters["count"] == 10 and recording.version == substep.__version__
        np.testing.assert_array_equal(recording.times, 0.5 * np.arange(21))
        assert recording.parts["particles"].fields == {"distance": "m"}
    code, out, _ = call(capsys, "info", "runs/walkers/walkers.vtkhdf")
    assert code == 0 and "frames      21, 0 s to 10 s" in out and "distance [m]" in out
    assert "parameter   count = 10" in out and "seed 3" in out


def test_configuration_and_options(capsys, folder):
    (folder / "run.toml").write_text(
        f"scene = '{TOY.name}'\nframes = 11\nout = 'a'\nseed = 5\n"
        "[parameters]\ncount = 3\nduration = 5\n"
    )
    (folder / TOY.name).write_text(TOY.read_text())
    assert call(capsys, "run", "--config", "run.toml", "--no-picture")[0] == 0
    options = ("--no-picture", "--frames", "11", "--seed", "5", "--out", "b")
    sets = ("--set", "count=3", "--set", "duration=5")
    assert call(capsys, "run", TOY, *options, *sets)[0] == 0
    assert hashes("a/walkers.vtkhdf") == hashes("b/walkers.vtkhdf")
    overridden = call(
        capsys, "run", "--config", "run.toml", *options[:3], "--out", "c", "--set", "count=4"
    )
    assert overridden[0] == 0
    with substep.Recording("c/walkers.vtkhdf") as recording:
        assert (recording.parameters["count"], recording.seed) == (4, 5)


@pytest.mark.parametrize(
    ("options", "times"),
    [
        ((), 0.5 * np.arange(21)),
        (("--frames", "5"), 2.5 * np.arange(5)),
        (("--fps", "1"), 1.0 * np.arange(11)),
        (("--fps", "1", "--frames", "3"), 1.0 * np.arange(3)),
    ],
)
def test_frames_and_rate(capsys, options, times):
    assert call(capsys, "run", TOY, "--no-picture", *options)[0] == 0
    with substep.Recording("runs/walkers/walkers.vtkhdf") as recording:
        np.testing.assert_array_equal(recording.times, times)


def test_an_earlier_run_is_not_lost(capsys):
    options = ("run", TOY, "--no-picture", "--frames", "3")
    assert call(capsys, *options)[0] == 0
    before = hashes("runs/walkers/walkers.vtkhdf")
    code, out, err = call(capsys, *options, "--seed", "1")
    assert code == 2 and out == "" and "--resume" in err and "--overwrite" in err
    assert hashes("runs/walkers/walkers.vtkhdf") == before
    assert call(capsys, *options, "--seed", "1", "--overwrite")[0] == 0
    assert hashes("runs/walkers/walkers.vtkhdf") != before
    code, out, _ = call(capsys, *options, "--resume")
    assert code == 0 and "3 frames" in out


def test_solver_error_tells_time_and_remedy_and_keeps_the_frames(capsys):
    code, out, err = call(capsys, "run", TOY, "--no-picture", "--set", "fail_at=4")
    assert code == 1 and out == ""
    assert (
        "walker 3: fell over; take shorter steps at time 4 s" in err
        and "walkers.vtkhdf.journal" in err
    )
    assert len(hashes("runs/walkers/walkers.vtkhdf.journal")) == 9
    for name in ("walkers.vtkhdf", "walkers.vtkhdf.journal"):
        code, out, _ = call(capsys, "info", f"runs/walkers/{name}")
        assert code == 0 and "walkers.vtkhdf.journal (" in out and "frames      9, " in out
    code, out, _ = call(capsys, "export", "runs/walkers/walkers.vtkhdf.journal")
    assert code == 0 and "recording: runs/walkers/walkers.vtkhdf" in out
    assert len(hashes("runs/walkers/walkers.vtkhdf")) == 9


SLOW = ("--set", "pause=0.1", "--seed", "2")


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """Hashes of the slow run's frames; the pause must be a parameter of both."""
    out = tmp_path_factory.mktemp("whole")
    assert main(["run", str(TOY), "--no-picture", "--out", str(out), *SLOW]) == 0
    return hashes(out / "walkers.vtkhdf")


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_an_interrupted_run_goes_on_to_the_same_bits(capsys, uninterrupted, number, code):
    process = start(*SLOW, frames=4)
    process.send_signal(number)
    out, err = process.communicate(timeout=10)
    assert process.returncode == code and out == ""
    names = {path.name for path in Path("run").iterdir()}
    if number == signal.SIGKILL:
        assert names == {"walkers.vtkhdf.journal"}
    else:
        assert err.count("\n") == 1 and "--resume" in err
        assert names == {"walkers.vtkhdf.journal", "walkers.checkpoint"}
    recorded = hashes("run/walkers.vtkhdf")
    assert 4 <= len(recorded) < 21 and recorded == uninterrupted[: len(recorded)]
    assert call(capsys, "run", TOY, "--no-picture", "--out", "run", "--resume")[0] == 0
    assert hashes("run/walkers.vtkhdf") == uninterrupted
    assert [path.name for path in Path("run").iterdir()] == ["walkers.vtkhdf"]


def test_interrupted_twice_and_resumed_from_a_checkpoint(capsys, uninterrupted, monkeypatch):
    for frames in (3, 6):
        process = start("--resume", *SLOW, frames=frames)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=10)
    assert len(hashes("run/walkers.vtkhdf")) >= 6
    pauses = []
    monkeypatch.setattr(time, "sleep", pauses.append)
    assert call(capsys, "run", TOY, "--no-picture", "--out", "run", "--resume")[0] == 0
    assert 0 < pauses.count(0.1) <= 21 - 6  # from the checkpoint, not from the start
    assert hashes("run/walkers.vtkhdf") == uninterrupted


@pytest.mark.parametrize("damage", ["empty", "text", "stale", "gone"])
def test_resume_without_a_usable_checkpoint_starts_over(capsys, uninterrupted, damage):
    process = start(*SLOW, frames=3)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=10)
    checkpoint = Path("run/walkers.checkpoint")
    if damage == "gone":
        checkpoint.unlink()
    elif damage == "stale":  # of another time, which the journal has not reached
        checkpoint.write_text(checkpoint.read_text().replace("[", "[1", 1))
    else:
        checkpoint.write_text("" if damage == "empty" else "[1, 2]")
    assert call(capsys, "run", TOY, "--no-picture", "--out", "run", "--resume")[0] == 0
    assert hashes("run/walkers.vtkhdf") == uninterrupted


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--set", "count=6"), "count: the run to resume has 5, got 6"),
        (("--frames", "22"), "frames: the run to resume has 21, got 22"),
        (("--fps", "3"), "fps: the run to resume has 2"),
        (("--seed", "3"), "seed: the run to resume has 2, got 3"),
    ],
)
def test_resume_refuses_another_run(capsys, options, words):
    process = start(*SLOW)
    process.kill()
    process.communicate(timeout=10)
    before = Path("run/walkers.vtkhdf.journal").read_bytes()
    code, out, err = call(capsys, "run", TOY, "--no-picture", "--out", "run", "--resume", *options)
    assert (code, out) == (2, "") and words in err
    assert Path("run/walkers.vtkhdf.journal").read_bytes() == before


def test_resume_refuses_a_scene_that_has_changed(capsys, folder):
    process = start(*SLOW)
    process.kill()
    process.communicate(timeout=10)
    changed = folder / "changed.py"
    changed.write_text(TOY.read_text().replace("0.1 * self._random", "0.2 * self._random"))
    code, _, err = call(capsys, "run", changed, "--no-picture", "--out", "run", "--resume")
    assert code == 2 and "is different now" in err


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("x = (", "1", "SyntaxError"),
        ("\n\nraise OSError('no\\nluck')", "3", "OSError: no"),
        ("import substep_no_such_module", "1", "ModuleNotFoundError"),
        ("from substep.scenes import Scene\nScene('a', 'b', {}, None)", "2", "InputError"),
    ],
)
def test_faults_of_a_scene_file_tell_its_line(capsys, folder, text, place, words):
    (folder / "bad.py").write_text(text)
    code, out, err = call(capsys, "run", "bad.py")
    assert (code, out) == (2, "") and re.match(rf"bad\.py:{place}: {words}", err)
    assert [path.name for path in folder.iterdir()] == ["bad.py"]


def test_a_file_without_a_scene(capsys, folder):
    (folder / "empty.py").write_text("")
    code, _, err = call(capsys, "run", "empty.py")
    assert code == 2 and "expected one substep.scenes.Scene, found 0" in err


def test_an_exception_of_the_scene_tells_its_line(capsys, folder):
    text = TOY.read_text().replace("time.sleep(self._pause)", "{}['lost']")
    line = text[: text.index("{}['lost']")].count("\n") + 1
    (folder / "bad.py").write_text(text)
    code, out, err = call(capsys, "run", "bad.py", "--no-picture")
    assert (code, out) == (1, "") and err == f"bad.py:{line}: KeyError: 'lost'"
    with pytest.raises(Exception, match="lost") as caught:
        main(["run", "bad.py", "--no-picture", "--overwrite", "--traceback"])
    assert isinstance(caught.value.__cause__, KeyError)


@pytest.mark.parametrize(("error", "words"), [
    (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "f"), "f: No space left"),
    (MemoryError(), "out of memory"),
])  # fmt: skip
def test_faults_of_the_machine_are_code_1(capsys, monkeypatch, error, words):
    def fail(*_):
        raise error

    monkeypatch.setattr(substep.Recorder, "append", fail)
    code, out, err = call(capsys, "run", TOY, "--no-picture")
    assert (code, out) == (1, "") and words in err


def test_closed_pipe_is_quiet():
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command("scenes"), stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert done.returncode == 141 and done.stderr == ""


def test_run_into_a_closed_pipe_still_records(folder):
    script = f"{sys.executable} -m substep run {TOY} --no-picture | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr == "" and done.stdout == "141\n"
    assert len(hashes("runs/walkers/walkers.vtkhdf")) == 21


def test_progress_bar_on_a_terminal_only(folder):
    try:
        leader, follower = pty.openpty()
    except OSError as error:
        pytest.skip(f"no pseudo-terminal to be had: {error}")
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    done = subprocess.run(
        command("run", TOY, "--no-picture", "--set", "pause=0.05"),
        stdout=subprocess.PIPE, stderr=follower, text=True, check=True,
    )  # fmt: skip
    os.close(follower)
    shown = ""
    with suppress(OSError):  # EIO at the end
        while chunk := os.read(leader, 1 << 16):
            shown += chunk.decode()
    os.close(leader)
    assert "walkers: 100%" in shown and "21/21" in shown and "frame/s" in shown
    assert "frame" not in done.stdout.replace("21 frames", "")


def test_folder_that_cannot_be_made(capsys, folder):
    (folder / "file").write_text("")
    code, out, err = call(capsys, "run", TOY, "--no-picture", "--out", "file/run")
    assert (code, out) == (2, "") and "file/run" in err and "Not a directory" in err


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (["run", "kepler", "--out", ""], "expected the name of a folder, got none"),
        (["sweep", "kepler", "--out", ""], "expected the name of a folder, got none"),
        (["render", "x", "--out", ""], "expected the name of a file, got none"),
        (["export", "x", "--out", "a.npz/"], "expected the name of a file, got a folder"),
        (["validate", "--out", "a.html/"], "expected the name of a file, got a folder"),
    ],
)
def test_outputs_have_names(tmp_path, monkeypatch, capsys, line, told):
    monkeypatch.chdir(tmp_path)
    assert main(line) == 2
    assert f"--out: {told}" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
