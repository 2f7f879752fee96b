"""The page's end of the pipe: it starts the worker, gives it the latest requests in turn, and restarts it."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from typing import Any

from lobewise.errors import LobewiseError
from lobewise.scenes.crashes import describe_crash
from lobewise.viewer.messages import Command, Forget, Opened, Problem, Report, Request, Save, Target
from lobewise.viewer.worker import run_worker

MAX_RESTARTS = 3
"""Restarts of the worker within `RESTART_SPAN`. After one more death, or one before it was ever ready, it stays off."""
RESTART_SPAN = 60.0
"""Seconds."""
_PATIENCE = 2.0
"""Seconds to wait for a process or thread to end."""
_log = logging.getLogger(__name__)


class WorkerProcess:
    """The worker process. It renders one picture at a time, for each browser in turn.

    A new request of a browser replaces the waiting one, so that the worker is never behind, however slow it is.

    ``receive`` is called with every `Report`, from a thread of this object. When the worker died, ``remark`` is called
    with a sentence, and with the error if the worker is not started again.
    """

    def __init__(
        self,
        target: Target,
        receive: Callable[[Report], None],
        remark: Callable[[str, LobewiseError | None], None],
    ) -> None:
        self._target = target
        self._receive = receive
        self._remark = remark
        self._lock = threading.RLock()
        self._requests: OrderedDict[int, Request] = OrderedDict()
        self._urgent: list[Save | Forget] = []
        self._latest: dict[int, Request] = {}
        self._ready = self._was_ready = False
        self._command: Command | None = None
        self._since = 0.0
        self._deaths: list[float] = []
        self._stopped = False
        self._process: Any = None
        self._pipe: Connection | None = None
        self._thread = threading.Thread(target=self._listen, name="lobewise-worker", daemon=True)

    def start(self) -> None:
        """Start the process; returns before it is ready."""
        self._launch()
        self._thread.start()

    @property
    def process_id(self) -> int:
        """Process id of the worker, 0 if there is none."""
        with self._lock:
            return int(self._process.pid or 0) if self._process is not None else 0

    def get_busy(self) -> tuple[Command | None, float]:
        """Return the command that the worker is executing, and since how many seconds."""
        with self._lock:
            return self._command, time.monotonic() - self._since

    def submit(self, request: Request) -> None:
        """Ask for a picture. It replaces a waiting request of that browser."""
        with self._lock:
            waiting = self._requests.get(request.client)
            if waiting is not None and waiting.fresh and not request.fresh:
                # A request that only shows the last frame again must not cancel the request for a new frame.
                request = _freshen(request)
            self._requests[request.client] = self._latest[request.client] = request
            self._send_next()

    def is_waiting(self, client: int) -> bool:
        """Return whether a request of that browser waits or is being executed."""
        with self._lock:
            command = self._command
            return client in self._requests or (isinstance(command, Request) and command.client == client)

    def save(self, client: int, kind: str) -> None:
        """Ask for a file of the picture that a browser sees."""
        with self._lock:
            self._urgent.append(Save(client, kind))
            self._send_next()

    def forget(self, client: int) -> None:
        """Cancel the requests of a browser, and free its state in the worker."""
        with self._lock:
            self._requests.pop(client, None)
            self._latest.pop(client, None)
            self._urgent = [command for command in self._urgent if command.client != client]
            self._urgent.append(Forget(client))
            self._send_next()

    def stop(self) -> None:
        """End the worker; a picture that is being rendered is lost."""
        with self._lock:
            self._stopped = True
            process, pipe = self._process, self._pipe
        if pipe is not None and self._command is None and self._ready:
            try:
                pipe.send(None)
                process.join(0.5)
            except OSError:
                pass
        if process is not None:
            for end in (process.terminate, process.kill):
                if process.is_alive():
                    end()
                    process.join(_PATIENCE)
        if self._thread.is_alive():
            self._thread.join(_PATIENCE)

    def _launch(self) -> None:
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=run_worker, args=(theirs, self._target), name="lobewise-viewer", daemon=True)
        with _without_interrupts():
            process.start()
        # While this process holds the other end too, the death of the worker would not close the pipe.
        theirs.close()
        with self._lock:
            self._process, self._pipe = process, ours
            self._ready, self._command = False, None

    def _send_next(self) -> None:
        """Send the next command if the worker is idle; saving and forgetting come first. The caller holds the lock."""
        if not self._ready or self._command is not None or self._pipe is None or self._stopped:
            return
        command: Command
        if self._urgent:
            command = self._urgent.pop(0)
        elif self._requests:
            command = self._requests.popitem(last=False)[1]
        else:
            return
        self._command, self._since = command, time.monotonic()
        try:
            self._pipe.send(command)
        except OSError:
            # The worker died, which `_listen` will notice.
            return

    def _listen(self) -> None:
        while not self._stopped:
            pipe = self._pipe
            assert pipe is not None
            try:
                report: Report | None = pipe.recv()
            except (EOFError, OSError):
                if self._stopped or not self._revive():
                    return
                continue
            if report is None:
                with self._lock:
                    self._command = None
                    self._send_next()
                continue
            if isinstance(report, Opened):
                with self._lock:
                    self._ready = self._was_ready = True
                    self._send_next()
            fatal = isinstance(report, Problem) and report.client is None
            if fatal:
                self._stopped = True
            try:
                self._receive(report)
            except Exception:
                # One browser's problem must not stop the others.
                _log.exception("a report of the renderer could not be shown")

    def _revive(self) -> bool:
        """Restart the worker after it died, and repeat the last request of every browser; False if it stays off."""
        with self._lock:
            process = self._process
            self._ready, self._command = False, None
        process.join(_PATIENCE)
        code = process.exitcode
        now = time.monotonic()
        self._deaths = [moment for moment in self._deaths if now - moment < RESTART_SPAN] + [now]
        how = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with exit code {code}"
        if len(self._deaths) > MAX_RESTARTS or not self._was_ready:
            # Of a scene that it cannot open, a new renderer would die as well.
            crash = describe_crash(self._target.name, code or 0)
            self._remark(str(crash), crash)
            return False
        self._remark(f"The renderer {how} and was started again.", None)
        with self._lock:
            if self._stopped:
                return False
            # Saving a file may have killed the worker, so do not repeat it. A new worker has nothing to forget.
            self._urgent.clear()
            for client, request in self._latest.items():
                self._requests.setdefault(client, _freshen(request))
        self._launch()
        return True


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes that are started in the ``with`` block: a terminal sends it to every process.

    The page ends the worker itself.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Start the resource tracker first: if it started together with the worker, it would unblock Ctrl-C.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _freshen(request: Request) -> Request:
    return replace(request, fresh=True)
