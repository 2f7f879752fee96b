"""Workers that are processes of this machine. They listen at no port: each has a pipe to the client alone."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

from lobewise.display.hushing import hush_libraries
from lobewise.errors import LobewiseError
from lobewise.farm.calls import CallFailedError, WorkerLostError
from lobewise.farm.worker import limit_threads
from lobewise.work.chunks import count_cores

MAX_FALSE_STARTS = 3
"""Processes that may end, before they have answered anything, since the last answer; then no process can start here."""


class ProcessCall:
    """A function that runs in a process of this machine; see `lobewise.farm.calls.Call`."""

    def __init__(self, key: str, future: Future[Any], lose: Callable[[], None]) -> None:
        self.key = key
        self._future = future
        self._lose = lose

    @property
    def has_ended(self) -> bool:
        """Whether the function has returned or failed, or its process has ended."""
        return self._future.done()

    def fetch(self) -> Any:
        """Return what the function returned; raise `WorkerLostError` or `CallFailedError`."""
        try:
            return self._future.result(timeout=0.0)
        except (BrokenExecutor, CancelledError) as problem:
            self._lose()
            raise WorkerLostError from problem
        except Exception as problem:
            raise CallFailedError(f"{type(problem).__name__}: {problem}") from problem

    def drop(self) -> None:
        """Forget the call; a function that does not run yet never will."""
        self._future.cancel()


class Processes:
    """Processes of this machine; see `lobewise.farm.calls.Connection`. One that ended is replaced by another.

    Parameters
    ----------
    count : int
        How many. They share the cores of the machine.
    """

    address = "this machine"

    def __init__(self, count: int) -> None:
        self._threads = max(count_cores() // count, 1)
        self._count = count
        self._numbers = itertools.count(1)
        self._keys = itertools.count(1)
        self._pools: dict[str, ProcessPoolExecutor] = {}
        self._answered: set[str] = set()
        self._false_starts = 0
        self._finished: queue.SimpleQueue[str] = queue.SimpleQueue()

    def list_workers(self) -> dict[str, int]:
        """Return the threads of each process by its name. Raises LobewiseError if no process can start."""
        if self._false_starts >= MAX_FALSE_STARTS:
            raise LobewiseError(
                "--workers",
                expected=f"{self._count} processes that start",
                got=f"{self._false_starts} that ended at once",
                action="ask for fewer, or look for what hinders a new process",
            )
        while len(self._pools) < self._count:
            # One process in each pool: where a process ends, its whole pool is lost.
            pool = ProcessPoolExecutor(
                1,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=prepare_process,
                initargs=(self._threads,),
            )
            self._pools[f"process {next(self._numbers)}"] = pool
        return dict.fromkeys(self._pools, self._threads)

    def call(self, worker: str, function: Callable[..., Any], *arguments: Any) -> ProcessCall:
        """Let a process call a function."""
        key = str(next(self._keys))
        try:
            with _deaf_to_interrupts():
                future = self._pools[worker].submit(function, *arguments)
        except BrokenExecutor as problem:
            future = Future()
            future.set_exception(problem)

        def end(done: Future[Any]) -> None:
            if not done.cancelled() and done.exception() is None:
                self._answered.add(worker)
                self._false_starts = 0
            self._finished.put(key)

        future.add_done_callback(end)
        return ProcessCall(key, future, lambda: self._lose(worker))

    def wait_for_finished(self, seconds: float) -> list[str]:
        """Return the keys of calls that have ended, however they ended; wait at most some seconds for the first."""
        return take_finished(self._finished, seconds)

    def _lose(self, worker: str) -> None:
        pool = self._pools.pop(worker, None)
        if pool is not None:
            pool.shutdown(wait=False)
            self._false_starts += worker not in self._answered

    def close(self) -> None:
        """End all processes, whatever they are at."""
        for pool in self._pools.values():
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def start_local(workers: int) -> Iterator[Processes]:
    """Start processes on this machine; they end with the ``with`` block."""
    before = set(multiprocessing.active_children())
    # Start multiprocessing's helper now: a process that starts it hears Ctrl-C afterwards.
    resource_tracker.ensure_running()
    processes = Processes(workers)
    try:
        yield processes
    finally:
        for child in set(multiprocessing.active_children()) - before:
            child.kill()
        processes.close()


def prepare_process(threads: int) -> None:
    """Prepare a process of `Processes`: it is quiet, shares the cores, and ends with the client."""
    threading.Thread(target=_end_with_client, name="client", daemon=True).start()
    hush_libraries()
    limit_threads(threads)


def _end_with_client() -> None:
    client = multiprocessing.parent_process()
    assert client is not None
    client.join()
    os._exit(1)


def take_finished(finished: queue.SimpleQueue[str], seconds: float) -> list[str]:
    """Return what a queue holds; wait at most some seconds for the first."""
    keys: list[str] = []
    try:
        keys.append(finished.get(timeout=seconds))
        while True:
            keys.append(finished.get_nowait())
    except queue.Empty:
        return keys


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Start processes that are deaf to Ctrl-C.

    A terminal sends Ctrl-C to every process of a command. A worker would print a traceback; the client ends it anyway.
    A process has the mask of the thread that starts it. Windows has no masks.
    """
    mask = getattr(signal, "pthread_sigmask", None)
    before = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else set()
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)
