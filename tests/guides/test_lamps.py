"""Lamps are found by their brightness and by having no noise; noise, textures and even light are none."""

import numpy as np
import pytest

from lobewise.guides.lamps import mark_lamps

LAMP = np.s_[20:30, 40:60]


def make_wall(rng: np.random.Generator, spp: int, brightness: float = 15.0) -> np.ndarray:
    """Return a noisy wall with a lamp on it."""
    wall = 0.4 * rng.gamma(spp, 1.0 / spp, (64, 96, 3)).astype(np.float32)
    wall[LAMP] += brightness * np.array([1.0, 0.8, 0.5], np.float32)
    return wall


@pytest.mark.parametrize(("spp", "brightness"), [(1, 60.0), (16, 15.0), (256, 15.0)])
def test_a_lamp_is_found_whole_and_nothing_else(rng: np.random.Generator, spp: int, brightness: float) -> None:
    found = mark_lamps(make_wall(rng, spp, brightness))
    there = np.zeros_like(found)
    there[LAMP] = True
    beside = np.zeros_like(found)
    beside[18:32, 38:62] = True
    assert found[there].mean() > 0.97
    assert found[~beside].sum() == 0


def test_the_edge_of_a_lamp_belongs_to_it(rng: np.random.Generator) -> None:
    wall = make_wall(rng, 64)
    wall[19, 40:60] += 0.3 * np.float32(15.0)
    assert mark_lamps(wall)[19, 40:60].all()


def make_dark_wall(rng: np.random.Generator) -> np.ndarray:
    """Return a noisy dark wall with four pixels that are alike by chance."""
    wall = 0.01 * rng.gamma(4.0, 0.25, (64, 96, 3)).astype(np.float32)
    wall[20:22, 40:42] = 0.5
    return wall


@pytest.mark.parametrize("place", [(20, 43), (19, 42), (23, 41), (18, 38)])
def test_a_firefly_beside_alike_pixels_is_no_edge(rng: np.random.Generator, place: tuple[int, int]) -> None:
    wall = make_dark_wall(rng)
    wall[place] = 121.0
    found = mark_lamps(wall)
    assert found[20:22, 40:42].all()
    assert not found[place]


def test_the_edge_of_an_uneven_lamp_may_be_a_little_brighter(rng: np.random.Generator) -> None:
    wall = make_dark_wall(rng)
    # Three of four samples hit the lamp inside, all four beside it.
    wall[20:22, 42] = 0.5 * 4.0 / 3.0
    assert mark_lamps(wall)[20:22, 40:43].all()


def test_an_edge_is_as_bright_as_its_lamp_before_division_by_the_albedo(rng: np.random.Generator) -> None:
    light, albedo = make_dark_wall(rng), np.full((64, 96, 3), 0.8, np.float32)
    albedo[20:22, 40:42] = 0.1
    # Divided by its albedo, the first is as bright as the lamp, the second is ten times as bright.
    light[20, 42], light[21, 42] = 0.5, 5.0
    albedo[21, 42] = 0.01
    found = mark_lamps(light * albedo, albedo)
    assert found[20:22, 40:42].all()
    assert not found[20, 42]
    assert found[21, 42]


def test_even_light_noise_and_sparks_are_no_lamps(rng: np.random.Generator) -> None:
    assert not mark_lamps(np.ones((40, 40, 3), np.float32)).any()
    assert not mark_lamps(rng.gamma(0.1, 10.0, (64, 64, 3)).astype(np.float32)).any()
    sparks = 0.2 * np.ones((64, 64, 3), np.float32)
    sparks[10, 10] = sparks[30, 41] = 50.0
    assert not mark_lamps(sparks).any()


def test_a_lamp_that_is_little_brighter_is_left_to_the_filter(rng: np.random.Generator) -> None:
    assert not mark_lamps(make_wall(rng, 64, brightness=1.0)).any()


def test_bad_pixels_are_no_lamps(rng: np.random.Generator) -> None:
    wall = make_wall(rng, 16)
    wall[5:9, 5:9] = np.inf
    wall[40:44, 5:9] = np.nan
    wall[40:44, 70:74] = -100.0
    found = mark_lamps(wall)
    assert found[LAMP].mean() > 0.97
    assert not found[5:9, 5:9].any()
    assert not found[40:44].any()


def test_the_inside_of_a_large_lamp_is_found_as_far_as_a_filter_reaches(rng: np.random.Generator) -> None:
    wall = 0.3 * rng.gamma(4.0, 0.25, (160, 160, 3)).astype(np.float32)
    wall[:, 40:] = 12.0
    assert mark_lamps(wall)[:, 40:60].all()


def test_sizes_down_to_one_pixel() -> None:
    for height, width in ((1, 1), (1, 7), (5, 1), (2, 3)):
        assert mark_lamps(np.ones((height, width, 3), np.float32)).shape == (height, width)
