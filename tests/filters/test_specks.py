"""Specks of blurred lights against the definition in NumPy: light that is moved or stays, borders, bad numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.filters.specks import MAX_MIXED_SHARE, MIN_MIXED, SPREAD_RADIUS, WINDOW_RADIUS, share_out_specks
from lobewise.lobes.vectors import LUMINANCE

Image = NDArray[np.float32]
SIZES = [(1, 1), (1, 9), (3, 2), (17, 33), (70, 41)]


def cut(image: NDArray[np.float64], y: int, x: int, radius: int) -> NDArray[np.float64]:
    """Return the part of a square around a pixel that lies in the image."""
    return image[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1]


def share_slowly(light: Image, share: Image) -> NDArray[np.float64]:
    """Return the gain by its definition, pixel by pixel."""
    with np.errstate(invalid="ignore", over="ignore"):
        bright = light.astype(np.float64) @ np.array(LUMINANCE)
    bright = np.where(np.isfinite(bright) & (bright > 0.0) & (bright < 1e38), bright, 0.0)
    mixed = (share < MAX_MIXED_SHARE).astype(np.float64)
    pixels = list(np.ndindex(*share.shape))
    blurred, near, low = (np.zeros(share.shape) for _ in range(3))
    for y, x in pixels:
        blurred[y, x] = cut(mixed, y, x, WINDOW_RADIUS).mean() > MIN_MIXED
    for y, x in pixels:
        near[y, x] = cut(blurred, y, x, WINDOW_RADIUS).any()
        around = [
            bright[y + j, x + i] if 0 <= y + j < share.shape[0] and 0 <= x + i < share.shape[1] else 0.0
            for j in (-1, 0, 1)
            for i in (-1, 0, 1)
            if (i, j) != (0, 0)
        ]
        low[y, x] = min(bright[y, x], sorted(around)[-4]) if near[y, x] else bright[y, x]
    takes, total = low * near, low.copy()
    for y, x in pixels:
        above, sum_around = bright[y, x] - low[y, x], cut(takes, y, x, SPREAD_RADIUS).sum()
        if sum_around > 0.0:
            rows = slice(max(y - SPREAD_RADIUS, 0), y + SPREAD_RADIUS + 1)
            columns = slice(max(x - SPREAD_RADIUS, 0), x + SPREAD_RADIUS + 1)
            total[rows, columns] += above * takes[rows, columns] / sum_around
        else:
            total[y, x] += above
    return np.divide(total, bright, out=np.ones(share.shape), where=bright > 0.0)


def make_case(size: tuple[int, int]) -> tuple[Image, Image]:
    """Return noisy light, black in part, and shares of objects, mixed around half of the pixels."""
    rng = np.random.default_rng(3)
    light = rng.gamma(0.5, 1.0, (*size, 3)).astype(np.float32)
    light[rng.random(size) < 0.2] = 0.0
    share = np.where(np.arange(size[1]) < size[1] // 2 + 1, rng.uniform(0.5, 1.0, size), 1.0).astype(np.float32)
    return light, share


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_against_the_definition(size: tuple[int, int]) -> None:
    light, share = make_case(size)
    wanted = share_slowly(light, share)
    np.testing.assert_allclose(share_out_specks(light, share), wanted, rtol=1e-4, atol=1e-6)
    if size == SIZES[-1]:
        assert 0.1 < (wanted != 1.0).mean() < 0.9


def test_light_is_moved_and_not_taken() -> None:
    light, share = make_case((70, 41))
    bright = light.astype(np.float64) @ np.array(LUMINANCE)
    gain = share_out_specks(light, share)
    assert (bright * gain).sum() == pytest.approx(bright.sum(), rel=1e-5)
    assert gain.min() < 0.1
    # Black pixels stay black.
    assert (gain[bright == 0.0] == 1.0).all()


def test_a_disc_out_of_focus_gets_a_rim_and_keeps_its_light() -> None:
    """Eight samples of every pixel see a disc of which the rim is a ramp, or the dark behind it."""
    y, x = np.mgrid[:40, :40] - 19.7
    covered = np.clip((9.0 - np.hypot(x, y)) / 5.0, 0.0, 0.8)
    seen = np.random.default_rng(5).binomial(8, covered) / 8.0
    light = np.float32(0.05 + 20.0 * seen)[..., None] * np.ones(3, np.float32)
    truth = 0.05 + 20.0 * covered
    share = np.maximum(seen, 1.0 - seen).astype(np.float32)
    shared = light[..., 0] * share_out_specks(light, share)
    errors = [np.mean((image - truth) ** 2 / (truth**2 + 0.01)) for image in (light[..., 0], shared)]
    assert errors[1] < 0.4 * errors[0]


@pytest.mark.parametrize("width", [1, 2])
def test_edges_in_focus_are_left_alone(width: int) -> None:
    """A bright line and its edges, two pixels wide, mix objects as well, but not over an area."""
    light, share = np.full((30, 30, 3), 0.1, np.float32), np.ones((30, 30), np.float32)
    light[:, 14 : 14 + width] = 50.0
    light[7, 7] = 50.0
    share[:, 13 : 15 + width] = 0.7
    share[6:9, 6:9] = 0.7
    np.testing.assert_array_equal(share_out_specks(light, share), np.ones((30, 30), np.float32))


def test_strange_light_counts_as_none() -> None:
    light, share = make_case((20, 20))
    share[...] = 0.6
    light[3, 4], light[10, 10, 1], light[15, 3] = np.nan, np.inf, -1.0
    gain = share_out_specks(light, share)
    assert np.isfinite(gain).all()
    assert gain[3, 4] == gain[10, 10] == gain[15, 3] == 1.0


def test_sizes_are_checked() -> None:
    light, share = make_case((20, 20))
    with pytest.raises(InputError):
        share_out_specks(light, share[:-1])
