"""Adaptive re-computation: which pixels, and how they are merged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.adaptive import find_unsupported, recompute
from lobewise.denoising import denoise
from lobewise.errors import InputError
from lobewise.frame import Radiance, Result
from lobewise.metrics import rel_mse
from lobewise.sparse_frame import make_sparse
from lobewise.upsampling import upsample
from tests.denoising.test_upsampling import make_clean_frame

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


def test_bad_new_samples_are_dropped() -> None:
    weight = np.full(SHAPE, 10.0)
    weight[1, 1], weight[2, 2] = 1.0, 0.0

    def shade(rows: Any, columns: Any) -> Radiance:
        return Radiance(np.full((len(rows), 1, 3), np.nan))

    merged = recompute(make_result(weight), shade, samples=1.0)
    np.testing.assert_array_equal(merged.image, 2.0)


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
    ("change", "words"),
    [
        ({"budget": 1.5}, "budget: expected a number from 0 to 1"),
        ({"budget": float("nan")}, "budget"),
        ({"least": -1.0}, "least"),
        ({"samples": 0.0}, "samples: expected a finite number above 0"),
    ],
)
def test_numbers_are_checked(change: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        recompute(make_result(0.0), lambda rows, columns: Radiance(np.ones((1, 1, 3))), **{"samples": 1.0, **change})


def test_count_is_checked() -> None:
    with pytest.raises(InputError, match=r"re-computed radiance: expected 9 pixels"):
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
