"""Views and pages in a real browser: what is there is seen, plays, and can be changed."""

import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import substep
from matplotlib.image import imread
from substep.view.browser import Viewer

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("viser", reason="viser is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
if CHROMIUM is None:
    pytest.skip("no browser: install chromium", allow_module_level=True)
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

PATIENCE = 60.0  # s; pictures of software rendering are slow


@pytest.fixture(scope="module")
def chromium():
    software = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=software)
        yield browser
        browser.close()


@pytest.fixture
def tab(chromium):
    """A page that may load local things alone, and in which no error may occur."""
    page, wrong = open_tab(chromium, 640, 400)
    yield page
    page.close()
    assert wrong == []


def open_tab(chromium, width, height):
    """A page, and a list of what goes wrong in it."""
    page = chromium.new_page(viewport={"width": width, "height": height})
    wrong = []
    local = ("file:", "data:", "blob:", "http://127.0.0.1", "ws://127.0.0.1")
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda told: wrong.append(told.text) if told.type == "error" else None)
    page.on("request", lambda r: None if r.url.startswith(local) else wrong.append(r.url))
    return page, wrong


def seen(page, tmp_path):
    page.screenshot(path=tmp_path / "seen.png")
    return imread(tmp_path / "seen.png")[:, :, :3]


def reddish(image):
    """Pixels of the first colour of the palette, in any light."""
    return (image[..., 0] > 0.35) & (image[..., 0] > 1.5 * image[..., 2])


def wait_for(page, done):
    """Look until it is true of what is seen."""
    for _ in range(int(2 * PATIENCE)):
        if (value := done()) is not None and value is not False:
            return value
        page.wait_for_timeout(500)
    raise AssertionError("the picture did not come")


@pytest.fixture
def drift(tmp_path):
    """A cube of balls that drifts by six times its side."""
    balls = substep.fill_box((0, 0, 0), (0.5, 0.5, 0.5), 0.1)
    parts = {"balls": substep.Part("particles", {"height": "m"})}
    with substep.Recorder(tmp_path / "drift.vtkhdf", parts=parts) as recorder:
        for k in range(31):
            x = balls + np.array([0.1 * k, 0, 0])
            recorder.append(0.1 * k, {"balls": {"points": x, "height": x[:, 2]}})
    with substep.Recording(tmp_path / "drift.vtkhdf") as recording:
        yield recording


def test_a_page_plays_without_python_and_without_a_network(drift, tab, tmp_path):
    drift.to_html(tmp_path / "drift.html", fps=1.0)
    tab.goto((tmp_path / "drift.html").as_uri())

    def column():
        red = reddish(seen(tab, tmp_path))
        return float(np.nonzero(red)[1].mean()) if red.sum() > 200 else None

    first = wait_for(tab, column)
    wait_for(tab, lambda: abs((column() or first) - first) > 60)


def test_a_recording_is_scrubbed_and_coloured(drift, tab, tmp_path):
    with Viewer(drift, None, None, False, 8080) as viewer:
        tab.goto(viewer.url)
        wait_for(tab, lambda: reddish(seen(tab, tmp_path)).sum() > 200)
        assert tab.get_by_text("t = 0 s").count() == 1
        viewer._frame.value = 30
        viewer._touch()
        wait_for(tab, lambda: tab.get_by_text("t = 3 s").count() == 1)
        tab.get_by_role("combobox", name="colour").click()
        tab.get_by_role("option", name="height").click()
        wait_for(tab, lambda: tab.get_by_text("height [m]").count() == 1)
        wait_for(tab, lambda: reddish(seen(tab, tmp_path)).sum() < 20)


def test_a_simulation_runs_pauses_steps_and_is_changed(tab, tmp_path):
    water = substep.fill_box((0, 0, 1), (0.3, 0.3, 1.3), 0.1)
    fluid = substep.PositionBasedFluid(water, 0.1, colliders=[substep.Plane()])
    with Viewer(fluid, None, None, False, 8080) as viewer:
        tab.goto(viewer.url)
        wait_for(tab, lambda: reddish(seen(tab, tmp_path)).sum() > 50)
        assert fluid.time == 0
        tab.get_by_role("button", name="step", exact=True).click()
        wait_for(tab, lambda: fluid.time > 0)
        dt = fluid.time
        tab.wait_for_timeout(500)
        assert fluid.time == dt  # one step alone
        tab.locator("input[value='-9.81']").click()
        for key in ("Control+A", "2", "Enter"):
            tab.keyboard.press(key)
        wait_for(tab, lambda: fluid.gravity[2] == 2.0)
        tab.get_by_role("checkbox").first.click()
        wait_for(tab, lambda: viewer.drawn > 20)
        tab.get_by_role("checkbox").first.click()
        wait_for(tab, lambda: not viewer._playing.value)
        tab.wait_for_timeout(500)
        assert fluid.positions[:, 2].min() > 1.0  # it has risen
    assert viewer._closed.is_set()


def test_a_failure_is_told_and_pauses(tab, tmp_path):
    class Broken(substep.PositionBasedFluid):
        def step(self, dt=None):
            raise substep.SolverError("the pump is broken", time=1.0)

    with Viewer(Broken([[0.0, 0, 1]], 0.1), None, None, True, 8080) as viewer:
        tab.goto(viewer.url)
        wait_for(tab, lambda: tab.get_by_text("the pump is broken").count() == 1)
        assert not viewer._playing.value


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_hot_corner_of_a_grid_is_seen_in_its_place(dimension, tab, tmp_path):
    """At the left and on top it is yellow, elsewhere purple."""
    heat = np.zeros(dimension * (8,))
    heat[0, ..., -1] = 1.0
    box = np.array([np.zeros(dimension), np.ones(dimension)])
    part = substep.Part("grid", {"heat": "J"}, bounds=box, cell=1 / 8)
    with substep.Recorder(tmp_path / "grid.vtkhdf", parts={"grid": part}) as recorder:
        recorder.append(0.0, {"grid": {"heat": heat}})
    with substep.Recording(tmp_path / "grid.vtkhdf") as recording:
        recording.to_html(tmp_path / "grid.html")
    tab.goto((tmp_path / "grid.html").as_uri())
    tab.add_style_tag(content=".mantine-Notification-root, body > div[style] {display: none}")

    def places():
        red, green, blue = np.moveaxis(seen(tab, tmp_path), -1, 0)
        found = (green > 0.7) & (blue < 0.5), (green < 0.2) & (red < 0.4) & (blue > 0.2)
        if min(map(np.sum, found)) < 50:
            return None
        return [np.argwhere(pixels).mean(axis=0) for pixels in found]

    yellow, purple = wait_for(tab, places)
    assert np.all(yellow < purple - 20)


def test_the_command_line_shows_a_recording_until_ctrl_c(drift, tab, tmp_path):
    command = [sys.executable, "-m", "substep", "view", str(drift.path), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view:
        try:
            url = view.stdout.readline().split()[0]
            tab.goto(url)
            wait_for(tab, lambda: reddish(seen(tab, tmp_path)).sum() > 200)
            view.send_signal(signal.SIGINT)
            assert view.wait(PATIENCE) == 0
        finally:
            view.kill()


def test_smoke_hides_what_is_behind_it_and_not_what_is_before_it(chromium, tmp_path):
    """A wall at the left before a box of even smoke, and one at the right behind it."""
    parts = {"air": substep.Part("grid", {"smoke": "1"}, bounds=[(0, 0, 0), (2, 2, 2)], cell=0.25)}
    for name, (x0, x1, y) in {"before": (0, 0.5, -0.5), "behind": (1, 2, 2.5)}.items():
        corners = [[x0, y, 0], [x1, y, 0], [x1, y, 2], [x0, y, 2]]
        parts[name] = substep.Part("mesh", triangles=[[0, 1, 2], [0, 2, 3]], points=corners)
    with substep.Recorder(tmp_path / "smoke.vtkhdf", parts=parts) as recorder:
        for k, density in enumerate((0.0, 0.05, 1.0)):
            recorder.append(k, {"air": {"smoke": np.full((8, 8, 8), density)}})
    page, wrong = open_tab(chromium, 1000, 800)
    with (
        substep.Recording(tmp_path / "smoke.vtkhdf") as recording,
        Viewer(recording, None, None, False, 8080) as viewer,
    ):
        camera = viewer._server.initial_camera
        camera.position, camera.look_at = (1.0, -12.0, 1.0), (1.0, 1.0, 1.0)
        page.goto(viewer.url)

        def brightness():
            """Of the wall before, and at the left and at the right of the edge of that behind."""
            image = seen(page, tmp_path).mean(axis=2)[380:420]
            return [float(image[:, a:b].mean()) for a, b in ((425, 440), (485, 495), (505, 515))]

        found = {}
        for frame in (2, 0, 1):  # what lights the walls comes in some time after the page
            viewer._frame.value = frame
            viewer._touch()
            wait_for(page, lambda k=frame: page.get_by_text(f"t = {k} s").count() == 1)
            page.wait_for_timeout(3000)
            wait_for(page, lambda: brightness() == brightness())
            found[frame] = np.array(brightness())
    page.close()
    # The squares of viser's blobs have no third coordinate, of which its three.js complains once.
    assert [text for text in wrong if "computeBoundingSphere" not in text] == []
    before, left, right = np.array([found[k] for k in range(3)]).T
    assert np.ptp(before) < 0.01
    contrast = left - right
    assert contrast[0] > 0.3 and abs(contrast[2]) < 0.01
    # Light through 8 cells of optical depth 14 x 0.05 / 8.
    assert contrast[1] / contrast[0] == pytest.approx(np.exp(-14 * 0.05), rel=0.1)


def test_a_recording_that_is_being_written_is_followed(tab, tmp_path):
    parts = {"ball": substep.Part("particles")}
    with substep.Recorder(tmp_path / "run.vtkhdf", parts=parts) as recorder:
        recorder.append(0.0, {"ball": {"points": [[0.0, 0, 0]]}})
        with (
            substep.Recording(tmp_path / "run.vtkhdf") as recording,
            Viewer(recording, None, None, False, 8080) as viewer,
        ):
            tab.goto(viewer.url)
            wait_for(tab, lambda: tab.get_by_text("t = 0 s").count() == 1)
            recorder.append(1.0, {"ball": {"points": [[0.0, 0, 1]]}})
            wait_for(tab, lambda: tab.get_by_text("t = 1 s").count() == 1)
            viewer._frame.value = 0
            recorder.append(2.0, {"ball": {"points": [[0.0, 0, 2]]}})
            wait_for(tab, lambda: viewer._frame.max == 2)
            wait_for(tab, lambda: tab.get_by_text("t = 0 s").count() == 1)  # where it was left
            tab.get_by_role("checkbox").first.click()  # plays to the end, and waits there
            wait_for(tab, lambda: tab.get_by_text("t = 2 s").count() == 1)
            tab.wait_for_timeout(1000)
            assert viewer._frame.value == 2
            recorder.append(3.0, {"ball": {"points": [[0.0, 0, 3]]}})
            wait_for(tab, lambda: tab.get_by_text("t = 3 s").count() == 1)
