"""docs/materials.md is true: its code runs, its fits are as near as it promises, its options exist."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from lobewise.cli.commands import app
from lobewise.fitting.fit import fit_lobes
from lobewise.fitting.ggx import ggx_brdf
from lobewise.io.materials import lobe_table_to_json, write_merl
from tests.fitting.merl_tables import make_merl

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "materials.md").read_text()


@pytest.mark.nightly
def test_the_code_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_merl("gold-paint.binary", make_merl(lambda view, light: ggx_brdf(view, light, 0.15)))
    blocks = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)
    assert blocks
    names = {}
    for block in blocks:
        exec(compile(block, "materials.md", "exec"), names)
    assert names["value"].shape == (2,)
    assert names["albedo"].shape == (2, 3)
    assert names["brushed"].azimuth.size == 8


def test_fits_keep_their_promise():
    results = json.loads((ROOT / "benchmarks" / "results" / "fit_materials.json").read_text())
    # The promise of the fit: three anisotropic lobes, alpha 0.1 to 0.5, n.v from 0.3; a whole file in a minute.
    for fit in results["fits"]:
        if 0.1 <= fit["alpha"] <= 0.5:
            assert min(n for n, view in zip(fit["asg 3"], results["views"], strict=True) if view >= 0.3) >= 0.993
    assert max(results["whole file"]["seconds"]) < 60.0


def test_options_are_those_of_the_verb():
    from typer.main import get_command

    verb = get_command(app).commands["fit"]
    options = {name for parameter in verb.params for name in parameter.opts if name.startswith("--")}
    used = set(re.findall(r"`(--[a-z-]+)", PAGE))
    assert used
    assert used <= options
    assert options - used <= {"--output", "--help"}


@pytest.mark.parametrize("word", ["format", "version"])
def test_format_is_the_one_described(word):
    table = fit_lobes(lambda view, light: ggx_brdf(view, light, 0.3), cosines=[1.0], lobes=1)
    values = json.loads(lobe_table_to_json(table))
    assert f'"{word}": {json.dumps(values[word])}' in PAGE
    for name in values:
        assert f"`{name}`" in PAGE or f'"{name}"' in PAGE
