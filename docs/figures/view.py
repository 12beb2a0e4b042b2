"""The pictures of docs/view.md: a dam break in the browser while it runs, and a plume of smoke.

PYTHONPATH=python python docs/figures/view.py; needs playwright and chromium.
"""

import shutil
from pathlib import Path

import substep
from playwright.sync_api import sync_playwright
from substep.scenes.gridfluid.smoke import SCENE as SMOKE
from substep.view import Viewer

SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def look(browser, source, color, out):
    with Viewer(source, color, None, False, 8080) as viewer:
        page = browser.new_page(viewport={"width": 1100, "height": 560})
        page.goto(viewer.url)
        page.wait_for_timeout(12_000)
        message = page.locator(".mantine-Notification-root")
        if message.count():  # that WebGL is drawn by software
            message.first.get_by_role("button").click()
            page.wait_for_timeout(4000)
        page.screenshot(path=Path(__file__).with_name(out))
        page.close()


def main():
    water = substep.fill_box((0, 0, 0), (0.5, 0.5, 0.6), 0.0125)
    obstacle = substep.Box((0.16, 0.2, 0.16), center=(1.2, 0.25, 0.08))
    tank = ((0, 0, 0), (1.6, 0.5, 0.8))
    liquid = substep.GridLiquid(water, cell=0.025, bounds=tank, colliders=[obstacle])
    liquid.advance(0.45)
    defaults = {name: each.default for name, each in SMOKE.parameters.items()}
    plume = SMOKE.build(defaults | {"cells": 40}, 0)
    plume.advance(2.4)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=SOFTWARE
        )
        look(browser, liquid, "velocity", "view.png")
        look(browser, plume, None, "view-smoke.png")
        browser.close()


if __name__ == "__main__":
    main()
