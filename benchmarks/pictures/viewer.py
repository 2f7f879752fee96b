"""Take the picture of the browser page for docs/viewer.md: the showroom with a wipe, in a headless Chromium.

python -m benchmarks.pictures.viewer             # needs playwright and Debian's chromium
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT
from lobewise.scenes import BY_THEMSELVES
from lobewise.viewer import Viewer

FLAGS = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE = 300.0


def main() -> None:
    """Open the page, compare the lobes with normals, let frames accumulate, write a PNG."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", default="showroom", help="a scene")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images" / "viewer.png")
    parser.add_argument("--frames", type=int, default=12, help="frames of a scene that are averaged, or of its motion")
    moving = {"nargs": "?", "const": BY_THEMSELVES, "metavar": "FILE.json"}
    parser.add_argument("--moving-objects", **moving, help="let objects of a scene move")
    arguments = parser.parse_args()
    from playwright.sync_api import sync_playwright

    with Viewer(arguments.target, port=0, moving=arguments.moving_objects) as viewer, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 860})
        page.goto(viewer.url)
        wait(page, lambda: viewer.statistics["frames"] > 1)
        notice = page.locator(".mantine-Notification-closeButton")
        if notice.count():
            notice.first.click()
        page.get_by_label("Compare A, B", exact=True).click()
        seen = viewer.statistics["frames"]
        wait(page, lambda: viewer.statistics["frames"] > seen + 1)
        if arguments.moving_objects:
            wait(page, lambda: viewer.statistics["moments"][0] >= arguments.frames)
        else:
            wait(page, lambda: viewer.statistics["accumulated"][0] >= arguments.frames)
        # Away from the controls, whose hints would cover others.
        page.mouse.move(300, 60)
        page.wait_for_timeout(1500)
        page.screenshot(path=arguments.output)
        browser.close()
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e3:.0f} kB")


def wait(page: Any, condition: Any) -> None:
    """Return when the condition holds; the page lives on meanwhile."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"the page did not get there within {PATIENCE:.0f} s")
        page.wait_for_timeout(100)


if __name__ == "__main__":
    main()
