"""The guide of a dual-buffer pass against NumPy's logarithm and SciPy's Gaussian."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lobewise.backend.jit import count_compiled_kernels
from lobewise.errors import InputError
from lobewise.filters.noise_guides import compute_mean_light, make_noise_guide, measure_light
from lobewise.records.frame import FloatArray
from tests.features.frames import make_radiance
from tests.filters.sizes import SIZES
from tests.mistakes import refuses

LOG_OFFSET_SHARE = 0.04
LEVEL = 1.7
"""How bright the whole image is taken to be; any number will do."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
ALBEDO_FLOOR = 1e-3
MIN_VARIANCE = 5e-4
# The kernels' log2 is good to 1e-4, of which a natural logarithm has ln 2.
LOGARITHM = 7e-5


def make_halves(shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return two noisy halves of one smooth image, black in a corner."""
    rows, columns = (np.arange(count)[:, None] / count for count in shape)
    image = np.exp(2.0 * np.sin(3.0 * rows + 4.0 * columns.T))[..., None] * np.array([1.0, 0.6, 0.3])
    halves = []
    for seed in (3, 4):
        half = (image * make_radiance(shape, seed)).astype(np.float32)
        half[: shape[0] // 3, : shape[1] // 3] = 0.0
        halves.append(half)
    return halves[0], halves[1]


def noise_guide_reference(a: FloatArray, b: FloatArray) -> NDArray[np.float64]:
    """Return the guide from its definition, float64."""
    both = np.stack([a, b]).astype(np.float64)
    logs = np.log(both + LOG_OFFSET_SHARE * LEVEL)
    spread = 0.25 * np.mean((logs[0] - logs[1]) ** 2, axis=-1)
    variance = gaussian_filter(spread, 1.0, mode="nearest", radius=3)
    return np.concatenate([logs.mean(axis=0), variance[..., None] + MIN_VARIANCE], axis=-1)


def assert_is_guide(guide: FloatArray, expected: NDArray[np.float64]) -> None:
    """Raise AssertionError unless a guide is as expected, as far as its logarithms are good."""
    assert guide.dtype == np.float32
    assert guide.shape == expected.shape
    np.testing.assert_allclose(guide[..., :3], expected[..., :3], rtol=1e-6, atol=1.2 * LOGARITHM)
    # The error of d^2 / 4 is d / 2 times the error of the difference d, which is that of two logarithms.
    d = np.sqrt(4.0 * expected[..., 3].max())
    np.testing.assert_allclose(guide[..., 3], expected[..., 3], rtol=1e-5, atol=1.2 * LOGARITHM * d)


def check_guide(shape: tuple[int, int]) -> None:
    """Raise AssertionError unless the guide of random halves of a size is as its definition says."""
    a, b = make_halves(shape)
    assert_is_guide(make_noise_guide(a, b, LEVEL), noise_guide_reference(a, b))


@pytest.mark.sampled("cpu", "vulkan")
@given(shape=SIZES)
def test_guide_is_as_defined(shape: tuple[int, int]) -> None:
    check_guide(shape)


def test_variance_of_one_pixel_is_spread_by_the_gaussian() -> None:
    # Put the pixel at a border, so that pixels beyond the border count too.
    shape, (row, column) = (12, 15), (0, 5)
    a, b = np.ones((*shape, 3), np.float32), np.ones((*shape, 3), np.float32)
    b[row, column, 1] = 3.0
    guide = make_noise_guide(a, b, LEVEL)
    offset = LOG_OFFSET_SHARE * LEVEL
    spread = np.zeros(shape)
    spread[row, column] = 0.25 / 3.0 * np.log((3.0 + offset) / (1.0 + offset)) ** 2
    expected = gaussian_filter(spread, 1.0, mode="nearest", radius=3)
    found = guide[..., 3] - np.float32(MIN_VARIANCE)
    np.testing.assert_allclose(found, expected, rtol=5e-4, atol=1e-7)


def test_a_black_image_has_a_guide() -> None:
    black = np.zeros((5, 7, 3), np.float32)
    guide = make_noise_guide(black, black, 0.0)
    assert np.isfinite(guide).all()
    np.testing.assert_allclose(guide[..., :3], np.log(1e-30), rtol=1e-5)
    np.testing.assert_array_equal(guide[..., 3], np.float32(MIN_VARIANCE))


def make_samples(shape: tuple[int, int]) -> tuple[tuple[FloatArray, FloatArray], FloatArray, NDArray[np.bool_]]:
    """Return halves with bad pixels, an albedo that is black and bad at some, and a mask."""
    rng = np.random.default_rng(8)
    a, b = make_halves(shape)
    albedo = rng.uniform(0.0, 1.0, (*shape, 3)).astype(np.float32)
    for image in (a, b, albedo):
        image[rng.random(shape) < 0.1] = np.nan
        image[rng.random(shape) < 0.05, 1] = -1.0
        image[rng.random(shape) < 0.05, 2] = np.inf
    albedo[rng.random(shape) < 0.1] = 0.5 * ALBEDO_FLOOR
    return (a, b), albedo, rng.random(shape) > 0.3


def light_reference(
    halves: tuple[FloatArray, FloatArray], albedo: FloatArray | None, mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the light of every pixel from its definition, float64, 0 where nothing has meaning."""
    tint = np.ones((*mask.shape, 3)) if albedo is None else albedo.astype(np.float64)
    told = (np.isfinite(tint) & (tint >= 0.0)).all(axis=-1) & (tint > ALBEDO_FLOOR).any(axis=-1)
    light = np.zeros((2, *mask.shape))
    good = np.zeros((2, *mask.shape), bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        for k, half in enumerate(halves):
            good[k] = (np.isfinite(half) & (half >= 0.0)).all(axis=-1) & told & mask
            light[k] = np.where(good[k], (half / np.maximum(tint, ALBEDO_FLOOR)) @ LUMINANCE, 0.0)
    return np.asarray(light.sum(axis=0) / np.maximum(good.sum(axis=0), 1))


def check_light(shape: tuple[int, int], tinted: bool) -> None:
    """Raise AssertionError unless the light of random halves of a size is as its definition says."""
    halves, albedo, mask = make_samples(shape)
    tint = albedo if tinted else None
    rows = measure_light(halves, tint, mask)
    expected = light_reference(halves, tint, mask)
    np.testing.assert_allclose(rows[:, 0], expected.sum(axis=1), rtol=1e-5, atol=1e-30)
    np.testing.assert_array_equal(rows[:, 1], mask.sum(axis=1))
    if mask.any():
        assert compute_mean_light(rows) == pytest.approx(expected[mask].mean(), rel=1e-5, abs=1e-30)


@pytest.mark.sampled("cpu", "vulkan")
@given(shape=SIZES, tinted=st.booleans())
def test_light_is_measured_as_defined(shape: tuple[int, int], tinted: bool) -> None:
    check_light(shape, tinted)


def test_the_level_of_an_image_is_that_of_its_bands() -> None:
    halves, albedo, mask = make_samples((70, 65))
    whole = measure_light(halves, albedo, mask)
    for height in (1, 2, 7, 32, 69):
        cuts = [slice(top, top + height) for top in range(0, 70, height)]
        bands = [measure_light((halves[0][cut], halves[1][cut]), albedo[cut], mask[cut]) for cut in cuts]
        np.testing.assert_array_equal(np.concatenate(bands), whole)


def test_nothing_is_as_bright_as_nothing() -> None:
    halves, albedo, mask = make_samples((9, 9))
    assert compute_mean_light(measure_light(halves, albedo, np.zeros_like(mask))) == 0.0
    assert compute_mean_light(measure_light(halves, np.zeros_like(albedo), mask)) == 0.0
    huge = np.full((9, 9, 3), 3e38, np.float32)
    assert compute_mean_light(measure_light((huge, huge), np.full_like(huge, 0.01), mask)) == 0.0


def test_every_size_has_one_kernel() -> None:
    make_noise_guide(*make_halves((3, 4)), LEVEL)
    measure_light(*make_samples((3, 4)))
    before = count_compiled_kernels()
    make_noise_guide(*make_halves((40, 3)), LEVEL)
    measure_light(*make_samples((40, 3)))
    assert count_compiled_kernels() == before


def test_images_of_another_size_are_refused() -> None:
    a, b = make_halves((8, 9))
    with refuses(InputError, "half", "float32 of shape (8, 8, 3)"):
        make_noise_guide(a, b[:, :8], LEVEL)
    with refuses(InputError, "half", "float32 of shape (8, 9, 2)"):
        make_noise_guide(a[..., :2], b, LEVEL)
    with refuses(InputError, "half b"):
        measure_light((a, b[:7]), None, np.ones((8, 9), bool))
    with refuses(InputError, "albedo"):
        measure_light((a, b), a[..., 0], np.ones((8, 9), bool))
