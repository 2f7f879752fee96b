"""The page of a finished frame: plain HTML, and a small server that filters for it."""

from __future__ import annotations

import io
import json
import logging
import re
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingTCPServer
from typing import Any

import numpy as np

from lobewise.display.tones import map_tones
from lobewise.errors import InputError, LobewiseError
from lobewise.io.documents import parse_json
from lobewise.reporting.report import fill_page
from lobewise.viewer.frame_target import FrameTarget
from lobewise.viewer.http.access import HttpRequest
from lobewise.viewer.http.browser_messages import MAX_MESSAGE_BYTES
from lobewise.viewer.http.site import HEADERS, LOOPBACK, REFUSED, Site, Tell, choose_port
from lobewise.viewer.messages import FrameReading, describe_failure

MAX_REQUEST_SECONDS = 20.0
"""Longest time that a browser may take to send a request, and again to take the answer."""
MAX_WAITING = 16
"""Most connections that have not shown the token yet. A browser opens about six at once."""
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:"


class FrameViewer(Site):
    """A page that shows a finished frame: a wipe between the noisy and the denoised image, values, a histogram.

    Parameters
    ----------
    path : str
        An EXR file of any renderer.
    host, port : str, int
        Address of the page. If the port is taken, the next free one; if it is 0, any free one.
    changes : dict, optional
        Settings to begin with, fields of `lobewise.DenoiseSettings` that the page has a control for.
    token : str, optional
        The secret in the URL, as for `Viewer`.
    tell : callable, optional
        Called with sentences for whoever started the viewer. By default they are logged as warnings.
    reading : FrameReading, optional
        How the file is read.
    reference : str, optional
        Another EXR file, of the same size, to compare with.

    Raises
    ------
    LobewiseError
        If a file cannot be read, the reference has another size, or a setting or the token is wrong.

    Examples
    --------
    >>> with FrameViewer("frame.exr") as viewer:  # doctest: +SKIP
    ...     print(viewer.url)
    ...     viewer.wait()
    """

    def __init__(
        self,
        path: str,
        *,
        host: str = LOOPBACK,
        port: int = 8080,
        changes: Mapping[str, Any] | None = None,
        token: str | None = None,
        tell: Tell | None = None,
        reading: FrameReading | None = None,
        reference: str | None = None,
    ) -> None:
        super().__init__(host, port, token)
        self._tell = tell or logging.getLogger(__name__).warning
        self._target = FrameTarget(path, reading, reference)
        self._target.make_settings(changes or {})
        self._changes = dict(changes or {})
        self._over = threading.Event()
        self._server: ThreadingTCPServer | None = None

    def __enter__(self) -> FrameViewer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the page; returns when it can be opened.

        Raises InputError if the host is unknown or no port is free.
        """
        self._port = choose_port(self._host, self._port)
        self._server = _Server((self._host, self._port), self)
        threading.Thread(target=self._server.serve_forever, args=(0.05,), name="lobewise-page", daemon=True).start()
        for note in self._target.notes:
            self._tell(note)

    def wait(self) -> None:
        """Wait until the viewer was stopped."""
        # Without a timeout Ctrl-C would not interrupt the wait on every system.
        while not self._over.wait(0.5):
            pass

    def stop(self) -> None:
        """End the page. A filter that is running is not waited for."""
        self._over.set()
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()

    def write_page(self) -> bytes:
        """Return the page."""
        description = {**self._target.describe(), "changes": self._changes}
        return fill_page("frame.html", {"data": json.dumps(description).replace("<", "\\u003c")}).encode()

    def answer(self, path: str, request: Mapping[str, Any]) -> bytes:
        """Return what the page asks for, by its path.

        Raises LobewiseError if the request is none that the page has, or cannot be met.
        """
        if path == "/tones":
            # The display value of every half float, by its bits, so that the page needs no tone curve of its own.
            factor = 2.0 ** (_read_number(request, "stops", -64.0, 64.0) - self._target.stops)
            with np.errstate(invalid="ignore"):
                return map_tones(np.arange(65536, dtype=np.uint16).view(np.float16), factor).tobytes()
        if path == "/share":
            return json.dumps({"share": self._target.share}).encode()
        values = request.get("settings")
        if not isinstance(values, dict):
            raise InputError("settings", expected="an object", got=type(values).__name__, action="load the page again")
        settings = self._target.make_settings(values)
        if path == "/picture":
            return self._target.paint(str(request.get("name")), settings).tobytes()
        if path == "/values":
            x, y = (int(_read_number(request, axis, 0.0, 1e6)) for axis in "xy")
            return json.dumps(self._target.list_values(x, y, settings)).encode()
        if path == "/file":
            with tempfile.TemporaryDirectory() as folder:
                return self._target.write(settings, Path(folder)).read_bytes()
        raise InputError("path", expected="one of the page", got=repr(path[:80]), action="load the page again")


class _Server(ThreadingTCPServer):
    allow_reuse_address = daemon_threads = True
    request_queue_size = MAX_WAITING

    def __init__(self, address: tuple[str, int], viewer: FrameViewer) -> None:
        self.address_family = socket.getaddrinfo(*address, type=socket.SOCK_STREAM)[0][0]
        self.viewer = viewer
        # Connections that have not shown the token yet, the oldest first.
        self._waiting: dict[Any, None] = {}
        self._waiting_lock = threading.Lock()
        super().__init__(address, _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread of its own; end the oldest one where too many wait."""
        with self._waiting_lock:
            if len(self._waiting) >= MAX_WAITING:
                oldest = next(iter(self._waiting))
                del self._waiting[oldest]
                # Its thread reads the end of the request, and closes it.
                with suppress(OSError):
                    oldest.shutdown(socket.SHUT_RDWR)
            self._waiting[request] = None
        super().process_request(request, client_address)

    def end_waiting(self, request: Any) -> None:
        """Count a connection no more: it has shown the token, or ends."""
        with self._waiting_lock:
            self._waiting.pop(request, None)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.end_waiting(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that has left or was silent: the others go on."""
        logging.getLogger(__name__).debug("in the server of the page", exc_info=True)


class _RequestReader(io.RawIOBase):
    """Bytes of one connection, all of which must arrive within `MAX_REQUEST_SECONDS`.

    The timeout of a socket alone begins anew with every byte.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._end = time.monotonic() + MAX_REQUEST_SECONDS

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Return the number of bytes read into ``buffer``, 0 at the end. Raises TimeoutError after the deadline."""
        # A timeout of 0 would not wait for a byte, and raise another error.
        self._connection.settimeout(max(self._end - time.monotonic(), 1e-3))
        return self._connection.recv_into(buffer)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version, sys_version = "lobewise", ""

    def setup(self) -> None:
        """Limit the time in which the request must arrive."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BufferedReader(_RequestReader(self.connection))

    def log_message(self, format: str, *args: Any) -> None:
        """Print no line for a request."""

    def do_GET(self) -> None:
        """Answer with the page."""
        self._admit(False, lambda: self.server.viewer.write_page() if self._place == "/" else None)

    def do_POST(self) -> None:
        """Answer a request of the page. Browsers name the page that asks, as with a WebSocket."""
        self._admit(True, lambda: self.server.viewer.answer(self._place, self._read_request()))

    @property
    def _place(self) -> str:
        return self.path.partition("?")[0]

    def _admit(self, is_post: bool, make: Callable[[], bytes | None]) -> None:
        """Answer a request by ``make`` if the visitor may ask; None is what does not exist."""
        hosts, origins, cookies = (self.headers.get_all(name, []) for name in ("Host", "Origin", "Cookie"))
        request = HttpRequest(self.path, hosts, origins, cookies, is_socket=is_post)
        access = self.server.viewer.access
        refusal = access.refuse(request)
        if refusal:
            self._send(REFUSED, f"{refusal}\n".encode())
            return
        self.server.end_waiting(self.connection)
        try:
            data, status = make(), 200
        except LobewiseError as problem:
            data, status = str(problem).encode(), 400
        except (TimeoutError, ConnectionError):
            raise
        except Exception as problem:
            data, status = describe_failure(problem).encode(), 500
        kind = "text/plain" if status != 200 or is_post else "text/html"
        self._send(404 if data is None else status, data or b"", kind, access.make_cookie(request))

    def _send(self, status: int, data: bytes, kind: str = "text/plain", cookie: str = "") -> None:
        self.send_response(status)
        headers = {**HEADERS, "Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(data))}
        headers["Content-Security-Policy"] = f"{_POLICY}; {HEADERS['Content-Security-Policy']}"
        for name, value in {**headers, **({"Set-Cookie": cookie} if cookie else {})}.items():
            self.send_header(name, value)
        # Reading the request has shortened it.
        self.connection.settimeout(MAX_REQUEST_SECONDS)
        self.end_headers()
        self.wfile.write(data)

    def _read_request(self) -> Mapping[str, Any]:
        """Return the JSON object of a request. Raises LobewiseError if it is too long or none."""
        length = self.headers.get("Content-Length", "")
        body = self.rfile.read(min(int(length), MAX_MESSAGE_BYTES + 1)) if re.fullmatch("[0-9]{1,9}", length) else b""
        if not 0 < len(body) <= MAX_MESSAGE_BYTES:
            expected = f"1 to {MAX_MESSAGE_BYTES} bytes"
            raise InputError("request", expected=expected, got=f"{length or 'no'} bytes"[:40], action="send fewer")
        request = parse_json(body, what="request", action="correct it")
        if not isinstance(request, dict):
            raise InputError("request", expected="an object", got=type(request).__name__, action="load the page again")
        return request


def _read_number(request: Mapping[str, Any], name: str, low: float, high: float) -> float:
    value = request.get(name)
    # The comparison fails for NaN.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InputError(name, expected=f"a number from {low:g} to {high:g}", got=repr(value)[:80], action="correct it")
    return value
