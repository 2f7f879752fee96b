"""Roughness conversions: inverses, published definitions, and the quality of the fits to the density of normals."""

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.fitting import ggx
from lobewise.lobes.numbers import NUMPY
from lobewise.lobes.roughness import compute_principled_alphas

from .oracles import brdf, roughness, sg
from .quadrature import gauss

POLE = np.array([0.0, 0.0, 1.0])
ALPHAS = np.array([0.01, 0.05, 0.2, 0.5, 0.9, 1.0])


def test_conversions_are_inverse_to_each_other():
    np.testing.assert_allclose(roughness.alpha_from_perceptual(roughness.perceptual_from_alpha(ALPHAS)), ALPHAS)
    np.testing.assert_allclose(roughness.alpha_from_blinn_exponent(roughness.blinn_exponent_from_alpha(ALPHAS)), ALPHAS)
    for fit in ("wang", "volume", "l2"):
        back = roughness.ggx_from_sg_sharpness(roughness.sg_sharpness_from_ggx(ALPHAS, fit), fit)
        np.testing.assert_allclose(back, ALPHAS)
    np.testing.assert_allclose(roughness.sg_sharpness_from_asg(*2 * (roughness.asg_sharpness_from_sg(ALPHAS),)), ALPHAS)


def test_published_values():
    assert roughness.alpha_from_perceptual(0.3) == pytest.approx(0.09)
    assert roughness.sg_sharpness_from_ggx(0.1) == pytest.approx(200.0)
    assert roughness.sg_sharpness_from_ggx(0.1, "volume") == pytest.approx(198.0)
    assert roughness.sg_sharpness_from_ggx(0.1, "l2") == pytest.approx(2.262 * 99.0)
    assert roughness.sg_sharpness_from_beckmann(0.2) == pytest.approx(50.0)
    assert roughness.sg_sharpness_from_blinn(37.0) == 37.0
    assert roughness.blinn_exponent_from_alpha(1.0) == 0.0
    assert roughness.asg_sharpness_from_ggx(0.1, 0.2) == pytest.approx((1.131 * 99.0, 1.131 * 24.0))
    assert roughness.sg_sharpness_from_asg(8.0, 2.0) == pytest.approx(8.0)


def test_mirrors_are_infinitely_sharp():
    for fit in ("wang", "volume", "l2"):
        assert roughness.sg_sharpness_from_ggx(0.0, fit) == np.inf
        assert roughness.ggx_from_sg_sharpness(np.inf, fit) == 0.0
    assert roughness.blinn_exponent_from_alpha(0.0) == np.inf


def test_principled_anisotropy():
    # aspect = sqrt(1 - 0.9 x) = 1/2 for x = 5/6
    assert compute_principled_alphas(NUMPY, 0.4, 5.0 / 6.0) == pytest.approx((0.32, 0.08))
    assert compute_principled_alphas(NUMPY, 0.4, 0.0) == pytest.approx((0.16, 0.16))
    assert compute_principled_alphas(NUMPY, 0.0, 0.5) == (1e-3, 1e-3)
    above = ALPHAS[ALPHAS > 0.04]
    u, v = compute_principled_alphas(NUMPY, above, 0.7)
    np.testing.assert_allclose(u * v, above**4)


def test_an_unknown_fit_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'wang'"):
        roughness.sg_sharpness_from_ggx(0.1, "wangg")
    with pytest.raises(InputError, match="expected one of wang, volume, l2"):
        roughness.ggx_from_sg_sharpness(3.0, "x")


def relative_error(shape, sharpness, best_amplitude=True):
    """Relative L2 error, over solid angle, of ``exp(sharpness (cos - 1))`` against a density scaled to peak 1."""
    t, w = gauss(300)
    cosine = 1.0 - t**3  # dense at the pole
    w = w * 3.0 * t**2
    half = np.stack([np.sqrt(1.0 - cosine**2), 0.0 * cosine, cosine], axis=-1)
    values = shape(half) / shape(POLE)
    lobe = sg.sg_evaluate(half, POLE, sharpness)
    amplitude = np.sum(w * values * lobe) / np.sum(w * lobe**2) if best_amplitude else 1.0
    return np.sqrt(np.sum(w * (values - amplitude * lobe) ** 2) / np.sum(w * values**2))


@pytest.mark.parametrize(
    ("alpha", "wang", "volume"), [(0.05, 0.15, 0.15), (0.2, 0.15, 0.16), (0.5, 0.25, 0.21), (0.7, 0.37, 0.14)]
)
def test_quality_of_the_ggx_fits(alpha, wang, volume):
    def density(half):
        return ggx.ggx_normal_density(half, alpha)

    assert relative_error(density, roughness.sg_sharpness_from_ggx(alpha)) == pytest.approx(wang, abs=0.01)
    assert relative_error(density, roughness.sg_sharpness_from_ggx(alpha, "volume")) == pytest.approx(volume, abs=0.01)


@pytest.mark.parametrize(("alpha", "error"), [(0.05, 0.001), (0.2, 0.018), (0.3, 0.042), (0.5, 0.119), (0.7, 0.230)])
def test_quality_of_the_beckmann_fit(alpha, error):
    sharpness = roughness.sg_sharpness_from_beckmann(alpha)
    measured = relative_error(lambda half: brdf.beckmann_normal_density(half, alpha), sharpness)
    assert measured == pytest.approx(error, abs=0.002)


@pytest.mark.parametrize(("exponent", "error"), [(5, 0.122), (10, 0.061), (20, 0.031), (50, 0.012), (1000, 6e-4)])
def test_quality_of_the_blinn_fit(exponent, error):
    sharpness = roughness.sg_sharpness_from_blinn(exponent)
    measured = relative_error(lambda half: brdf.blinn_normal_density(half, exponent), sharpness, False)
    assert measured == pytest.approx(error, abs=1e-3)
