"""The process of the page: it answers browsers at once, whatever the worker is doing."""

from __future__ import annotations

import importlib.util
import logging
import threading
import warnings
from collections.abc import Callable
from typing import Any

from lobewise.errors import MissingDependencyError
from lobewise.viewer.browsers import Browsers
from lobewise.viewer.http.site import LOOPBACK, Site, choose_port
from lobewise.viewer.messages import Target


class Viewer(Site):
    """A page that shows a scene, and the process behind it. `FrameViewer` shows a finished frame.

    Parameters
    ----------
    target : str
        A built-in scene or a Mitsuba XML file.
    host, port : str, int
        Address of the page. If the port is taken, the next free one; if it is 0, any free one.
    size : (int, int), optional
        Columns and rows of a scene's picture.
    fixed_size : bool
        Always render at the size of the target, whatever the window's aspect and the speed of rendering.
    changes : dict, optional
        Settings to begin with: fields of `lobewise.interactive.InteractiveSettings`.
    token : str, optional
        The secret in the URL without which nobody gets the page: 16 or more letters, digits and any of ``. _ ~ -``; by
        default a random one.
    tell : callable, optional
        Called from any thread with sentences for whoever started the viewer: which parts of the scene are not
        shown, why a browser was disconnected. By default they are logged as warnings.
    moving : str, optional
        A file with the paths of a scene's objects, for `lobewise.render.read_object_paths`, or "by-themselves" for the
        objects of a built-in scene. By default nothing moves.

    Raises
    ------
    InputError
        If the token is too short or has other characters.

    Examples
    --------
    >>> with Viewer("showroom") as viewer:  # doctest: +SKIP
    ...     print(viewer.url)
    ...     viewer.wait()
    """

    def __init__(
        self,
        target: str,
        *,
        host: str = LOOPBACK,
        port: int = 8080,
        size: tuple[int, int] | None = None,
        fixed_size: bool = False,
        changes: dict[str, Any] | None = None,
        token: str | None = None,
        tell: Callable[[str], None] | None = None,
        moving: str | None = None,
    ) -> None:
        super().__init__(host, port, token)
        self._tell = tell or logging.getLogger(__name__).warning
        self._browsers = Browsers(Target(target, size, moving), fixed_size, dict(changes or {}), self._tell)
        self._server: Any = None
        self._ticker = threading.Thread(target=self._browsers.watch, name="lobewise-viewer", daemon=True)

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
            If the host is unknown or no port is free.
        MissingDependencyError
            If viser is not installed, or if the server of its version cannot be protected.
        """
        if importlib.util.find_spec("viser") is None:
            raise MissingDependencyError("viser is not installed", action="pip install 'lobewise[viewer]'")
        self._port = choose_port(self._host, self._port)
        try:
            # Start the worker first, because it takes longer than the page.
            self._browsers.worker.start()
            self._serve()
            self._ticker.start()
        except BaseException:
            self.stop()
            raise

    @property
    def statistics(self) -> dict[str, Any]:
        """Figures for tests and benchmarks; see `Browsers.statistics`."""
        return self._browsers.statistics

    def wait_until_open(self) -> None:
        """Wait until the target is open or the viewer was stopped.

        Raises
        ------
        LobewiseError, RuntimeError
            As `wait`.
        """
        while not self._browsers.opened.wait(0.05) and not self._browsers.over.is_set():
            pass
        self._require_success()

    def wait(self) -> None:
        """Wait until the viewer was stopped.

        Raises
        ------
        LobewiseError
            If the target cannot be opened, or a scene crashed the renderer again and again.
        RuntimeError
            If it cannot be opened, or crashed, because of an error of the program.
        """
        # Without a timeout Ctrl-C would not interrupt the wait on every system.
        while not self._browsers.over.wait(0.5):
            pass
        self._require_success()

    def _require_success(self) -> None:
        if self._browsers.failure is not None:
            raise self._browsers.failure

    def stop(self) -> None:
        """End the page and the worker."""
        self._browsers.over.set()
        self._browsers.worker.stop()
        server, self._server = self._server, None
        if server is not None:
            server.stop()

    def _serve(self) -> None:
        import rich
        import viser

        from lobewise.viewer.http.guard import guard_serving, require_guard

        # viser prints a greeting in this thread and a farewell in its own, both by rich, which captures by threads.
        console = rich.get_console()
        with console.capture(), guard_serving(self.access, self._browsers.controls, self._tell):
            server = viser.ViserServer(host=self._host, port=self._port, label="lobewise", verbose=False)
        self._server = server
        server.get_event_loop().call_soon_threadsafe(console.begin_capture)
        self._port = server.get_port()
        require_guard(self._host, self._port)
        # A picture may be on its way to a browser that is just leaving.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        # Otherwise any browser could make the page public, by a tunnel through another server.
        server.request_share_url = _refuse_sharing  # type: ignore[method-assign]
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="medium")
        server.gui.main_panel.dock_right()
        self._browsers.join(server)


def _refuse_sharing(verbose: bool = True) -> None:
    return None
