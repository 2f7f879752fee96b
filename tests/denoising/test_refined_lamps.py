"""lobewise.denoising.refining.lamps: what the network sees and changes of lamps and skies."""

from __future__ import annotations

import numpy as np
import pytest

from lobewise.denoising.refining.lamps import (
    NEAR_PIXELS,
    find_edges,
    find_refined,
    find_shining,
    find_small,
    widen_mask,
)


def make_mask(*places: tuple[slice | int, slice | int]) -> np.ndarray:
    """Return a mask of 40x40 pixels that is set at some places."""
    mask = np.zeros((40, 40), bool)
    for place in places:
        mask[place] = True
    return mask


def test_a_pixel_shines_where_most_light_is_scattered_by_no_surface() -> None:
    part, rest = np.full((2, 3, 3), 0.5, np.float32), np.zeros((2, 3, 3), np.float32)
    rest[0, 1], rest[1, 2], part[1, 2] = 2.0, 0.4, np.nan
    assert find_shining(rest, [part, part]).tolist() == [[False, True, False], [False, False, True]]


def test_a_lamp_of_few_pixels_is_small() -> None:
    small = find_small(make_mask((5, 5), (slice(20, 22), slice(20, 22))))
    assert np.argwhere(small).tolist() == [[5, 5], [20, 20], [20, 21], [21, 20], [21, 21]]


def test_single_pixels_near_a_large_lamp_belong_to_it() -> None:
    lamp = (slice(10, 13), slice(10, 13))
    small = find_small(make_mask(lamp, (11, 12 + NEAR_PIXELS), (11, 14 + NEAR_PIXELS)))
    assert np.argwhere(small).tolist() == [[11, 14 + NEAR_PIXELS]]


def test_a_lamp_at_the_border_of_the_image_is_as_large_as_it_goes_on() -> None:
    assert not find_small(make_mask((slice(0, 2), slice(0, 2)))).any()


def test_two_pixels_on_both_sides_of_an_edge_are_refined() -> None:
    lamp = make_mask((slice(10, 30), slice(10, 30)))
    inside = ~find_refined([~lamp])
    assert np.array_equal(inside, make_mask((slice(12, 28), slice(12, 28))))
    assert np.array_equal(find_edges(lamp), make_mask((slice(8, 32), slice(8, 32))))


@pytest.mark.parametrize("pixels", [0, 1, 2, 9])
def test_a_mask_grows_by_any_width(pixels: int, rng: np.random.Generator) -> None:
    mask = rng.random((23, 31)) < 0.01
    rows, columns = np.indices(mask.shape)
    near = [np.maximum(abs(rows - y), abs(columns - x)) <= pixels for y, x in np.argwhere(mask)]
    assert np.array_equal(widen_mask(mask, pixels), np.logical_or.reduce(near))
