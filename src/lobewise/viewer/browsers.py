"""The browsers of a page: their controls, requests, pictures and messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lobewise.errors import LobewiseError
from lobewise.interactive.settings import UNFILTERED, InteractiveSettings
from lobewise.settings import SimilarityName
from lobewise.viewer.browser import Browser, has_moved
from lobewise.viewer.cameras import CameraMap, place_camera, read_pose
from lobewise.viewer.http.browser_messages import Control
from lobewise.viewer.messages import Description, Opened, Picture, Progress, Report, SavedFile, Target
from lobewise.viewer.panel import Actions, Panel
from lobewise.viewer.pictures import BARS
from lobewise.viewer.status import write_figures, write_message
from lobewise.viewer.worker_process import WorkerProcess

_JPEG_QUALITY = 90
"""JPEG quality of a picture. The last picture of a row is sent again without loss."""
_TICK = 0.05
"""Seconds between two looks at what no event tells."""
_STATUS_EVERY = 0.2
"""Shortest time between two updates of the figures, seconds."""
_SLOW_AFTER = 0.8
"""Time after which the status says what the worker is doing, seconds."""


class Browsers:
    """All browsers, between the page and the process that renders.

    With ``fixed_size`` a picture always has the target's size, whatever the window's aspect and the speed of rendering.
    ``changes`` are settings to begin with, fields of `InteractiveSettings`. ``tell`` is called with sentences about the
    target, for whoever started the viewer. ``controls`` holds the controls of all browsers by viser's identities.
    """

    def __init__(self, target: Target, fixed_size: bool, changes: dict[str, Any], tell: Callable[[str], None]) -> None:
        self.worker = WorkerProcess(target, self.receive, self.remark)
        self.description: Description | None = None
        self.cameras: CameraMap | None = None
        self.failure: Exception | None = None
        self.opened, self.over = threading.Event(), threading.Event()
        self.controls: dict[str, Control] = {}
        self._fixed_size, self._changes, self._tell_starter = fixed_size, changes, tell
        self._lock = threading.RLock()
        self._browsers: dict[int, Browser] = {}
        self._notice = f"Opening {target.name} \u2026"
        self._doing = ""
        self._memory = self._frames = self._restarts = 0
        self._page: Any = None

    def join(self, page: Any) -> None:
        """Serve the browsers of a page of viser from now on."""
        self._page = page
        page.on_client_connect(self.welcome)
        page.on_client_disconnect(self.dismiss)

    @property
    def statistics(self) -> dict[str, Any]:
        """Figures for tests and benchmarks.

        ``frames`` counts the pictures shown and ``browsers`` the browsers. ``process``, ``memory`` and ``restarts`` are
        the worker's id, its memory in bytes, and how often it died. The others are lists with an entry for each
        browser: ``fps`` of the last 20 pictures; ``size``, ``accumulated`` and ``seconds`` of the last picture, and
        ``moments``, that of the objects' motion in it; ``eyes``, the camera's position in the browser's unit;
        ``resting``, whether the last picture was sent without loss and no request is open.
        """
        with self._lock:
            browsers = list(self._browsers.values())
            pictures = [browser.picture for browser in browsers if browser.picture is not None]
            return {
                "frames": self._frames,
                "fps": [browser.get_rate(20) for browser in browsers],
                "browsers": len(browsers),
                "memory": self._memory,
                "restarts": self._restarts,
                "process": self.worker.process_id,
                "size": [picture.size for picture in pictures],
                "accumulated": [picture.accumulated for picture in pictures],
                "seconds": [picture.seconds for picture in pictures],
                "moments": [picture.moment for picture in pictures],
                "eyes": [tuple(map(float, browser.pose.position)) for browser in browsers],
                "resting": [
                    browser.is_resting and not self.worker.is_waiting(browser.client.client_id) for browser in browsers
                ],
            }

    async def welcome(self, client: Any) -> None:
        """Add a browser. It gets its controls as soon as the target is open.

        This runs in the server's own thread, so that a browser that has gone is never added.
        """
        browser = Browser(client, read_pose(client.camera), self._fixed_size)
        client.scene.set_background_image(np.full((8, 8, 3), BARS, np.uint8), format="jpeg")
        with self._lock:
            self._browsers[client.client_id] = browser
            self._furnish(browser)

        async def follow(camera: Any) -> None:
            self._follow(browser, camera)

        client.camera.on_update(follow)
        self._ask(browser)

    async def dismiss(self, client: Any) -> None:
        """Forget a browser that has gone."""
        with self._lock:
            browser = self._browsers.pop(client.client_id, None)
        self.worker.forget(client.client_id)
        if browser is None:
            return
        browser.drop_pictures()
        if browser.panel is not None:
            for identity in browser.panel.controls:
                self.controls.pop(identity, None)

    def _furnish(self, browser: Browser) -> None:
        """Give a browser its controls, or a status line as long as the target is not open."""
        description, gui = self.description, browser.client.gui
        if description is None or self.cameras is None:
            browser.status = gui.add_html(write_message(self._notice))
            return
        if browser.status is not None:
            browser.status.remove()

        def render() -> None:
            self._ask(browser)

        def redraw() -> None:
            self._ask(browser, fresh=False)

        def expose() -> None:
            browser.expose = True
            redraw()

        def reset() -> None:
            assert self.cameras is not None
            place_camera(browser.client.camera, self.cameras.start)
            browser.pose = self.cameras.start
            render()

        actions = Actions(render, redraw, reset, expose, lambda kind: self.worker.save(browser.client.client_id, kind))
        settings = replace(description.settings, **self._changes)
        panel = Panel(gui, description, settings, choose_other(settings), actions, fixed_size=self._fixed_size)
        browser.panel, browser.status = panel, panel.status
        self.controls.update(panel.controls)
        place_camera(browser.client.camera, self.cameras.start)
        browser.pose = self.cameras.start

    def _follow(self, browser: Browser, camera: Any) -> None:
        """React to a change of a browser's camera or window."""
        pose = read_pose(camera)
        if has_moved(browser.pose, pose):
            browser.pose = pose
            browser.moved_at = time.monotonic()
        self._ask(browser)

    def _ask(self, browser: Browser, *, fresh: bool = True) -> None:
        """Ask for the next picture of a browser."""
        if self.description is None or self.cameras is None or self.over.is_set():
            return
        with self._lock:
            if browser.client.client_id not in self._browsers:
                return
            request = browser.make_request(self.description, self.cameras, fresh=fresh)
        if request is not None:
            self.worker.submit(request)

    def receive(self, report: Report) -> None:
        """React to a report of the worker."""
        if isinstance(report, Picture):
            self._doing = ""
            self._show(report)
        elif isinstance(report, Progress):
            self._doing = report.text
            if self.description is None:
                self._announce(f"{report.text} \u2026")
        elif isinstance(report, Opened):
            self._open(report.description)
        elif isinstance(report, SavedFile):
            browser = self._browsers.get(report.client)
            if browser is not None:
                browser.client.send_file_download(report.name, report.data, save_immediately=True)
        elif report.client is None:
            self.failure = report.error
            self._announce(report.text, bad=True)
            self.over.set()
        else:
            browser = self._browsers.get(report.client)
            if browser is not None:
                browser.note = report.text
                browser.status.content = write_message(report.text, bad=True)

    def _open(self, description: Description) -> None:
        """Give every browser its controls and ask for its first picture. A restarted worker only tells the target."""
        with self._lock:
            first = self.description is None
            self.description, self.cameras = description, CameraMap(description)
            if not first:
                return
            start = self.cameras.start
            initial = self._page.initial_camera
            initial.position, initial.look_at, initial.fov = start.position, start.look_at, start.fov
            self._page.scene.set_up_direction(start.up)
            browsers = list(self._browsers.values())
            for browser in browsers:
                self._furnish(browser)
        if description.unseen:
            self._tell_starter(description.unseen)
        self.opened.set()
        for browser in browsers:
            self._ask(browser)

    def _show(self, picture: Picture) -> None:
        with self._lock:
            browser = self._browsers.get(picture.client)
            self._memory = picture.memory
            if browser is None or browser.panel is None:
                return
            self._frames += 1
            browser.add_picture(picture)
        if picture.stops is not None and picture.final:
            browser.expose = False
            browser.panel.set_stops(picture.stops)
        assert self.description is not None
        more = picture.final and browser.needs_more(self.description) and not self.worker.is_waiting(picture.client)
        if more:
            self._ask(browser)
        browser.client.scene.set_background_image(picture.pixels, format="jpeg", jpeg_quality=_JPEG_QUALITY)
        self._tell_figures(browser, now=not more)

    def _tell_figures(self, browser: Browser, *, now: bool = False) -> None:
        """Update a browser's figures, at most every `_STATUS_EVERY` seconds unless ``now`` is set."""
        moment = time.monotonic()
        picture = browser.picture
        if picture is None or browser.status is None or not (now or moment - browser.reported_at > _STATUS_EVERY):
            return
        browser.reported_at = moment
        note = browser.note or ("" if picture.final else "Unfiltered yet: compiling the kernels \u2026")
        unseen = "" if self.description is None else self.description.unseen
        browser.status.content = write_figures(picture, browser.shown, browser.get_rate(), note, unseen=unseen)

    def _announce(self, text: str, *, bad: bool = False) -> None:
        """Show one line to every browser, and to later ones until the target is open."""
        self._notice = text
        with self._lock:
            for browser in self._browsers.values():
                self._tell(browser, text, bad=bad)

    def _tell(self, browser: Browser, text: str, *, bad: bool = False) -> None:
        """Show one line to a browser, below the figures of its picture if it has a picture."""
        if browser.picture is None and browser.status is not None:
            browser.status.content = write_message(text, bad=bad)
        else:
            browser.note = text
            self._tell_figures(browser, now=True)

    def remark(self, text: str, failure: LobewiseError | None) -> None:
        """Tell every browser that the worker died. ``failure`` says why it is not started again."""
        self._restarts += failure is None
        with self._lock:
            browsers = list(self._browsers.values())
        for browser in browsers:
            browser.client.add_notification(
                "lobewise", text, color="red" if failure else "orange", auto_close_seconds=8.0
            )
        self._announce(text, bad=True)
        if failure:
            self.failure = failure
            self.over.set()

    def watch(self) -> None:
        """Watch for cameras that came to rest and for pictures that take long, until the viewer stops."""
        reported_at = 0.0
        while not self.over.wait(_TICK):
            with self._lock:
                browsers, description = list(self._browsers.values()), self.description
            if description is None:
                continue
            for browser in browsers:
                if self.worker.is_waiting(browser.client.client_id):
                    continue
                if browser.needs_more(description):
                    self._ask(browser)
                elif (picture := browser.get_last()) is not None:
                    browser.client.scene.set_background_image(picture.pixels, format="png")
                    browser.keep(picture)
            command, busy = self.worker.get_busy()
            if command is not None and busy > _SLOW_AFTER and time.monotonic() - reported_at > 0.5:
                reported_at = time.monotonic()
                with self._lock:
                    slow = self._browsers.get(command.client)
                if slow is not None and slow.status is not None:
                    doing = self._doing or "Working on the next picture"
                    self._tell(slow, f"{doing}: {busy:.0f} s \u2026")


BASELINE: SimilarityName = "normal"
"""Similarity that the right of the wipe shows at first."""


def choose_other(settings: InteractiveSettings) -> InteractiveSettings:
    """Return the first settings right of the wipe: the normal-aware filter, or no filter if the left side has it."""
    return replace(settings, similarity=UNFILTERED if settings.similarity == BASELINE else BASELINE)
