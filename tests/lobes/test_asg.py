"""Anisotropic spherical Gaussians against quadrature, limits and laws."""

import numpy as np
import pytest

from lobewise.lobes import asg

from .quadrature import normalize
from .tolerances import ROUNDING


def test_similarity_of_equal_lobes_is_1(rng):
    axis = normalize(rng.normal(size=(20, 3)))
    tangent = normalize(np.cross(axis, rng.normal(size=(20, 3))))
    lobe = asg.make_asg(axis, tangent, rng.uniform(1.0, 50.0, 20), rng.uniform(1.0, 50.0, 20))
    np.testing.assert_allclose(asg.asg_similarity(lobe, lobe), 1.0, atol=ROUNDING)
    assert asg.asg_approx_similarity(lobe, lobe, 3.0) == pytest.approx(1.0, abs=ROUNDING)
