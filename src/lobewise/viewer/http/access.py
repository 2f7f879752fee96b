"""Access to the page by a secret token, the names of this server and the page's own origin.

Browsers let every page open a connection to this machine. They tell the server only where the page is from (`Origin`),
by which name it reached the server (`Host`), and the cookies of that name.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs

from lobewise.errors import InputError

MIN_TOKEN_CHARACTERS = 16
"""Shortest token that a user may choose, characters. A shorter token can be guessed by trying."""
_TOKEN_BYTES = 32
_TOKEN = re.compile(r"[A-Za-z0-9._~-]+")
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[^\[\]:/@\s]+)(?::(\d{1,5}))?")
_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_OPEN = "open the URL that lobewise printed."


@dataclass(frozen=True)
class HttpRequest:
    """The parts of an HTTP request that tell who asks.

    Parameters
    ----------
    target : str
        Path and query.
    hosts, origins, cookies : sequence of str
        Values of the headers ``Host``, ``Origin`` and ``Cookie``, one for each header.
    is_socket : bool
        Whether the request opens a WebSocket.
    """

    target: str
    hosts: Sequence[str] = ()
    origins: Sequence[str] = ()
    cookies: Sequence[str] = ()
    is_socket: bool = False


class Access:
    """Decides on every request before anything is answered.

    A request must name a host of this server; this prevents DNS rebinding, where another name points to this server. A
    request must have the token in the URL, or in the cookie that the first request with the token sets. A request
    from a page must come from the server's own page. Browsers send an origin with every WebSocket: a WebSocket without
    an origin needs the token in its URL.

    ``Host`` may have any port, so that a forwarded port works (``ssh -L 9000:localhost:8080``). The origin must have
    the port of ``Host``.

    Parameters
    ----------
    host : str
        The address or name that the server is bound to.
    token : str, optional
        The secret; by default 32 random bytes.

    Raises
    ------
    InputError
        If the token is too short, or has characters that must be quoted in a URL.
    """

    def __init__(self, host: str, token: str | None = None) -> None:
        self.token = secrets.token_urlsafe(_TOKEN_BYTES) if token is None else _check_token(token)
        self._private = is_loopback(host)
        self._names = {*_LOOPBACK_NAMES, _write_name(host)}
        if not self._private:
            self._names |= list_machine_names()

    def refuse(self, request: HttpRequest) -> str:
        """Return a sentence that says why a request is refused; empty if it is allowed."""
        if len(request.hosts) != 1 or not self._is_ours(request.hosts[0]):
            named = ", ".join(request.hosts)[:80] or "no name"
            return f"This viewer is not reached by {named!r}: {_OPEN}"
        host = request.hosts[0].lower()
        if any(_strip_scheme(origin) != host for origin in request.origins):
            return f"Only the viewer's own page may ask this: {_OPEN}"
        if self.knows_token(request):
            return ""
        if not self._knows_cookie(request):
            return f"The viewer's token is missing or wrong: {_OPEN}"
        if request.is_socket and not request.origins:
            return f"A connection that names no page needs the token in its URL: {_OPEN}"
        return ""

    def knows_token(self, request: HttpRequest) -> bool:
        """Return whether the URL has the token."""
        return any(self._is_token(word) for word in parse_qs(request.target.partition("?")[2]).get("token", ()))

    def make_cookie(self, request: HttpRequest) -> str:
        """Return the value of ``Set-Cookie`` by which the page's own requests are allowed; empty without the token.

        Browsers share cookies between the ports of a host, so the cookie's name has the port of its viewer.
        """
        if not self.knows_token(request):
            return ""
        return f"{_name_cookie(request.hosts[0])}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def _is_ours(self, host: str) -> bool:
        match = _HOST.fullmatch(host.lower())
        if match is None:
            return False
        return match[1] in self._names or (not self._private and _is_address(match[1]))

    def _knows_cookie(self, request: HttpRequest) -> bool:
        name = _name_cookie(request.hosts[0])
        pairs = [pair.strip().partition("=") for line in request.cookies for pair in line.split(";")]
        return any(self._is_token(value) for key, _, value in pairs if key == name)

    def _is_token(self, word: str) -> bool:
        # Compare in constant time: the time of a refusal must not tell how much of a guess is right.
        return hmac.compare_digest(word.encode("utf-8", "replace"), self.token.encode())


def is_loopback(host: str) -> bool:
    """Return whether an address or name can be reached from this machine only."""
    return host in ("localhost", "::1") or host.startswith("127.")


def list_machine_names() -> set[str]:
    """Return the names of this machine that are known without asking a name server."""
    name = socket.gethostname().lower()
    short = name.partition(".")[0]
    return {name, short, f"{short}.local"}


def _check_token(token: str) -> str:
    if len(token) < MIN_TOKEN_CHARACTERS or _TOKEN.fullmatch(token) is None:
        raise InputError(
            "--token",
            expected=f"at least {MIN_TOKEN_CHARACTERS} letters, digits and any of . _ ~ -",
            got="an empty one" if not token else f"{len(token)} characters",
            action="leave it out for a random one",
        )
    return token


def _write_name(host: str) -> str:
    """Return an address or name as the header `Host` writes it."""
    return f"[{host.lower()}]" if ":" in host else host.lower()


def _is_address(name: str) -> bool:
    """Return whether the name in a `Host` is an address. DNS rebinding cannot use addresses."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def _strip_scheme(origin: str) -> str:
    """Return host and port of an origin; empty for an origin without a host, such as "null" of a file or sandbox."""
    scheme, separator, host = origin.lower().partition("://")
    return host if separator and scheme in ("http", "https") else ""


def _name_cookie(host: str) -> str:
    match = _HOST.fullmatch(host.lower())
    return f"lobewise-{(match and match[2]) or 80}"
