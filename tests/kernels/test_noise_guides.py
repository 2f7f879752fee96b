"""The guide of a paired pass against NumPy's logarithm and SciPy's Gaussian."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lobewise.errors import InputError
from lobewise.frame import FloatArray
from lobewise.kernels.engine import count_compiled_kernels
from lobewise.kernels.noise_guides import make_noise_guide
from tests.kernels.frames import make_mask, make_radiance

DARKEST = 0.04
VARIANCE_FLOOR = 5e-4
# The kernels' log2 is good to 1e-4, of which a natural logarithm has ln 2.
LOGARITHM = 7e-5
SHAPES = [(1, 1), (1, 9), (9, 1), (2, 3), (33, 17), (70, 65)]


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


def noise_guide_reference(a: FloatArray, b: FloatArray, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the guide from its definition, float64."""
    both = np.stack([a, b]).astype(np.float64)
    logs = np.log(both + DARKEST * both[:, mask].mean())
    spread = 0.25 * np.mean((logs[0] - logs[1]) ** 2, axis=-1)
    variance = gaussian_filter(spread, 1.0, mode="nearest", radius=3)
    return np.concatenate([logs.mean(axis=0), variance[..., None] + VARIANCE_FLOOR], axis=-1)


def assert_is_guide(guide: FloatArray, expected: NDArray[np.float64]) -> None:
    """Raise AssertionError unless a guide is as expected, as far as its logarithms are good."""
    assert guide.dtype == np.float32
    assert guide.shape == expected.shape
    np.testing.assert_allclose(guide[..., :3], expected[..., :3], rtol=1e-6, atol=1.2 * LOGARITHM)
    # A quarter of the square of a difference d is out by half of d times its error, which is that of two logarithms.
    d = np.sqrt(4.0 * expected[..., 3].max())
    np.testing.assert_allclose(guide[..., 3], expected[..., 3], rtol=1e-5, atol=1.2 * LOGARITHM * d)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_guide_is_as_defined(shape: tuple[int, int]) -> None:
    a, b = make_halves(shape)
    assert_is_guide(make_noise_guide(a, b, make_mask(shape)), noise_guide_reference(a, b, make_mask(shape)))


def test_variance_of_one_pixel_is_spread_by_the_gaussian() -> None:
    # At a border, so that what lies beyond it counts too.
    shape, (row, column) = (12, 15), (0, 5)
    a, b = np.ones((*shape, 3), np.float32), np.ones((*shape, 3), np.float32)
    b[row, column, 1] = 3.0
    guide = make_noise_guide(a, b, make_mask(shape))
    offset = DARKEST * np.mean([a, b])
    spread = np.zeros(shape)
    spread[row, column] = 0.25 / 3.0 * np.log((3.0 + offset) / (1.0 + offset)) ** 2
    expected = gaussian_filter(spread, 1.0, mode="nearest", radius=3)
    found = guide[..., 3] - np.float32(VARIANCE_FLOOR)
    np.testing.assert_allclose(found, expected, rtol=5e-4, atol=1e-7)


def test_alike_halves_have_the_least_variance() -> None:
    a, _ = make_halves((33, 17))
    guide = make_noise_guide(a, a, make_mask((33, 17)))
    np.testing.assert_array_equal(guide[..., 3], np.float32(VARIANCE_FLOOR))


@pytest.mark.parametrize("scale", [1e-4, 7.0, 1e5])
def test_a_brighter_image_shifts_the_logarithms_alone(scale: float) -> None:
    a, b = make_halves((33, 17))
    guide = make_noise_guide(a, b, make_mask((33, 17)))
    brighter = make_noise_guide(np.float32(scale) * a, np.float32(scale) * b, make_mask((33, 17)))
    np.testing.assert_allclose(brighter[..., :3] - guide[..., :3], np.log(scale), atol=2.4 * LOGARITHM)
    d = np.sqrt(4.0 * guide[..., 3].max())
    np.testing.assert_allclose(brighter[..., 3], guide[..., 3], rtol=1e-5, atol=2.4 * LOGARITHM * d)


def test_halves_may_change_places() -> None:
    a, b = make_halves((33, 17))
    guide, swapped = make_noise_guide(a, b, make_mask((33, 17))), make_noise_guide(b, a, make_mask((33, 17)))
    np.testing.assert_array_equal(swapped, guide)


def test_what_is_masked_does_not_count_in_the_mean() -> None:
    shape = (33, 17)
    a, b = make_halves(shape)
    mask = np.random.default_rng(1).random(shape) > 0.4
    # As a pass leaves it: 0. Whatever lies there, the mean is that of the others.
    expected = noise_guide_reference(a, b, mask)
    assert_is_guide(make_noise_guide(a, b, mask), expected)
    for value in (0.0, 1e6):
        c, d = (np.where(mask[..., None], half, np.float32(value)) for half in (a, b))
        changed, guide = make_noise_guide(c, d, mask), make_noise_guide(a, b, mask)
        np.testing.assert_array_equal(changed[mask][:, :3], guide[mask][:, :3])


@pytest.mark.parametrize("masked", [False, True])
def test_a_black_image_has_a_guide(masked: bool) -> None:
    black, mask = np.zeros((5, 7, 3), np.float32), np.full((5, 7), not masked)
    guide = make_noise_guide(black, black, mask)
    assert np.isfinite(guide).all()
    np.testing.assert_allclose(guide[..., :3], np.log(1e-30), rtol=1e-5)
    np.testing.assert_array_equal(guide[..., 3], np.float32(VARIANCE_FLOOR))


def test_any_layout_of_the_arrays_will_do() -> None:
    a, b = make_halves((33, 17))
    mask = np.random.default_rng(1).random((33, 17)) > 0.2
    expected = make_noise_guide(a, b, mask)
    frozen = a.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(make_noise_guide(frozen, np.asfortranarray(b), mask[::-1][::-1]), expected)
    # What lies before and behind an image is none of the kernel's business.
    flat = np.full(a.size + 512, np.nan, np.float32)
    flat[256:-256] = a.ravel()
    np.testing.assert_array_equal(make_noise_guide(flat[256:-256].reshape(a.shape), b, mask), expected)


def test_every_size_has_one_kernel() -> None:
    make_noise_guide(*make_halves((3, 4)), make_mask((3, 4)))
    before = count_compiled_kernels()
    make_noise_guide(*make_halves((40, 3)), make_mask((40, 3)))
    assert count_compiled_kernels() == before


def test_images_of_another_size_are_refused() -> None:
    a, b = make_halves((8, 9))
    with pytest.raises(InputError, match="shape"):
        make_noise_guide(a, b[:, :8], make_mask((8, 9)))
    with pytest.raises(InputError, match="shape"):
        make_noise_guide(a[..., :2], b, make_mask((8, 9)))


PROGRAM = """
import sys
from tests.kernels.test_noise_guides import *
sys.stdout.buffer.write(make_noise_guide(*make_halves((131, 67)), make_mask((131, 67))).tobytes())
"""


def test_threads_and_another_run_change_nothing() -> None:
    expected = make_noise_guide(*make_halves((131, 67)), make_mask((131, 67))).tobytes()
    assert make_noise_guide(*make_halves((131, 67)), make_mask((131, 67))).tobytes() == expected
    alone = {**os.environ, "HL_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, check=True, env=alone)
    assert done.stdout == expected
