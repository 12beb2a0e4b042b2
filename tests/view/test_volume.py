"""Fields of grids in pictures: smoke in three dimensions, colours and streamlines in the plane."""

import numpy as np
import pytest
import substep
from substep import render
from substep.render import Camera, Look, View
from substep.view import egl
from substep.view.field_sheet import draw_field, draw_streamlines, limits_of, scalar
from substep.view.volume import through

FRONT, SIZE = Camera(-90, 0), (160, 120)
FACES = [[0, 1, 2], [0, 2, 3]]


@pytest.fixture
def egl_there():
    pytest.importorskip("pyvista", reason="PyVista is not installed")
    if egl._why_not_egl():
        pytest.skip(f"no OpenGL: {egl._why_not_egl()}")


def wall(x0, x1, y):
    return np.array([[x0, y, 0], [x1, y, 0], [x1, y, 2.0], [x0, y, 2.0]])


def smoky(tmp_path, smoke, name="smoke"):
    """A box of smoke, a wall on the left before it and one on the right behind it."""
    cells = smoke[0].shape
    parts = {
        "air": substep.Part("grid", {name: "1"}, bounds=[(0, 0, 0), (2, 2, 2)], cell=2 / cells[0]),
        "before": substep.Part("mesh", triangles=FACES, points=wall(0, 1, -0.5)),
        "behind": substep.Part("mesh", triangles=FACES, points=wall(1, 2, 2.5)),
    }
    path = tmp_path / "smoke.vtkhdf"
    with substep.Recorder(path, parts=parts) as recorder:
        for k, values in enumerate(smoke):
            recorder.append(k, {"air": {name: values}})
    return substep.Recording(path)


LOOKS = {"before": Look("#ff0000"), "behind": Look("#ff0000"), "air": Look("white")}


def redness(image):
    """Of the middle of the left and of the right half."""
    excess = image[..., 0].astype(float) - image[..., 2]
    middle = excess[40:80]
    return middle[:, 50:70].mean(), middle[:, 90:110].mean()


@pytest.mark.usefixtures("egl_there")
def test_smoke_hides_what_is_behind_it_and_not_what_is_before_it(tmp_path):
    none, thick = np.zeros((16, 16, 16)), np.ones((16, 16, 16), np.float32)
    recording = smoky(tmp_path, [none, 0.06 * thick, thick])
    view = View(FRONT, LOOKS, ground=lambda recording: None)
    clear, thin, dense = (redness(view.image(recording, k, SIZE)) for k in range(3))
    assert min(clear) > 100
    assert thin[0] == pytest.approx(clear[0], abs=2) and dense[0] == pytest.approx(clear[0], abs=2)
    assert dense[1] < 10 < thin[1] < 0.8 * clear[1]
    # Light through 14 x 0.06 optical depths, as the constants of the picture say.
    assert thin[1] / clear[1] == pytest.approx(np.exp(-14 * 0.06 * 15 / 16), rel=0.05)


@pytest.mark.usefixtures("egl_there")
def test_the_same_pixels_every_time_and_a_field_has_its_colours(tmp_path):
    values = np.zeros((16, 16, 16), np.float32)
    values[:8] = 0.5
    values[8:] = 1.0
    recording = smoky(tmp_path, [values, values], name="heat")
    view = View(FRONT, {**LOOKS, "before": Look(hidden=True)}, dark=True)
    again = View(FRONT, {**LOOKS, "before": Look(hidden=True)}, dark=True)
    assert np.array_equal(view.image(recording, 0, SIZE), again.image(recording, 1, SIZE))
    assert view.image(recording, 0, SIZE)[:8].max() < 40  # dark
    colored = View(FRONT, view.looks, color="heat", palette="bwr", limits=(0, 1))
    left, right = redness(colored.image(recording, 0, SIZE))
    assert left < 60 < right
    with pytest.raises(substep.InputError, match="known: heat"):
        render.draw(recording, 0, color="smoke")
    assert len(render.draw(recording, 0, color="heat").axes) == 2


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_light_is_absorbed_along_its_way(axis, sign):
    """Beer and Lambert's law, in a half space of even smoke and under a slanting light."""
    key = np.full(3, 0.3)
    key[axis] = 0.9 * sign
    key /= np.linalg.norm(key)
    light = through(np.full((9, 9, 9), 0.1, np.float32), key)
    layers = np.moveaxis(light, axis, 0)[::-sign]
    way = (np.arange(9) + 0.5) / abs(key[axis])
    # The middle of the first layers is not reached by what comes in at the sides.
    np.testing.assert_allclose(layers[:4, 4, 4], np.exp(-0.1 * way[:4]), rtol=1e-5)
    assert (layers >= np.exp(-0.1 * way)[:, None, None] - 1e-6).all() and light.max() < 1


def test_a_field_of_the_plane_is_where_it_should_be(tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    fields = {"vorticity": "1/s", "velocity": "m/s"}
    part = substep.Part("grid", fields, bounds=[(1, 2), (3, 3)], cell=0.25)
    vorticity = np.arange(32.0).reshape(8, 4) - 10
    velocity = np.stack([vorticity, 0 * vorticity + 3], axis=-1)
    path = tmp_path / "plane.vtkhdf"
    with substep.Recorder(path, parts={"air": part}) as recorder:
        recorder.append(0, {"air": {"vorticity": vorticity, "velocity": velocity}})
    axes = Figure().add_subplot()
    image = draw_field(axes, part, vorticity, (-21, 21))
    assert list(image.get_extent()) == [1, 3, 2, 3] and image.origin == "lower"
    assert np.array_equal(image.get_array(), vorticity.T)
    assert np.array_equal(scalar(part, velocity), np.hypot(vorticity, 3))
    draw_streamlines(axes, part, np.stack([0 * vorticity + 1, 0 * vorticity], axis=-1))
    (line, *_) = axes.collections
    assert np.ptp(np.array(line.get_segments())[..., 1], axis=1).max() < 1e-9
    with substep.Recording(path) as recording:
        most = np.quantile(np.abs(vorticity), 0.98)  # without its few extremes
        assert limits_of(recording, "vorticity") == pytest.approx((-most, most))
        assert limits_of(recording, "velocity")[0] >= 3
        figure = render.draw(recording)
        assert [axes.get_ylabel() for axes in figure.axes[1::2]] == [
            "vorticity [1/s]",
            "velocity [m/s]",
        ]
        with pytest.raises(substep.InputError, match="three dimensions"):
            render.draw(recording, color="velocity")


@pytest.mark.usefixtures("egl_there")
def test_looks_of_no_part_are_refused(tmp_path):
    recording = smoky(tmp_path, [np.zeros((8, 8, 8), np.float32)])
    with pytest.raises(substep.InputError, match=r"looks: .*before"):
        View(looks={"bevor": Look()}).image(recording, 0, SIZE)


@pytest.mark.usefixtures("egl_there")
def test_a_temperature_is_drawn_in_colours(tmp_path):
    heat = np.linspace(300, 400, 8)[:, None, None] * np.ones((8, 8, 8))
    recording = smoky(tmp_path, [heat.astype(np.float32)], name="temperature")
    view = View(FRONT, {"before": Look(hidden=True)}, ground=lambda recording: None)
    left, right = redness(view.image(recording, 0, SIZE))
    assert right > left + 30
