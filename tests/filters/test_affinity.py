"""The affinity filter: against its definition in NumPy, weights of a single pixel, laws of a mean, sizes."""

from __future__ import annotations

import halide as hl
import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.backend import jit
from lobewise.backend.devices import make_target
from lobewise.errors import InputError
from lobewise.filters.affinity import AffinityInputs, run_affinity

Array = NDArray[np.float64]

EXPONENTIAL = 2e-5
"""Relative: the kernel's exp2 is good to 1e-5; sums of 25 terms in float32 add less."""

SIZES = [(1, 1), (1, 9), (9, 1), (5, 5), (37, 21), (40, 70)]


def make_inputs(rng: np.random.Generator, size: tuple[int, int], features: int = 8, lobes: int = 4) -> AffinityInputs:
    """Return random arrays whose weights are neither all 1 nor all 0."""

    def draw(*channels: int, scale: float = 1.0) -> NDArray[np.float32]:
        return (scale * rng.random((*channels, *size))).astype(np.float32)

    light, numbers = draw(3, scale=5.0), draw(features, scale=0.8)
    centre, source = draw() + np.float32(0.1), draw()
    return AffinityInputs(light, numbers, centre, source, *((draw(lobes), draw(scale=3.0)) if lobes else ()))


def shift(image: Array, down: int, right: int, outside: float) -> Array:
    """Return the image moved so that pixel (y, x) is (y + down, x + right) of the original; ``outside`` beyond it."""
    height, width = image.shape[-2:]
    moved = np.full(image.shape, outside)
    rows, columns = np.arange(height) + down, np.arange(width) + right
    good_rows, good_columns = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
    if good_rows.any() and good_columns.any():
        part = image[..., rows[good_rows], :][..., columns[good_columns]]
        moved[..., np.ix_(good_rows, good_columns)[0], np.ix_(good_rows, good_columns)[1]] = part
    return moved


def filter_slowly(inputs: AffinityInputs, step: int) -> Array:
    """Return the filter's result, computed in float64."""
    light, features, centre, source, *more = (np.asarray(each, np.float64) for each in inputs if each is not None)
    total, sums = centre.copy(), centre * light
    for v in range(-2, 3):
        for u in range(-2, 3):
            if (u, v) != (0, 0):
                down, right = v * step, u * step
                distance = np.square(features - shift(features, down, right, 0.0)).sum(axis=0)
                if more:
                    lobes, exponent = more
                    distance = distance + exponent * np.square(lobes - shift(lobes, down, right, 0.0)).sum(axis=0)
                weight = np.exp(-distance) * shift(source, down, right, 0.0)
                total, sums = total + weight, sums + weight * shift(light, down, right, 0.0)
    return np.concatenate([sums / total, total[None]])


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("step", [1, 4])
def test_the_kernel_is_the_definition(rng: np.random.Generator, size: tuple[int, int], step: int) -> None:
    inputs = make_inputs(rng, size)
    found = run_affinity(inputs, step=step)
    np.testing.assert_allclose(found, filter_slowly(inputs, step), rtol=EXPONENTIAL)


def test_lobes_may_be_left_out(rng: np.random.Generator) -> None:
    inputs = make_inputs(rng, (19, 35), features=3, lobes=0)
    found = run_affinity(inputs, step=2)
    np.testing.assert_allclose(found, filter_slowly(inputs, 2), rtol=EXPONENTIAL)
    alike = inputs._replace(lobes=np.ones((2, 19, 35), np.float32), exponent=np.full((19, 35), 9.0, np.float32))
    np.testing.assert_allclose(run_affinity(alike, step=2), found, rtol=EXPONENTIAL)


def test_a_single_pixel_shows_the_weights(rng: np.random.Generator) -> None:
    size, (row, column), step = (23, 29), (11, 13), 3
    inputs = make_inputs(rng, size)
    light = np.zeros((3, *size), np.float32)
    light[:, row, column] = 1.0
    found = np.asarray(run_affinity(inputs._replace(light=light), step=step), np.float64)
    weights = found[0] * found[3]
    _, features, centre, source, lobes, exponent = (np.asarray(each, np.float64) for each in inputs)
    assert np.count_nonzero(weights) == 25
    assert weights[row, column] == pytest.approx(centre[row, column], rel=EXPONENTIAL)
    for v, u in ((-2, 0), (1, -2), (2, 2), (0, 1)):
        at = row + v * step, column + u * step
        distance = np.square(features[:, row, column] - features[(slice(None), *at)]).sum()
        distance += exponent[at] * np.square(lobes[:, row, column] - lobes[(slice(None), *at)]).sum()
        assert weights[at] == pytest.approx(np.exp(-distance) * source[row, column], rel=EXPONENTIAL)


def test_a_constant_stays_and_nothing_leaves_its_range(rng: np.random.Generator) -> None:
    inputs = make_inputs(rng, (30, 41))
    constant = run_affinity(inputs._replace(light=np.full_like(inputs.light, 2.5)), step=2)
    np.testing.assert_allclose(constant[:3], 2.5, rtol=1e-6)
    found = run_affinity(inputs, step=2)
    assert found[:3].max() <= inputs.light.max() * (1.0 + 1e-6)
    assert found[:3].min() >= inputs.light.min() * (1.0 - 1e-6)


def test_nothing_changes_where_no_neighbour_counts(rng: np.random.Generator) -> None:
    inputs = make_inputs(rng, (17, 33))
    alone = run_affinity(inputs._replace(source=np.zeros((17, 33), np.float32)), step=1)
    np.testing.assert_allclose(alone[:3], inputs.light, rtol=1e-6)
    np.testing.assert_array_equal(alone[3], inputs.centre)


def test_shapes_are_checked(rng: np.random.Generator) -> None:
    inputs = make_inputs(rng, (9, 12))
    for wrong in (
        inputs._replace(light=inputs.light[:2]),
        inputs._replace(features=inputs.features[:, :-1]),
        inputs._replace(source=inputs.source[:-1]),
        inputs._replace(lobes=None),
        inputs._replace(exponent=None),
        inputs._replace(lobes=inputs.lobes[..., 1:]),
    ):
        with pytest.raises(InputError):
            run_affinity(wrong)


@pytest.mark.processor
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_no_memory_beside_the_images_is_touched(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator, size: tuple[int, int]
) -> None:
    """Kernels have no checks of their own; here they have, and say which image they would read beside."""
    monkeypatch.setattr(jit, "_kernels", {})
    monkeypatch.setattr(
        jit, "make_target", lambda device: make_target(device).without_feature(hl.TargetFeature.NoAsserts)
    )
    for step in (1, 4):
        assert np.isfinite(run_affinity(make_inputs(rng, size), step=step)).all()
