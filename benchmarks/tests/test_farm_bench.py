"""The benchmark of farms: its ratios, and a small run with a killed worker and a restarted scheduler."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.robustness import farm


def test_ratios_compare_a_run_with_the_work_of_its_workers() -> None:
    parts = {
        "work": {"frame": {"seconds": 9.0, "cpu_seconds": 0.5}},
        "farm": {"frames": 100, "seconds": 999.0, "cpu_seconds": 60.0},
        "work_quiet": {"frame": {"seconds": 0.5, "cpu_seconds": 9.0}},
        "farm_quiet": {"frames": 100, "seconds": 30.0, "cpu_seconds": 999.0},
    }
    assert farm.compare(parts) == pytest.approx({"cpu_seconds": 1.2, "seconds": 1.2})
    assert farm.compare({"work": parts["work"]}) == {}


@pytest.mark.nightly
def test_a_small_run_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="needs Dask: pip install 'lobewise[farm]'")
    monkeypatch.setattr(farm, "FOLDER", tmp_path / "frames")
    # Large enough that the run is not over before the kills.
    found = farm.measure_losses(farm.make_sources(30), 30, tmp_path)
    assert found["frames_before_worker_was_killed"] < found["frames_before_scheduler_was_killed"] < 30
    assert (found["same_bytes_as_one_process"], found["missing"], found["left_over"]) == (30, 0, 0)
