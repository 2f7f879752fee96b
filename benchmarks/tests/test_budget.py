"""The budget of processor time: what counts as kernels, and what counts as slower."""

import json

import numpy as np
import pytest

from benchmarks.performance.budget import (
    RECIPES,
    RESULT,
    SIZE,
    list_rises,
    make_calls,
    make_shot_calls,
    tile,
    time_processor,
)
from lobewise.backend.runtime import Runtime
from lobewise.cli.bench.plane import make_frame
from lobewise.settings.choices import QUALITIES

THREADS = 2
"""Threads that the foretold times of plans are for, all of them busy."""


def test_work_beside_kernels_is_no_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]

    def spend(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr("time.process_time", lambda: now[0])
    monkeypatch.setattr(Runtime, "call", lambda self, seconds: spend(seconds))
    runtime = Runtime.__new__(Runtime)

    def run() -> None:
        spend(3.0)
        runtime.call(2.0)
        runtime.call(0.5)

    assert time_processor(run) == (5.5, 2.5, 0.0)


def test_slower_recipes_are_named() -> None:
    before = {"recipes": {"one": {"over_oidn_fast": 1.0}, "two": {"over_oidn_fast": 1.0}, "old": {}}}
    after = {"recipes": {"one": {"over_oidn_fast": 1.05}, "two": {"over_oidn_fast": 1.3}, "new": {}}}
    assert list_rises(before, after) == ["two"]


def test_committed_budget_has_every_recipe() -> None:
    frame = tile(make_frame(12, 8), 30, 20)
    assert frame.shape == (20, 30)
    assert np.array_equal(frame.radiance.color[8:16, 12:24], frame.radiance.color[:8, :12])
    names = [*make_calls(frame), *make_shot_calls(frame)]
    assert set(RECIPES) < set(names)
    assert list(json.loads(RESULT.read_text())["recipes"]) == names


@pytest.mark.parametrize("quality", [name for name, each in QUALITIES.items() if not each.needs_oidn])
def test_plans_foretell_the_times_that_were_measured(quality: str) -> None:
    measured = json.loads(RESULT.read_text())["recipes"][quality]["seconds"] / THREADS
    megapixels = SIZE[0] * SIZE[1] * 1e-6
    assert QUALITIES[quality].seconds_per_megapixel == pytest.approx(measured / megapixels, rel=0.05)
