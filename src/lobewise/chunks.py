"""Work on an image piece by piece, on every core; pieces do not depend on each other, so threads change no bit."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def run_chunks(work: Callable[[Chunk], None], height: int, width: int, threads: int | None = None) -> None:
    """Do ``work`` on every piece of an image; NumPy releases the interpreter lock inside it.

    Parameters
    ----------
    threads : int, optional
        Worker threads; by default one per available core.
    """
    todo = list(cut_rows(height, width))
    if threads is None:
        threads = count_cores()
    threads = min(threads, len(todo))
    if threads == 1:
        for chunk in todo:
            work(chunk)
        return
    with ThreadPoolExecutor(threads) as pool:
        # one task per thread, every n-th chunk each: a task per chunk would spend its time in the queue
        for done in [pool.submit(_run_all, work, todo[start::threads]) for start in range(threads)]:
            done.result()


def map_chunks(function: Callable[..., Any], *images: NDArray[Any]) -> Any:
    """Return ``function(*images)``, computed piece by piece; it must not look from one pixel at another.

    Every array begins with (height, width); the function gets the same piece of each and returns one of its own, or a
    tuple of them, and so does this.
    """
    first = function(*(image[:1, :1] for image in images))
    several = isinstance(first, tuple)
    height, width = images[0].shape[:2]
    wholes = tuple(np.empty((height, width, *part.shape[2:]), part.dtype) for part in (first if several else (first,)))

    def work(chunk: Chunk) -> None:
        pieces = function(*(image[chunk] for image in images))
        for whole, piece in zip(wholes, pieces if several else (pieces,), strict=True):
            whole[chunk] = piece

    run_chunks(work, height, width)
    return wholes if several else wholes[0]


def _run_all(work: Callable[[Chunk], None], chunks: list[Chunk]) -> None:
    for chunk in chunks:
        work(chunk)


def count_cores() -> int:
    """Return how many processors this process may use, which can be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
