"""The recipe on small frames made here: what it takes, what it gives, what it refuses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.denoising import bad_pixels, denoise
from lobewise.denoising.automatic import choose_beta, choose_screen_sigma, choose_tau, estimate_spp, resolve_all
from lobewise.denoising.plan import compute_steps_reach
from lobewise.errors import InputError, MissingChannelError
from lobewise.peers import has_oidn
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, LobeKind, Radiance
from lobewise.settings import DenoiseSettings
from tests.mistakes import refuses

CAMERA = Camera(position=(0.0, 0.0, 0.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.6)
SHAPE = (40, 50)
BOTH = pytest.mark.parametrize("quality", ["fast", pytest.param("balanced", marks=pytest.mark.nightly)])
"""Of what `denoise` promises however the noise enters; tests of how guides alone weigh say "fast"."""
EVERY = pytest.mark.parametrize(
    "quality", ["fast", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("balanced", "high"))]
)


def make_frame(shape: tuple[int, int] = SHAPE, *, apart: bool = True, seed: int = 0, **guides: Any) -> Frame:
    """Return a tilted plane, glossy on the left and rough on the right, lit differently, with noise."""
    rng = np.random.default_rng(seed)
    rays = CAMERA.make_ray_directions(shape[1], shape[0]).astype(np.float64)
    normal = np.array([0.0, 0.6, 0.8])
    depth = -5.0 / (rays @ normal)
    left = np.arange(shape[1]) < shape[1] // 2
    alpha = np.broadcast_to(np.where(left, 0.05, 0.5), shape)
    clean = np.broadcast_to(np.where(left, 2.0, 0.5)[None, :, None], (*shape, 3))
    albedo = np.full((*shape, 3), 0.5)
    specular = clean * 0.5 * rng.exponential(1.0, (*shape, 1))
    diffuse = 0.3 * rng.exponential(1.0, (*shape, 1)) * np.ones(3)
    gbuffer = {
        "depth": depth,
        "position": rays * depth[..., None],
        "normal": np.broadcast_to(normal, (*shape, 3)),
        "alpha_u": alpha,
        "alpha_v": alpha,
        "lobe_kind": np.full(shape, int(LobeKind.GGX)),
        "diffuse_albedo": albedo,
        "specular_albedo": albedo,
        **guides,
    }
    return Frame(
        radiance=Radiance(
            color=diffuse + specular, diffuse=diffuse if apart else None, specular=specular if apart else None
        ),
        gbuffer=GBuffer(**gbuffer),
        camera=CAMERA,
        spp=4,
    )


def get_clean(shape: tuple[int, int] = SHAPE) -> np.ndarray[Any, Any]:
    """Return what the noise of `make_frame` averages to."""
    return np.broadcast_to(np.where(np.arange(shape[1]) < shape[1] // 2, 1.3, 0.55)[None, :, None], (*shape, 3))


@pytest.mark.sampled("ggx-full-True")
@pytest.mark.parametrize(
    ("similarity", "form", "apart"),
    [
        ("sg", "full", True),
        ("sg_mixture", "full", True),
        ("ggx", "full", True),
        # Forms and similarities are apart: that each works with each is in the tests of the filter.
        pytest.param("ggx", "full", False, marks=pytest.mark.nightly),
        pytest.param("sg_mixture", "full", False, marks=pytest.mark.nightly),
        pytest.param("ggx", "separable", True, marks=pytest.mark.nightly),
        pytest.param("sg", "atrous", True, marks=pytest.mark.nightly),
    ],
)
def test_lobes_keep_the_edge_that_normals_blur(similarity: str, form: str, apart: bool) -> None:
    frame, clean = make_frame(apart=apart), get_clean()
    lobes = denoise(frame, similarity=similarity, form=form, quality="fast").image
    normals = denoise(frame, similarity="normal", form=form, quality="fast").image
    near_edge = slice(SHAPE[1] // 2 - 3, SHAPE[1] // 2 + 3)

    def error(image: np.ndarray[Any, Any], columns: slice) -> float:
        return float(np.mean((image - clean)[:, columns] ** 2))

    everywhere = slice(None)
    assert error(lobes, everywhere) < 0.25 * error(frame.radiance.color, everywhere)
    assert error(lobes, near_edge) < 0.6 * error(normals, near_edge)


def test_mixture_of_one_lobe_is_the_single_lobe() -> None:
    # up to the sharpness, which is that of the curvature at the axis for sg and that of least squares for mixtures
    frame = make_frame()
    one = denoise(frame, similarity="sg_mixture", lobes=1, quality="fast").image
    single = denoise(frame, similarity="sg", quality="fast").image
    np.testing.assert_allclose(one, single, rtol=0.1, atol=0.02)


def test_combined_radiance_is_compared_by_diffuse_and_specular_lobe() -> None:
    # two paints under one lacquer: all that differs is how much the diffuse lobe reflects
    bright = np.broadcast_to(np.where(np.arange(SHAPE[1]) % 10 < 5, 0.9, 0.02)[None, :, None], (*SHAPE, 3))
    alpha = np.full(SHAPE, 0.3)
    dim = np.full((*SHAPE, 3), 0.04)
    frame = make_frame(apart=False, alpha_u=alpha, alpha_v=alpha, diffuse_albedo=bright, specular_albedo=dim)
    support = {name: denoise(frame, similarity=name, quality="fast").weight_sum for name in ("sg", "sg_mixture")}
    assert np.median(support["sg_mixture"] / support["sg"]) < 0.8
    with refuses(InputError, "lobes of a mixture", expected="an integer from 1 to 3"):
        denoise(frame, similarity="sg_mixture", lobes=4)


@pytest.mark.nightly
def test_default_is_what_auto_says() -> None:
    frame = make_frame()
    result = lobewise.denoise(frame)
    assert result.settings["similarity"] in ("sg", "ggx")
    assert result.settings["quality"] == ("balanced" if has_oidn() else "high")
    assert result.settings["with_oidn"] is has_oidn()
    again = denoise(frame, DenoiseSettings(**result.settings))
    assert result.image.tobytes() == again.image.tobytes()
    assert lobewise.denoise(frame, quality="fast").settings["beta"] == choose_beta(4.0)


@BOTH
def test_auto_without_roughness_compares_normals(quality: str) -> None:
    frame = make_frame(alpha_u=None, alpha_v=None)
    assert denoise(frame, quality=quality).settings["similarity"] == "normal"


@EVERY
def test_emission_and_background_pass_through(quality: str) -> None:
    depth = make_frame().gbuffer.depth
    depth = depth.copy()
    depth[:5] = 0.0
    normal = np.zeros((*SHAPE, 3), np.float32) + np.float32([0.0, 0.6, 0.8])
    normal[:5] = 0.0
    frame = make_frame(depth=depth, normal=normal)
    color, (diffuse, specular) = frame.radiance.color.copy(), map(np.array, frame.radiance.parts or ())
    # No surface scatters light here.
    diffuse[:5], specular[:5] = 0.0, 0.0
    frame = frame.with_changes(radiance=Radiance(color.copy(), diffuse, specular))
    # To the network of "high" a lamp of a single pixel is noise.
    color[18:23, 18:23] += 7.0
    radiance = Radiance(color=color, diffuse=diffuse, specular=specular)
    lit = denoise(frame.with_changes(radiance=radiance), quality=quality)
    plain = denoise(frame, quality=quality)
    light = [each.image - each.diffuse - each.specular for each in (lit, plain)]
    np.testing.assert_allclose((light[0] - light[1])[20, 20], 7.0, rtol=1e-5)
    # The network of "high" smooths the two rows of the background that are next to the surface.
    rows = 3 if quality == "high" else 5
    np.testing.assert_allclose(lit.image[:rows], color[:rows], rtol=1e-6)


@BOTH
@pytest.mark.parametrize("apart", [True, False], ids=["apart", "combined"])
def test_bad_pixels_are_counted_and_refilled(apart: bool, quality: str) -> None:
    frame = make_frame(apart=apart)
    color = frame.radiance.color.copy()
    diffuse = frame.radiance.diffuse.copy() if frame.radiance.diffuse is not None else None
    for at, value in (((3, 3), np.nan), ((10, 30), np.inf), ((11, 31), -200.0)):
        color[at] = value
        if diffuse is not None:
            diffuse[at] = value
    radiance = Radiance(color=color, diffuse=diffuse, specular=frame.radiance.specular)
    result = denoise(frame.with_changes(radiance=radiance), quality=quality)
    assert result.bad_pixel_count == 3
    assert result.bad_pixels[3, 3]
    assert np.isfinite(result.image).all()
    clean = get_clean()
    for at in ((3, 3), (10, 30), (11, 31)):
        np.testing.assert_allclose(result.image[at], clean[at], rtol=0.4)


@BOTH
def test_bad_background_is_refilled_from_the_screen(quality: str) -> None:
    normal = np.zeros((*SHAPE, 3), np.float32)
    frame = make_frame(normal=normal, depth=np.zeros(SHAPE))
    color = np.ones((*SHAPE, 3), np.float32)
    color[5:9, 5:9] = np.nan
    zero = np.zeros_like(color)
    result = denoise(frame.with_changes(radiance=Radiance(color=color, diffuse=zero, specular=zero)), quality=quality)
    np.testing.assert_allclose(result.image, 1.0, rtol=1e-5)


SURROUNDINGS = {"fast": 1e-6, "balanced": 1e-3, "high": 1e-3}
"""What a bad pixel changes beyond the reach of all filters, relative: rounding, and the mean of the frame, which has
one pixel less and says how dark is dark."""


@EVERY
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0], ids=str)
@pytest.mark.parametrize(
    "channel",
    [
        *("alpha", "normal", "position", "depth", "coverage"),
        *("diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo"),
    ],
)
@pytest.mark.usefixtures("unshared")
def test_garbage_guides_spoil_only_their_surroundings(channel: str, bad: float, quality: str) -> None:
    reach = compute_steps_reach(resolve_all(make_frame(), DenoiseSettings(quality=quality)))
    frame = make_frame((reach + 8, 11))
    albedo, coverage = frame.gbuffer.diffuse_albedo, np.broadcast_to(np.eye(9)[4], (*frame.shape, 9))
    more = {"coverage": coverage, "mean_diffuse_albedo": albedo, "mean_specular_albedo": albedo}
    whole = replace(frame.gbuffer, **more, position=None if channel == "depth" else frame.gbuffer.position)
    names = ("alpha_u", "alpha_v") if channel == "alpha" else (channel,)
    spoilt = {name: np.array(getattr(whole, name)) for name in names}
    for guide in spoilt.values():
        guide[4, 7] = bad
    clean, result = (
        denoise(frame.with_changes(gbuffer=guides), quality=quality).image
        for guides in (whole, replace(whole, **spoilt))
    )
    assert np.isfinite(result).all()
    # A guide may say less than all: the pixel itself is near what its samples are, and neighbours average over it.
    assert np.abs(result - clean).max() < 2.0
    np.testing.assert_allclose(result[reach + 5 :], clean[reach + 5 :], rtol=SURROUNDINGS[quality])


@BOTH
def test_coloured_metal_without_one_channel_stays_finite(quality: str) -> None:
    albedo = np.full((*SHAPE, 3), [0.9, 0.5, 0.0])
    frame = make_frame(specular_albedo=albedo)
    assert np.isfinite(denoise(frame, quality=quality).image).all()


@BOTH
def test_result_describes_itself(quality: str) -> None:
    result = denoise(make_frame(), radius=5, quality=quality)
    assert result.settings["quality"] == quality
    assert result.settings["radius"] == 5
    assert result.seconds > 0.0
    assert (result.effective_samples >= 1.0).all()
    assert (result.effective_samples <= 121.0 * 1.001).all()
    assert (result.weight_sum >= 0.99).all()
    np.testing.assert_allclose(result.image, result.diffuse + result.specular, rtol=1e-5)


def test_noise_decides_what_the_samples_are_worth() -> None:
    frame = make_frame()
    mean = frame.radiance.color.mean(axis=-1, keepdims=True)

    def worth(relative_variance: float, spp: int | None) -> float:
        variance = Radiance(color=np.broadcast_to(relative_variance * mean**2, (*SHAPE, 3)))
        return estimate_spp(frame.with_changes(spp=spp, variance=variance))

    assert estimate_spp(frame) == 4.0
    assert estimate_spp(frame.with_changes(spp=None)) == 4.0
    assert worth(0.0825, 4) == pytest.approx(4.0, rel=1e-3)
    assert worth(0.33, 4) == pytest.approx(1.0, rel=1e-3)
    assert worth(0.0825, None) == pytest.approx(4.0, rel=1e-3)
    assert worth(1e-12, None) == 4096.0
    assert worth(np.nan, 64) == 64.0


def test_parameters_follow_the_noise() -> None:
    samples = [0.5, 1.0, 4.0, 16.0, 64.0, 1024.0]
    betas = [choose_beta(spp) for spp in samples]
    taus = [choose_tau(spp, 1e-4) for spp in samples]
    sigmas = [choose_screen_sigma(spp, 8) for spp in samples]
    assert betas == sorted(betas)
    assert taus == sorted(taus, reverse=True)
    assert sigmas == sorted(sigmas, reverse=True)
    assert max(sigmas) == 8.0
    assert choose_tau(1e9, 2e-3) == 2e-3
    assert choose_screen_sigma(4.0, 0) > 0.0


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({"form": "seperable"}, ("form",)),
        ({"radius": 2.5}, ("radius",)),
        ({"beta": 0.0}, ("beta", "0.0")),
        ({"beta": "high"}, ("beta", "'high'")),
        ({"tau": float("nan")}, ("tau",)),
        ({"bandwidth": 3.0}, ("setting",)),
    ],
)
def test_wrong_settings_are_named(changes: dict[str, Any], refused: tuple[str, ...]) -> None:
    with refuses(InputError, *refused):
        denoise(make_frame((4, 4)), **changes)


@BOTH
@pytest.mark.parametrize(
    ("similarity", "guides", "what"),
    [
        ("sg", {"alpha_u": None, "alpha_v": None}, "channel alpha_u"),
        ("ggx", {"alpha_u": None, "alpha_v": None}, "channel alpha_u"),
        ("sg", {"position": None, "depth": None}, "channel position"),
    ],
)
def test_missing_channels_are_named(similarity: str, guides: dict[str, Any], what: str, quality: str) -> None:
    with refuses(MissingChannelError, what):
        denoise(make_frame((4, 4), **guides), similarity=similarity, quality=quality)


@BOTH
def test_missing_camera_is_named(quality: str) -> None:
    with refuses(MissingChannelError, "camera"):
        denoise(make_frame((4, 4)).with_changes(camera=None), similarity="ggx", quality=quality)


@pytest.mark.sampled("fast")
@BOTH
def test_support_is_that_of_what_a_pixel_reflects(quality: str) -> None:
    paint, metal = np.full((*SHAPE, 3), 0.5), np.full((*SHAPE, 3), 0.5)
    paint[:, :10], metal[:, 30:] = 0.0, 0.0  # metal on the left, both in the middle, paint on the right
    frame = make_frame(diffuse_albedo=paint, specular_albedo=metal)
    result = denoise(frame, form="full", radius=3, quality=quality)
    assert (result.weight_sum > 0.9).all()
    assert (result.effective_samples >= 1.0).all()
    if quality == "fast":
        # paint compares normals, which are one here, so its support is the larger
        assert result.weight_sum[5:-5, 35:45].min() > result.weight_sum[5:-5, 13:20].max()


@BOTH
def test_very_dim_frames_are_not_nothing(quality: str) -> None:
    frame = make_frame()
    scale = np.float32(1e-26)
    parts = {name: getattr(frame.radiance, name) * scale for name in ("color", "diffuse", "specular")}
    noise = Radiance(color=np.full((*SHAPE, 3), 1e-53))
    dim = frame.with_changes(radiance=Radiance(**parts), variance=noise)
    assert np.isfinite(estimate_spp(dim))
    assert np.isfinite(denoise(dim, quality=quality).image).all()


@BOTH
def test_position_may_come_from_depth_and_camera(quality: str) -> None:
    known = denoise(make_frame(), similarity="ggx", quality=quality)
    rebuilt = denoise(make_frame(position=None), similarity="ggx", quality=quality)
    np.testing.assert_allclose(rebuilt.image, known.image, rtol=1e-3)


@pytest.mark.parametrize("size", [(300, 340), (90, 400)])
def test_holes_are_filled_in_their_box_as_in_the_whole_image(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    image, holes = rng.random((*size, 3), np.float32), np.zeros(size, bool)
    # Alone, together, and too wide for the first round.
    holes[40, 100], holes[41:43, 102:105], holes[44:84, 140:180] = True, True, True
    image[holes] = np.nan
    mean = np.full(3, 0.5, np.float32)
    box, whole = bad_pixels.refill(image, holes, mean), image.copy()
    bad_pixels._fill_box(mean, whole, holes)
    assert np.isfinite(box).all()
    assert box.tobytes() == whole.tobytes()
