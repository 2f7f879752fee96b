"""Shortest times of functions that run in turn; fewer threads."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import Any


def time_best(candidates: Mapping[str, Callable[[], Any]], seconds: float, *, rounds: int = 5) -> dict[str, float]:
    """Return the shortest wall time of each candidate by its name, seconds.

    All candidates run once without timing, and then in turn, so that a disturbance of the machine hits all of them:
    for at least ``rounds`` rounds, >= 1, and until all rounds together have taken ``seconds``.
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


def limit_threads(count: int) -> None:
    """Set the number of threads of kernels; the process must not have run a kernel before."""
    os.environ["HL_NUM_THREADS"] = str(count)
