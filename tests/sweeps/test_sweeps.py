"""Sweeps: every combination once, whatever dies; the bits of single runs; results as arrays."""

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
import substep
from substep.cli import main
from substep.sweeps import write_gns

WALKERS = str(Path(__file__).parents[1] / "scenes" / "toy_scene.py")


@pytest.fixture(scope="module")
def walkers(tmp_path_factory):
    """A sweep of the command line: two counts of walkers, one of which falls."""
    out = tmp_path_factory.mktemp("sweep") / "walkers"
    line = ["sweep", WALKERS, "--set", "count=3:5:2", "--set", "fail_at=1,99", "--repeats", "3"]
    line += ["--seed", "7", "--frames", "5", "--workers", "2", "--out", str(out)]
    assert main(line) == 1  # some runs failed
    return substep.RunCollection(out)


def test_every_combination_is_run_with_each_seed(walkers):
    assert walkers.shape == (2, 2, 3) and len(walkers) == 12
    assert walkers.parameters == {"count": (3, 5), "fail_at": (1.0, 99.0)}
    run = walkers[-2]
    assert (run.index, run.parameters, run.seed) == (10, {"count": 5, "fail_at": 99.0}, 8)
    assert "12 runs of count[2] x fail_at[2] x repeats[3], 6 done, 6 failed" in repr(walkers)


def test_failed_runs_are_listed_with_their_error(walkers, capsys):
    assert [run.index for run in walkers.failed] == [0, 1, 2, 6, 7, 8]
    assert walkers.failed[0].error.startswith("NonFiniteError: walker 3: fell over")
    with pytest.raises(substep.InputError, match="run 0 is failed: NonFiniteError"):
        walkers[0].recording()
    with pytest.raises(substep.InputError, match="one of a scene"):
        walkers[3].result()


def test_runs_have_the_bits_of_single_runs(walkers, tmp_path):
    scene = substep.scenes.load(WALKERS)
    run = walkers[4]
    alone = substep.scenes.run(scene, run.parameters, tmp_path, frames=5, seed=run.seed)
    with run.recording() as swept, substep.Recording(alone.recording) as single:
        for k in range(5):
            assert np.array_equal(swept["particles"].points(k), single["particles"].points(k))


def test_recordings_are_collected_as_arrays(walkers):
    def mean(run):
        with run.recording() as recording:
            return {"mean": recording["particles"].points(-1).mean(0)}

    found = walkers.arrays(mean)["mean"]
    assert found.shape == (2, 2, 3, 2)
    assert np.isnan(found[:, 0]).all() and np.isfinite(found[:, 1]).all()
    data = walkers.to_xarray(mean)
    assert data["mean"].dims == ("count", "fail_at", "repeat", "mean_0")
    assert data["seed"].values.tolist() == [7, 8, 9]
    assert data["mean"].sel(count=5, fail_at=99)[1, 0] == found[1, 1, 1, 0]


def test_data_set_for_graph_network_simulators(walkers, tmp_path):
    with pytest.raises(substep.InputError, match="part: expected one of particles"):
        write_gns(walkers, tmp_path / "no", part="liquid")
    with pytest.raises(substep.InputError, match="part: expected one of particles"):
        write_gns(walkers, tmp_path / "no", part=np.array(["particles"]))
    with pytest.raises(substep.InputError, match="material: expected one of"):
        write_gns(walkers, tmp_path / "no", material=[])
    with pytest.raises(substep.InputError, match=r"bounds: expected smaller .* of run 3 differ in"):
        write_gns(walkers, tmp_path / "no", bounds=[[-1e12] * 2, [1e12] * 2])
    for bounds in ([[0, 0], [1e-320, 1e-320]], [[-1e308] * 2, [1e308] * 2], [[50, 50], [60, 60]]):
        with pytest.raises(substep.InputError, match="bounds: "):
            write_gns(walkers, tmp_path / "no", bounds=bounds)
    with walkers[3].recording() as recording:  # the first that is done
        x = np.stack([recording["particles"].points(k) for k in range(5)])
    middle = np.median(x[..., 0])
    frame, particle = np.argwhere(x[..., 0] > middle)[0]
    told = rf"in run 3, frame {frame}, particle {particle} is at x = .* between -8 and "
    with pytest.raises(substep.InputError, match=f"bounds: expected all particles .* {told}"):
        write_gns(walkers, tmp_path / "no", bounds=[[-8, -4], [middle, 4]])
    assert not (tmp_path / "no").exists()
    folder = write_gns(
        walkers,
        tmp_path,
        bounds=[[-8, -4], [8, 4]],
        radius=1,
        fractions=(2 / 3, 1 / 3, 0),
        material="count",
    )
    data = json.loads((folder / "metadata.json").read_text())
    assert data["bounds"] == [[0.1, 0.9], [0.1, 0.5]] and data["dim"] == 2
    assert data["sequence_length"] == 4 and data["dt"] == 2.5
    assert data["default_connectivity_radius"] == pytest.approx(0.05)
    # As the data loader of gns does.
    sets = {}
    for split in ("train", "valid", "test"):
        with np.load(folder / f"{split}.npz", allow_pickle=True) as file:
            sets[split] = [item for _, item in file.items()]
    assert [len(entries) for entries in sets.values()] == [4, 2, 0]  # by seeds
    entries = sets["train"]
    for positions, types, material in entries + sets["valid"]:
        assert set(material) == {len(types)}
        assert positions.dtype == np.float32 and positions.shape == (5, len(types), 2)
        assert types.dtype == np.int64 and set(types) == {6}
    velocities = np.concatenate([np.diff(p, axis=0).reshape(-1, 2) for p, *_ in entries])
    assert np.allclose(data["vel_mean"], velocities.mean(0), atol=1e-7)
    assert np.allclose(data["vel_std"], velocities.std(0), rtol=1e-5)
    with (
        walkers[3].recording() as recording,
        np.load(
            folder / ("train.npz" if 3 in _numbers(folder / "train.npz") else "valid.npz"),
            allow_pickle=True,
        ) as file,
    ):
        positions = file["simulation_trajectory_3"][0]
        back = (positions - 0.1) / data["scale"] + data["origin"]
        assert np.allclose(back[2], recording["particles"].points(2), atol=1e-5)


def _numbers(path):
    with np.load(path, allow_pickle=True) as file:
        return [int(name.rpartition("_")[2]) for name in file]


def test_functions_return_arrays_and_failures_are_tried_again(tmp_path):
    broken = tmp_path / "broken"
    broken.touch()

    def work(side, kind, seed):
        if side == 2 and kind == "b" and broken.exists():
            raise ValueError("two\nlines")
        return {"area": side**2 + seed, "name": kind}

    given = {"side": np.arange(1, 4), "kind": ["a", "b"]}
    ended = []
    runs = substep.sweep(
        work, given, tmp_path / "out", repeats=2, workers=2, on_run=lambda *args: ended.append(args)
    )
    assert [run.index for run in runs.failed] == [6, 7] and len(ended) == 12
    assert ended[-1] == (12, 12, 2)
    assert runs.failed[0].error == "ValueError: two"
    assert "Traceback" in (runs[6].path / "error.txt").read_text()
    area = runs.arrays()["area"]
    assert np.isnan(area[1, 1]).all() and area[2, 0].tolist() == [9, 10]
    before = {
        run.index: (run.path / "result.npz").stat().st_mtime_ns for run in runs if not run.error
    }

    broken.unlink()
    again = substep.sweep(work, given, tmp_path / "out", repeats=2, workers=2)
    assert not again.failed and again.arrays()["area"].dtype == np.int64
    assert again.arrays()["name"][1, 1, 0] == "b"
    after = {index: (again[index].path / "result.npz").stat().st_mtime_ns for index in before}
    assert before == after  # none twice
    with pytest.raises(substep.InputError, match=r"repeats: the sweep in .* has 2, got 3"):
        substep.sweep(work, given, tmp_path / "out", repeats=3)

    def odd(k):
        if k == 0:
            os._exit(1)
        if k == 1:
            sys.exit("enough")
        time.sleep(0.05)
        return {("file", "a.npy", "a\0")[k - 2]: 1.0} if k < 5 else {"a": 1.0}

    found = substep.sweep(odd, {"k": range(12)}, tmp_path / "odd", workers=2)
    assert [run.index for run in found.failed] == [0, 1, 2, 3, 4]
    assert [run.error.partition(":")[0] for run in found.failed] == [
        "the process died 3 times in this run",
        "SystemExit",
        *3 * ["InputError"],
    ]
    (found[7].path / "result.npz").write_bytes(b"PK")
    with pytest.raises(substep.CorruptError, match="remove the folder"):
        found[7].result()
    with pytest.raises(substep.InputError, match="as its result, got int"):
        raise substep.InputError(
            substep.sweep(lambda: 3, {}, tmp_path / "int", workers=1).failed[0].error
        )


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("task: expected a scene", {"task": 3}),
        ("neither a built-in scene", {"task": "kepller"}),
        ("parameters: expected a mapping", {"parameters": [1]}),
        (r"parameters\['particls'\]: double-gyre has no such", {"parameters": {"particls": 1}}),
        (
            r"parameters\['particles'\]: expected an integer",
            {"parameters": {"particles": [1, "a"]}},
        ),
        (r"parameters\['particles'\]: expected at least one", {"parameters": {"particles": []}}),
        (r"parameters\['step'\]: expected finite", {"parameters": {"step": [0.1, np.nan]}}),
        ("seeds are set by", {"parameters": {"seed": 1}}),
        ("at most 1000000 runs", {"parameters": {"particles": range(1, 5000)}, "repeats": 5000}),
        ("frames: expected an integer from 2", {"frames": 1}),
        ("repeats: expected", {"repeats": 0}),
        ("seed: expected", {"seed": -1}),
        ("workers: expected", {"workers": 0}),
        ("scheduler: expected an address", {"scheduler": "x"}),
        ("repeats: expected", {"repeats": 2**63}),
        ("expected integers of 64 bits", {"parameters": {"particles": 10**5000}}),
        ("fps: expected", {"fps": np.nan}),
        ("the function does not take them", {"task": lambda a: {}, "parameters": {"b": 1}}),
        ("would be the same", {"task": lambda: {}, "repeats": 2}),
        ("for scenes only", {"task": lambda: {}, "frames": 3}),
        ("cannot be sent", {"task": (lambda lock: lambda: lock)(threading.Lock())}),
    ],
)
def test_wrong_input_is_refused_before_any_run(words, options, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(substep.InputError, match=words):
        substep.sweep(options.pop("task", "double-gyre"), out=out, **options)
    assert not [path for path in out.glob("*") if path.is_dir()]


def test_folders_of_others_are_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(substep.InputError, match="out: expected a folder that is empty"):
        substep.sweep("double-gyre", out=tmp_path)
    for content in (b"{", b"[]", b'{"task": "x"}', b'{"repeats": NaN}'):
        (tmp_path / "sweep.json").write_bytes(content)
        with pytest.raises(substep.FormatError, match=r"sweep\.json"):
            substep.RunCollection(tmp_path)


def test_processes_draw_numbers_of_their_own(tmp_path):
    """They are forks of one process, but not of its random numbers."""

    def work(k):
        time.sleep(0.1)  # each of two takes some
        return {"numpy": np.random.rand(), "python": random.random()}  # noqa: NPY002

    found = substep.sweep(work, {"k": range(12)}, tmp_path, workers=2).arrays()
    for name in ("numpy", "python"):
        assert len(set(found[name].ravel().tolist())) == 12


def test_killed_processes_lose_nothing(tmp_path):
    """Processes die of kill -9 while the runs go on, also the one that the others are forks of."""
    log = tmp_path / "log"

    def work(k, seed):
        with open(log, "a") as file:
            file.write(f"{k}\n")
        time.sleep(0.03)
        return {"x": np.random.default_rng([k, seed]).normal(size=3)}

    kills, over, choose = [], threading.Event(), random.Random(1)

    def kill():
        while not over.is_set() and len(kills) < 6:
            time.sleep(0.2)
            for child in psutil.Process().children(recursive=True):
                if "multiprocessing.forkserver" in " ".join(child.cmdline()):
                    if choose.random() < 0.5:
                        child.kill()
                        kills.append(child.pid)
                        break

    def guarded():
        while not over.is_set() and len(kills) < 6:
            try:
                kill()
            except psutil.Error:
                continue

    killer = threading.Thread(target=guarded)
    killer.start()
    try:
        runs = substep.sweep(work, {"k": range(60)}, tmp_path / "out", workers=2)
    finally:
        over.set()
        killer.join()
    assert len(kills) > 2
    assert not runs.failed
    found = runs.arrays()["x"]
    for k in range(60):
        assert np.array_equal(found[k, 0], np.random.default_rng([k, 0]).normal(size=3))
    begun = log.read_text().split()
    assert len(set(begun)) == 60 and len(begun) <= 60 + len(kills)


def test_a_killed_sweep_goes_on(tmp_path):
    line = [sys.executable, "-m", "substep", "sweep", WALKERS, "--set", "pause=0.01", "--repeats"]
    line += ["40", "--workers", "2", "--out", str(tmp_path / "out")]
    first = subprocess.Popen(line, start_new_session=True)
    while len(list(tmp_path.glob("out/*/*.vtkhdf"))) < 10:
        assert first.poll() is None
        time.sleep(0.02)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    done = {
        run.index: (run.path / "walkers.vtkhdf").stat().st_mtime_ns
        for run in substep.RunCollection(tmp_path / "out")
        if run.state == "done"
    }
    assert 10 <= len(done) < 40
    assert subprocess.run(line, capture_output=True, check=False).returncode == 0
    runs = substep.RunCollection(tmp_path / "out")
    assert repr(runs).endswith("40 done)")
    for index, time_ns in done.items():
        assert (runs[index].path / "walkers.vtkhdf").stat().st_mtime_ns == time_ns
