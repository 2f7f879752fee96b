"""The documentation is true: its code runs, its commands exist, its figures come from the committed JSON files."""

from __future__ import annotations

import json
import re
import shutil
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import lobewise

ROOT = Path(__file__).parents[1]
BUNDLED = ROOT / "src" / "lobewise" / "data" / "demo.exr"


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def load_publisher() -> ModuleType:
    """Return benchmarks/publish.py as a module."""
    return import_module("benchmarks.publish")


def run_blocks(name: str) -> dict[str, Any]:
    """Run the Python blocks of a page of docs one after the other; return the names that they define."""
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs" / name).read_text(), flags=re.S):
        exec(compile(block, name, "exec"), names)
    return names


def test_readme_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(BUNDLED, tmp_path / "frame.exr")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    before, after = lobewise.read_frame("frame.exr"), lobewise.read_frame("clean.exr")
    assert after.shape == before.shape
    assert not np.array_equal(after.radiance.color, before.radiance.color)


BLENDER_PAGE = ROOT / "docs" / "blender.md"


def test_blender_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(ROOT / "tests" / "data" / "foreign" / "blender_4.5_seed1.exr", tmp_path / "shot.exr")
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", BLENDER_PAGE.read_text(), flags=re.S)
    exec(compile(block, "blender.md", "exec"), {})
    before, after = lobewise.read_frame("shot.exr"), lobewise.read_frame("clean.exr")
    assert not np.array_equal(after.radiance.color, before.radiance.color)
    assert [len(layer.parts) for layer in after.layers] == [len(layer.parts) for layer in before.layers] != []


def test_blender_page_has_commands_and_options_that_exist() -> None:
    from typer.main import get_command

    from lobewise.cli.commands import app

    verbs = get_command(app).commands  # type: ignore[attr-defined]
    blocks = re.findall(r"^```(\w*)\n(.*?)^```", BLENDER_PAGE.read_text(), flags=re.S | re.M)
    commands = "".join(text for language, text in blocks if not language)
    lines = re.findall(r"^lobewise ([^#\n]*)", commands, flags=re.M)
    assert {line.split()[0] for line in lines} >= {"inspect", "denoise", "view", "compare"}
    known = {
        verb: {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
        for verb, command in verbs.items()
    }
    for verb, *words in map(str.split, lines):
        assert {word for word in words if word.startswith("--")} <= known[verb], verb
    alone = set(re.findall(r"`(--[a-z-]+)", BLENDER_PAGE.read_text()))
    assert alone
    assert alone <= known["denoise"]


def test_blender_page_names_what_the_extension_shows() -> None:
    page = BLENDER_PAGE.read_text()
    sources = "".join(path.read_text() for path in (ROOT / "extensions" / "blender").glob("*.py"))
    for text in re.findall(r"\*\*([A-Z][^*]+)\*\*(?: denoises|, and)", page):
        assert f'"{text}"' in sources, text
    settings = re.findall(r"^\| ([A-Z][\w ]+) \| (?:as|whether|Replace)", page, flags=re.M)
    assert len(settings) == 4
    for name in settings:
        assert f'name="{name}"' in sources, name


def test_blender_page_has_every_menu_entry_that_notes_name() -> None:
    from lobewise.interchange.preset import look_up_preset

    page = BLENDER_PAGE.read_text()
    tables = "\n".join(line for line in page.splitlines() if line.startswith("|"))
    entries = [text for text in look_up_preset("cycles").advice.values() if text.startswith("View Layer > Passes > ")]
    assert len(entries) > 4
    for text in entries:
        panel, passes = text.split(", from")[0].removeprefix("View Layer > Passes > ").split(" > ")
        for word in re.findall(r"[A-Z]\w*", passes):
            assert any(row.startswith(f"| {panel} ") and word in row for row in tables.splitlines()), text


@pytest.mark.nightly
def test_upsampling_page_runs() -> None:
    names = run_blocks("upsampling.md")
    assert names["image"].shape == (64, 80, 3)
    np.testing.assert_allclose(names["image"], 0.5, rtol=1e-5)
    np.testing.assert_allclose(names["shine"], 0.2, rtol=1e-5)


@pytest.mark.parametrize("needs", ["torch", "pyoidn"])
def test_what_the_notebook_on_arrays_does_not_run_is_true(needs: str) -> None:
    pytest.importorskip(needs)
    cells = json.loads((ROOT / "docs" / "tutorials" / "arrays.ipynb").read_text())["cells"]
    text = "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    block = {"torch": 0, "pyoidn": 1}[needs]
    noisy = np.full((20, 24, 3), 0.5, np.float32)
    guides = lobewise.GBuffer(diffuse_albedo=noisy)
    names = {"lobewise": lobewise, "noisy": noisy, "guides": guides}
    names["frame"] = lobewise.Frame(lobewise.Radiance(noisy), guides)
    exec(compile(re.findall(r"```python\n(.*?)```", text, flags=re.S)[block], "arrays.ipynb", "exec"), names)
    assert names["clean" if needs == "torch" else "image"].shape == noisy.shape


@pytest.mark.nightly
def test_temporal_page_runs() -> None:
    names = run_blocks("developers/temporal.md")
    assert names["result"].image.shape == (48, 64, 3)
    np.testing.assert_allclose(names["result"].image.mean(), 0.5, rtol=0.05)


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_page_for_mitsubas_users_runs(mi: Any) -> None:
    names: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "mitsuba.md").read_text(), flags=re.S)
    for block in blocks:
        exec(compile(block, "mitsuba.md", "exec"), names)
    assert len(blocks) == 5
    assert np.array(names["denoised"]).shape == names["previous"].shape == (256, 256, 3)
    assert np.isfinite(np.array(names["dr"].grad(names["noisy"]))).all()


@pytest.mark.mitsuba
@pytest.mark.nightly
def test_interactive_page_runs(mi: Any) -> None:
    names = run_blocks("developers/interactive.md")
    assert [image.shape for image in names["images"]] == [(128, 128, 3)] * 3


@pytest.mark.parametrize("name", ["README.md", "docs/command_line.md"])
def test_commands_exist(name: str) -> None:
    from typer.main import get_command

    from lobewise.cli.commands import app

    verbs = set(get_command(app).commands)  # type: ignore[attr-defined]
    text = (ROOT / name).read_text()
    used = set(re.findall(r"^(?:.*/)?lobewise (\w+)", text, flags=re.M)) | set(re.findall(r"`lobewise (\w+)", text))
    assert used
    assert used <= verbs


def test_pictures_and_links_exist() -> None:
    for path in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text()):
            assert (path.parent / target).exists(), f"{path.name} points to {target}"


@pytest.mark.parametrize("name", load_publisher().PAGES)
def test_figures_are_those_of_the_results(name: str) -> None:
    text = load_publisher().fill_page(name)
    assert (ROOT / name).read_text() == text, f"{name} is out of date: run python -m benchmarks.publish"


def test_every_page_with_marks_is_filled() -> None:
    marked = {str(path.relative_to(ROOT)) for path in PAGES if re.search("^<!-- figures:", path.read_text(), re.M)}
    assert marked == set(load_publisher().PAGES)


@pytest.mark.parametrize("figures", [{}, {"times": "1", "errors": "2"}])
def test_places_and_figures_must_agree(figures: dict[str, str]) -> None:
    from benchmarks.pages.marks import fill_places

    page = "before\n<!-- figures:times -->\n<!-- figures:end -->\nafter\n"
    filled = fill_places(page, {"times": "| 3 |"})
    assert filled == "before\n<!-- figures:times -->\n\n| 3 |\n\n<!-- figures:end -->\nafter\n"
    assert fill_places(filled, {"times": "| 3 |"}) == filled
    with pytest.raises(ValueError, match="times"):
        fill_places(page, figures)


def test_performance_page_names_every_device() -> None:
    from lobewise.backend.devices import DEVICES

    text = (ROOT / "docs" / "developers" / "performance.md").read_text()
    for name in DEVICES:
        assert f"`{name}`" in text


def test_default_similarity_is_the_winner_of_the_comparison() -> None:
    from lobewise.denoising.automatic import DEFAULT_SIMILARITY

    similarities = json.loads((ROOT / "benchmarks" / "results" / "similarities.json").read_text())
    logs = dict.fromkeys(("sg", "sg_mixture", "asg", "ggx"), 0.0)
    for by_spp in similarities["scenes"].values():
        for row in by_spp.values():
            for name in logs:
                logs[name] += float(np.log(row[name]["rel_mse"]))
    assert min(logs, key=lambda name: logs[name]) == DEFAULT_SIMILARITY
