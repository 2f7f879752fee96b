"""The property that every kind of file has, tried until time or a count is spent."""

import os
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.readers import READERS, can_read
from tests.fuzz.strategies import make_strategy
from tests.fuzz.watch import Verdict, Watcher, save_finding

SECONDS = float(os.environ.get("LOBEWISE_FUZZ_SECONDS", "1"))
"""For each kind in a run of the tests."""
SEED = int(os.environ.get("LOBEWISE_FUZZ_SEED", "20150915"))
BATCH = 25
"""Files that one seed makes."""


@dataclass
class Tally:
    """What became of the files of a kind."""

    outcomes: Counter[str] = field(default_factory=Counter)
    peak: int = 0
    findings: dict[str, str] = field(default_factory=dict)
    """Where the first file of each cause lies, and what it did, by what tells causes apart."""
    seconds: float = 0.0

    @property
    def files(self) -> int:
        """How many were tried."""
        return sum(self.outcomes.values())


def fuzz(
    kind: str,
    watcher: Watcher,
    *,
    seconds: float = float("inf"),
    count: int | None = None,
    start: int = SEED,
    notice: Callable[[Verdict], None] | None = None,
) -> Tally:
    """Return what became of files of a kind, made one after another until the seconds or the count are spent.

    The same ``start`` makes the same files. Each file that fails is kept among the regressions.
    """
    tally, began = Tally(), time.monotonic()
    strategy = make_strategy(kind)

    def is_over() -> bool:
        if count is not None and tally.files >= count:
            return True
        # One file is tried however slow the machine is.
        return tally.files > 0 and time.monotonic() - began >= seconds

    def try_one(data: bytes) -> None:
        if is_over():
            return
        verdict = watcher.judge(kind, data)
        tally.outcomes[verdict.outcome] += 1
        tally.peak = max(tally.peak, verdict.peak)
        if verdict.is_bad and verdict.signature not in tally.findings:
            path = save_finding(kind, data, READERS[kind].ending)
            tally.findings[verdict.signature] = f"{path}: {verdict.outcome}\n{verdict.told}"
            if notice is not None:
                notice(verdict)

    number = start
    while not is_over():
        run = given(strategy)(try_one)
        run = settings(
            max_examples=BATCH,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )(run)
        seed(number)(run)()
        number += 1
    tally.seconds = time.monotonic() - began
    return tally


def check_kind(kind: str, *, share: float = 1.0) -> None:
    """Assert that no file of a kind fails, for `SECONDS` times ``share``; skip where what it needs is missing."""
    if not can_read(kind):
        pytest.skip(f"what {kind} needs is not installed")
    with Watcher() as watcher:
        # Loading and compiling is not fuzzing: the clock starts after it.
        watcher.judge(kind, b"")
        tally = fuzz(kind, watcher, seconds=SECONDS * share)
    assert tally.files > 0
    assert not tally.findings, f"seed {SEED}\n" + "\n".join(tally.findings.values())
