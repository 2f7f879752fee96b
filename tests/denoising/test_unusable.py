"""Guides that no surface can have and radiance that is no number do no harm; what is not used is named."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.denoising.bad_pixels import fill_holes, mark_good
from lobewise.errors import InputError
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import Frame, GBuffer, Radiance, RadianceLayer
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

QUALITIES = ("fast", "balanced", "high")
SHAPE = (24, 32)
ALBEDOS = ("diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo")


@pytest.fixture(scope="module")
def scene() -> Frame:
    """Return a frame with every image that denoising looks at."""
    return make_scene(SHAPE)


@pytest.fixture(scope="module")
def spots() -> np.ndarray:
    """Return one pixel of twenty."""
    return np.random.default_rng(0).random(SHAPE) < 0.05


def spoil(frame: Frame, name: str, value: float, spots: np.ndarray) -> Frame:
    """Return a frame one of whose guides has another value in some pixels."""
    image = getattr(frame.gbuffer, name).copy()
    image[spots] = value
    return frame.with_changes(gbuffer=replace(frame.gbuffer, **{name: image}))


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("value", [10.0, 50.0, 1e30, np.inf])
def test_no_albedo_makes_bright_pixels(quality: str, value: float, scene: Frame, spots: np.ndarray) -> None:
    honest = lobewise.denoise(scene, quality=quality)
    assert honest.notes == ()
    for name in ALBEDOS:
        result = lobewise.denoise(spoil(scene, name, value, spots), quality=quality)
        assert np.isfinite(result.image).all()
        assert result.image.max() < 2.5 * honest.image.max(), name
        assert result.notes == (f"{name} is above 1 at {spots.sum()} pixels: it counts as 1 there.",)


BAD = (np.nan, np.inf, -np.inf, -1.0)


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("value", BAD)
def test_one_channel_makes_a_pixel_bad(value: float, channel: int) -> None:
    image = np.ones((4, 5, 3), np.float32)
    image[2, 3, channel] = value
    assert np.argwhere(~mark_good(image)).tolist() == [[2, 3]]


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("quality", ["fast", "balanced", "high", "auto"])
def test_one_channel_that_is_no_number_does_not_reach_the_image(
    quality: str, channel: int, scene: Frame, spots: np.ndarray
) -> None:
    images = {name: getattr(scene.radiance, name).copy() for name in ("color", "diffuse", "specular")}
    for image in images.values():
        image[spots, channel] = np.nan
    result = lobewise.denoise(scene.with_changes(radiance=replace(scene.radiance, **images)), quality=quality)
    assert np.isfinite(result.image).all()


def test_holes_without_neighbours_take_the_mean_of_the_good_pixels(scene: Frame, spots: np.ndarray) -> None:
    color = scene.radiance.color.copy()
    color[spots, 1] = np.nan
    frame = Frame(Radiance(color))
    filled = fill_holes(np.zeros_like(color), np.ones(scene.shape, np.bool_), frame)
    np.testing.assert_allclose(filled, np.broadcast_to(color[~spots].mean(axis=0), color.shape), rtol=1e-5)


def test_layers_have_albedos_too(scene: Frame, spots: np.ndarray) -> None:
    albedo = np.where(spots[..., None], 50.0, 0.5) * np.ones(3)
    layer = RadianceLayer("gloss", "glossy", scene.radiance.specular, albedo)
    rest = RadianceLayer("paint", "diffuse", scene.radiance.diffuse)
    result = lobewise.denoise(scene.with_changes(layers=(layer, rest)), quality="fast")
    assert result.image.max() < 3.0 * scene.radiance.color.max()
    (told,) = result.notes
    assert told.startswith(f"the albedo of the layer 'gloss' is above 1 at {spots.sum()} pixels")


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("normal", 0.0, "normal is of length 0 on a surface"),
        ("normal", np.nan, "normal is not finite"),
        ("normal", 50.0, "normal is longer than 1.5"),
        ("diffuse_albedo", -0.5, "diffuse_albedo is below 0"),
        ("specular_albedo", np.nan, "specular_albedo is NaN"),
        ("alpha_u", -1.0, "alpha_u is out of [0, 1]"),
        ("alpha_v", np.nan, "alpha_v is NaN"),
        ("depth", -3.0, "depth is below 0"),
        ("depth", np.nan, "depth is NaN"),
    ],
)
def test_unusable_values_are_counted(name: str, value: float, told: str, scene: Frame) -> None:
    # Spots that stand alone: a region without normals raises no alarm.
    spots = np.zeros(SHAPE, bool)
    spots[5:-2:3, 4:-2:3] = True
    result = lobewise.denoise(spoil(scene, name, value, spots), quality="fast")
    assert [note for note in result.notes if note.startswith(f"{told} at {spots.sum()} pixel")], result.notes
    assert np.isfinite(result.image).all()


def test_honest_frames_are_not_touched(scene: Frame, spots: np.ndarray) -> None:
    """Rounding, measured albedos a little above 1 and a background without normals raise no alarm."""
    from lobewise.guides.usable import bound_guides

    guides = replace(scene.gbuffer, diffuse_albedo=np.where(spots[..., None], np.float32(1.05), -0.0005 * np.ones(3)))
    frame = scene.with_changes(gbuffer=guides)
    assert bound_guides(frame) is frame
    assert lobewise.denoise(frame, quality="fast").notes == ()


def test_bands_count_each_pixel_once(scene: Frame, spots: np.ndarray, tmp_path: Any) -> None:
    write_frame(tmp_path / "a.exr", spoil(scene, "diffuse_albedo", 50.0, spots), half=False)
    whole = lobewise.denoise(lobewise.read_frame(tmp_path / "a.exr"), quality="fast")
    done = denoise_file(tmp_path / "a.exr", tmp_path / "b.exr", rows=5, quality="fast")
    assert done.notes == whole.notes
    assert done.unused == whole.unused
    np.testing.assert_array_equal(read_image(tmp_path / "b.exr"), whole.image)


@pytest.mark.parametrize("bands", ["off", "7"])
def test_the_command_line_tells(
    bands: str, scene: Frame, spots: np.ndarray, tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    write_frame(tmp_path / "a.exr", spoil(scene, "diffuse_albedo", 50.0, spots))
    words = ["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--quality", "fast", "--bands", bands]
    assert run(words) == 0
    told = capsys.readouterr().err
    assert f"diffuse_albedo is above 1 at {spots.sum()} pixels" in told
    assert "Not used with these settings: hit_distance, mean_" in told


def test_other_recipes_count_too(scene: Frame, spots: np.ndarray) -> None:
    frame = spoil(scene, "diffuse_albedo", 50.0, spots)
    assert lobewise.TemporalFilter().add(frame).notes == lobewise.denoise(frame, quality="fast").notes
    sparse = lobewise.SparseFrame(Radiance(frame.radiance.color[::4, ::4]), frame.gbuffer, scale=4, camera=frame.camera)
    assert lobewise.upsample(sparse).notes == lobewise.denoise(frame, quality="fast").notes


def make_everything(*, apart: bool) -> Frame:
    """Return a frame with every image that there is."""
    rng = np.random.default_rng(1)
    frame = make_scene(SHAPE, apart=apart)
    more = {"motion": rng.normal(size=(*SHAPE, 2)), "hit_position": rng.normal(size=(*SHAPE, 3))}
    more["mean_normal"] = frame.gbuffer.normal
    color = frame.radiance.color
    return frame.with_changes(
        gbuffer=replace(frame.gbuffer, **more),
        radiance=replace(frame.radiance, direct=0.5 * color, indirect=0.5 * color),
        variance=Radiance(0.1 * color),
    )


def change(frame: Frame, name: str) -> Frame:
    """Return a frame one of whose images has other values, all of them such as it may have."""
    rng = np.random.default_rng(2)
    if name.startswith("radiance."):
        part = name.partition(".")[2]
        return frame.with_changes(radiance=replace(frame.radiance, **{part: 0.5 * getattr(frame.radiance, part)}))
    if name in ("half_a", "half_b", "variance"):
        images = {part: 3.0 * getattr(getattr(frame, name), part) for part in getattr(frame, name).names}
        return frame.with_changes(**{name: Radiance(**images)})
    image = getattr(frame.gbuffer, name)
    values: dict[str, Callable[[], Any]] = {
        "lobe_kind": lambda: rng.integers(0, 3, SHAPE),
        "coverage": lambda: rng.multinomial(16, np.full(9, 1 / 9), SHAPE) / 16,
    }
    new = values[name]() if name in values else image * rng.uniform(0.3, 0.9, image.shape)
    return frame.with_changes(gbuffer=replace(frame.gbuffer, **{name: new}))


@pytest.mark.sampled("fast-normal-True", "fast-ggx-True", "balanced-normal-True")
@pytest.mark.parametrize("apart", [True, False])
@pytest.mark.parametrize(
    ("quality", "similarity"),
    [("fast", "normal"), ("fast", "sg"), ("fast", "ggx"), ("balanced", "ggx"), ("balanced", "normal"), ("high", "ggx")],
)
def test_what_is_not_used_is_named(quality: str, similarity: str, apart: bool) -> None:
    """An image changes the result unless it is named as not used."""
    frame = make_everything(apart=apart)

    def filter(frame: Frame) -> lobewise.Result:
        return lobewise.denoise(frame, quality=quality, similarity=similarity)

    before = filter(frame)
    names = [*frame.gbuffer.names, *(f"radiance.{name}" for name in frame.radiance.names), "half_a", "variance"]
    for name in names:
        changed = not np.array_equal(filter(change(frame, name)).image, before.image)
        assert changed == (name not in before.unused), name


def test_a_lone_diffuse_albedo_is_used() -> None:
    """Of an image whose light is not told apart, and of one with layers."""
    for apart in (True, False):
        frame = make_scene(SHAPE, apart=apart)
        guides = GBuffer(
            normal=frame.gbuffer.normal, depth=frame.gbuffer.depth, diffuse_albedo=frame.gbuffer.diffuse_albedo
        )
        frame = frame.with_changes(gbuffer=guides)
        before = lobewise.denoise(frame, quality="fast", similarity="normal")
        assert "diffuse_albedo" not in before.unused
        after = lobewise.denoise(change(frame, "diffuse_albedo"), quality="fast", similarity="normal")
        assert not np.array_equal(before.image, after.image)


class Traced:
    """What a tensor of PyTorch's is like that carries gradients."""

    requires_grad = True

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


def test_gradients_are_not_lost_in_silence() -> None:
    with refuses(InputError, "color"):
        Radiance(Traced())


@pytest.mark.mitsuba
def test_neither_are_those_of_dr_jit(mi: Any) -> None:
    import drjit as dr

    image = mi.TensorXf(np.ones((4, 5, 3), np.float32))
    assert Radiance(image).color.shape == (4, 5, 3)
    dr.enable_grad(image)
    with refuses(InputError, "color"):
        Radiance(image)
    with refuses(InputError, "normal"):
        GBuffer(normal=image)


@pytest.mark.real_exr
@pytest.mark.parametrize("name", ["mitsuba_multi_channels.exr", "beachball_singlepart.0001.exr"])
def test_lamps_without_normals_raise_no_alarm(name: str, exr_folder: Any) -> None:
    notes = lobewise.denoise(lobewise.read_frame(exr_folder / name), quality="fast", radius=2).notes
    assert not any("normal is" in note for note in notes)


@pytest.mark.parametrize("quality", QUALITIES)
def test_an_albedo_that_is_no_number_makes_no_black_pixels(quality: str, spots: np.ndarray) -> None:
    frame = make_scene(SHAPE, apart=False)
    result = lobewise.denoise(spoil(frame, "diffuse_albedo", np.nan, spots), quality=quality)
    assert result.image[spots].min() > 0.0
