"""The mixing of candidates against its definition in NumPy and SciPy, and properties of a convex average."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.special import softmax

from lobewise.backend.jit import count_compiled_kernels
from lobewise.errors import InputError
from lobewise.filters.mixing import Network, find_features, mix_candidates
from lobewise.filters.mixing_pass import count_features
from lobewise.frame import FloatArray
from tests.features.frames import make_radiance

Pairs = list[tuple[FloatArray, FloatArray]]
Exact = NDArray[np.float64]

CANDIDATES, MIDDLE, EXTRAS, UNITS = 3, 1, 2, (5, 4)
SHAPES = [(1, 1), (3, 40), (33, 50)]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
BINOMIAL = np.poly1d([0.5, 0.5]) ** 4
BORDER = 10
"""Distance from which pixels do not affect a pixel: 2 and 6 for the blurs, 1 for the slope, and one to spare."""

LOGARITHM = 1.2e-4
"""The kernels' log2 is good to 1e-4; the rest is for squares of differences, which float32 rounds."""
SHARE = 3e-5
"""Relative: the kernels' exp2 is good to 1e-5 above and below the fraction bar, and scores are sums in float32."""
ROUNDING = 3e-7
"""Relative: a weighted mean of three numbers in float32."""


def make_pairs(shape: tuple[int, int], count: int = CANDIDATES, seed: int = 1) -> Pairs:
    """Return candidates of unlike noise about an image with an edge, which is black in a corner."""
    image = np.ones((*shape, 3), np.float32) * np.float32([1.0, 0.5, 0.2])
    image[:, shape[1] // 2 :] *= 4.0
    image[: shape[0] // 3, : shape[1] // 3] = 0.0
    halves = []
    for k in range(2 * count):
        noise = np.float32(0.1 * (1 + k // 2))
        halves.append(image * (1.0 + noise * (make_radiance(shape, seed + k) - 1.0)))
    return list(zip(halves[::2], halves[1::2], strict=True))


def make_extras(shape: tuple[int, int], count: int = EXTRAS) -> FloatArray:
    """Return logarithms of some size."""
    return np.random.default_rng([7, *shape]).uniform(-4.0, 4.0, (*shape, count)).astype(np.float32)


def make_network(inputs: int, candidates: int, units: tuple[int, int] = UNITS, seed: int = 2) -> Network:
    """Return a network of random numbers, whose scores differ by some units."""
    rng = np.random.default_rng(seed)
    sizes = [inputs, *units, candidates]

    def draw(*shape: int, scale: float = 1.0) -> FloatArray:
        return (scale * rng.normal(size=shape)).astype(np.float32)

    weights = tuple(draw(a, b, scale=max(a, 1) ** -0.5) for a, b in pairwise(sizes))
    biases = tuple(draw(b, scale=0.5) for b in sizes[1:])
    return Network(draw(inputs, scale=3.0), 0.3 + 0.2 * rng.random(inputs).astype(np.float32), weights, biases)  # type: ignore[arg-type]


def force_shares(network: Network, scores: Any) -> Network:
    """Return a network that gives every pixel the same scores."""
    *weights, last = network.weights
    biases = (*network.biases[:-1], np.asarray(scores, np.float32))
    return network._replace(weights=(*weights, np.zeros_like(last)), biases=biases)


def make_inputs(shape: tuple[int, int]) -> tuple[Pairs, int, FloatArray, float]:
    """Return the arguments of the kernels."""
    pairs = make_pairs(shape)
    a, b = pairs[MIDDLE]
    return pairs, MIDDLE, make_extras(shape), float(np.mean((0.5 * (a + b)) @ LUMINANCE))


NETWORK = make_network(count_features(CANDIDATES, EXTRAS), CANDIDATES)


def features_reference(pairs: Pairs, middle: int, extras: FloatArray, level: float) -> Exact:
    """Return the features from their definition, float64."""
    edges = ((BORDER, BORDER), (BORDER, BORDER), (0, 0))
    wide = [[np.pad(half.astype(np.float64), edges, mode="edge") for half in pair] for pair in pairs]
    light = [0.5 * (a + b) @ LUMINANCE for a, b in wide]
    squares = [0.25 * (a - b) ** 2 @ LUMINANCE for a, b in wide]
    squares += [(each - light[middle]) ** 2 for k, each in enumerate(light) if k != middle]
    squares.append(sum(slope**2 for slope in np.gradient(light[middle])))

    def blur(image: Exact, apart: int) -> Exact:
        kernel = np.zeros(4 * apart + 1)
        kernel[::apart] = BINOMIAL.coeffs
        return np.asarray(convolve1d(convolve1d(image, kernel, axis=0), kernel, axis=1))

    logs: list[Exact] = []
    local, images = light[middle], squares
    for apart in (1, 3):
        local, images = blur(local, apart), [blur(each, apart) for each in images]
        relative = [each / (local**2 + (0.05 * level) ** 2) for each in images]
        logs += [*(np.log2(np.maximum(each, 1e-8)) for each in relative), np.log2(np.maximum(local / level, 1e-3))]
    inside = np.stack(logs, axis=-1)[BORDER:-BORDER, BORDER:-BORDER]
    return np.concatenate([inside, extras.astype(np.float64)], axis=-1)


def mixture_reference(pairs: Pairs, features: NDArray[Any], network: Network) -> Exact:
    """Return the mixture that a network makes of features, float64."""
    values = (features.astype(np.float64) - network.mean) * network.scale
    for weights, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        values = values @ weights.astype(np.float64) + bias
        values = np.where(values < 0.0, 0.01 * values, values)
    shares = softmax(values @ network.weights[-1].astype(np.float64) + network.biases[-1], axis=-1)
    means = np.stack([0.5 * (a.astype(np.float64) + b) for a, b in pairs], axis=-1)
    return np.asarray(np.einsum("yxck,yxk->yxc", means, shares))


class TestDefinition:
    @pytest.mark.parametrize("shape", SHAPES, ids=str)
    def test_features(self, shape):
        inputs = make_inputs(shape)
        found = find_features(*inputs)
        assert found.dtype == np.float32
        assert found.shape == (*shape, count_features(CANDIDATES, EXTRAS))
        np.testing.assert_allclose(found, features_reference(*inputs), atol=LOGARITHM, rtol=1e-6)

    @pytest.mark.parametrize("shape", SHAPES, ids=str)
    def test_mixture(self, shape):
        inputs = make_inputs(shape)
        found = mix_candidates(*inputs, NETWORK)
        assert found.dtype == np.float32
        assert found.shape == (*shape, 3)
        # Of its own features, so that their rounding is not counted twice.
        expected = mixture_reference(inputs[0], find_features(*inputs), NETWORK)
        np.testing.assert_allclose(found, expected, rtol=SHARE, atol=1e-9)

    def test_shares_are_those_of_no_one_candidate(self):
        # Otherwise the test above would not depend on the network.
        pairs, *rest = make_inputs((33, 50))
        for k in range(CANDIDATES):
            lit: Pairs = [
                (np.full_like(a, float(i == k)), np.full_like(b, float(i == k))) for i, (a, b) in enumerate(pairs)
            ]
            features = find_features(pairs, *rest)
            share = mixture_reference(lit, features, NETWORK)[..., 0]
            assert share.max() - share.min() > 0.1

    def test_one_lit_pixel_is_spread_by_the_blur(self):
        shape, (row, column) = (11, 13), (0, 6)
        pairs, middle, extras, _ = make_inputs(shape)
        flat = [(np.ones_like(a), np.ones_like(b)) for a, b in pairs]
        flat[2][0][row, column] = 1.5
        flat[2][1][row, column] = 0.5
        variance = np.exp2(find_features(flat, middle, extras, 1.0)[..., 2]) * (1.0 + 0.05**2)
        weights = np.convolve([0.5, 0.5], np.convolve([0.5, 0.5], [0.25, 0.5, 0.25]))
        beyond = np.zeros((shape[0] + 4, shape[1]))
        # At the first row: the rows beyond it are that row again.
        beyond[: row + 3, column - 2 : column + 3] = 0.25 * weights
        expected = np.stack([weights @ beyond[y : y + 5] for y in range(shape[0])])
        # Features do not go below log2(1e-8).
        np.testing.assert_allclose(variance, expected, rtol=1e-4, atol=1.1e-8)

    def test_black_and_alike_candidates_have_features(self):
        black = [(np.zeros((4, 5, 3), np.float32),) * 2] * CANDIDATES
        found = find_features(black, MIDDLE, np.zeros((4, 5, EXTRAS), np.float32), 0.0)
        least = 2 * ([np.log2(1e-8)] * (2 * CANDIDATES) + [np.log2(1e-3)]) + [0.0] * EXTRAS
        np.testing.assert_allclose(found, np.broadcast_to(least, found.shape), atol=LOGARITHM)
        np.testing.assert_array_equal(mix_candidates(black, MIDDLE, found[..., :EXTRAS], 0.0, NETWORK), 0.0)

    @pytest.mark.slow
    def test_two_candidates_and_other_extras(self):
        # Open Image Denoise and our result are mixed like this: equal halves, and the first is the middle candidate.
        pairs = [(a, a) for a, _ in make_pairs((7, 8), 2)]
        extras = make_extras((7, 8), 5)
        network = make_network(count_features(2, 5), 2, (3, 6))
        features = features_reference(pairs, 0, extras, 0.7)
        found = mix_candidates(pairs, 0, extras, 0.7, network)
        # Features are good to a logarithm's error, which the network makes a share's.
        np.testing.assert_allclose(found, mixture_reference(pairs, features, network), rtol=3e-4)


class TestLaws:
    def test_every_channel_is_between_the_candidates(self):
        pairs, *rest = make_inputs((33, 50))
        means = np.stack([np.float32(0.5) * (a + b) for a, b in pairs])
        mixed = mix_candidates(pairs, *rest, NETWORK)
        assert (mixed >= means.min(axis=0) * (1.0 - ROUNDING)).all()
        assert (mixed <= means.max(axis=0) * (1.0 + ROUNDING)).all()

    @pytest.mark.parametrize("factor", [2.0**-20, 3.0, 1e5], ids=str)
    def test_a_brighter_image_is_mixed_alike(self, factor):
        pairs, middle, extras, level = make_inputs((33, 50))
        k = np.float32(factor)
        brighter: Pairs = [(k * a, k * b) for a, b in pairs]
        features, same = (
            find_features(each, middle, extras, level * scale) for each, scale in ((pairs, 1.0), (brighter, factor))
        )
        mixed, bright = (
            mix_candidates(each, middle, extras, level * scale, NETWORK)
            for each, scale in ((pairs, 1.0), (brighter, factor))
        )
        if np.log2(factor).is_integer():
            np.testing.assert_array_equal(same, features)
            np.testing.assert_array_equal(bright, k * mixed)
        # Both logarithms have their error, where the mantissas differ.
        np.testing.assert_allclose(same, features, atol=2.0 * LOGARITHM)
        np.testing.assert_allclose(bright, k * mixed, rtol=5e-4)

    @pytest.mark.parametrize(
        ("scores", "shares"),
        [
            ([0.0, 0.0, 0.0], [1 / 3, 1 / 3, 1 / 3]),
            ([np.log(4.0), 0.0, np.log(3.0)], [0.5, 0.125, 0.375]),
            ([1e4, 0.0, -1e4], [1.0, 0.0, 0.0]),
            ([-1e30, -1e30, 1e30], [0.0, 0.0, 1.0]),
            ([-3e38, 3e38, 3e38], [0.0, 0.5, 0.5]),
            ([-1e30, -1e30, -1e30], [1 / 3, 1 / 3, 1 / 3]),
        ],
        ids=str,
    )
    def test_shares_are_the_softmax_of_the_scores(self, scores, shares):
        pairs, *rest = make_inputs((3, 40))
        mixed = mix_candidates(pairs, *rest, force_shares(NETWORK, scores))
        expected = sum(share * 0.5 * (a + b) for share, (a, b) in zip(shares, pairs, strict=True))
        np.testing.assert_allclose(mixed, expected, rtol=1e-5)
        if 1.0 in shares:
            np.testing.assert_allclose(mixed, expected, rtol=ROUNDING)

    def test_halves_may_change_places(self):
        pairs, *rest = make_inputs((33, 50))
        swapped = [(b, a) for a, b in pairs]
        np.testing.assert_array_equal(mix_candidates(swapped, *rest, NETWORK), mix_candidates(pairs, *rest, NETWORK))

    def test_any_layout_of_the_arrays_will_do(self):
        pairs, middle, extras, level = make_inputs((33, 17))
        expected = mix_candidates(pairs, middle, extras, level, NETWORK)
        odd = [*pairs]
        frozen = pairs[0][0].copy()
        frozen.flags.writeable = False
        odd[0] = frozen, np.asfortranarray(pairs[0][1])
        odd[1] = pairs[1][0][::-1].copy()[::-1], pairs[1][1].astype(np.float64)
        # The kernel must not read memory before or behind an image.
        flat = np.full(extras.size + 512, np.nan, np.float32)
        flat[256:-256] = extras.ravel()
        weights = tuple(np.asfortranarray(each.astype(np.float64)) for each in NETWORK.weights)
        found = mix_candidates(
            odd, middle, flat[256:-256].reshape(extras.shape), level, NETWORK._replace(weights=weights)
        )
        np.testing.assert_array_equal(found, expected)


class TestMistakes:
    @pytest.mark.parametrize("shape", [(8, 8, 3), (8, 9), (8, 9, 4)], ids=str)
    def test_candidates_of_another_shape(self, shape):
        pairs, *rest = make_inputs((8, 9))
        pairs[2] = pairs[2][0], np.ones(shape, np.float32)
        with pytest.raises(InputError, match=r"candidate: expected real numbers of shape \(8, 9, 3\)"):
            mix_candidates(pairs, *rest, NETWORK)
        with pytest.raises(InputError, match="candidate"):
            find_features(pairs, *rest)

    @pytest.mark.parametrize("shape", [(8, 9), (8, 9, 0)], ids=str)
    def test_no_extras(self, shape):
        pairs, middle, _, level = make_inputs((8, 9))
        with pytest.raises(
            InputError, match=r"extras: expected shape \(height, width, count\) with a count of at least 1"
        ):
            find_features(pairs, middle, np.zeros(shape, np.float32), level)

    @pytest.mark.parametrize(("middle", "count"), [(-1, 3), (3, 3), (0, 0)])
    def test_no_middle(self, middle, count):
        pairs, _, extras, level = make_inputs((8, 9))
        with pytest.raises(InputError, match=f"middle: expected the index of a candidate, got {middle} of {count}"):
            find_features(pairs[:count], middle, extras, level)

    @pytest.mark.parametrize(
        "spoil",
        [
            lambda n: n._replace(mean=n.mean[:-1]),
            lambda n: n._replace(scale=np.append(n.scale, 1.0)),
            lambda n: n._replace(weights=(n.weights[0][:-1], *n.weights[1:])),
            lambda n: n._replace(weights=(n.weights[0], n.weights[1].T, n.weights[2])),
            lambda n: n._replace(weights=(*n.weights[:2], n.weights[2][:, :-1])),
            lambda n: n._replace(biases=(n.biases[0][:-1], *n.biases[1:])),
            lambda n: n._replace(biases=(*n.biases[:2], n.biases[2][:-1])),
            lambda n: n._replace(weights=n.weights[:2], biases=n.biases[:2]),
            lambda n: n._replace(weights=n.weights[2:], biases=n.biases[2:]),
            lambda n: n._replace(weights=n.weights[:2]),
            lambda n: make_network(len(n.mean) - 1, CANDIDATES),
            lambda n: make_network(len(n.mean) + 1, CANDIDATES),
            lambda n: make_network(len(n.mean), CANDIDATES - 1),
            lambda n: make_network(len(n.mean), CANDIDATES, (0, 4)),
        ],
    )
    def test_a_network_of_other_shapes(self, spoil):
        # Nothing in a kernel asks again: it would read and write beyond the arrays.
        before = count_compiled_kernels()
        with pytest.raises(
            InputError, match="network: expected 3 layers from 16 inputs to 3 outputs, got arrays of shapes"
        ):
            mix_candidates(*make_inputs((8, 9)), spoil(NETWORK))
        assert count_compiled_kernels() == before


def test_every_size_has_one_kernel() -> None:
    mix_candidates(*make_inputs((3, 4)), NETWORK)
    before = count_compiled_kernels()
    mix_candidates(*make_inputs((40, 3)), force_shares(NETWORK, [1.0, 2.0, 3.0]))
    assert count_compiled_kernels() == before
