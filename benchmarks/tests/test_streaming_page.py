"""The pages on bands: their code runs, the goal was met, their numbers of rows are true."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from lobewise.denoising.automatic import ask, resolve_all
from lobewise.filters.forms import ATROUS_REACH
from lobewise.recipes.streaming.plan import MAX_WHOLE_GIB, MIN_ROWS, compute_band_reach
from tests.streaming.frames import make_scene
from tests.test_docs import BUNDLED, ROOT

PAGE = ROOT / "docs" / "streaming.md"
DETAILS = ROOT / "docs" / "developers" / "bands.md"
RESULT = ROOT / "benchmarks" / "results" / "streaming.json"


def test_the_goal_was_met() -> None:
    measured = json.loads(RESULT.read_text())
    assert measured["size"] == [7680, 4320]
    assert set(measured["rows"]) == {"fast", "balanced", "high"}
    for row in measured["rows"].values():
        assert row["bands"]["peak_gib"] < 4.0
        assert row["within_limit"]


def test_the_page_knows_how_far_filters_reach() -> None:
    text = " ".join(DETAILS.read_text().split())

    def reach(**settings: Any) -> int:
        return compute_band_reach(resolve_all(make_scene((8, 8)), ask(None, settings)))

    numbers = reach(quality="fast"), reach(quality="balanced"), reach(quality="high"), reach(form="atrous")
    assert "{} to each side for `fast` at radius 8, {} for `balanced`, {} for `high`".format(*numbers) in text
    assert f"; {numbers[3]} for the form `atrous`" in text
    assert f"from up to {ATROUS_REACH} pixels away" in text
    assert f"bands then have {MIN_ROWS} rows" in text
    assert f"more than {MAX_WHOLE_GIB:g} GiB" in text


@pytest.mark.nightly
def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(BUNDLED, tmp_path / "frame.exr")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.S):
        exec(compile(block, PAGE.name, "exec"), names)
    assert names["done"].bands == -(-names["done"].shape[0] // 64)
    assert (tmp_path / "clean.exr").exists()


def test_tiles_differ_from_each_other_in_their_light_alone() -> None:
    import numpy as np

    from benchmarks.performance import streaming

    rng = np.random.default_rng(1)
    for name, noisy in (
        ("R", True), ("diffuse.G", True), ("half_a.B", True), ("half_b.specular.R", True), ("indirect.R", True),
        ("diffuse_albedo.R", False), ("specular_albedo.R", False), ("normal.X", False), ("coverage.0", False),
    ):  # fmt: skip
        assert streaming.is_radiance(name) == noisy
    for kind in (np.float16, np.float32):
        plane = rng.gamma(0.5, 1.0, (20, 30)).astype(kind)
        plane[3] = 0.0
        plane[4, 5] = np.nan
        changed = streaming.vary("R", plane, rng)
        assert changed.dtype == kind
        assert (changed != plane).mean() > 0.5
        np.testing.assert_allclose(changed, plane, rtol=0.005)
        assert (changed[3] == 0.0).all()
        np.testing.assert_array_equal(streaming.vary("normal.X", plane, rng), plane)
