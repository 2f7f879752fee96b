"""The upsampling recipe: edges stay where the guides have them, everything else as in denoising."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.errors import InputError
from lobewise.metrics import rel_mse
from lobewise.recipes.temporal import TemporalFilter
from lobewise.recipes.upsampling import MAX_TINT, tint_radiance, upsample
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import SparseFrame, list_places, make_sparse
from tests.denoising.test_denoising import SHAPE, make_frame
from tests.mistakes import refuses

SLOW = pytest.mark.nightly  # kernels are compiled


def make_clean_frame() -> Any:
    """Return the glossy and the rough half of `make_frame` without noise, and what they look like."""
    frame = make_frame()
    left = np.arange(SHAPE[1]) < SHAPE[1] // 2
    truth = np.broadcast_to(np.where(left, 1.0, 0.25)[None, :, None], (*SHAPE, 3)).astype(np.float32)
    dark = np.zeros_like(truth)
    return frame.with_changes(radiance=Radiance(color=truth, diffuse=dark, specular=truth)), truth


@pytest.mark.sampled("2-place0-ggx", "4-place1-ggx")
@pytest.mark.parametrize("similarity", [*(pytest.param(name, marks=SLOW) for name in ("sg", "sg_mixture")), "ggx"])
@pytest.mark.parametrize(("scale", "place"), [(2, (0, 1)), (4, (2, 1))])
def test_edge_of_gloss_stays_where_the_guides_have_it(similarity: str, scale: int, place: tuple[int, int]) -> None:
    frame, truth = make_clean_frame()
    sparse = make_sparse(frame, scale, place)
    lobes = rel_mse(upsample(sparse, similarity=similarity, beta=16.0).image, truth)
    normals = rel_mse(upsample(sparse, similarity="normal").image, truth)
    screen = rel_mse(upsample(sparse, bilinear=True).image, truth)
    assert lobes < 0.05 * normals
    assert lobes < 0.05 * screen


@pytest.mark.nightly
@pytest.mark.parametrize("over_time", [False, True])
def test_pixels_that_two_surfaces_share_show_both(over_time: bool) -> None:
    # Two surfaces of other albedos side by side. The pixels of column 31, which are not shaded, show half of each.
    height, width, scale = 32, 64, 2
    left = np.arange(width) < 32
    depth = np.where(left, 4.0, 40.0) * np.ones((height, 1))
    albedo = np.where(left[:, None], 0.8, 0.2) * np.ones((height, 1, 3))
    light = np.where(left[:, None], 1.0, 5.0) * np.ones((height, 1, 3))
    mean, coverage, truth = albedo.copy(), np.zeros((height, width, 9)), albedo * light
    coverage[..., 4] = 1.0
    coverage[:, 31, 4:6] = 0.5
    mean[:, 31], truth[:, 31] = 0.5, 0.5 * (0.8 * 1.0 + 0.2 * 5.0)
    dark = np.full((height, width, 3), 1e-6)
    guides = GBuffer(
        depth=depth,
        normal=np.broadcast_to([0.0, 0.0, 1.0], (height, width, 3)),
        alpha_u=np.full((height, width), 0.3),
        diffuse_albedo=albedo,
        mean_diffuse_albedo=mean,
        specular_albedo=dark,
        mean_specular_albedo=dark,
        coverage=coverage,
        mean_emission=0.0 * dark,
    )
    camera = Camera(position=(0, 0, 4), forward=(0, 0, -1), up=(0, 1, 0), fov_y=0.6)
    frame = Frame(Radiance(truth, diffuse=truth, specular=0.0 * truth), guides, camera, spp=4)
    sparse = make_sparse(frame, scale, (0, 0))
    result = TemporalFilter(similarity="ggx").add(sparse) if over_time else upsample(sparse, similarity="ggx")
    np.testing.assert_allclose(result.image, truth, rtol=0.02)


@pytest.mark.parametrize("over_time", [False, True])
def test_areas_of_another_albedo_than_their_centres_keep_their_radiance(over_time: bool) -> None:
    shape = (16, 32)
    half, cover = np.full((*shape, 3), 0.5), np.zeros((*shape, 9))
    cover[..., 4] = 1.0
    guides = GBuffer(
        depth=np.full(shape, 4.0),
        normal=np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)),
        alpha_u=np.full(shape, 0.3),
        diffuse_albedo=half,
        mean_diffuse_albedo=0.5 * half,
        specular_albedo=half,
        mean_specular_albedo=1.5 * half,
        coverage=cover,
    )
    camera = Camera(position=(0, 0, 4), forward=(0, 0, -1), up=(0, 1, 0), fov_y=0.6)
    frame = Frame(Radiance(3.0 * half, diffuse=half, specular=2.0 * half), guides, camera, spp=4)
    sparse = make_sparse(frame, 2, (0, 1))
    result = TemporalFilter(similarity="ggx").add(sparse) if over_time else upsample(sparse, similarity="ggx")
    np.testing.assert_allclose(result.image, 1.5, rtol=1e-4)


def test_samples_are_divided_by_the_albedo_of_their_area() -> None:
    shape = (2, 4)
    albedo, mean = np.full((*shape, 3), 0.8, np.float32), np.full((*shape, 3), 0.8, np.float32)
    mean[0, 0], mean[0, 1], mean[0, 2], albedo[1, 0] = 0.4, 0.01, np.nan, 0.0
    guides = GBuffer(
        diffuse_albedo=albedo,
        mean_diffuse_albedo=mean,
        specular_albedo=albedo,
        mean_specular_albedo=albedo,
        coverage=np.full((*shape, 9), 1.0 / 9.0),
    )
    light = Radiance(np.full((*shape, 3), 3.5), diffuse=np.full((*shape, 3), 1.0), specular=np.full((*shape, 3), 2.0))
    found = Radiance(*tint_radiance(light, guides, lambda image: image))
    expected = np.ones(shape)
    # The albedo of the area is half of that at the centre; too small; not a number; beside a black centre.
    expected[0, :3], expected[1, 0] = (2.0, MAX_TINT, 1.0), 1.0
    np.testing.assert_allclose(found.diffuse, np.repeat(expected[..., None], 3, -1))
    np.testing.assert_allclose(found.specular, 2.0)
    np.testing.assert_allclose(found.color, found.diffuse + found.specular + 0.5)
    plain = GBuffer(diffuse_albedo=albedo, specular_albedo=albedo)
    assert tint_radiance(light, plain, lambda image: image) is None


def test_every_pixel_shaded_is_filtering() -> None:
    from lobewise.denoising import denoise

    frame = make_frame()
    same = upsample(make_sparse(frame, 1), radius=4)
    np.testing.assert_allclose(same.image, denoise(frame, radius=4, quality="fast").image, rtol=1e-3, atol=1e-5)


def make_lit_frame(rng: np.random.Generator, *, apart: bool = True) -> tuple[Any, Any]:
    """Return a frame with a detailed sky and a lamp, and its emission, which is free of noise."""
    frame, truth = make_clean_frame()
    emission = np.zeros_like(truth)
    emission[:10] = rng.uniform(0.1, 2.0, (10, SHAPE[1], 3))
    emission[20:25, 30:37] = 40.0
    guides = {name: np.array(getattr(frame.gbuffer, name)) for name in ("depth", "normal", "position")}
    for guide in guides.values():
        guide[:10] = 0.0
    scattered = truth.copy()
    scattered[:10] = 0.0
    dark = np.zeros_like(truth)
    light = Radiance(scattered + emission, dark, scattered) if apart else Radiance(scattered + emission)
    gbuffer = replace(frame.gbuffer, **guides, mean_emission=emission)
    return frame.with_changes(gbuffer=gbuffer, radiance=light), emission


@pytest.mark.parametrize("over_time", [False, True])
def test_light_without_noise_is_taken_from_the_guides(over_time: bool, rng: np.random.Generator) -> None:
    frame, emission = make_lit_frame(rng)
    sparse = make_sparse(frame, 4, (1, 2))
    result = TemporalFilter(radius=5).add(sparse) if over_time else upsample(sparse)
    truth = frame.radiance.color
    np.testing.assert_array_equal(result.image[:10], emission[:10])
    lamp = np.s_[20:25, 30:37]
    np.testing.assert_allclose(result.image[lamp] - emission[lamp], truth[lamp] - emission[lamp], rtol=0.1)
    ring = result.image[17:28, 27:40].copy()
    ring[3:8, 3:10] = 0.0
    assert ring.max() < 1.2


@pytest.mark.parametrize("over_time", [False, True])
def test_light_that_is_left_out_is_named(over_time: bool, rng: np.random.Generator) -> None:
    frame, emission = make_lit_frame(rng)

    def list_notes(known: Any) -> tuple[str, ...]:
        sparse = make_sparse(frame.with_changes(gbuffer=replace(frame.gbuffer, mean_emission=known)), 4, (1, 2))
        return (TemporalFilter().add(sparse) if over_time else upsample(sparse)).notes

    assert list_notes(emission) == ()
    lacking = emission.copy()
    lacking[3, 4] = np.nan
    (note,) = list_notes(lacking)
    assert note.startswith("mean_emission is not finite or below 0 at 1 pixel:")
    (note,) = list_notes(np.zeros_like(emission))
    assert "is neither diffuse nor specular nor in mean_emission, and is left out" in note


@pytest.mark.parametrize("apart", [False, True])
def test_the_sky_takes_no_light_of_surfaces_and_surfaces_none_of_the_sky(apart: bool, rng: np.random.Generator) -> None:
    frame, _ = make_lit_frame(rng, apart=apart)
    flat = np.where(np.arange(SHAPE[0])[:, None, None] < 10, np.float32(5.0), frame.radiance.color)
    flat[20:25, 30:37] = frame.radiance.color[19, 30]
    light = replace(frame.radiance, color=np.asarray(flat, np.float32))
    frame = frame.with_changes(gbuffer=replace(frame.gbuffer, mean_emission=None), radiance=light)
    image = upsample(make_sparse(frame, 4, (1, 2))).image
    np.testing.assert_allclose(image[:10], 5.0, rtol=1e-4)
    assert rel_mse(image[10:], flat[10:]) < 1e-3
    assert image[10:].max() < 1.2


def test_result_describes_itself() -> None:
    sparse = make_sparse(make_frame(), 4, (3, 0))
    result = upsample(sparse)
    assert result.image.shape == (*SHAPE, 3)
    assert result.weight_sum.shape == SHAPE
    assert (result.settings["scale"], result.settings["place"]) == (4, (3, 0))
    assert result.settings["radius"] == 5
    assert np.isfinite(result.image).all()


def test_bad_samples_are_counted_at_their_pixels() -> None:
    sparse = make_sparse(make_frame(), 2, (1, 0))
    color = sparse.radiance.color.copy()
    color[4, 7] = np.nan
    radiance = Radiance(color=color, diffuse=sparse.radiance.diffuse, specular=sparse.radiance.specular)
    broken = SparseFrame(radiance, sparse.gbuffer, 2, (1, 0), camera=sparse.camera, spp=4)
    result = upsample(broken)
    assert result.bad_pixel_count == 1
    assert result.bad_pixels[9, 14]
    assert np.isfinite(result.image).all()


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        ({"scale": 0}, ("scale", "0")),
        ({"scale": 2.0}, ("scale", "2.0")),
        ({"place": (0, 4)}, ("place",)),
        ({"scale": 3, "place": (0, 0)}, ("radiance",)),
        ({"gbuffer": GBuffer()}, ("gbuffer",)),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], refused: tuple[str, ...]) -> None:
    sparse = make_sparse(make_frame(), 4, (1, 1))
    values = {"radiance": sparse.radiance, "gbuffer": sparse.gbuffer, "scale": 4, "place": (1, 1), **change}
    with refuses(InputError, *refused):
        SparseFrame(**values)


def test_other_forms_are_refused() -> None:
    with refuses(InputError, "form"):
        upsample(make_sparse(make_frame(), 2), form="atrous")


@pytest.mark.parametrize("scale", range(1, 17))
def test_places_visit_every_pixel_of_a_block_once(scale: int) -> None:
    places = list_places(scale)
    assert sorted(places) == [(row, column) for row in range(scale) for column in range(scale)]


@pytest.mark.parametrize("scale", [2, 4, 8])
def test_the_first_places_cover_the_block_evenly(scale: int) -> None:
    # The first four are one in each quarter of the block, and so are the four after them.
    half = scale // 2
    for start in range(0, scale**2, 4):
        quarters = {(row // half, column // half) for row, column in list_places(scale)[start : start + 4]}
        assert len(quarters) == 4


def test_silhouettes_of_mean_guides_get_no_light_that_no_surface_has() -> None:
    """As in the files of other renderers: a dark metal before a bright wall, and pixels of half of each.

    Their albedo is brighter than the metal's, and their normal is that of no surface.
    """
    height, width = 32, 48
    left, edge = np.arange(width) < 22, np.arange(width) == 22
    metal, wall = np.array([0.8, 0.0, 0.6]), np.array([-0.8, 0.0, 0.6])
    normal = np.where(left[:, None], metal, wall) * np.ones((height, 1, 1))
    albedo = np.where(left[:, None], 0.1, 0.8) * np.ones((height, 1, 3))
    # Light of the metal is bright beside its albedo.
    light = np.where(left[:, None], 0.5, 0.2) * np.ones((height, 1, 3))
    normal[:, edge], albedo[:, edge], light[:, edge] = 0.5 * (metal + wall), 0.45, 0.35
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    frame = Frame(
        Radiance(light),
        GBuffer(normal=unit, diffuse_albedo=albedo, specular_albedo=0.0 * albedo, denoiser_normal=normal),
    )
    for place in ((0, 0), (1, 1), (2, 3)):
        result = upsample(make_sparse(frame, 4, place), similarity="normal")
        assert result.image.max() < 0.55, place
        own = make_sparse(frame.with_changes(gbuffer=replace(frame.gbuffer, denoiser_normal=None)), 4, place)
        clean = np.delete(result.image, 22, axis=1)
        np.testing.assert_array_equal(clean, np.delete(upsample(own, similarity="normal").image, 22, axis=1))


def test_metals_of_another_renderer_have_no_white_dots(field_folder: Path) -> None:
    truth = np.load(field_folder / "half_ref.npy")
    frame = lobewise.read_frame(field_folder / "half_64spp.exr")
    image = upsample(make_sparse(frame, 4, (1, 1))).image
    error = (image - truth) ** 2 / (truth**2 + 0.01)
    assert error.mean() < 0.06
    assert error.mean(axis=-1).max() < 20.0
