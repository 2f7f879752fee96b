"""The page on virtual lights is true: the band-limit by the lights helps, and the code of the page runs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "virtual_lights.md"


@pytest.fixture
def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((ROOT / "benchmarks" / "results" / "virtual_lights.json").read_text())
    return found


def test_limit_mends_what_the_default_leaves(results: dict[str, Any]) -> None:
    for name, row in results["scenes"].items():
        errors = row["errors"]
        for similarity in ("sg", "ggx"):
            default, limited = (errors[f"{similarity}, {kind}"]["paths, sharp"] for kind in ("default", "limited"))
            assert limited < 0.8 * default, name
            best = min(each["paths, sharp"] for each in row["sweep"][similarity].values())
            assert limited < 1.15 * best, name


@pytest.fixture
def clusters() -> dict[str, Any]:
    found = json.loads((ROOT / "benchmarks" / "results" / "virtual_light_clusters.json").read_text())
    scenes: dict[str, Any] = found["scenes"]
    return scenes


def test_clusters_have_less_error_than_points(clusters: dict[str, Any]) -> None:
    assert len(clusters) == 8
    for name, row in clusters.items():
        for stage in ("not filtered", "one frame", "eighth frame"):
            for part in ("all", "glossy"):
                found, points = (row["errors"][method][stage][part] for method in ("clusters", "points"))
                assert found < points, (name, stage, part)


def test_clusters_on_metal_boxes_come_near_paths_at_equal_time(clusters: dict[str, Any]) -> None:
    boxes = {name: row for name, row in clusters.items() if "alpha" in name}
    assert len(boxes) == 3
    for name, row in boxes.items():
        for stage in ("not filtered", "one frame", "eighth frame"):
            for part in ("all", "glossy"):
                found, paths = (row["errors"][method][stage][part] for method in ("clusters", "paths"))
                assert found < 1.5 * paths, (name, stage, part)


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_code_runs() -> None:
    pytest.importorskip("mitsuba")
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.S):
        exec(compile(block, PAGE.name, "exec"), names)
    assert 0.0 < names["tau"] < 1.0
