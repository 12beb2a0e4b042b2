"""Data sets of MeshGraphNets: what meta.json declares is what the arrays are."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import substep
from substep import InputError
from substep.cli import main
from substep.sweeps import write_gns, write_meshgraphnets
from substep.sweeps.training import _split_by_seed

pytest.importorskip("distributed", reason="Dask is not installed")


def trajectories(folder, split, meta):
    """By the number of the run; as a loader reads them, with nothing pickled."""
    found = {}
    for path in sorted((folder / split).glob("trajectory_*.npz")):
        with np.load(path) as file:
            arrays = dict(file)
        assert list(arrays) == meta["field_names"]
        for name, told in meta["features"].items():
            assert arrays[name].dtype.name == told["dtype"]
            length, nodes, width = arrays[name].shape
            assert [length, -1, width] == told["shape"] and nodes > 0
            assert length == (meta["trajectory_length"] if told["type"] == "dynamic" else 1)
        found[int(path.stem.rpartition("_")[2])] = arrays
    return found


def test_cloth_and_the_obstacle_below_it(tmp_path, capsys):
    out = tmp_path / "drapes"
    line = ["sweep", "cloth-drape", "--set", "vertices=8,10", "--set", "cells=16"]
    line += ["--set", "duration=0.2", "--repeats", "3", "--frames", "5", "--workers", "2"]
    assert main([*line, "--to", "meshgraphnets", "--out", str(out)]) == 0
    folder = out / "meshgraphnets"
    assert f"data set: {folder}" in capsys.readouterr().out
    meta = json.loads((folder / "meta.json").read_text())
    assert meta["field_names"] == ["cells", "mesh_pos", "node_type", "world_pos"]
    assert meta["trajectory_length"] == 5 and meta["dt"] == pytest.approx(0.05)
    assert meta["features"]["cells"] == {"type": "static", "dtype": "int32", "shape": [1, -1, 3]}
    sets = [trajectories(folder, split, meta) for split in ("train", "valid", "test")]
    assert sorted(k for part in sets for k in part) == list(range(6))
    runs = substep.RunCollection(out)
    for k, arrays in (item for part in sets for item in part.items()):
        n = runs[k].parameters["vertices"] ** 2
        kinds = arrays["node_type"][0, :, 0]
        assert (kinds[:n] == 0).all() and (kinds[n:] == 1).all() and len(kinds) > n
        with runs[k].recording() as recording:
            points = recording["cloth"].points(3)
        np.testing.assert_array_equal(arrays["world_pos"][3, :n], points.astype(np.float32))
        np.testing.assert_array_equal(arrays["mesh_pos"][0], arrays["world_pos"][0])
        assert np.ptp(arrays["world_pos"][:, n:], axis=0).max() == 0
        of_cloth = (arrays["cells"][0] < n).all(axis=1)
        assert of_cloth.sum() == 2 * (runs[k].parameters["vertices"] - 1) ** 2
        assert (arrays["cells"][0][~of_cloth] >= n).all()


def split_of(seeds, fractions=(0.8, 0.1, 0.1)):
    runs = [SimpleNamespace(seed=seed) for seed in seeds]
    sets = _split_by_seed(runs, np.array(fractions))
    assert sorted(k for chosen in sets for k in chosen) == list(range(len(runs)))
    owners = {
        seed: {k for k, s in enumerate(sets) for i in s if seeds[i] == seed} for seed in seeds
    }
    if len(owners) > 1:
        assert all(len(found) == 1 for found in owners.values())
    return [len(chosen) for chosen in sets]


def test_runs_of_one_seed_stay_together():
    assert split_of([7, 8] * 3) == [3, 3, 0]
    assert split_of([7, 8, 9] * 2) == [2, 2, 2]
    assert split_of([0] * 4) == [2, 1, 1]  # of a single seed one by one
    assert split_of([0]) == [1, 0, 0]
    assert split_of(range(5)) == [3, 1, 1]
    assert split_of(range(20)) == [16, 2, 2]
    assert split_of(range(200)) == [160, 20, 20]
    assert split_of(range(2), (0, 0.5, 0.5)) == [0, 1, 1]
    assert split_of(range(3), (1, 0, 0)) == [3, 0, 0]


def test_folders_that_stay_empty_are_told(tmp_path, capsys):
    line = ["sweep", "cloth-hang", "--set", "vertices=6,8", "--set", "duration=0.1"]
    line += ["--frames", "3", "--workers", "1", "--out", str(tmp_path / "a")]
    assert main([*line, "--to", "meshgraphnets"]) == 0
    assert "substep: warning: no run is left for test: there are 2" in capsys.readouterr().err
    runs = substep.RunCollection(tmp_path / "a")
    with pytest.warns(UserWarning, match="no run is left for test: there are 2"):
        write_meshgraphnets(runs, tmp_path / "data")


def test_what_is_held_and_what_is_solid(tmp_path):
    small = {"vertices": 6, "duration": 0.1}
    runs = substep.sweep("cloth-hang", small, tmp_path / "a", frames=3, workers=1)
    folder = write_meshgraphnets(runs, tmp_path / "data", fractions=(1, 0, 0))
    meta = json.loads((folder / "meta.json").read_text())
    (cloth,) = trajectories(folder, "train", meta).values()
    assert np.bincount(cloth["node_type"].ravel(), minlength=4).tolist() == [34, 0, 0, 2]
    (folder / "train" / "trajectory_7.npz").write_bytes(b"of an older data set")
    (folder / "train" / "trajectory_mine.npz").write_bytes(b"not ours")
    write_meshgraphnets(runs, folder, fractions=(0, 1, 0))  # elsewhere than before
    left = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.npz"))
    assert left == ["train/trajectory_mine.npz", "valid/trajectory_0.npz"]
    with pytest.raises(InputError, match=r"part: expected one of cloth; got 'wool'"):
        write_meshgraphnets(runs, tmp_path / "no", part="wool")
    with pytest.raises(InputError, match="fractions"):
        write_meshgraphnets(runs, tmp_path / "no", fractions=(1, 1, 1))
    with pytest.raises(InputError, match="runs: expected a RunCollection"):
        write_meshgraphnets([1], tmp_path / "no")
    gyre = {"particles": 5, "duration": 0.2}
    points = substep.sweep("double-gyre", gyre, tmp_path / "b", frames=3, workers=1)
    with pytest.raises(InputError, match="part: the recordings have no meshes that move"):
        write_meshgraphnets(points, tmp_path / "no")
    assert not (tmp_path / "no").exists()


CHANNEL = """
import substep
from substep.scenes import Parameter, Scene


def build(parameters, seed):
    ball = substep.Collider(substep.Sphere(0.2, (0.6, 0.5, 0)))
    ball.velocity = (parameters["moves"], 0, 0)
    return substep.GridFlow(
        [(0, 0), (2, 1)],
        0.125,
        viscosity=0.1,
        velocity=(1.0, 0.0),
        colliders=[ball],
        sides=[(substep.gridfluid.Inflow((1.0, 0.0)), "open"), "wall"],
        largest_step=0.05,
    )


duration, moves = Parameter("time", 0.2, unit="s", above=0), Parameter("speed", 0.0, unit="m/s")
SCENE = Scene("channel", "A channel.", {"duration": duration, "moves": moves}, build, frames=5)
"""


def test_flows_have_types_of_their_sides_and_no_nodes_in_obstacles(tmp_path):
    (tmp_path / "channel.py").write_text(CHANNEL)
    runs = substep.sweep(str(tmp_path / "channel.py"), {}, tmp_path / "a", workers=1)
    folder = write_meshgraphnets(runs, tmp_path / "data", fractions=(1, 0, 0))
    with pytest.raises(InputError, match=r"no parts of particles; .* --to meshgraphnets"):
        write_gns(runs, tmp_path / "no")
    meta = json.loads((folder / "meta.json").read_text())
    assert meta["field_names"] == ["cells", "mesh_pos", "node_type", "velocity", "pressure"]
    assert meta["features"]["pressure"] == {
        "type": "dynamic",
        "dtype": "float32",
        "shape": [5, -1, 1],
    }
    (flow,) = trajectories(folder, "train", meta).values()
    x, kinds = flow["mesh_pos"][0], flow["node_type"][0, :, 0]
    ball = np.hypot(x[:, 0] - 0.6, x[:, 1] - 0.5)
    assert ball.min() > 0.2 and len(x) == 16 * 8 - 8
    wall = np.isin(x[:, 1], (0.0625, 0.9375))
    beside = ball < 0.2 + 0.125
    assert (kinds[wall | beside] == 6).all() and (kinds[ball > 0.4][~wall[ball > 0.4]] != 6).all()
    assert (kinds[(x[:, 0] < 0.1) & ~wall] == 4).all() and (kinds == 4).sum() == 6
    assert (kinds[(x[:, 0] > 1.9) & ~wall] == 5).all() and (kinds == 5).sum() == 6
    a, b, c = x[flow["cells"][0]].transpose(1, 0, 2)
    u, v = b - a, c - a
    area = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    np.testing.assert_allclose(area, 0.125**2 / 2, rtol=1e-5)
    middle = (a + b + c) / 3
    assert np.hypot(middle[:, 0] - 0.6, middle[:, 1] - 0.5).min() > 0.2
    with runs[0].recording() as recording:
        name = next(iter(recording.parts))
        at = np.floor(x / 0.125).astype(int)
        for field in ("velocity", "pressure"):
            values = recording[name].field(field, 3)[at[:, 0], at[:, 1]].reshape(len(x), -1)
            np.testing.assert_array_equal(flow[field][3], values.astype(np.float32))
    moving = substep.sweep(str(tmp_path / "channel.py"), {"moves": 0.1}, tmp_path / "b", workers=1)
    with pytest.raises(InputError, match=r"part: .* has obstacles that move"):
        write_meshgraphnets(moving, tmp_path / "no")
    assert not (tmp_path / "no").exists()


PAIR = """
import substep
from substep.scenes import Parameter, Scene


def flow(x, colliders=()):
    return substep.GridFlow(
        [(x, 0), (x + 2, 1)], 0.25, viscosity=0.1, velocity=(1.0, 0.0), largest_step=0.05,
        sides=[(substep.gridfluid.Inflow((1.0, 0.0)), "open"), "wall"], colliders=colliders,
    )


def build(parameters, seed):
    bodies = substep.RigidBodies(gravity=(0, 0, 0))
    motion = "kinematic" if parameters["moves"] else "static"
    ball = bodies.add(substep.Sphere(0.3), (0.6, 0.5, 0), motion=motion)
    left = flow(0.0, bodies.make_colliders(ball))
    return substep.World({"bodies": bodies, "left": left, "right": flow(5.0)})


duration, moves = Parameter("time", 0.2, unit="s", above=0), Parameter("whether it moves", 0.0)
SCENE = Scene("pair", "Two.", {"duration": duration, "moves": moves}, build, frames=3)
"""


def test_a_flow_of_a_world_is_the_member_of_its_name(tmp_path):
    scene, end = tmp_path / "pair.py", {"fractions": (1, 0, 0)}
    scene.write_text(PAIR)
    runs = substep.sweep(str(scene), {}, tmp_path / "a", workers=1)
    found = {}
    for part in ("left", "right"):
        folder = write_meshgraphnets(runs, tmp_path / part, part=part, **end)
        meta = json.loads((folder / "meta.json").read_text())
        (found[part],) = trajectories(folder, "train", meta).values()
    assert found["left"]["mesh_pos"].shape[1] < found["right"]["mesh_pos"].shape[1] == 8 * 4
    assert found["left"]["mesh_pos"].min() < 1 and found["right"]["mesh_pos"][..., 0].min() > 5
    with pytest.raises(InputError, match="part: expected one of left, right; got 'wool'"):
        write_meshgraphnets(runs, tmp_path / "no", part="wool", **end)
    moving = substep.sweep(str(scene), {"moves": 1.0}, tmp_path / "b", workers=1)
    with pytest.raises(InputError, match="part: left has obstacles that move"):  # not yet, though
        write_meshgraphnets(moving, tmp_path / "no", part="left", **end)
    write_meshgraphnets(moving, tmp_path / "right", part="right", **end)
    scene.write_text(PAIR.replace("(x, 0), (x + 2, 1)", "(x - 1, 0), (x + 1, 1)"))
    with pytest.raises(InputError, match="part: right was recorded in cells that the scene no lon"):
        write_meshgraphnets(runs, tmp_path / "no", part="right", **end)
    assert not (tmp_path / "no").exists()


FIELDS = """


def chosen(simulation):
    names = ("velocity", "pressure") if simulation.viscosity < 0.15 else ("velocity",)
    return {name: simulation.fields()[name] for name in names}


def parts(simulation):
    units = {name: unit for name, (_, unit) in chosen(simulation).items()}
    bounds, cell = simulation.bounds, simulation.cell
    return {"air": substep.Part("grid", units, bounds=bounds, cell=cell)}


def frame(simulation):
    return {"air": {name: values for name, (values, _) in chosen(simulation).items()}}


given = {"duration": duration, "viscosity": Parameter("viscosity", 0.1)}
SCENE = Scene("channel", "A channel.", given, build, frames=5, parts=parts, frame=frame)
"""


@pytest.mark.parametrize("viscosities", [[0.1, 0.2], [0.2, 0.1]])
def test_runs_of_other_fields_are_refused_by_number(tmp_path, viscosities):
    text = CHANNEL.replace("viscosity=0.1", 'viscosity=parameters["viscosity"]') + FIELDS
    (tmp_path / "channel.py").write_text(text.replace('parameters["moves"]', "0"))
    values = {"viscosity": viscosities}
    runs = substep.sweep(str(tmp_path / "channel.py"), values, tmp_path / "a", workers=1)
    assert not runs.failed
    with pytest.raises(InputError, match=r"runs: run 1 has velocity.*, but run 0 has velocity"):
        write_meshgraphnets(runs, tmp_path / "no", fractions=(0.5, 0.5, 0))
    for write in (write_meshgraphnets, write_gns):
        with pytest.raises(TypeError, match="out: expected a file name, got 3"):
            write(runs, 3, fractions=(0.5, 0.5, 0))
    assert not (tmp_path / "no").exists()


def test_options_of_the_other_set_are_refused_before_anything_runs(tmp_path, capsys):
    line = ["sweep", "cloth-hang", "--out", str(tmp_path / "x"), "--bounds=0,0,1,1"]
    for to in ([], ["--to", "meshgraphnets"]):
        assert main([*line, *to]) == 2
        assert "--bounds: for --to gns only" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
