"""Both halves filtered by the same weights, against the definition in float64 and what follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import halide as hl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lobewise.backend.expressions import LOG2_E
from lobewise.backend.jit import count_compiled_kernels
from lobewise.errors import InputError
from lobewise.features import DiffuseFeature, Feature, ScreenFeature
from lobewise.features.base import Pixel, Stage
from lobewise.filters.dual_buffer import DualBufferOutput, PassRequest, filter_dual_buffer
from lobewise.records.frame import FloatArray
from lobewise.settings import LARGEST_RADIUS
from tests.features.frames import make_directions, make_feature, make_mask, make_radiance
from tests.features.oracles import Pixels, get_similarity
from tests.filters.sizes import SIZES
from tests.mistakes import refuses

FloatImage = NDArray[np.float64]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
FLOOR = 1e-3
NOISE_FLOOR = 1e-4
# A weight is out by 3e-4 of itself, from the kernels' logarithms to a power of 4 and their exponential (2 % where the
# similarity itself is approximate, ggx and diffuse), times the exponent; a mean and a sum of squares by twice that.
WEIGHT = 1e-3
APPROXIMATE = 2e-2


class ToneFeature(Feature):
    """Own feature, ``exp(-strength (|t_i - t_j| + |m_i - m_j|^2))``: tone t of one channel, mark m of two."""

    def __init__(self, tone: FloatArray, mark: FloatArray, strength: float) -> None:
        self.tone, self.mark, self.strength = tone, mark, strength

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.tone, self.mark

    def get_parameters(self) -> tuple[float, ...]:
        return (self.strength,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        return [inputs[0] * parameters[0], inputs[1], inputs[2]]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        squared = stage((i[1] - j[1]) * (i[1] - j[1]) + (i[2] - j[2]) * (i[2] - j[2]))
        return -hl.f32(LOG2_E) * (hl.abs(i[0] - j[0]) + parameters[0] * squared)


@get_similarity.register
def _(feature: ToneFeature, i: Pixels, j: Pixels) -> FloatImage:
    tone, mark = (array[i].astype(np.float64) - array[j] for array in (feature.tone, feature.mark))
    return np.asarray(np.exp(-feature.strength * (np.abs(tone) + np.sum(mark * mark, axis=-1))))


def make_own_feature(kind: str, shape: tuple[int, int]) -> Feature:
    """Return a feature of a random frame: one of those that there are, or the one above."""
    rng = np.random.default_rng(shape)
    if kind == "diffuse":
        # Normals that do not face apart: what is approximate is small beside the similarity.
        return DiffuseFeature(make_directions(rng, shape, 0.15), 4.0)
    if kind != "tone":
        return make_feature(kind, shape)
    tone, mark = rng.random(shape).astype(np.float32), rng.random((*shape, 2)).astype(np.float32)
    return ToneFeature(tone, mark, 1.5)


@dataclass(frozen=True)
class Case:
    """What decides the code of a dual-buffer pass, and the exponent that it is tried with."""

    radius: int
    place: tuple[str, ...]
    lobes: tuple[str, ...]
    demodulate: bool
    guided: bool
    exponent: float
    tolerance: float = WEIGHT


# Every one compiles a kernel.
STANDARD = Case(3, ("screen",), ("sg",), True, True, 0.5)
CASES = {
    "own sample": Case(0, ("screen",), (), True, False, 1.0),
    "unguided": Case(1, ("position",), ("diffuse",), True, False, 0.5, APPROXIMATE),
    "two places": Case(2, ("screen", "position"), ("ggx",), False, True, 1.0, APPROXIMATE),
    "standard": STANDARD,
    "no features": Case(4, (), (), False, False, 1.0),
    "own feature": Case(5, ("screen",), ("tone",), False, True, 2.0),
}


@dataclass(frozen=True)
class Given:
    """The arguments of a dual-buffer pass."""

    halves: tuple[FloatArray, FloatArray]
    mask: NDArray[np.bool_]
    place: list[Feature]
    lobes: list[Feature]
    exponent: float
    radius: int
    albedo: FloatArray | None = None
    guide: FloatArray | None = None
    noise: float = 2.0

    def run(self) -> DualBufferOutput:
        """Return what the kernel gives."""
        return filter_dual_buffer(PassRequest(**{item.name: getattr(self, item.name) for item in fields(self)}))

    def run_oracle(self) -> Found:
        """Return what the definition gives."""
        return dual_buffer_reference(**{item.name: getattr(self, item.name) for item in fields(self)})


class Found(NamedTuple):
    """What a pass gives, float64; see `DualBufferOutput`."""

    a: FloatImage
    b: FloatImage
    weight_sum: FloatImage
    effective_samples: FloatImage


def mark_good(half: FloatArray, mask: NDArray[np.bool_], albedo: FloatArray | None) -> NDArray[np.bool_]:
    """Return which pixels of a half count."""
    good = mask & np.isfinite(half).all(axis=-1) & (half >= 0.0).all(axis=-1)
    if albedo is not None:
        good &= np.isfinite(albedo).all(axis=-1) & (albedo >= 0.0).all(axis=-1) & (albedo.max(axis=-1) > FLOOR)
    return good


def compute_light(half: FloatArray, albedo: FloatArray | None) -> FloatImage:
    """Return radiance over albedo; a channel without albedo takes the mean of those that have one."""
    if albedo is None:
        return half.astype(np.float64)
    known = albedo > FLOOR
    light = half / np.where(known, albedo, 1.0).astype(np.float64)
    mean = np.sum(light, axis=-1, where=known) / np.maximum(known.sum(axis=-1), 1)
    return np.where(known, light, mean[..., None])


def dual_buffer_reference(
    halves: tuple[FloatArray, FloatArray],
    mask: NDArray[np.bool_],
    place: Sequence[Feature],
    lobes: Sequence[Feature],
    *,
    exponent: float = 1.0,
    radius: int,
    albedo: FloatArray | None = None,
    guide: FloatArray | None = None,
    noise: float = 1.0,
) -> Found:
    """Return ``sum_j w I_X / sum_j w`` of both halves X, offset by offset, from the definition."""
    height, width = mask.shape
    share = np.ones(mask.shape)
    if albedo is not None:
        share = np.where(np.isfinite(albedo) & (albedo >= 0.0), albedo, 0.0).astype(np.float64) @ LUMINANCE
    good = [mark_good(half, mask, albedo) for half in halves]
    light = [compute_light(np.where(g[..., None], half, 0.0), albedo) for half, g in zip(halves, good, strict=True)]
    # Of each half: light, weight, squared weight.
    sums = np.zeros((2, height, width, 5))
    reach = range(-radius, radius + 1)
    for down, right in ((down, right) for down in reach for right in reach):
        rows = np.arange(max(0, -down), min(height, height - down))
        columns = np.arange(max(0, -right), min(width, width - right))
        i_all = np.meshgrid(rows, columns, indexing="ij")
        both = mask[i_all[0], i_all[1]] & mask[i_all[0] + down, i_all[1] + right]
        i = i_all[0][both], i_all[1][both]
        j = i[0] + down, i[1] + right
        if i[0].size == 0:
            continue
        alike = [
            np.prod([get_similarity(feature, i, j) for feature in group] or [np.ones(i[0].shape)], axis=0)
            for group in (place, lobes)
        ]
        apart = np.zeros(i[0].shape)
        if guide is not None:
            g_i, g_j = guide[i].astype(np.float64), guide[j].astype(np.float64)
            v_i, v_j = g_i[:, 3], g_j[:, 3]
            unexplained = np.mean((g_i - g_j)[:, :3] ** 2, axis=-1) - (v_i + np.minimum(v_i, v_j))
            apart = np.maximum(unexplained, 0.0) / (NOISE_FLOOR + noise * (v_i + v_j))
        for half in range(2):
            weight = alike[0] * alike[1] ** exponent * np.exp(-apart) * share[j] * good[half][j]
            terms = [weight[:, None] * light[half][j], weight[:, None], weight[:, None] ** 2]
            sums[half][i] += np.concatenate(terms, axis=-1)
    return _compute_means(sums, mask, share)


def _compute_means(sums: FloatImage, mask: NDArray[np.bool_], share: FloatImage) -> Found:
    total = sums[..., 3]
    some = total > 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(some[..., None], sums[..., :3] / total[..., None], 0.0)
        spread = np.where(some, sums[..., 4] / total**2, 1.0)
    a, b = (np.where(some[half][..., None], means[half], means[1 - half]) for half in range(2))
    weight_sum = 0.5 * (total[0] + total[1]) / np.maximum(share, FLOOR)
    # A half that has nothing takes the other's mean, and the mean of both is worth what that is.
    both, one = 4.0 / (spread[0] + spread[1]), 1.0 / np.where(some[0], spread[0], spread[1])
    effective = np.where(some.all(axis=0), both, np.where(some.any(axis=0), one, 0.0))
    return Found(a, b, np.where(mask, weight_sum, 0.0), np.where(mask, effective, 0.0))


def make_given(case: Case, shape: tuple[int, int], *, clean: bool = False) -> Given:
    """Return random halves and guides: a tenth each is bad in one half, in the other, in the albedo, masked."""
    rng = np.random.default_rng([case.radius, *shape])
    albedo = rng.uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
    guide = rng.normal(0.0, 0.5, (*shape, 4)).astype(np.float32)
    guide[..., 3] = np.exp(rng.uniform(np.log(1e-3), np.log(0.3), shape))
    mask = make_mask(shape)
    bad = not clean and shape != (1, 1)
    if bad:
        mask &= rng.random(shape) > 0.1
        albedo[rng.random((*shape, 3)) < 0.1] = 0.0
        dark = rng.random(shape) < 0.05
        albedo[dark] = rng.choice([0.0, 0.9e-3, 1.1e-3], (int(dark.sum()), 1))
    # A little is reflected where there is no albedo, as by rounding: of the order of the floor.
    halves = tuple(make_radiance(shape, seed) * np.maximum(albedo, np.float32(0.5e-3)) for seed in (3, 4))
    if bad:
        # Half of what is masked is garbage, half would do.
        hidden = ~mask & (rng.random(shape) > 0.5)
        for half in halves:
            lost = rng.random(shape) < 0.1
            half[lost, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf, -1.0], int(lost.sum()))
            half[hidden] = np.nan
        albedo[rng.random((*shape, 3)) < 0.03] = np.nan
        albedo[rng.random((*shape, 3)) < 0.03] = -1.0
        albedo[hidden] = np.inf
    place, lobes = ([make_own_feature(kind, shape) for kind in kinds] for kinds in (case.place, case.lobes))
    return Given(
        halves=(halves[0], halves[1]),
        mask=mask,
        place=place,
        lobes=lobes,
        exponent=case.exponent,
        radius=case.radius,
        albedo=albedo if case.demodulate else None,
        guide=guide if case.guided else None,
    )


def make_flat_guide(shape: tuple[int, int]) -> FloatArray:
    """Return a guide without differences."""
    return np.ones((*shape, 4), np.float32)


def assert_agrees(given: Given, tolerance: float) -> None:
    """Raise AssertionError where the kernel is not what the definition says."""
    out = given.run()
    for name, value in given.run_oracle()._asdict().items():
        found = getattr(out, name)
        np.testing.assert_allclose(found, value, rtol=2.0 * tolerance, atol=1e-30, err_msg=name)
        assert found.dtype == np.float32


def get_bits(found: DualBufferOutput) -> bytes:
    """Return the bits of every image."""
    return b"".join(image.tobytes() for image in found[:3])


def check_definition(name: str, shape: tuple[int, int]) -> None:
    """Raise AssertionError unless a case of random images of a size is as the definition says."""
    assert_agrees(make_given(CASES[name], shape), CASES[name].tolerance)


@pytest.mark.sampled("cpu", "vulkan")
@given(name=st.sampled_from(list(CASES)), shape=SIZES)
def test_agrees_with_the_definition(name: str, shape: tuple[int, int]) -> None:
    check_definition(name, shape)


@pytest.mark.parametrize("name", CASES)
def test_bad_pixels_are_there_to_be_seen(name: str) -> None:
    given = make_given(CASES[name], (33, 17))
    one, other = (mark_good(half, given.mask, given.albedo) for half in given.halves)
    assert (one & ~other).any()
    assert (other & ~one).any()
    assert (given.mask & ~one & ~other).any()
    assert not given.mask.all()


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_constant_light_stays_constant_where_colours_lack_a_channel(channel: int) -> None:
    albedo = np.full((9, 12, 3), 0.7, np.float32)
    albedo[:, 4:, channel] = 0.0
    albedo[2:5, 8:, (channel + 1) % 3] = 0.0
    radiance = np.float32(1.5) * albedo
    everywhere = np.ones(albedo.shape[:2], dtype=bool)
    request = PassRequest(halves=(radiance, radiance), mask=everywhere, radius=3, albedo=albedo)
    out = filter_dual_buffer(request)
    np.testing.assert_allclose(out.a, 1.5, rtol=1e-5)
    np.testing.assert_allclose(out.b, 1.5, rtol=1e-5)


def test_a_half_of_bad_pixels_takes_the_mean_of_the_other() -> None:
    given = make_given(STANDARD, (33, 17))
    for empty in (0, 1):
        halves = list(given.halves)
        halves[empty] = np.full_like(halves[empty], np.nan)
        changed = replace(given, halves=(halves[0], halves[1]))
        assert_agrees(changed, STANDARD.tolerance)
        out = changed.run()
        assert out.a.max() > 0.0
        np.testing.assert_array_equal(out.a, out.b)
    nothing = np.full_like(given.halves[0], -1.0)
    for image in replace(given, halves=(nothing, nothing)).run()[:3]:
        assert not image.any()


@pytest.mark.sampled("cpu", "vulkan")
def test_more_images_are_averaged_by_the_same_weights() -> None:
    given = make_given(STANDARD, (33, 17))
    request = PassRequest(**{item.name: getattr(given, item.name) for item in fields(given)})
    swapped = replace(given, halves=given.halves[::-1]).run()
    bad = np.full_like(given.halves[0], np.nan)
    for more in (given.halves, (given.halves[0], bad)):
        found = filter_dual_buffer(replace(request, others=more))
        np.testing.assert_allclose(found.a, given.run().a, rtol=1e-6)
        # Where no tap of an image is good, a half takes the mean of the other half, and another image is black.
        for image, half, samples in zip(found.others, (found.a, swapped.a), more, strict=True):
            alone = replace(given, halves=(samples, bad)).run()
            np.testing.assert_allclose(image, np.where(alone.weight_sum[..., None] > 0.0, half, 0.0), rtol=1e-6)


def test_halves_may_be_the_colours_of_a_checkerboard() -> None:
    given = make_given(STANDARD, (33, 17))
    even = (np.add.outer(np.arange(33), np.arange(17)) % 2 == 0)[..., None]
    a, b = np.where(even, given.halves[0], np.nan), np.where(even, np.nan, given.halves[1])
    assert_agrees(replace(given, halves=(a, b)), STANDARD.tolerance)
    # Without neighbours each pixel has one half alone.
    assert_agrees(replace(given, halves=(a, b), radius=0), STANDARD.tolerance)


def test_a_far_tap_whose_square_underflows_is_one_sample() -> None:
    given = make_given(STANDARD, (1, 4), clean=True)
    alone = np.full((1, 4, 3), np.nan, np.float32)
    alone[0, 3] = 2.0
    # exp(-9 / (2 * 0.25^2)) is 5e-32, its square no float32.
    far = replace(
        given, halves=(alone, alone), place=[ScreenFeature(0.25)], exponent=0.0, guide=make_flat_guide((1, 4))
    )
    out = far.run()
    np.testing.assert_allclose(out.a[0, 0], 2.0 / given.albedo[0, 3], rtol=1e-5)
    assert out.weight_sum[0, 0] > 0.0
    assert (out.weight_sum[0, 0] * (given.albedo[0, 0] @ LUMINANCE)) < 1e-30
    # One of each half.
    np.testing.assert_allclose(out.effective_samples, 2.0, rtol=1e-6)


@pytest.mark.parametrize("name", ["unguided", "standard"])
def test_the_impulse_response_is_the_weight(name: str) -> None:
    case, shape = CASES[name], (11, 13)
    given = make_given(case, shape, clean=True)
    share = given.albedo @ LUMINANCE
    at = 5, 4
    impulse = np.zeros((*shape, 3), np.float32)
    impulse[at] = given.albedo[at]
    reach = tuple(slice(k - case.radius, k + case.radius + 1) for k in at)
    found = replace(given, halves=(impulse, 2.0 * impulse)).run()
    rows, columns = (k[reach].ravel() for k in np.indices(shape))
    i, j = (rows, columns), (np.full_like(rows, at[0]), np.full_like(rows, at[1]))
    alike = get_similarity(given.place[0], i, j) * get_similarity(given.lobes[0], i, j) ** case.exponent
    apart = np.zeros(rows.shape)
    if given.guide is not None:
        g_i, g_j = given.guide[i].astype(np.float64), given.guide[at].astype(np.float64)
        unexplained = np.mean((g_i - g_j)[:, :3] ** 2, axis=-1) - g_i[:, 3] - np.minimum(g_i[:, 3], g_j[3])
        apart = np.maximum(unexplained, 0.0) / (NOISE_FLOOR + given.noise * (g_i[:, 3] + g_j[3]))
    expected = np.zeros(shape)
    expected[i] = alike * np.exp(-apart) * share[at]
    for image, height in ((found.a, 1.0), (found.b, 2.0)):
        answer = image[..., 1] * found.weight_sum * share
        np.testing.assert_allclose(answer, height * expected, rtol=2.0 * case.tolerance, atol=1e-6)


def test_the_largest_radius_agrees_with_the_definition() -> None:
    assert_agrees(replace(make_given(STANDARD, (9, 70)), radius=LARGEST_RADIUS), STANDARD.tolerance)


def test_any_layout_of_the_arrays_will_do() -> None:
    given = make_given(STANDARD, (33, 17))
    expected = get_bits(given.run())

    def spread(array: NDArray[Any]) -> NDArray[Any]:
        wide = np.zeros((array.shape[0], 2 * array.shape[1], *array.shape[2:]), array.dtype)
        wide[:, ::2] = array
        return wide[:, ::2]

    def freeze(array: NDArray[Any]) -> NDArray[Any]:
        frozen = array.copy()
        frozen.flags.writeable = False
        return frozen

    def surround(array: NDArray[Any]) -> NDArray[Any]:
        # What lies before and behind an image is none of a kernel's business.
        flat = np.ones(array.size + 512, bool) if array.dtype == bool else np.full(array.size + 512, np.nan, np.float32)
        flat[256:-256] = array.ravel()
        return flat[256:-256].reshape(array.shape)

    for change in (spread, freeze, np.asfortranarray, surround, lambda array: array[::-1][::-1]):
        a, b, mask, albedo, guide = map(change, (*given.halves, given.mask, given.albedo, given.guide))
        assert get_bits(replace(given, halves=(a, b), mask=mask, albedo=albedo, guide=guide).run()) == expected


def test_another_size_radius_or_number_does_not_compile_again() -> None:
    make_given(STANDARD, (8, 9)).run()
    before = count_compiled_kernels()
    for radius in (0, 1, LARGEST_RADIUS):
        replace(make_given(STANDARD, (31, 50)), radius=radius).run()
    replace(make_given(STANDARD, (31, 50)), exponent=4.0, noise=0.7).run()
    assert count_compiled_kernels() == before


def test_images_of_another_size_are_refused() -> None:
    given = make_given(STANDARD, (8, 9), clean=True)
    for name, wrong in (
        ("half", {"halves": (given.halves[0], given.halves[1][:, :8])}),
        ("albedo", {"albedo": given.albedo[:7]}),
        ("guide", {"guide": given.guide[..., :3]}),
        ("an array of feature 'sg'", {"lobes": [make_feature("sg", (8, 8))]}),
    ):
        with refuses(InputError, name):
            replace(given, **wrong).run()
