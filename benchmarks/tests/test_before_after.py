"""The times that a printed plan foretells are those that were measured."""

from __future__ import annotations

import json

import pytest

from benchmarks.before_after import RESULTS
from benchmarks.common import RESULTS as FOLDER
from benchmarks.same_bits import load_bundled
from lobewise.settings.choices import QUALITIES

CASES = {"fast": "fast full ggx", "balanced": "balanced ggx"}
TIMED = "seconds at 1920x1080, two threads, best of three"


@pytest.mark.parametrize("quality", CASES)
def test_qualities_take_as_long_as_measured(quality: str) -> None:
    height, width = load_bundled().shape
    measured = json.loads(RESULTS.read_text())["cases"][CASES[quality]]["after_ms"] * 1e-3 / (height * width * 1e-6)
    assert QUALITIES[quality].seconds_per_megapixel == pytest.approx(measured, rel=0.05)


def test_high_takes_as_long_as_measured() -> None:
    measured = json.loads((FOLDER / "refinement_trials.json").read_text())[TIMED]["high"] / (1.92 * 1.08)
    assert QUALITIES["high"].seconds_per_megapixel == pytest.approx(measured, rel=0.05)
