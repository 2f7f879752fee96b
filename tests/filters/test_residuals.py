"""The noise of images without halves: the accuracy of residuals, and their use in the filters."""

import numpy as np
import pytest

import lobewise
from lobewise.filters.noise.residuals import (
    RESIDUAL_NOISE_SHARE,
    compute_squared_residual,
    split_by_noise,
    split_samples,
)
from lobewise.metrics import rel_mse
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance

SIZE = 96
EVERYWHERE = np.ones((SIZE, SIZE), np.bool_)


def take_inside(image: np.ndarray) -> np.ndarray:
    """Return an image without its outermost pixels, whose neighbours they stand for themselves."""
    return image[1:-1, 1:-1]


def test_white_noise_keeps_its_variance(rng: np.random.Generator) -> None:
    image = (5.0 + 0.3 * rng.normal(size=(SIZE, SIZE, 3))).astype(np.float32)
    found = take_inside(compute_squared_residual(image, None, EVERYWHERE))
    # The mean of 26,508 squares, which hang together over 3x3 pixels.
    assert found.mean() == pytest.approx(0.09, rel=0.06)


def test_slopes_and_edges_along_the_axes_are_no_noise() -> None:
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    for image in (2.0 + 0.1 * x + 0.3 * y, 1.0 + 4.0 * (x > 40), 1.0 + 4.0 * (y > 17) + 2.0 * (x % 3)):
        light = np.repeat(image[..., None], 3, axis=-1).astype(np.float32)
        assert take_inside(compute_squared_residual(light, None, EVERYWHERE)).max() < 1e-9


def test_it_is_that_of_the_light_and_weighted_like_radiance(rng: np.random.Generator) -> None:
    light = (5.0 + 0.3 * rng.normal(size=(SIZE, SIZE, 3))).astype(np.float32)
    albedo = rng.uniform(0.2, 0.9, (SIZE, SIZE, 3)).astype(np.float32)
    plain, tinted = (compute_squared_residual(*each, EVERYWHERE) for each in ((light, None), (light * albedo, albedo)))
    np.testing.assert_allclose(tinted, plain * albedo, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_bad_pixels_tell_nothing_of_their_neighbours(bad: float) -> None:
    light = np.full((SIZE, SIZE, 3), 2.0, np.float32)
    light[10, 20, 1] = bad
    mask = EVERYWHERE.copy()
    mask[:, 50:] = False
    light[:, 50:] = 1e6
    found = compute_squared_residual(light, None, mask)
    assert np.isnan(found[10, 20]).all()
    assert np.isnan(found[:, 50:]).all()
    kept = found[:, :50].copy()
    kept[10, 20] = 0.0
    assert (kept == 0.0).all()


def test_the_two_images_are_as_far_apart_as_the_noise() -> None:
    rng = np.random.default_rng(2)
    mean = rng.uniform(1.0, 4.0, (SIZE, SIZE, 3)).astype(np.float32)
    residual = (0.2 * mean * rng.uniform(0.5, 1.0, mean.shape)).astype(np.float32)
    worth = rng.uniform(1.0, 30.0, (SIZE, SIZE)).astype(np.float32)
    support = np.stack([worth, 2.0 * worth], axis=-1)
    a, b, halved = split_by_noise(mean, residual, support, 0.1)
    np.testing.assert_array_equal(halved, np.stack([worth, worth], axis=-1))
    np.testing.assert_allclose(0.5 * (a + b), mean, rtol=1e-5)
    apart = 0.5 * (np.log(a + 0.1) - np.log(b + 0.1))
    np.testing.assert_allclose(
        apart**2, RESIDUAL_NOISE_SHARE * residual / worth[..., None] / (mean + 0.1) ** 2, rtol=2e-3
    )


def test_they_are_never_negative_nor_bad_however_large_the_noise() -> None:
    mean = np.array([0.0, 1e-20, 1e-3, 1.0, 1e30], np.float32)[None, :, None] * np.ones((4, 1, 3), np.float32)
    for size in (0.0, 1.0, 1e30, np.float32(3e38)):
        support = np.full((*mean.shape[:2], 2), 2.0, np.float32)
        a, b, _ = split_by_noise(mean, np.full_like(mean, size), support, 1e-30)
        for image in (a, b):
            assert np.isfinite(image).all()
            assert (image >= 0.0).all()


def test_samples_are_apart_by_the_residual_of_their_logarithms(rng: np.random.Generator) -> None:
    light = np.exp(0.2 * rng.normal(size=(SIZE, SIZE, 3))).astype(np.float32)
    a, b = split_samples(light, None, EVERYWHERE, 1e-6)
    np.testing.assert_allclose(0.5 * (np.log(a) + np.log(b)), np.log(light), atol=1e-4)
    apart = take_inside(0.5 * (np.log(a) - np.log(b)))
    assert np.mean(apart**2) == pytest.approx(0.04, rel=0.06)


def make_mirror(noise: float, contrast: float) -> tuple[Frame, np.ndarray]:
    """Return a flat mirror that shows diagonal stripes, which no guide knows, and the stripes themselves."""
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    shown = 1.0 + contrast * np.sin(0.9 * x + 0.7 * y)
    reference = np.repeat(shown[..., None], 3, axis=-1).astype(np.float32)
    factor = np.random.default_rng(5).gamma(1.0 / noise**2, noise**2, (SIZE, SIZE, 1))
    color = (reference * factor).astype(np.float32)
    camera = Camera((0.0, 0.0, 3.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.6)
    depth = (3.0 / -camera.make_ray_directions(SIZE, SIZE)[..., 2]).astype(np.float32)
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    normal[..., 2] = 1.0
    guides = GBuffer(
        depth=depth,
        normal=normal,
        alpha_u=np.full((SIZE, SIZE), 0.3, np.float32),
        diffuse_albedo=np.zeros((SIZE, SIZE, 3), np.float32),
        specular_albedo=np.ones((SIZE, SIZE, 3), np.float32),
    )
    radiance = Radiance(color, diffuse=np.zeros_like(color), specular=color)
    return Frame(radiance, guides, camera, spp=128), reference


@pytest.mark.parametrize("quality", ["balanced", "high"])
def test_detail_that_stands_out_of_the_noise_stays(quality: str) -> None:
    """Lobes as wide as these would average the detail away, an error of 1.9: only the noise estimate keeps it."""
    frame, reference = make_mirror(0.05, contrast=0.8)
    assert rel_mse(lobewise.denoise(frame, quality=quality).image, reference) < 0.02


@pytest.mark.parametrize("quality", ["balanced", "high"])
def test_noise_without_detail_is_averaged(quality: str) -> None:
    frame, reference = make_mirror(0.5, contrast=0.0)
    clean = rel_mse(lobewise.denoise(frame, quality=quality).image, reference)
    assert clean < 0.02 * rel_mse(frame.radiance.color, reference)
