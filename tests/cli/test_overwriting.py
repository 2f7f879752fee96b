"""No command replaces a file that it reads, unless it is told to; any other file it may replace."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.io import read_frame, write_frame, write_sparse_frame
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import SparseFrame
from tests.cli.lines import fail

SIZE = 12, 16
FOREIGN = Path(__file__).parents[1] / "data" / "foreign"


def make_frame(rng: np.random.Generator) -> Frame:
    """Return a noisy wall."""
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (*SIZE, 3))
    return Frame(Radiance(rng.gamma(1.0, 1.0, (*SIZE, 3)).astype(np.float32)), GBuffer(normal=normal), spp=4)


@pytest.fixture
def noisy(rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a noisy file in the working folder."""
    monkeypatch.chdir(tmp_path)
    path = Path("noisy.exr")
    write_frame(path, make_frame(rng))
    return path


@pytest.mark.parametrize("name", ["noisy.exr", "./noisy.exr", "link.exr", "hard.exr", "{folder}/noisy.exr"])
@pytest.mark.parametrize("bands", ["auto", "4"])
def test_the_noisy_file_is_not_replaced_by_any_name(
    name: str, bands: str, noisy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = noisy.read_bytes()
    Path("link.exr").symlink_to(noisy)
    if name == "hard.exr":
        os.link(noisy, name)
    line = ["denoise", "noisy.exr", "-o", name.format(folder=tmp_path), "--bands", bands, "--quality", "fast"]
    assert fail(capsys, *line).what.endswith(f"output {name.removeprefix('./').format(folder=tmp_path)!r}")
    assert noisy.read_bytes() == before
    # Replacing a hard link replaces only its name. The warning of it is an error in tests.
    if name != "hard.exr":
        assert run([*line, "--overwrite"]) == 0
        assert noisy.read_bytes() != before


def test_any_other_file_is_replaced_as_it_was(noisy: Path) -> None:
    Path("clean.exr").write_text("an earlier result")
    assert run(["denoise", "noisy.exr", "-o", "clean.exr"]) == 0
    assert read_frame("clean.exr").shape == SIZE


def test_a_sparse_frame_is_not_replaced(noisy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    full = read_frame(noisy)
    shaded = Radiance(full.radiance.color[::2, ::2])
    write_sparse_frame("sparse.exr", SparseFrame(shaded, full.gbuffer, scale=2, place=(0, 0)))
    fail(capsys, "upsample", "sparse.exr", "-o", "./sparse.exr", what="output 'sparse.exr'")
    assert run(["upsample", "sparse.exr", "-o", "./sparse.exr", "--overwrite"]) == 0


def test_what_is_read_besides_is_not_replaced(
    noisy: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    write_frame("second.exr", make_frame(rng))
    Path("camera.json").write_text('{"position": [0, 0, 0], "forward": [0, 0, -1], "up": [0, 1, 0], "fov_y": 1}')
    Path("camera.exr").symlink_to("camera.json")
    for words in (["--half", "second.exr", "-o", "second.exr"], ["--camera", "camera.json", "-o", "camera.exr"]):
        fail(capsys, "denoise", "noisy.exr", *words, what=f"--output {words[-1]!r}")


def test_a_pass_in_a_file_of_its_own_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "luxcore"
    shutil.copytree(FOREIGN / "luxcore", folder)
    fail(capsys, "denoise", folder / "RGB.exr", "-o", folder / "ALBEDO.exr", what="--output 'ALBEDO.exr'")
    assert run(["denoise", str(folder / "RGB.exr"), "-o", str(folder / "OTHER.exr"), "--quality", "fast"]) == 0


@pytest.mark.parametrize("output", ["in.%04d.exr", "linked.####.exr", "hard.####.exr", "in.####.exr"])
def test_a_sequence_replaces_none_of_its_frames(
    output: str, noisy: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (1, 2):
        write_frame(f"in.000{number}.exr", make_frame(rng))
    # Frame 1 would replace what frame 2 is read from.
    Path("linked.0001.exr").symlink_to("in.0002.exr")
    os.link("in.0002.exr", "hard.0001.exr")
    first = f"output '{output.partition('.')[0]}.0001.exr'"
    fail(capsys, "denoise", "in.####.exr", "-o", output, what=first)
    fail(capsys, "denoise", "in.####.exr", "-o", output, "--overwrite", what="--overwrite")
    fail(capsys, "denoise", "in.####.exr", "--half", "in.####.exr", "-o", output, what=first)
    assert run(["denoise", "in.####.exr", "-o", "out.####.exr", "--quality", "fast"]) == 0


def test_figures_replace_no_image(noisy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_frame("in.0001.exr", read_frame(noisy))
    fail(capsys, "compare", "noisy.exr", "-r", "noisy.exr", "--json", "./noisy.exr", what="output 'noisy.exr'")
    words = ["-r", "in.####.exr", "--json", "in.0001.exr"]
    fail(capsys, "compare", "in.####.exr", *words, what="--json 'in.0001.exr'")


def test_a_render_and_a_fit_replace_nothing_that_they_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("matplotlib")
    scene, link = tmp_path / "scene.xml", tmp_path / "scene.exr"
    scene.write_text('<scene version="3.0.0"/>')
    link.symlink_to(scene)
    fail(capsys, "render", scene, "-o", link, what="--output 'scene.exr'")
    fail(capsys, "render", scene, "-o", link, "--scale", "2", what="--output 'scene.exr'")
    fail(capsys, "render", scene, "-o", link, "--frames", "1", what="--output 'scene.exr'")
    fail(capsys, "bench", "interactive", scene, "-o", scene, what="--output 'scene.xml'")
    fail(capsys, "fit", scene, "-o", scene, "--no-plot", what="--output 'scene.xml'")
    fail(
        capsys,
        "fit",
        "--mitsuba",
        f"{scene}#wall",
        "-o",
        tmp_path / "a.lobes",
        "--plot",
        scene,
        what="output 'scene.xml'",
    )
    assert scene.read_text() == '<scene version="3.0.0"/>'


def test_a_picture_replaces_nothing_that_is_read(
    noisy: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    what = "picture 'b.png'"
    shutil.copy(noisy, "b.png")
    for more in ([], ["--overwrite"]):
        fail(capsys, "denoise", "b.png", "-o", "b.exr", "--png", *more, what=what)
        fail(capsys, "denoise", "noisy.exr", "--half", "b.png", "-o", "b.exr", "--png", *more, what=what)
        fail(capsys, "upsample", "b.png", "-o", "b.exr", "--scale", "2", "--png", *more, what=what)
    for number in (1, 2):
        write_frame(f"in.000{number}.exr", make_frame(rng))
        write_frame(f"b.000{number}.png", make_frame(rng))
    line = ["denoise", "in.####.exr", "--half", "b.####.png", "-o", "b.####.exr", "--png"]
    fail(capsys, *line, what="picture 'b.0001.png'")
    assert not list(Path().glob("b*.exr"))


def test_the_picture_of_a_render_replaces_no_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mitsuba")
    scene, output = tmp_path / "scene.xml", tmp_path / "out.exr"
    scene.write_text('<scene version="3.0.0"/>')
    (tmp_path / "out.png").symlink_to(scene)
    (tmp_path / "out.0001.png").symlink_to(scene)
    for what, words in (
        ("picture 'out.png'", ["-o", output]),
        ("picture 'out.0001.png'", ["-o", tmp_path / "out.####.exr", "--frames", "2"]),
    ):
        fail(capsys, "render", scene, "--png", *words, what=what)
