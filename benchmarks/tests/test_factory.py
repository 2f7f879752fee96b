"""The factory of random shots of Blender: its kinds and plans, and shots that follow from their seeds alone."""

import ast
import json
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from benchmarks.foreign.files import read_pass
from benchmarks.tests.test_foreign_bench import ROOT
from tests.pythons import choose_python, run_without_paths

FACTORY = ROOT / "benchmarks" / "foreign" / "factory"
kinds: Any = import_module("benchmarks.foreign.factory.kinds")
halves: Any = import_module("benchmarks.foreign.factory.halves")

TINY_SHOT = """
import json
import sys
from dataclasses import replace
from pathlib import Path

sys.path[:0] = sys.argv[1:3]
from kinds import plan_shot
from shots import render_shot

for folder, seed in (("first", 0), ("again", 0), ("first", 1)):
    plan, random = plan_shot(sys.argv[4], seed)
    tiny = replace(plan, size=(32, 24), spp=(4,), reference_spp=(2, 2, 2), roughness=seed == 0)
    render_shot(Path(sys.argv[3]) / folder, tiny, random, 1)

# As if it had been stopped: the exposure that its frames have stays.
shot = Path(sys.argv[3]) / "first" / f"{sys.argv[4]}_1"
(shot / "4.exr").rename(Path(sys.argv[3]) / "before.exr")
(shot / "reference_3.exr").unlink()
row = json.loads((shot / "shot.json").read_text())
(shot / "shot.json").write_text(json.dumps({**row, "exposure": 2.0 * row["exposure"]}))
written = (shot / "reference_1.exr").stat().st_mtime_ns
plan, random = plan_shot(sys.argv[4], 1)
render_shot(Path(sys.argv[3]) / "first", tiny, random, 1)
assert (shot / "reference_1.exr").stat().st_mtime_ns == written
"""


def test_every_kind_has_one_purpose_and_one_maker() -> None:
    validation, training = set(kinds.VALIDATION), set(kinds.TRAINING)
    assert not validation & training
    assert validation | training == set(kinds.KINDS) == set(kinds.ORDER)
    assert validation >= {"fog", "hair", "street", "jewels", "windows", "depth"}
    made = [
        (path.stem, node.name.removeprefix("make_"))
        for path in FACTORY.glob("*.py")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and node.name.removeprefix("make_") in kinds.KINDS
    ]
    assert sorted(made) == sorted((kind.module, name) for name, kind in kinds.KINDS.items())


def test_kinds_keep_their_places_and_so_their_seeds() -> None:
    places = {"fog": 0, "foliage": 5, "product": 6, "party": 18, "windows": 19, "depth": 24}
    assert {kind: kinds.ORDER.index(kind) for kind in places} == places


@pytest.mark.parametrize("compression", [OpenEXR.ZIP_COMPRESSION, OpenEXR.ZIPS_COMPRESSION])
@pytest.mark.parametrize("size", [(37, 21), (16, 8)])
def test_files_become_half_floats_but_names_of_things(compression: Any, size: tuple[int, int], tmp_path: Path) -> None:
    random, path = np.random.default_rng(3), tmp_path / "frame.exr"
    names = ("A.Combined.R", "A.CryptoObject00.r", "A.Depth.Z", "A.Position.X")
    old = {name: random.normal(3.0, 2.0, size).astype(np.float32) for name in names}
    old["A.Depth.Z"][0] = 1e10
    old["A.Combined.R"] = np.ones(size, np.float16)
    OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, dict(old)).write(str(path))
    halves.halve_file(path)
    written = path.read_bytes()
    with OpenEXR.File(str(path), separate_channels=True) as file:
        new = {name: channel.pixels for name, channel in file.channels().items()}
    assert {name for name, pixels in new.items() if pixels.dtype == np.float32} == {"A.CryptoObject00.r"}
    for name, pixels in old.items():
        np.testing.assert_array_equal(new[name], pixels.clip(-65504, 65504).astype(new[name].dtype), err_msg=name)
    halves.halve_file(path)
    assert path.read_bytes() == written


@pytest.mark.parametrize("kind", kinds.KINDS)
def test_plans_follow_from_seeds_and_stay_within_bounds(kind: str) -> None:
    plans = [kinds.plan_shot(kind, seed)[0] for seed in range(40)]
    assert plans == [kinds.plan_shot(kind, seed)[0] for seed in range(40)]
    assert 5 < sum(plan.roughness for plan in plans) < 35
    assert len({plan.size for plan in plans}) > 1
    for plan in plans:
        assert (160, 144) <= plan.size <= (256, 192)
        assert len(plan.reference_spp) == 3
        assert sum(plan.reference_spp) >= (300 if kind in kinds.VALIDATION else 150)
        assert all(1 <= spp <= 256 for spp in plan.spp)
        assert kind in kinds.TRAINING or plan.spp == (4, 16, 64)


def test_one_shot_of_each_kind_comes_first() -> None:
    shots = kinds.list_shots(list(reversed(kinds.ORDER)), range(2))
    assert [kind for kind, seed in shots if seed == 0] == list(kinds.ORDER)
    assert [seed for _, seed in shots] == sorted(seed for _, seed in shots)


def average(image: Any) -> float:
    """Return a mean that a few bright dots hardly change."""
    return float(np.mean(image / (1.0 + image)))


@pytest.mark.parametrize(
    "kind",
    [name if name in ("jewels", "product") else pytest.param(name, marks=pytest.mark.nightly) for name in kinds.KINDS],
)
def test_a_shot_follows_from_its_seed(kind: str, tmp_path: Path) -> None:
    run_without_paths([choose_python("bpy"), "-c", TINY_SHOT, str(FACTORY), str(FACTORY.parent), str(tmp_path), kind])
    first, again, other = (tmp_path / folder for folder in (f"first/{kind}_0", f"again/{kind}_0", f"first/{kind}_1"))
    names = {"4.exr", "reference_1.exr", "reference_2.exr", "reference_3.exr", "shot.json"}
    assert {path.name for path in first.iterdir()} == names
    rows = [json.loads((folder / "shot.json").read_text()) for folder in (first, again, other)]
    exposures = [row.pop("exposure") for row in rows]
    assert rows[0] == rows[1]
    assert exposures[0] == pytest.approx(exposures[1], rel=0.05)
    images, places, colors = (
        [read_pass(folder / "4.exr", *name) for folder in (first, again, other)]
        for name in (("Combined", "RGB"), ("Position", "XYZ"), ("DiffCol", "RGB"))
    )
    np.testing.assert_allclose(places[0], places[1], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(colors[0], colors[1], atol=1e-3)
    # Cycles chooses among many lamps in an order of its own.
    assert average(images[0]) == pytest.approx(average(images[1]), rel=0.15)
    before = read_pass(tmp_path / "before.exr", "Combined", "RGB")
    assert average(images[2]) == pytest.approx(average(2.0 * before), rel=0.15)
    assert np.abs(places[0] - places[2]).mean() > 0.05
    assert 0.02 < images[0].mean() < 5.0
    assert read_pass(first / "4.exr", "CryptoObject00", "rgba").any()
    assert read_pass(first / "4.exr", "Roughness", "X").any()
    with OpenEXR.File(str(first / "4.exr"), separate_channels=True) as file:
        position = file.channels()["ViewLayer.Position.X"].pixels
    assert position.dtype == (np.float16 if kinds.KINDS[kind].halves else np.float32)
    with pytest.raises(KeyError):
        read_pass(other / "4.exr", "Roughness", "X")
