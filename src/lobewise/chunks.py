"""Work on an image piece by piece, on every core; pieces do not depend on each other, so threads change no bit."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
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
