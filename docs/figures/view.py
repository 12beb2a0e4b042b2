"""The picture of docs/view.md: a dam break in the browser while it runs.

PYTHONPATH=python python docs/figures/view.py; needs playwright and chromium.
"""

import shutil
from pathlib import Path

import substep
from playwright.sync_api import sync_playwright
from substep.view import Viewer

OUT = Path(__file__).with_suffix(".png")
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main():
    water = substep.fill_box((0, 0, 0), (0.5, 0.5, 0.6), 0.0125)
    obstacle = substep.Box((0.16, 0.2, 0.16), center=(1.2, 0.25, 0.08))
    tank = ((0, 0, 0), (1.6, 0.5, 0.8))
    liquid = substep.GridLiquid(water, cell=0.025, bounds=tank, colliders=[obstacle])
    liquid.advance(0.45)
    with sync_playwright() as playwright, Viewer(liquid, "velocity", None, False, 8080) as viewer:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=SOFTWARE
        )
        page = browser.new_page(viewport={"width": 1100, "height": 560})
        page.goto(viewer.url)
        page.wait_for_timeout(12_000)
        message = page.locator(".mantine-Notification-root")
        if message.count():  # that WebGL is drawn by software
            message.first.get_by_role("button").click()
            page.wait_for_timeout(4000)
        page.screenshot(path=OUT)
        browser.close()


if __name__ == "__main__":
    main()
