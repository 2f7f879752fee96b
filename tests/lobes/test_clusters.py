"""Light of clusters in closed form against quadrature."""

import numpy as np
import pytest

from lobewise.fitting import ggx
from lobewise.lobes import clusters
from lobewise.lobes.covariance import make_covariance_lobe
from lobewise.lobes.numbers import NUMPY

from .oracles.sg import sg_evaluate
from .quadrature import make_frame, normalize, rotate, sphere_grid
from .tolerances import QUADRATURE, ROUNDING

Z = np.array([0.0, 0.0, 1.0])
POSITIVE_MEAN = 0.02
"""How near the mean positive cosine has to be."""
SHARPNESSES = (0.2, 1.0, 2.0, 5.0, 20.0, 1000.0)


def draw_covariance(rng):
    """Return a 3x3 covariance and its six numbers."""
    root = rng.normal(size=(3, 3)) * [1.0, 0.5, 0.1]
    matrix = root.T @ root
    return matrix, matrix[np.triu_indices(3)]


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_a_spherical_gaussian_has_this_mean_and_integral(sharpness):
    grid, weights = sphere_grid(Z, min(1.0, 2.0 / np.sqrt(sharpness)), 300, 64)
    value = weights * sg_evaluate(grid, Z, sharpness)
    length = (value * grid[:, 2]).sum() / value.sum()
    assert clusters.compute_mean_length(NUMPY, sharpness) == pytest.approx(length, rel=QUADRATURE)
    assert clusters.compute_sharpness_of_mean(NUMPY, length) == pytest.approx(sharpness, rel=0.06)
    found = clusters.evaluate_gaussian(NUMPY, grid[:, 2], sharpness)
    assert (weights * found).sum() == pytest.approx(1.0, rel=QUADRATURE)
    np.testing.assert_allclose(found, value / weights / value.sum(), rtol=1e-6, atol=1e-12)


def test_the_mean_has_no_step_and_no_division_by_zero():
    around = clusters.MIN_EXACT_SHARPNESS * np.array([0.0, 1e-9, 1.0 - 1e-9, 1.0 + 1e-9])
    found = clusters.compute_mean_length(NUMPY, around)
    np.testing.assert_allclose(found, around / 3.0, rtol=1e-3)
    assert clusters.compute_sharpness_of_mean(NUMPY, 1.0) == pytest.approx(clusters.MAX_SHARPNESS)
    assert clusters.compute_sharpness_of_mean(NUMPY, 0.0) == 0.0


@pytest.mark.parametrize("sharpness", SHARPNESSES)
@pytest.mark.parametrize("cosine", [-0.9, -0.3, 0.0, 0.2, 0.6, 1.0])
def test_positive_cosines_against_quadrature(sharpness, cosine):
    normal = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
    grid, weights = sphere_grid(Z, min(1.0, 2.0 / np.sqrt(sharpness)), 200, 256)
    value = weights * sg_evaluate(grid, Z, sharpness)
    value /= value.sum()
    cosines = grid @ normal
    length = clusters.compute_mean_length(NUMPY, sharpness)
    variance = clusters.compute_cosine_variance(cosine, length, length / sharpness, 1.0 - cosine**2)
    assert length * cosine == pytest.approx((value * cosines).sum(), abs=1e-8)
    assert variance == pytest.approx((value * cosines**2).sum() - (length * cosine) ** 2, abs=1e-8)
    found = clusters.compute_positive_mean(NUMPY, length * cosine, variance)
    assert found == pytest.approx((value * np.maximum(cosines, 0.0)).sum(), abs=POSITIVE_MEAN)


def test_positive_share_is_the_derivative_of_the_positive_mean():
    step = 1e-6
    for mean in (-3.0, -0.2, 0.0, 0.1, 2.0):
        below, above = (clusters.compute_positive_mean(NUMPY, mean + way * step, 0.3) for way in (-1.0, 1.0))
        found = clusters.compute_positive_share(mean, clusters.compute_positive_mean(NUMPY, mean, 0.3))
        assert found == pytest.approx((above - below) / (2.0 * step), abs=1e-8)
    assert clusters.compute_positive_share(-1.0, 0.0) == 0.0


def test_offset_and_turned_basis(rng):
    for _ in range(20):
        axis, direction = normalize(rng.normal(size=3)), normalize(rng.normal(size=3))
        basis = make_frame(axis)
        x, y, twice = clusters.project_direction(NUMPY, axis, basis, direction)
        assert np.hypot(x, y) == pytest.approx(np.linalg.norm(direction - axis), rel=1e-9)
        across = direction - (direction @ axis) * axis
        np.testing.assert_allclose(normalize(np.array([x, y])), normalize(np.array(basis) @ across), atol=1e-9)
        matrix, six = draw_covariance(rng)
        turn = rotate(normalize(np.cross(axis, direction)), np.arccos(axis @ direction))
        turned = np.array(basis) @ turn.T
        np.testing.assert_allclose(turned @ direction, 0.0, atol=1e-12)
        expected = turned @ matrix @ turned.T
        found = clusters.project_covariance(axis, basis, direction, twice, six)
        np.testing.assert_allclose(found, expected[np.triu_indices(2)], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(clusters.multiply_covariance(six, axis), matrix @ axis, rtol=ROUNDING)


def test_opposite_directions_have_a_finite_offset():
    assert np.isfinite(clusters.project_direction(NUMPY, Z, make_frame(Z), -Z)).all()


LOBE, LIGHT = (0.02, 0.004, 0.01), (0.006, -0.003, 0.015)


def make_plane(half, count):
    """Return points of a square around 0, shape (count^2, 2), and the area of each."""
    steps = np.linspace(-half, half, count)
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2), (steps[1] - steps[0]) ** 2


@pytest.mark.parametrize("beckmann", [True, False])
def test_a_lobe_through_a_gaussian_is_their_convolution_in_the_plane(beckmann):
    points, area = make_plane(4.0, 1601)
    inverse = np.linalg.inv([[LOBE[0], LOBE[1]], [LOBE[1], LOBE[2]]])
    square = np.einsum("ni,ij,nj->n", points, inverse, points)
    # With the covariance A / 2, GGX is (1 + r A^-1 r)^-2.
    profile = np.exp(-0.5 * square) if beckmann else (1.0 + 0.5 * square) ** -2.0
    profile /= profile.sum() * area
    light = np.linalg.inv([[LIGHT[0], LIGHT[1]], [LIGHT[1], LIGHT[2]]])
    for offset in ((0.0, 0.0), (0.1, 0.05), (0.3, -0.1)):
        away = points - offset
        gaussian = np.exp(-0.5 * np.einsum("ni,ij,nj->n", away, light, away))
        expected = (profile * gaussian).sum() / gaussian.sum()
        found = clusters.evaluate_lobe(NUMPY, offset, LOBE, LIGHT, beckmann)
        # The mixture that stands for GGX ends earlier than its tails.
        assert found == pytest.approx(expected, rel=1e-6 if beckmann else 0.07)


def test_lobes_have_an_integral_of_one():
    points, area = make_plane(12.0, 1501)
    wide = tuple(20.0 * part for part in LOBE)
    for beckmann in (True, False):
        found = clusters.evaluate_lobe(NUMPY, tuple(points.T), wide, LIGHT, beckmann)
        assert found.sum() * area == pytest.approx(1.0, rel=1e-4)
    bound = clusters.bound_lobe(NUMPY, tuple(points.T), wide, 0.1)
    # A part of the long tails lies outside the square.
    assert 0.98 < bound.sum() * area < 1.0
    assert bound.min() > 0.0


@pytest.mark.parametrize(
    ("alpha", "view_angle", "most"), [(0.05, 0.3, 0.1), (0.12, 0.3, 0.1), (0.12, 0.9, 0.1), (0.25, 0.6, 0.15)]
)
def test_reflected_light_of_a_cluster_against_quadrature(alpha, view_angle, most):
    """A spherical Gaussian that a GGX surface reflects, by the true BRDF over the sphere."""
    view = np.array([np.sin(view_angle), 0.0, np.cos(view_angle)])
    lobe = make_covariance_lobe(
        NUMPY, Z, view, view[2], [alpha, alpha], ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), 1e-6, beckmann=False
    )
    axis = np.array(lobe.axis)
    basis = make_frame(axis)
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = lobe.covariance
    matrix = matrix + np.triu(matrix, 1).T
    plane = (np.array(basis) @ matrix @ np.array(basis).T)[np.triu_indices(2)]
    grid, weights = sphere_grid(axis, 2.0 * alpha, 300, 256)
    reflected = weights * ggx.ggx_brdf(view, grid, alpha) * np.maximum(grid[:, 2], 0.0)
    errors, peak = [], 0.0
    for sharpness in (30.0, 300.0):
        for turn in (-0.3, -0.1, 0.0, 0.1, 0.3):
            towards = rotate(np.array([0.0, 1.0, 0.0]), turn) @ axis
            expected = (reflected * clusters.evaluate_gaussian(NUMPY, grid @ towards, sharpness)).sum()
            x, y, twice = clusters.project_direction(NUMPY, axis, basis, towards)
            even = [1.0 / sharpness, 0.0, 0.0, 1.0 / sharpness, 0.0, 1.0 / sharpness]
            light = clusters.project_covariance(axis, basis, towards, twice, even)
            found = reflected.sum() * clusters.evaluate_lobe(NUMPY, (x, y), plane, light, False)
            errors.append(found - expected)
            peak = max(peak, expected)
    assert np.abs(errors).max() < most * peak
