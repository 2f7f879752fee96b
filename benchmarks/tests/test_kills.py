"""Targets of a killed run are whole, and the next run leaves nothing over."""

import pytest

from benchmarks.robustness.kills import WAYS, run_kills


@pytest.mark.nightly
def test_some_kills() -> None:
    names = set()
    for name, counts in run_kills(len(WAYS), seed=3):
        names.add(name)
        assert counts["killed"] == 1
        assert counts["with something half written"] == 1
        assert counts["old"] + counts["new"] >= 1
        for what in ("damaged", "missing", "other pixels", "left over", "not new after the next run"):
            assert counts[what] == 0, counts
    assert names == {way.name for way in WAYS}
