"""Adaptive re-computation: which pixels, and how they are merged."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.denoising import denoise
from lobewise.errors import InputError
from lobewise.metrics import rel_mse
from lobewise.recipes.adaptive import choose_spp, find_unsupported, recompute
from lobewise.recipes.adaptive.merging import MAX_KEPT_RATIO
from lobewise.recipes.adaptive.recipe import KEPT_WORTH
from lobewise.recipes.upsampling import upsample
from lobewise.records.frame import Radiance, Result
from lobewise.records.sparse_frame import make_sparse
from tests.denoising.test_upsampling import make_clean_frame
from tests.mistakes import refuses

SHAPE = (12, 15)


def make_result(weight: Any, **changes: Any) -> Result:
    """Return a grey result with these weight sums."""
    weight = np.broadcast_to(np.asarray(weight, dtype=np.float32), SHAPE).copy()
    values: dict[str, Any] = {
        "image": np.full((*SHAPE, 3), 2.0, np.float32),
        "weight_sum": weight,
        "effective_samples": weight.copy(),
        "bad_pixels": np.zeros(SHAPE, bool),
        "settings": {},
        "seconds": 0.0,
    }
    return Result(**{**values, **changes})


def test_least_supported_come_first_within_the_budget() -> None:
    weight = np.full(SHAPE, 10.0)
    weight[3, 4], weight[5, 6], weight[7, 8], weight[9, 9] = 0.0, 0.5, 1.0, 8.0
    result = make_result(weight)
    chosen = find_unsupported(result, budget=1.0)
    assert set(zip(*np.nonzero(chosen), strict=True)) == {(3, 4), (5, 6), (7, 8)}  # 8 is above half of the median
    two = find_unsupported(result, budget=2.5 / weight.size)
    assert set(zip(*np.nonzero(two), strict=True)) == {(3, 4), (5, 6)}
    assert not find_unsupported(result, budget=0.0).any()
    assert not find_unsupported(make_result(10.0)).any()


def test_budget_holds_where_nothing_is_supported() -> None:
    chosen = find_unsupported(make_result(0.0), budget=0.1)
    assert chosen.sum() == int(0.1 * chosen.size)


def test_new_radiance_counts_by_its_samples() -> None:
    weight = np.full(SHAPE, 10.0)
    weight[1, 2], weight[3, 3] = 1.0, 0.0
    asked = []

    def shade(rows: Any, columns: Any) -> Radiance:
        asked.extend(zip(rows, columns, strict=True))
        return Radiance(np.full((len(rows), 1, 3), 8.0))

    result = make_result(weight, specular=np.full((*SHAPE, 3), 1.0, np.float32))
    merged = recompute(result, shade, samples=3.0, budget=0.5)
    assert asked == [(1, 2), (3, 3)]
    np.testing.assert_allclose(merged.image[1, 2], (1.0 * 2.0 + 3.0 * 8.0) / 4.0)
    np.testing.assert_allclose(merged.image[3, 3], 8.0)
    untouched = weight == 10.0
    np.testing.assert_array_equal(merged.image[untouched], result.image[untouched])
    np.testing.assert_allclose(merged.weight_sum[1, 2], 4.0)
    np.testing.assert_array_equal(merged.specular, result.specular)  # the new radiance does not tell it apart
    assert merged.settings["recomputed"] == 2
    np.testing.assert_array_equal(result.image, 2.0)


def test_nothing_is_shaded_where_all_is_well() -> None:
    def shade(rows: Any, columns: Any) -> Radiance:
        raise AssertionError

    assert recompute(make_result(5.0), shade, samples=1.0).settings["recomputed"] == 0


@pytest.mark.parametrize("task", ["upsample", "denoise"])
def test_thin_things_between_the_samples_come_back(task: str) -> None:
    # a hair of another gloss, one pixel wide, that no shaded pixel hits
    frame, truth = make_clean_frame()
    truth = np.full_like(truth, 0.25)
    truth[:, 11] = 4.0
    alpha = np.full(truth.shape[:2], 0.4, np.float32)
    alpha[:, 11] = 0.02
    guides = {name: getattr(frame.gbuffer, name) for name in type(frame.gbuffer).__dataclass_fields__}
    guides.update(alpha_u=alpha, alpha_v=alpha)
    lit = Radiance(color=truth, diffuse=np.zeros_like(truth), specular=truth)
    frame = frame.with_changes(gbuffer=type(frame.gbuffer)(**guides), radiance=lit)
    result = upsample(make_sparse(frame, 4), beta=16.0) if task == "upsample" else denoise(frame, beta=16.0)
    again = recompute(result, lambda rows, columns: Radiance(truth[rows, columns][:, None]), samples=4.0)
    hair = np.zeros(truth.shape[:2], bool)
    hair[:, 11] = True
    assert find_unsupported(result)[hair].mean() > 0.9
    if task == "upsample":
        assert rel_mse(again.image, truth, hair) < 0.2 * rel_mse(result.image, truth, hair)


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        ({"budget": 1.5}, ("budget", "1.5")),
        ({"budget": float("nan")}, ("budget", "nan")),
        ({"samples": 0.0}, ("samples",)),
    ],
)
def test_numbers_are_checked(change: dict[str, float], refused: tuple[str, ...]) -> None:
    with refuses(InputError, *refused):
        recompute(make_result(0.0), lambda rows, columns: Radiance(np.ones((1, 1, 3))), **{"samples": 1.0, **change})


def test_count_is_checked() -> None:
    with refuses(InputError, "re-computed radiance", expected="9 pixels, shape (9, parts, 3)"):
        recompute(make_result(0.0), lambda rows, columns: Radiance(np.ones((1, 1, 3))), samples=1.0)


def test_pixels_without_support_come_first_then_those_of_the_largest_expected_error() -> None:
    frame, _ = make_clean_frame()
    shape = frame.shape
    image = np.ones((*shape, 3), np.float32)
    image[20:23, 20:23] = 3.0
    weight = np.full(shape, 10.0, np.float32)
    weight[30, 30] = 0.01
    noisy, sky = np.ones(shape, np.float32), np.s_[:6]
    noisy[2:12, 40:50] = 50.0
    depth, normal = frame.gbuffer.depth.copy(), frame.gbuffer.normal.copy()
    depth[sky], normal[sky] = 0.0, 0.0
    frame = frame.with_changes(gbuffer=replace(frame.gbuffer, depth=depth, normal=normal, position=None))
    result = Result(image, weight, weight.copy(), np.zeros(shape, bool), {}, 0.0, variance=0.01 * noisy)
    chosen = [find_unsupported(result, frame=frame, budget=count / weight.size) for count in (1.5, 50.5, 120.5)]
    assert np.argwhere(chosen[0]).tolist() == [[30, 30]]
    assert chosen[1][18:25, 18:25].sum() > 30
    assert chosen[2][6:12, 40:50].all()
    assert not any(mask[sky].any() for mask in chosen)


def test_new_pixels_keep_the_exact_emission_of_the_frame() -> None:
    frame, truth = make_clean_frame()
    emission = np.zeros_like(truth)
    emission[20:24, 30:34] = 50.0
    light = Radiance(truth + emission, np.zeros_like(truth), truth)
    frame = frame.with_changes(gbuffer=replace(frame.gbuffer, mean_emission=emission), radiance=light)
    sparse = make_sparse(frame, 4)

    def shade(rows: Any, columns: Any) -> Radiance:
        parts = [part[rows, columns][:, None] for part in (np.zeros_like(truth), truth)]
        # The samples of these pixels hit the lamp too often.
        return Radiance(parts[1] + 3.0 * emission[rows, columns][:, None], *parts)

    result = upsample(sparse)
    again = recompute(result, shade, samples=4.0, frame=sparse, budget=1.0)
    assert again.settings["recomputed"] > 0.9 * result.weight_sum.size
    assert np.abs(again.image - light.color).max() < 0.5


def test_new_pixels_are_filtered_among_themselves() -> None:
    frame, truth = make_clean_frame()
    result = upsample(make_sparse(frame, 4))
    rng = np.random.default_rng(5)

    def shade(rows: Any, columns: Any) -> Radiance:
        color = truth[rows, columns][:, None] * rng.gamma(0.5, 2.0, (len(rows), 1, 1))
        return Radiance(color, diffuse=np.zeros_like(color), specular=color)

    mask = find_unsupported(result, budget=0.3, frame=frame)
    options: dict[str, Any] = {"samples": 1.0, "budget": 0.3, "frame": frame}
    alone = recompute(result, shade, filter_new=False, **options)
    together = recompute(result, shade, **options)
    assert rel_mse(together.image, truth, mask) < 0.7 * rel_mse(alone.image, truth, mask)
    np.testing.assert_array_equal(together.image[~mask], result.image[~mask])
    assert (together.weight_sum[mask] >= alone.weight_sum[mask]).all()


def test_a_new_pixel_without_a_like_counts_as_it_is() -> None:
    frame, truth = make_clean_frame()
    result = upsample(make_sparse(frame, 4))
    one = 1.5 / result.weight_sum.size
    mask = find_unsupported(result, budget=one, frame=frame)
    assert mask.sum() == 1
    shade = lambda rows, columns: Radiance(truth[rows, columns][:, None])  # noqa: E731
    options: dict[str, Any] = {"samples": 4.0, "budget": one, "frame": frame}
    alone, together = recompute(result, shade, filter_new=False, **options), recompute(result, shade, **options)
    np.testing.assert_allclose(together.image[mask], alone.image[mask], rtol=1e-3)
    bad = recompute(result, lambda rows, columns: Radiance(np.full((1, 1, 3), np.nan)), **options)
    np.testing.assert_array_equal(bad.image, result.image)


def mend_grey(parts: Any, support: float = 0.5) -> Any:
    """Return the new radiance of a pixel that was 2, from the luminances of its parts."""
    weight = np.full(SHAPE, 10.0)
    weight[1, 2] = support
    color = np.repeat(np.asarray(parts, np.float32)[None, :, None], 3, axis=-1)
    return recompute(make_result(weight), lambda rows, columns: Radiance(color), samples=4.0).image[1, 2]


def test_parts_that_agree_count_fully() -> None:
    np.testing.assert_allclose(mend_grey([8.0] * 4), 8.0, rtol=1e-5)


def test_the_share_of_parts_is_that_of_the_least_squared_error() -> None:
    # Here the error of the old radiance is 10 % of its square, and the light below which it is absolute is 1 % of 2.
    parts = np.array([2.0, 3.0, 5.0, 6.0])
    old, noise = 0.1 * 2.0**2 + 0.02**2, parts.var(ddof=1) / 4.0
    shares = np.linspace(0.0, 1.0, 100001)
    share = shares[np.argmin((1.0 - shares) ** 2 * old + shares**2 * noise)]
    np.testing.assert_allclose(mend_grey(parts), 2.0 + share * (parts.mean() - 2.0), rtol=1e-4)


def test_a_firefly_in_one_part_hardly_counts() -> None:
    calm, fireflies = mend_grey([2.0, 2.1, 1.9, 2.0]), mend_grey([2.0, 2.1, 1.9, 5000.0])
    assert np.abs(fireflies - calm).max() < 0.01


def test_bad_parts_are_left_out() -> None:
    good = mend_grey([3.0, 3.5, 2.5])
    for bad in (np.nan, np.inf, -1.0):
        np.testing.assert_allclose(mend_grey([3.0, bad, 3.5, 2.5]), good, rtol=1e-5)
        np.testing.assert_allclose(mend_grey([bad, bad, 9.0, bad]), 2.0)
        for support in (0.5, 0.0):
            np.testing.assert_array_equal([mend_grey([bad] * count, support) for count in (1, 4)], 2.0)


def test_parts_have_less_error_than_one_noisy_mean() -> None:
    frame, truth = make_clean_frame()
    result = upsample(make_sparse(frame, 4))
    options: dict[str, Any] = {"samples": 16.0, "budget": 0.3, "frame": frame}
    mask = find_unsupported(result, budget=0.3, frame=frame)

    def shade(count: int) -> Any:
        def shade_parts(rows: Any, columns: Any) -> Radiance:
            rng = np.random.default_rng(5)
            noise = rng.gamma(0.5, 2.0, (len(rows), 4, 1))
            # Some samples see a small lamp.
            noise[rng.random(noise.shape) < 0.01] = 300.0
            color = truth[rows, columns][:, None] * (noise if count == 4 else noise.mean(axis=1, keepdims=True))
            return Radiance(color, diffuse=np.zeros_like(color), specular=color)

        return shade_parts

    one, four = (recompute(result, shade(count), **options) for count in (1, 4))
    assert rel_mse(four.image, truth, mask) < 0.5 * rel_mse(one.image, truth, mask)
    np.testing.assert_allclose(four.image, four.diffuse + four.specular, atol=1e-5)
    np.testing.assert_array_equal(four.image[~mask], result.image[~mask])


def test_a_history_gets_bounded_light_that_counts_twice() -> None:
    frame, truth = make_clean_frame()
    result, kept = upsample(make_sparse(frame, 4)), []

    class History:
        def add_samples(self, rows: Any, columns: Any, radiance: Radiance, weights: Any) -> None:
            kept.append((rows, columns, radiance, weights))

    def shade(rows: Any, columns: Any) -> Radiance:
        color = np.repeat(truth[rows, columns][:, None], 4, axis=1)
        # A single pixel of light that the filter spreads among its neighbours.
        color[0] *= 200.0
        return Radiance(color, diffuse=np.zeros_like(color), specular=color)

    again = recompute(result, shade, samples=4.0, budget=0.3, frame=frame, history=History())
    rows, columns, light, weights = kept[0]
    gathered = again.weight_sum[rows, columns] - result.weight_sum[rows, columns]
    np.testing.assert_allclose(weights, KEPT_WORTH * gathered, rtol=1e-4)
    assert light.color[0].max() < again.image[rows[0], columns[0]].max() / MAX_KEPT_RATIO
    np.testing.assert_allclose(light.color[1:, 0], again.image[rows[1:], columns[1:]], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("budget", "spp"), [(0.05, 64), (0.001, 256), (0.1, 32), (1.0, 16)])
def test_few_pixels_get_many_samples(budget: float, spp: int) -> None:
    assert choose_spp(budget) == spp


@pytest.mark.parametrize("budget", [0.0, 1.5, float("nan")])
def test_samples_are_chosen_for_a_share(budget: float) -> None:
    with refuses(InputError, "budget"):
        choose_spp(budget)


def test_a_firefly_in_one_part_hardly_reaches_other_pixels() -> None:
    frame, truth = make_clean_frame()
    result = upsample(make_sparse(frame, 4))
    options: dict[str, Any] = {"samples": 4.0, "budget": 0.3, "frame": frame}
    middle = int(0.3 * result.weight_sum.size) // 2

    def shade(light: float) -> Any:
        def shade_parts(rows: Any, columns: Any) -> Radiance:
            color = np.repeat(truth[rows, columns][:, None], 4, axis=1)
            color[middle, 2] *= light
            return Radiance(color, diffuse=np.zeros_like(color), specular=color)

        return shade_parts

    calm, firefly = (recompute(result, shade(light), **options).image for light in (1.0, 1e4))
    assert 0.0 < np.abs(firefly - calm).max() < 1.0
