"""How the viewer responds: seconds to the first picture, frames per second while the camera moves, memory on an orbit.

A headless Chromium (``chromium`` on the path, driven by playwright) looks at the page. Without a GPU it draws in
software, which takes a core or more of those that the viewer runs on; so frames per second are measured twice: with
that browser, and with a client that speaks the page's protocol and draws nothing, as if the browser had its own.

python -m benchmarks.interactive.viewer --output benchmarks/results/viewer.json
"""

import argparse
import io
import math
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np

from benchmarks.common import describe_machine, write_json
from lobewise.viewer import Viewer

SIZE = (512, 512)
METHODS = ("paths", "voxel_cones", "virtual_lights")
FLAGS = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
WINDOW = {"width": 900, "height": 700}
WARM_UP = 12.0
"""Seconds that are not counted: kernels are compiled, voxels filled."""
MOVING = 15.0
"""Seconds of dragging that are."""
STARTS = 3
"""Starts of the command whose median counts."""
ORBIT = 64
PATIENCE = 180.0


@contextmanager
def open_browser() -> Iterator[Any]:
    """Open a headless browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        engine = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        yield engine
        engine.close()


def wait(page: Any, condition: Callable[[], object], what: str) -> None:
    """Return when the condition holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {PATIENCE:.0f} s for {what}")
        page.wait_for_timeout(50)


def look(page: Any) -> np.ndarray:
    """Return the lower left of the page as it is shown."""
    from PIL import Image

    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
    return picture[WINDOW["height"] // 3 :, : WINDOW["width"] // 2]


def time_first_picture(browser: Any, method: str) -> float:
    """Return seconds from the command to a picture in the browser, which is open already."""
    page = browser.new_context(viewport=WINDOW).new_page()
    program = str(Path(sys.executable).parent / "lobewise")
    command = [program, "view", "showroom", "--no-open", "--port", "0", "--fixed-size"]
    command += ["--size", f"{SIZE[0]}x{SIZE[1]}", "--method", method]
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line
        page.goto(found.group())
        wait(page, lambda: look(page).std() > 20.0, "a picture")
        return time.perf_counter() - start
    finally:
        process.terminate()
        process.wait(30)
        page.context.close()


def drag_for(page: Any, seconds: float) -> int:
    """Drag the camera to and fro for so long; return the number of moves."""
    page.mouse.move(150, 300)
    page.mouse.down()
    end, step = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        step += 1
        page.mouse.move(250 + 100 * math.sin(0.03 * step), 300)
        page.wait_for_timeout(30)
    page.mouse.up()
    return step


class QuietClient:
    """What a page is to the viewer, without a page: it takes every picture and moves the camera."""

    def __init__(self, viewer: Viewer) -> None:
        import viser
        from websockets.sync.client import connect

        self._viewer = viewer
        address = viewer.url.replace("http", "ws")
        protocol: Any = f"viser-v{viser.__version__}"
        self._socket = connect(address, subprotocols=[protocol], compression=None, max_size=None)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._turn = 0.0
        self.look(0.0)

    def _read(self) -> None:
        for _ in self._socket:
            pass

    def look(self, angle: float) -> None:
        """Put the camera on the orbit, so many radians from where it began."""
        import msgspec

        cameras = self._viewer._browsers.cameras
        position, look_at = np.array([0.0, 0.0, 4.0]), np.zeros(3)
        up, fov = np.array([0.0, 1.0, 0.0]), 0.8
        if cameras is not None:
            start = cameras.start
            look_at, up, fov = start.look_at, start.up, start.fov
            arm = start.position - look_at
            position = look_at + math.cos(angle) * arm + math.sin(angle) * np.cross(up, arm)
            position += (1.0 - math.cos(angle)) * up * float(up @ arm)
        message = {
            "type": "ViewerCameraMessage",
            "wxyz": [1.0, 0.0, 0.0, 0.0],
            "position": position.tolist(),
            "fov": float(fov),
            "near": 0.01,
            "far": 1000.0,
            "image_height": WINDOW["height"],
            "image_width": WINDOW["width"],
            "look_at": look_at.tolist(),
            "up_direction": up.tolist(),
        }
        self._socket.send(msgspec.msgpack.encode(message))

    def move_for(self, seconds: float) -> None:
        """Move the camera to and fro, thirty times a second."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._turn += 0.03
            self.look(0.3 * math.sin(self._turn))
            time.sleep(1.0 / 30.0)

    def close(self) -> None:
        """Leave."""
        self._socket.close()


def measure_pace(method: str) -> dict[str, Any]:
    """Return frames per second while the camera moves, of a client that takes no time, and where the time goes."""
    with Viewer("showroom", port=0, size=SIZE, fixed_size=True, changes={"method": method}) as viewer:
        client = QuietClient(viewer)
        start = time.monotonic()
        while viewer.statistics["frames"] < 3:
            if time.monotonic() - start > PATIENCE:
                raise TimeoutError("no pictures")
            time.sleep(0.05)
        client.move_for(WARM_UP)
        before, begin = viewer.statistics["frames"], time.perf_counter()
        stages: list[dict[str, float]] = []
        for _ in range(10):
            client.move_for(MOVING / 10)
            stages.append(viewer.statistics["seconds"][0])
        count, seconds = viewer.statistics["frames"] - before, time.perf_counter() - begin
        accumulated = viewer.statistics["accumulated"][0]
        size = viewer.statistics["size"][0]
        client.close()
    return {**summarise(count / seconds, size, stages), "accumulated": accumulated}


def summarise(pace: float, size: Any, stages: list[dict[str, float]]) -> dict[str, Any]:
    """Return the figures of a way to move the camera."""
    times = {name: median(stage[name] for stage in stages) for name in stages[0]}
    return {"frames_per_second": pace, "size": list(size), "seconds": times}


def measure_motion(browser: Any, method: str) -> dict[str, Any]:
    """Return frames per second while the camera is dragged in a browser, and where the time goes."""
    with Viewer("showroom", port=0, size=SIZE, fixed_size=True, changes={"method": method}) as viewer:
        page = browser.new_context(viewport=WINDOW).new_page()
        page.goto(viewer.url)
        wait(page, lambda: viewer.statistics["frames"] > 2, "pictures")
        drag_for(page, WARM_UP)
        before, start = viewer.statistics["frames"], time.perf_counter()
        stages: list[dict[str, float]] = []
        for _ in range(5):
            drag_for(page, MOVING / 5)
            stages.append(viewer.statistics["seconds"][0])
        count, seconds = viewer.statistics["frames"] - before, time.perf_counter() - start
        size = viewer.statistics["size"][0]
        page.context.close()
    return summarise(count / seconds, size, stages)


def measure_orbit(browser: Any) -> dict[str, Any]:
    """Return what an orbit of 64 frames does to connection and memory."""
    errors: list[str] = []
    closed: list[Any] = []
    with Viewer("showroom", port=0, size=SIZE, fixed_size=True) as viewer:
        page = browser.new_context(viewport=WINDOW).new_page()
        page.on("console", lambda message: message.type == "error" and errors.append(message.text))
        page.on("pageerror", lambda problem: errors.append(str(problem)))
        page.on("websocket", lambda socket: socket.on("close", lambda *_: closed.append(socket)))
        page.goto(viewer.url)
        wait(page, lambda: viewer.statistics["frames"] > 8, "pictures")
        memory = []
        page.mouse.move(150, 300)
        page.mouse.down()
        for step in range(1, ORBIT + 1):
            seen = viewer.statistics["frames"]
            page.mouse.move(150 + 4 * step, 300)
            wait(page, lambda seen=seen: viewer.statistics["frames"] > seen, "a picture")
            memory.append(viewer.statistics["memory"])
        page.mouse.up()
        restarts, dropped = viewer.statistics["restarts"], len(closed)
        page.context.close()
    half = ORBIT // 2
    return {
        "frames": ORBIT,
        "dropped_connections": dropped,
        "console_errors": errors,
        "restarts": restarts,
        "memory": memory[half - 1],
        "growth": mean(memory[-4:]) / mean(memory[half - 4 : half]) - 1.0,
    }


def main() -> None:
    """Measure and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, help="JSON to write")
    arguments = parser.parse_args()
    with open_browser() as browser:
        found: dict[str, Any] = {"machine": describe_machine(), "window": WINDOW, "moving_seconds": MOVING}
        found["first_picture"] = {
            method: median(time_first_picture(browser, method) for _ in range(STARTS)) for method in METHODS[:1]
        }
        print(found["first_picture"], flush=True)
        found["pace"] = {}
        for method in METHODS:
            found["pace"][method] = measure_pace(method)
            print("alone", method, found["pace"][method], flush=True)
        found["motion"] = {}
        for method in METHODS:
            found["motion"][method] = measure_motion(browser, method)
            print(method, found["motion"][method], flush=True)
        found["orbit"] = measure_orbit(browser)
        print(found["orbit"], flush=True)
    if arguments.output is not None:
        write_json(arguments.output, found)


if __name__ == "__main__":
    main()
