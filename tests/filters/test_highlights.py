"""Highlights against the definition in NumPy: spots that are highlights or not, bad numbers, sums of the parts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.filters.highlights import (
    MIN_BLOCK_RATIO,
    MIN_CORNER_RATIO,
    MIN_HIGHLIGHT_EDGE_RATIO,
    MIN_RING_PIXELS,
    RING_RADIUS,
    SPOT_RADIUS,
    split_highlights,
)
from tests.filters.sizes import SMALL_SIZES
from tests.filters.test_fireflies import compute_light, make_case

Image = NDArray[np.float32]


def list_blocks(least: NDArray[np.float64], row: int, column: int, side: int) -> list[NDArray[np.float64]]:
    """Return the values of all blocks that hold a pixel, the pixels outside the image as -1."""
    padded = np.pad(least, side, constant_values=-1.0)
    corners = [(row - dy + side, column - dx + side) for dy in range(side) for dx in range(side)]
    return [padded[y : y + side, x : x + side].ravel() for y, x in corners]


def compute_slowly(halves: tuple[Image, Image], albedo: Image | None, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the share of every pixel that is split off, by its definition, pixel by pixel."""
    lights = np.stack([compute_light(half, albedo, mask) for half in halves])
    known = ~np.isnan(lights)
    filled = np.where(known, lights, 0.0)
    count = known.sum(axis=0)
    both = np.where(count > 0, filled.sum(axis=0) / np.maximum(count, 1), -1.0)
    least = np.where(known.all(axis=0), filled.min(axis=0), np.where(count > 0, filled.max(axis=0), -1.0))
    height, width = mask.shape
    level, core = np.full(mask.shape, np.inf), np.zeros(mask.shape, bool)
    for y, x in np.ndindex(mask.shape):
        ring = [
            both[j, i]
            for j in range(max(y - RING_RADIUS, 0), min(y + RING_RADIUS + 1, height))
            for i in range(max(x - RING_RADIUS, 0), min(x + RING_RADIUS + 1, width))
            if max(abs(j - y), abs(i - x)) > SPOT_RADIUS and both[j, i] >= 0.0
        ]
        if len(ring) >= MIN_RING_PIXELS:
            level[y, x] = np.mean(ring)
        if least[y, x] < 0.0:
            continue
        for block in list_blocks(least, y, x, 2):
            lowest, second = np.sort(block)[:2]
            core[y, x] |= lowest > MIN_BLOCK_RATIO * level[y, x]
            core[y, x] |= least[y, x] >= second > MIN_CORNER_RATIO * level[y, x]
    around = np.pad(core, 1)
    near = np.any(
        [around[1 + j : 1 + j + height, 1 + i : 1 + i + width] for j in (-1, 0, 1) for i in (-1, 0, 1)], axis=0
    )
    taken = core | (near & (both > MIN_HIGHLIGHT_EDGE_RATIO * level))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(taken & (both > level), 1.0 - level / both, 0.0)


def make_spots(size: tuple[int, int], strange: bool = True) -> tuple[tuple[Image, Image], Image, NDArray[np.bool_]]:
    """Return noisy halves with spots of all shapes that 3x3 pixels have."""
    halves, albedo, mask = make_case(size, strange)
    rng = np.random.default_rng(11)
    for _ in range(size[0] * size[1] // 150):
        y, x = rng.integers(0, size[0]), rng.integers(0, size[1])
        shape = rng.random((3, 3)) < 0.93
        bright = rng.uniform(60.0, 200.0)
        for half in halves:
            part, tint = half[y : y + 3, x : x + 3], albedo[y : y + 3, x : x + 3]
            where = shape[: part.shape[0], : part.shape[1]]
            part[where] = np.float32(bright) * tint[where]
    return halves, albedo, mask


def check_definition(size: tuple[int, int], strange: bool) -> NDArray[np.float64]:
    """Return the share of every pixel that is split off, after both halves were compared with the definition."""
    halves, albedo, mask = make_spots(size, strange)
    share = compute_slowly(halves, albedo, mask)
    found = split_highlights(halves, albedo, mask)
    for half, rest in zip(halves, (found.a, found.b), strict=True):
        with np.errstate(invalid="ignore", over="ignore"):
            known = ~np.isnan(compute_light(half, albedo, mask))
            wanted = np.where(known[..., None], half * (1.0 - share[..., None]), half)
        np.testing.assert_allclose(rest, wanted, rtol=2e-4, atol=1e-6)
    return share


@pytest.mark.sampled("cpu", "vulkan")
@given(size=SMALL_SIZES, strange=st.booleans())
def test_agrees_with_the_definition(size: tuple[int, int], strange: bool) -> None:
    check_definition(size, strange)


def test_highlights_are_there_to_be_seen() -> None:
    # One of the strange numbers would outshine every spot.
    assert 0.005 < (check_definition((70, 41), strange=False) > 0.0).mean() < 0.3


def put(*pixels: tuple[int, int], value: float = 30.0) -> Image:
    """Return an even image with some bright pixels."""
    image = np.full((25, 27, 3), 0.5, np.float32)
    for y, x in pixels:
        image[y, x] = value
    return image


SQUARE = ((10, 10), (10, 11), (11, 10), (11, 11))


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (SQUARE, True),
        (SQUARE[:3], True),
        (((10, 10), (10, 11)), False),
        (((10, 10), (11, 11)), False),
        (((10, 10), (12, 12), (10, 12), (12, 10)), False),
        (((10, 10),), False),
    ],
    ids=["square", "corner", "pair", "diagonal", "apart", "firefly"],
)
def test_neighbours_must_agree(pixels: tuple[tuple[int, int], ...], expected: bool) -> None:
    image = put(*pixels)
    found = split_highlights((image, image), None, np.ones(image.shape[:2], bool))
    where = np.zeros(image.shape[:2], bool)
    if expected:
        where[tuple(zip(*pixels, strict=True))] = True
    np.testing.assert_array_equal((found.highlights > 0.0).all(axis=-1), where)
    np.testing.assert_allclose(found.highlights[where], 29.5, rtol=1e-5)


def count_highlights(first: Image, second: Image) -> int:
    found = split_highlights((first, second), None, np.ones(first.shape[:2], bool))
    return int(np.count_nonzero(found.highlights.any(axis=-1)))


def test_one_half_alone_proves_nothing() -> None:
    image = put(*SQUARE)
    assert count_highlights(image, put()) == 0
    # Of a checkerboard's colours each pixel has but one.
    even = (np.add.outer(np.arange(25), np.arange(27)) % 2 == 0)[..., None]
    a, b = np.where(even, image, np.float32(np.nan)), np.where(even, np.float32(np.nan), image)
    assert count_highlights(a, b) == 4
    assert np.isnan(split_highlights((a, b), None, np.ones(image.shape[:2], bool)).a[~even[..., 0]]).all()


def test_a_wide_light_is_none() -> None:
    image = put(*[(y, x) for y in range(3, 22) for x in range(3, 24)])
    found = split_highlights((image, image), None, np.ones(image.shape[:2], bool))
    assert not found.highlights[8:17, 8:19].any()


def test_sizes_are_checked() -> None:
    image = put()
    with pytest.raises(InputError):
        split_highlights((image, image[:-1]), None, np.ones(image.shape[:2], bool))
