"""The reprojection kernel against the float64 oracle, and its laws."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lobewise.features import Feature
from lobewise.filters.history.reprojection import IMAGES_AT_ONCE, prepare_pixels, reproject, reproject_images
from lobewise.filters.history.reprojection_pass import AGREEMENT, SNAP_PIXELS
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.records.frame import FloatArray
from tests.features.frames import make_feature, make_mask
from tests.filters.reference import reproject_reference
from tests.filters.sizes import SIZES

SQUARED_WEIGHT = 4
# As in test_cross_filter; the sum of squared weights has twice the error.
RELATIVE = {"ggx": 0.02, "ggx_hits": 0.02}
DEFAULT_RELATIVE = 1e-3
# 2^0 of the kernels' polynomial is 1 + 2.6e-6.
EXACT = 4e-6


def make_past(shape: tuple[int, int], seed: int = 3) -> FloatArray:
    """Return positive sums with a long tail, (height, width, 7)."""
    return np.random.default_rng([seed, *shape]).exponential(1.0, (*shape, HISTORY_CHANNELS)).astype(np.float32)


def make_grid(shape: tuple[int, int]) -> FloatArray:
    """Return every pixel's own column and row."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    return np.stack([column, row], axis=-1).astype(np.float32)


def make_places(shape: tuple[int, int]) -> FloatArray:
    """Return places everywhere: within, outside, on the borders, on pixels, next to them, and nowhere."""
    rng = np.random.default_rng([11, *shape])
    size = np.array([shape[1], shape[0]], np.float32)
    places = rng.uniform(-2.0, size + 1.0, (*shape, 2)).astype(np.float32)
    border = np.stack([rng.choice([-1.0, -0.5, 0.0, n - 1.0, n - 0.5, n], shape) for n in size], axis=-1)
    near = np.rint(places) + rng.choice([-1.5, -0.5, 0.0, 0.5, 1.5], places.shape) * SNAP_PIXELS
    strange = rng.choice([np.nan, np.inf, -np.inf, 1e20, -1e20, 3e9, -3e9], places.shape)
    kind = rng.integers(0, 8, shape)[..., None]
    places = np.where(kind == 0, border, np.where(kind == 1, near, places))
    return np.where((kind == 2) & (rng.random(places.shape) < 0.6), strange, places).astype(np.float32)


def make_pair(kinds: tuple[str, ...], shape: tuple[int, int]) -> tuple[list[Feature], list[Feature]]:
    """Return the features of two frames that have nothing to do with each other."""
    before, now = ([make_feature(kind, shape, beta=2.0, seed=seed) for kind in kinds] for seed in (5, 6))
    return before, now


def make_random_mask(shape: tuple[int, int], seed: int) -> NDArray[np.bool_]:
    """Return a mask that leaves out an eighth of the pixels."""
    return np.random.default_rng([seed, *shape]).random(shape) > 0.125


def run_reprojection(
    past: FloatArray,
    places: FloatArray,
    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    features: tuple[Sequence[Feature], Sequence[Feature]],
    **options: Any,
) -> FloatArray:
    """Return the history reprojected by the masks and the features of the frame before and of this frame."""
    before, now = (prepare_pixels(mask, each) for mask, each in zip(masks, features, strict=True))
    return reproject(past, places, before, now, **options)


def reproject_plainly(past: FloatArray, places: FloatArray) -> FloatArray:
    """Return the history reprojected without features, so that all pixels are similar."""
    masks = make_mask(places.shape[:2]), make_mask(places.shape[:2])
    return run_reprojection(past, places, masks, ([], []))


def check_definition(kinds: tuple[str, ...], shape: tuple[int, int]) -> None:
    """Raise AssertionError unless a random past of a size is reprojected as the oracle does it."""
    tolerance = max((RELATIVE.get(kind, DEFAULT_RELATIVE) for kind in kinds), default=1e-5)
    past, places = make_past(shape), make_places(shape)
    masks, features = (make_random_mask(shape, 1), make_random_mask(shape, 2)), make_pair(kinds, shape)
    expected = reproject_reference(past, places, masks, features)
    found = run_reprojection(past, places, masks, features)
    np.testing.assert_allclose(found, expected, rtol=2.0 * tolerance, atol=1e-6)


@pytest.mark.sampled("cpu", "vulkan")
@given(kinds=st.sampled_from([(), ("sg",)]), shape=SIZES)
def test_agrees_with_oracle(kinds: tuple[str, ...], shape: tuple[int, int]) -> None:
    check_definition(kinds, shape)


@pytest.mark.sampled("cpu-5", "vulkan-2")
@pytest.mark.parametrize("count", [2, IMAGES_AT_ONCE + 1])
def test_images_are_gathered_like_the_light_of_a_history(count: int) -> None:
    shape = (9, 40)
    places, features = make_places(shape), make_pair(("normal",), shape)
    masks = make_random_mask(shape, 1), make_random_mask(shape, 2)
    before, now = (prepare_pixels(mask, each) for mask, each in zip(masks, features, strict=True))
    images = [make_past(shape, seed)[..., :3] for seed in range(count)]
    found, agreement = reproject_images(images, places, before, now)
    past = np.zeros((*shape, HISTORY_CHANNELS), np.float32)
    expected = reproject(past, places, before, now)
    np.testing.assert_allclose(agreement, expected[..., AGREEMENT], rtol=1e-6)
    assert len(found) == count
    for image, gathered in zip(images, found, strict=True):
        past[..., :3] = image
        np.testing.assert_allclose(gathered, reproject(past, places, before, now)[..., :3], rtol=1e-6)


@pytest.mark.nightly
@given(kinds=st.sampled_from([("position", "normal"), ("plane", "hit_distance"), ("ggx",), ("mixture",)]), shape=SIZES)
def test_every_feature_agrees_with_oracle(kinds: tuple[str, ...], shape: tuple[int, int]) -> None:
    check_definition(kinds, shape)


@pytest.mark.sampled("cpu-0-plane+normal+hit_distance")
@pytest.mark.parametrize("kinds", [("plane", "normal", "hit_distance"), ("plane", "ggx")], ids="+".join)
@pytest.mark.parametrize("virtual_from", [0, 1])
def test_of_two_places_the_better_counts_more(kinds: tuple[str, ...], virtual_from: int) -> None:
    tolerance = max(RELATIVE.get(kind, DEFAULT_RELATIVE) for kind in kinds)
    for shape in [(17, 3), (33, 29)]:
        past, places, masks = make_past(shape), make_places(shape), (make_random_mask(shape, 1), make_mask(shape))
        other = np.ascontiguousarray(places[::-1, ::-1])
        before, now = make_pair(kinds, shape)
        out = run_reprojection(past, places, masks, (before, now), virtual=(other, virtual_from), memory=0.5)
        first = reproject_reference(past, places, masks, (before, now))
        second = reproject_reference(past, other, masks, (before[virtual_from:], now[virtual_from:]))
        squares = [found[..., AGREEMENT:] ** 2 for found in (first, second)]
        share = squares[1] / np.maximum(squares[0] + squares[1], 1e-12)
        expected = ((1.0 - share) * first + share * second) * 0.5
        expected[..., SQUARED_WEIGHT] *= 0.5
        expected[..., AGREEMENT] *= 2.0
        # Mixing by squared agreements adds twice their error.
        np.testing.assert_allclose(out, expected, rtol=4.0 * tolerance, atol=1e-6, err_msg=str(shape))


@pytest.mark.parametrize("kinds", [(), ("plane", "ggx", "hit_distance")], ids="+".join)
@pytest.mark.parametrize("step", [(0.0, 0.0), (0.3, -0.6), (-5.25, 1.0), (200.0, 0.5)], ids=str)
def test_vectors_that_move_together_agree_with_oracle(kinds: tuple[str, ...], step: tuple[float, float]) -> None:
    # Wide enough for vectors whose pixels all move alike, beside vectors that cross a seam of the motion or the border.
    shape = (7, 151)
    past, places = make_past(shape), make_grid(shape) + np.array(step, np.float32)
    places[:, 70:] += np.float32(1.4)
    masks, features = (make_random_mask(shape, 1), make_random_mask(shape, 2)), make_pair(kinds, shape)
    out = run_reprojection(past, places, masks, features)
    expected = reproject_reference(past, places, masks, features)
    tolerance = 2.0 * (RELATIVE["ggx"] if kinds else DEFAULT_RELATIVE)
    np.testing.assert_allclose(out, expected, rtol=tolerance, atol=1e-6)


@pytest.mark.parametrize("step", [0.0, 0.3])
def test_vectors_of_which_few_pixels_have_a_place_agree_with_oracle(step: float) -> None:
    shape = (40, 96)
    rng = np.random.default_rng(3)
    past, places = make_past(shape), make_grid(shape) + np.float32(step)
    # Some move by a pixel, most were nowhere.
    places += rng.integers(0, 2, (*shape, 1)).astype(np.float32)
    places[rng.random(shape) < 0.85] = np.nan
    masks = make_random_mask(shape, 1), make_random_mask(shape, 2)
    out = run_reprojection(past, places, masks, ([], []))
    np.testing.assert_allclose(out, reproject_reference(past, places, masks, ([], [])), rtol=1e-5, atol=1e-6)


def check_own_places(shape: tuple[int, int]) -> None:
    """Raise AssertionError unless every pixel that stays where it is takes its past."""
    # These compare differences, so that the logarithm of a pixel with itself is 0 exactly.
    past, features = make_past(shape), [make_feature(kind, shape) for kind in ("plane", "hit_distance")]
    out = run_reprojection(past, make_grid(shape), (make_mask(shape), make_mask(shape)), (features, features))
    np.testing.assert_allclose(out[..., :AGREEMENT], past, rtol=2.0 * EXACT)
    np.testing.assert_allclose(out[..., AGREEMENT], 1.0, rtol=EXACT)


@given(shape=SIZES)
def test_own_places_give_the_past_back(shape: tuple[int, int]) -> None:
    check_own_places(shape)


def test_own_places_give_the_past_back_as_well_as_a_lobe_resembles_itself() -> None:
    shape = (17, 3)
    # The logarithm of the kernels is good to 1e-4; here it is that to the power 2.
    features = [make_feature("sg", shape, beta=2.0)]
    out = run_reprojection(make_past(shape), make_grid(shape), (make_mask(shape),) * 2, (features, features))
    np.testing.assert_allclose(out[..., :AGREEMENT], make_past(shape), rtol=2.0 * 2e-4)


@pytest.mark.parametrize("share", [-0.9, 0.9])
def test_places_that_differ_by_rounding_do_not_blur(share: float) -> None:
    shape = (9, 21)
    past, grid = make_past(shape), make_grid(shape)
    snapped = reproject_plainly(past, grid + np.float32(share * SNAP_PIXELS))
    assert snapped.tobytes() == reproject_plainly(past, grid).tobytes()


def test_places_that_differ_by_more_are_between_pixels() -> None:
    shape, step = (9, 21), 3.0 * SNAP_PIXELS
    past = make_past(shape)
    places = make_grid(shape) + np.array([step, 0.0], np.float32)
    out = reproject_plainly(past, places)
    # float32 columns around 20 are 2e-6 apart, so that the step is not the same everywhere.
    share = (places.astype(np.float64) - make_grid(shape))[..., :1]
    expected = (1.0 - share[:, :-1]) * past[:, :-1] + share[:, :-1] * past[:, 1:]
    np.testing.assert_allclose(out[:, :-1, :AGREEMENT], expected, rtol=2.0 * EXACT)
    np.testing.assert_allclose(out[:, -1, AGREEMENT], 1.0 - share[:, -1, 0], rtol=EXACT)


@pytest.mark.parametrize(("right", "down"), [(1, 0), (0, -1), (-7, 3), (20, 8), (21, 0), (0, 9), (-40, 2)])
def test_whole_pixels_shift(right: int, down: int) -> None:
    shape = (9, 21)
    past = make_past(shape)
    out = reproject_plainly(past, make_grid(shape) + np.array([right, down], np.float32))
    row, column = np.mgrid[: shape[0], : shape[1]]
    row, column = row + down, column + right
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    expected = np.zeros_like(past)
    expected[inside] = past[row[inside], column[inside]]
    np.testing.assert_allclose(out[..., :AGREEMENT], expected, rtol=2.0 * EXACT)
    np.testing.assert_allclose(out[..., AGREEMENT], inside, rtol=EXACT)


def test_agreement_is_the_share_of_the_place_inside() -> None:
    shape = (6, 5)
    places = np.full((*shape, 2), 2.0, np.float32)
    places[0, :, 0] = [-0.75, -0.25, 4.25, 4.75, 5.0]
    places[1, :, 1] = [-0.75, -0.25, 5.25, 5.75, 6.0]
    out = reproject_plainly(make_past(shape), places)
    for row in (0, 1):
        np.testing.assert_allclose(out[row, :, AGREEMENT], [0.25, 0.75, 0.75, 0.25, 0.0], rtol=EXACT)


def test_masked_pixels_neither_give_nor_take_whatever_they_hold() -> None:
    shape = (17, 23)
    masks = make_random_mask(shape, 1), make_random_mask(shape, 2)
    before, now = make_pair(("sg",), shape)
    past, places = make_past(shape), make_places(shape)
    expected = run_reprojection(past, places, masks, (before, now))
    for feature, mask in ((before[0], masks[0]), (now[0], masks[1])):
        values: dict[str, Any] = vars(feature)
        values["axis"] = np.where(mask[..., None], values["axis"], np.nan).astype(np.float32)
        values["sharpness"] = np.where(mask, values["sharpness"], -np.inf).astype(np.float32)
    past[~masks[0]] = np.nan
    out = run_reprojection(past, places, masks, (before, now))
    assert out.tobytes() == expected.tobytes()
    assert (out[~masks[1]] == 0.0).all()


def test_nowhere_is_no_history() -> None:
    shape = (9, 21)
    past, places = make_past(shape), make_grid(shape)
    expected = reproject_plainly(past, places)
    nowhere = [4, 5, 0], [7, 8, 0]
    expected[nowhere] = 0.0
    places[4, 7], places[5, 8, 0], places[0, 0, 1] = np.nan, np.inf, -1e20
    assert reproject_plainly(past, places).tobytes() == expected.tobytes()


@pytest.mark.parametrize("channel", range(HISTORY_CHANNELS))
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_is_no_history(channel: int, value: float) -> None:
    shape = (9, 21)
    past, places = make_past(shape), make_grid(shape)
    places[2:] += np.float32(0.25)
    masks = make_mask(shape), make_mask(shape)
    for at in ((0, 3), (5, 7), (8, 20)):
        past[(*at, channel)] = value
        masks[0][at] = False
    out = reproject_plainly(past, places)
    assert np.isfinite(out).all()
    assert out.tobytes() == run_reprojection(np.nan_to_num(past), places, masks, ([], [])).tobytes()
