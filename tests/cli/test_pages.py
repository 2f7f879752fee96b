"""`inspect --html` and `compare --html`: pages that hold every picture, and refusals."""

import re
from pathlib import Path

import numpy as np

import lobewise
from lobewise.cli.program import run as run_program
from lobewise.interchange import describe_file
from lobewise.io import write_image
from tests.streaming.frames import make_scene

BLENDER = Path(__file__).parents[1] / "data" / "foreign" / "blender_4.5_seed1.exr"


def run(*words: object) -> int:
    """Return the exit code of a command line."""
    return run_program([str(word) for word in words])


def list_figures(page: Path) -> dict[str, str]:
    """Return the captions of a page by the names of their images."""
    found = re.findall(
        r'<figure><img alt="([^"]+)" src="data:image/png;base64,[^"]+"><figcaption>(.*?)</figc', page.read_text()
    )
    return dict(found)


def test_inspect_shows_every_image_of_a_renderers_file(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert run("inspect", BLENDER, "--html", page) == 0
    frame = lobewise.read_frame(BLENDER)
    figures = list_figures(page)
    assert set(frame.gbuffer.names) <= set(figures)
    assert {"image", "diffuse", "specular"} <= set(figures)
    assert "Normal.X/Y/Z" in figures["normal"]
    assert figures["normal"].count("from") >= 1
    channels = {channel for part in describe_file(BLENDER).parts for channel in (c.name for c in part.channels)}
    assert channels <= set(re.findall(r"<td>([^<]*)</td>", page.read_text()))
    assert not re.search(r'(src|href)="(?!data:)', page.read_text())


def test_inspect_shows_a_file_of_lobewise(tmp_path: Path) -> None:
    page, source = tmp_path / "page.html", tmp_path / "frame.exr"
    frame = make_scene((12, 16))
    lobewise.write_frame(source, frame)
    assert run("inspect", source, "--html", page) == 0
    assert set(frame.gbuffer.names) <= set(list_figures(page))


def test_compare_writes_a_page(tmp_path: Path) -> None:
    image = np.full((8, 9, 3), 0.5, np.float32)
    for name, factor in (("a", 1.5), ("b", 1.1), ("c", 1.0)):
        write_image(tmp_path / f"{name}.exr", image * factor)
    page = tmp_path / "page.html"
    assert run("compare", tmp_path / "a.exr", tmp_path / "b.exr", "-r", tmp_path / "c.exr", "--html", page) == 0
    text = page.read_text()
    assert all(f"{name}.exr" in text for name in "abc")
    assert "c.exr (reference)" in text
    assert not re.search(r'(src|href)="(?!data:)', text)
