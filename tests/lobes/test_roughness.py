"""The alphas of principled materials."""

import numpy as np
import pytest

from lobewise.lobes.numbers import NUMPY
from lobewise.lobes.roughness import compute_principled_alphas


def test_principled_anisotropy():
    # aspect = sqrt(1 - 0.9 x) = 1/2 for x = 5/6
    assert compute_principled_alphas(NUMPY, 0.4, 5.0 / 6.0) == pytest.approx((0.32, 0.08))
    assert compute_principled_alphas(NUMPY, 0.4, 0.0) == pytest.approx((0.16, 0.16))
    assert compute_principled_alphas(NUMPY, 0.0, 0.5) == (1e-3, 1e-3)
    above = np.array([0.05, 0.2, 0.5, 0.9, 1.0])
    u, v = compute_principled_alphas(NUMPY, above, 0.7)
    np.testing.assert_allclose(u * v, above**4)
