"""Scenes in TOML files: what they build, and that every fault names its key and place."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
import substep
from substep.cli import main
from substep.scenes import load, run

LIQUID = """\
[scene]
method = "pbf"
duration = 0.2
frames = 3
spacing = 0.05

[options]
viscosity = 1e-4

[[block]]
low = [0, 0, 0]
high = [0.4, 0.4, 0.4]

[[obstacle]]  # a tank
shape = "box"
lengths = [0.8, 0.4, 3]
position = [0.4, 0.2, 1.5]
hollow = true

[[obstacle]]  # a gate that is pulled up
shape = "box"
lengths = [0.05, 0.5, 0.8]
friction = 0.2
keyframes = [
  {time = 0, position = [0.425, 0.2, 0.4]},
  {time = 0.15, position = [0.425, 0.2, 1.4], rotation_deg = [0, 0, 30]},
]
"""
JELLY = """\
[scene]
method = "mpm"
duration = 0.05
frames = 2
spacing = 0.05

[[material]]
name = "soft"
class = "NeoHookean"
density = 1000
young_modulus = 2e4
poisson_ratio = 0.3

[[material]]
class = "Sand"

[[block]]
low = [0, 0, 0]
high = [0.2, 0.2, 0.2]
material = "soft"

[[block]]
low = [0.3, 0, 0]
high = [0.5, 0.2, 0.2]
material = "Sand"
velocity = [0, 0, 1]

[[obstacle]]
shape = "plane"
normal = [0, 0, 1]
friction = 0.5
"""
RAFT = """\
[scene]
name = "raft"
method = "grid-liquid"
duration = 0.1
frames = 2
spacing = 0.05
bounds = [[0, 0, 0], [0.6, 0.6, 0.8]]

[[block]]
low = [0, 0, 0]
high = [0.6, 0.6, 0.3]

[[body]]
shape = "box"
lengths = [0.2, 0.2, 0.1]
position = [0.3, 0.3, 0.35]
density = 300

[[obstacle]]
shape = "box"
lengths = [0.6, 0.6, 0.8]
position = [0.3, 0.3, 0.4]
hollow = true
"""
BODIES = """\
[scene]
method = "rigid"
duration = 1.0
frames = 2

[[body]]
shape = "sphere"
radius = 0.1
position = [0, 0, 1]
restitution = 0.5
[[body]]
shape = "cylinder"
radius = 0.1
length = 0.3
position = [1, 0, 0.5]
rotation_deg = [90, 0, 0]

[[obstacle]]
shape = "plane"
normal = [0, 0, 1]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(text, name="scene.toml"):
    with open(name, "w", encoding="utf-8") as file:
        file.write(text)
    return load(name)


def test_a_gate_is_where_its_keyframes_say_and_the_water_follows(folder):
    scene = read(LIQUID)
    assert scene.name == "scene" and set(scene.parameters) == {"duration", "spacing"}
    outcome = run(scene, {}, folder / "out")
    with substep.Recording(outcome.recording) as recording:
        gate = [recording["obstacle-1"].points(i).mean(axis=0) for i in range(3)]
        np.testing.assert_allclose(gate[0], [0.425, 0.2, 0.4], atol=1e-6)
        np.testing.assert_allclose(gate[1], [0.425, 0.2, 0.4 + 1 / 1.5], atol=1e-6)
        np.testing.assert_allclose(gate[2], [0.425, 0.2, 1.4], atol=1e-6)
        across = np.ptp(recording["obstacle-1"].points(2), axis=0)[0]
        turn = np.radians(30)
        assert across == pytest.approx(0.05 * np.cos(turn) + 0.5 * np.sin(turn), rel=1e-5)
        first, last = recording["particles"].points(0), recording["particles"].points(2)
        assert len(first) == 8**3 and first[:, 0].max() < 0.4 < last[:, 0].max()
    coarse = run(scene, {"spacing": 0.1}, folder / "coarse")
    with substep.Recording(coarse.recording) as recording:
        assert len(recording["particles"].points(0)) == 4**3


def test_interrupted_runs_of_files_go_on_to_the_same_bits(folder):
    scene = read(LIQUID)
    whole = run(scene, {}, folder / "whole")

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(scene, {}, folder / "parts", on_frame=stop)
    parts = run(read(LIQUID), {}, folder / "parts", resume=True)
    ends = []
    for outcome in (whole, parts):
        with substep.Recording(outcome.recording) as recording:
            ends.append(recording["particles"].points(-1))
    assert (ends[0] == ends[1]).all()


def test_materials_bodies_and_obstacles_of_every_method():
    jelly = read(JELLY).build({"duration": 0.05, "spacing": 0.05}, 0)
    assert [type(m).__name__ for m in jelly.simulation.materials] == ["NeoHookean", "Sand"]
    assert np.bincount(jelly.simulation.kinds).tolist() == [64, 64]
    assert (jelly.simulation.velocities[64:, 2] == 1).all()
    jelly.advance(0.05)
    raft = read(RAFT).build({"duration": 0.1, "spacing": 0.05}, 0)
    raft.advance(0.3)
    bodies = raft.simulation["bodies"]
    assert abs(bodies.velocities[0, 2]) < 0.5 and bodies.positions[0, 2] > 0.25  # it floats
    assert set(raft.parts()) == {"particles", "bodies"} == set(raft.frame())
    falling = read(BODIES).build({"duration": 1.0}, 0)
    falling.advance(2.0)
    heights = falling.simulation["bodies"].positions[:2, 2]
    np.testing.assert_allclose(heights, [0.1, 0.1], atol=0.01)  # the cylinder lies
    assert len(falling.frame()["bodies"]["points"]) > 16


def test_a_mesh_is_read_from_beside_the_file(folder):
    box = substep.geometry.box_mesh((300, 400, 500))
    (folder / "meshes").mkdir()
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.faces]
    (folder / "meshes/box.obj").write_text("\n".join(lines))
    filled = LIQUID.replace(
        "low = [0, 0, 0]\nhigh = [0.4, 0.4, 0.4]",
        'file = "meshes/box.obj"\nup = "y"\nscale = 1e-3\nposition = [0.2, 0.2, 0.2]',
    ).replace("[0.425, 0.2, ", "[5, 0.2, ")
    (folder / "below").mkdir()
    scene = read(filled, "tank.toml")
    x = scene.build({"duration": 1.0, "spacing": 0.05}, 0).simulation.positions
    assert np.ptp(x, axis=0) == pytest.approx([0.35, 0.25, 0.35], abs=0.11)
    outside = filled.replace("meshes/box.obj", "../meshes/box.obj")
    with pytest.raises(substep.InputError, match=r"below/tank.toml:11:1: file: expected a path"):
        read(outside, "below/tank.toml").build({"duration": 1.0, "spacing": 0.05}, 0)


@pytest.mark.parametrize(
    ("good", "old", "new", "told"),
    [
        (LIQUID, 'method = "pbf"\n', "", "1:1: method: scene needs it"),
        (
            LIQUID,
            '"pbf"',
            '"sph"',
            "2:1: method: expected one of pbf, grid-liquid, mpm, mass-spring",
        ),
        (LIQUID, "duration = 0.2", "duration = -1", "3:1: duration: expected a finite number"),
        (LIQUID, "viscosity", "viscosty", "8:1: viscosty: unknown key of options; did you mean"),
        (LIQUID, "viscosity = 1e-4", "viscosity = nan", "8:1: viscosity: expected a finite"),
        (LIQUID, "[[block]]", "[[blok]]", "blok: unknown table; did you mean block?"),
        (LIQUID, "[[block]]", "[block]", "block: expected tables [[block]], got a table"),
        (
            LIQUID,
            "high = [0.4, 0.4, 0.4]",
            "high = [0.4, 0.4]",
            "high: expected 3 numbers, got 2: ",
        ),
        (LIQUID, "high = [0.4, 0.4, 0.4]", "", "high: block needs it"),
        (LIQUID, 'shape = "box"\nlengths = [0.05', 'shape = "bx"\nlengths = [0.05', "21:1: shape"),
        (LIQUID, "friction = 0.2", "friction = -1", "23:1: friction: expected"),
        (LIQUID, "friction = 0.2", "radius = 1", "23:1: radius: unknown key of obstacle"),
        (LIQUID, "friction = 0.2", "position = [0, 0, 0]", "23:1: position: the keyframes say it"),
        (LIQUID, "{time = 0, ", "{time = 0.1, ", "24:1: keyframes: expected ascending times"),
        (LIQUID, "{time = 0, ", "{tme = 0, ", "24:1: keyframes: unknown key tme; did you mean"),
        (
            LIQUID,
            "spacing = 0.05",
            "spacing = 0.05\nbounds = [[0,0,0],[1,1,1]]",
            "6:1: bounds: pbf",
        ),
        (RAFT, "bounds = [[0, 0, 0], [0.6, 0.6, 0.8]]\n", "", "bounds: grid-liquid needs it"),
        (RAFT, "[0.6, 0.6, 0.8]]", "[0.6, 0.6, -1]]", "7:1: bounds: expected the lowest corner"),
        (RAFT, "hollow = true", "velocity = [1, 0, 0]", "velocity: obstacles are still"),
        (RAFT, 'name = "raft"', 'name = "A raft"', "2:1: name: name: expected at most 64"),
        (JELLY, 'class = "Sand"', 'class = "Sandy"', "15:1: class: expected one of FixedCorotated"),
        (JELLY, "poisson_ratio = 0.3", "poisson = 0.3", "12:1: poisson: unknown key of material"),
        (JELLY, "young_modulus = 2e4\n", "", "7:1: young_modulus: material needs it"),
        (JELLY, 'material = "soft"', 'material = "sft"', "20:1: material: no such material; did"),
        (JELLY, 'material = "soft"\n', "", "material: expected one of soft, Sand"),
        (JELLY, "[[obstacle]]", "[[body]]", "a body is no plane; make it an obstacle"),
        (BODIES, "[[body]]", "[[obstacle]]", "rigid needs at least one [[body]]"),
        (BODIES, "radius = 0.1\nposition", "position", "radius: body needs it"),
        (LIQUID, "[scene]", "[scene", "1:7: file: "),
        (LIQUID, "[0, 0, 30]", "[1e300, 0, 0]", "24:1: keyframes: rotation_deg: expected"),
        (LIQUID, "viscosity =", r'"a\n\u001b[31m" =', r"unknown key of options"),
        (LIQUID, "high = [0.4, 0.4, 0.4]", "high = [0.4, 0, 0.4]", "12:1: high: expected numbers"),
        (LIQUID, "spacing = 0.05", "spacing = 3.0", "11:1: low: no particle fits into the block"),
        (
            LIQUID,
            "position = [0.4, 0.2, 1.5]",
            "position = [9, 0, 0]",
            "11:1: low: no particle fits",
        ),
        (RAFT, "0.6, 0.6, 0.8]]", "0.6, 0.6, 0.83]]", "7:1: bounds: "),
        (JELLY, "ratio = 0.3", "ratio = 0.7", "12:1: poisson_ratio: expected"),
        (JELLY, "low = [0.3, 0, 0]", "low = [0.1, 0.1, 0]", "23:1: low: block 2 overlaps block 1"),
    ],
)
def test_faults_are_told_by_key_and_place(folder, capsys, good, old, new, told):
    assert old in good
    (folder / "a.toml").write_text(good.replace(old, new))
    assert main(["run", "a.toml", "--no-picture"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("a.toml:") and told in err and err.count("\n") == 1
    assert err[:-1].isprintable()
    assert [path.name for path in folder.iterdir()] == ["a.toml"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_pipe_is_no_mesh(folder):
    os.mkfifo(folder / "x.obj")
    block = "low = [0, 0, 0]\nhigh = [0.4, 0.4, 0.4]"
    scene = read(LIQUID.replace(block, 'file = "x.obj"'))
    with pytest.raises(substep.InputError, match=r"scene.toml:11:1: file: expected a file"):
        scene.build({"duration": 1.0, "spacing": 0.05}, 0)


def put(path, mesh):
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines))


def documented(folder):
    """The files of docs/scenes.md, and the meshes that they name."""
    docs = Path(__file__).parents[2] / "docs/scenes.md"
    text = docs.read_text(encoding="utf-8")
    put(folder / "meshes/rock.obj", substep.geometry.sphere_mesh(100.0))
    put(folder / "meshes/bust.obj", substep.geometry.sphere_mesh(195.0))
    for k in range(4):
        ball = substep.geometry.sphere_mesh(0.1 + 0.02 * k, (0.5, 0.2, 0.15), 1)
        put(folder / f"meshes/swelling/{k}.obj", ball)
    return re.findall(r"```toml\n(\[scene\].*?)```", text, re.DOTALL)


def test_the_files_in_the_docs_are_scenes(folder):
    gate, cloth, jelly, swelling = documented(folder)
    gate = read(gate, "gate.toml").build({"duration": 1.5, "spacing": 0.05}, 0)
    gate.advance(0.4)
    assert gate.simulation.positions[:, 0].max() > 0.6

    cloth = read(cloth).build({"duration": 1.0, "spacing": 0.1}, 0)
    assert cloth.simulation.pinned.sum() == 11
    cloth.advance(0.5)
    held = cloth.simulation.positions[cloth.simulation.pinned]
    np.testing.assert_allclose(held[:, 2], 0.6)
    assert cloth.simulation.positions[:, 2].min() < 0.5
    assert cloth.parts()["particles"].kind == "mesh"

    jelly = read(jelly).build({"duration": 1.0, "spacing": 0.1}, 0)
    assert type(jelly.simulation).__name__ == "SoftBody"
    start = jelly.frame()["particles"]["points"]
    assert len(start) == 642 and np.linalg.norm(start - [0, 0, 0.3], axis=1).max() < 0.2
    jelly.advance(0.1)
    fallen = jelly.frame()["particles"]["points"][:, 2].mean() - start[:, 2].mean()
    assert fallen == pytest.approx(-9.81 * 21 / 60**2, rel=1e-6)  # implicit Euler in 6 steps

    swelling = read(swelling).build({"duration": 0.5, "spacing": 0.05}, 0)
    radii = []
    for _ in range(2):
        points = swelling.frame()["animation_1"]["points"] - [0.5, 0.2, 0.15]
        radii.append(np.linalg.norm(points, axis=1).mean())
        swelling.advance(0.2)
    np.testing.assert_allclose(radii, [0.1, 0.14], atol=1e-6)
    away = swelling.simulation["particles"].positions - [0.5, 0.2, 0.15]
    assert np.linalg.norm(away, axis=1).min() > 0.15


def test_cloth_solids_and_skins_of_other_methods(folder):
    _, cloth, jelly, _ = documented(folder)
    jelly = jelly.replace("normal = [0, 0, 1]", "normal = [0, 0, 1]\nposition = [0, 0, -1]")
    values = {"duration": 1.0, "spacing": 0.1}
    elastic = "stiffness = 500              # [N/m]\ndamping_time = 0.002         # [s]"
    assert elastic in cloth
    sheet = cloth.replace("mass-spring", "pbd").replace(elastic, "rigidity = 1e-5")
    sheet = read(sheet).build(values, 0)
    sheet.advance(0.3)
    assert sheet.simulation.positions[:, 2].min() < 0.5
    body = read(jelly.replace("soft-body", "pbd")).build(values, 0)
    assert type(body.simulation).__name__ == "PositionBasedDynamics"
    solid = jelly[jelly.index("\n[solid]") : jelly.index("\n[skin]")]
    block = "\n[[block]]\nlow = [-0.2, -0.2, 0.1]\nhigh = [0.2, 0.2, 0.5]\n"
    material = '[[material]]\nclass = "NeoHookean"\nyoung_modulus = 2e4\npoisson_ratio = 0.4\n'
    snow = jelly.replace("soft-body", "mpm").replace(solid, block + material + "density = 500\n")
    snow = read(snow).build(values, 0)
    for one in (body, snow):
        before = one.frame()["particles"]["points"]
        one.advance(0.1)
        assert len(before) == 642
        fall = one.frame()["particles"]["points"][:, 2].mean() - before[:, 2].mean()
        assert fall == pytest.approx(-9.81 / 2 * 0.1**2, rel=0.15)  # by steps of a tenth of it


def test_cloth_and_solids_of_pbd_are_recorded_as_meshes(folder):
    _, cloth, jelly, _ = documented(folder)
    values = {"duration": 1.0, "spacing": 0.1}
    elastic = "stiffness = 500              # [N/m]\ndamping_time = 0.002         # [s]"
    springs = read(cloth).build(values, 0).parts()["particles"].triangles
    sheet = cloth.replace("mass-spring", "pbd").replace(elastic, "")
    for text in (sheet, sheet.replace("size =", "rigidity = 1e-5\nsize =")):
        found = read(text).build(values, 0).parts()["particles"].triangles
        assert set(map(frozenset, found.tolist())) == set(map(frozenset, springs.tolist()))
    solid = re.sub(r"\[skin\].*?\n\n", "", jelly, flags=re.DOTALL)
    part = read(solid).build(values, 0).parts()["particles"]
    same = read(solid.replace("soft-body", "pbd")).build(values, 0)
    found = same.parts()["particles"]
    assert np.unique(found.tetrahedra).size == len(same.simulation) == 5**3
    assert np.array_equal(np.sort(found.tetrahedra, axis=0), np.sort(part.tetrahedra, axis=0))
    outcome = run(read(solid.replace("soft-body", "pbd")), {"spacing": 0.1}, "out", frames=2)
    with substep.Recording(outcome.recording) as recording:
        assert recording.parts["particles"].kind == "mesh"


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 2), (1, 0, 0)])
def test_planes_are_recorded_as_squares_below_what_there_is(normal):
    place = "position = [0, 0, -0.1]\nfriction"
    scene = read(JELLY.replace("[0, 0, 1]\nfr", f"{list(normal)}\nfr").replace("friction", place))
    outcome = run(scene, {}, "out")
    with substep.Recording(outcome.recording) as recording:
        plane, x = recording.parts["obstacle-0"], recording["particles"].points(0)
        corners, n = np.asarray(plane.points), np.array(normal) / np.linalg.norm(normal)
        np.testing.assert_allclose((corners - [0, 0, -0.1]) @ n, 0, atol=1e-12)
        low, high = x.min(axis=0), x.max(axis=0)
        foot = (low + high) / 2 - ((low + high) / 2 - [0, 0, -0.1]) @ n * n
        np.testing.assert_allclose(corners.mean(axis=0), foot, atol=1e-6)
        sides = np.linalg.norm(np.roll(corners, 1, axis=0) - corners, axis=1)
        np.testing.assert_allclose(sides, np.linalg.norm(high - low), rtol=1e-6)
        a, b, c = (corners[k] for k in np.asarray(plane.triangles)[0])
        assert np.cross(b - a, c - a) @ n > 0
    scene = read(BODIES).build({"duration": 1.0}, 0)
    assert {"bodies", "obstacle-0"} == set(scene.parts()) and set(scene.frame()) == {"bodies"}


def test_margins_and_neighbours_reach_the_classes(folder):
    _, cloth, jelly, _ = documented(folder)
    options = "\n[options]\ncontact_margin = 0.07\n"
    values = {"duration": 1.0, "spacing": 0.1}
    elastic = "stiffness = 500              # [N/m]\ndamping_time = 0.002         # [s]"
    for text in (cloth, cloth.replace("mass-spring", "pbd").replace(elastic, ""), jelly):
        one, plain = read(text + options).build(values, 0), read(text).build(values, 0)
        for each in (one, plain):
            each.advance(0.6)
        gap = [
            min(c.distance(e.simulation.positions).min() for c in e.simulation.colliders)
            for e in (one, plain)
        ]
        assert gap[0] > gap[1] + 0.03, gap
    rolling = read(BODIES + options).build({"duration": 1.0}, 0).simulation["bodies"]
    assert rolling._options["contact_margin"] == 0.07
    body = jelly.replace("soft-body", "pbd").replace("scale =", "neighbours = 20\nscale =")
    assert read(body).build(values, 0).simulation.skin.cells.shape[1] == 20


@pytest.mark.parametrize(
    ("which", "old", "new", "told"),
    [
        (1, "density = 0.2", "densty = 0.2", "densty: unknown key of cloth; did you mean density?"),
        (1, "stiffness = 500", "", "stiffness: cloth needs it"),
        (1, "[-0.51, 0.49, 0.0]", "[-0.51, 0.509, 0.0]", "pinned: expected a box with vertices"),
        (1, "\n[cloth]", "\n[solid]", "solid: mass-spring has none"),
        (1, "\n[cloth]", "\n[[cloth]]", "cloth: expected a table [cloth]"),
        (1, "size = [1.0, 1.0]", "size = [1.0]", "size: expected 2 numbers"),
        (1, "spacing = ", "spacing = 1e-320 #", "spacing: inf cells are more than 2e+07"),
        (2, "spacing = ", "spacing = 1e-4 #", "cells are more than 2e+07"),
        (1, '"mass-spring"', '"pbd"', "stiffness: is of cloth of mass-spring; pbd has compliance"),
        (2, "poisson_ratio = 0.4", "poisson_ratio = 0.6", "poisson_ratio: [0]: expected a number"),
        (2, "poisson_ratio = 0.4", "", "poisson_ratio: solid needs it"),
        (2, "high = [0.2, 0.2, 0.5]", "high = [0.2, 0.2, 0.1]", "high: expected numbers above"),
        (2, "scale = 0.001", "scal = 0.001", "scal: unknown key of skin; did you mean scale?"),
        (2, "scale = 0.001", "scale = 1", "expected vertices within"),
        (2, "scale = 0.001", "neighbours = 20", "neighbours: unknown key of skin"),
        (1, "\n[cloth]", "\n[options]\ncontact_margin = 0\n[cloth]", "contact_margin: expected"),
        (2, '"meshes/bust.obj"', '"../bust.obj"', "file: expected a path"),
        (2, "\n[solid]", "\n[[block]]", "density: unknown key of block"),
        (3, "fps = 10", "", "fps: obstacle needs it"),
        (3, "fps = 10", "fps = 0", "fps: expected"),
        (3, "fps = 10", "fps = 1e-320", "fps: expected a larger number"),
        (
            3,
            "thickness = 0.05",
            "thickness = 0.05\nhollow = true",
            "hollow: unknown key of obstacle",
        ),
        (
            3,
            "thickness = 0.05",
            "thickness = 0.01",
            "expected a surface of a thickness of at least",
        ),
        (3, '"meshes/swelling"', '"meshes/none"', "meshes/none"),
        (3, '"meshes/swelling"', '"../meshes"', "folder: expected a path"),
    ],
)
def test_faults_of_cloth_skins_and_animations_are_told(folder, capsys, which, old, new, told):
    text = documented(folder)[which]
    assert old in text
    (folder / "a.toml").write_text(text.replace(old, new))
    assert main(["run", "a.toml", "--no-picture"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and told in err and err.count("\n") == 1
    assert sorted(path.name for path in folder.iterdir()) == ["a.toml", "meshes"]
