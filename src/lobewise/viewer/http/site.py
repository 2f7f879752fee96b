"""The address of a page, its token, the port that it listens at, and the headers of its answers."""

from __future__ import annotations

import socket
from collections.abc import Callable

from lobewise.errors import InputError
from lobewise.io.files import say_reason
from lobewise.viewer.http.access import Access, is_loopback

Tell = Callable[[str], None]
LOOPBACK = "127.0.0.1"
REFUSED = 403
HEADERS = {
    # The URL holds the token: keep it from other servers and caches, and the page out of frames of other pages.
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every answer."""
_MAX_TRIED_PORTS = 100


class Site:
    """A page at an address. ``port`` is the first port to try; 0 takes any free one.

    Raises InputError if the token is too short or has other characters.
    """

    def __init__(self, host: str, port: int, token: str | None) -> None:
        self._host, self._port = host, port
        self.access = Access(host, token)

    @property
    def url(self) -> str:
        """The URL of the page with the secret token. Anyone who has this URL can use the page."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        place = f"http://{'localhost' if host in ('0.0.0.0', '[::]') else host}:{self._port}"
        return f"{place}/?token={self.access.token}"

    @property
    def is_private(self) -> bool:
        """Whether only this machine can reach the page."""
        return is_loopback(self._host)


def choose_port(host: str, port: int) -> int:
    """Return ``port``, or the next one that is free on the host.

    Raises InputError if there is no such host here, or no port of the next hundred is free.
    """
    reason = ""
    for candidate in range(port, min(port + _MAX_TRIED_PORTS, 65536)) if port else (0,):
        try:
            kind, _, _, _, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(kind, socket.SOCK_STREAM) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                return int(probe.getsockname()[1])
        except OSError as problem:
            reason = say_reason(problem)
    raise InputError(
        "--host and --port",
        expected="an address of this machine with a free port",
        got=f"{host}:{port} ({reason})",
        action="pass another",
    )
