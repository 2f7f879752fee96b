"""Take the picture of the browser page for docs/viewer.md: the showroom with a wipe, in a headless Chromium.

python -m benchmarks.pictures.viewer             # needs playwright and Debian's chromium
"""

import argparse
from pathlib import Path

from benchmarks.common import ROOT
from benchmarks.interactive.viewer import open_browser, wait
from lobewise.scenes import BY_THEMSELVES
from lobewise.viewer import Viewer


def main() -> None:
    """Open the page, compare the lobes with normals, let frames accumulate, write a PNG."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", default="showroom", help="a scene")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images" / "viewer.png")
    parser.add_argument("--frames", type=int, default=12, help="frames of a scene that are averaged, or of its motion")
    moving = {"nargs": "?", "const": BY_THEMSELVES, "metavar": "FILE.json"}
    parser.add_argument("--moving-objects", **moving, help="let objects of a scene move")
    arguments = parser.parse_args()
    with Viewer(arguments.target, port=0, moving=arguments.moving_objects) as viewer, open_browser() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 860})
        page.goto(viewer.url)
        wait(page, lambda: viewer.statistics["frames"] > 1, "pictures")
        notice = page.locator(".mantine-Notification-closeButton")
        if notice.count():
            notice.first.click()
        page.get_by_label("Compare A, B", exact=True).click()
        seen = viewer.statistics["frames"]
        wait(page, lambda: viewer.statistics["frames"] > seen + 1, "other pictures")
        if arguments.moving_objects:
            wait(page, lambda: viewer.statistics["moments"][0] >= arguments.frames, "the moment")
        else:
            wait(page, lambda: viewer.statistics["accumulated"][0] >= arguments.frames, "samples")
        # Away from the controls, whose hints would cover others.
        page.mouse.move(300, 60)
        page.wait_for_timeout(1500)
        page.screenshot(path=arguments.output)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
