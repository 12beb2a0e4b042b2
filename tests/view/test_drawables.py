"""What there is to see of every simulation, without a browser; and what notebooks show."""

import contextlib
import io
import os
import signal
import socket
import threading
import time

import matplotlib.figure
import matplotlib.image
import numpy as np
import pytest
import substep
from substep.recording.contents import particle_frame, particle_parts
from substep.view import browser, page, painted
from substep.view.browser import Viewer
from substep.view.cloud import blocks
from substep.view.drawables import Drawable, Scenery
from substep.view.painted import Paint, close_server, cloud, open_server, palette, sheet
from test_conformance import classes, example

CLASSES = pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)


def pixels(png):
    return matplotlib.image.imread(io.BytesIO(png))[:, :, :3]


@CLASSES
def test_every_simulation_shows_all_that_it_consists_of(kind):
    simulation = example(kind)()
    simulation.step()
    scenery = Scenery(simulation)
    drawn = scenery.at()
    assert len({one.name for one in drawn}) == len(drawn)
    for one in drawn:
        assert one.points.dtype == np.float32 and np.isfinite(one.points).all()
        assert not len(one.rows) or 0 <= one.rows.min() <= one.rows.max() < len(one.points)
        if one.kind != "cells":
            assert all(len(values) == len(one.points) for values in one.fields.values())
    assert {name for one in drawn for name in one.fields} == set(scenery.fields)
    for member in getattr(simulation, "members", {"": simulation}).values():
        x = member.fields().get("position", (np.zeros((0, 3)),))[0].astype(float)
        x = np.pad(x, ((0, 0), (0, 3 - x.shape[1])))
        if "orientation" in member.fields():  # solids about these places, but for the ground
            [mesh] = [one for one in drawn if one.name == "bodies"]
            x = x[x[:, 2] != 0]
            assert np.all(mesh.points.min(axis=0) < x.min(axis=0))
            assert np.all(mesh.points.max(axis=0) > x.max(axis=0))
        elif len(x):
            seen = np.concatenate([one.points for one in drawn])
            far = np.linalg.norm(seen[None] - x[:, None], axis=-1).min(axis=1)
            assert far.max() < 1e-6


@CLASSES
def test_every_simulation_says_and_pictures_what_is_in_it(kind):
    simulation = example(kind)()
    assert kind.__name__ in repr(simulation)
    png = simulation._repr_png_()
    colored = np.ptp(pixels(png), axis=-1) > 0.1
    assert colored.sum() > 10
    words = simulation._repr_html_()
    assert "data:image/png;base64," in words and kind.__name__ in words


SHAPES = {
    "ball": substep.Sphere(0.3, (0.1, 0.2, 0.3)),
    "box": substep.Box((0.2, 0.3, 0.4), (0.1, 0, 0), (0.8, 0.6, 0, 0)),
    "capsule": substep.Capsule(0.1, 0.4, (0, 0.3, 0), (0.6, 0, 0.8, 0)),
    "cylinder": substep.Cylinder(0.2, 0.5),
    "plane": substep.Plane((0.2, 0.1, 1), (0, 0, 0.4)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_obstacles_are_seen_where_their_distance_is_0(name):
    """Also where they were carried and turned to."""
    turning = {"velocity": (0.4, 0, 0.1), "angular_velocity": (0.3, 1.0, -0.2)}
    obstacle = substep.Collider(SHAPES[name], **turning)
    water = substep.fill_box((0, 0, 2), (0.2, 0.2, 2.2), 0.05)
    fluid = substep.PositionBasedFluid(water, 0.05, colliders=[obstacle])
    scenery = Scenery(fluid)
    for _ in range(2):
        [one] = [d for d in scenery.at() if d.kind == "surface"]
        assert np.abs(obstacle.distance(one.points.astype(float))).max() < 1e-6
        obstacle.advance(0.7)


def test_an_obstacle_of_a_plane_is_seen_as_its_section():
    ball = substep.Collider(substep.Sphere(0.5, (1, 0.5, 0.3)))
    water = np.array([[0.0, 2.0], [0.1, 2.0]])
    fluid = substep.PositionBasedFluid(water, 0.05, gravity=(0, -9.81), colliders=[ball])
    scenery = Scenery(fluid)
    [one] = [d for d in scenery.at() if d.kind == "lines"]
    assert scenery.flat and not one.points[:, 2].any()
    r = np.linalg.norm(one.points[:, :2] - (1, 0.5), axis=1)
    # A circle of sqrt(0.5^2 - 0.3^2) = 0.4; edges of 1/32 of a turn are 0.5 (pi / 32)^2 / 2 within.
    assert 0.39 < r.min() and r.max() < 0.4 + 1e-6
    angle = np.sort(np.arctan2(*(one.points[:, :2] - (1, 0.5)).T))
    assert np.diff(angle).max() < 0.25


def test_what_lies_flat_at_first_is_in_space():
    sheet = substep.geometry.grid_mesh(3, 3)
    cloth = substep.MassSpring.from_mesh(sheet, stiffness=100.0, density=0.1)
    assert not Scenery(cloth).flat


def test_bodies_are_seen_in_their_places():
    bodies = substep.RigidBodies()
    turn = np.array([0.8, 0, 0.6, 0])
    bodies.add(substep.Box((0.2, 0.4, 0.6)), (1, 2, 3), turn, velocities=(1, 0, 0))
    bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    drawn = {one.name: one for one in Scenery(bodies).at()}
    x = drawn["bodies"].points - (1, 2, 3)
    cosine, sine = 0.8**2 - 0.6**2, 2 * 0.8 * 0.6  # about y
    back = np.column_stack(
        [cosine * x[:, 0] - sine * x[:, 2], x[:, 1], sine * x[:, 0] + cosine * x[:, 2]]
    )
    assert np.allclose(np.abs(back), (0.1, 0.2, 0.3), atol=1e-6)
    assert np.all(drawn["bodies"].fields["velocity"] == 1.0)
    assert not drawn["bodies-ground-0"].points[:, 2].any()


def test_a_recording_shows_what_the_simulation_did(tmp_path):
    cube = example(substep.SoftBody)()
    with substep.Recorder(tmp_path / "a.vtkhdf", parts=particle_parts(cube)) as recorder:
        recorder.append(0.0, particle_frame(cube))
    with substep.Recording(tmp_path / "a.vtkhdf") as recording:
        assert "mesh" in repr(recording) and "1 frames" in repr(recording)
        [then], [now] = Scenery(recording).at(0), Scenery(cube).at()
        assert recording._repr_png_()[:4] == b"\x89PNG"
    assert then.kind == now.kind == "surface"
    assert np.array_equal(then.points, now.points) and np.array_equal(then.rows, now.rows)


def test_a_recording_shows_bodies_with_their_shapes(tmp_path):
    """As the simulation does; the ground has no end and no shape, and is not a ball."""
    bodies = substep.RigidBodies()
    bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    bodies.add(substep.Box((0.2, 0.4, 0.6)), (1, 2, 3), (0.8, 0, 0.6, 0), velocities=(1, 0, 0))
    bodies.add(substep.Sphere(0.1), (0, 0, 1))
    with substep.Recorder(tmp_path / "a.vtkhdf", parts=particle_parts(bodies)) as recorder:
        recorder.append(0.0, particle_frame(bodies))
    with substep.Recording(tmp_path / "a.vtkhdf") as recording:
        [then] = Scenery(recording).at(0)
    [now] = [one for one in Scenery(bodies).at() if one.name == "bodies"]
    assert then.kind == "surface" and np.array_equal(then.rows, now.rows)
    assert np.array_equal(then.points, now.points)
    assert np.array_equal(then.fields["velocity"], now.fields["velocity"])


@pytest.mark.parametrize("axis", [None, 0, 1, 2])
def test_a_cut_shows_the_cells_where_they_are(axis):
    shape = (4, 5) if axis is None else (4, 5, 6)
    values = np.zeros(shape)
    values[-1, 1 if axis is None else -1, ...] = 1.0  # right below, or at the far corner
    corners = np.array([[0, 0, 0], [*shape, 0][:3]], np.float32)
    one = Drawable("grid", "cells", corners, fields={"smoke": values})
    place = 0.99
    image, box = sheet(one, Paint("smoke", {"smoke": (0.0, 1.0)}, axis or 0, place))
    hot = np.argwhere((image == palette(np.ones(1), "smoke", (0, 1))[0]).all(axis=-1))
    if axis is None:
        assert image.shape[:2] == (5, 4) and hot.tolist() == [[3, 3]]
        return
    rows, columns = np.delete(shape, axis)[::-1]
    assert image.shape[:2] == (rows, columns)
    assert np.allclose(box[:, axis], place * shape[axis])
    # The hot cells are an edge along z, which a cut across z meets in its upper right corner.
    met = [0] if axis == 2 else range(rows)
    assert hot.tolist() == [[row, columns - 1] for row in met]


def test_a_volume_has_the_smoke_of_the_cells_in_its_place():
    smoke = np.zeros((5, 6, 7))
    smoke[4, 5, 6], smoke[0, 0, 0] = 1.0, np.nan
    means, side = blocks(smoke, most=40)
    assert means.shape == (3, 3, 4) and side == 2
    assert np.argwhere(means).tolist() == [[2, 2, 3]] and 8 * means.sum() == 1
    assert blocks(smoke)[1] == 1
    box = np.array([[1, 1, 1], [6, 7, 8]], np.float32)
    one = Drawable("air", "cells", box, fields={"smoke": smoke})
    white, side = cloud(one, Paint(None, {}, axis=None))
    assert white.shape == (5, 6, 7, 4) and side == 1
    assert np.argwhere(white[..., 3]).tolist() == [[4, 5, 6]]
    colored, _ = cloud(one, Paint("smoke", {"smoke": (0.0, 2.0)}, axis=None))
    assert colored[4, 5, 6, :3].tolist() == palette(np.ones(1), "smoke", (0, 2))[0].tolist()
    assert 0 < colored[4, 5, 6, 3] < white[4, 5, 6, 3]


def test_results_fields_and_regions_have_pictures():
    gyre = substep.DoubleGyre()
    x = np.array([[0.5, 0.5], [1.0, 0.3]])
    decay = {"fun": lambda t, y: -y, "t_span": (0, 1)}
    things = [
        substep.solve_ivp(**decay, y0=[1.0, 2.0], method="rk4", step=0.1),
        substep.solve_second_order(lambda t, x, v: -x, (0, 1), [1.0], [0.0], step=0.1),
        substep.advect(gyre, x, (0, 1), 0.1, t_eval=np.linspace(0, 1, 5)),
        substep.stability.region("rk4"),
        gyre,
        substep.ABC(),
        substep.TaylorGreen(),
    ]
    for thing in things:
        assert pixels(thing._repr_png_()).std() > 0.02
        assert type(thing).__name__ in repr(thing) or isinstance(thing, dict)
        assert len(repr(thing)) < 1000


def test_what_a_callback_raises_is_told_and_the_view_goes_on():
    pytest.importorskip("viser", reason="viser is not installed")

    class Broken(substep.PositionBasedFluid):
        broken = True

        def step(self, dt=None):
            if self.broken:
                raise KeyError("no such pump")
            super().step(dt)

    fluid = Broken([[0.0, 0, 1]], 0.1)
    with Viewer(fluid, None, None, True, 8080) as viewer:
        wait_until(lambda: "KeyError: 'no such pump'" in viewer._told.content)
        assert viewer._thread.is_alive() and not viewer._playing.value
        viewer._problem = ""
        viewer._single()
        assert viewer._problem == "KeyError: 'no such pump'"
        fluid.broken = False
        viewer._playing.value = True
        viewer._touch()
        wait_until(lambda: fluid.time > 0)


def test_close_waits_for_the_step_and_closes_what_show_opened(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    began, go_on = threading.Event(), threading.Event()

    class Slow(substep.PositionBasedFluid):
        def step(self, dt=None):
            began.set()
            assert go_on.wait(20)
            super().step(dt)

    viewer = Viewer(Slow([[0.0, 0, 1]], 0.1), None, None, True, 8080)
    assert began.wait(20)
    closing = threading.Thread(target=viewer.close)
    closing.start()
    closing.join(0.2)
    assert closing.is_alive()
    go_on.set()
    closing.join(20)
    assert not closing.is_alive() and not viewer._thread.is_alive()
    path = tmp_path / "a.vtkhdf"
    with substep.Recorder(path, parts={"p": substep.Part()}) as recorder:
        recorder.append(0.0, {"p": {"points": [[0.0, 0, 0]]}})
    viewer = substep.show(path, open_browser=False, wait=False)
    viewer.close()
    with pytest.raises(substep.InputError, match="closed"):
        viewer.source.frame(0)
    with substep.Recording(path) as recording:
        substep.show(recording, open_browser=False, wait=False).close()
        recording.frame(0)  # is not closed


def test_a_packed_recording_that_is_resumed_is_followed(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    path, parts = tmp_path / "a.vtkhdf", {"p": substep.Part()}
    with substep.Recorder(path, parts=parts) as recorder:
        recorder.append(0.0, {"p": {"points": [[0.0, 0, 0]]}})
    with substep.show(path, open_browser=False, wait=False) as viewer:
        with substep.Recorder(path, parts=parts, resume=True) as recorder:
            recorder.append(1.0, {"p": {"points": [[0.0, 0, 1]]}})
            wait_until(lambda: "t = 1 s" in viewer._told.content)
            assert viewer._frame.max == viewer._frame.value == 1


def test_frames_that_another_thread_took_in_are_followed(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    path, parts = tmp_path / "a.vtkhdf", {"p": substep.Part()}
    with substep.Recorder(path, parts=parts) as recorder:
        recorder.append(0.0, {"p": {"points": [[0.0, 0, 0]]}})
        with substep.Recording(path) as recording:
            with substep.show(recording, open_browser=False, wait=False) as viewer:
                recorder.append(1.0, {"p": {"points": [[0.0, 0, 1]]}})
                assert recording.refresh() == 2
                wait_until(lambda: "t = 1 s" in viewer._told.content)
                assert viewer._frame.max == viewer._frame.value == 1


def test_a_second_interrupt_while_it_closes_leaves_no_server(monkeypatch):
    pytest.importorskip("viser", reason="viser is not installed")
    usual, come = browser.close_server, []

    def interrupted(server):
        come.append(server)
        if len(come) < 3:
            raise KeyboardInterrupt
        usual(server)

    monkeypatch.setattr(browser, "close_server", interrupted)
    fluid = substep.PositionBasedFluid([[0.0, 0, 1]], 0.1)
    viewer = substep.show(fluid, open_browser=False, wait=False)
    with pytest.raises(KeyboardInterrupt):  # twice, of which the second is in what follows
        viewer.close()
    viewer.close()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", viewer._server.get_port()))
    viewer.close()
    assert len(come) == 3


def wait_until(true):
    end = time.monotonic() + 20
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_no_free_port_is_told():
    pytest.importorskip("viser", reason="viser is not installed")
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # somebody else has it
            stack.enter_context(socket.create_server(("127.0.0.1", 65535)))
        with pytest.raises(OSError, match="port: none from 65535 to 65535 is free"):
            open_server("nothing", 65535)


@pytest.mark.parametrize("place", ["open_server", "close_server"])
def test_an_interrupted_page_leaves_no_server(tmp_path, monkeypatch, place):
    """Ctrl-C right after it is opened, or right before it is closed."""
    pytest.importorskip("viser", reason="viser is not installed")
    opened = []

    def open_it(label):
        opened.append(open_server(label))
        if place == "open_server":
            os.kill(os.getpid(), signal.SIGINT)
        return opened[0]

    def close_it(server):
        if place == "close_server":
            os.kill(os.getpid(), signal.SIGINT)
        close_server(server)

    monkeypatch.setattr(page, "open_server", open_it)
    monkeypatch.setattr(page, "close_server", close_it)
    with substep.Recorder(tmp_path / "a.vtkhdf", parts={"p": substep.Part()}) as recorder:
        recorder.append(0.0, {"p": {"points": [[0.0, 0, 0]]}})
    with substep.Recording(tmp_path / "a.vtkhdf") as recording:
        with pytest.raises(KeyboardInterrupt):
            recording.to_html(tmp_path / "a.html")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", opened[0].get_port())).close()
    assert not (tmp_path / "a.html").exists()


STAGES = {
    "making": (painted, "_served"),
    "painting": (painted.Painter, "put"),
    "camera": (browser, "place_camera"),
    "controls": (Viewer, "_make_controls"),
    "thread": (threading.Thread, "start"),
    "tab": (browser.webbrowser, "open"),
    "waiting": (Viewer, "wait"),
    "end of waiting": (threading.Thread, "join"),
}


@pytest.mark.parametrize(
    ("stage", "after"),
    [(stage, False) for stage in STAGES]
    + [(stage, True) for stage in ("painting", "camera", "controls", "thread")],
)
def test_an_interrupt_while_it_is_shown_leaves_no_server(tmp_path, monkeypatch, stage, after):
    viser = pytest.importorskip("viser", reason="viser is not installed")
    served, stopped, come = [], [], threading.Event()
    make, stop = viser.ViserServer.__init__, viser.ViserServer.stop

    def made(server, *arguments, **options):
        make(server, *arguments, **options)
        served.append(server)

    def end(server):
        stopped.append(server)
        stop(server)

    owner, name = STAGES[stage]
    usual = getattr(owner, name)

    def interrupted(*arguments, **options):
        of_view = name not in ("start", "join") or arguments[0].name == "substep-view"
        if come.is_set() or not of_view:
            return usual(*arguments, **options)
        come.set()
        if name == "_served":  # in a thread, which no interrupt comes to
            os.kill(os.getpid(), signal.SIGINT)
            return usual(*arguments, **options)
        if after:
            usual(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(viser.ViserServer, "__init__", made)
    monkeypatch.setattr(viser.ViserServer, "stop", end)
    monkeypatch.setattr(browser.webbrowser, "open", lambda url: True)
    monkeypatch.setattr(owner, name, interrupted)
    path = tmp_path / "a.vtkhdf"
    with substep.Recorder(path, parts={"p": substep.Part()}) as recorder:
        recorder.append(0.0, {"p": {"points": [[0.0, 0, 0]]}})
    with pytest.raises(KeyboardInterrupt):
        viewer = substep.show(path, open_browser=True, wait=stage == "waiting")
        viewer.close()
    wait_until(lambda: stopped)
    assert len(served) == 1 and stopped == served
    wait_until(lambda: all(t.name != "substep-view" for t in threading.enumerate()))


def test_what_is_not_there_is_told(tmp_path):
    with pytest.raises(TypeError, match="source: expected a simulation"):
        substep.show(3)
    for color in ("Velocity", ["velocity"]):
        with pytest.raises(substep.InputError, match="color: expected one of velocity"):
            substep.show(substep.PositionBasedFluid([[0.0, 0, 1]], 0.1), color=color)
    with substep.Recorder(tmp_path / "a.vtkhdf", parts={"p": substep.Part()}) as recorder:
        recorder.append(0.0, {"p": {"points": [[0.0, 0, 0]]}})
    with substep.Recording(tmp_path / "a.vtkhdf") as recording:
        with pytest.raises(substep.InputError, match="fps"):
            recording.to_html(tmp_path / "a.html", fps=0)
        with pytest.raises(substep.InputError, match="color"):
            recording.to_html(tmp_path / "a.html", color="speed")
        assert not (tmp_path / "a.html").exists()


def small_flat_world():
    """A ball of 0.1 m in water that has two dimensions."""
    bodies = substep.RigidBodies(gravity=(0, -9.81, 0))
    ball = bodies.add(substep.Sphere(0.1), (0.5, 0.4, 0), density=500.0)
    water = substep.GridLiquid(
        substep.fill_box((0, 0), (1, 0.4), 0.05),
        cell=0.1,
        bounds=((0, 0), (1, 1)),
        colliders=bodies.make_colliders(ball),
    )
    return substep.World({"bodies": bodies, "water": water})


@pytest.mark.parametrize("recorded", [False, True])
def test_bodies_in_water_of_a_plane_are_seen_as_their_sections(recorded, tmp_path):
    source = small_flat_world()
    if recorded:
        source = substep.Recording(substep.scenes.record(source, tmp_path / "one.vtkhdf", 0.0))
    scenery = Scenery(source)
    [one] = [d for d in scenery.at() if d.name == "bodies"]
    assert scenery.flat
    r = np.linalg.norm(one.points[:, :2] - (0.5, 0.4), axis=1)
    assert 0.098 < r.min() and r.max() < 0.1 + 1e-6
    if recorded:
        figure = matplotlib.figure.Figure()
        substep.render.plain_picture(source, 0, figure)
        axes = figure.axes[0]
        assert [len(c.get_paths()) for c in axes.collections] == [len(one.rows), 1]
        assert axes.get_ylim()[1] > 0.5


def test_a_cloth_in_the_plane_of_a_liquid_stays_a_surface():
    sheet = substep.geometry.grid_mesh(3, 3)
    cloth = substep.MassSpring.from_mesh(sheet, stiffness=100.0, density=0.1)
    water = substep.GridLiquid(
        substep.fill_box((0, 0), (1, 1), 0.1), cell=0.2, bounds=((0, 0), (1, 1))
    )
    scenery = Scenery(substep.World({"cloth": cloth, "water": water}))
    assert scenery.flat and "surface" in [d.kind for d in scenery.at()]
