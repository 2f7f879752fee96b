"""Every feature against its oracle on pairs of pixels, ordinary ones and such that are nearly degenerate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.features import (
    Feature,
    GgxFeature,
    NormalFeature,
    PositionFeature,
    ScreenFeature,
    SgMixtureFeature,
    SplitGgxFeature,
    SplitLobe,
)
from lobewise.lobes.hits import HitField
from lobewise.records.frame import FloatArray
from tests.features.frames import KINDS, make_covariances, make_feature
from tests.features.oracles import get_similarity
from tests.features.pairs import compare, draw_pairs, weigh
from tests.mistakes import refuses

SHAPE = (40, 50)
COUNT = 20_000
# The kernels' exp2 is good to 1e-5, their log2 to 1e-4, which is multiplied by beta.
EXACT = ("screen", "position", "depth", "plane", "normal", "band_limit", "hit_distance")
# The polynomial of the diffuse similarity is good to 3.8e-3, which is raised to the power beta. With hits,
# 1/|zi + zj|^2 is taken to first order.
ABSOLUTE = {"diffuse": 4.0 * 3.8e-3, "sg_hits": 1e-3, "ggx_hits": 1e-3, "asg_hits": 1e-3}
# Of lobes from a thousandth to half of the sphere; the first order counts for more the farther a hit shifts a lobe.
WIDE = {"diffuse": 4.0 * 3.8e-3, "sg_hits": 0.05, "ggx_hits": 0.05, "asg_hits": 0.05, "ggx": 3e-3, "asg": 3e-3}
# The polynomial of the exponential exceeds 1 by as much.
ABOVE_ONE = 3e-6


def make_extremes(kind: str) -> Feature:
    """Return a feature whose arrays hold the smallest and the largest that frames have, side by side."""
    rng = np.random.default_rng([7, *SHAPE])
    feature: Any = make_feature(kind, SHAPE, beta=1.5)

    def spread(low: float, high: float, *channels: int) -> FloatArray:
        return np.exp(rng.uniform(np.log(low), np.log(high), (*SHAPE, *channels))).astype(np.float32)

    axis = rng.normal(size=(*SHAPE, 3))
    axis[::3] = np.sign(axis[::3]) * np.eye(3)[rng.integers(3, size=(len(axis[::3]), SHAPE[1]))]
    axis[1::3] = np.array([0.0, 0.0, 1.0]) + 1e-4 * axis[1::3]
    if getattr(feature, "hits", None) is not None:
        axis[::3], axis[2::3] = feature.axis[::3], feature.axis[2::3]
    axis = (axis / np.linalg.norm(axis, axis=-1, keepdims=True)).astype(np.float32)
    covariance, determinant = make_covariances(rng, axis, 2e-3, 0.7)
    inverse = np.where(rng.random(SHAPE) < 0.3, 0.0, spread(1e-6, 1e3)).astype(np.float32)
    changes: dict[str, Any] = {"axis": axis, "normal": axis, "covariance": covariance, "determinant": determinant}
    changes |= {"sharpness": spread(0.5, 1e6), "depth": spread(1e-2, 1e4), "footprint": spread(1e-4, 1e2)}
    changes |= {"inverse_distance": inverse, "tolerance": spread(1e-3, 10.0)}
    if isinstance(feature, SgMixtureFeature):
        shape = feature.sharpness.shape
        changes["axis"] = np.concatenate([axis, axis[::-1], -axis], axis=-1)[..., : feature.axis.shape[2]]
        changes["sharpness"] = spread(0.5, 1e5, shape[2])
        changes["amplitude"] = (spread(1e-3, 1e3, shape[2]) * (rng.random(shape) < 0.5)).astype(np.float32)
    if getattr(feature, "hits", None) is not None:
        changes["hits"] = HitField(feature.hits.position, inverse)
    return replace(feature, **{name: value for name, value in changes.items() if name in vars(feature)})


@pytest.mark.sampled("screen", "depth", "band_limit", "asg", "asg_hits")
@pytest.mark.parametrize("kind", KINDS)
def test_similarity_is_the_oracle_s(kind: str, rng: np.random.Generator) -> None:
    feature, pairs = make_feature(kind, SHAPE), draw_pairs(rng, SHAPE, COUNT)
    weights, expected = weigh(feature, pairs), get_similarity(feature, *pairs)
    assert expected.std() > 0.05  # they are told apart
    relative, absolute = 2e-5 if kind in EXACT else 1e-3, ABSOLUTE.get(kind, 2e-6)
    np.testing.assert_allclose(weights, expected, rtol=relative, atol=absolute)
    assert weights.max() <= 1.0 + ABOVE_ONE
    there_and_back = weigh(feature, (pairs[1], pairs[0]))
    np.testing.assert_allclose(there_and_back, weights, rtol=2e-5, atol=1e-7)


@pytest.mark.sampled("screen", "plane", "sg", "sg_hits", "ggx", "asg_hits", "mixture")
@pytest.mark.parametrize("kind", KINDS)
def test_extremes_are_the_oracle_s(kind: str, rng: np.random.Generator) -> None:
    feature, pairs = make_extremes(kind), draw_pairs(rng, SHAPE, COUNT)
    weights, expected = weigh(feature, pairs), get_similarity(feature, *pairs)
    np.testing.assert_allclose(weights, expected, rtol=0.0, atol=WIDE.get(kind, 5e-4))
    assert weights.min() >= 0.0
    assert weights.max() <= 1.0 + ABOVE_ONE


@pytest.mark.parametrize("kind", [kind for kind in KINDS if make_feature(kind, (2, 2)).get_arrays()])
def test_what_is_unknown_is_neutral(kind: str, rng: np.random.Generator) -> None:
    feature: Any = make_feature(kind, SHAPE)
    pairs = draw_pairs(rng, SHAPE, COUNT)
    known = rng.random(SHAPE) < 0.5
    expected = weigh(feature, pairs)

    def poison(array: FloatArray) -> FloatArray:
        return np.where(known if array.ndim == 2 else known[..., None], array, np.float32(np.nan))

    changes = {name: poison(value) for name, value in vars(feature).items() if isinstance(value, np.ndarray)}
    if getattr(feature, "hits", None) is not None:
        changes["hits"] = HitField(*map(poison, feature.hits))
    weights, logs = compare(replace(feature, **changes), pairs, [known[each] for each in pairs])
    both = known[pairs[0]] & known[pairs[1]]
    np.testing.assert_array_equal(weights[both], expected[both])
    assert np.isfinite(logs).all()  # a weight is clamped, whatever it is made of
    assert weights.min() >= 0.0
    assert weights.max() <= 1.0 + ABOVE_ONE
    assert len(feature.neutral) == sum(1 if array.ndim == 2 else array.shape[2] for array in feature.get_arrays())


def split(feature: GgxFeature) -> SplitGgxFeature:
    """Return the feature with its covariances split by NumPy's eigenvectors."""
    xx, xy, xz, yy, yz, zz = np.moveaxis(feature.covariance.astype(np.float64), -1, 0)
    matrix = np.stack([np.stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2)
    values, vectors = np.linalg.eigh(matrix)
    large, small = values[..., 2], values[..., 1]
    t = np.sqrt(large - small)[..., None] * vectors[..., :, 2]
    planes = (*np.moveaxis(feature.axis, -1, 0), *np.moveaxis(t, -1, 0), large, small)
    lobe = SplitLobe(*(np.ascontiguousarray(plane, np.float32) for plane in planes))
    return SplitGgxFeature(lobe, feature.beta, feature.hits)


@pytest.mark.parametrize("kind", ["ggx", "ggx_hits"])
def test_split_covariances_are_as_similar(kind: str, rng: np.random.Generator) -> None:
    feature, pairs = make_feature(kind, SHAPE), draw_pairs(rng, SHAPE, COUNT)
    assert isinstance(feature, GgxFeature)
    np.testing.assert_allclose(weigh(split(feature), pairs), weigh(feature, pairs), rtol=2e-3, atol=1e-5)


def test_split_covariances_that_are_unknown_are_neutral(rng: np.random.Generator) -> None:
    feature = make_feature("ggx", SHAPE)
    assert isinstance(feature, GgxFeature)
    whole, pairs, known = split(feature), draw_pairs(rng, SHAPE, COUNT), rng.random(SHAPE) < 0.5
    lobe = SplitLobe(*(np.where(known, plane, np.float32(np.nan)) for plane in whole.lobe))
    weights, logs = compare(replace(whole, lobe=lobe), pairs, [known[each] for each in pairs])
    both = known[pairs[0]] & known[pairs[1]]
    np.testing.assert_array_equal(weights[both], weigh(whole, pairs)[both])
    assert np.isfinite(logs).all()
    assert len(whole.neutral) == len(whole.get_arrays())


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_numbers_are_above_0(value: float) -> None:
    with refuses(InputError, "screen sigma", expected="a finite number above 0"):
        ScreenFeature(value)
    depth = np.ones((2, 2), np.float32)
    with refuses(InputError, "position pixel angle"):
        PositionFeature(depth, depth, pixel_angle=value, sigma=1.0)


def test_numbers_of_numpy_are_numbers() -> None:
    feature = NormalFeature(np.ones((2, 2, 3), np.float32), np.float32(3.0))  # type: ignore[arg-type]
    assert len(feature.get_arrays()) == 1
    assert type(feature.exponent) is float
