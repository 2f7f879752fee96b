"""The upsampling kernel against a float64 loop over pairs of pixels, and its laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lobewise.errors import InputError
from lobewise.features import Feature, TentFeature
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.history.accumulation import run_upsampling
from lobewise.records.frame import FloatArray
from tests.features.frames import make_feature, make_mask, make_radiance
from tests.features.oracles import get_similarity
from tests.filters.sizes import SMALL_SIZES
from tests.mistakes import refuses

RADIUS = 2
# As in test_cross_filter: the logarithm of the kernels, times beta, and the GGX kernel's own rounding.
TOLERANCE = 2e-3


def upsample_slowly(
    low: FloatArray, mask: np.ndarray, features: list[Feature], scale: int, place: tuple[int, int], albedo: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return image and weight sum, sample by sample, from the definition."""
    height, width = mask.shape
    total, weights = np.zeros((height, width, 3)), np.zeros((height, width))
    pairs = [
        (y, x, row, column)
        for y, x in np.ndindex(height, width)
        for row in range(max(0, y // scale - RADIUS), min(low.shape[0], y // scale + RADIUS + 1))
        for column in range(max(0, x // scale - RADIUS), min(low.shape[1], x // scale + RADIUS + 1))
        if mask[y, x] and mask[row * scale + place[0], column * scale + place[1]]
    ]
    y, x, row, column = np.array(pairs, np.intp).reshape(-1, 4).T
    i, j = (y, x), (row * scale + place[0], column * scale + place[1])
    weight = np.prod([get_similarity(feature, i, j) for feature in features], axis=0)
    np.add.at(total, i, weight[:, None] * low[row, column].astype(np.float64) / albedo[j])
    np.add.at(weights, i, weight)
    some = np.where(weights > 0.0, weights, np.inf)
    return total / some[..., None] * albedo, weights


def check_definition(scale: int, place: tuple[int, int], shape: tuple[int, int]) -> None:
    """Raise AssertionError unless random samples, one of each block, are upsampled as the definition says."""
    rng = np.random.default_rng([scale, *shape])
    # The first block has the place, however small the image is.
    place = min(place[0], shape[0] - 1), min(place[1], shape[1] - 1)
    features = [make_feature(kind, shape) for kind in ("screen", "position", "ggx")]
    mask = rng.random(shape) > 0.1
    albedo = rng.uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
    low = make_radiance(shape)[place[0] :: scale, place[1] :: scale]
    out = run_upsampling(low, mask, features, scale=scale, place=place, radius=RADIUS, albedo=albedo)
    image, weights = upsample_slowly(low, mask, features, scale, place, albedo)
    np.testing.assert_allclose(out.weight_sum, weights, rtol=TOLERANCE, atol=1e-6)
    np.testing.assert_allclose(out.image, image, rtol=2.0 * TOLERANCE, atol=1e-6)


@pytest.mark.sampled("cpu", "vulkan")
@given(scale=st.integers(2, 8), place=st.tuples(st.integers(0, 7), st.integers(0, 7)), shape=SMALL_SIZES)
def test_agrees_with_the_definition(scale: int, place: tuple[int, int], shape: tuple[int, int]) -> None:
    check_definition(scale, (place[0] % scale, place[1] % scale), shape)


def test_upsampling_by_one_is_filtering() -> None:
    shape = (33, 29)
    features = [make_feature(kind, shape) for kind in ("screen", "position", "ggx")]
    radiance, mask = make_radiance(shape), make_mask(shape)
    same = run_upsampling(radiance, mask, features, scale=1, radius=3, albedo=None)
    plain = run_filter(radiance, mask, features, form="full", radius=3)
    # Rounding of the GGX kernel, whose sums the two compile in another order.
    for name in ("image", "weight_sum", "effective_samples"):
        np.testing.assert_allclose(getattr(same, name), getattr(plain, name), rtol=2e-5)


@pytest.mark.parametrize("scale", [2, 4, 5])
def test_tent_is_bilinear_interpolation(scale: int) -> None:
    # a plane over the image is its own interpolation between the samples
    shape = (6 * scale, 7 * scale)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    plane = np.stack([1.0 + 0.1 * x, 2.0 + 0.05 * y, 1.0 + 0.02 * x + 0.03 * y], axis=-1).astype(np.float32)
    out = run_upsampling(
        plane[::scale, ::scale], make_mask(shape), [TentFeature(float(scale))], scale=scale, place=(0, 0), radius=1
    )
    inner = slice(0, -scale + 1), slice(0, -scale + 1)
    np.testing.assert_allclose(out.image[inner], plane[inner], rtol=1e-4)
    np.testing.assert_allclose(out.weight_sum[inner], 1.0, rtol=1e-4)


def test_bad_samples_weigh_nothing() -> None:
    shape = (16, 20)
    low = make_radiance(shape)[::2, ::2].copy()
    low[3, 4, 1], low[5, 5] = np.nan, -1.0
    out = run_upsampling(low, make_mask(shape), [make_feature("screen", shape)], scale=2, radius=RADIUS)
    assert np.isfinite(out.image).all()
    assert (out.image >= 0.0).all()


def test_number_of_samples_is_checked() -> None:
    with refuses(InputError, "shaded radiance", "shape (8, 9, 3)"):
        run_upsampling(np.ones((8, 9, 3), np.float32), make_mask((16, 20)), [], scale=2, radius=1)
