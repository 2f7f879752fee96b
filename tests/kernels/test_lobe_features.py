"""The constants of the lobe features against their exact counterparts."""

from __future__ import annotations

import math

import numpy as np

from lobewise.kernels.covariance_features import GGX_UNIT, TAIL_SQUARINGS
from lobewise.kernels.lobe_features import LAMBERT_COEFFICIENTS


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
