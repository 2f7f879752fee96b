"""Work on every core: on an image piece by piece, and by libraries that have threads of their own.

Pieces do not depend on each other, so threads change no bit.

A forked process has none of its parent's threads, but a copy of every lock and thread pool as they were. A library
whose threads wait for work believes in the child that they still do: it waits for them for ever, or crashes. So its
threads are ended right before a fork, while no call is under way; the next call starts them anew, in both processes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise

# Largest number of pixels worked on at a time: some thirty float32 arrays of this length fit a core's L2 cache.
CHUNK_PIXELS = 16384

Chunk = tuple[slice, slice]
"""Rows and columns of a piece."""


def cut_rows(height: int, width: int) -> Iterator[Chunk]:
    """Cut an image into pieces of about `CHUNK_PIXELS`: whole rows where they fit, else parts of one row."""
    if width > CHUNK_PIXELS:
        for row in range(height):
            for left in range(0, width, CHUNK_PIXELS):
                yield slice(row, row + 1), slice(left, min(left + CHUNK_PIXELS, width))
        return
    step = max(1, CHUNK_PIXELS // width)
    for top, bottom in pairwise([*range(0, height, step), height]):
        yield slice(top, bottom), slice(0, width)


def run_chunks(work: Callable[[Chunk], None], height: int, width: int) -> None:
    """Do ``work`` on every piece of an image; NumPy releases the interpreter lock inside it."""
    todo = list(cut_rows(height, width))
    threads = min(count_cores(), len(todo))

    def run_some(start: int) -> None:
        for chunk in todo[start::threads]:
            work(chunk)

    with ThreadPoolExecutor(threads) as pool:
        # One task per thread, every n-th chunk each: a task per chunk would spend its time in the queue.
        list(pool.map(run_some, range(threads)))


def count_cores() -> int:
    """Return how many processors this process may use, which can be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ForkGate:
    """Calls of a library that has threads of its own: any number at once, but none while the process forks.

    Parameters
    ----------
    end_threads : callable
        Ends the library's threads. It is called before every fork, once no call is under way.
    """

    def __init__(self, end_threads: Callable[[], None]) -> None:
        self._end_threads = end_threads
        self._changed = threading.Condition()
        self._calls = 0
        _hold_at_fork(self._close, self._changed.release)

    @contextmanager
    def enter(self) -> Iterator[None]:
        """Keep the process from forking while a call is under way."""
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
    """Return a lock that no other thread holds while the process forks, so that the child finds it free."""
    lock = threading.RLock()
    _hold_at_fork(lock.acquire, lock.release)
    return lock


def _hold_at_fork(before: Callable[[], object], after: Callable[[], object]) -> None:
    # Systems without fork lack the function.
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=before, after_in_parent=after, after_in_child=after)
