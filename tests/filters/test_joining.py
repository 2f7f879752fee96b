"""The sum of a frame's layers against NumPy."""

import numpy as np
import pytest

from lobewise import engine
from lobewise.denoising.layers import Layer
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.glue import define_support
from lobewise.filters.history.accumulation import AccumulatedOutput
from lobewise.filters.history.joining import join_layers, mark_reflecting
from lobewise.records.frame import FloatArray

SHAPE = (9, 37)


def make_output(seed: int) -> AccumulatedOutput:
    """Return sums of which a fifth has no support."""
    rng = np.random.default_rng(seed)
    image = rng.exponential(1.0, (*SHAPE, 3)).astype(np.float32)
    weight, effective, variance = (rng.exponential(1.0, SHAPE).astype(np.float32) for _ in range(3))
    weight[rng.random(SHAPE) < 0.2] = 0.0
    return AccumulatedOutput(image, weight, effective, sums=np.zeros((*SHAPE, 7), np.float32), variance=variance)


def make_layer(seed: int) -> Layer:
    rng = np.random.default_rng(seed)
    albedo = rng.choice([0.0, 0.5], (*SHAPE, 3)).astype(np.float32)
    return Layer(np.zeros((1, 1, 3), np.float32), albedo, rng.random(SHAPE) > 0.2, ())


def add(images: list[FloatArray]) -> FloatArray:
    total = images[0]
    for image in images[1:]:
        total = total + image
    return total


def compute_support(layers: list[Layer], outputs: list[AccumulatedOutput]) -> tuple[FloatArray, FloatArray]:
    """Return weight and samples of the least supported layer that reflects, pixel by pixel; else those of the first."""
    found = np.zeros((2, *SHAPE), np.float32)
    for at in np.ndindex(*SHAPE):
        known = [
            (output.weight_sum[at], output.effective_samples[at])
            for layer, output in zip(layers, outputs, strict=True)
            if layer.mask[at] and layer.albedo is not None and layer.albedo[at].max() > ALBEDO_FLOOR
        ]
        first = outputs[0].weight_sum[at], outputs[0].effective_samples[at]
        found[(slice(None), *at)] = min(known, key=lambda each: each[0], default=first)
    return found[0], found[1]


@pytest.mark.parametrize("count", [1, 2])
def test_support_is_that_of_the_least_supported_layer(count: int) -> None:
    outputs, layers = [make_output(k) for k in range(count)], [make_layer(10 + k) for k in range(count)]
    images = {}
    for k, (layer, output) in enumerate(zip(layers, outputs, strict=True)):
        support = np.stack([output.weight_sum, output.effective_samples], axis=-1)
        images |= {f"support{k}": support, f"mask{k}": layer.mask, f"albedo{k}": layer.albedo}
    found = engine.pixels(define_support, images, {}, count)
    for image, expected in zip(found, compute_support(layers, outputs), strict=True):
        np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_sum_and_support_are_those_of_numpy(count: int) -> None:
    outputs, layers = [make_output(k) for k in range(count)], [make_layer(10 + k) for k in range(min(count, 2))]
    variances = [output.variance for output in outputs]
    found = join_layers(outputs, [(layer.mask, layer.albedo) for layer in layers], variances=variances)
    assert found.image.tobytes() == add([output.image for output in outputs]).tobytes()
    assert found.variance.tobytes() == add([output.variance for output in outputs]).tobytes()
    weight, effective = compute_support(layers, outputs[: len(layers)])
    np.testing.assert_array_equal(found.weight_sum, weight)
    np.testing.assert_array_equal(found.effective_samples, effective)
    np.testing.assert_array_equal(found.holes, ~np.logical_or.reduce([each.weight_sum > 0.0 for each in outputs]))
    assert len(found.parts) == (0 if count == 1 else 2)
    for part, output in zip(found.parts, outputs, strict=False):
        np.testing.assert_array_equal(part, output.image)


def test_exact_light_is_added_where_it_is_a_number() -> None:
    output, exact = make_output(1), np.full((*SHAPE, 3), 0.25, np.float32)
    exact[2, 3, 1], exact[4, 5, 0] = np.nan, -1.0
    found = join_layers([output], [(np.ones(SHAPE, bool), None)], exact=exact)
    assert found.variance is None
    expected = output.image + np.float32(0.25)
    expected[2, 3], expected[4, 5] = output.image[2, 3], output.image[4, 5]
    assert found.image.tobytes() == expected.tobytes()


def test_where_nothing_reflects_no_support_is_needed() -> None:
    outputs, reflecting = [make_output(1), make_output(2)], np.ones(SHAPE, bool)
    reflecting[:, 20:] = False
    for output in outputs:
        output.weight_sum[3:] = 0.0
    found = join_layers(outputs, [(reflecting, None)] * 2, is_black_beside=True)
    assert found.holes[3:, :20].all()
    assert not found.holes[:, 20:].any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_a_sum_that_is_no_light_is_a_hole_and_its_part_black(value: float) -> None:
    outputs = [make_output(1), make_output(2)]
    for output in outputs:
        output.weight_sum[...] = 1.0
    outputs[1].image[2, 30] = [1.0, value * 100.0, 1.0]
    found = join_layers(outputs, [(np.ones(SHAPE, bool), None)] * 2)
    assert found.holes[2, 30]
    assert found.holes.sum() == 1
    assert (found.parts[1][2, 30] == 0.0).all()
    np.testing.assert_array_equal(found.parts[0], outputs[0].image)


def test_pixels_that_reflect_nothing_are_left_out() -> None:
    layer = make_layer(3)
    layer.albedo[2, :7] = [0.0, 1e-6, 0.0]
    expected = layer.mask & (layer.albedo > 1e-6).any(axis=-1)
    np.testing.assert_array_equal(mark_reflecting(layer.mask, layer.albedo, 1e-6), expected)
    assert mark_reflecting(layer.mask, None, 1e-6) is layer.mask
