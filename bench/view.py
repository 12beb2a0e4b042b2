"""Pictures a second of a page that plays 100,000 balls, in Debian's Chromium without a screen.

Beside it the time that Chromium's graphics process takes for a picture, by the processor's clock:
without a graphics card it draws by software, and a core of its own gives no more than 1 / that.
Needs playwright and chromium, as tests/view/test_browser.py does.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import psutil
import substep
from playwright.sync_api import sync_playwright

COUNT = """seconds => new Promise(done => {
  let pictures = 0;
  const begun = performance.now();
  const look = now => {
    if (now - begun > 1000 * seconds) done(1000 * pictures / (now - begun));
    else { ++pictures; requestAnimationFrame(look); }
  };
  requestAnimationFrame(look);
})"""


def graphics_time() -> float:
    """Seconds that the graphics processes of all browsers below this process have computed."""
    children = psutil.Process().children(recursive=True)
    drawing = [c for c in children if "--type=gpu-process" in c.cmdline()]
    return sum(sum(c.cpu_times()[:2]) for c in drawing)


def main() -> None:
    """Print JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    balls, seconds = (10_000, 4.0) if parser.parse_args().quick else (100_000, 20.0)
    random = np.random.default_rng(0)
    x, v = random.uniform(-1, 1, (balls, 3)), random.normal(0, 0.1, (balls, 3))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / "balls.vtkhdf"
        parts = {"balls": substep.Part("particles")}
        with substep.Recorder(path, parts=parts) as recorder:
            for k in range(25):
                recorder.append(0.04 * k, {"balls": {"points": x + 0.04 * k * v}})
        with substep.Recording(path) as recording:
            recording.to_html(path.with_suffix(".html"), fps=25.0)
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = browser.new_page(viewport={"width": 960, "height": 540})
        page.goto(path.with_suffix(".html").as_uri())
        page.wait_for_selector("canvas")
        page.wait_for_timeout(10_000)
        before = graphics_time()
        rate = page.evaluate(COUNT, seconds)
        busy = (graphics_time() - before) / (rate * seconds)
        browser.close()
    record = {"workload": f"{balls} balls, 960 x 540", "peer": "none", "threads": 2, "isa": "any"}
    for metric, value, unit in (
        ("pictures", rate, "1 / s"),
        ("processor time of a picture's drawing", busy, "s"),
    ):
        print(json.dumps(record | {"metric": metric, "value": value, "unit": unit}), flush=True)


if __name__ == "__main__":
    main()
