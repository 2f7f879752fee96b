"""The page's end of the pipe: starts the process that renders, hands it the latest wishes in turn, starts it again."""

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

from lobewise.viewer.messages import Forget, Opened, Order, Problem, Report, Request, Save, Target
from lobewise.viewer.worker import run_worker

MOST_RESTARTS = 3
"""How often within `RESTART_SPAN` seconds the process is started again."""
RESTART_SPAN = 60.0
_PATIENCE = 2.0
_log = logging.getLogger(__name__)


class Link:
    """A process that renders for several browsers, one picture at a time, each browser in its turn.

    Of every browser only the latest request is kept: a new one replaces the one that waits. So the process is never
    behind, however slow a picture is.

    ``receive`` is called with every `Report`, from a thread of the link; ``remark`` with a sentence when the process
    died, and whether it is started again.
    """

    def __init__(self, target: Target, receive: Callable[[Report], None], remark: Callable[[str, bool], None]) -> None:
        self._target = target
        self._receive = receive
        self._remark = remark
        self._lock = threading.RLock()
        self._wishes: OrderedDict[int, Request] = OrderedDict()
        self._errands: list[Save | Forget] = []
        self._latest: dict[int, Request] = {}
        self._ready = False
        self._order: Order | None = None
        self._since = 0.0
        self._deaths: list[float] = []
        self._stopped = False
        self._process: Any = None
        self._pipe: Connection | None = None
        self._thread = threading.Thread(target=self._listen, name="lobewise-link", daemon=True)

    def start(self) -> None:
        """Start the process; returns before it is ready."""
        self._launch()
        self._thread.start()

    @property
    def process_id(self) -> int:
        """Of the process that renders, 0 where there is none."""
        with self._lock:
            return int(self._process.pid or 0) if self._process is not None else 0

    def get_busy(self) -> tuple[Order | None, float]:
        """Return the order that is worked on, and for how many seconds."""
        with self._lock:
            return self._order, time.monotonic() - self._since

    def submit(self, request: Request) -> None:
        """Ask for a picture; it replaces an earlier wish of that browser that has not been begun."""
        with self._lock:
            waiting = self._wishes.get(request.client)
            if waiting is not None and waiting.fresh and not request.fresh:
                # What only shows the last frame anew must not cancel a frame that was asked for.
                request = _freshen(request)
            self._wishes[request.client] = self._latest[request.client] = request
            self._send_next()

    def is_waiting(self, client: int) -> bool:
        """Return whether a wish of that browser waits or is worked on."""
        with self._lock:
            order = self._order
            return client in self._wishes or (isinstance(order, Request) and order.client == client)

    def save(self, client: int, kind: str) -> None:
        """Ask for a file of what a browser sees."""
        with self._lock:
            self._errands.append(Save(client, kind))
            self._send_next()

    def forget(self, client: int) -> None:
        """Take back what a browser wished for, and free what it had."""
        with self._lock:
            self._wishes.pop(client, None)
            self._latest.pop(client, None)
            self._errands = [errand for errand in self._errands if errand.client != client]
            self._errands.append(Forget(client))
            self._send_next()

    def stop(self) -> None:
        """End the process; a picture that is worked on is given up."""
        with self._lock:
            self._stopped = True
            process, pipe = self._process, self._pipe
        if pipe is not None and self._order is None and self._ready:
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
        # Held here too, the pipe would never end when the process does.
        theirs.close()
        with self._lock:
            self._process, self._pipe = process, ours
            self._ready, self._order = False, None

    def _send_next(self) -> None:
        """Give the process its next order if it has none; saving and forgetting come first. Needs the lock."""
        if not self._ready or self._order is not None or self._pipe is None or self._stopped:
            return
        order: Order
        if self._errands:
            order = self._errands.pop(0)
        elif self._wishes:
            order = self._wishes.popitem(last=False)[1]
        else:
            return
        self._order, self._since = order, time.monotonic()
        try:
            self._pipe.send(order)
        except OSError:
            # The listener finds the process dead.
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
                    self._order = None
                    self._send_next()
                continue
            if isinstance(report, Opened):
                with self._lock:
                    self._ready = True
                    self._send_next()
            fatal = isinstance(report, Problem) and report.client is None
            if fatal:
                self._stopped = True
            try:
                self._receive(report)
            except Exception:
                # Something about one browser; the others go on.
                _log.exception("a report of the renderer could not be shown")

    def _revive(self) -> bool:
        """Start the process again after it died, and ask for what every browser sees; False where that is no use."""
        with self._lock:
            process = self._process
            self._ready, self._order = False, None
        process.join(_PATIENCE)
        code = process.exitcode
        now = time.monotonic()
        self._deaths = [moment for moment in self._deaths if now - moment < RESTART_SPAN] + [now]
        again = len(self._deaths) <= MOST_RESTARTS
        how = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with exit code {code}"
        if not again:
            self._remark(f"The renderer {how}, the {len(self._deaths)}th time within a minute; it stays off.", False)
            return False
        self._remark(f"The renderer {how} and was started again.", True)
        with self._lock:
            if self._stopped:
                return False
            # Files are asked for again only by hand: what killed it may have been one. There is nothing to forget.
            self._errands.clear()
            for client, request in self._latest.items():
                self._wishes.setdefault(client, _freshen(request))
        self._launch()
        return True


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes that are started meanwhile never see Ctrl-C, which a terminal sends to all: the page ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Started with the first process, it would let Ctrl-C through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _freshen(request: Request) -> Request:
    return replace(request, fresh=True)
