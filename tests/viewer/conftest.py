"""A headless browser, small frames to look at, and pages that are followed while they are used."""

import contextlib
import http.client
import importlib.util
import io
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from lobewise.io import write_frame
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.viewer import Viewer

REBOUND = "evil.example"
"""A name that the browser is made to believe is this machine."""
FLAGS = [
    "--no-sandbox",
    "--use-gl=swiftshader",
    "--enable-unsafe-swiftshader",
    f"--host-resolver-rules=MAP {REBOUND} 127.0.0.1",
    # Newer browsers stop some strangers by themselves; older ones do not, and the server must.
    "--disable-features=LocalNetworkAccessChecks,LocalNetworkAccessChecksWebSockets",
]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 120.0
"""Seconds for anything to happen, kernels to be compiled on a busy machine among it."""


@pytest.fixture(scope="session")
def floor_frame() -> Frame:
    """Return a noisy glossy floor, 48x32, bright on the left and dark on the right."""
    rng = np.random.default_rng(7)
    height, width = 32, 48
    camera = Camera(position=(0.0, 1.0, 4.0), forward=(0.0, -0.4, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.4)
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    depth = -1.0 / rays[..., 1]
    level = np.linspace(2.0, 0.2, width)[None, :, None]
    specular = rng.gamma(1.0, 1.0, (height, width, 3)) * level
    return Frame(
        Radiance(color=specular, diffuse=np.zeros_like(specular), specular=specular),
        GBuffer(
            depth=depth,
            position=camera.position + depth[..., None] * rays,
            normal=np.broadcast_to([0.0, 1.0, 0.0], (height, width, 3)),
            alpha_u=np.full((height, width), 0.2),
            lobe_kind=np.ones((height, width)),
            diffuse_albedo=np.zeros((height, width, 3)),
            specular_albedo=np.full((height, width, 3), 0.8),
            hit_distance=np.full((height, width), 2.0),
        ),
        camera=camera,
        spp=4,
    )


@pytest.fixture(scope="session")
def floor_file(floor_frame: Frame, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return that frame on disk."""
    path = tmp_path_factory.mktemp("viewer") / "floor.exr"
    write_frame(path, floor_frame, half=False)
    return path


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Return a headless browser, or skip and say what is missing; where CI is set that is a failure."""
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    missing = [f"pip install {name}" for name in ("viser", "playwright") if importlib.util.find_spec(name) is None] + (
        [] if found else ["apt install chromium"]
    )
    if missing:
        reason = f"the page needs a browser and a driver: {', '.join(missing)}"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        engine = driver.chromium.launch(executable_path=found, args=FLAGS)
        yield engine
        engine.close()


class Page:
    """One browser window on a viewer; whatever its console calls an error is kept."""

    def __init__(self, browser: Any, viewer: Viewer, size: tuple[int, int]) -> None:
        self.viewer = viewer
        self.errors: list[str] = []
        self.closed_sockets = 0
        self._context = browser.new_context(viewport={"width": size[0], "height": size[1]}, accept_downloads=True)
        self.page = self._context.new_page()
        self.page.on("console", lambda message: message.type == "error" and self.errors.append(message.text))
        self.page.on("pageerror", lambda problem: self.errors.append(str(problem)))
        self.page.on("websocket", lambda socket: socket.on("close", self._count_closed))
        # On a busy machine viser draws fewer pixels than the window has, and then more again.
        self.page.goto(f"{viewer.url}&fixedDpr=1")

    def _count_closed(self, *_: object) -> None:
        self.closed_sockets += 1

    def close(self) -> None:
        self._context.close()

    def choose(self, label: str, value: str, side: int = 0) -> None:
        """Choose from a list; ``side`` 1 is the second list of that label."""
        self.page.get_by_role("combobox", name=label, exact=True).nth(side).click()
        self.page.get_by_role("option", name=value, exact=True).click()

    def tick(self, label: str) -> None:
        """Click a checkbox."""
        self.page.get_by_label(label, exact=True).first.click()

    def slide(self, label: str, keys: str, times: int = 1) -> None:
        """Press a key on a slider."""
        name = self.page.locator("label", has_text=label).first.get_attribute("for")
        knob = self.page.locator(f'[id="{name}"] [role=slider]')
        knob.focus()
        for _ in range(times):
            knob.press(keys)

    def save(self, kind: str) -> tuple[str, bytes]:
        """Return name and bytes of a file that the page saves."""
        with self.page.expect_download(timeout=1e3 * PATIENCE) as download:
            self.page.get_by_role("button", name=kind, exact=True).click()
        return download.value.suggested_filename, Path(download.value.path()).read_bytes()

    def look(self) -> np.ndarray:
        """Return what the picture area shows, (height, width, 3)."""
        from PIL import Image

        canvas = self.page.locator("canvas").first.bounding_box()
        picture = np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"))
        rows, columns = int(canvas["height"]), int(canvas["width"])
        # Notifications cover the corner above on the left.
        return picture[rows // 3 : rows, :columns]

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Return when the condition holds; the page lives on meanwhile."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"waited {PATIENCE:.0f} s for {what}"
            self.page.wait_for_timeout(50)

    def wait_for_frames(self, count: int, since: int | None = None) -> None:
        """Return when so many more pictures were shown than now, or than ``since``."""
        target = (self.viewer.statistics["frames"] if since is None else since) + count
        self.wait(lambda: self.viewer.statistics["frames"] >= target, f"{count} pictures")

    def wait_for_change(self, before: np.ndarray, least: float = 1.0, block: int = 1) -> np.ndarray:
        """Return what is shown when it differs by ``least`` codes in the mean, noise within blocks left aside."""
        found = [before]

        def changed() -> bool:
            found[0] = self.look()
            return compare(found[0], before, block) > least

        self.wait(changed, "the picture to change")
        return found[0]


def compare(one: np.ndarray, other: np.ndarray, block: int = 1) -> float:
    """Return the mean difference of two pictures in codes, of the means of blocks."""
    if one.shape != other.shape:
        return float("inf")
    rows, columns = (size // block for size in one.shape[:2])
    means = [
        image[: rows * block, : columns * block].reshape(rows, block, columns, block, 3).mean(axis=(1, 3))
        for image in (one.astype(float), other.astype(float))
    ]
    return float(np.abs(means[0] - means[1]).mean())


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Page]]:
    """Return a function that opens a page on a viewer; at the end none may have met an error."""
    pages: list[Page] = []

    def open_page(viewer: Viewer, size: tuple[int, int] = (720, 520)) -> Page:
        seen = viewer.statistics["frames"]
        pages.append(Page(browser, viewer, size))
        pages[-1].wait_for_frames(1, since=seen)
        return pages[-1]

    yield open_page
    for page in pages:
        page.close()
    end = time.monotonic() + PATIENCE
    while any(page.viewer.statistics["browsers"] for page in pages):
        assert time.monotonic() < end, "browsers that are gone are not forgotten"
        time.sleep(0.02)
    assert [page.errors for page in pages] == [[] for _ in pages]


def ask(viewer: Any, path: str, body: bytes | None = None, **headers: str) -> tuple[int, Any, bytes]:
    """Return status, headers and body of the answer to a request of a page's server."""
    place = urlsplit(viewer.url)
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=PATIENCE)
    with contextlib.closing(connection):
        connection.request("GET" if body is None else "POST", path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


@contextlib.contextmanager
def run_viewer(target: str, **options: Any) -> Iterator[Viewer]:
    """Run a viewer on a free port; wait until there is a page."""
    with Viewer(target, port=0, **options) as viewer:
        yield viewer
