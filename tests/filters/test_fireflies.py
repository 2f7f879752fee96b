"""Fireflies against the definition in NumPy: light that must go or stay, bad numbers, borders, threads."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.fireflies import (
    FIREFLY_REACH,
    MAX_RATIO_TO_HALF,
    MAX_RATIO_TO_WINDOW,
    MIN_WINDOW_PIXELS,
    bound_fireflies,
)
from lobewise.lobes.vectors import LUMINANCE
from tests.filters.sizes import SIZES
from tests.mistakes import refuses

Image = NDArray[np.float32]
STRANGE = np.float32([np.nan, np.inf, -np.inf, -1.0, 1e-42, 1e33])
# Relative error of a few operations in float32.
ROUNDING = 2e-6


def make_case(size: tuple[int, int], strange: bool = True) -> tuple[tuple[Image, Image], Image, NDArray[np.bool_]]:
    """Return two noisy halves with fireflies, an albedo and a mask."""
    rng = np.random.default_rng(7)
    a, b = rng.gamma(0.3, 1.0, (2, *size, 3)).astype(np.float32)
    albedo = rng.uniform(0.0, 1.0, (*size, 3)).astype(np.float32)
    for half in (a, b):
        half[rng.random(size) < 0.02] *= 50.0
    if strange:
        for image in (a, b, albedo):
            where = rng.random(image.shape) < 0.02
            image[where] = rng.choice(STRANGE, where.sum())
        albedo[rng.random(size) < 0.05] = 0.5 * ALBEDO_FLOOR
    return (a, b), albedo, rng.random(size) < 0.9


def compute_light(half: Image, albedo: Image | None, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return luminance over albedo, NaN where it does not count."""
    image = half.astype(np.float64)
    good = mask & (np.isfinite(image) & (image >= 0.0)).all(axis=-1)
    if albedo is not None:
        tint = albedo.astype(np.float64)
        with np.errstate(invalid="ignore"):
            good &= (np.isfinite(tint) & (tint >= 0.0)).all(axis=-1) & (tint > np.float32(ALBEDO_FLOOR)).any(axis=-1)
            image = image / np.maximum(tint, ALBEDO_FLOOR)
    return np.where(good, np.where(good[..., None], image, 0.0) @ np.array(LUMINANCE), np.nan)


def bound_slowly(
    halves: tuple[Image, Image], albedo: Image | None, mask: NDArray[np.bool_]
) -> tuple[list[NDArray[np.float64]], float]:
    """Return the bounded halves and the share taken, by sorting the whole window of every pixel."""
    lights = np.stack([compute_light(half, albedo, mask) for half in halves])
    count = (~np.isnan(lights)).sum(axis=0)
    means = np.where(count > 0, np.nan_to_num(lights).sum(axis=0) / np.maximum(count, 1), np.nan)
    padded = np.pad(means, FIREFLY_REACH, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * FIREFLY_REACH + 1, 2 * FIREFLY_REACH + 1)).reshape(
        *mask.shape, -1
    )
    others = np.delete(windows, windows.shape[-1] // 2, axis=-1)
    known = (~np.isnan(others)).sum(axis=-1)
    second = np.sort(np.nan_to_num(others, nan=-np.inf), axis=-1)[..., -2]
    window = np.where(known < MIN_WINDOW_PIXELS, np.inf, MAX_RATIO_TO_WINDOW * second)
    out = []
    seen = taken = 0.0
    for half, own, other in zip(halves, lights, lights[::-1], strict=True):
        bound = np.fmax(window, MAX_RATIO_TO_HALF * other)
        with np.errstate(invalid="ignore"):
            factor = np.where(own > bound, bound / own, 1.0)
        power = np.where(np.isnan(own), 0.0, np.nan_to_num(half.astype(np.float64), posinf=0.0) @ np.array(LUMINANCE))
        out.append(np.where(factor[..., None] < 1.0, half * factor[..., None], half))
        seen, taken = seen + power.sum(), taken + float((power * (1.0 - factor)).sum())
    return out, taken / seen if seen > 0.0 else 0.0


def check_definition(size: tuple[int, int], tinted: bool, strange: bool = True) -> float:
    """Return the share of light that is lost, after both halves were compared with the definition."""
    halves, albedo, mask = make_case(size, strange)
    tint = albedo if tinted else None
    expected, lost = bound_slowly(halves, tint, mask)
    bounded = bound_fireflies(halves, tint, mask)
    for got, want in zip(bounded[:2], expected, strict=True):
        np.testing.assert_allclose(got, want, rtol=ROUNDING, atol=np.finfo(np.float32).tiny)
    assert bounded.energy_lost == pytest.approx(lost, rel=1e-4 if strange else 1e-5, abs=1e-6)
    return bounded.energy_lost


@pytest.mark.sampled("cpu", "vulkan")
@given(size=SIZES, tinted=st.booleans(), strange=st.booleans())
def test_agrees_with_the_definition(size: tuple[int, int], tinted: bool, strange: bool) -> None:
    check_definition(size, tinted, strange)


@pytest.mark.parametrize("tinted", [False, True], ids=["plain", "albedo"])
def test_fireflies_are_there_to_be_seen(tinted: bool) -> None:
    assert 0.01 < check_definition((70, 41), tinted, strange=False) < 0.9


def make_flat(size: tuple[int, int] = (21, 25)) -> tuple[Image, Image, NDArray[np.bool_]]:
    flat = np.full((*size, 3), 0.5, np.float32)
    return flat.copy(), flat.copy(), np.ones(size, bool)


@pytest.mark.parametrize("place", [(10, 12), (0, 0), (20, 24), (0, 13)], ids=str)
@pytest.mark.parametrize("companions", [0, 1, 2])
def test_a_firefly_goes_and_a_glint_of_three_stays(place: tuple[int, int], companions: int) -> None:
    a, b, mask = make_flat()
    y, x = place
    step = 1 if x < 20 else -1
    for k in range(companions + 1):
        a[y, x + k * step] = b[y, x + k * step] = 100.0
    # The other half of the pixel did not see the firefly.
    b[y, x] = 0.5
    bounded = bound_fireflies((a, b), None, mask)
    if companions == 2:
        np.testing.assert_array_equal(bounded.a, a)
        assert bounded.energy_lost == 0.0
    else:
        np.testing.assert_allclose(bounded.a[y, x], max(MAX_RATIO_TO_WINDOW, MAX_RATIO_TO_HALF) * 0.5, rtol=ROUNDING)
        np.testing.assert_array_equal(bounded.b[y, x], b[y, x])


def test_what_both_halves_saw_stays() -> None:
    a, b, mask = make_flat()
    a[10, 12], b[10, 12] = 100.0, 30.0
    bounded = bound_fireflies((a, b), None, mask)
    np.testing.assert_array_equal(bounded.a, a)
    # All that the window bounds is the smaller of them.
    b[10, 12] = 20.0
    np.testing.assert_allclose(bound_fireflies((a, b), None, mask).a[10, 12], MAX_RATIO_TO_HALF * 20.0)


def test_a_bright_patch_stays_and_a_tinted_one_is_no_firefly() -> None:
    a, b, mask = make_flat()
    a[8:11, 9:12] = b[8:11, 9:12] = 100.0
    bounded = bound_fireflies((a, b), None, mask)
    np.testing.assert_array_equal(bounded.a, a)
    # One white pixel on black: as much light as its neighbours get.
    albedo = np.full(a.shape, 0.01, np.float32)
    albedo[10, 12] = 1.0
    checked = np.where((np.indices(mask.shape).sum(axis=0) % 2 == 0)[..., None], albedo, np.float32(np.nan))
    bounded = bound_fireflies((checked, np.where(np.isnan(checked), albedo, np.float32(np.nan))), albedo, mask)
    np.testing.assert_array_equal(bounded.a, checked)
    assert bounded.energy_lost == 0.0


def test_colours_of_a_checkerboard_bound_each_other() -> None:
    flat, _, mask = make_flat()
    flat[10, 12] = 100.0
    even = (np.indices(mask.shape).sum(axis=0) % 2 == 0)[..., None]
    a, b = np.where(even, flat, np.float32(np.nan)), np.where(even, np.float32(np.nan), flat)
    bounded = bound_fireflies((a, b), None, mask)
    np.testing.assert_array_equal(np.isnan(bounded.a), np.isnan(a))
    np.testing.assert_array_equal(bounded.b, b)
    np.testing.assert_allclose(bounded.a[10, 12], MAX_RATIO_TO_WINDOW * 0.5, rtol=ROUNDING)
    assert bounded.energy_lost == pytest.approx(
        (100.0 - MAX_RATIO_TO_WINDOW * 0.5) / float(flat[..., 0].sum()), rel=1e-4
    )


def test_too_few_neighbours_say_nothing() -> None:
    a, b, mask = make_flat()
    a[10, 12] = 100.0
    near = np.zeros_like(mask)
    near[10, 12], near[9, 8 : 8 + MIN_WINDOW_PIXELS - 1] = True, True
    np.testing.assert_array_equal(bound_fireflies((a, b), None, near).a, a)
    near[9, 8 + MIN_WINDOW_PIXELS - 1] = True
    assert bound_fireflies((a, b), None, near).a[10, 12, 0] < 100.0


def test_images_of_other_sizes_are_refused() -> None:
    a, b, mask = make_flat()
    with refuses(InputError, "half b"):
        bound_fireflies((a, b[1:]), None, mask)
