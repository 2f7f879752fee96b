"""benchmarks/upsampling/rays.py: its measure, its trials and its means."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from benchmarks.upsampling.rays import BETAS, TRIALS, Shot, compute_mean_ratios, measure_error


def test_error_leaves_out_the_noise_of_the_reference() -> None:
    rng = np.random.default_rng(0)
    truth = np.full((64, 64, 3), 2.0)
    halves = tuple((truth + rng.normal(0.0, 0.1, truth.shape)).astype(np.float32) for _ in range(2))
    shot = Shot([], [], (halves[0], halves[1]), np.ones((64, 64), bool))
    assert measure_error((truth + 0.5).astype(np.float32), shot) == pytest.approx(0.25 / 4.01, rel=0.1)
    assert abs(measure_error(truth.astype(np.float32), shot)) < 0.0002


def test_means_are_geometric_and_over_frames_without_rays() -> None:
    def make(factor: float) -> dict[str, dict[str, dict[str, float]]]:
        errors = {str(beta): {"one frame": 1.0, "over time": 2.0} for beta in BETAS}
        scaled = {beta: {kind: factor * each for kind, each in cells.items()} for beta, cells in errors.items()}
        return {trial: errors if trial == "no rays" else scaled for trial in TRIALS}

    means = compute_mean_ratios({"a": make(0.5), "b": make(2.0), "c": make(0.125)})
    assert means["no rays"]["auto"] == {"one frame": 1.0, "over time": 1.0}
    assert means["weights"]["auto"] == {"one frame": 0.5, "over time": 0.5}
