"""Every feature against its oracle on pairs of pixels, ordinary ones and such that are nearly degenerate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.features import (
    Feature,
    GgxLobe,
    NormalFeature,
    PositionFeature,
    ScreenFeature,
    SgMixtureFeature,
)
from lobewise.records.frame import FloatArray
from tests.features.frames import KINDS, make_feature, make_ggx_lobe
from tests.features.oracles import get_similarity
from tests.features.pairs import compare, draw_pairs, weigh
from tests.mistakes import refuses

SHAPE = (40, 50)
COUNT = 20_000
# The kernels' exp2 is good to 1e-5, their log2 to 1e-4, which is multiplied by beta.
EXACT = ("screen", "position", "depth", "plane", "normal", "band_limit", "hit_distance")
# The polynomial of the diffuse similarity is good to 3.8e-3, which is raised to the power beta.
ABSOLUTE = {"diffuse": 4.0 * 3.8e-3}
# Of lobes from a thousandth to half of the sphere.
WIDE = {"diffuse": 4.0 * 3.8e-3, "ggx": 3e-3}
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
    axis = (axis / np.linalg.norm(axis, axis=-1, keepdims=True)).astype(np.float32)
    inverse = np.where(rng.random(SHAPE) < 0.3, 0.0, spread(1e-6, 1e3)).astype(np.float32)
    changes: dict[str, Any] = {"axis": axis, "normal": axis, "lobe": make_ggx_lobe(rng, axis, 2e-3, 0.7)}
    changes |= {"sharpness": spread(0.5, 1e6), "depth": spread(1e-2, 1e4), "footprint": spread(1e-4, 1e2)}
    changes |= {"inverse_distance": inverse, "tolerance": spread(1e-3, 10.0)}
    if isinstance(feature, SgMixtureFeature):
        shape = feature.sharpness.shape
        changes["axis"] = np.concatenate([axis, axis[::-1], -axis], axis=-1)[..., : feature.axis.shape[2]]
        changes["sharpness"] = spread(0.5, 1e5, shape[2])
        changes["amplitude"] = (spread(1e-3, 1e3, shape[2]) * (rng.random(shape) < 0.5)).astype(np.float32)
    return replace(feature, **{name: value for name, value in changes.items() if name in vars(feature)})


@pytest.mark.sampled("screen", "depth", "band_limit")
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


@pytest.mark.sampled("screen", "plane", "sg", "ggx", "mixture")
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
    if isinstance(getattr(feature, "lobe", None), GgxLobe):
        changes["lobe"] = GgxLobe(*map(poison, feature.lobe))
    weights, logs = compare(replace(feature, **changes), pairs, [known[each] for each in pairs])
    both = known[pairs[0]] & known[pairs[1]]
    np.testing.assert_array_equal(weights[both], expected[both])
    assert np.isfinite(logs).all()  # a weight is clamped, whatever it is made of
    assert weights.min() >= 0.0
    assert weights.max() <= 1.0 + ABOVE_ONE
    assert len(feature.neutral) == sum(1 if array.ndim == 2 else array.shape[2] for array in feature.get_arrays())


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
