"""Spherical Gaussians against quadrature, published figures, limits and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ive

from .oracles import sg
from .quadrature import gauss, normalize, rotate, sphere_grid
from .tolerances import MEASURED, QUADRATURE, ROUNDING, SINGLE

SHARPNESSES = [0.0, 1e-8, 1e-3, 0.5, 1.0, 2.133, 10.0, 100.0, 2e4]
Z = np.array([0.0, 0.0, 1.0])

# sharpness i, sharpness j, angle of the axes, integral of i, product integral, similarity exact and of sharp lobes
VECTORS = [
    (10.0, 10.0, 0.2, 0.62831853, 2.85714121e-01, 0.90945629, 0.90513868),
    (10.0, 40.0, 0.3, 0.62831853, 8.84301591e-02, 0.56296388, 0.55964555),
    (2.133, 2.133, 1.0, 2.90435212, 9.95004237e-01, 0.67569624, 0.61246248),
    (100.0, 100.0, 0.1, 0.06283185, 2.44986393e-02, 0.77981591, 0.77896300),
    (1000.0, 250.0, 0.05, 0.00628319, 3.91556877e-03, 0.62318212, 0.62307307),
    (0.5, 3.0, 0.7, 7.94346122, 1.66758354e00, 0.69913464, 0.63275932),
]

sharpnesses = st.one_of(st.just(0.0), st.floats(1e-6, 1e6))
sharp = st.floats(0.5, 1e5)
components = st.floats(-1.0, 1.0)
directions = (
    st.tuples(components, components, components)
    .map(np.array)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)


def tilt(angle):
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def grid_for(axis, *sharpness):
    return sphere_grid(axis, 3.0 / np.sqrt(1.0 + max(sharpness)))


@pytest.mark.parametrize("row", VECTORS)
def test_published_figures(row):
    li, lj, angle, integral, product, exact, slide = row
    pair = (Z, li, tilt(angle), lj)
    assert sg.sg_integral(li) == pytest.approx(integral, abs=6e-9)
    assert sg.sg_product_integral(*pair) == pytest.approx(product, rel=5e-9)
    assert sg.sg_similarity(*pair) == pytest.approx(exact, abs=6e-9)
    assert sg.sg_slide_similarity(*pair) == pytest.approx(slide, abs=6e-9)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_integrals_against_quadrature(sharpness):
    grid, weights = grid_for(Z, sharpness)
    values = sg.sg_evaluate(grid, Z, sharpness)
    # 400 nodes for the flat ones, whose mass is where the stereographic grid is thinnest
    tolerance = QUADRATURE if sharpness >= 0.5 else 1e-4
    assert sg.sg_integral(sharpness) == pytest.approx(np.sum(weights * values), rel=tolerance)
    assert sg.sg_square_integral(sharpness) == pytest.approx(np.sum(weights * values**2), rel=tolerance)


def test_evaluate_is_the_definition(rng):
    axis, direction = normalize(rng.normal(size=(2, 50, 3)))
    sharpness = rng.uniform(0.0, 30.0, 50)
    definition = np.exp(0.3 + sharpness * (np.sum(axis * direction, axis=-1) - 1.0))
    np.testing.assert_allclose(sg.sg_evaluate(direction, axis, sharpness, 0.3), definition, rtol=1e-13)


@pytest.mark.parametrize(("li", "lj"), [(0.0, 0.0), (0.0, 3.0), (1.0, 1.0), (2.0, 9.0), (50.0, 300.0), (2e4, 10.0)])
@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.1, 1.0, 2.5, np.pi])
def test_product_and_similarity_against_quadrature(li, lj, angle):
    pair = (Z, li, tilt(angle), lj)
    product = sg.sg_product(*pair)
    assert np.linalg.norm(product.axis) == pytest.approx(1.0, abs=ROUNDING)
    grid, weights = sphere_grid(np.asarray(product.axis), 3.0 / np.sqrt(1.0 + product.sharpness), radial=400)
    values = sg.sg_evaluate(grid, Z, li) * sg.sg_evaluate(grid, tilt(angle), lj)
    inner = np.sum(weights * values)
    tolerance = QUADRATURE if product.sharpness > 0.5 else 1e-5
    assert sg.sg_product_integral(*pair) == pytest.approx(inner, rel=tolerance)
    similarity = inner / np.sqrt(sg.sg_square_integral(li) * sg.sg_square_integral(lj))
    assert sg.sg_similarity(*pair) == pytest.approx(similarity, rel=tolerance)


@given(directions, sharpnesses, directions, sharpnesses, directions)
def test_product_is_the_product_of_the_values(axis_i, li, axis_j, lj, direction):
    product = sg.sg_product(axis_i, li, axis_j, lj)
    logarithm = li * (direction @ axis_i - 1.0) + lj * (direction @ axis_j - 1.0)
    rounding = 1e-14 * (1.0 + li + lj)
    together = product.log_amplitude + product.sharpness * (direction @ product.axis - 1.0)
    assert together == pytest.approx(logarithm, abs=rounding, rel=1e-12)


@given(directions, sharpnesses, directions, sharpnesses)
def test_similarity_laws(axis_i, li, axis_j, lj):
    for function in (sg.sg_similarity, sg.sg_slide_similarity):
        value = function(axis_i, li, axis_j, lj)
        assert 0.0 <= value <= 1.0
        assert value == pytest.approx(float(function(axis_j, lj, axis_i, li)), rel=ROUNDING, abs=1e-300)
        assert function(axis_i, li, axis_i, li) == pytest.approx(1.0, abs=ROUNDING)
    turn = rotate(normalize(np.array([1.0, -2.0, 0.5])), 1.1)
    # rotating rounds the axes to 1e-16, which a lobe of sharpness 1e6 sees as 1e-10 of its width
    assert sg.sg_similarity(turn @ axis_i, li, turn @ axis_j, lj) == pytest.approx(
        float(sg.sg_similarity(axis_i, li, axis_j, lj)), abs=1e-9
    )


@given(directions, sharp, directions, sharp, st.floats(0.5, 40.0))
def test_beta_is_a_power_and_scales_the_sharpness(axis_i, li, axis_j, lj, beta):
    value = sg.sg_slide_similarity(axis_i, li, axis_j, lj, beta)
    assert value == pytest.approx(float(sg.sg_slide_similarity(axis_i, li, axis_j, lj)) ** beta, rel=1e-8, abs=1e-150)


def dense_pairs(smallest):
    """Return all pairs of sharpnesses from ``smallest`` up, at angles from 1e-4 to pi."""
    sharpness = np.geomspace(smallest, 1e4 * smallest, 60)
    angle = np.concatenate([np.geomspace(1e-4, 0.1, 40), np.linspace(0.1, np.pi, 200)])
    axes = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)
    return Z, sharpness[:, None, None], axes, sharpness[None, :, None]


@pytest.mark.parametrize("smallest", [1.0, 2.0, 3.0, 5.0, 20.0, 100.0])
def test_slide_form_is_within_the_bounds_of_its_docstring(smallest):
    pairs = dense_pairs(smallest)
    error = sg.sg_slide_similarity(*pairs) - sg.sg_similarity(*pairs)
    assert error.min() > -0.184 / smallest
    assert error.max() < 0.062 / smallest
    assert error.max() < 0.0201


def test_slide_form_at_a_ratio_of_two():
    angle = np.linspace(0.0, np.pi, 2001)
    axes = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)
    worst = {}
    for smallest in (1.0, 2.0, 5.0, 10.0, 100.0):
        error = sg.sg_slide_similarity(Z, smallest, axes, 2.0 * smallest) - sg.sg_similarity(
            Z, smallest, axes, 2.0 * smallest
        )
        worst[smallest] = error.min()
    expected = {1.0: -0.106, 2.0: -0.042, 5.0: -0.0153, 10.0: -0.0074, 100.0: -0.0007}
    assert worst == pytest.approx(expected, abs=6e-4)


def test_middle_form_is_within_a_thousandth_from_sharpness_2():
    pair = dense_pairs(2.0)
    error = np.abs(sg.sg_middle_similarity(*pair) - sg.sg_similarity(*pair))
    assert error.max() < 3.4e-4 * MEASURED
    pair = dense_pairs(5.0)
    error = np.abs(sg.sg_middle_similarity(*pair) - sg.sg_similarity(*pair))
    assert error.max() < 2.1e-9 * MEASURED


def test_middle_form_without_its_numerator_would_fail_near_the_antipode():
    # why the numerator 1 - exp(-2 lm) stays: without it lobes of sharpness 2 diverge where they face away
    exact = sg.sg_similarity(Z, 2.0, tilt(3.1), 2.0)
    product = sg.sg_product(Z, 2.0, tilt(3.1), 2.0)
    bare = 4.0 / product.sharpness * np.exp(product.log_amplitude)
    assert abs(bare - exact) > 0.5
    assert sg.sg_middle_similarity(Z, 2.0, tilt(3.1), 2.0) == pytest.approx(float(exact), abs=1e-3)


def test_sharp_product_integral_is_an_underestimate_that_converges():
    previous = np.inf
    for sharpness in (5.0, 50.0, 500.0, 5000.0):
        pair = (Z, sharpness, tilt(1.0 / np.sqrt(sharpness)), sharpness)
        error = float(sg.sg_product_integral(*pair) / sg.sg_approx_product_integral(*pair) - 1.0)
        assert 0.0 < error < previous / 5.0
        previous = error
    assert previous < 1e-4


def test_convolution_against_mean_resultant_lengths():
    def mean_cosine(k):
        return 1.0 / np.tanh(k) - 1.0 / k

    exact = {
        pair: brentq(lambda k, p=pair: mean_cosine(k) - mean_cosine(p[0]) * mean_cosine(p[1]), 1e-3, 1e4)
        for pair in [(2.0, 2.0), (5.0, 5.0), (10.0, 100.0), (50.0, 50.0), (1000.0, 100.0)]
    }
    assert list(exact.values()) == pytest.approx([0.913, 2.712, 9.174, 25.25, 90.99], abs=5e-3)
    error = [float(sg.sg_convolve(*pair)) / value - 1.0 for pair, value in exact.items()]
    assert error == pytest.approx([0.095, -0.078, -0.009, -0.010, -0.001], abs=2e-3)
    assert sg.sg_convolve(np.inf, 7.0) == 7.0
    assert sg.sg_convolve(0.0, 0.0) == 0.0


def test_bandlimit_is_a_convolution_and_has_its_limits():
    assert sg.sg_bandlimit(np.inf, 0.1) == pytest.approx(100.0)
    assert sg.sg_bandlimit(np.inf, 0.0) == np.inf
    assert sg.sg_bandlimit(0.0, 0.1) == 0.0
    sharpness = np.geomspace(1e-3, 1e8, 50)
    np.testing.assert_allclose(sg.sg_bandlimit(sharpness, 0.0), sharpness, rtol=1e-15)
    np.testing.assert_allclose(sg.sg_bandlimit(sharpness, 0.3), sg.sg_convolve(sharpness, 1.0 / 0.09), rtol=1e-14)


@pytest.mark.parametrize("sharpness", [0.0, 0.3, 1.0, 3.0, 6.0, 10.0, 20.0, 100.0, 1000.0])
def test_hemisphere_integral_against_quadrature(sharpness):
    worst = 0.0
    height, weight = gauss(600)
    for cosine in np.linspace(-1.0, 1.0, 17):
        # by height above the equator; the integral over the azimuth is a Bessel function
        flat = np.sqrt((1.0 - height**2) * (1.0 - cosine**2))
        ring = 2.0 * np.pi * ive(0, sharpness * flat) * np.exp(sharpness * (height * cosine + flat - 1.0))
        truth = np.sum(weight * ring)
        value = sg.sg_hemisphere_integral(cosine, sharpness)
        worst = max(worst, abs(value - truth) / sg.sg_integral(sharpness))
        if abs(cosine) == 1.0 or sharpness == 0.0:
            assert value == pytest.approx(truth, rel=1e-10)
    assert worst < 0.005


def test_cone_energy_and_its_inverse():
    sharpness = np.array([0.0, 1e-7, 1e-3, 0.5, 3.0, 40.0, 1e4])[:, None]
    angle = np.linspace(0.01, np.pi, 30)
    energy = sg.sg_cone_energy(sharpness, angle)
    np.testing.assert_allclose(energy[:, -1], 1.0, rtol=ROUNDING)
    assert (np.diff(energy, axis=1) > -1e-15).all()
    back = sg.sg_cone_angle(sharpness, energy)
    whole = energy > 1.0 - 1e-9  # beyond, float64 no longer tells the fractions apart
    np.testing.assert_allclose(back[~whole], np.broadcast_to(angle, back.shape)[~whole], rtol=1e-6)
    # the definition: integral of exp(-l (1 - u)) over the cap
    u, w = gauss(200)
    for k, value in enumerate([0.5, 3.0, 40.0], start=3):
        low = np.cos(angle[7])
        nodes = low + (1.0 - low) * u
        cap = 2.0 * np.pi * np.sum((1.0 - low) * w * np.exp(value * (nodes - 1.0)))
        assert energy[k, 7] == pytest.approx(cap / sg.sg_integral(value), rel=1e-12)
    assert sg.sg_cone_angle(np.inf, 0.5) == 0.0


def test_sharpness_from_angle_is_where_the_lobe_has_fallen():
    for angle in (1e-3, 0.2, 1.0, 3.0):
        sharpness = sg.sg_sharpness_from_angle(angle, 0.1)
        assert sg.sg_evaluate(tilt(angle), Z, sharpness) == pytest.approx(0.1, rel=1e-9)


def test_equal_and_opposite_lobes_have_a_constant_product():
    product = sg.sg_product(Z, 3.0, -Z, 3.0)
    assert product.sharpness == 0.0
    assert product.log_amplitude == -6.0
    np.testing.assert_array_equal(product.axis, Z)
    assert sg.sg_product_integral(Z, 3.0, -Z, 3.0) == pytest.approx(4.0 * np.pi * np.exp(-6.0), rel=1e-15)
    # next to it, where |li xi + lj xj| cancels, the exact integral is 4 pi sinh(lm)/lm exp(-li - lj)
    near = sg.sg_product(Z, 3.0, -tilt(1e-9), 3.0)
    assert near.sharpness == pytest.approx(3e-9, rel=1e-9)


def test_nearly_equal_sharp_lobes_keep_their_digits():
    # 1 - c = 5e-19 is 0 in float64, yet at sharpness 1e12 the similarity is exp(-0.25e-6 ...)
    angle, sharpness = 1e-6, 1e12
    value = sg.sg_similarity(Z, sharpness, tilt(angle), sharpness)
    assert value == pytest.approx(np.exp(-sharpness * angle**2 / 4.0), rel=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_dtype_is_kept_and_single_precision_is_near(rng, dtype):
    axis_i, axis_j = normalize(rng.normal(size=(2, 40, 3)))
    axis_j = normalize(axis_i + 0.1 * axis_j)
    li, lj = rng.uniform(1.0, 100.0, (2, 40))
    pair = tuple(a.astype(dtype) for a in (axis_i, li, axis_j, lj))
    for function in (
        sg.sg_product_integral,
        sg.sg_approx_product_integral,
        sg.sg_similarity,
        sg.sg_middle_similarity,
        sg.sg_slide_similarity,
    ):
        value = function(*pair)
        assert value.dtype == dtype
        np.testing.assert_allclose(value, function(axis_i, li, axis_j, lj), rtol=2e-5)
    for value in (
        sg.sg_evaluate(pair[0], pair[2], pair[1]),
        sg.sg_integral(pair[1]),
        sg.sg_square_integral(pair[1]),
        sg.sg_convolve(pair[1], pair[3]),
        sg.sg_bandlimit(pair[1], 0.1),
        sg.sg_cone_energy(pair[1], 0.3),
        sg.sg_cone_angle(pair[1], 0.5),
        sg.sg_hemisphere_integral(pair[0][:, 2], pair[1]),
        sg.sg_sharpness_from_angle(pair[1] * dtype(0.01)),
        *sg.sg_product(*pair),
    ):
        assert value.dtype == dtype
    assert sg.sg_integral(pair[1]) == pytest.approx(sg.sg_integral(li), rel=10 * SINGLE)


def test_leading_shapes_broadcast(rng):
    axis_i = normalize(rng.normal(size=(4, 1, 3)))
    axis_j = normalize(rng.normal(size=(1, 5, 3)))
    assert sg.sg_similarity(axis_i, np.ones((4, 1)), axis_j, 3.0).shape == (4, 5)
    product = sg.sg_product(axis_i, np.ones((4, 1)), axis_j, 3.0)
    assert product.axis.shape == (4, 5, 3)
    assert product.sharpness.shape == product.log_amplitude.shape == (4, 5)
