"""How long things take: candidates in turn, the best of each; in processes with fewer threads."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from typing import Any


def time_best(candidates: Mapping[str, Callable[[], Any]], seconds: float, *, rounds: int = 5) -> dict[str, float]:
    """Return the best wall time of each candidate by its name, seconds.

    All run once, uncounted, and then in turn again and again, so that a disturbance of the machine meets all of them:
    at least ``rounds`` times, >= 1, and until all rounds have taken ``seconds`` together.
    """
    for call in candidates.values():
        call()
    best = dict.fromkeys(candidates, float("inf"))
    start, done = time.perf_counter(), 0
    while done < rounds or time.perf_counter() - start < seconds:
        for name, call in candidates.items():
            begin = time.perf_counter()
            call()
            best[name] = min(best[name], time.perf_counter() - begin)
        done += 1
    return best


def keep_best(known: Mapping[str, float] | None, found: Mapping[str, float]) -> dict[str, float]:
    """Return the lower of two times of each candidate; None is no times yet."""
    return {name: min(value, (known or found)[name]) for name, value in found.items()}


@contextmanager
def open_pools(counts: Sequence[int]) -> Iterator[dict[int, ProcessPoolExecutor]]:
    """Give a process for each number of threads that kernels shall use, which a process cannot change."""
    with ExitStack() as stack:
        context = get_context("spawn")
        yield {
            count: stack.enter_context(
                ProcessPoolExecutor(1, mp_context=context, initializer=limit_threads, initargs=(count,))
            )
            for count in counts
        }


def limit_threads(count: int) -> None:
    """Make this process, which has run no kernel yet, use so many threads."""
    os.environ["HL_NUM_THREADS"] = str(count)
