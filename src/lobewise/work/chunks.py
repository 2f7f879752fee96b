"""Work on all cores: on an image in chunks, and in libraries with threads of their own.

Chunks do not depend on each other, so results have the same bits for any number of threads.

A forked process has no threads of its parent, but copies of its locks and thread pools. In the child a library with a
thread pool would wait for its threads for ever, or crash. So the threads of libraries are ended before a fork, while no
call is under way. The next call starts them anew, in both processes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import pairwise

CHUNK_PIXELS = 16384
"""Largest number of pixels in a chunk: thirty float32 arrays of this length fit a core's L2 cache."""

Chunk = tuple[slice, slice]
"""Rows and columns of a part of an image."""


def cut_rows(height: int, width: int) -> Iterator[Chunk]:
    """Cut an image into chunks of at most `CHUNK_PIXELS`: whole rows where a row fits, else parts of one row."""
    if width > CHUNK_PIXELS:
        for row in range(height):
            for left in range(0, width, CHUNK_PIXELS):
                yield slice(row, row + 1), slice(left, min(left + CHUNK_PIXELS, width))
        return
    step = max(1, CHUNK_PIXELS // width)
    for top, bottom in pairwise([*range(0, height, step), height]):
        yield slice(top, bottom), slice(0, width)


def run_chunks(work: Callable[[Chunk], None], height: int, width: int) -> None:
    """Call ``work`` on every chunk of an image, in this thread and others. NumPy releases the interpreter lock."""
    todo = list(cut_rows(height, width))
    waiting = iter(todo)

    def run_waiting() -> None:
        # Tasks take chunks until none is left: with a task per chunk the queue would take the time.
        for chunk in waiting:
            work(chunk)

    helpers = min(count_threads(), len(todo)) - 1
    tasks: list[Future[None]] = []
    with ThreadPoolExecutor(max(helpers, 1)) as pool:
        # Python raises RuntimeError where the system refuses another thread: the threads that run do the work.
        with suppress(RuntimeError):
            for _ in range(helpers):
                tasks.append(pool.submit(run_waiting))
        run_waiting()
    for task in tasks:
        task.result()


def count_cores() -> int:
    """Return how many processors this process may use. The machine may have more."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def count_threads() -> int:
    """Return the number of threads to use: one per core, unless HL_NUM_THREADS sets another number, as for Halide."""
    variable = os.environ.get("HL_NUM_THREADS", "")
    return int(variable) if variable.isdecimal() and int(variable) > 0 else count_cores()


class ForkGate:
    """Allows any number of calls at once of a library with threads of its own, but none while the process forks.

    Parameters
    ----------
    end_threads : callable
        Ends the library's threads. Called before every fork, when no call is under way.
    """

    def __init__(self, end_threads: Callable[[], None]) -> None:
        self._end_threads = end_threads
        self._changed = threading.Condition()
        self._calls = 0
        _hold_at_fork(self._close, self._changed.release)

    @contextmanager
    def enter(self) -> Iterator[None]:
        """Delay forks of the process until the ``with`` block has ended."""
        with self._changed:
            self._calls += 1
        try:
            yield
        finally:
            with self._changed:
                self._calls -= 1
                self._changed.notify_all()

    def _close(self) -> None:
        self._changed.acquire()
        self._changed.wait_for(lambda: self._calls == 0)
        self._end_threads()


def make_fork_lock() -> threading.RLock:
    """Return a lock that no other thread can hold during a fork, so that it is free in the child."""
    lock = threading.RLock()
    _hold_at_fork(lock.acquire, lock.release)
    return lock


def _hold_at_fork(before: Callable[[], object], after: Callable[[], object]) -> None:
    # Systems without fork lack this function.
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=before, after_in_parent=after, after_in_child=after)
