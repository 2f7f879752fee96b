"""benchmarks/quality/textured_lobes.py: its ways of finding lobes, and its measure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.common import RESULTS
from benchmarks.pages.materials import make_texture_table


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_it_measures_and_leaves_nothing_changed(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.quality import textured_lobes
    from lobewise.render.materials import bsdfs, fitted

    monkeypatch.setattr(textured_lobes, "SEEDS", (1,))
    monkeypatch.setattr(textured_lobes, "FILTERS", {"fast, ggx": textured_lobes.FILTERS["fast, ggx"]})
    before = dict(bsdfs.PLUGIN_OF_CLASS), fitted.probe_places
    found = textured_lobes.measure("metal", 32, 4, 16, tmp_path)
    assert (dict(bsdfs.PLUGIN_OF_CLASS), fitted.probe_places) == before
    assert [found[way]["lobe tables"] for way in textured_lobes.WAYS] == [1, 2, 0]
    for way in ("places", "formula"):
        assert np.allclose(found[way]["alpha"], textured_lobes.ALPHAS, rtol=0.1)
    assert np.ptp(found["one place"]["alpha"]) < 0.01
    assert len(list(tmp_path.glob("*.png"))) == 9


def test_the_page_shows_every_measured_filter() -> None:
    results = json.loads((RESULTS / "textured_lobes.json").read_text())
    rows = make_texture_table(results).splitlines()[2:]
    assert len(rows) == sum(len(found["places"]["errors"]) for found in results["scenes"].values())
    for found in results["scenes"].values():
        for name, error in found["places"]["errors"].items():
            assert error < found["one place"]["errors"][name]
