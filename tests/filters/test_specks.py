"""Light out of focus against the definition in NumPy, pixel by pixel; lamps out of focus and in focus."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.filters.specks import choose_sharing, count_turns
from lobewise.lobes.vectors import LUMINANCE

Image = NDArray[np.float32]
SIZES = [(1, 1), (1, 9), (3, 2), (17, 33), (40, 31)]


def share(light: Image, radius: Image, spp: int | None) -> Image:
    """Return light that was shared out."""
    return choose_sharing(light, radius, spp).apply(light)


def cut(image: NDArray[np.float64], y: int, x: int, radius: int) -> NDArray[np.float64]:
    """Return the part of a square around a pixel that lies in the image."""
    return image[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1]


def mark_amid(bright: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which pixels are bright, or have bright ones in each of eight half-planes."""
    found = np.zeros(bright.shape, np.bool_)
    for y, x in np.ndindex(*bright.shape):
        floor = cut(bright, y, x, 2).max() / 3.0
        if floor > 0.0:
            rows, columns = np.nonzero(cut(bright, y, x, 5) >= floor)
            down, right = rows - min(y, 5), columns - min(x, 5)
            turns = [math.pi / 4.0 * k for k in range(8)]
            around = all((right * math.cos(turn) + down * math.sin(turn) > 1e-6).any() for turn in turns)
            found[y, x] = bright[y, x] >= floor or around
    return found


def share_slowly(light: Image, radius: Image, spp: int) -> NDArray[np.float64]:
    """Return the light by its definition: neighbours that share exchange a ninth of their difference, turn by turn."""
    known = np.nan_to_num(radius)
    turns = np.minimum(np.floor(6.0 * (known / spp) ** (2.0 / 3.0)), 10) * (known >= 1.5)
    shared = light.astype(np.float64)
    turns = turns * mark_amid(np.where(turns > 0, shared @ np.array(LUMINANCE), 0.0))
    for turn in range(10):
        before = shared.copy()
        for y, x in np.argwhere(turns > turn):
            for j, i in np.ndindex(3, 3):
                near = y + j - 1, x + i - 1
                if 0 <= near[0] < light.shape[0] and 0 <= near[1] < light.shape[1] and turns[near] > turn:
                    shared[y, x] += (before[near] - before[y, x]) / 9.0
    return hand_out(shared, radius)


def hand_out(light: NDArray[np.float64], radius: Image) -> NDArray[np.float64]:
    """Return light of which each pixel near a blurred one gave what is above its fourth brightest neighbour."""
    bright, pixels = light @ np.array(LUMINANCE), list(np.ndindex(*radius.shape))
    padded = np.pad(bright, 1, mode="edge")
    kept, near, total = bright.copy(), np.zeros(radius.shape), bright.copy()
    for y, x in pixels:
        near[y, x] = (cut(radius, y, x, 4) >= 1.5).any() and not radius[y, x] < 1.5
        around = np.sort(np.delete(padded[y : y + 3, x : x + 3].ravel(), 4))[::-1]
        if near[y, x]:
            kept[y, x] = min(bright[y, x], around[3])
    takes = kept * near
    for y, x in pixels:
        taken = cut(takes, y, x, 2).sum()
        if taken > 0.0:
            share = min((bright[y, x] - kept[y, x]) / taken, 0.25)
            total[y, x] -= share * taken
            cut(total, y, x, 2)[...] += share * cut(takes, y, x, 2)
    return light * np.divide(total, bright, out=np.ones_like(bright), where=bright > 0.0)[..., None]


def make_case(size: tuple[int, int]) -> tuple[Image, Image]:
    """Return light of a few bright pixels, and the radius of a blur, none in a part of the pixels."""
    rng = np.random.default_rng(3)
    light = rng.gamma(0.3, 1.0, (*size, 3)).astype(np.float32)
    light[rng.random(size) < 0.4] = 0.0
    radius = rng.uniform(-20.0, 60.0, size).clip(0.0)
    radius[rng.random(size) < 0.2] = np.nan
    return light, radius.astype(np.float32)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("spp", [1, 64])
def test_against_the_definition(size: tuple[int, int], spp: int) -> None:
    light, radius = make_case(size)
    shared = share(light, radius, spp)
    np.testing.assert_allclose(shared, share_slowly(light, radius, spp), rtol=1e-4, atol=1e-6)
    if size == SIZES[-1]:
        assert len(set(count_turns(light, radius, spp).flat)) > (2 if spp == 1 else 5)


def test_no_light_is_lost_and_parts_still_sum_to_the_whole() -> None:
    light, radius = make_case((40, 31))
    shared = share(light, radius, 1)
    luminance = np.array(LUMINANCE)
    assert (shared @ luminance).sum() == pytest.approx((light @ luminance).sum(), rel=1e-5)
    red = light * np.array([1.0, 0.0, 0.0], np.float32)
    sharing = choose_sharing(light, radius, 1)
    np.testing.assert_allclose(sharing.apply(red) + sharing.apply(light - red), shared, rtol=1e-4, atol=1e-6)
    assert np.abs(shared - light).max() > 1.0


def see_disc(spp: int, seed: int) -> tuple[Image, NDArray[np.float64]]:
    """Return what samples show of a lamp that the lens blurs over a disc of a radius of 6, and the truth."""
    y, x = np.mgrid[:40, :40] - 19.7
    covered = 0.1 * np.clip(6.5 - np.hypot(x, y), 0.0, 1.0)
    seen = np.random.default_rng(seed).binomial(spp, covered) / spp
    light, truth = (0.05 + 20.0 * each[..., None] * np.ones(3) for each in (seen, covered))
    return light.astype(np.float32), truth


@pytest.mark.parametrize(("spp", "most"), [(4, 0.2), (16, 0.35), (64, 0.8)])
def test_a_disc_out_of_focus_is_filled(spp: int, most: float) -> None:
    errors = np.zeros(2)
    for seed in range(8):
        light, truth = see_disc(spp, seed)
        shared = share(light, np.full((40, 40), 6.0, np.float32), spp)
        errors += [np.mean((image - truth) ** 2 / (truth**2 + 0.01)) for image in (light, shared)]
    assert errors[1] < most * errors[0]


def test_what_is_in_focus_neither_gives_nor_takes() -> None:
    light, _ = see_disc(16, 1)
    radius = np.full((40, 40), 6.0, np.float32)
    radius[:, :20] = 0.0
    shared = share(light, radius, 16)
    np.testing.assert_array_equal(shared[:, :20], light[:, :20])
    assert (shared[:, 20:] != light[:, 20:]).any()


@pytest.mark.parametrize("radius", [0.0, 1.4, np.nan, np.inf])
def test_light_stays_without_blur(radius: float) -> None:
    light, _ = see_disc(16, 1)
    np.testing.assert_array_equal(share(light, np.full((40, 40), radius, np.float32), None), light)
