"""Recordings in other forms: each is read back by a library that knows the form."""

import csv

import numpy as np
import pytest
import substep
from substep.cli import main
from substep.export import save
from substep.export.save import SUFFIXES
from substep.render import Look, View

TURN = np.sqrt(0.5)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Three frames, 0.1 s apart, of a part of every kind."""
    mesh = substep.geometry.grid_mesh(3, 3, (1.0, 1.0))
    solid = substep.geometry.box_tetrahedra((1, 1, 1), (1, 1, 1))
    brick = substep.Box((2.0, 1.0, 0.5)).mesh()
    shapes = {
        "shape_vertices": brick.vertices,
        "shape_faces": brick.faces,
        "shape_bodies": np.ones((8, 1), int),  # the first stone has no shape
    }
    parts = {
        "drops": substep.Part("particles", {"velocity": "m/s", "heat": "K"}),
        "stones": substep.Part("bodies", {"orientation": "1"}, **shapes),
        "cloth": substep.Part("mesh", {"strain": "1"}, triangles=mesh.faces),
        "rope": substep.Part("mesh", edges=[[0, 1], [1, 2]]),
        "jelly": substep.Part("mesh", tetrahedra=solid.tetrahedra),
        "floor": substep.Part("mesh", triangles=mesh.faces, points=mesh.vertices),
        "air": substep.Part("grid", {"smoke": "1"}, bounds=[[0, 0, 0], [2, 1, 1]], cell=1.0),
    }
    path = tmp_path_factory.mktemp("export") / "all.vtkhdf"
    with substep.Recorder(path, parts=parts) as recorder:
        for k in range(3):
            drops = np.arange(12.0).reshape(4, 3) + k
            frame = {
                "drops": {"points": drops, "velocity": drops + 1, "heat": np.arange(4.0) + k},
                "stones": {
                    "points": [[k, 0, 1], [0, k, 2]],
                    "orientation": [[1, 0, 0, 0], [TURN, 0, 0, TURN]],
                },
                "cloth": {
                    "points": mesh.vertices + np.array([0, 0, k]),
                    "strain": np.full(9, 0.1 * k),
                },
                "rope": {"points": [[0, 0, k], [1, 0, k], [2, 0, k]]},
                "jelly": {"points": solid.vertices * (1 + k)},
                "air": {"smoke": np.full((2, 1, 1), k)},
            }
            recorder.append(0.1 * k, frame)
    return path


def test_usd_has_every_part(recording, tmp_path):
    pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    assert pxr
    for suffix in (".usda", ".usdc"):
        [path] = save(recording, tmp_path / f"all{suffix}")
        stage = Usd.Stage.Open(str(path))
        assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 2)
        assert stage.GetTimeCodesPerSecond() == pytest.approx(10)

        def at(name, kind, stage=stage):
            return kind(stage.GetPrimAtPath(f"/recording/{name}"))

        drops = at("drops", UsdGeom.Points)
        for k in range(3):
            points = np.array(drops.GetPointsAttr().Get(k))
            assert np.array_equal(points, np.arange(12).reshape(4, 3) + k)
            assert np.array_equal(np.array(drops.GetVelocitiesAttr().Get(k)), points + 1)
        assert drops.GetWidthsAttr().Get()[0] == pytest.approx(np.sqrt(27))
        heat = UsdGeom.PrimvarsAPI(drops).GetPrimvar("heat")
        assert list(heat.Get(2)) == [2, 3, 4, 5] and heat.GetInterpolation() == "vertex"
        cloth = at("cloth", UsdGeom.Mesh)
        assert list(cloth.GetFaceVertexCountsAttr().Get()) == 8 * [3]
        assert np.array(cloth.GetPointsAttr().Get(2))[:, 2].tolist() == 9 * [2]
        assert len(at("jelly", UsdGeom.Mesh).GetFaceVertexCountsAttr().Get()) == 12  # of a box
        rope = at("rope", UsdGeom.BasisCurves)
        assert list(rope.GetCurveVertexCountsAttr().Get()) == [2, 2]
        assert np.array(rope.GetPointsAttr().Get(1))[:, 0].tolist() == [0, 1, 1, 2]
        floor = at("floor", UsdGeom.Mesh).GetPointsAttr()
        assert floor.GetNumTimeSamples() == 0 and len(floor.Get()) == 9
        stone = at("stones/body_1", UsdGeom.Xformable).ComputeLocalToWorldTransform(2)
        assert np.allclose(stone.Transform((1, 0, 0)), (0, 3, 2))  # turned by 90 degrees about z
        shape = at("stones/body_1/body_1_shape", UsdGeom.Mesh)
        assert np.ptp(np.array(shape.GetPointsAttr().Get()), axis=0).tolist() == [2, 1, 0.5]
        assert not stage.GetPrimAtPath("/recording/stones/body_0/body_0_shape")
        box = np.array(at("cloth", UsdGeom.Mesh).GetExtentAttr().Get(2))
        assert np.allclose(box, [[-0.5, -0.5, 2], [0.5, 0.5, 2]])
        wide = np.array(drops.GetExtentAttr().Get(0))  # points, and half the width of each
        half = 0.5 * np.sqrt(27)
        assert np.allclose(wide, [np.arange(3) - half, np.arange(9, 12) + half])
        assert not stage.GetPrimAtPath("/recording/air")


def test_gltf_moves_as_the_recording_does(recording, tmp_path):
    """Of its nodes and morph targets, as viewers add them up; y is up."""
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    [path] = save(recording, tmp_path / "all.glb")
    gltf = pygltflib.GLTF2().load(str(path))
    blob = gltf.binary_blob()

    def array(number):
        accessor = gltf.accessors[number]
        start = gltf.bufferViews[accessor.bufferView].byteOffset
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        dtype = "<f4" if accessor.componentType == pygltflib.FLOAT else "<u4"
        return np.frombuffer(blob, dtype, accessor.count * width, start).reshape(-1, width)

    nodes = {node.name: k for k, node in enumerate(gltf.nodes)}
    assert "air" not in nodes and gltf.scenes[0].nodes == [0]
    assert np.allclose(gltf.nodes[0].rotation, [-TURN, 0, 0, TURN])  # z to y
    [animation] = gltf.animations
    moved = {}
    for channel in animation.channels:
        sampler = animation.samplers[channel.sampler]
        assert np.allclose(array(sampler.input)[:, 0], [0, 0.1, 0.2])
        moved[channel.target.node, channel.target.path] = array(sampler.output)
    stone = nodes["stones-body_1"]
    assert moved[stone, "translation"].tolist() == [[0, 0, 2], [0, 1, 2], [0, 2, 2]]
    assert np.allclose(moved[stone, "rotation"], [0, 0, TURN, TURN])  # x, y, z, w
    assert gltf.nodes[nodes["stones-body_0"]].mesh is None
    [primitive] = gltf.meshes[gltf.nodes[stone].mesh].primitives
    assert len(array(primitive.indices)) == 36
    [primitive] = gltf.meshes[gltf.nodes[nodes["cloth"]].mesh].primitives
    weights = moved[nodes["cloth"], "weights"].reshape(3, 2)
    for k in range(3):
        points = array(primitive.attributes.POSITION) + sum(
            w * array(target["POSITION"])
            for w, target in zip(weights[k], primitive.targets, strict=True)
        )
        assert points[:, 2].tolist() == 9 * [k]


def test_surfaces_of_liquids(tmp_path, capsys):
    """A ball of particles that is larger in the second frame: its faces are others there."""
    pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    grid = np.stack(np.meshgrid(*3 * [np.arange(-6.0, 7)]), -1).reshape(-1, 3)
    with substep.Recorder(tmp_path / "a.vtkhdf", parts={"drop": substep.Part()}) as recorder:
        for k, size in enumerate((4.2, 6.2)):
            ball = grid[np.linalg.norm(grid, axis=1) < size]
            recorder.append(k, {"drop": {"points": 0.1 * ball}})
    told = ["export", str(tmp_path / "a.vtkhdf"), "--out", str(tmp_path / "a.usdc")]
    assert main([*told, "--liquid", "drop=0.05"]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    drop = UsdGeom.Mesh(stage.GetPrimAtPath("/recording/drop"))
    for k, radius in enumerate((0.42, 0.62)):
        points = np.array(drop.GetPointsAttr().Get(k))
        faces = np.array(drop.GetFaceVertexIndicesAttr().Get(k)).reshape(-1, 3)
        assert substep.geometry.TriangleMesh(points.astype(float), faces).report().closed
        assert np.linalg.norm(points, axis=1).mean() == pytest.approx(radius, rel=0.1)
    assert main([*told, "--liquid", "drip=0.05"]) == 2
    assert "liquids: expected one of drop; got 'drip'" in capsys.readouterr().err
    with pytest.raises(substep.InputError, match=r"liquids: \.csv files hold no surfaces"):
        save(tmp_path / "a.vtkhdf", tmp_path / "a.csv", liquids={"drop": 0.05})


def test_usd_of_a_plane_stands_upright(tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    run = substep.scenes.run("double-gyre", {"particles": 5}, tmp_path, frames=2)
    assert main(["export", str(run.recording), "--out", str(tmp_path / "a.usdc")]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    points = UsdGeom.Points(stage.GetPrimAtPath("/recording/particles"))
    with substep.Recording(run.recording) as recording:
        plane = recording["particles"].points(1)
    found = np.array(points.GetPointsAttr().Get(1))
    assert np.allclose(found[:, [0, 2]], plane) and not found[:, 1].any()


def test_arrays(recording, tmp_path):
    [path] = save(recording, tmp_path / "all.npz")
    with np.load(path) as file:
        assert file["times"].tolist() == [0.0, 0.1, 0.2]
        assert file["drops/points"].shape == (3, 4, 3)
        assert file["drops/heat"][:, 0].tolist() == [0, 1, 2]
        assert file["air/smoke"].shape == (3, 2, 1, 1)
        assert file["floor/points"].shape == (9, 3) and file["jelly/mesh/tetrahedra"].shape[1] == 4


def test_arrays_of_particles_that_come(tmp_path):
    with substep.Recorder(tmp_path / "a.vtkhdf", parts={"p": substep.Part()}) as recorder:
        for k in range(2):
            recorder.append(k, {"p": {"points": np.zeros((k + 1, 2))}})
    [path] = save(tmp_path / "a.vtkhdf", tmp_path / "a.npz")
    with np.load(path) as file:
        assert file["p/points/0001"].shape == (2, 2)


def test_tables(recording, tmp_path):
    paths = save(recording, tmp_path / "all.csv")
    assert [p.name for p in paths] == [
        f"all-{name}.csv" for name in ("drops", "stones", "cloth", "rope", "jelly")
    ]
    with open(paths[0], newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12 and list(rows[0])[:6] == ["frame", "time", "index", "x", "y", "z"]
    last = rows[-1]
    assert (last["frame"], last["time"], last["index"]) == ("2", "0.2", "3")
    assert (last["x"], last["velocity_2"], last["heat"]) == ("11.0", "14.0", "5.0")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".vtu"])
def test_meshes(recording, tmp_path, suffix, capfd):
    meshio = pytest.importorskip("meshio", reason="meshio is not installed")
    paths = {p.name: p for p in save(recording, tmp_path / f"all{suffix}")}
    assert f"all-floor{suffix}" in paths and f"all-cloth-0002{suffix}" in paths
    mesh = meshio.read(paths[f"all-cloth-0002{suffix}"])
    assert mesh.points[:, 2].tolist() == 9 * [2]
    assert len(mesh.get_cells_type("triangle")) == 8
    if suffix != ".obj":  # which has no fields
        assert mesh.point_data["strain"] == pytest.approx(np.full(9, 0.2))
    assert capfd.readouterr().err == ""  # where meshio warns
    assert main(["export", str(recording), "--out", str(tmp_path / f"all{suffix}")]) == 0
    lines = capfd.readouterr().out.splitlines()
    told = [f"written: {len(paths)} files, "] if len(paths) > 4 else len(paths) * ["written: "]
    assert all(line.startswith(begin) for line, begin in zip(lines, told, strict=True))


@pytest.mark.parametrize("name", ["a.fbx", "a", "a.mp4"])
def test_unknown_suffixes_are_refused(recording, tmp_path, name, capsys):
    assert main(["export", str(recording), "--out", str(tmp_path / name)]) == 2
    assert "expected a file ending in .vtkhdf, .usd" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_grids_alone_are_for_arrays(tmp_path):
    part = substep.Part("grid", {"a": "1"}, bounds=[[0, 0], [1, 1]], cell=1.0)
    with substep.Recorder(tmp_path / "a.vtkhdf", parts={"air": part}) as recorder:
        recorder.append(0.0, {"air": {"a": np.zeros((1, 1))}})
    for suffix in (".csv", ".ply", ".usdc"):
        with pytest.raises(substep.InputError, match=r"grids alone.*write \.npz"):
            save(tmp_path / "a.vtkhdf", tmp_path / f"b{suffix}")
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtkhdf"]


def test_the_recording_is_not_written_over(recording, tmp_path):
    same = tmp_path / "same.npz"
    same.write_bytes(recording.read_bytes())
    with pytest.raises(substep.InputError, match="is the recording itself"):
        save(same, same)
    assert same.read_bytes() == recording.read_bytes()


def test_the_case_of_names_counts(recording, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    with substep.Recording(recording) as opened:
        assert "velocity" in opened.parts["drops"].fields
        for told, refused in (
            ("color", lambda: opened.to_html(tmp_path / "a.html", color="Velocity")),
            ("color", lambda: substep.show(opened, color="Velocity", open_browser=False)),
            ("liquids", lambda: save(recording, tmp_path / "a.usda", liquids={"Drops": 0.1})),
            ("looks", lambda: View(looks={"Drops": Look()}).check(opened)),
            ("color", lambda: View(color="Velocity").check(opened)),
        ):
            with pytest.raises(substep.InputError, match=f"^{told}: "):
                refused()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("suffix", "module"), [(".usda", "pxr"), (".glb", "pygltflib")])
def test_what_float32_cannot_hold_is_refused(tmp_path, suffix, module):
    pytest.importorskip(module, reason=f"{module} is not installed")
    for name, far, step in (("far", 1e300, 0.1), ("near", 1.0, 1e-60)):
        with substep.Recorder(tmp_path / f"{name}.vtkhdf", parts={"p": substep.Part()}) as recorder:
            for k in range(2):
                recorder.append(k * step, {"p": {"points": [[far, k, 0], [0, 0, 1]]}})
        with pytest.raises(substep.InputError, match=r"^recording: .*float32"):
            save(tmp_path / f"{name}.vtkhdf", tmp_path / f"a{suffix}")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["far.vtkhdf", "near.vtkhdf"]


def test_names_that_usd_makes_alike_and_frames_without_points(tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd

    part = substep.Part("particles", {"velocity": "m/s", "time": "s", "a-b": "1", "a_b": "1"})
    with substep.Recorder(tmp_path / "a.vtkhdf", parts={"a-b": part, "a_b": part}) as recorder:
        for n in (0, 2):
            one = {"points": np.zeros((n, 3)), "velocity": np.zeros((n, 4)), "time": np.zeros(n)}
            frame = {"a-b": one | {"a-b": np.zeros(n), "a_b": np.ones(n)}}
            recorder.append(n, frame | {"a_b": frame["a-b"]})
    [path] = save(tmp_path / "a.vtkhdf", tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(path))
    for name in ("a_b", "a_b__1"):
        prim = stage.GetPrimAtPath(f"/recording/{name}")
        assert prim.GetAttribute("primvars:a_b").Get(1)[0] == 0
        assert prim.GetAttribute("primvars:a_b__1").Get(1)[0] == 1
        assert not prim.GetAttribute("velocities").HasValue()
    table = save(tmp_path / "a.vtkhdf", tmp_path / "a.csv")[0].read_text().splitlines()
    assert len(table) == 3 and table[0].count("time") == 2 and "time_field" in table[0]
    for folder, error in (("none", FileNotFoundError), ("a.vtkhdf", NotADirectoryError)):
        for suffix in SUFFIXES:  # named as the folder that is missing, before anything is done
            with pytest.raises(error, match=f"{folder}'$"):
                save(tmp_path / "a.vtkhdf", tmp_path / folder / f"b{suffix}")
