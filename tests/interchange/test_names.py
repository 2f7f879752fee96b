"""Names that many programs use: alone they neither tell who wrote a file, nor keep an image from being found."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import WRITERS, Written, make_scene, name, write

from lobewise.errors import MissingChannelError
from lobewise.interchange import import_file
from lobewise.interchange.reading import list_selections
from lobewise.interchange.selections import Selection
from lobewise.io import write_frame
from lobewise.records.frame import Frame

SCENE = make_scene()
ALBEDO = SCENE.diffuse_albedo + SCENE.specular_albedo


def list_images(frame: Frame) -> dict[str, np.ndarray]:
    return {word: getattr(one, word) for one in (frame.radiance, frame.gbuffer) for word in one.names}


def test_own_words_of_lobewise_are_plain_ones_elsewhere(tmp_path: Path) -> None:
    """The same frame by plain names and by those of Mitsuba gives the same bits."""
    plain = name("", SCENE.color) | name("normal", SCENE.normal, "XYZ") | name("depth", SCENE.depth, "Z")
    plain |= name("position", SCENE.position, "XYZ") | name("albedo", ALBEDO)
    write(tmp_path / "plain.exr", Written("", plain, {}, ()))
    write(tmp_path / "mitsuba.exr", WRITERS["mitsuba"](SCENE))
    first, second = (import_file(tmp_path / f"{each}.exr") for each in ("plain", "mitsuba"))
    assert (first.preset, second.preset) == ("generic", "mitsuba")
    images, others = list_images(first.frame), list_images(second.frame)
    assert images.keys() == others.keys()
    assert "denoiser_albedo" in images
    for word, image in images.items():
        np.testing.assert_array_equal(image, others[word], err_msg=word)


def test_a_file_of_lobewise_is_known_by_its_attribute(full_frame: Frame, tmp_path: Path) -> None:
    write_frame(tmp_path / "a.exr", full_frame)
    assert import_file(tmp_path / "a.exr").map.is_own


def test_stereo_of_nuke_with_a_depth(tmp_path: Path) -> None:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    parts = [
        OpenEXR.Part({**header, "view": eye}, dict(planes), f"{layer}.{eye}")
        for eye in ("left", "right")
        for layer, planes in (("rgba", name("", SCENE.color)), ("depth", {"depth.Z": SCENE.depth}))
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert list_selections(tmp_path / "a.exr") == (Selection("left"), Selection("right"))


def rename(written: Written, old: str, new: str) -> Written:
    written.channels = {key.replace(old, new, 1): plane for key, plane in written.channels.items()}
    return written


@pytest.mark.parametrize("picture", ["Image", "rgba", "beauty"])
def test_a_picture_by_a_usual_name_beside_an_attribute(picture: str, tmp_path: Path) -> None:
    written = rename(WRITERS["cycles"](SCENE), ".Combined", f".{picture}")
    write(tmp_path / "a.exr", written)
    imported = import_file(tmp_path / "a.exr", light_passes=True)
    assert imported.preset == "cycles"
    assert imported.outputs["color"].target.source.path == f"View Layer.001.{picture}"
    assert [layer.name for layer in imported.frame.layers][:2] == ["diffuse", "glossy"]


def test_the_passes_that_could_be_the_picture_are_listed(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", rename(WRITERS["cycles"](SCENE), ".Combined", ".mine"))
    with pytest.raises(
        MissingChannelError, match=r"got only the passes .*Emit, .*GlossInd, [^,]*\.mine; .*--map color=PASS"
    ):
        import_file(tmp_path / "a.exr")
    assert import_file(tmp_path / "a.exr", mapping={"color": "mine"}).frame.layers


def test_light_by_names_of_ones_own_is_named_as_noisy(tmp_path: Path) -> None:
    written = rename(rename(WRITERS["cycles"](SCENE), ".Combined", ".rgba"), ".DiffDir", ".direct")
    write(tmp_path / "a.exr", written)
    (line,) = import_file(tmp_path / "a.exr", light_passes=True).frame.notes
    assert line == "Left noisy: pass of light 'DiffInd', pass 'direct' (--also NAME denoises one)."
