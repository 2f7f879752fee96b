"""Mixtures of spherical Gaussians against quadrature, the exact shape of GGX, limits and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import exp1

from lobewise.fitting import ggx
from lobewise.lobes.gaussian import GGX_MIXTURES, MIN_SHARPNESS

from .oracles import mixture, sg
from .quadrature import directions, draw_pairs, measure_similarity, normalize, rms, sphere_grid
from .tolerances import ROUNDING

Z = np.array([0.0, 0.0, 1.0])
ACCEPTED = 0.01
"""How near the similarity of three-lobe mixtures has to be where their axes are exact."""

single_lobes = st.tuples(directions, st.floats(0.3, 1e5), st.one_of(st.just(0.0), st.floats(1e-3, 1e3)))
mixtures = st.lists(single_lobes, min_size=1, max_size=4).map(
    lambda parts: mixture.SgMixture(*(np.array(column) for column in zip(*parts, strict=True)))
)


def draw_mixture(rng, shape, count):
    axis = normalize(Z + 0.4 * rng.normal(size=(*shape, count, 3)))
    return mixture.SgMixture(
        axis, np.exp(rng.uniform(0.0, 5.0, (*shape, count))), rng.uniform(0.0, 2.0, (*shape, count))
    )


def add_up(item):
    """Return the sum of the amplitudes of the lobes that are there."""
    return float(np.sum(item.amplitude))


@given(i=mixtures, j=mixtures)
def test_similarity_laws(i, j):
    function = mixture.mixture_approx_similarity
    value = float(function(i, j))
    assert 0.0 <= value <= 1.0
    assert float(function(j, i)) == pytest.approx(value, rel=ROUNDING, abs=1e-300)
    assert float(function(i, i)) == pytest.approx(1.0 if add_up(i) > 0.0 else 0.0, abs=ROUNDING)
    # the scale of a mixture and the order of its lobes do not matter
    turned = mixture.SgMixture(i.axis[::-1], i.sharpness[::-1], 7.0 * i.amplitude[::-1])
    assert float(function(turned, j)) == pytest.approx(value, rel=1e-9, abs=1e-300)
    # an absent lobe is no lobe, whatever is stored for it
    nothing = mixture.SgMixture(-i.axis[:1], np.zeros(1), np.zeros(1))
    more = mixture.SgMixture(*(np.concatenate(parts) for parts in zip(i, nothing, strict=True)))
    assert float(function(more, j)) == pytest.approx(value, rel=1e-9, abs=1e-300)
    assert float(function(nothing, j)) == 0.0


def test_absent_lobes_count_nothing_beside_a_constant():
    # the sharp form of two constants is infinite, and 0 times that is not a number
    absent, constant = (mixture.SgMixture(Z[None], np.zeros(1), np.full(1, value)) for value in (0.0, 1.0))
    assert mixture.mixture_approx_product_integral(absent, constant) == 0.0
    assert mixture.mixture_approx_product_integral(constant, absent) == 0.0


def test_one_lobe_is_a_spherical_gaussian(rng):
    i, j = draw_mixture(rng, (40,), 1), draw_mixture(rng, (40,), 1)
    pair = (i.axis[:, 0], i.sharpness[:, 0], j.axis[:, 0], j.sharpness[:, 0])
    np.testing.assert_allclose(
        mixture.mixture_approx_similarity(i, j, 3.0), sg.sg_slide_similarity(*pair, 3.0), rtol=1e-10
    )


def fit_gaussians(exponent):
    """Return (weights, relative L2 error) of the best sum of ``exp(-b q)`` for ``(1 + q)^-2`` over q >= 0.

    Closed forms: the Gram matrix is ``1 / (b_a + b_b)``, the projections ``1 - b exp(b) E1(b)``, the squared norm 1/3.
    """
    gram = 1.0 / (exponent[:, None] + exponent[None, :])
    projection = 1.0 - exponent * np.exp(exponent) * exp1(exponent)
    weight = np.linalg.solve(gram, projection)
    return weight, np.sqrt(max(1.0 - 3.0 * projection @ weight, 0.0))


@pytest.mark.parametrize(("count", "residual"), [(1, 0.140), (2, 0.031), (3, 0.0085), (4, 0.0027)])
def test_table_is_the_least_squares_fit(count, residual):
    exponent, weight = (np.array(column) for column in GGX_MIXTURES[count])
    start = np.log(exponent) + 0.1 * np.cos(np.arange(count))
    best = minimize(
        lambda b: fit_gaussians(np.exp(b))[1] ** 2,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-16, "maxiter": 4000, "maxfev": 4000},
    )
    fitted = np.exp(best.x)
    np.testing.assert_allclose(fitted, exponent, rtol=2e-3)
    np.testing.assert_allclose(fit_gaussians(fitted)[0], weight, rtol=3e-3)
    assert fit_gaussians(exponent)[1] == pytest.approx(residual, rel=0.03)
    # and by quadrature of the table itself, over q = t / (1 - t)
    t = (np.arange(200000) + 0.5) / 200000
    q, measure = t / (1.0 - t), 1.0 / (1.0 - t) ** 2
    error = (1.0 + q) ** -2 - np.exp(-exponent * q[:, None]) @ weight
    assert np.sqrt(np.mean(error**2 * measure) * 3.0) == pytest.approx(residual, rel=0.03)


def evaluate_ggx_shape(direction, axis, alpha):
    """``(1 + q)^-2`` of GGX normals, reflected at normal incidence: exact, ``q = (1 / alpha^2 - 1) sin^2(t / 2)``."""
    return (1.0 + (1.0 / alpha**2 - 1.0) * 0.5 * (1.0 - direction @ axis)) ** -2


@pytest.mark.parametrize("alpha", [0.02, 0.06, 0.2])
@pytest.mark.parametrize("ratio", [1.0, 1.7, 3.0])
def test_three_lobes_are_within_a_hundredth_where_axes_are_exact(alpha, ratio):
    small = alpha / ratio
    for offset in (0.0, 0.5, 1.0, 2.0, 3.0):
        angle = offset * 2.0 * alpha  # the reflected lobe is 2 alpha wide
        axis = np.array([np.sin(angle), 0.0, np.cos(angle)])
        middle = normalize(Z + axis) if ratio == 1.0 else axis
        grid, weights = sphere_grid(middle, 3.0 * small, 150, 128)
        inner = np.sum(weights * evaluate_ggx_shape(grid, Z, alpha) * evaluate_ggx_shape(grid, axis, small))
        squares = []
        for width in (alpha, small):
            rings, ring_weights = sphere_grid(Z, 3.0 * width, 200, 4)
            squares.append(np.sum(ring_weights * evaluate_ggx_shape(rings, Z, width) ** 2))
        truth = inner / np.sqrt(squares[0] * squares[1])
        pair = mixture.make_ggx_mixture(Z, Z, alpha), mixture.make_ggx_mixture(axis, axis, small)
        assert mixture.mixture_approx_similarity(*pair) == pytest.approx(truth, abs=ACCEPTED)


# n.v from; RMSE of S that the theory page states
ACCURACY = [(0.0, 0.10), (0.7, 0.038)]


def test_mixture_against_the_whole_brdf():
    pairs = draw_pairs(200, seed=2)
    truth = np.array([measure_similarity(*pair, 60, 64) for pair in pairs])
    cosine = np.array([i.local_view[2] for i, _ in pairs])
    made = [
        mixture.make_ggx_mixture(
            *(np.array([part(pair[side]) for pair in pairs]) for part in (lambda s: s.view, lambda s: s.frame[2])),
            np.array([pair[side].alpha_u for pair in pairs]),
        )
        for side in (0, 1)
    ]
    for least, bound in ACCURACY:
        assert rms((mixture.mixture_approx_similarity(*made) - truth)[cosine > least]) < bound


@pytest.mark.parametrize("lobes", [1, 2, 3, 4])
@pytest.mark.parametrize("tau", [0.0, 0.05])
def test_ggx_mixture_has_the_integral_of_the_albedo(lobes, tau):
    exponent, weight = (np.array(column) for column in GGX_MIXTURES[lobes])
    view = normalize(np.array([0.5, 0.1, 0.8]))
    for alpha in (0.0, 0.01, 0.3, 0.999999, 1.0):
        item = mixture.make_ggx_mixture(view, Z, alpha, lobes=lobes, albedo=0.7, tau=tau)
        integral = np.sum(item.amplitude * sg.sg_integral(item.sharpness))
        assert integral == pytest.approx(0.7 * np.sum(weight / exponent), rel=ROUNDING)
    # what the docstring says of the missing tail
    assert np.sum(weight / exponent) == pytest.approx([0.760, 0.918, 0.967, 0.985][lobes - 1], abs=6e-4)


def test_ggx_mixture_of_a_sharp_lobe_has_the_true_peak_and_profile():
    view = normalize(np.array([0.6, 0.0, 0.8]))
    alpha = 0.02
    item = mixture.make_ggx_mixture(view, Z, alpha)
    mirror = np.array([-view[0], 0.0, view[2]])
    np.testing.assert_allclose(item.axis, mirror[None], atol=1e-15)
    truth = float(ggx.ggx_brdf(view, mirror, alpha) * 0.8)
    # the fit is 0.9 % low at the peak, the albedo of a smooth lobe is 1
    assert add_up(item) == pytest.approx(truth, rel=0.012)
    # in between the two principal directions the round lobe is as wide as the true one: q = d^2 / area
    ratio = item.sharpness[0] / (2.0 * np.array(GGX_MIXTURES[3][0]))[0]
    assert ratio == pytest.approx((1.0 / alpha**2 - 1.0) / (4.0 * 0.8), rel=1e-5)


def test_bandlimit_adds_variance_and_keeps_the_integrals():
    plain = mixture.make_ggx_mixture(Z, Z, 0.1)
    blurred = mixture.make_ggx_mixture(Z, Z, 0.1, tau=0.2)
    np.testing.assert_allclose(1.0 / blurred.sharpness, 1.0 / plain.sharpness + 0.04, rtol=1e-6)
    parts = [item.amplitude * sg.sg_integral(item.sharpness) for item in (plain, blurred)]
    np.testing.assert_allclose(parts[0], parts[1], rtol=ROUNDING)
    mirror = mixture.make_ggx_mixture(Z, Z, 0.0, tau=0.01)
    np.testing.assert_allclose(mirror.sharpness, 1e4, rtol=1e-9)


def test_no_ggx_lobe_is_wider_than_the_hemisphere():
    item = mixture.make_ggx_mixture(Z, Z, np.linspace(0.01, 1.0, 50))
    assert item.sharpness.min() == pytest.approx(MIN_SHARPNESS, rel=1e-6)
    np.testing.assert_array_equal(item.sharpness.argsort(axis=-1)[0], [2, 1, 0])


def test_lambert_lobe_is_the_least_squares_gaussian():
    item = mixture.make_lambert_lobe(Z, 0.6)
    assert item.axis.shape == (1, 3)
    grid, weights = sphere_grid(Z, 1.5, 200, 8)
    target = 0.6 / np.pi * np.maximum(grid[:, 2], 0.0)

    def error(sharpness, amplitude):
        return np.sum(weights * (target - amplitude * np.exp(sharpness * (grid[:, 2] - 1.0))) ** 2)

    sharpness, amplitude = item.sharpness[0], item.amplitude[0]
    best = minimize(lambda p: error(p[0], p[1]) * 1e4, (2.0, 0.2), method="Nelder-Mead", options={"xatol": 1e-6})
    assert (sharpness, amplitude) == pytest.approx(tuple(best.x), rel=2e-3)
    relative = np.sqrt(error(sharpness, amplitude) / np.sum(weights * target**2))
    assert relative == pytest.approx(0.177, abs=1e-3)
