"""Pictures in three dimensions: what is in front of the camera is seen where it should be."""

import dataclasses
import gc
import itertools
import sys

import matplotlib.image
import numpy as np
import pytest
import substep
from substep import render, scenes
from substep.cli import main
from substep.render import Camera, Look, View
from substep.view import egl

pyvista = pytest.importorskip("pyvista", reason="PyVista is not installed")
if egl._why_not_egl():
    pytest.skip(f"no OpenGL: {egl._why_not_egl()}", allow_module_level=True)

SIZE = (320, 240)
RED, BLUE = "#ff0000", "#0000ff"
SQUARE = np.array([[-1.0, 0, 0], [1, 0, 0], [1, 0, 2], [-1, 0, 2]])  # faces -y
FACES = [[0, 1, 2], [0, 2, 3]]
FRONT = Camera(-90, 0)


def record(path, parts, frames):
    with substep.Recorder(path, parts=parts) as recorder:
        for k, frame in enumerate(frames):
            recorder.append(0.1 * k, frame)
    return substep.Recording(path)


def square(tmp_path, fields=()):
    parts = {"cloth": substep.Part("mesh", dict.fromkeys(fields, "m"), FACES)}
    values = {name: np.arange(4.0) for name in fields}
    return record(tmp_path / "a.vtkhdf", parts, [{"cloth": {"points": SQUARE, **values}}])


def reddish(image):
    return (image[..., 0] > 90) & (image[..., 1] < 90) & (image[..., 2] < 90)


def bluish(image):
    return (image[..., 2] > 60) & (image[..., 0] < image[..., 2] / 1.5)


def test_a_surface_is_where_it_should_be_and_has_two_sides(tmp_path):
    recording = square(tmp_path)
    looks = {"cloth": Look(RED, back=BLUE)}
    front = View(FRONT, looks, ground=lambda r: None).image(recording, size=SIZE)
    assert front.shape == (240, 320, 3) and front.dtype == np.uint8
    seen = reddish(front)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=3)  # a square is a square
    assert np.ptp(rows) == pytest.approx(0.86 * 240, abs=6)  # and fills the picture
    assert rows.mean() == pytest.approx(119.5, abs=2) and columns.mean() == pytest.approx(
        159.5, abs=2
    )
    assert seen[rows[0] + 2 : rows[-1] - 1, columns[0] + 2 : columns[-1] - 1].all()
    assert not bluish(front).any()
    back = View(Camera(90, 0), looks, ground=lambda r: None).image(recording, size=SIZE)
    assert bluish(back).sum() == pytest.approx(seen.sum(), rel=0.03) and not reddish(back).any()


@pytest.mark.parametrize(
    ("azimuth", "elevation"), [(-150, -30), (-60, 18), (0, 0), (45, 60), (0, 90)]
)
def test_the_camera_sees_all_of_it(tmp_path, azimuth, elevation):
    points = np.random.default_rng(0).uniform([-3, 1, 10], [5, 2, 12], (300, 3))
    recording = record(tmp_path / "a.vtkhdf", {"p": substep.Part()}, [{"p": {"points": points}}])
    view = View(Camera(azimuth, elevation), {"p": Look(RED, radius=0.05)})
    seen = reddish(view.image(recording, size=SIZE))
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    assert rows[0] > 3 and rows[-1] < 236 and columns[0] > 3 and columns[-1] < 316
    assert max(np.ptp(rows) / 240, np.ptp(columns) / 320) > 0.6
    near = View(Camera(azimuth, elevation, 0.5), view.looks).image(recording, size=SIZE)
    assert reddish(near).sum() > 1.5 * seen.sum()


def test_every_kind_of_part_is_drawn(tmp_path):
    tetrahedron = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 1.5]])
    orientation = [[1.0, 0, 0, 0]] * 4
    kinds = {
        "surface": (substep.Part("mesh", triangles=[[0, 1, 3]]), {}),
        "lines": (substep.Part("mesh", edges=[[0, 1], [1, 3], [3, 0]]), {}),
        "solid": (substep.Part("mesh", tetrahedra=[[0, 1, 2, 3]]), {}),
        "particles": (substep.Part(), {}),
        "bodies": (
            substep.Part("bodies", {"orientation": "1"}),
            {"orientation": orientation},
        ),
    }
    parts = {name: part for name, (part, _) in kinds.items()}
    frame = {name: {"points": tetrahedron, **extra} for name, (_, extra) in kinds.items()}
    recording = record(tmp_path / "a.vtkhdf", parts, [frame])

    def area(name, radius):
        looks = {other: Look(hidden=other != name, color=RED, radius=radius) for other in kinds}
        image = View(FRONT, looks, ground=lambda r: None).image(recording, size=SIZE)
        return reddish(image).sum()

    areas = {name: area(name, 0.2) for name in kinds} | {"thin lines": area("lines", 0.02)}
    assert 50 < areas["thin lines"] < 0.3 * areas["surface"]
    assert areas["lines"] > 4 * areas["thin lines"]  # lines are tubes of that radius
    assert areas["solid"] == pytest.approx(areas["surface"], rel=0.1)  # seen from the front
    assert areas["particles"] == areas["bodies"] > 1000


def test_the_surface_of_tetrahedra_has_no_inner_faces(tmp_path):
    """Three colours of light at most on a box: its sharp edges are not smoothed."""
    box = substep.geometry.box_tetrahedra((1, 1, 1), (4, 4, 4))
    recording = record(
        tmp_path / "a.vtkhdf",
        {"box": substep.Part("mesh", tetrahedra=box.tetrahedra)},
        [{"box": {"points": box.vertices}}],
    )
    view = View(Camera(-60, 30), {"box": Look(RED)}, ground=lambda r: None)
    image = view.image(recording, size=SIZE)
    _, counts = np.unique(image[reddish(image)] // 4, axis=0, return_counts=True)
    assert counts[counts > 200].sum() > 0.9 * counts.sum() and (counts > 200).sum() <= 8
    assert view._stage(recording, SIZE)._bodies["box"].data.n_cells == 6 * 4 * 4 * 2


def test_nooks_are_darker(tmp_path):
    parts = {"dot": substep.Part("particles")}
    for name, lengths, z in (("floor", [2.0, 2, 0.1], -0.05), ("wall", [0.1, 2, 1.5], 0.75)):
        mesh = substep.geometry.box_mesh(lengths)
        place = [-0.6 if name == "wall" else 0.0, 0, z]
        parts[name] = substep.Part("mesh", triangles=mesh.faces, points=mesh.vertices + place)
    recording = record(tmp_path / "a.vtkhdf", parts, [{"dot": {"points": [[0.0, 0, -0.05]]}}])
    view = View(
        Camera(0, 60),
        {"floor": Look("#909090"), "wall": Look(BLUE), "dot": Look(hidden=True)},
        box=lambda recording: [[-1, -1, 0], [1, 1, 0.1]],
        ground=lambda recording: None,
    )
    shaded = dataclasses.replace(view, nooks=lambda recording: 0.4)
    before, after = (v.image(recording, size=SIZE).astype(int)[:, 140:180] for v in (view, shaded))
    grey = np.ptp(before, axis=2).max(axis=1) < 20  # rows of the floor alone
    floor = np.flatnonzero(grey & (np.abs(before[..., 0].mean(axis=1) - before[120, 20, 0]) < 15))
    change = (after - before)[floor].mean(axis=(1, 2))
    assert len(floor) > 100 and np.abs(change[len(floor) // 2 :]).max() < 4  # far from the wall
    assert change[:10].mean() < -25


def test_what_lies_above_the_ground_has_a_shadow(tmp_path):
    ball = substep.geometry.sphere_mesh(1.0, (0, 0, 1.5), 2)
    parts = {"ball": substep.Part("mesh", triangles=ball.faces)}
    frames = [{"ball": {"points": ball.vertices + np.array([0, 0, z])}} for z in (0, 4)]
    recording = record(tmp_path / "a.vtkhdf", parts, frames)
    shadow = View(Camera(-90, 35), {"ball": Look(RED)})
    none = View(shadow.camera, shadow.looks, ground=lambda r: None)
    for frame in (0, 1):
        image, bare = (v.image(recording, frame, SIZE).astype(int) for v in (shadow, none))
        assert np.array_equal(reddish(image), reddish(bare))
        ground = np.all(bare == bare[0, 0], axis=2)  # neither the ball nor its smooth border
        darkest = image[ground].sum(axis=1).min()
        assert darkest < bare[0, 0].sum() - 150
        place = np.argwhere(ground & (image.sum(axis=2) == darkest)).mean(axis=0)
        ball_at = np.argwhere(reddish(image)).mean(axis=0)
        assert place[0] > ball_at[0] and place[1] > ball_at[1]  # below, and away from the light


def hills(tmp_path, x, y, z, faces):
    """Red hills at heights z, and a ball that is first above them, then far away."""
    points = np.stack([x, y, z], axis=-1)
    ball = substep.geometry.sphere_mesh(0.3, (0, 0, 1.5), 2)
    parts = {
        "ball": substep.Part("mesh", triangles=ball.faces),
        "hills": substep.Part("mesh", triangles=faces, points=points),
    }
    frames = [{"ball": {"points": ball.vertices + np.array([0, 0, up])}} for up in (0, 90)]
    return record(tmp_path / "hills.vtkhdf", parts, frames)


def test_shadows_fall_on_hills(tmp_path):
    field = substep.HeightField(np.full((5, 5), 0.5), 1.0, (-2, -2, 0)).mesh()
    recording = hills(tmp_path, *field.vertices.T, field.faces)
    box = [[-2, -2, 0], [2, 2, 1]]
    view = View(
        Camera(0, 90), {"hills": Look(RED), "ball": Look(BLUE)}, box=lambda r: box, bar=False
    )
    shaded, bare = (view.image(recording, frame, SIZE).astype(int) for frame in (0, 1))
    seen = reddish(shaded) & reddish(bare)
    darker = seen & ((bare - shaded).sum(axis=2) > 40)
    # The middle of the shadow: 1 m below the ball, seen with x downwards and y to the right.
    rows, columns = np.nonzero(seen)
    metre = np.ptp(rows) / 4
    middle = np.argwhere(darker).mean(axis=0) - [rows.mean(), columns.mean()]
    np.testing.assert_allclose(middle / metre, [0.45, 0.30], atol=0.15)
    assert 0.05 < darker.sum() / metre**2 < 1.5


def test_no_shadow_falls_on_what_has_an_upper_and_a_lower_side(tmp_path):
    table = substep.geometry.box_mesh((4.0, 4, 0.1))  # the ball may be below it
    x, y, z = table.vertices.T
    recording = hills(tmp_path, x, y, z + 3, table.faces)
    view = View(Camera(0, 90), {"hills": Look(RED)}, box=lambda r: [[-2, -2, 0], [2, 2, 3]])
    below, away = (view.image(recording, frame, SIZE).astype(int) for frame in (0, 1))
    table = reddish(below) & reddish(away)
    assert table.sum() > 1000 and np.abs(below - away)[table].max() == 0


def test_particles_may_come_and_go(tmp_path):
    frames = [{"p": {"points": np.arange(3.0 * n).reshape(n, 3)}} for n in (5, 0, 9)]
    recording = record(tmp_path / "a.vtkhdf", {"p": substep.Part()}, frames)
    view = View(looks={"p": Look(RED, radius=0.8)})
    areas = [reddish(view.image(recording, k, SIZE)).sum() for k in range(3)]
    assert areas[1] == 0 < areas[0] < areas[2]


@pytest.mark.parametrize("color", [None, "heat"])
@pytest.mark.parametrize("heap", [False, True])
def test_a_recording_may_begin_before_there_is_a_particle(tmp_path, color, heap):
    frames = [
        {"p": {"points": np.arange(3.0 * n).reshape(n, 3), "heat": np.ones((n, 3))}}
        for n in (0, 5, 0, 9)
    ]
    parts = {"p": substep.Part("particles", {"heat": "K"})}
    recording = record(tmp_path / "a.vtkhdf", parts, frames)
    view = View(looks={"p": Look(radius=0.8, heap=heap)}, color=color)
    empty, some, none, more = (view.image(recording, k, SIZE).astype(int) for k in range(4))
    np.testing.assert_array_equal(empty, none)
    areas = [(np.ptp(image - empty, axis=2) > 20).sum() for image in (some, more)]
    assert 0 < areas[0] < areas[1]


def test_a_recording_may_end_without_a_particle(tmp_path):
    frames = [{"p": {"points": np.ones((n, 3))}} for n in (0, 4, 0)]
    recording = record(tmp_path / "a.vtkhdf", {"p": substep.Part()}, frames)
    assert not render.is_flat(recording)


def test_a_picture_by_a_view(tmp_path):
    with square(tmp_path, fields=("height",)):
        pass
    path, out = tmp_path / "a.vtkhdf", tmp_path / "a.png"
    view = View(FRONT, {"cloth": Look(RED)}, title=lambda r, k: "")
    seen = []
    for color in (None, "height"):
        render.save_picture(path, out, color=color, view=view)
        seen.append(reddish((255 * matplotlib.image.imread(out)).astype(int)).sum())
    assert seen[0] > 1e5 > seen[1] == 0
    with pytest.raises(TypeError, match="view: expected a View, got 'front'"):
        render.save_picture(path, out, view="front")


def test_colours_of_a_field_and_its_range_over_all_frames(tmp_path):
    parts = {"cloth": substep.Part("mesh", {"height": "m", "force": "N"}, FACES)}
    force = np.zeros((4, 3))
    force[:, 0], force[2, 1] = 3.0, 4.0
    frames = [
        {"cloth": {"points": SQUARE, "height": np.full(4, float(k)), "force": force}}
        for k in range(3)
    ]
    recording = record(tmp_path / "a.vtkhdf", parts, frames)
    view = View(FRONT, color="height", ground=lambda r: None)
    low, middle, high = (view.image(recording, k, SIZE)[120, 160].astype(int) for k in range(3))
    assert low[2] > low[1] and high[0] > 1.5 * high[2] and middle[1] > middle[0]  # viridis
    assert view._stage(recording, SIZE).range == (0.0, 2.0)
    assert View(color="force")._stage(recording, SIZE).range == (3.0, 5.0)  # norms
    figure = render.draw(recording, color="height")
    assert [a.get_ylabel() for a in figure.axes] == ["", "height [m]"]
    assert [t.get_text() for t in figure.texts] == ["recording, t = 0.200 s"]
    with pytest.raises(
        substep.InputError, match="no part has a field 'heat'; known: force, height"
    ):
        render.draw(recording, color="heat")
    bare = record(tmp_path / "b.vtkhdf", {"p": substep.Part()}, [{"p": {"points": np.eye(3)}}])
    with pytest.raises(substep.InputError, match="a field 'heat'; there are none"):
        render.draw(bare, color="heat")


def test_the_same_pixels_every_time(tmp_path):
    recording = square(tmp_path)
    images = [View(camera=Camera()).image(recording, size=SIZE) for _ in range(2)]
    images.append(View().image(substep.Recording(tmp_path / "a.vtkhdf"), size=SIZE))
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])


def test_the_region_shown_can_be_given(tmp_path):
    """A vertex that flies away would make the rest a dot."""
    parts = {"cloth": substep.Part("mesh", triangles=FACES)}
    frames = [{"cloth": {"points": SQUARE * [1, 1, s]}} for s in (1.0, 1e6)]
    recording = record(tmp_path / "a.vtkhdf", parts, frames)
    looks = {"cloth": Look(RED)}
    lost = View(FRONT, looks).image(recording, 0, SIZE)
    kept = View(FRONT, looks, box=lambda r: [[-1, 0, 0], [1, 0, 2]]).image(recording, 0, SIZE)
    assert reddish(lost).sum() < 30 and reddish(kept).sum() > 20_000


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # imageio-ffmpeg's pipes
def test_command_line(tmp_path, capsys):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    parts = {"cloth": substep.Part("mesh", {"height": "m"}, FACES)}
    frames = [
        {"cloth": {"points": SQUARE + np.array([0, 0, 0.2 * k]), "height": np.arange(4.0)}}
        for k in range(3)
    ]
    path = str(tmp_path / "a.vtkhdf")
    record(path, parts, frames).close()
    picture, movie = str(tmp_path / "x.png"), str(tmp_path / "x.mp4")
    options = ("--camera=30,10,0.8", "--color", "height")
    assert main(["render", path, "--out", picture, *options]) == 0
    assert capsys.readouterr().out == f"picture: {picture}\n"
    from matplotlib.image import imread

    assert imread(picture).shape[:2] == (810, 1440)
    assert main(["render", path, "--out", movie, *options]) == 0
    reader = imageio_ffmpeg.read_frames(movie)
    meta = next(reader)
    assert meta["size"] == (960, 540) and meta["codec"] == "h264"
    pictures = [np.frombuffer(frame, np.uint8) for frame in reader]
    assert len(pictures) == 3
    assert all(np.any(a != b) for a, b in itertools.pairwise(pictures))
    del reader
    gc.collect()
    capsys.readouterr()
    for option, words in (
        ("--camera=1", "--camera: expected AZIMUTH,ELEVATION[,DISTANCE], got '1'"),
        ("--camera=a,b", "--camera: expected"),
        ("--camera=0,91", "--camera: elevation: expected -90 to 90"),
        ("--camera=0,0,0", "--camera: distance: expected"),
        ("--camera=nan,0", "--camera: azimuth"),
        ("--color=heat", "color: no part has a field 'heat'"),
    ):
        assert main(["render", path, "--out", str(tmp_path / "y.png"), option]) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"substep: {words}") and err.count("\n") == 1, err
    assert not (tmp_path / "y.png").exists()


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # imageio-ffmpeg's pipes
def test_a_run_may_make_a_movie(tmp_path, capsys):
    pytest.importorskip("imageio_ffmpeg")
    command = ["run", "cloth-hang", "--set", "vertices=6", "--set", "duration=0.1", "--frames", "3"]
    assert main([*command, "--movie", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.endswith(f"movie: {tmp_path / 'cloth-hang.mp4'}\n")
    assert (tmp_path / "cloth-hang.mp4").stat().st_size > 5000
    gc.collect()
    assert main([*command, "--movie", "--no-picture"]) == 2


def test_a_picture_of_the_plane_has_no_camera(tmp_path, capsys):
    frames = [{"p": {"points": [[0.0, 0.0]]}}]
    record(tmp_path / "a.vtkhdf", {"p": substep.Part()}, frames).close()
    assert main(["render", str(tmp_path / "a.vtkhdf"), "--camera=0,0"]) == 2
    assert "camera: only pictures in three dimensions have one" in capsys.readouterr().err


def liquid(tmp_path, *, n=14, fields=(), frames=1):
    """A cube of liquid, 1 m wide, in front of a red square, and a blue one in front of it."""
    pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")
    points = (np.stack(np.meshgrid(*3 * [np.arange(n) + 0.5]), -1).reshape(-1, 3) / n).round(4)
    square = np.array([[-1.0, 0, -0.5], [2, 0, -0.5], [2, 0, 1.5], [-1, 0, 1.5]])
    parts = {
        "water": substep.Part("particles", dict.fromkeys(fields, "m")),
        "behind": substep.Part("mesh", triangles=FACES, points=square + np.array([0, 1.5, 0])),
        "front": substep.Part(
            "mesh", triangles=FACES, points=[0.6, -0.5, 0.6] + square * [0.1, 1, 0.1]
        ),
    }
    moving = [points[: len(points) * k // frames] for k in range(frames, 0, -1)]
    values = [dict.fromkeys(fields, p[:, 2]) for p in moving]
    return record(
        tmp_path / "w.vtkhdf",
        parts,
        [{"water": {"points": p, **v}} for p, v in zip(moving, values, strict=True)],
    )


LOOKS = {"water": Look("#2060ff", liquid=True), "behind": Look(RED), "front": Look("#00c000")}
ALONG_Y = View(FRONT, LOOKS, box=lambda r: [[0, 0, 0], [1, 1, 1]], ground=lambda r: None)


def test_a_liquid_is_clear_and_hides_nothing_in_front_of_it(tmp_path):
    recording = liquid(tmp_path, frames=14)  # thinner by one layer of y in each frame
    image = ALONG_Y.image(recording, 0, SIZE).astype(int)
    dry = View(FRONT, LOOKS | {"water": Look(hidden=True)}, box=ALONG_Y.box, ground=ALONG_Y.ground)
    without = dry.image(recording, 0, SIZE).astype(int)
    middle = (slice(120, 170), slice(120, 200))  # through the whole cube
    assert bluish(image[middle]).all() and reddish(without[middle]).all()
    outside = (slice(5, 235), slice(5, 60))
    np.testing.assert_array_equal(image[outside], without[outside])
    green = without[..., 1] > without[..., 0] + 60
    assert green.sum() > 1000
    np.testing.assert_allclose(image[green], without[green], atol=1)
    thin = ALONG_Y.image(recording, 13, SIZE).astype(int)
    assert (thin[middle][..., 0] > image[middle][..., 0] + 40).all()  # red shines through


def test_more_of_a_liquid_lets_less_light_through(tmp_path):
    """Layers along z seen from above: a red square shines through, the less the deeper."""
    pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")
    grid = np.stack(np.meshgrid(*3 * [np.arange(14) + 0.5]), -1).reshape(-1, 3) / 14
    floor = np.array([[-1.0, -1, -0.01], [2, -1, -0.01], [2, 2, -0.01], [-1, 2, -0.01]])
    parts = {
        "water": substep.Part(),
        "floor": substep.Part("mesh", triangles=FACES, points=floor),
    }
    frames = [{"water": {"points": grid[grid[:, 2] < z]}} for z in (0.15, 0.3, 0.6, 1.0)]
    recording = record(tmp_path / "w.vtkhdf", parts, frames)
    looks = {"water": LOOKS["water"], "floor": Look(RED)}
    view = View(Camera(0, 90), looks, box=lambda r: [[0, 0, 0], [1, 1, 1]])
    pixels = np.array([view.image(recording, k, SIZE)[110:130, 150:170] for k in range(4)])
    red, blue = (pixels[..., c].mean(axis=(1, 2)) for c in (0, 2))
    assert (np.diff(red)[:2] < -3).all() and (np.diff(blue) > 0).all()
    assert red[0] - red[1] > 3 * (red[2] - red[3])  # exponentially


def test_a_liquid_that_comes_and_goes(tmp_path):
    pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")
    points = np.stack(np.meshgrid(*3 * [np.arange(5.0)]), -1).reshape(-1, 3)
    frames = [{"water": {"points": points[:n]}} for n in (0, 60, 125, 0)]
    recording = record(tmp_path / "w.vtkhdf", {"water": substep.Part()}, frames)
    view = View(looks={"water": Look("#2060ff", liquid=True)}, ground=lambda r: None)
    areas = [bluish(view.image(recording, k, SIZE)).sum() for k in range(4)]
    assert areas[0] == areas[3] == 0 < areas[1] < areas[2]
    again = View(looks=view.looks, ground=view.ground).image(recording, 2, SIZE)
    np.testing.assert_array_equal(again, view.image(recording, 2, SIZE))


def test_a_field_colours_the_particles_of_a_liquid(tmp_path):
    recording = liquid(tmp_path, fields=("height",))
    view = View(FRONT, LOOKS, color="height", ground=lambda r: None)
    stage = view._stage(recording, SIZE)
    assert not stage._liquids and stage._bodies["water"].kind == "points"


def test_particles_have_the_colours_of_a_field(tmp_path):
    points = np.array([[0.0, 0, 0], [1, 0, 0]])
    parts = {"dust": substep.Part("particles", {"heat": "K"})}
    frames = [{"dust": {"points": points, "heat": np.array([0.0, k])}} for k in (0.0, 1.0)]
    recording = record(tmp_path / "a.vtkhdf", parts, frames)
    looks = {"dust": Look(radius=0.5)}
    image = View(FRONT, looks, color="heat").image(recording, 1, SIZE).reshape(-1, 3).astype(int)
    assert ((image[:, 0] > 1.5 * image[:, 2]) & (image[:, 0] > 60)).any()  # viridis: yellow
    assert ((image[:, 2] > 1.5 * image[:, 1]) & (image[:, 2] > 30)).any()  # and purple


def test_the_radius_may_come_from_the_recording(tmp_path):
    recording = liquid(tmp_path, n=5)
    looks = {"water": Look(liquid=True, radius=lambda r: 0.1)}
    assert View(looks=looks)._stage(recording, SIZE)._liquids["water"].radius == 0.1
    guessed = View(looks={"water": Look(liquid=True)})._stage(recording, SIZE)._liquids["water"]
    assert guessed.radius == pytest.approx(0.1)


def test_what_is_missing_is_named(tmp_path, capsys, monkeypatch):
    square(tmp_path).close()
    path = str(tmp_path / "a.vtkhdf")
    cases = [
        ('pip install "substep[viz]"', lambda m: m.setitem(sys.modules, "pyvista", None)),
        ("apt install libegl1", lambda m: m.setattr(egl, "_why_not_egl", lambda: "EGL is not")),
    ]
    for words, take_away in cases:
        with monkeypatch.context() as changed:
            take_away(changed)
            changed.setattr(egl.ctypes, "CDLL", _no_library)
            egl.window_class.cache_clear()
            assert main(["render", path]) == 1
        egl.window_class.cache_clear()
        err = capsys.readouterr().err
        assert words in err and err.count("\n") == 1
    assert not (tmp_path / "a.png").exists()


def _no_library(name, *arguments):
    raise OSError(name)


def test_nothing_stays_of_a_recording_that_is_gone(tmp_path):
    from pyvista.plotting.plotter import _ALL_PLOTTERS

    gc.collect()
    before = len(_ALL_PLOTTERS)
    recording = square(tmp_path)
    View().image(recording, size=SIZE)
    assert len(_ALL_PLOTTERS) == before + 2  # the picture and its shadow
    recording.close()
    del recording
    gc.collect()
    assert len(_ALL_PLOTTERS) == before


@pytest.mark.parametrize("arguments", [(0, 91), (0, 0, 0), (0, 0, -1), (np.nan, 0), (0, np.inf)])
def test_cameras_are_checked(arguments):
    with pytest.raises(substep.InputError):
        Camera(*arguments)


def test_a_heap_is_lit_by_its_surface(tmp_path):
    from substep.view.heap_light import heap_light, heap_normals

    axis = 0.05 * (np.arange(40) + 0.5) - 1
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    away = np.linalg.norm(x, axis=1)
    ball, away = x[away < 1].astype(np.float32), away[away < 1]
    outer = away > 0.93
    normals, weight = heap_normals(ball, 0.025)
    outward = np.einsum("ij,ij->i", normals, ball / away[:, None])
    assert outward[outer].min() > 0.9 and weight[outer].min() > 0.5
    assert weight[away < 0.5].max() < 0.05
    light = heap_light(ball, 0.025, [(np.array([0, 0, 1.0]), 1.0)])
    up = normals[:, 2]
    assert light[outer & (up > 0.9)].min() > 1.5 * light[outer & (up < -0.9)].max()
    for few in (ball[:0], ball[:1]):  # nothing to be lit, and no surface
        assert np.isfinite(heap_light(few, 0.025, [(np.ones(3), 1.0)])).all()

    parts = {"ball": substep.Part("particles", {"height": "m"})}
    with substep.Recorder(tmp_path / "ball.vtkhdf", parts=parts) as recorder:
        recorder.append(0.0, {"ball": {"points": ball, "height": ball[:, 2]}})
    recording = substep.Recording(tmp_path / "ball.vtkhdf")
    looks = {"ball": Look(RED, heap=True, radius=0.03)}
    plain = View(FRONT, looks, ground=lambda r: None).image(recording, size=SIZE)
    rows = np.flatnonzero((plain[:, SIZE[0] // 2].astype(int) @ [1, -1, 0]) > 60)
    top, bottom = plain[rows[len(rows) // 6], SIZE[0] // 2], plain[rows[-3], SIZE[0] // 2]
    assert top[0] > 1.2 * bottom[0]
    view = View(FRONT, looks, color="height", palette="gray", limits=(-9.0, 1.0))
    gray = view.image(recording, size=SIZE)[SIZE[1] // 2, SIZE[0] // 2].astype(int)
    assert np.ptp(gray) < 3 and view._stage(recording, SIZE).range == (-9.0, 1.0)


def test_a_bar_beside_the_picture_only_where_it_is_asked_for(tmp_path):
    recording = square(tmp_path, ["height", "dye"])
    scene = scenes.Scene(
        name="toy",
        doc="Never built.",
        parameters={"duration": scenes.Parameter("time", 1.0, above=0)},
        build=lambda parameters, seed: None,
        picture=View(FRONT, color="dye", palette="copper", limits=(-9.0, 1.0), bar=False),
    )
    assert len(render.draw(recording, scene=scene).axes) == 1
    _, bar = render.draw(recording, scene=scene, color="height").axes  # and its own range
    assert bar.collections[0].get_cmap().name == "viridis"
    assert bar.get_ylabel() == "height [m]" and bar.get_ylim() == (0.0, 3.0)


def test_the_bar_of_colours_is_within_small_pictures_too(tmp_path):
    from matplotlib.figure import Figure

    view = View(FRONT, color="heat", limits=(-123456.0, 0.0))
    with square(tmp_path, ["heat"]) as recording:
        for size in ((160, 90), (320, 180), (480, 270), (960, 540), (1440, 810)):
            figure = Figure(figsize=(size[0] / 150, size[1] / 150), dpi=150)
            view(recording, 0, figure)
            extent = figure.axes[-1].get_tightbbox()
            assert 0.5 * size[0] < extent.x0 and extent.x1 <= size[0]
            assert 0 <= extent.y0 and extent.y1 <= size[1]
            title = figure.texts[0].get_window_extent()
            assert title.x1 < size[0] and not title.overlaps(extent)


def test_a_field_by_name_keeps_what_the_view_says_of_colours(tmp_path):
    square(tmp_path, ["heat"]).close()
    view = View(FRONT, palette="Reds", limits=(0.0, 30.0), bar=False)
    for name, options in (
        ("a", {"view": dataclasses.replace(view, color="heat")}),
        ("b", {"view": view, "color": "heat"}),
        ("c", {"view": View(FRONT), "color": "heat"}),
    ):
        render.save_picture(tmp_path / "a.vtkhdf", tmp_path / f"{name}.png", size=SIZE, **options)
    a, b, c = (matplotlib.image.imread(tmp_path / f"{name}.png") for name in "abc")
    assert np.array_equal(a, b) and not np.array_equal(a, c)


def test_camera_paths():
    """Catmull and Rom: of evenly spaced times exact for parabolas, here t^2, within."""
    times = np.arange(5.0)
    places = np.stack([times**2, times, 0 * times], axis=1)
    path = render.CameraPath(times, places, (0, 0, 5))
    for t in (1.0, 1.3, 2.5, 2.9):
        assert np.allclose(path.at(t)[0], [t**2, t, 0])
    assert path.at(-1.0)[0].tolist() == [0, 0, 0] and path.at(9.0)[0].tolist() == [16, 4, 0]
    assert path.at(2.5)[1].tolist() == [0, 0, 5]
    for arguments, told in (
        (([1, 1], [(0, 0, 1), (0, 0, 2)], (0, 0, 0)), "times: .* increasing"),
        (([], np.zeros((0, 3)), (0, 0, 0)), "times: "),
        (([0], [(0, 0, 1, 2)], (0, 0, 0)), "positions: "),
        (([0], [(0, 0, 1)], (0, 0, 1)), "targets: expected others"),
        (([0], [(0, 0, 1)], (0, 0, 0), 180), "angle: "),
        (([0, 2], [(-1, 2, 0), (1, 2, 0)], (0, 2, 0)), "targets: .* passes through .* at 1 s"),
        (([0, 3], [(0, 0, 0), (9, 0, 0)], [(6, 0, 0), (6, 0, 0)]), "passes through .* at 2 s"),
        (([0, 2], [(-1e308, 0, 0), (1e308, 1, 0)], (0, 0, 0)), "times, positions and targets: "),
        (([-1e308, 1e308], [(-1, 0, 0), (1, 1, 0)], (0, 0, 0)), "times"),
    ):
        with pytest.raises(substep.InputError, match=told):
            render.CameraPath(*arguments)
    for time in (np.nan, np.inf):
        with pytest.raises(substep.InputError, match="time: "):
            path.at(time)


def test_what_a_moving_camera_looks_at_stays_in_the_middle(tmp_path):
    """A ball that the targets go with; what its size is follows from the distance."""
    frames = [{"p": {"points": [[k, 0, 1.0]]}} for k in range(3)]
    recording = record(tmp_path / "a.vtkhdf", {"p": substep.Part()}, frames)
    path = render.CameraPath(
        [0, 0.1, 0.2], [(0, -4, 1), (1, -4, 1), (2, -8, 1)], [(0, 0, 1), (1, 0, 1), (2, 0, 1)]
    )
    view = View(path, {"p": Look(RED, radius=0.3)}, ground=lambda r: None)
    for frame, distance in ((0, 4), (1, 4), (2, 8)):
        rows, columns = np.nonzero(reddish(view.image(recording, frame, SIZE)))
        assert rows.mean() == pytest.approx(119.5, abs=1)
        assert columns.mean() == pytest.approx(159.5, abs=1)
        height = 240 * 0.3 / distance / np.tan(np.radians(15))
        assert np.ptp(rows) + 1 == pytest.approx(height, abs=3)


def test_bodies_have_their_shapes_and_colours(tmp_path):
    bodies = substep.RigidBodies()
    boxes = bodies.add(substep.Box((1.0, 1.0, 1.0)), [(-1.0, 0, 0), (1.0, 0, 0)])
    quarter = np.sqrt(0.5)
    bodies.set_rotations([(1, 0, 0, 0), (np.cos(np.pi / 8), 0, np.sin(np.pi / 8), 0)], ids=boxes)
    path = substep.scenes.record(bodies, tmp_path / "a.vtkhdf", 0.0)
    with substep.Recording(path) as recording:
        looks = {"particles": Look((RED, BLUE))}
        view = View(FRONT, looks, ground=lambda r: None, box=lambda r: [(-2, -1, -1), (2, 1, 1)])
        image = view.image(recording, size=SIZE)
    left, right = (np.nonzero(seen) for seen in (reddish(image), bluish(image)))
    assert left[1].max() < right[1].min()
    assert np.ptp(left[1]) == pytest.approx(np.ptp(left[0]), abs=5)  # with some of its side
    # Turned by 45 degrees about the view it is higher by the square root of two.
    assert np.ptp(right[0]) == pytest.approx(np.ptp(left[0]) / quarter, rel=0.06)


def test_lights_have_a_side_and_a_colour(tmp_path):
    recording = record(
        tmp_path / "a.vtkhdf",
        {"p": substep.Part("mesh", triangles=(ball := substep.geometry.sphere_mesh(1.0)).faces)},
        [{"p": {"points": ball.vertices}}],
    )
    light = render.Light(azimuth=180.0, elevation=0.0, color=RED)  # from the left
    view = View(FRONT, {"p": Look("white")}, ground=lambda r: None, lights=[light])
    image = view.image(recording, size=SIZE).astype(float)
    left, right = image[120, 100], image[120, 220]
    assert left[0] > right[0] + 60
    assert left[0] > left[1] + 60  # red, but for the light of all directions
    with pytest.raises(substep.InputError, match="elevation"):
        render.Light(0.0, 91.0)


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_a_film_outlives_a_surface_that_fails(tmp_path, monkeypatch):
    """First at some lattices, then at all: the liquid is drawn as balls, with a warning."""
    pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    from substep.geometry import isosurface

    points = np.stack(np.meshgrid(*3 * [np.arange(4.0)]), -1).reshape(-1, 3)
    frames = [{"p": {"points": points + np.array([k, 0, 0])}} for k in range(2)]
    record(tmp_path / "a.vtkhdf", {"p": substep.Part()}, frames).close()
    real, cells = isosurface._reconstruct, []

    def failing(points, cell, smoothing, good=0.9):
        cells.append(cell)
        if cell > good:
            raise substep.SolverError("liquid_surface: pysplashsurf failed (panicked)")
        return real(points, cell, smoothing)

    monkeypatch.setattr(isosurface, "_reconstruct", failing)
    surface = substep.liquid_surface(points, 0.5)
    assert cells == [1.0, 0.98, 0.95, 0.9]
    report = substep.geometry.TriangleMesh(surface.vertices, surface.faces).report()
    assert report.closed
    monkeypatch.setattr(isosurface, "_reconstruct", lambda *a: failing(*a, good=0))
    with pytest.raises(substep.SolverError, match="panicked"):
        substep.liquid_surface(points, 0.5)
    view = View(looks={"p": Look(RED, liquid=True, radius=0.5)})
    with pytest.warns(RuntimeWarning, match="a liquid is drawn as particles: .*panicked"):
        out = render.save_movie(tmp_path / "a.vtkhdf", tmp_path / "a.mp4", view=view)
    assert imageio_ffmpeg.count_frames_and_secs(str(out))[0] == 2
    with (
        substep.Recording(tmp_path / "a.vtkhdf") as recording,
        pytest.warns(RuntimeWarning, match="drawn as particles"),
    ):
        assert reddish(view.image(recording, 0, SIZE)).sum() > 1000


def test_a_simulation_without_a_film_is_as_it_was(tmp_path, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")
    bodies = substep.RigidBodies()
    bodies.add(substep.Box((1, 1, 1)), (0, 0, 2))
    (tmp_path / "folder.mp4").mkdir()
    nobody = View(looks={"nobody": Look()})
    for error, told, options in (
        (substep.InputError, "color: no part has a field 'heat'", {"color": "heat"}),
        (substep.InputError, "looks: expected one of", {"view": nobody}),
        (TypeError, "view: expected a View", {"view": 3}),
        (TypeError, "scene: expected a Scene", {"scene": "dam-break"}),
        (TypeError, "on_frame: expected a callable", {"on_frame": 3}),
        (substep.InputError, "fps: expected a number from", {"fps": 1e-300}),
        (FileNotFoundError, "none'$", {"out": tmp_path / "none/a.mp4"}),
        (IsADirectoryError, "folder.mp4", {"out": tmp_path / "folder.mp4"}),
        (ZeroDivisionError, "zero", {"on_frame": lambda frame, frames, time: 1 / 0}),
        (ImportError, "Blender|bpy", {"engine": "Cycles"}),
        (ImportError, "pyvista is missing", {}),
    ):
        if error is ImportError:
            for module in ("pyvista", "bpy"):
                monkeypatch.setitem(sys.modules, module, None)
        how = {"out": tmp_path / "a.mp4", "duration": 0.1, "size": (64, 48)} | options
        with pytest.raises(error, match=told):
            render.save_movie(bodies, **how)
        assert bodies.time == 0 and bodies.positions[0, 2] == 2, options
    assert [p.name for p in tmp_path.iterdir()] == ["folder.mp4"]
    for write in (render.save_picture, render.save_movie):
        with pytest.raises(TypeError, match="source: expected a recording or a simulation, got"):
            write(substep.RigidBodies, tmp_path / "a.mp4")


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (Look, {"radius": 0.0}),
        (Look, {"radius": np.nan}),
        (Look, {"opacity": -1.0}),
        (Look, {"color": 3}),
        (Look, {"color": ("red", 3)}),
        (Look, {"back": 3}),
        (Look, {"density": 3}),
        (Look, {"hidden": "no"}),
        (View, {"camera": (1, 2)}),
        (View, {"looks": {"cloth": "red"}}),
        (View, {"color": 3}),
        (View, {"palette": None}),
        (View, {"limits": (1.0, 1.0)}),
        (View, {"limits": (0.0, np.nan)}),
        (View, {"limits": (0.0, 1.0, 2.0)}),
        (View, {"bar": "no"}),
        (View, {"box": [[0, 0, 0], [1, 1, 1]]}),
        (View, {"ground": 0.0}),
        (View, {"nooks": 0.0}),
        (View, {"lights": [3]}),
        (lambda **options: render.Light(0, 0, **options), {"color": 3}),
    ],
)
def test_values_of_views_are_checked(kind, wrong):
    with pytest.raises((substep.InputError, TypeError), match=f"^{next(iter(wrong))}.*: expected"):
        kind(**wrong)


def test_what_a_view_finds_when_it_draws_is_checked(tmp_path):
    with square(tmp_path) as recording:
        for told, view in (
            ("palette: .* 'rainbows'", View(palette="rainbows")),
            ("color: .* 'blorange'", View(looks={"cloth": Look(("red", "blorange"))})),
            ("back: .* 'blorange'", View(looks={"cloth": Look(back="blorange")})),
            ("color: .* 'blorange'", View(lights=[render.Light(0, 0, color="blorange")])),
            ("box: ", View(box=lambda recording: [[0, 0, 0], [1, 1, -1]])),
            ("box", View(box=lambda recording: np.full((2, 3), np.nan))),
            ("ground: ", View(ground=lambda recording: np.nan)),
            ("nooks: ", View(nooks=lambda recording: -1.0)),
            ("radius of 'cloth': ", View(looks={"cloth": Look(radius=lambda recording: np.nan)})),
        ):
            with pytest.raises(substep.InputError, match=f"^{told}"):
                view.image(recording, size=SIZE)
