"""Exports read back by Blender itself: counts, places, units and the axis that is up."""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
import substep
from substep.export import save
from substep.render import CameraPath, Look, View, save_movie, save_picture

if importlib.util.find_spec("bpy") is None:
    pytest.skip("bpy is not installed", allow_module_level=True)

pytestmark = pytest.mark.slow

# Of every object with points, by time and name: how many, and the box that they fill in the world.
READ = """
import bpy, json, sys
import numpy as np
path, rate = sys.argv[1], float(sys.argv[2])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
if path.endswith(".abc"):
    bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
elif path.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=path)
else:
    bpy.ops.wm.usd_import(filepath=path, set_frame_range=True)
found = {"unit": scene.unit_settings.scale_length, "frames": []}
for k in (0, 2, 4):
    # A time code of USD is a frame; Alembic and glTF have seconds.
    at = k if ".usd" in path else k * scene.render.fps / scene.render.fps_base / rate
    scene.frame_set(int(at), subframe=at - int(at))
    graph = bpy.context.evaluated_depsgraph_get()
    boxes = {}
    for thing in bpy.data.objects:
        seen = thing.evaluated_get(graph)
        if thing.type == "MESH":
            points = [seen.matrix_world @ v.co for v in seen.data.vertices]
        elif thing.type == "POINTCLOUD":
            points = [seen.matrix_world @ v.co for v in seen.data.points]
            found["radius"] = seen.data.points[0].radius
        else:
            continue
        points = np.array(points)
        if min(seen.scale) > 0:
            boxes[thing.name] = [len(points), points.min(0).tolist(), points.max(0).tolist()]
    found["frames"].append(boxes)
print("found", json.dumps(found))
"""
RATE, FRAMES = 20.0, 5
TURN = np.sqrt(0.5)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A tilted brick that falls, drops that rise, some that come, cloth, and smoke in one cell."""
    brick = substep.Box((0.4, 0.3, 0.2)).mesh()
    shapes = {
        "shape_vertices": brick.vertices,
        "shape_faces": brick.faces,
        "shape_bodies": np.zeros((8, 1), int),
    }
    sheet = substep.geometry.grid_mesh(3, 3, (1.0, 1.0))
    box = [[0, 0, 0], [1, 1, 2]]
    parts = {
        "bricks": substep.Part("bodies", {"orientation": "1"}, **shapes),
        "drops": substep.Part("particles", {"velocity": "m/s"}),
        "coming": substep.Part("particles"),
        "cloth": substep.Part("mesh", triangles=sheet.faces),
        "air": substep.Part("grid", {"smoke": "1"}, bounds=box, cell=0.25),
    }
    drops = np.stack(np.meshgrid(*3 * [np.arange(4.0)], indexing="ij"), -1).reshape(-1, 3)
    up = np.array([0.0, 0.0, 1.0])
    path = tmp_path_factory.mktemp("blender") / "all.vtkhdf"
    with substep.Recorder(path, parts=parts) as recorder:
        for k in range(FRAMES):
            smoke = np.zeros((4, 4, 8))
            smoke[1, 2, k] = 1
            frame = {
                "bricks": {"points": [[1, 2, 3 - 0.5 * k]], "orientation": [[TURN, 0, 0, TURN]]},
                "drops": {"points": drops + k * up, "velocity": 20 * (0 * drops + up)},
                "coming": {"points": drops[: 5 * (k + 1)] - 10},
                "cloth": {"points": sheet.vertices + np.array([5, 0, k])},
                "air": {"smoke": smoke},
            }
            recorder.append(k / RATE, frame)
    return path


def objects(boxes, name):
    """Of Blender's objects that of a part: its name has more to it in glTF and of bodies."""
    [found] = [v for key, v in boxes.items() if key.startswith(name) or name in key]
    return found[0], np.array(found[1:])


@pytest.mark.parametrize("suffix", ["usdc", "abc", "glb"])
def test_blender_reads_what_was_exported(recording, tmp_path, suffix):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    if suffix == "glb":
        pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    [path] = save(recording, tmp_path / f"all.{suffix}")
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path), str(RATE)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-1000:]
    found = json.loads(done.stdout.rpartition("found ")[2].splitlines()[0])
    assert found["unit"] == 1  # metres
    for k, boxes in zip((0, 2, 4), found["frames"], strict=True):
        count, box = objects(boxes, "body_0")
        assert count == 8  # turned by 90 degrees about the vertical, which is z
        half = np.array([0.15, 0.2, 0.1])
        center = np.array([1, 2, 3 - 0.5 * k])
        np.testing.assert_allclose(box, [center - half, center + half], atol=1e-5)
        count, box = objects(boxes, "drops")
        assert count == 64
        np.testing.assert_allclose(box, [[0, 0, k], [3, 3, 3 + k]], atol=1e-5)
        count, box = objects(boxes, "coming")
        assert count == 5 * (k + 1)
        np.testing.assert_allclose(box[0], [-10, -10, -10], atol=1e-5)
        count, box = objects(boxes, "cloth")
        assert count == 9
        np.testing.assert_allclose(box, [[4.5, -0.5, k], [5.5, 0.5, k]], atol=1e-5)
    if suffix == "usdc":
        assert found["radius"] == pytest.approx(0.5)


READ_VOLUME = """
import bpy, json, sys
sys.path.append(bpy.utils.resource_path("LOCAL") + "/python/lib/python3.11/site-packages")
import openvdb
[grid], _ = openvdb.readAll(sys.argv[1])
[value] = list(grid.iterOnValues())
place = grid.transform.indexToWorld(value.min)
print("found", json.dumps([grid.name, value.value, list(place)]), flush=True)
"""


def test_volumes(recording, tmp_path):
    paths = save(recording, tmp_path / "all.vdb")
    assert [p.name for p in paths] == [f"all-air-{k:04d}.vdb" for k in range(FRAMES)]
    done = subprocess.run(
        [sys.executable, "-c", READ_VOLUME, str(paths[3])], capture_output=True, text=True
    )
    found = json.loads(done.stdout.rpartition("found ")[2].splitlines()[0])
    assert found == ["smoke", 1, [0.375, 0.625, 0.875]]  # the middle of cell (1, 2, 3)


def middle(path):
    """Of what is red, in pixels; and how much of it there is."""
    from matplotlib.image import imread

    image = imread(path)[..., :3]
    rows, columns = np.nonzero(image[..., 0] > 0.1 + 2 * image[..., 1:].max(axis=2))
    return np.array([columns.mean(), rows.mean()]), len(rows)


def test_cycles_sees_what_vtk_sees(recording, tmp_path):
    """The same camera: a red brick is in the same pixels, by both engines."""
    pytest.importorskip("pyvista", reason="PyVista is not installed")
    others = {name: Look(hidden=True) for name in ("drops", "coming", "cloth", "air")}
    camera = CameraPath([0.0, 0.2], [(4, -2, 4), (3, -3, 2)], [(1, 2, 3), (1, 2, 1.5)])
    view = View(camera, {"bricks": Look("#ff0000"), **others}, ground=lambda recording: 0.0)
    seen = {}
    for engine in ("vtk", "cycles"):
        out = tmp_path / f"{engine}.png"
        save_picture(recording, out, frame=3, view=view, size=(320, 180), engine=engine, samples=4)
        seen[engine] = middle(out)
    assert np.allclose(seen["vtk"][0], seen["cycles"][0], atol=1.0)
    assert seen["cycles"][1] == pytest.approx(seen["vtk"][1], rel=0.15)
    out = save_movie(
        recording, tmp_path / "a.mp4", view=view, size=(64, 36), engine="cycles", samples=1
    )
    assert out.stat().st_size > 1000
    flat = View(camera, {"bricks": Look("#ff0000"), **others})
    with pytest.raises(substep.InputError, match="engine: expected"):
        save_picture(recording, tmp_path / "x.png", view=flat, engine="eevee")
