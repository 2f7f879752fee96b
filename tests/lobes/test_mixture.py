"""Mixtures of spherical Gaussians against quadrature, the exact shape of GGX, limits and laws."""

import numpy as np
import pytest

from lobewise.lobes import mixture

from .tolerances import ROUNDING

Z = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("alpha", [0.0, 0.1, 1.0])
def test_similarity_of_equal_mixtures_is_1(alpha):
    lobes = mixture.combine_mixtures(mixture.make_ggx_mixture(Z, Z, alpha, tau=0.01), mixture.make_lambert_lobe(Z, 0.5))
    assert mixture.mixture_similarity(lobes, lobes) == pytest.approx(1.0, abs=ROUNDING)
    assert mixture.mixture_approx_similarity(lobes, lobes, 3.0) == pytest.approx(1.0, abs=ROUNDING)
