"""The connection to a Dask scheduler that runs already. No other module imports Dask."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import queue
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from lobewise.errors import InputError, LobewiseError, MissingDependencyError
from lobewise.farm.calls import CallFailedError, CallLostError, ConnectionLostError
from lobewise.farm.processes import take_finished

CONNECT_SECONDS = 7.0
"""Longest time to reach a scheduler and to get its first answers, seconds."""
ANSWER_SECONDS = 9.0
"""Longest time to ask a connected scheduler for its workers, seconds. A scheduler that falls silent is noticed in 15 s:
in this time and `RESULT_SECONDS`."""
SECURE_PROTOCOLS = ("tls", "wss")
"""Protocols of Dask that encrypt and that check the certificates of both sides."""
RESULT_SECONDS = 4.0
"""Longest time to fetch the small result of a finished call, seconds."""
CLOSE_SECONDS = 5.0
"""Longest time for workers of a local farm to end by themselves, seconds; then they are killed."""


class DaskCall:
    """A function that runs on a worker of Dask; see `lobewise.farm.calls.Call`.

    Parameters
    ----------
    future : object
        Dask's future.
    """

    def __init__(self, future: Any) -> None:
        self._future = future

    @property
    def key(self) -> str:
        """A name that no other call has."""
        return str(self._future.key)

    @property
    def has_ended(self) -> bool:
        """Whether the function has returned or failed, or the call was lost."""
        return bool(self._future.status != "pending")

    def fetch(self) -> Any:
        """Return what the function returned; raise `CallLostError` or `CallFailedError`."""
        status = self._future.status
        if status == "error":
            problem = self._future.exception(timeout=RESULT_SECONDS)
            raise CallFailedError(f"{type(problem).__name__}: {problem}")
        if status != "finished":
            raise CallLostError
        try:
            return self._future.result(timeout=RESULT_SECONDS)
        except Exception as problem:
            # The worker ended after the call, before its result was fetched.
            raise CallLostError from problem

    def drop(self) -> None:
        """Forget the call; a function that does not run yet never will."""
        with suppress(Exception):
            self._future.cancel(force=True)


class DaskConnection:
    """A client of a scheduler; see `lobewise.farm.calls.Connection`.

    Parameters
    ----------
    address : str
        Such as ``tls://host:8786``.
    loop : object
        Dask's event loop, which runs in a thread of its own.
    security : object, optional
        Dask's certificates; by default those of its settings.

    Raises
    ------
    InputError
        If the address is malformed.
    LobewiseError
        If the scheduler does not answer within `CONNECT_SECONDS`.
    """

    def __init__(self, address: str, loop: Any, security: Any = None) -> None:
        self.address = address
        self._loop = loop
        self._security = security
        self._finished: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._client = self._open(CONNECT_SECONDS)

    def _open(self, seconds: float) -> Any:
        from distributed.comm.addressing import parse_address
        from distributed.comm.registry import get_backend
        from distributed.utils import sync

        try:
            get_backend(parse_address(self.address)[0]).get_address_host(parse_address(self.address)[1])
        except ValueError as problem:
            raise InputError(
                "--farm",
                expected="the address of a Dask scheduler, such as tls://host:8786",
                got=repr(self.address),
                action=f"mend it ({' '.join(str(problem).split())})",
            ) from None
        try:
            return sync(self._loop, self._make_client, seconds, callback_timeout=seconds + CLOSE_SECONDS)
        except Exception as problem:
            raise LobewiseError(
                "--farm",
                expected=f"a Dask scheduler at {self.address}",
                got=f"no answer of Dask within {seconds:g} s ({type(problem).__name__})",
                action="start it with 'dask scheduler', or check address, certificates and firewall",
            ) from None

    async def _make_client(self, seconds: float) -> Any:
        """Return a client that the scheduler has greeted. Dask itself waits for the greeting without end."""
        from distributed import Client

        client = Client(
            self.address,
            security=self._security,
            timeout=seconds,
            set_as_default=False,
            name="lobewise",
            asynchronous=True,
        )
        try:
            return await asyncio.wait_for(client, seconds)
        except BaseException:
            with suppress(Exception):
                await client.close(timeout=1.0)
            raise

    def list_workers(self) -> dict[str, int]:
        """Return the threads of each worker by its address; raise `ConnectionLostError` if the scheduler is gone."""
        if self._client.status != "running":
            raise ConnectionLostError
        try:
            return dict(self._client.sync(self._client.scheduler.ncores, callback_timeout=ANSWER_SECONDS))
        except Exception as problem:
            raise ConnectionLostError from problem

    def call(self, worker: str, function: Callable[..., Any], *arguments: Any) -> DaskCall:
        """Let a worker call a function; raise `ConnectionLostError` if the scheduler is gone."""
        try:
            future = self._client.submit(
                function,
                *arguments,
                key=f"lobewise-{uuid.uuid4().hex}",
                workers=[worker],
                allow_other_workers=False,
                pure=False,
                retries=0,
            )
            future.add_done_callback(lambda done: self._finished.put(str(done.key)))
        except Exception as problem:
            raise ConnectionLostError from problem
        return DaskCall(future)

    def wait_for_finished(self, seconds: float) -> list[str]:
        """Return the keys of calls that have ended, however they ended; wait at most some seconds for the first."""
        return take_finished(self._finished, seconds)

    def close(self) -> None:
        """End the connection. Workers of the scheduler go on with the calls that they are at."""
        with suppress(Exception):
            self._client.close(timeout=CLOSE_SECONDS)


def require_secure(address: str) -> None:
    """Raise InputError if messages to an address would leave this machine unencrypted.

    Dask's messages are programs: whoever can answer in the scheduler's place runs programs here.
    """
    protocol, _, place = address.rpartition("://")
    try:
        host = urlsplit(f"//{place}").hostname or ""
        is_local = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_local = False
    if protocol not in SECURE_PROTOCOLS and not is_local:
        raise InputError(
            "--farm",
            expected="an address that begins with tls://, or one of this machine",
            got=repr(address),
            action="give Dask certificates, or add --insecure in a network that strangers cannot reach",
        )


@contextmanager
def connect(address: str) -> Iterator[DaskConnection]:
    """Connect to a scheduler that runs already; see `DaskConnection` for the errors."""
    require_distributed()
    with _silence(), _run_loop() as loop:
        connection = DaskConnection(address, loop)
        try:
            yield connection
        finally:
            connection.close()


def require_distributed() -> None:
    """Raise MissingDependencyError if Dask is not installed."""
    try:
        import distributed  # noqa: F401 - tells whether it can be imported
    except ImportError as problem:
        raise MissingDependencyError(
            f"A farm needs Dask, which cannot be imported ({problem})", action="pip install 'lobewise[farm]'"
        ) from None


@contextmanager
def _run_loop() -> Iterator[Any]:
    """Run Dask's event loop in a thread of its own.

    Dask leaves a loop alone that others have started: it ends here, whatever a client still waits for.
    """
    from tornado.ioloop import IOLoop

    begun: queue.SimpleQueue[tuple[IOLoop, asyncio.Event]] = queue.SimpleQueue()

    async def wait_for_end() -> None:
        end = asyncio.Event()
        begun.put((IOLoop.current(), end))
        await end.wait()

    thread = threading.Thread(target=lambda: asyncio.run(wait_for_end()), name="farm", daemon=True)
    thread.start()
    loop, end = begun.get()
    try:
        yield loop
    finally:
        loop.add_callback(end.set)
        thread.join(CLOSE_SECONDS)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep Dask's log from the terminal: what matters is told in sentences."""
    import distributed  # noqa: F401 - makes the handlers of its log

    # Calls that a lost scheduler will never answer end with exceptions of Dask, which asyncio tells when it forgets
    # them: at any time, so the filter stays.
    logging.getLogger("asyncio").addFilter(_is_not_of_dask)
    # The loggers of Dask's modules have levels of their own, which the handlers override.
    levels = {handler: handler.level for handler in logging.getLogger("distributed").handlers}
    for handler in levels:
        handler.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for handler, level in levels.items():
            handler.setLevel(level)


def _is_not_of_dask(record: logging.LogRecord) -> bool:
    """Return whether a line of the log tells anything but an exception of Dask."""
    kind = record.exc_info[0] if record.exc_info else None
    return kind is None or not kind.__module__.startswith("distributed.")
