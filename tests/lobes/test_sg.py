"""Spherical Gaussians against quadrature, published figures, limits and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from .oracles import sg
from .quadrature import directions, normalize, rotate, sphere_grid
from .tolerances import QUADRATURE, ROUNDING

SHARPNESSES = [0.0, 1e-8, 1e-3, 0.5, 1.0, 2.133, 10.0, 100.0, 2e4]
Z = np.array([0.0, 0.0, 1.0])

# sharpness i, sharpness j, angle of the axes, integral of i, similarity exact and of sharp lobes
VECTORS = [
    (10.0, 10.0, 0.2, 0.62831853, 0.90945629, 0.90513868),
    (10.0, 40.0, 0.3, 0.62831853, 0.56296388, 0.55964555),
    (2.133, 2.133, 1.0, 2.90435212, 0.67569624, 0.61246248),
    (100.0, 100.0, 0.1, 0.06283185, 0.77981591, 0.77896300),
    (1000.0, 250.0, 0.05, 0.00628319, 0.62318212, 0.62307307),
    (0.5, 3.0, 0.7, 7.94346122, 0.69913464, 0.63275932),
]

sharpnesses = st.one_of(st.just(0.0), st.floats(1e-6, 1e6))


def tilt(angle):
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


@pytest.mark.parametrize("row", VECTORS)
def test_published_figures(row):
    li, lj, angle, integral, exact, slide = row
    pair = (Z, li, tilt(angle), lj)
    assert sg.sg_integral(li) == pytest.approx(integral, abs=6e-9)
    assert sg.sg_similarity(*pair) == pytest.approx(exact, abs=6e-9)
    assert sg.sg_slide_similarity(*pair) == pytest.approx(slide, abs=6e-9)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_integral_against_quadrature(sharpness):
    grid, weights = sphere_grid(Z, 3.0 / np.sqrt(1.0 + sharpness))
    values = sg.sg_evaluate(grid, Z, sharpness)
    np.testing.assert_allclose(values, np.exp(sharpness * (grid[:, 2] - 1.0)), rtol=1e-9, atol=1e-300)
    # the mass of flat ones is where the stereographic grid is thinnest
    tolerance = QUADRATURE if sharpness >= 0.5 else 1e-4
    assert sg.sg_integral(sharpness) == pytest.approx(np.sum(weights * values), rel=tolerance)


@pytest.mark.parametrize(("li", "lj"), [(0.0, 0.0), (0.0, 3.0), (1.0, 1.0), (2.0, 9.0), (50.0, 300.0), (2e4, 10.0)])
@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.1, 1.0, 2.5, np.pi])
def test_similarity_against_quadrature(li, lj, angle):
    axis = li * Z + lj * tilt(angle)
    sharpness = np.linalg.norm(axis)
    grid, weights = sphere_grid(axis / sharpness if sharpness > 0.0 else Z, 3.0 / np.sqrt(1.0 + sharpness), radial=400)
    inner = np.sum(weights * sg.sg_evaluate(grid, Z, li) * sg.sg_evaluate(grid, tilt(angle), lj))
    # the square of a lobe is one of twice its sharpness
    similarity = inner / np.sqrt(sg.sg_integral(2.0 * li) * sg.sg_integral(2.0 * lj))
    value = sg.sg_similarity(Z, li, tilt(angle), lj)
    assert value == pytest.approx(similarity, rel=QUADRATURE if sharpness > 0.5 else 1e-5)


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


def test_bandlimit_adds_variance_and_has_its_limits():
    assert sg.sg_bandlimit(np.inf, 0.1) == pytest.approx(100.0)
    assert sg.sg_bandlimit(np.inf, 0.0) == np.inf
    assert sg.sg_bandlimit(0.0, 0.1) == 0.0
    sharpness = np.geomspace(1e-3, 1e8, 50)
    np.testing.assert_allclose(sg.sg_bandlimit(sharpness, 0.0), sharpness, rtol=1e-15)
    np.testing.assert_allclose(1.0 / sg.sg_bandlimit(sharpness, 0.3), 1.0 / sharpness + 0.09, rtol=1e-14)


def test_nearly_equal_sharp_lobes_keep_their_digits():
    # 1 - c = 5e-19 is 0 in float64, yet at sharpness 1e12 the similarity is exp(-0.25e-6 ...)
    angle, sharpness = 1e-6, 1e12
    value = sg.sg_similarity(Z, sharpness, tilt(angle), sharpness)
    assert value == pytest.approx(np.exp(-sharpness * angle**2 / 4.0), rel=1e-6)
