"""Albedos without the noise of samples: against the definition in NumPy, and what must stay."""

import numpy as np
from hypothesis import given
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter

from lobewise.errors import InputError
from lobewise.filters.noise.albedo import (
    DIFFERENCE_DIRECTIONS,
    MAX_RATIO_TO_MEDIAN,
    NORMAL_SHARPNESS,
    RADIUS,
    VARIANCE_FLOOR,
    clean_albedo,
)
from lobewise.records.frame import FloatArray
from tests.features.frames import make_directions
from tests.filters.sizes import SIZES
from tests.mistakes import refuses

EDGE = 12
"""Pixels beside the border that the definition continues the image by, more than the kernel reads."""


def make_guides(shape: tuple[int, int], noise: float = 0.1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a noisy albedo of flat patches, the albedo without noise, and normals."""
    rng = np.random.default_rng(shape)
    patches = rng.uniform(0.2, 0.8, (shape[0] // 9 + 1, shape[1] // 9 + 1, 3))
    clean = np.repeat(np.repeat(patches, 9, 0), 9, 1)[: shape[0], : shape[1]].astype(np.float32)
    noisy = clean + np.float32(noise) * rng.normal(size=clean.shape).astype(np.float32)
    return noisy, clean, make_directions(rng, shape, 0.1)


def compute_variance(albedo: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the variance of the noise of every pixel, all channels together, by its definition."""
    around = np.pad(albedo, ((1, 1), (1, 1), (0, 0)), mode="edge")
    inner = np.s_[1:-1, 1:-1]
    means = []
    for dx, dy in DIFFERENCE_DIRECTIONS:
        ahead, behind = (np.roll(around, (-sign * dy, -sign * dx), (0, 1))[inner] for sign in (1, -1))
        means.append(uniform_filter(np.sum((2.0 * albedo - ahead - behind) ** 2, axis=-1) / 6.0, 3, mode="nearest"))
    least = np.min(means, axis=0)
    return np.asarray(uniform_filter(np.minimum(least, MAX_RATIO_TO_MEDIAN * median_filter(least, 3)), 3))


def clean_slowly(albedo: FloatArray, normal: FloatArray) -> NDArray[np.float64]:
    """Return the weighted means, offset by offset, from the definition."""
    height, width = albedo.shape[:2]
    edges = ((EDGE, EDGE), (EDGE, EDGE), (0, 0))
    wide, facing = (np.pad(guide.astype(np.float64), edges, mode="edge") for guide in (albedo, normal))
    variance = compute_variance(wide)
    total, weights = np.zeros_like(wide), np.zeros(wide.shape[:2])
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            near, turned, other = (np.roll(image, (-dy, -dx), (0, 1)) for image in (wide, facing, variance))
            apart = np.sum((wide - near) ** 2, axis=-1) - variance - np.minimum(variance, other)
            patch = uniform_filter(apart / (VARIANCE_FLOOR + variance + other), 3)
            weight = np.exp(-np.maximum(patch, 0.0) - NORMAL_SHARPNESS * np.sum((facing - turned) ** 2, axis=-1))
            total += weight[..., None] * near
            weights += weight
    return (total / weights[..., None])[EDGE : EDGE + height, EDGE : EDGE + width]


@given(shape=SIZES)
def test_agrees_with_the_definition(shape: tuple[int, int]) -> None:
    albedo, _, normal = make_guides(shape)
    np.testing.assert_allclose(clean_albedo(albedo, normal), clean_slowly(albedo, normal), rtol=2e-4, atol=2e-5)


def test_noise_goes_and_patches_stay() -> None:
    albedo, clean, normal = make_guides((63, 72))
    before, after = (float(np.mean((image - clean) ** 2)) for image in (albedo, clean_albedo(albedo, normal)))
    assert after < 0.25 * before


def test_detail_without_noise_stays() -> None:
    rows, columns = np.indices((40, 50))
    stripes = np.repeat(np.where((rows + columns) % 6 < 3, 0.2, 0.7)[..., None], 3, axis=-1).astype(np.float32)
    facing = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), stripes.shape)
    inner = np.s_[4:-4, 4:-4]
    np.testing.assert_allclose(clean_albedo(stripes, facing)[inner], stripes[inner], atol=0.01)


def test_surfaces_that_face_apart_are_not_averaged() -> None:
    albedo, _, _ = make_guides((30, 40), noise=0.3)
    normal = np.zeros((30, 40, 3), np.float32)
    normal[:, :20, 0], normal[:, 20:, 0] = 1.0, -1.0
    other = albedo.copy()
    other[:, 23:] = 0.5
    kept, changed = clean_albedo(albedo, normal), clean_albedo(other, normal)
    np.testing.assert_allclose(kept[:, :12], changed[:, :12], atol=1e-6)


def test_guides_of_two_sizes_are_refused() -> None:
    with refuses(InputError, "normal"):
        clean_albedo(np.ones((8, 9, 3), np.float32), np.ones((8, 8, 3), np.float32))
