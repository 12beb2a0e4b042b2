"""SIGKILL and damage: nothing acknowledged is lost, and nothing wrong is ever handed out."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import substep

HERE = Path(__file__).parent
ENVIRONMENT = {
    **os.environ,
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONPATH": os.pathsep.join(
        [str(Path(substep.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    ),
}


def run(program, *arguments):
    """Run a program of this folder; its last line is JSON."""
    done = subprocess.run(
        [sys.executable, str(HERE / program), *map(str, arguments)],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def assert_nothing_lost(tally, kills):
    failures = "unreadable lost wrong resumed_elsewhere wrong_after_resume left_behind".split()
    assert {name: tally[name] for name in failures} == dict.fromkeys(failures, 0), tally["messages"]
    assert tally["kills"] == kills and tally["killed"] == kills
    assert tally["frames"] > kills  # they were not all killed before the first frame


def test_30_kills():
    assert_nothing_lost(run("kills.py", 30, 1), 30)


@pytest.mark.slow
def test_1000_kills():
    tally = run("kills.py", 1000, 2)
    assert_nothing_lost(tally, 1000)
    print(tally)


RECORD_AND_CLOSE = """
import sys, numpy as np, substep
with substep.Recorder(sys.argv[1], parts={"p": substep.Part()}) as recorder:
    for k in range(20):
        recorder.append(k, {"p": {"points": np.full((1000, 3), float(k))}})
    print("closing", flush=True)
"""


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3])
def test_killed_in_close_while_the_packing_process_lives_on(tmp_path, delay):
    path = tmp_path / "a.vtkhdf"
    command = [sys.executable, "-c", RECORD_AND_CLOSE, str(path)]
    with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "closing\n"
        time.sleep(delay)
        child.kill()
    deadline = time.monotonic() + 60
    while True:
        with substep.Recording(path) as recording:
            assert len(recording) == 20
            assert all((f["p"]["points"] == k).all() for k, (_, f) in enumerate(recording))
        try:
            recorder = substep.Recorder(path, parts={"p": substep.Part()}, resume=True)
            break
        except BlockingIOError:  # it packs
            assert time.monotonic() < deadline
            time.sleep(0.02)
    recorder.append(20, {"p": {"points": [[20.0, 20.0, 20.0]]}})
    recorder.close()
    with substep.Recording(path) as recording:
        assert recording.packed and len(recording) == 21
    assert os.listdir(tmp_path) == ["a.vtkhdf"]


def assert_never_wrong(tally, trials):
    for kind, outcomes in tally.items():
        allowed = {"identical", "error"}
        if kind.endswith("recover") or kind.startswith("journal truncate"):
            allowed.add("prefix")
        assert set(outcomes) <= allowed, (kind, outcomes)
        assert sum(outcomes.values()) > 0.9 * trials / 2
    assert "identical" not in tally["journal flip"]  # every bit of a journal is checked


def test_400_flips_and_truncations_are_noticed():
    assert_never_wrong(run("damage.py", 400, 1), 400)


@pytest.mark.slow
def test_4000_flips_and_truncations_are_noticed():
    assert_never_wrong(run("damage.py", 4000, 2), 4000)
