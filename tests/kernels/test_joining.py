"""Samples joined with a history, against the definition in float64 and against the arithmetic of `temporal.sums`."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.backend.jit import count_compiled_kernels
from lobewise.errors import InputError
from lobewise.filters.reprojection import HISTORY_CHANNELS
from lobewise.filters.runs import JoinedOutput, SampleGrid
from lobewise.frame import FloatArray
from lobewise.lobes.vectors import LUMINANCE
from lobewise.temporal.sums import summarize
from tests.features.oracles import get_similarity
from tests.kernels.frames import make_feature, make_mask, make_radiance

FloatImage = NDArray[np.float64]

SHAPE = (13, 21)
RADIUS = 2
CASES = [(1, (0, 0)), (2, (1, 0)), (3, (0, 2)), (4, (3, 1))]
GROWTH, OWN = 0.5, 1.4
# The logarithm of the kernels, to a power of three at most.
TOLERANCE = 2e-3
FLOOR = 1e-3


def make_given(shape: tuple[int, int], scale: int, place: tuple[int, int]) -> dict[str, Any]:
    """Return a frame of random samples, guides and history: a tenth of everything is bad."""
    rng = np.random.default_rng([scale, *shape])
    samples = make_radiance(shape)[place[0] :: scale, place[1] :: scale].copy()
    samples[rng.random(samples.shape[:2]) < 0.1] = np.nan
    albedo = rng.uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
    albedo[rng.random(shape) < 0.1] = rng.choice([np.nan, -1.0, 0.9e-3, 5e-4])
    history = rng.exponential(1.0, (*shape, HISTORY_CHANNELS)).astype(np.float32)
    history[rng.random(shape) < 0.1] = 0.0
    return {
        "samples": samples,
        "mask": rng.random(shape) > 0.1,
        "albedo": albedo,
        "history": history,
        "trust": rng.random(samples.shape[:2]).astype(np.float32),
    }


def join(given: dict[str, Any], scale: int, place: tuple[int, int], **changes: Any) -> JoinedOutput:
    """Return what the kernel makes of it."""
    shape = given["mask"].shape
    grid = SampleGrid(
        given["mask"], [make_feature("position", shape)], scale=scale, place=place, albedo=given["albedo"]
    )
    options = {"radius": RADIUS, "history": given["history"], "trust": given["trust"], "growth": GROWTH, "own": OWN}
    return grid.join(given["samples"], **{**options, **changes})


def find_weights(mask: NDArray[np.bool_], scale: int, place: tuple[int, int], radius: int) -> FloatImage:
    """Return the similarity of every pixel and every sample near it, (height, width, rows, columns)."""
    height, width = mask.shape
    feature = make_feature("position", mask.shape)
    rows, columns = np.arange(place[0], height, scale), np.arange(place[1], width, scale)
    y, x, row, column = np.meshgrid(np.arange(height), np.arange(width), rows, columns, indexing="ij")
    weights = get_similarity(feature, (y, x), (row, column))
    near = (abs(row // scale - y // scale) <= radius) & (abs(column // scale - x // scale) <= radius)
    return np.where(near & mask[y, x] & mask[row, column], weights, 0.0)


def demodulate(samples: FloatArray, albedo: FloatArray, floor: float) -> tuple[FloatImage, NDArray[np.bool_]]:
    """Return samples over their albedo, 0 where bad, and which of them are good."""
    both = np.concatenate([samples, albedo], axis=-1).astype(np.float64)
    good = (np.isfinite(both) & (both >= 0.0)).all(axis=-1) & (both[..., 3:].max(axis=-1) > floor)
    light = both[..., :3] / np.maximum(both[..., 3:], floor)
    return np.where(good[..., None], light, 0.0), good


def join_slowly(given: dict[str, Any], scale: int, place: tuple[int, int], trust_radius: int) -> FloatImage:
    """Return the sums from the definition, (height, width, 7)."""
    mask, history, shaded = (
        given["mask"],
        given["history"].astype(np.float64),
        np.s_[place[0] :: scale, place[1] :: scale],
    )
    near = find_weights(mask, scale, place, trust_radius)
    told = near.sum(axis=(2, 3))
    trust = np.where(told > 0.0, (near * given["trust"]).sum(axis=(2, 3)) / np.where(told > 0.0, told, 1.0), 1.0)
    sums = history * trust[..., None]
    sums[..., 4] *= trust
    unit = (sums[..., 6] + 1.0) ** GROWTH
    light, good = demodulate(given["samples"], given["albedo"][shaded], FLOOR)
    weights = find_weights(mask, scale, place, RADIUS)
    weights = np.where(weights > 0.0, weights ** unit[..., None, None], 0.0) * good
    sums[..., :3] += unit[..., None] * np.einsum("yxrc,rck->yxk", weights, light)
    sums[..., 3] += unit * weights.sum(axis=(2, 3))
    sums[..., 4] += unit**2 * (weights**2).sum(axis=(2, 3))
    sums[..., 5] += unit * np.einsum("yxrc,rc->yx", weights, (light @ LUMINANCE) ** 2)
    sums[..., 6] += weights.sum(axis=(2, 3)) > 0.0
    # The pixel's own sample counts as one of weight own, of which the part that is 1 is there already.
    light, good = demodulate(given["samples"], given["albedo"][shaded], FLOOR / OWN)
    more = np.where(good & mask[shaded], (OWN - 1.0) * unit[shaded], 0.0)
    sums[shaded][..., :3] += more[..., None] * light
    sums[shaded][..., 3] += more
    sums[shaded][..., 4] += (more + unit[shaded]) ** 2 * (more > 0.0) - unit[shaded] ** 2 * (more > 0.0)
    sums[shaded][..., 5] += more * (light @ LUMINANCE) ** 2
    return sums


@pytest.mark.parametrize("shape", [SHAPE, (3, 5), (1, 1)], ids=str)
@pytest.mark.parametrize(("scale", "place"), CASES)
def test_agrees_with_the_definition(scale: int, place: tuple[int, int], shape: tuple[int, int]) -> None:
    place = min(place[0], shape[0] - 1), min(place[1], shape[1] - 1)
    given = make_given(shape, scale, place)
    out = join(given, scale, place)
    np.testing.assert_allclose(out.sums, join_slowly(given, scale, place, 1), rtol=TOLERANCE, atol=1e-6)


def test_the_taps_of_the_trust_may_reach_further_than_those_of_the_samples() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    out = join(given, 2, (1, 0), trust_radius=3)
    np.testing.assert_allclose(out.sums, join_slowly(given, 2, (1, 0), 3), rtol=TOLERANCE, atol=1e-6)


@pytest.mark.parametrize("modulate", [False, True])
def test_the_summary_is_that_of_the_sums(modulate: bool) -> None:
    given = make_given(SHAPE, 2, (1, 0))
    trust = np.full_like(given["trust"], 0.25)
    out = join(given, 2, (1, 0), trust=trust, modulate=modulate)
    told = find_weights(given["mask"], 2, (1, 0), 1).sum(axis=(2, 3)) > 0.0
    frames = given["history"][..., 6] * np.where(told, 0.25, 1.0)
    unit = ((frames + 1.0) ** GROWTH).astype(np.float32)
    image, *rest = summarize(np.ascontiguousarray(out.sums), unit, *([given["albedo"]] if modulate else []))
    np.testing.assert_allclose(out.image, image, rtol=2e-6, atol=1e-12)
    # The variance is a difference of squares.
    for name, expected, rtol in zip(
        ("weight_sum", "effective_samples", "variance"), rest, (5e-6, 5e-6, 1e-3), strict=True
    ):
        np.testing.assert_allclose(getattr(out, name), expected, rtol=rtol, atol=1e-5 if rtol == 1e-3 else 0.0)


def test_no_history_is_one_that_holds_nothing() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    nothing = join(given, 2, (1, 0), history=None, trust=None)
    empty = join(given, 2, (1, 0), history=np.zeros_like(given["history"]))
    for name in ("sums", "image", "weight_sum", "effective_samples", "variance"):
        assert getattr(nothing, name).tobytes() == getattr(empty, name).tobytes(), name


def test_without_trust_the_history_counts_whole() -> None:
    given = make_given(SHAPE, 3, (0, 2))
    without = join(given, 3, (0, 2), trust=None)
    whole = join(given, 3, (0, 2), trust=np.ones_like(given["trust"]))
    np.testing.assert_allclose(without.sums, whole.sums, rtol=2e-6)


def test_histories_of_any_layout_are_the_same() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    planes = np.moveaxis(np.ascontiguousarray(np.moveaxis(given["history"], -1, 0)), 0, -1)
    planes.setflags(write=False)
    assert join(given, 2, (1, 0), history=planes).sums.tobytes() == join(given, 2, (1, 0)).sums.tobytes()


def test_one_kernel_serves_every_radius_scale_and_strength() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    join(given, 2, (1, 0))
    compiled = count_compiled_kernels()
    for radius in range(5):
        join(given, 2, (1, 0), radius=radius, growth=0.1 * radius, own=1.0 + radius, trust_radius=radius)
    for scale, place in CASES:
        join(make_given(SHAPE, scale, place), scale, place, trust=None)
        join(make_given(SHAPE, scale, place), scale, place, history=None, shaded_only=True)
    assert count_compiled_kernels() == compiled


def test_shapes_are_checked() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    for name, message in (("trust", "trust: expected"), ("history", "history: expected sums of shape")):
        with pytest.raises(InputError, match=message):
            join(given, 2, (1, 0), **{name: given[name][:-1]})
    with pytest.raises(InputError, match="albedo: expected"):
        SampleGrid(make_mask(SHAPE), [], scale=2, albedo=given["albedo"][:-1])


PROGRAM = """
import sys
from tests.kernels.test_joining import *
given = make_given((131, 67), 2, (1, 0))
sys.stdout.buffer.write(join(given, 2, (1, 0)).sums.tobytes())
"""


@pytest.mark.processor
def test_threads_change_nothing() -> None:
    out = join(make_given((131, 67), 2, (1, 0)), 2, (1, 0))
    alone = {**os.environ, "HL_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, check=True, env=alone)
    assert done.stdout == out.sums.tobytes()
