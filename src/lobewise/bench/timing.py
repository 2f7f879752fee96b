"""How long things take: candidates in turn, the best of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any


def time_best(candidates: Mapping[str, Callable[[], Any]], seconds: float, *, rounds: int = 5) -> dict[str, float]:
    """Return the best wall time of each candidate, seconds.

    All run once, uncounted, and then in turn again and again, so that a disturbance of the machine meets all of them.

    Parameters
    ----------
    candidates : mapping of str to callable
        What is timed, by name.
    seconds : float
        Least time that all rounds take together.
    rounds : int
        Least number of rounds, >= 1.
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
