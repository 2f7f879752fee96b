"""Who may see the page and speak to it: a secret token, the names of this server, the page's own origin.

Browsers let every page open a connection to this machine. They tell only where that page is from (`Origin`), by which
name it reached the server (`Host`), and which cookies belong to that name.
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
"""Of a token that the user chooses. Shorter ones can be guessed by trying."""
_TOKEN_BYTES = 32
_TOKEN = re.compile(r"[A-Za-z0-9._~-]+")
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[^\[\]:/@\s]+)(?::(\d{1,5}))?")
_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_OPEN = "open the URL that lobewise printed."


@dataclass(frozen=True)
class Visit:
    """One HTTP request, as far as it tells who asks.

    Parameters
    ----------
    target : str
        Path and query.
    hosts, origins, cookies : sequence of str
        Values of the headers of that name, as often as they came.
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

    A request must name a host of this server, so that no other name can be made to point here (DNS rebinding). It must
    carry the token: in the URL, or in a cookie that the first visit with the token leaves. A request from a page must
    be from the server's own page. A WebSocket without an origin, which no browser opens, needs the token in its URL.

    The port of ``Host`` is free, so that a forwarded port works (``ssh -L 9000:localhost:8080``); the origin must have
    the same one.

    Parameters
    ----------
    host : str
        The address or name that the server is bound to.
    token : str, optional
        The secret; by default 32 random bytes.

    Raises
    ------
    InputError
        If the token is short, or has characters that a URL would have to quote.
    """

    def __init__(self, host: str, token: str | None = None) -> None:
        self.token = secrets.token_urlsafe(_TOKEN_BYTES) if token is None else _check_token(token)
        self._private = is_loopback(host)
        self._names = {*_LOOPBACK_NAMES, _write_name(host)}
        if not self._private:
            self._names |= list_machine_names()

    def refuse(self, visit: Visit) -> str:
        """Return in one sentence why a request gets nothing; empty where it is welcome."""
        if len(visit.hosts) != 1 or not self._is_ours(visit.hosts[0]):
            named = ", ".join(visit.hosts)[:80] or "no name"
            return f"This viewer is not reached by {named!r}: {_OPEN}"
        host = visit.hosts[0].lower()
        if any(_strip_scheme(origin) != host for origin in visit.origins):
            return f"Only the viewer's own page may ask this: {_OPEN}"
        if self.knows_token(visit):
            return ""
        if not self._knows_cookie(visit):
            return f"The viewer's token is missing or wrong: {_OPEN}"
        if visit.is_socket and not visit.origins:
            return f"A connection that names no page needs the token in its URL: {_OPEN}"
        return ""

    def knows_token(self, visit: Visit) -> bool:
        """Return whether the URL has the token."""
        return any(self._is_token(word) for word in parse_qs(visit.target.partition("?")[2]).get("token", ()))

    def make_cookie(self, visit: Visit) -> str:
        """Return the value of ``Set-Cookie`` that lets the page's own requests in.

        Browsers share cookies between the ports of a host; the name has the port, so that viewers keep apart.
        """
        return f"{_name_cookie(visit.hosts[0])}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def _is_ours(self, host: str) -> bool:
        found = _HOST.fullmatch(host.lower())
        if found is None:
            return False
        return found[1] in self._names or (not self._private and _is_address(found[1]))

    def _knows_cookie(self, visit: Visit) -> bool:
        name = _name_cookie(visit.hosts[0])
        pairs = [pair.strip().partition("=") for line in visit.cookies for pair in line.split(";")]
        return any(self._is_token(value) for key, _, value in pairs if key == name)

    def _is_token(self, word: str) -> bool:
        # In constant time: how long a refusal takes must not tell how much of a guess is right.
        return hmac.compare_digest(word.encode("utf-8", "replace"), self.token.encode())


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address or name."""
    return host in ("localhost", "::1") or host.startswith("127.")


def list_machine_names() -> set[str]:
    """Return the names of this machine that need no question to a name server."""
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
    """Return an address or name as `Host` has it."""
    return f"[{host.lower()}]" if ":" in host else host.lower()


def _is_address(name: str) -> bool:
    """Return whether the name of a `Host` is an address, which no name server can change."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def _strip_scheme(origin: str) -> str:
    """Return host and port of an origin; empty where it has none, as "null" of a sandbox or a file."""
    scheme, separator, host = origin.lower().partition("://")
    return host if separator and scheme in ("http", "https") else ""


def _name_cookie(host: str) -> str:
    found = _HOST.fullmatch(host.lower())
    return f"lobewise-{(found and found[2]) or 80}"
