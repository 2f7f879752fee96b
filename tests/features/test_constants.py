"""The constants of the lobe features against their exact counterparts, and the narrowest lobes against the oracle."""

import math

import numpy as np
import pytest

from lobewise.features import GgxFeature, GgxLobe
from lobewise.features.ggx import GGX_UNIT, TAIL_SQUARINGS
from lobewise.features.normal import LAMBERT_COEFFICIENTS
from lobewise.filters.cross_filter import run_filter
from tests.filters.reference import filter_reference


def correlate_ggx(offset: float) -> float:
    """Return the planar L2 autocorrelation of (1 + r^2)^-2 at ``offset``, by polar quadrature."""
    radius = np.tan(np.linspace(0.0, 0.5 * np.pi, 2001)[:-1])[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, 361)[:-1]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    product = (1.0 + x * x + y * y) ** -2 * (1.0 + (x - offset) ** 2 + y * y) ** -2
    ring = 2.0 * np.pi * product.mean(axis=1) * radius[:, 0]
    return float(np.sum(0.5 * (ring[1:] + ring[:-1]) * np.diff(radius[:, 0])))


def test_tail_is_the_autocorrelation_of_ggx() -> None:
    peak = correlate_ggx(0.0)
    np.testing.assert_allclose(peak, np.pi / 3.0, rtol=1e-5)
    power = GGX_UNIT * 2**TAIL_SQUARINGS
    errors = [abs(correlate_ggx(d) / peak - (1.0 + 0.25 * d * d) ** -power) for d in np.linspace(0.0, 8.0, 41)]
    assert max(errors) < 3.8e-3


def test_tail_has_the_exact_slope() -> None:
    assert 0.25 * GGX_UNIT * 2**TAIL_SQUARINGS == 0.6


def test_lambert_fit_is_the_overlap_of_two_cosines() -> None:
    angle = np.linspace(0.0, math.pi, 2001)
    exact = ((math.pi - angle) * np.cos(angle) + np.sin(angle)) / math.pi
    x = 1.0 - np.cos(angle)
    logarithm = x * np.polynomial.polynomial.polyval(x, LAMBERT_COEFFICIENTS)
    assert np.max(np.abs(np.exp2(-logarithm) - exact)) < 3.8e-3
    assert np.all(np.diff(logarithm) > 0.0)


@pytest.mark.parametrize("deviation", [1e-2, 1e-4, 1e-6])
def test_ggx_compares_lobes_however_narrow(deviation: float) -> None:
    rng = np.random.default_rng(3)
    shape = (9, 21)
    axis = np.dstack([deviation * rng.normal(size=(*shape, 2)), np.ones(shape)])
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    variance = deviation**2 * np.exp(0.5 * rng.normal(size=shape))
    planes = (*np.moveaxis(axis, -1, 0), *np.zeros((3, *shape)), variance, variance)
    feature = GgxFeature(GgxLobe(*(np.ascontiguousarray(each, np.float32) for each in planes)), beta=2.0)
    light, mask = rng.random((*shape, 3)).astype(np.float32), np.ones(shape, bool)
    out = run_filter(light, mask, [feature], form="full", radius=3)
    expected = filter_reference(light, mask, [feature], form="full", radius=3)
    np.testing.assert_allclose(out.weight_sum, expected.weight_sum, rtol=5e-3)
    assert expected.weight_sum.max() < 30.0  # of 49 taps: they are told apart
