"""Small files of users that once came out wrong: the default command does right with each."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from lobewise.cli.program import run
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import decode_part
from lobewise.metrics import rel_mse

pytestmark = pytest.mark.real_exr
Planes = dict[str, np.ndarray]


def denoise(source: Path, output: Path, *words: str) -> Planes:
    """Run the command on a file of one part, and return the planes that it writes."""
    assert run(["denoise", str(source), "-o", str(output), *words]) == 0
    return read(output)


def read(path: Path) -> Planes:
    container = read_container(path)
    (part,) = container.parts
    return {name: plane.astype("f4") for name, plane in decode_part(container, part).items()}


def list_changed(before: Planes, after: Planes) -> set[str]:
    """Return the passes of which a channel has changed."""
    assert before.keys() == after.keys()
    changed = {name for name, plane in before.items() if plane.tobytes() != after[name].tobytes()}
    return {name.rpartition(".")[0].removeprefix("ViewLayer.") for name in changed}


def test_plain_names_are_not_those_of_lobewise_alone(
    field_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = field_folder / "plain_names.exr"
    after = denoise(source, tmp_path / "a.exr")
    assert "only copied" not in capsys.readouterr().err
    asked = denoise(source, tmp_path / "b.exr", "--preset", "generic")
    without = denoise(field_folder / "offsets_missing.exr", tmp_path / "c.exr")
    for other in (asked, without):
        assert all(plane.tobytes() == other[name].tobytes() for name, plane in after.items())


def test_the_file_output_node_of_blender(field_folder: Path, tmp_path: Path) -> None:
    source = field_folder / "file_output_node.exr"
    changed = list_changed(read(source), denoise(source, tmp_path / "a.exr"))
    assert changed == {"Image", "DiffDir", "DiffInd", "GlossDir", "GlossInd"}


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("noisy_ao", "Left noisy: passes 'AO', 'soft_ao' (--also NAME denoises one)."),
        ("volume_emission", "Left noisy: passes of light 'Emit', 'Env'."),
    ],
)
def test_noisy_passes_that_stay_are_named(
    name: str, told: str, field_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = field_folder / f"{name}.exr"
    changed = list_changed(read(source), denoise(source, tmp_path / "a.exr"))
    assert told in " ".join(capsys.readouterr().err.split())
    assert "Combined" in changed
    assert not changed.intersection({"AO", "soft_ao"})


def test_the_picture_of_a_file_of_acescg(field_folder: Path, tmp_path: Path) -> None:
    """It is that of the same file whose primaries stand as numbers."""
    source, numbers = field_folder / "acescg_interop_id.exr", tmp_path / "numbers.exr"
    with OpenEXR.File(str(source), separate_channels=True) as file:
        header = {key: value for key, value in file.header().items() if key not in ("channels", "colorInteropID")}
        planes = {name: np.ascontiguousarray(channel.pixels) for name, channel in file.channels().items()}
    header["chromaticities"] = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    OpenEXR.File(header, planes).write(str(numbers))
    denoise(source, tmp_path / "a.exr", "--png")
    denoise(numbers, tmp_path / "b.exr", "--png")
    pictures = [np.asarray(Image.open(tmp_path / f"{each}.png")) for each in "ab"]
    np.testing.assert_array_equal(*pictures)


def test_a_pass_keeps_no_share_of_the_highlight_of_another(field_folder: Path, tmp_path: Path) -> None:
    source, place = field_folder / "passes_leak.exr", (17, 39)
    before, after = read(source), denoise(source, tmp_path / "a.exr")
    for letter in "RGB":
        name = f"ViewLayer.GlossInd.{letter}"
        assert before[name][place] == 0.0
        # It was 32.5, the highlight of GlossDir.
        assert after[name][place] < 0.01


def test_negative_channels_of_another_gamut_are_light(
    field_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, reference = field_folder / "gamut_negative.exr", np.load(field_folder / "gamut_negative_ref.npy")
    before, after = read(source), denoise(source, tmp_path / "a.exr")
    assert "bad pixel" not in capsys.readouterr().err
    noisy, clean = (np.stack([planes[letter] for letter in "RGB"], axis=-1) for planes in (before, after))
    assert (noisy < 0.0).any(axis=-1).mean() > 0.2
    reference = reference.astype(np.float32)
    assert rel_mse(clean, reference) < 0.2 * rel_mse(noisy, reference)


def test_both_eyes_of_blender(field_folder: Path, tmp_path: Path) -> None:
    source = field_folder / "blender_stereo.exr"
    changed = list_changed(read(source), denoise(source, tmp_path / "a.exr"))
    assert {f"{head}.{eye}" for head in ("Combined", "DiffDir", "DiffInd") for eye in ("left", "right")} == changed
