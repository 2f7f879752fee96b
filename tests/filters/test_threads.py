"""Threads change no bit of what any kernel over time gives: one process with one thread, against this one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from lobewise.filters.history.reprojection import run_reprojection as reproject
from tests.features.frames import make_mask
from tests.filters.test_accumulation import accumulate, make_given, make_grid
from tests.filters.test_reprojection import make_pair, make_past, make_places

SHAPE = (131, 67)


def run_reprojection_once() -> np.ndarray:
    """Return what a reprojection gives."""
    masks = make_mask(SHAPE), make_mask(SHAPE)
    return reproject(make_past(SHAPE), make_places(SHAPE), masks, make_pair((), SHAPE))


def run_trust_once() -> np.ndarray:
    """Return how far samples bear out a history."""
    given = make_given(SHAPE, 2, (1, 0))
    return make_grid(given, 2, (1, 0)).find_trust(given["samples"], given["history"], 1.4)


def run_accumulation_once() -> np.ndarray:
    """Return the sums of samples and history."""
    return accumulate(make_given(SHAPE, 2, (1, 0)), 2, (1, 0)).sums


CALLS: dict[str, Callable[[], np.ndarray]] = {
    "accumulation": run_accumulation_once,
    "reprojection": run_reprojection_once,
    "trust": run_trust_once,
}
PROGRAM = """
import sys
from tests.filters.test_threads import CALLS
import numpy as np
np.savez(sys.argv[1], **{name: call() for name, call in CALLS.items()})
"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """Return what every call gives in a process of one thread."""
    path = tmp_path_factory.mktemp("threads") / "alone.npz"
    environment = {**os.environ, "HL_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", PROGRAM, str(path)], check=True, env=environment)
    with np.load(path) as stored:
        return dict(stored)


@pytest.mark.processor
@pytest.mark.parametrize("name", CALLS)
def test_threads_change_nothing(name: str, alone: dict[str, np.ndarray]) -> None:
    assert CALLS[name]().tobytes() == alone[name].tobytes()
