"""Guard viser's server. No other module depends on the internals of viser.

viser 1.x has no option for a guard. It serves page and WebSocket by one call of ``websockets.asyncio.server.serve``.
This public function of `websockets` has the hooks of a guard: it calls `process_request` before it answers anything,
and `create_connection` makes the object from which viser reads messages. A proxy before viser's server would guard
nothing: any page could connect to viser's own port.
"""

from __future__ import annotations

import asyncio
import http.client
import inspect
import logging
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from typing import Any

from lobewise.errors import MissingDependencyError
from lobewise.viewer.http.access import Access, HttpRequest
from lobewise.viewer.http.browser_messages import MAX_MESSAGE_BYTES, Control, MessageError, read_message
from lobewise.viewer.http.site import HEADERS, REFUSED, Tell

_POLICY_VIOLATION = 1008
_PATIENCE = 20.0
_starting = threading.Lock()


@contextmanager
def guard_serving(access: Access, controls: Mapping[str, Control], tell: Tell) -> Iterator[None]:
    """Guard every server that viser starts in the ``with`` block: it answers only requests that ``access`` allows.

    Only messages that `read_message` has checked reach viser. ``tell`` is called with a sentence when a browser was
    disconnected or the server failed at something.
    """
    import websockets.asyncio.server as library

    plain = library.serve

    def serve(handler: Any, *arguments: Any, **options: Any) -> Any:
        if str(getattr(handler, "__module__", "")).partition(".")[0] != "viser":
            return plain(handler, *arguments, **options)
        asyncio.get_running_loop().set_exception_handler(partial(_tell_failure, tell))
        options["process_request"] = partial(_process_request, access, options.get("process_request"))
        options["create_connection"] = partial(_make_connection_class(), controls, tell)
        options["max_size"] = MAX_MESSAGE_BYTES
        options["logger"] = _make_logger(tell)
        return plain(handler, *arguments, **options)

    with _starting:
        vars(library)["serve"] = serve
        try:
            yield
        finally:
            vars(library)["serve"] = plain


def require_guard(host: str, port: int) -> None:
    """Raise MissingDependencyError unless the server refuses a request without the token."""
    connection = http.client.HTTPConnection({"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host), port, _PATIENCE)
    try:
        connection.request("GET", "/")
        status = connection.getresponse().status
    except (OSError, http.client.HTTPException) as problem:
        status = 0
        reason: Exception | None = problem
    else:
        reason = None
    finally:
        connection.close()
    if status != REFUSED:
        import viser

        raise MissingDependencyError(
            f"viser {viser.__version__} serves its page in a way that this lobewise cannot protect with a token",
            action="pip install 'viser==1.1.1'",
        ) from reason


async def _process_request(access: Access, pages: Any, connection: Any, request: Any) -> Any:
    """Refuse a request that is not allowed; otherwise let viser answer, and set the cookie."""
    headers = request.headers
    http_request = HttpRequest(
        request.path,
        headers.get_all("Host"),
        headers.get_all("Origin"),
        headers.get_all("Cookie"),
        is_socket="Upgrade" in headers,
    )
    refusal = access.refuse(http_request)
    if refusal:
        answer = connection.respond(REFUSED, f"{refusal}\n")
    else:
        answer = None if pages is None else pages(connection, request)
        if inspect.isawaitable(answer):
            answer = await answer
    if answer is not None:
        for name, value in HEADERS.items():
            answer.headers[name] = value
        if not refusal and (cookie := access.make_cookie(http_request)):
            answer.headers["Set-Cookie"] = cookie
    return answer


@cache
def _make_connection_class() -> Any:
    """Return the class of connections whose `recv` returns only checked messages."""
    from websockets.asyncio.server import ServerConnection

    class Connection(ServerConnection):
        """The connection of one browser. It ends with the first message that no page sends."""

        def __init__(self, controls: Mapping[str, Control], tell: Tell, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._controls, self._tell = controls, tell
            self._remarked = self._refused = False

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                # When the browser has gone or was disconnected, this raises the error that viser expects.
                data = await super().recv(decode)
                if self._refused:
                    continue
                try:
                    checked, remark = read_message(data, self._controls)
                except MessageError as problem:
                    self._refused = True
                    self._tell(f"A browser was disconnected because it sent {problem}.")
                    await self.close(_POLICY_VIOLATION, f"lobewise does not take {problem}"[:120])
                    continue
                if remark and not self._remarked:
                    self._remarked = True
                    self._tell(f"A browser sent {remark}: ignored, as further ones of that browser will be.")
                if checked is not None:
                    return checked

    return Connection


def _tell_failure(tell: Tell, loop: Any, context: dict[str, Any]) -> None:
    """Tell in one line what failed in the server's thread. Other connections go on."""
    problem = context.get("exception")
    logging.getLogger(__name__).debug("in the server of the page", exc_info=problem)
    tell(f"The page could not do something: {_shorten(problem or context.get('message', ''))}")


def _make_logger(tell: Tell) -> logging.Logger:
    """Return the log of a server of `websockets`: one line for a failure, none for a refused connection."""
    logger = logging.Logger("lobewise.viewer.http", logging.WARNING)

    class Lines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if "handshake" not in record.getMessage():
                problem = record.exc_info[1] if record.exc_info else None
                tell(f"A browser was disconnected: {_shorten(problem or record.getMessage())}")

    logger.addHandler(Lines())
    return logger


def _shorten(problem: object) -> str:
    name = f"{type(problem).__name__}: " if isinstance(problem, BaseException) else ""
    return " ".join(f"{name}{problem}".split())[:200]
