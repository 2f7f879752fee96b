"""Empty guides are left out, encoded normals decoded, and guides that tell nothing named: of arrays as of files."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.errors import MissingChannelError, UnusedGuideWarning
from lobewise.guides.survey import GuideSurvey
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import Frame, GBuffer, Radiance, RadianceLayer
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

SHAPE = (40, 32)


@pytest.fixture(scope="module")
def scene() -> Frame:
    """Return a frame with every image that denoising looks at."""
    return make_scene(SHAPE)


def with_guides(frame: Frame, **guides: Any) -> Frame:
    """Return a frame with other guides."""
    return frame.with_changes(gbuffer=replace(frame.gbuffer, **guides))


def denoise_warned(frame: Frame, **changes: Any) -> tuple[lobewise.Result, list[str]]:
    """Return the result of a frame, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = lobewise.denoise(frame, quality="fast", **changes)
    assert all(one.category is UnusedGuideWarning and one.filename == __file__ for one in caught)
    return result, [str(one.message) for one in caught]


@pytest.mark.parametrize("name", ["normal", "depth", "position", "diffuse_albedo", "specular_albedo", "mean_normal"])
def test_an_empty_guide_is_named_and_left_out(name: str, scene: Frame) -> None:
    image = getattr(scene.gbuffer, name)
    shape = (*SHAPE, 3) if image is None else image.shape
    result, warned = denoise_warned(with_guides(scene, **{name: np.zeros(shape)}))
    told = f"{name} is 0 everywhere, so it is not used."
    assert warned == [told]
    assert told in result.notes
    without = lobewise.denoise(with_guides(scene, **{name: None}), quality="fast")
    np.testing.assert_array_equal(result.image, without.image)


def test_the_empty_albedo_of_a_layer_is_named(scene: Frame) -> None:
    diffuse, specular = scene.radiance.parts
    layers = (
        RadianceLayer("paint", "diffuse", diffuse, np.zeros_like(diffuse)),
        RadianceLayer("gloss", "glossy", specular),
    )
    result, warned = denoise_warned(scene.with_changes(layers=layers))
    assert warned == ["the albedo of the layer 'paint' is 0 everywhere, so it is not used."]
    plain = (RadianceLayer("paint", "diffuse", diffuse), layers[1])
    np.testing.assert_array_equal(
        result.image, lobewise.denoise(scene.with_changes(layers=plain), quality="fast").image
    )


def test_a_black_albedo_without_light_is_right(scene: Frame) -> None:
    radiance, black = scene.radiance, np.zeros((*SHAPE, 3))
    dark = replace(radiance, color=radiance.color - radiance.diffuse, diffuse=black)
    frame = with_guides(scene, diffuse_albedo=black, mean_diffuse_albedo=black).with_changes(
        radiance=dark, half_a=None, half_b=None
    )
    assert denoise_warned(frame)[1] == []
    # In light that is not split one of two albedos may be black.
    metals = with_guides(Frame(Radiance(radiance.color), scene.gbuffer, scene.camera), diffuse_albedo=black)
    assert denoise_warned(metals)[1] == []


def test_normals_of_one_value_are_named(scene: Frame) -> None:
    result, warned = denoise_warned(with_guides(scene, normal=np.broadcast_to([0.0, 0.6, 0.8], (*SHAPE, 3))))
    assert warned == []
    assert "normal has the same value everywhere, so it tells no surfaces apart." in result.notes


def test_encoded_normals_are_decoded(scene: Frame) -> None:
    normal = scene.gbuffer.normal
    there = (normal != 0.0).any(axis=-1, keepdims=True)
    result, warned = denoise_warned(with_guides(scene, normal=np.where(there, 0.5 * normal + 0.5, 0.0)))
    assert warned == []
    assert result.notes == ("normal is stored in [0, 1], so it was decoded to [-1, 1].",)
    np.testing.assert_allclose(result.image, lobewise.denoise(scene, quality="fast").image, rtol=2e-3, atol=1e-4)


def test_normals_that_all_face_one_way_are_not_taken_for_encoded(rng: np.random.Generator) -> None:
    normal = np.abs(rng.normal(size=(64, 64, 3)))
    survey = GuideSurvey()
    survey.look_at(
        Frame(Radiance(np.ones((64, 64, 3))), GBuffer(normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True)))
    )
    assert not survey.is_encoded


@pytest.mark.parametrize("spoil", ["depth", "diffuse_albedo", "encoded", "camera"])
def test_bands_give_the_same_bits_and_notes(spoil: str, scene: Frame, tmp_path: Path) -> None:
    normal = scene.gbuffer.normal
    if spoil == "camera":
        frame = scene.with_changes(camera=None)
    elif spoil == "encoded":
        frame = with_guides(
            scene, normal=np.where((normal != 0.0).any(axis=-1, keepdims=True), 0.5 * normal + 0.5, 0.0)
        )
    else:
        frame = with_guides(scene, **{spoil: np.zeros_like(getattr(scene.gbuffer, spoil))})
    write_frame(tmp_path / "a.exr", frame, half=False)
    whole, _ = denoise_warned(lobewise.read_frame(tmp_path / "a.exr"))
    done = denoise_file(tmp_path / "a.exr", tmp_path / "b.exr", rows=5, quality="fast")
    assert done.notes == whole.notes != ()
    assert done.unused == whole.unused
    np.testing.assert_array_equal(read_image(tmp_path / "b.exr"), whole.image)


def test_bands_need_normals(scene: Frame, tmp_path: Path) -> None:
    write_frame(tmp_path / "a.exr", with_guides(scene, normal=None), half=False)
    with refuses(MissingChannelError, "channel normal"):
        denoise_file(tmp_path / "a.exr", tmp_path / "b.exr", rows=5, quality="fast")


def test_what_waits_for_something_else_is_named(scene: Frame) -> None:
    alone = scene.with_changes(camera=None)
    result, warned = denoise_warned(alone)
    assert warned == [
        "position is given without a camera, so places are not compared.",
        "alpha_u is given without a camera, so normals are compared instead of reflection lobes.",
    ]
    assert set(warned) <= set(result.notes)
    # A depth without a camera still tells where there is no surface.
    result, told = denoise_warned(with_guides(alone, position=None), similarity="normal")
    assert (len(result.notes), told) == (1, [])
    # Whoever asks for normals misses no lobes.
    assert denoise_warned(alone, similarity="normal")[1] == warned[:1]
    assert denoise_warned(scene.with_changes(half_b=None))[1] == ["half_a is given without half_b, so it is not used."]
    light = Radiance(scene.radiance.color, diffuse=scene.radiance.diffuse)
    assert denoise_warned(scene.with_changes(radiance=light, half_a=None, half_b=None))[1] == [
        "radiance.diffuse is given without radiance.specular, so the light is filtered as a whole."
    ]


def test_the_command_line_tells_once(scene: Frame, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_frame(tmp_path / "a.exr", with_guides(scene, depth=np.zeros(SHAPE)).with_changes(camera=None), half=False)
    words = [str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]
    assert run(["denoise", *words]) == 0
    told = capsys.readouterr().err
    assert told.count("depth is 0 everywhere, so it is not used.") == 1
    assert told.count("position is given without a camera") == 1
    assert "UnusedGuideWarning" not in told
    assert run(["inspect", words[0]]) == 0
    assert "depth is 0 everywhere, so it is not used." in " ".join(capsys.readouterr().out.split())


NAMES = {
    "normal": ("N", "XYZ"),
    "position": ("P", "XYZ"),
    "albedo": ("albedo", "RGB"),
    "diffuse_albedo": ("DiffCol", "RGB"),
    "depth": ("Z", ""),
    "roughness": ("roughness", ""),
}
"""Names that files of unknown renderers have for passes, by role."""


def write_empty(path: Path, role: str) -> None:
    """Write a file of an unknown renderer with noise and a pass of zeros."""
    rng = np.random.default_rng(0)
    planes = {name: rng.random(SHAPE).astype(np.float32) for name in "RGB"}
    name, letters = NAMES[role]
    planes |= dict.fromkeys([f"{name}.{letter}" for letter in letters] or [name], np.zeros(SHAPE, np.float32))
    OpenEXR.File({}, planes).write(str(path))


@pytest.mark.parametrize("name", NAMES)
def test_an_empty_pass_of_a_file_is_named_and_not_advised(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.exr"
    write_empty(path, name)
    assert run(["inspect", str(path)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert f"is not used as {name}: it is 0 everywhere." in told
    found = lobewise.read_frame(path)
    assert found.gbuffer.names == ()


def test_colour_alone_is_denoised_as_the_file_is(rng: np.random.Generator, tmp_path: Path) -> None:
    color = rng.random((*SHAPE, 3)).astype(np.float32)
    # A lamp, which the filters must not spread.
    color[5:9, 5:12] = 60.0
    frame = Frame(Radiance(color))
    path = tmp_path / "a.exr"
    OpenEXR.File({}, {name: color[..., k].copy() for k, name in enumerate("RGB")}).write(str(path))
    for quality in ("fast", "auto"):
        result = lobewise.denoise(frame, quality=quality)  # type: ignore[arg-type]
        from_file = lobewise.denoise(lobewise.read_frame(path), quality=quality)  # type: ignore[arg-type]
        np.testing.assert_array_equal(result.image, from_file.image)
        assert result.notes[0].startswith("Nothing tells surfaces apart but the image itself")
        assert "28 pixels show lamps" in result.notes[1]


def test_roughness_without_places_stops_no_quality(scene: Frame) -> None:
    guides = GBuffer(normal=scene.gbuffer.normal, alpha_u=scene.gbuffer.alpha_u)
    with pytest.warns(UnusedGuideWarning, match="alpha_u is given without position or depth, so normals are compared"):
        result = lobewise.denoise(Frame(scene.radiance, guides, scene.camera), quality="high", radius=2)
    assert result.settings["similarity"] == "normal"


@pytest.mark.parametrize("placed_by", ["position", "depth"])
def test_places_give_the_normals_that_are_missing(placed_by: str, scene: Frame) -> None:
    other = {"position": "depth", "depth": "position"}[placed_by]
    bare = with_guides(scene, normal=None, **{other: None})
    result = lobewise.denoise(bare, quality="fast")
    assert result.notes == ("There are no normals; those of the surfaces through the positions stand for them.",)
    assert result.settings["similarity"] == "ggx"
