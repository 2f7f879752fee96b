"""A color image without any guide: that the result is weak, and what helps, is said once."""

from pathlib import Path

import numpy as np
import pytest
from renderers import WRITERS, Written, make_scene, write

from lobewise.cli.program import run
from lobewise.interchange import import_file
from lobewise.interchange.checks import lacks
from lobewise.interchange.preset import load_presets

WEAK = "Of a color image alone lobewise's own filters make a weak result"


def write_cycles(folder: Path, *passes: str) -> Path:
    """Write some passes of a frame of Blender."""
    written = WRITERS["cycles"](make_scene())
    kept = {name: plane for name, plane in written.channels.items() if name.split(".")[-2] in passes}
    write(folder / "a.exr", Written("cycles", kept, written.attributes))
    return folder / "a.exr"


def test_it_is_told_once_with_what_to_switch_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_cycles(tmp_path, "Combined")
    assert run(["denoise", str(path), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]) == 0
    told = capsys.readouterr().err
    assert told.count(WEAK) == 1
    assert told.count("Blender Cycles:") == 1
    assert "gives it by" not in told
    for role in ("normal", "position", "layers", "roughness"):
        assert told.count(load_presets()["cycles"].advice[role]) == 1
    assert "Denoise, which is used unless --offline or a quality is given:" in " ".join(told.split())
    assert "Where a pixel filter" not in told


def test_what_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    missing = "Open Image Denoise is not installed; pip install 'lobewise[best]'"
    monkeypatch.setattr(lacks, "has_oidn", lambda: False)
    monkeypatch.setattr(lacks, "explain_no_oidn", lambda: missing)
    (told,) = (note for note in import_file(write_cycles(tmp_path, "Combined")).notes if WEAK in note)
    assert f"Denoise, but {missing}: switch on in Blender Cycles:" in told


@pytest.mark.parametrize("more", ["Normal", "DiffCol", "Position"])
def test_with_a_guide_what_is_missing_is_told_by_itself(more: str, tmp_path: Path) -> None:
    notes = import_file(write_cycles(tmp_path, "Combined", more, "DiffDir", "DiffInd")).notes
    assert not any(WEAK in note for note in notes)


def test_a_renderer_that_is_not_known_has_no_menu(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", Written("generic", dict.fromkeys("RGB", np.ones((8, 8), np.float32)), {}), packed=False)
    found = import_file(tmp_path / "a.exr")
    (told,) = (note for note in found.notes if WEAK in note)
    assert ": render with a pass named normal, in world space; " in told
    assert "gives it by" not in " ".join(found.notes)


@pytest.mark.parametrize("renderer", [name for name in load_presets() if name != "generic"])
def test_every_renderer_has_something_to_switch_on(renderer: str, tmp_path: Path) -> None:
    write(tmp_path / "a.exr", Written("generic", dict.fromkeys("RGB", np.ones((8, 8), np.float32)), {}), packed=False)
    found = import_file(tmp_path / "a.exr", preset=renderer, mapping={"color": "R,G,B"})
    (told,) = (note for note in found.notes if WEAK in note)
    preset = load_presets()[renderer]
    assert f": switch on in {preset.title}: {preset.advice['normal']}" in told
    assert "none;" not in told
