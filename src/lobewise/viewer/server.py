"""The page's process: it answers browsers at once, whatever the process that renders is doing."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import socket
import threading
import time
import warnings
from dataclasses import replace
from typing import Any

from lobewise.errors import InputError, LobewiseError, MissingDependencyError
from lobewise.viewer.cameras import CameraMap, place_camera, read_pose
from lobewise.viewer.guest import Guest, has_moved
from lobewise.viewer.link import Link
from lobewise.viewer.looks import Look
from lobewise.viewer.messages import (
    Description,
    Opened,
    Picture,
    Progress,
    Report,
    SavedFile,
    Target,
)
from lobewise.viewer.panel import Actions, Panel
from lobewise.viewer.pictures import BARS
from lobewise.viewer.status import write_figures, write_message

LOOPBACK = "127.0.0.1"
_QUALITY = 90
"""Of a picture that others follow; one that stays is sent again without loss."""
_TICK = 0.05
_STATUS_EVERY = 0.2
_SLOW_AFTER = 0.8
_LAST_PORT_AFTER = 100


class Viewer:
    """A page that shows a scene or a finished frame, and the process behind it.

    Parameters
    ----------
    target : str
        A built-in scene, a Mitsuba XML file, or an EXR file.
    is_frame : bool
        Whether it is an EXR file.
    host, port : str, int
        Where the page is; the next free port if this one is taken, any free one if it is 0.
    size : (int, int), optional
        Columns and rows of a scene's picture.
    fixed_size : bool
        Render at that size whatever the window's aspect, and never fewer pixels.
    changes : dict, optional
        Settings to begin with: fields of `SceneLook` or `FrameLook`.

    Examples
    --------
    >>> with Viewer("frame.exr", is_frame=True) as viewer:  # doctest: +SKIP
    ...     print(viewer.url)
    ...     viewer.wait()
    """

    def __init__(
        self,
        target: str,
        *,
        is_frame: bool = False,
        host: str = LOOPBACK,
        port: int = 8080,
        size: tuple[int, int] | None = None,
        fixed_size: bool = False,
        changes: dict[str, Any] | None = None,
    ) -> None:
        self._target = Target(target, is_frame, size)
        self._host, self._asked_port = host, port
        self._fixed_size = fixed_size
        self._changes = dict(changes or {})
        self._lock = threading.RLock()
        self._guests: dict[int, Guest] = {}
        self._found: Description | None = None
        self._cameras: CameraMap | None = None
        self._failure: Exception | None = None
        self._notice = f"Opening {target} \u2026"
        self._doing = ""
        self._memory = 0
        self._frames = 0
        self._restarts = 0
        self._over = threading.Event()
        self._server: Any = None
        self._link = Link(self._target, self._receive, self._remark)
        self._ticker = threading.Thread(target=self._tick, name="lobewise-viewer", daemon=True)

    def __enter__(self) -> Viewer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the page and the process that renders; returns when the page can be opened.

        Raises
        ------
        InputError
            If host and port are not to be had.
        MissingDependencyError
            If viser is not installed.
        """
        if importlib.util.find_spec("viser") is None:
            raise MissingDependencyError("viser is not installed; pip install 'lobewise[viewer]'.")
        port = find_port(self._host, self._asked_port)
        # First, because it takes longer than the page.
        self._link.start()
        try:
            self._serve(port)
        except BaseException:
            self._link.stop()
            raise
        self._ticker.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{'localhost' if host in ('0.0.0.0', '[::]') else host}:{self._server.get_port()}"

    @property
    def is_private(self) -> bool:
        """Whether only this machine can reach the page."""
        return self._host in ("localhost", "::1") or self._host.startswith("127.")

    @property
    def statistics(self) -> dict[str, Any]:
        """Figures for tests and benchmarks.

        ``frames``: pictures shown; ``browsers``; ``process``, ``memory`` and ``restarts`` of the process that renders:
        its id, bytes, and how often it died. Lists with an entry for each browser: ``fps`` of the last 20 pictures;
        ``size``, ``accumulated`` and ``seconds`` of the last one; ``eyes``: where the camera is, in its own unit;
        ``resting``: whether the last picture was sent without loss and no other is asked for.
        """
        with self._lock:
            guests = list(self._guests.values())
            pictures = [guest.picture for guest in guests if guest.picture is not None]
            return {
                "frames": self._frames,
                "fps": [guest.get_rate(20) for guest in guests],
                "browsers": len(guests),
                "memory": self._memory,
                "restarts": self._restarts,
                "process": self._link.process_id,
                "size": [picture.size for picture in pictures],
                "accumulated": [picture.accumulated for picture in pictures],
                "seconds": [picture.seconds for picture in pictures],
                "eyes": [tuple(map(float, guest.pose.position)) for guest in guests],
                "resting": [guest.is_resting and not self._link.is_waiting(guest.client.client_id) for guest in guests],
            }

    def wait(self) -> None:
        """Return when the viewer was stopped.

        Raises
        ------
        LobewiseError
            If the target cannot be opened.
        RuntimeError
            If that is no fault of the target.
        """
        # With a timeout Ctrl-C gets through on every system.
        while not self._over.wait(0.5):
            pass
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End the page and the process behind it."""
        self._over.set()
        self._link.stop()
        server, self._server = self._server, None
        if server is not None:
            with contextlib.redirect_stdout(io.StringIO()):
                server.stop()

    def _serve(self, port: int) -> None:
        import viser

        # It greets on standard output, which has one line of ours.
        with contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=self._host, port=port, label="lobewise", verbose=False)
        # A picture may be on its way to a browser that is just leaving.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        # Any browser could ask for a tunnel through somebody's server, which would make the page public.
        server.request_share_url = _refuse_sharing  # type: ignore[method-assign]
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="medium")
        server.gui.main_panel.dock_right()
        server.on_client_connect(self._welcome)
        server.on_client_disconnect(self._dismiss)
        self._server = server

    async def _welcome(self, client: Any) -> None:
        """Take a browser in; it gets its controls as soon as there is something to control.

        In the server's own thread, so that nobody is taken in who has already gone.
        """
        guest = Guest(client, read_pose(client.camera), self._fixed_size)
        client.scene.set_background_image(_make_blank(), format="jpeg")
        with self._lock:
            self._guests[client.client_id] = guest
            self._furnish(guest)

        async def follow(camera: Any) -> None:
            self._follow(guest, camera)

        client.camera.on_update(follow)
        self._ask(guest)

    async def _dismiss(self, client: Any) -> None:
        """Forget a browser that has gone."""
        with self._lock:
            self._guests.pop(client.client_id, None)
        self._link.forget(client.client_id)

    def _furnish(self, guest: Guest) -> None:
        """Give a browser its controls, or until the target is open a line that says what is being done."""
        found, gui = self._found, guest.client.gui
        if found is None or self._cameras is None:
            guest.status = gui.add_html(write_message(self._notice))
            return
        if guest.status is not None:
            guest.status.remove()

        def render() -> None:
            self._ask(guest)

        def redraw() -> None:
            self._ask(guest, fresh=False)

        def expose() -> None:
            guest.expose = True
            redraw()

        def reset() -> None:
            assert self._cameras is not None
            place_camera(guest.client.camera, self._cameras.start)
            guest.pose = self._cameras.start
            render()

        actions = Actions(render, redraw, reset, expose, lambda kind: self._link.save(guest.client.client_id, kind))
        look = replace(found.look, **self._changes)
        panel = Panel(gui, found, look, choose_other(found, look), actions, fixed_size=self._fixed_size)
        guest.panel, guest.status = panel, panel.status
        place_camera(guest.client.camera, self._cameras.start)
        guest.pose = self._cameras.start

    def _follow(self, guest: Guest, camera: Any) -> None:
        """Take notice of a browser's camera, or of a window that changed its size."""
        pose = read_pose(camera)
        # A finished frame hangs still; only a scene is rendered at fewer pixels in motion.
        if has_moved(guest.pose, pose):
            guest.pose = pose
            guest.moved_at = time.monotonic()
        self._ask(guest)

    def _ask(self, guest: Guest, *, fresh: bool = True) -> None:
        """Ask for the next picture of a browser."""
        if self._found is None or self._cameras is None or self._over.is_set():
            return
        with self._lock:
            if guest.client.client_id not in self._guests:
                return
            request = guest.make_request(self._found, self._cameras, fresh=fresh)
        if request is not None:
            self._link.submit(request)

    def _receive(self, report: Report) -> None:
        """Do what a report of the other process says."""
        if isinstance(report, Picture):
            self._doing = ""
            self._show(report)
        elif isinstance(report, Progress):
            self._doing = report.text
            if self._found is None:
                self._announce(f"{report.text} \u2026")
        elif isinstance(report, Opened):
            self._open(report.description)
        elif isinstance(report, SavedFile):
            guest = self._guests.get(report.client)
            if guest is not None:
                guest.client.send_file_download(report.name, report.data, save_immediately=True)
        elif report.client is None:
            self._failure = RuntimeError(report.text) if report.ours else LobewiseError(report.text)
            self._announce(report.text, bad=True)
            self._over.set()
        else:
            guest = self._guests.get(report.client)
            if guest is not None:
                guest.note = report.text
                guest.status.content = write_message(report.text, bad=True)

    def _open(self, found: Description) -> None:
        """Give every browser its controls and ask for its first picture; once more after the process died."""
        with self._lock:
            first = self._found is None
            self._found, self._cameras = found, CameraMap(found)
            if not first:
                return
            start = self._cameras.start
            initial = self._server.initial_camera
            initial.position, initial.look_at, initial.fov = start.position, start.look_at, start.fov
            self._server.scene.set_up_direction(start.up)
            guests = list(self._guests.values())
            for guest in guests:
                self._furnish(guest)
        for guest in guests:
            self._ask(guest)

    def _show(self, picture: Picture) -> None:
        with self._lock:
            guest = self._guests.get(picture.client)
            self._memory = picture.memory
            if guest is None or guest.panel is None:
                return
            self._frames += 1
            guest.add_picture(picture)
        if guest.expose and picture.final:
            guest.expose = False
            guest.panel.set_stops(picture.stops)
        assert self._found is not None
        more = picture.final and guest.needs_more(self._found) and not self._link.is_waiting(picture.client)
        if more:
            self._ask(guest)
        guest.client.scene.set_background_image(picture.pixels, format="jpeg", jpeg_quality=_QUALITY)
        self._tell_figures(guest, now=not more)

    def _tell_figures(self, guest: Guest, *, now: bool = False) -> None:
        """Bring a browser's figures up to date, a few times a second."""
        moment = time.monotonic()
        picture = guest.picture
        if picture is None or guest.status is None or not (now or moment - guest.told_at > _STATUS_EVERY):
            return
        guest.told_at = moment
        rendered = self._found is not None and self._found.camera is not None
        rate = guest.get_rate() if rendered else None
        note = guest.note or ("" if picture.final else "Unfiltered yet: compiling the kernels \u2026")
        guest.status.content = write_figures(picture, guest.shown, rate, note, rendered=rendered)

    def _announce(self, text: str, *, bad: bool = False) -> None:
        """Show one line to every browser; those that come later see it too until the target is open."""
        self._notice = text
        with self._lock:
            for guest in self._guests.values():
                if guest.picture is None and guest.status is not None:
                    guest.status.content = write_message(text, bad=bad)
                else:
                    guest.note = text
                    self._tell_figures(guest, now=True)

    def _remark(self, text: str, again: bool) -> None:
        """Tell every browser that the process died."""
        self._restarts += again
        with self._lock:
            guests = list(self._guests.values())
        for guest in guests:
            guest.client.add_notification("lobewise", text, color="orange" if again else "red", auto_close_seconds=8.0)
        self._announce(text, bad=True)
        if not again and self._found is None:
            self._failure = RuntimeError(text)
            self._over.set()

    def _tick(self) -> None:
        """Look after what no event tells: cameras that came to rest, pictures that take long."""
        told = 0.0
        while not self._over.wait(_TICK):
            with self._lock:
                guests, found = list(self._guests.values()), self._found
            if found is None:
                continue
            for guest in guests:
                if self._link.is_waiting(guest.client.client_id):
                    continue
                if guest.needs_more(found):
                    self._ask(guest)
                elif (picture := guest.get_last()) is not None:
                    guest.client.scene.set_background_image(picture.pixels, format="png")
                    guest.keep(picture)
            order, busy = self._link.get_busy()
            if order is not None and busy > _SLOW_AFTER and time.monotonic() - told > 0.5:
                told = time.monotonic()
                with self._lock:
                    slow = self._guests.get(order.client)
                if slow is not None and slow.status is not None:
                    doing = self._doing or "Working on the next picture"
                    slow.note = f"{doing}: {busy:.0f} s \u2026"
                    if slow.picture is None:
                        slow.status.content = write_message(slow.note)
                    else:
                        self._tell_figures(slow, now=True)


def choose_other(found: Description, look: Look) -> Look:
    """Return what the right side of the wipe begins with: the usual filter, or nothing where that is on the left."""
    names = found.similarities
    other = "normal" if "normal" in names and look.similarity != "normal" else names[-1]
    return replace(look, similarity=other)


def find_port(host: str, port: int) -> int:
    """Return ``port``, or the next one that is free on the host.

    Raises
    ------
    InputError
        If there is no such host here, or no port of the next hundred is free.
    """
    reason = ""
    for candidate in range(port, min(port + _LAST_PORT_AFTER, 65536)) if port else (0,):
        try:
            kind, _, _, _, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(kind, socket.SOCK_STREAM) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                return int(probe.getsockname()[1])
        except OSError as problem:
            reason = problem.strerror or str(problem)
    raise InputError(
        "--host and --port",
        expected="an address of this machine with a free port",
        got=f"{host}:{port} ({reason[:1].lower()}{reason[1:]})",
        action="pass another",
    )


def _refuse_sharing(verbose: bool = True) -> None:
    return None


def _make_blank() -> Any:
    import numpy as np

    return np.full((8, 8, 3), BARS, np.uint8)
