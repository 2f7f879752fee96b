"""The documentation is true: its code runs, its commands exist, its figures come from the committed JSON files."""

import json
import re
import shlex
import shutil
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import lobewise
from tests.streaming.frames import make_scene

ROOT = Path(__file__).parents[1]
BUNDLED = ROOT / "src" / "lobewise" / "data" / "demo.exr"


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
USER_PAGES = [*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))]
"""What a user reads. Everything else is in docs/developers and docs/api."""
MAX_USER_PAGES = 25
MAX_USER_WORDS = 25000
MAX_README_LINES = 90


def load_publisher() -> ModuleType:
    """Return benchmarks/publish.py as a module."""
    return import_module("benchmarks.publish")


def list_blocks(page: Path) -> list[str]:
    """Return the blocks of Python of a page."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.S)


def run_blocks(name: str, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """Run the Python blocks of a page of docs one after the other; return the names that they define."""
    names = {} if names is None else names
    for block in list_blocks(ROOT / "docs" / name):
        exec(compile(block, name, "exec"), names)
    return names


def test_readme_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(BUNDLED, tmp_path / "frame.exr")
    monkeypatch.chdir(tmp_path)
    blocks = list_blocks(ROOT / "README.md")
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
    run_blocks("blender.md")
    before, after = lobewise.read_frame("shot.exr"), lobewise.read_frame("clean.exr")
    assert not np.array_equal(after.radiance.color, before.radiance.color)
    assert [len(layer.parts) for layer in after.layers] == [len(layer.parts) for layer in before.layers] != []


def test_blender_page_has_options_that_exist() -> None:
    from typer.main import get_command

    from lobewise.cli.commands import app

    denoise = get_command(app).commands["denoise"]  # type: ignore[attr-defined]
    known = {name for each in denoise.params for name in (*each.opts, *each.secondary_opts)}
    alone = set(re.findall(r"`(--[a-z-]+)", BLENDER_PAGE.read_text()))
    assert alone
    assert alone <= known


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
    names = run_blocks("developers/upsampling.md", names)
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
    names = run_blocks("mitsuba.md")
    assert np.array(names["denoised"]).shape == names["previous"].shape == (256, 256, 3)
    assert np.isfinite(np.array(names["dr"].grad(names["noisy"]))).all()


@pytest.mark.mitsuba
@pytest.mark.nightly
def test_interactive_page_runs(mi: Any) -> None:
    names = run_blocks("developers/interactive.md")
    assert [image.shape for image in names["images"]] == [(128, 128, 3)] * 3


def test_users_read_a_short_book() -> None:
    assert len(USER_PAGES) <= MAX_USER_PAGES
    assert sum(len(path.read_text().split()) for path in USER_PAGES) <= MAX_USER_WORDS
    assert len((ROOT / "README.md").read_text().splitlines()) <= MAX_README_LINES


def list_commands(page: str) -> list[list[str]]:
    """Return the words of every command `lobewise` in the blocks of a page."""
    blocks = re.findall(r"^```(\S*)\n(.*?)^```", page, flags=re.S | re.M)
    text = "".join(block for language, block in blocks if language in ("", "sh", "bash"))
    lines = (line.partition(" # ")[0] for line in text.replace("\\\n", " ").splitlines())
    found = (re.search(r"(?:^|&& )(?:\S*/)?lobewise ([^<>]*)", line) for line in lines)
    return [shlex.split(one[1], comments=True) for one in found if one]


@pytest.mark.parametrize(
    "path", [ROOT / "README.md", *(path for path in USER_PAGES if path.suffix == ".md")], ids=lambda path: path.stem
)
def test_commands_and_their_options_exist(path: Path) -> None:
    from typer.main import get_command

    from lobewise.cli.commands import app

    verbs = get_command(app).commands  # type: ignore[attr-defined]
    text = path.read_text()
    assert set(re.findall(r"`lobewise ([a-z]\w+)", text)) <= set(verbs)
    for words in list_commands(text):
        if words == ["--install-completion"]:
            continue
        command = verbs[words[0]]
        if words[1:] and words[1] in getattr(command, "commands", {}):
            command = command.commands[words[1]]
        known = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
        assert {word for word in words if word.startswith("--")} <= known, words


@pytest.mark.nightly
def test_commands_of_troubleshooting_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import OpenEXR

    from lobewise.cli.program import run

    shots = ROOT / "tests" / "data" / "foreign"
    for name in ("shot.exr", "shot.0001.exr", "panorama.exr"):
        shutil.copy(shots / "blender_4.5_seed1.exr", tmp_path / name)
    for name in ("second.exr", "shot.0002.exr"):
        shutil.copy(shots / "blender_4.5_seed2.exr", tmp_path / name)
    noisy = np.random.default_rng(1).gamma(2.0, 0.25, (32, 40, 3)).astype(np.float32)
    normal = np.broadcast_to(np.float32([0.5, 0.5, 1.0]), noisy.shape)
    planes = {f"N.{name}": np.ascontiguousarray(normal[..., k]) for k, name in enumerate("XYZ")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": noisy, **planes}).write(str(tmp_path / "frame.exr"))
    monkeypatch.chdir(tmp_path)
    for words in list_commands((ROOT / "docs" / "troubleshooting.md").read_text()):
        # A page for browsers waits for Ctrl-C; views need the configuration of Blender.
        if words[0] != "view" and "--view" not in words:
            assert run(words) == 0, words


def test_commands_of_pages_are_found() -> None:
    page = "text\n```sh\nlobewise a 'b.##.exr' --c 1  # d\n. x && .venv/bin/lobewise demo \\\n  --e\n```\n"
    assert list_commands(page) == [["a", "b.##.exr", "--c", "1"], ["demo", "--e"]]


def test_other_pages_of_users_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("frame.exr", "shot.0001.exr", "shot.0002.exr"):
        lobewise.write_frame(tmp_path / name, make_scene((64, 96)))
    monkeypatch.chdir(tmp_path)
    run_blocks("serving.md")
    run_blocks("sequences.md")
    assert lobewise.read_frame("clean.exr").shape == lobewise.read_frame("clean.0001.exr").shape


def test_renderers_page_runs(field_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(field_folder / "blender_stereo.exr", tmp_path / "stereo.exr")
    monkeypatch.chdir(tmp_path)
    run_blocks("renderers.md")
    for view in ("left", "right"):
        before, after = (lobewise.read_frame(name, view=view) for name in ("stereo.exr", "clean.exr"))
        assert not np.array_equal(after.radiance.color, before.radiance.color)


def test_every_page_of_users_with_python_is_run() -> None:
    """The tests of this file, of the viewer and of bands run these pages."""
    named = {path.name for path in USER_PAGES if path.suffix == ".md" and "```python" in path.read_text()}
    run = {"blender.md", "serving.md", "sequences.md", "upsampling.md", "mitsuba.md", "viewer.md"}
    run |= {"streaming.md", "renderers.md"}
    assert named - run == {"farm.md"}  # its programs ask SLURM and Kubernetes for machines


def test_every_capability_names_tests_that_exist() -> None:
    page = (ROOT / "docs" / "developers" / "capabilities.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| ")][2:]
    assert len(rows) > 50
    texts: dict[str, list[str]] = {}
    for path in (ROOT / "tests").rglob("*.py"):
        texts.setdefault(path.name, []).append(path.read_text())
    for row in rows:
        *_, told, _ = row.split(" |")
        named = re.findall(r"`(\w+\.py)::(test_\w+)`", told)
        assert len(named) == told.count("`") / 2 > 0, row
        for file, name in named:
            pattern = rf"^ *def {name}\("
            held = [text for text in texts.get(file, []) if re.search(pattern, text, flags=re.M)]
            assert len(held) == 1, f"{file}::{name}"


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
    from lobewise.settings.choices import DEFAULT_SIMILARITY

    similarities = json.loads((ROOT / "benchmarks" / "results" / "similarities.json").read_text())
    logs = dict.fromkeys(("sg", "sg_mixture", "asg", "ggx"), 0.0)
    for by_spp in similarities["scenes"].values():
        for row in by_spp.values():
            for name in logs:
                logs[name] += float(np.log(row[name]["rel_mse"]))
    assert min(logs, key=lambda name: logs[name]) == DEFAULT_SIMILARITY
