"""The times that a printed plan foretells are those that were measured."""

import json

import pytest

from benchmarks.before_after import RESULTS
from benchmarks.same_bits.frames import load_bundled
from lobewise.settings.choices import QUALITIES

CASES = {"fast": "fast full ggx", "balanced": "balanced ggx", "high": "high"}
THREADS = 2
"""Threads that the foretold times are for, all of them busy."""


@pytest.mark.parametrize("quality", CASES)
def test_qualities_take_as_long_as_measured(quality: str) -> None:
    height, width = load_bundled().shape
    processor_ms = json.loads(RESULTS.read_text())["cases"][CASES[quality]]["after_ms"]
    measured = processor_ms * 1e-3 / THREADS / (height * width * 1e-6)
    assert QUALITIES[quality].seconds_per_megapixel == pytest.approx(measured, rel=0.05)
