"""The comparison of networks with and without lobes and halves: its page, and what is not trained again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.pages.ablation import describe_verdict
from benchmarks.training import affinity_ablation


def make_point(steps: int, error: float) -> dict[str, object]:
    """Return a point of a curve with the same error everywhere."""
    errors = {name: {"1": error, "4": error} for name in ("all", "unsplit", "passes", "plain", "color")}
    return {"steps": steps, "frames": 4, "scenes": 2, "frames_aside": 1, "errors": errors}


def write_curve(path: Path, *points: dict[str, object]) -> None:
    """Write a curve as the trainer does."""
    path.write_text(json.dumps({"metric": "", "points": points}))


def test_the_verdict_compares_with_the_whole_network() -> None:
    errors = {"full": 2.0, "full2": 2.2, "nolobes": 3.0, "nohalves": 1.0}
    told = describe_verdict({name: make_point(10, error) for name, error in errors.items()})
    assert told.startswith("Without lobes the error is +50 % with all guides, +50 % with split light")
    assert "Without halves the error is -50 % with all guides" in told
    assert told.endswith("Another seed alone makes it +10 %, +10 %, +10 %.")


def test_what_has_all_of_its_steps_is_not_trained_again(tmp_path: Path) -> None:
    for number, name in enumerate(affinity_ablation.VARIANTS):
        write_curve(tmp_path / f"{name}.json", make_point(5, 9.0), make_point(20, 2.0 + number))
    output = tmp_path / "out.json"
    words = ["--frames", str(tmp_path / "none"), "--folder", str(tmp_path), "--output", str(output)]
    affinity_ablation.main([*words, "--steps", "20"])
    found = json.loads(output.read_text())["variants"]
    assert {name: point["errors"]["all"]["4"] for name, point in found.items()} == {
        name: 2.0 + number for number, name in enumerate(affinity_ablation.VARIANTS)
    }


@pytest.mark.usefixtures("torch")
def test_what_has_fewer_steps_is_begun_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.training import affinity

    curve, checkpoint = tmp_path / "nolobes.json", tmp_path / "nolobes.pt"
    write_curve(curve, make_point(5, 9.0))
    checkpoint.write_bytes(b"old")
    seen: list[list[str]] = []

    def train(words: list[str]) -> None:
        assert not curve.exists()
        assert not checkpoint.exists()
        seen.append(words)
        write_curve(curve, make_point(20, 2.0))

    monkeypatch.setattr(affinity, "main", train)
    point = affinity_ablation.train_variant("nolobes", tmp_path, tmp_path, 20)
    assert point["steps"] == 20
    assert seen[0][-4:] == ["20", "--seed", "1", "--no-lobes"]
