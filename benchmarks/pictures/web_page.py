"""Take the picture of the page of ``lobewise export --target web`` for docs/export.md, in a headless Chromium.

python -m benchmarks.pictures.web_page             # needs playwright and Debian's chromium
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

from PIL import Image

from benchmarks.common import ROOT
from lobewise.exporting.shaders.web import export_web

FLAGS = [
    "--no-sandbox",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    "--use-angle=vulkan",
]
"""WebGPU in software, and a canvas that it can draw on."""
LAST_FRAME = 9


def main() -> None:
    """Open the page, run the passes on all frames, write a PNG."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images" / "web.png")
    arguments = parser.parse_args()
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        export_web(Path(folder) / "page")
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": 960, "height": 880})
        page.set_default_timeout(300_000.0)
        page.goto((Path(folder) / "page" / "index.html").as_uri())
        page.evaluate("page.opened")
        page.evaluate("page.setPlaying(false)")
        page.evaluate("page.running")
        page.evaluate(f"page.seek({LAST_FRAME})")
        page.wait_for_timeout(1500)
        page.screenshot(path=arguments.output)
        browser.close()
    Image.open(arguments.output).convert("RGB").save(arguments.output, optimize=True)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
