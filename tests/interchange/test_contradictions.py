"""What `inspect` and `denoise` say of a file is true together: nothing is told to be missing or unused that is used."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from renderers import WRITERS, Written, make_scene, write

from lobewise.cli.program import run
from lobewise.denoising.automatic import ask, resolve_all
from lobewise.denoising.inputs import list_unused
from lobewise.denoising.plan import foretell_method
from lobewise.errors import LobewiseError
from lobewise.interchange import describe_file, import_file
from lobewise.settings import DenoiseSettings

DATA = Path(__file__).parents[1] / "data" / "foreign"
LEFT_OUT = ("", "position")
"""Words of channels' names without which the frames of every renderer are written as well."""
IMAGES = {
    "normal": {"normal"},
    "roughness": {"alpha_u"},
    "camera": {"depth"},
    "layers": {"radiance.diffuse", "radiance.specular"},
    "albedo": {"diffuse_albedo"},
    "silhouettes": {"coverage"},
    "halves": {"half_a", "half_b"},
}
"""What of a frame denoising cannot do without, where it is said to use something."""
ABSENT = {
    "normal": r"No normal:|no normal,|no normals",
    "roughness": r"No roughness:",
    "camera": r"No camera:|No positions:|no normal, position",
    "layers": r"No layers:|not told apart",
    "albedo": r"No albedo:",
}
"""Sentences by which something is missing."""
PAIRS = (
    (r"The camera (is that|was found)", r"No camera:|camera that nothing tells|no camera tells"),
    (r"Nothing tells surfaces apart but the image", r"comparing (which way|what)|Denoise with (albedo and )?normal"),
    (r"(\w+) stays? as (it is|they are)", r"Left noisy, as the result has no part for them: .*(Emi|Env|emis)"),
    (r"told by Cryptomatte|told by [\w.]*A;", r"Not used with these settings: [^\n]*coverage"),
    (r"with albedo", r"No albedo:|surface colors: textures"),
)
"""Sentences that cannot both be true."""


def write_samples(folder: Path, left_out: str) -> Iterator[Path]:
    """Yield written files of every renderer, without the channels whose names contain a word."""
    for renderer, writer in WRITERS.items():
        written = writer(make_scene())
        kept = {name: plane for name, plane in written.channels.items() if not left_out or left_out not in name.lower()}
        path = folder / f"{renderer}.exr"
        write(path, Written(written.preset, kept, written.attributes))
        yield path


def check_words(path: Path, capsys: pytest.CaptureFixture[str], folder: Path) -> bool:
    """Assert that nothing that is said of a file contradicts the rest; return whether it could be read."""
    try:
        found = import_file(path, light_passes=True)
        described = describe_file(path)
    except LobewiseError:
        return False
    uses = set(described.uses)
    assert not uses & {lack.role for lack in described.lacks}, path.name
    settings = ask(DenoiseSettings(), {"device": "cpu"})
    unused = set(list_unused(found.frame, resolve_all(found.frame, settings)))
    for use in uses:
        assert not IMAGES[use] & unused, f"{path.name}: {use} is used, and not used"
    capsys.readouterr()
    assert run(["inspect", "--all", str(path)]) == 0
    assert run(["denoise", str(path), "-o", str(folder / "clean.exr"), "--quality", "fast", "--radius", "1"]) == 0
    parts = capsys.readouterr()
    # What is said of the default's unused images is asked above: the quality fast uses less.
    words = " ".join([*parts.out.split(), *re.sub(r"Not used with these settings: .*", "", parts.err).split()])
    words += f" Not used with these settings: {', '.join(unused)}\n {foretell_method(found.frame, DenoiseSettings())}"
    for use, sentence in ABSENT.items():
        if use in uses:
            assert not re.search(sentence, words), f"{path.name}: {use} is used, and missing"
    for one, other in PAIRS:
        both = re.search(one, words), re.search(other, words)
        assert not all(both), f"{path.name}: {both}"
    return True


@pytest.mark.nightly
def test_nothing_that_is_said_contradicts_the_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = sorted(DATA.rglob("*.exr"))
    assert paths
    assert [path.name for path in paths if not check_words(path, capsys, tmp_path)] == []


@pytest.mark.nightly
@pytest.mark.parametrize("left_out", LEFT_OUT)
def test_nor_of_written_files(left_out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unread = [path.name for path in write_samples(tmp_path, left_out) if not check_words(path, capsys, tmp_path)]
    assert unread == []


@pytest.mark.nightly
@pytest.mark.real_exr
def test_nor_of_files_from_elsewhere(exr_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sum(check_words(path, capsys, tmp_path) for path in sorted(exr_folder.glob("*.exr"))) > 6
