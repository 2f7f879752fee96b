"""The connection to a Dask scheduler, its own or one that runs already. No other module imports Dask."""

from __future__ import annotations

import asyncio
import atexit
import ipaddress
import logging
import queue
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any
from urllib.parse import urlsplit

from lobewise.chunks import count_cores
from lobewise.errors import InputError, LobewiseError, MissingDependencyError

CONNECT_SECONDS = 7.0
"""Longest time to reach a scheduler and to get its first answers, seconds."""
ANSWER_SECONDS = 9.0
"""Longest time to ask a connected scheduler for its workers, seconds. A scheduler that falls silent is noticed in 15 s:
in this time and `RESULT_SECONDS`."""
SECURE_PROTOCOLS = ("tls", "wss")
"""Protocols of Dask that encrypt and that check the certificates of both sides."""
START_SECONDS = 120.0
"""Longest time for a worker of this machine to start, seconds."""
RESULT_SECONDS = 4.0
"""Longest time to fetch the small result of a finished call, seconds."""
CLOSE_SECONDS = 5.0
"""Longest time for workers of a local farm to end by themselves, seconds; then they are killed."""
RECONNECT_PAUSE_SECONDS = 1.0
PRELOAD = "lobewise.farm.worker"
"""Module that a worker of this machine imports while it starts."""
LOCAL_SETTINGS = {
    # A worker keeps no results, so there is nothing to spill. A paused worker would never go on: the memory is its own.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    # Dask watches itself and its workers a hundred times a second; nobody reads these figures.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.gil.enabled": False,
    # Dask serves pages over HTTP without a password. It has no switch for that: have no pages, and stop the servers.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


class ConnectionLostError(Exception):
    """The scheduler does not answer any more."""


class CallLostError(Exception):
    """A call was lost with its worker or scheduler; it may be made again."""


class CallFailedError(Exception):
    """The function of a call raised an error, or could not be loaded by the worker."""


class Call:
    """A function that runs on a worker.

    Parameters
    ----------
    worker : str
        Address of the worker.
    future : object
        Dask's future.
    """

    def __init__(self, worker: str, future: Any) -> None:
        self.worker = worker
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


class Connection:
    """A client of a scheduler.

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

    def call(self, worker: str, function: Callable[..., Any], *arguments: Any) -> Call:
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
        return Call(worker, future)

    def wait_for_finished(self, seconds: float) -> list[str]:
        """Return the keys of calls that have ended, however they ended; wait at most some seconds for the first."""
        finished: list[str] = []
        with suppress(queue.Empty):
            finished.append(self._finished.get(timeout=seconds))
            while True:
                finished.append(self._finished.get_nowait())
        return finished

    def reopen(self, seconds: float, tell: Callable[[], None]) -> None:
        """Connect again to a scheduler that was gone; ``tell`` is called before every attempt.

        Raises LobewiseError if the scheduler does not answer for ``seconds``, or what ``tell`` raises.
        """
        self._close_client()
        end = time.monotonic() + seconds
        while True:
            tell()
            try:
                self._client = self._open(CONNECT_SECONDS)
                return
            except InputError:
                raise
            except LobewiseError:
                if time.monotonic() >= end:
                    raise LobewiseError(
                        "--farm",
                        expected=f"the scheduler {self.address} to come back",
                        got=f"no answer for {seconds / 60:g} minutes",
                        action="start it, and give the same command again, which filters only what is missing",
                    ) from None
            time.sleep(RECONNECT_PAUSE_SECONDS)

    def close(self) -> None:
        """End the connection. Workers of the scheduler go on with the calls that they are at."""
        self._close_client()

    def _close_client(self) -> None:
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
def connect(address: str) -> Iterator[Connection]:
    """Connect to a scheduler that runs already; see `Connection` for the errors."""
    require_distributed()
    with _silence(), _run_loop() as loop:
        connection = Connection(address, loop)
        try:
            yield connection
        finally:
            connection.close()


@contextmanager
def start_local(workers: int, *, memory_bytes: int) -> Iterator[Connection]:
    """Start a scheduler and workers on this machine; they end with the ``with`` block.

    They talk by TLS. Its certificates are made for this run, and no other user of the machine can read their keys: so
    none can send them programs.

    Parameters
    ----------
    workers : int
        Processes. They share the cores of the machine.
    memory_bytes : int
        Limit of each process. Dask ends a process that takes more, and starts another.

    Raises
    ------
    MissingDependencyError
        If Dask is not installed.
    """
    require_distributed()
    import dask
    from distributed import LocalCluster
    from distributed.security import Security

    security = Security.temporary()
    threads = max(count_cores() // workers, 1)
    # Start multiprocessing's helper now: a thread that starts it hears Ctrl-C afterwards.
    resource_tracker.ensure_running()
    with _silence(), dask.config.set(LOCAL_SETTINGS), _run_loop() as loop:
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=threads,
                processes=True,
                memory_limit=memory_bytes,
                death_timeout=START_SECONDS,
                dashboard_address=None,
                # Any free port: Dask warns where its usual one is taken.
                scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                protocol="tls://",
                security=security,
                loop=loop,
                silence_logs=logging.CRITICAL,
                preload=[PRELOAD],
            )
        except Exception as problem:
            raise LobewiseError(
                "--workers",
                expected=f"{workers} processes that start within {START_SECONDS:.0f} s",
                got=f"{type(problem).__name__}: {problem}",
                action="ask for fewer, or look for what hinders a new process",
            ) from problem
        # The server's sockets belong to the loop's thread.
        loop.add_callback(cluster.scheduler.http_server.stop)
        try:
            connection = Connection(cluster.scheduler_address, loop, security)
            try:
                yield connection
            finally:
                connection.close()
        finally:
            with suppress(Exception):
                cluster.close(timeout=CLOSE_SECONDS)


def require_distributed() -> None:
    """Raise MissingDependencyError if Dask is not installed."""
    try:
        import cryptography  # noqa: F401 - makes the certificates of a farm on this machine
        import distributed  # noqa: F401 - both tell whether they can be imported
    except ImportError as problem:
        raise MissingDependencyError(
            f"A farm needs Dask, which cannot be imported ({problem}); pip install 'lobewise[farm]'."
        ) from None


def divide_memory(workers: int) -> int:
    """Return the memory of the machine divided by a number of workers, bytes."""
    from distributed.system import MEMORY_LIMIT

    return int(MEMORY_LIMIT // workers)


@contextmanager
def _run_loop() -> Iterator[Any]:
    """Run Dask's event loop in a thread that is deaf to Ctrl-C, and so are the workers that it starts.

    A terminal sends Ctrl-C to every process of a command. A worker would print a traceback; the client ends it anyway.
    Dask leaves a loop alone that others have started: it ends here, whatever a client still waits for.
    """
    from tornado.ioloop import IOLoop

    begun: queue.SimpleQueue[tuple[IOLoop, asyncio.Event]] = queue.SimpleQueue()

    async def wait_for_end() -> None:
        end = asyncio.Event()
        begun.put((IOLoop.current(), end))
        await end.wait()

    thread = threading.Thread(target=lambda: asyncio.run(wait_for_end()), name="farm", daemon=True)
    # A new thread, and every process that it starts, has the mask of the thread that made it. Windows has no masks.
    mask = getattr(signal, "pthread_sigmask", None)
    before = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else set()
    try:
        thread.start()
        loop, end = begun.get()
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)
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
    except BaseException:
        # Dask ends workers that were about to start when the program ends, and complains of their state.
        atexit.register(_complain_of_nothing)
        raise
    for handler, level in levels.items():
        handler.setLevel(level)


def _is_not_of_dask(record: logging.LogRecord) -> bool:
    """Return whether a line of the log tells anything but an exception of Dask."""
    kind = record.exc_info[0] if record.exc_info else None
    return kind is None or not kind.__module__.startswith("distributed.")


def _complain_of_nothing() -> None:
    """Print nothing more: the program has told why it ends."""
    logging.disable(logging.CRITICAL)
    sys.unraisablehook = lambda _: None
