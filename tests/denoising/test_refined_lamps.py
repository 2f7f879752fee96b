"""lobewise.denoising.refining.lamps: what the network sees and changes of lamps and skies."""

import numpy as np
import pytest

from lobewise import engine
from lobewise.denoising.refining.lamps import mark_refined, mark_shining
from lobewise.filters.refinement.steps import define_refined, define_widened


def make_mask(*places: tuple[slice | int, slice | int]) -> np.ndarray:
    """Return a mask of 40x40 pixels that is set at some places."""
    mask = np.zeros((40, 40), bool)
    for place in places:
        mask[place] = True
    return mask


def test_a_pixel_shines_where_most_light_is_scattered_by_no_surface() -> None:
    part, rest = np.full((2, 3, 3), 0.5, np.float32), np.zeros((2, 3, 3), np.float32)
    rest[0, 1], rest[1, 2], part[1, 2] = 2.0, 0.4, np.nan
    assert mark_shining(rest, [part, part]).tolist() == [[False, True, False], [False, False, True]]


def test_two_pixels_on_both_sides_of_an_edge_are_refined() -> None:
    lamp = make_mask((slice(10, 30), slice(10, 30)))
    inside = ~mark_refined([~lamp])
    assert np.array_equal(inside, make_mask((slice(12, 28), slice(12, 28))))


def widen_mask(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Return a mask that is so many pixels wider in all eight directions."""
    return engine.pixels(define_widened, {"mask": mask}, {}, pixels)[0]


@pytest.mark.parametrize("pixels", [0, 1, 2, 9])
def test_a_mask_grows_by_any_width(pixels: int, rng: np.random.Generator) -> None:
    mask = rng.random((23, 31)) < 0.01
    rows, columns = np.indices(mask.shape)
    near = [np.maximum(abs(rows - y), abs(columns - x)) <= pixels for y, x in np.argwhere(mask)]
    assert np.array_equal(widen_mask(mask, pixels), np.logical_or.reduce(near))


@pytest.mark.parametrize("place", [(0, 19), (39, 0), (1, 38)])
def test_a_mask_at_the_border_grows_without_gaps(place: tuple[int, int]) -> None:
    rows, columns = np.indices((40, 40))
    near = np.maximum(abs(rows - place[0]), abs(columns - place[1])) <= 9
    assert np.array_equal(widen_mask(make_mask(place), 9), near)


def test_lamps_are_scaled_but_for_their_inside() -> None:
    shape = (3, 4, 3)
    part, rest, filtered = (np.full(shape, value, np.float32) for value in (0.5, 2.0, 2.5))
    refined = np.ones((3, 4), bool)
    refined[0], filtered[2, 3] = False, 0.0
    images = {"image": 3.0 * filtered, "filtered": filtered, "refined": refined, "part0": part, "rest": rest}
    found = engine.pixels(define_refined, images, {}, 1e-36)
    factor = np.where(refined, 3.0, 1.0)
    factor[2, 3] = 0.0
    np.testing.assert_array_equal(found[0], part * factor[..., None])
    np.testing.assert_array_equal(found[1], rest * factor[..., None])
