"""Anisotropic spherical Gaussians against quadrature, eigenvectors, planar Gaussians, limits and laws."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ive

from lobewise.lobes import covariance
from lobewise.lobes.numbers import NUMPY

from .oracles import asg, brdf, sg, tangent
from .quadrature import draw_pairs, lobe_stretch, measure_similarity, normalize, rotate, sphere_grid
from .tolerances import QUADRATURE, ROUNDING, SINGLE

Z = np.array([0.0, 0.0, 1.0])
X = np.array([1.0, 0.0, 0.0])
HORIZON = 1e-3
"""Relative error of grids on lobes that the equator of the lobe cuts off."""
PAIRS = 80

components = st.floats(-1.0, 1.0)
directions = (
    st.tuples(components, components, components)
    .map(np.array)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)
sharpnesses = st.floats(1e-2, 1e5)
lobes = st.builds(
    lambda axis, helper, x, y: asg.make_asg(axis, make_tangent(axis, helper), x, y),
    directions,
    directions,
    sharpnesses,
    sharpnesses,
)


def make_tangent(axis, helper):
    """Return a unit vector across ``axis``, by ``helper`` where the two are not parallel."""
    across = np.cross(axis, helper)
    fallback = np.cross(axis, np.roll(axis, 1) * np.array([1.0, -1.0, 1.0]) + np.array([0.1, 0.7, -0.3]))
    return normalize(np.where(np.linalg.norm(across, axis=-1, keepdims=True) > 1e-2, across, fallback))


def matrix(six):
    """Return the full matrix of six components."""
    return six[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*six.shape[:-1], 3, 3)


def turn_lobe(rotation, lobe):
    """Return ``lobe`` rotated."""
    full = rotation @ matrix(lobe.precision) @ rotation.T
    return asg.AsgLobe(rotation @ lobe.axis, full[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], lobe.determinant)


def draw_planar_pairs(count, low, high, *, apart=1.3, ratio=4.0, size=3.0, anywhere=False, seed=0):
    """Return two stacks of ``count`` planar Gaussians, as `TangentLobe`: random pairs of anisotropic lobes.

    The smaller ASG sharpness of the first is log-uniform in [``low``, ``high``]; the larger up to ``ratio`` times it,
    the other lobe up to ``size`` times sharper, with any twist. The axes are up to ``apart`` widths of the first apart,
    or any angle with ``anywhere``.
    """
    rng = np.random.default_rng(seed)
    small = np.exp(rng.uniform(np.log(low), np.log(high), count))
    other = small * size ** rng.random(count)
    large, other_large = small * ratio ** rng.random(count), other * ratio ** rng.random(count)
    axis_i = normalize(rng.normal(size=(count, 3)))
    x = make_tangent(axis_i, rng.normal(size=(count, 3)))
    y = np.cross(axis_i, x)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.0, apart, count)
    step = (radius * np.cos(angle) / np.sqrt(large))[:, None] * x + (radius * np.sin(angle) / np.sqrt(small))[
        :, None
    ] * y
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    far = rng.uniform(0.0, np.pi, (count, 1)) if anywhere else length
    axis_j = np.cos(far) * axis_i + np.sin(far) * step / length
    x_j = make_tangent(axis_j, rng.normal(size=(count, 3)))
    stacks = []
    for axis, across, sharpness_x, sharpness_y in ((axis_i, x, large, small), (axis_j, x_j, other_large, other)):
        along = np.cross(axis, across)
        full = (0.5 / sharpness_x)[:, None, None] * across[:, :, None] * across[:, None, :]
        full = full + (0.5 / sharpness_y)[:, None, None] * along[:, :, None] * along[:, None, :]
        six = full.reshape(count, 9)[:, [0, 1, 2, 4, 5, 8]]
        stacks.append(tangent.TangentLobe(axis, six, 0.25 / (sharpness_x * sharpness_y)))
    return stacks


def to_asg(planar):
    return asg.asg_from_covariance(*planar)


def evaluate_by_definition(direction, planar):
    """``max(w.z, 0) exp(-w^T A w)`` with A by the pseudo-inverse of the covariance."""
    precision = 0.5 * np.linalg.pinv(matrix(planar.covariance), hermitian=True, rcond=1e-9)
    exponent = np.einsum("...k,kl,...l->...", direction, precision, direction)
    return np.maximum(direction @ planar.axis, 0.0) * np.exp(-exponent)


def measure_integral(a, b, radial=60, angular=64):
    """Return the integral of the product of two planar Gaussians' ASGs by quadrature."""
    axis, stretch = lobe_stretch([a, b])
    grid, weights = sphere_grid(axis, 2.0, radial, angular, stretch / (1.0 + np.linalg.norm(stretch)))
    return np.sum(evaluate_by_definition(grid, a) * evaluate_by_definition(grid, b) * weights)


@cache
def measured_pairs(low, high, kind):
    """Return (lobes i, lobes j, true product integrals, true similarities) of one population."""
    options = {"near": {}, "wide": {"apart": 2.5, "ratio": 10.0, "size": 6.0}, "anywhere": {"anywhere": True}}
    stack_i, stack_j = draw_planar_pairs(PAIRS, low, high, seed=7, **options[kind])
    inner, similarity = [], []
    for k in range(PAIRS):
        i, j = (tangent.TangentLobe(*(part[k] for part in stack)) for stack in (stack_i, stack_j))
        inner.append(measure_integral(i, j))
        similarity.append(inner[-1] / np.sqrt(measure_integral(i, i) * measure_integral(j, j)))
    return to_asg(stack_i), to_asg(stack_j), np.array(inner), np.array(similarity)


def rms(error):
    return float(np.sqrt(np.mean(np.square(error))))


def test_evaluate_is_the_definition(rng):
    axis, direction = normalize(rng.normal(size=(2, 50, 3)))
    x = make_tangent(axis, rng.normal(size=(50, 3)))
    y = np.cross(axis, x)
    lx, ly = rng.uniform(0.0, 20.0, (2, 50))
    wx, wy, wz = (np.sum(direction * a, axis=-1) for a in (x, y, axis))
    definition = np.maximum(wz, 0.0) * np.exp(-lx * wx**2 - ly * wy**2)
    lobe = asg.make_asg(axis, x, lx, ly)
    np.testing.assert_allclose(asg.asg_evaluate(direction, lobe), definition, rtol=1e-12, atol=1e-300)
    assert np.abs(matrix(lobe.precision) @ axis[..., None]).max() < 1e-13
    np.testing.assert_allclose(asg.asg_sharpness(lobe), [np.maximum(lx, ly), np.minimum(lx, ly)], rtol=1e-9)


def test_a_round_lobe_is_near_the_spherical_gaussian():
    lobe = asg.asg_from_sg(Z, 200.0)
    np.testing.assert_allclose(lobe.precision, asg.make_asg(Z, X, 100.0, 100.0).precision, atol=1e-13)
    assert lobe.determinant == 1e4
    angle = np.linspace(0.0, 0.3, 50)
    direction = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)
    np.testing.assert_allclose(asg.asg_evaluate(direction, lobe), sg.sg_evaluate(direction, Z, 200.0), atol=3e-3)
    other = asg.asg_from_sg(direction, 200.0)
    for function in (asg.asg_similarity, asg.asg_approx_similarity):
        np.testing.assert_allclose(function(lobe, other), sg.sg_similarity(Z, 200.0, direction, 200.0), atol=2e-3)


@pytest.mark.parametrize(
    ("large", "small"),
    [(0.0, 0.0), (1e-9, 0.0), (1.0, 0.0), (1.0, 1.0), (5.0, 1.0), (100.0, 1.0), (1e4, 5.0), (1e6, 1e-2), (1e6, 1e6)],
)
def test_integral_against_adaptive_quadrature(large, small):
    def ring(phi):
        k = large * np.cos(phi) ** 2 + small * np.sin(phi) ** 2
        return -np.expm1(-k) / (2.0 * k) if k > 0.0 else 0.5

    knee = np.arctan(np.sqrt(large / small)) if small > 0.0 else 1.5
    truth = 4.0 * quad(ring, 0.0, 0.5 * np.pi, limit=400, epsabs=0.0, epsrel=1e-12, points=[knee])[0]
    assert asg.asg_integral(large, small) == pytest.approx(truth, rel=1e-11)
    assert asg.asg_integral(small, large) == pytest.approx(truth, rel=1e-11)


def test_integral_is_that_of_the_values():
    for pair in ((0.0, 0.0), (5.0, 1.0), (100.0, 30.0)):
        lobe = asg.make_asg(Z, X, *pair)
        grid, weights = sphere_grid(Z, 1.0 / np.sqrt(1.0 + pair[1]), 300, 128)
        total = np.sum(weights * asg.asg_evaluate(grid, lobe))
        assert asg.asg_integral(*pair) == pytest.approx(total, rel=QUADRATURE if pair[1] > 10.0 else HORIZON)


def test_approximate_integral_has_its_stated_errors():
    def error(*pair):
        return float(asg.asg_approx_integral(*pair) / asg.asg_integral(*pair) - 1.0)

    assert [abs(error(s, s)) < ROUNDING for s in (0.5, 3.0, 40.0)] == [True] * 3
    stated = {(2.0, 0.5): 0.027, (5.0, 1.0): 0.002, (100.0, 1.0): 0.012}
    for pair, value in stated.items():
        assert abs(error(*pair)) == pytest.approx(value, abs=6e-4)
        assert asg.asg_approx_integral(*pair[::-1]) == asg.asg_approx_integral(*pair)


@pytest.mark.parametrize(("large", "small"), [(5.0, 1.0), (40.5, 1.0), (41.5, 1.0), (60.0, 0.5), (1e5, 3.0)])
def test_approximate_integral_is_its_formula(large, small):
    # on both sides of where the Bessel function changes to its series
    excess = large - small
    terms = [2.0 * np.pi * ive(0, 0.5 * a) for a in (excess, excess + excess / small)]
    formula = np.pi / np.sqrt(large * small) - np.exp(-small) / (2.0 * large) * (terms[0] + excess / small * terms[1])
    assert asg.asg_approx_integral(large, small) == pytest.approx(formula, rel=2e-7)


def test_covariance_of_a_planar_gaussian_gives_its_shape(rng):
    planar, _ = draw_planar_pairs(20, 0.5, 1e3, seed=3)
    lobe = to_asg(planar)
    for k in range(20):
        inverse = np.linalg.pinv(matrix(planar.covariance[k]), hermitian=True, rcond=1e-9)
        np.testing.assert_allclose(matrix(lobe.precision[k]), 0.5 * inverse, atol=1e-10 * np.abs(inverse).max())
    large, small = asg.asg_sharpness(lobe)
    np.testing.assert_allclose(large * small, lobe.determinant, rtol=ROUNDING)
    np.testing.assert_allclose(lobe.determinant, 0.25 / planar.determinant, rtol=ROUNDING)


@pytest.mark.parametrize("function", [asg.asg_similarity, asg.asg_approx_similarity])
def test_sharp_lobes_are_planar_gaussians(function):
    stack_i, stack_j = draw_planar_pairs(200, 1e5, 1e6, seed=4, apart=2.0)
    planar = tangent.tangent_gaussian_similarity(stack_i, stack_j)
    np.testing.assert_allclose(function(to_asg(stack_i), to_asg(stack_j)), planar, atol=2e-5)


def test_exponent_of_the_product_is_exact(rng):
    stack_i, stack_j = draw_planar_pairs(30, 0.5, 100.0, seed=5)
    i, j = to_asg(stack_i), to_asg(stack_j)
    product = asg.asg_product(i, j)
    direction = normalize(rng.normal(size=(30, 3)))

    def planar(lobe):
        return np.einsum("nk,nkl,nl->n", direction, matrix(lobe.precision), direction)

    parts = [np.sum(direction * a, axis=-1) ** 2 for a in (product.tangent_x, product.tangent_y)]
    exponent = -np.log(product.amplitude) + product.sharpness_x * parts[0] + product.sharpness_y * parts[1]
    np.testing.assert_allclose(exponent, planar(i) + planar(j), rtol=1e-9)
    assert (product.sharpness_x >= product.sharpness_y).all()
    assert (np.sum(product.axis * (i.axis + j.axis), axis=-1) > 0.0).all()
    cosines = np.sum(product.axis * i.axis, axis=-1) * np.sum(product.axis * j.axis, axis=-1)
    np.testing.assert_allclose(product.smooth, cosines, rtol=ROUNDING)


# smallest sharpness from, to; RMSE of S that the theory page states: near, wide, anywhere; exact axes, approximate
ACCURACY = [
    (1.0, 2.0, (0.0125, 0.018, 0.027), (0.0095, 0.016, 0.013)),
    (2.0, 5.0, (0.003, 0.0055, 0.006), (0.0036, 0.0075, 0.009)),
    (5.0, 10.0, (0.0004, 0.0006, 0.0006), (0.0016, 0.003, 0.004)),
    (10.0, 100.0, (0.0001, 0.0001, 0.0002), (0.0006, 0.001, 0.002)),
]


@pytest.mark.nightly
@pytest.mark.parametrize("row", ACCURACY, ids=lambda row: f"{row[0]:g}-{row[1]:g}")
@pytest.mark.parametrize("kind", ["near", "wide", "anywhere"])
def test_similarity_against_quadrature(row, kind):
    low, high, *bounds = row
    i, j, _, truth = measured_pairs(low, high, kind)
    column = ["near", "wide", "anywhere"].index(kind)
    for function, bound in zip((asg.asg_similarity, asg.asg_approx_similarity), bounds, strict=True):
        value = function(i, j)
        assert ((value >= 0.0) & (value <= 1.0)).all()
        assert rms(value - truth) < bound[column]


def test_quadrature_of_pairs_has_converged():
    stack_i, stack_j = draw_planar_pairs(PAIRS, 1.0, 2.0, seed=7)
    *_, truth = measured_pairs(1.0, 2.0, "near")
    for k in range(3):
        i, j = (tangent.TangentLobe(*(part[k] for part in stack)) for stack in (stack_i, stack_j))
        parts = [measure_integral(a, b, 160, 192) for a, b in ((i, j), (i, i), (j, j))]
        assert truth[k] == pytest.approx(parts[0] / np.sqrt(parts[1] * parts[2]), abs=1e-3)


@pytest.mark.parametrize(("low", "high", "bound"), [(1.0, 2.0, 0.05), (5.0, 10.0, 0.0017), (10.0, 100.0, 3e-4)])
def test_product_integral_against_quadrature(low, high, bound):
    i, j, inner, _ = measured_pairs(low, high, "near")
    assert rms(asg.asg_product_integral(i, j) / inner - 1.0) < bound


@pytest.mark.parametrize("function", [asg.asg_similarity, asg.asg_approx_similarity])
@given(i=lobes, j=lobes)
def test_similarity_laws(function, i, j):
    value = float(function(i, j))
    assert 0.0 <= value <= 1.0
    assert float(function(j, i)) == pytest.approx(value, rel=1e-6, abs=1e-9)
    # the eigenvalues of a lobe and twice itself agree to the rounding of the larger
    assert function(i, i) == pytest.approx(1.0, abs=1e-6)
    turn = rotate(normalize(np.array([1.0, -2.0, 0.5])), 1.1)
    # rotating rounds the axes to 1e-16 and the small sharpness to 1e-16 of the large one
    assert function(turn_lobe(turn, i), turn_lobe(turn, j)) == pytest.approx(value, abs=1e-6)


@given(lobes, lobes, st.floats(0.5, 40.0))
def test_beta_is_a_power(i, j, beta):
    value = asg.asg_approx_similarity(i, j, beta)
    assert value == pytest.approx(float(asg.asg_approx_similarity(i, j)) ** beta, rel=1e-8, abs=1e-150)


def test_lobes_that_face_away_from_each_other_are_unlike():
    # their exponents are the same function: only the cosines tell them apart
    for sharpness in (3.0, 50.0, 1e4):
        i, j = asg.make_asg(Z, X, sharpness, 3.0 * sharpness), asg.make_asg(-Z, X, sharpness, 3.0 * sharpness)
        assert asg.asg_similarity(i, j) == 0.0
        assert asg.asg_approx_similarity(i, j) < 0.01


def test_single_precision_is_near(rng):
    stack_i, stack_j = draw_planar_pairs(4000, 1.0, 1e6, ratio=30.0, seed=11)
    pair = [to_asg(stack) for stack in (stack_i, stack_j)]
    single = [asg.AsgLobe(*(part.astype(np.float32) for part in lobe)) for lobe in pair]
    # what the axes lose by themselves in single precision is not the function's error
    rounded = [asg.AsgLobe(*(part.astype(np.float64) for part in lobe)) for lobe in single]
    for beta in (1.0, 16.0):
        value = asg.asg_approx_similarity(*single, beta)
        assert value.dtype == np.float32
        np.testing.assert_allclose(value, asg.asg_approx_similarity(*pair, beta), atol=1e-4)
        np.testing.assert_allclose(value, asg.asg_approx_similarity(*rounded, beta), atol=1e-5)
    value = asg.asg_similarity(*single)
    assert value.dtype == np.float32
    np.testing.assert_allclose(value, asg.asg_similarity(*pair), atol=2e-4)


def test_dtype_is_kept_and_shapes_broadcast(rng):
    axis = normalize(rng.normal(size=(4, 1, 3))).astype(np.float32)
    tangent_x = make_tangent(axis, normalize(rng.normal(size=(4, 1, 3)))).astype(np.float32)
    one, five = np.float32(30.0), np.full((1, 5), 7.0, np.float32)
    lobe = asg.make_asg(axis, tangent_x, one, five)
    view, normal = axis[:, 0], normalize(axis[:, 0] + np.float32(0.4) * tangent_x[:, 0])
    across = np.cross(view, normal) / np.linalg.norm(np.cross(view, normal), axis=-1, keepdims=True)
    made = [
        lobe,
        asg.asg_from_sg(axis, five),
        asg.reflect_asg(view, normal, one),
        asg.reflect_anisotropic_asg(view, normal, across, one, np.float32(3.0)),
        asg.make_ggx_asg(view, normal, np.float32(0.3)),
        asg.make_ggx_asg(view, normal, np.float32(0.3), np.float32(0.1), across, dominant=False, tau=0.1),
    ]
    for item in made:
        assert [part.dtype for part in item] == [np.float32] * 3
        assert item.axis.shape == (*item.determinant.shape, 3)
        assert item.precision.shape == (*item.determinant.shape, 6)
    assert lobe.determinant.shape == made[1].determinant.shape == (4, 5)
    assert asg.asg_similarity(lobe, made[1]).shape == asg.asg_approx_similarity(lobe, made[1]).shape == (4, 5)
    for value in (
        asg.asg_evaluate(axis, lobe),
        asg.asg_integral(five, one),
        asg.asg_approx_integral(five, one),
        asg.asg_product_integral(lobe, made[1]),
        asg.asg_sg_product_integral(lobe, axis, five),
        *asg.asg_sharpness(lobe),
        *asg.asg_product(lobe, made[1]),
    ):
        assert value.dtype == np.float32
    assert asg.asg_integral(five, one)[0, 0] == pytest.approx(float(asg.asg_integral(7.0, 30.0)), rel=10 * SINGLE)


def test_product_with_a_spherical_gaussian(rng):
    # the formula in the eigenvectors of the lobe
    axis, other = normalize(rng.normal(size=(2, 3)))
    x = make_tangent(axis, other)
    lx, ly, half = 30.0, 7.0, 11.0
    y = np.cross(axis, x)
    kx, ky = lx * half / (lx + half), ly * half / (ly + half)
    other = normalize(axis + 0.2 * x - 0.3 * y)
    exponent = kx * (other @ x) ** 2 + ky * (other @ y) ** 2
    formula = np.pi / np.sqrt((lx + half) * (ly + half)) * max(other @ axis, 0.0) * np.exp(-exponent)
    lobe = asg.make_asg(axis, x, lx, ly)
    assert asg.asg_sg_product_integral(lobe, other, 2.0 * half) == pytest.approx(formula, rel=1e-12)
    grid, weights = sphere_grid(normalize(axis + other), 0.4, 200, 128)
    truth = np.sum(weights * asg.asg_evaluate(grid, lobe) * sg.sg_evaluate(grid, other, 2.0 * half))
    assert formula == pytest.approx(truth, rel=0.05)
    sharp = asg.make_asg(axis, x, 100.0 * lx, 100.0 * ly)
    near = normalize(axis + 0.02 * x - 0.03 * y)
    grid, weights = sphere_grid(normalize(axis + near), 0.04, 200, 128)
    truth = np.sum(weights * asg.asg_evaluate(grid, sharp) * sg.sg_evaluate(grid, near, 200.0 * half))
    assert asg.asg_sg_product_integral(sharp, near, 200.0 * half) == pytest.approx(truth, rel=6e-4)
    assert asg.asg_sg_product_integral(lobe, -axis, 5.0) == 0.0


def reflected_precision(view, normal, precision, step=1e-6):
    """Return J^-T L J^-1 with the Jacobian of the reflection by finite differences."""
    x = make_tangent(normal, normalize(np.array([0.3, -0.5, 0.8])))
    frame = np.stack([x, np.cross(normal, x)])

    def mirror(m):
        m = normalize(m)
        return 2.0 * (m @ view) * m - view

    columns = [(mirror(normal + step * t) - mirror(normal - step * t)) / (2.0 * step) for t in frame]
    back = frame.T @ np.linalg.pinv(np.stack(columns, axis=-1))
    return back.T @ precision @ back


@pytest.mark.parametrize("cosine", [1.0, 0.999999, 0.7, 0.2, 0.04])
def test_reflection_is_the_jacobian_of_the_mirror(cosine):
    normal = normalize(np.array([0.2, -0.4, 0.9]))
    across = make_tangent(normal, X)
    view = cosine * normal + np.sqrt(1.0 - cosine**2) * normalize(across + 0.7 * np.cross(normal, across))
    tangent_u = make_tangent(normal, Z)
    tangent_v = np.cross(normal, tangent_u)
    for sharpness in ((30.0, 30.0), (30.0, 4.0)):
        normals = sharpness[0] * np.outer(tangent_u, tangent_u) + sharpness[1] * np.outer(tangent_v, tangent_v)
        lobe = asg.reflect_anisotropic_asg(view, normal, tangent_u, *sharpness)
        np.testing.assert_allclose(lobe.axis, 2.0 * cosine * normal - view, atol=1e-15)
        truth = reflected_precision(view, normal, normals)
        np.testing.assert_allclose(matrix(lobe.precision), truth, atol=1e-7 * np.abs(truth).max())
        assert lobe.determinant == pytest.approx(sharpness[0] * sharpness[1] / (16.0 * cosine**2), rel=1e-9)
    plain, round_ = (
        asg.reflect_asg(view, normal, 30.0),
        asg.reflect_anisotropic_asg(view, normal, tangent_u, 30.0, 30.0),
    )
    for a, b in zip(plain, round_, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_reflection_at_grazing_angles_keeps_its_width():
    view = normalize(np.array([1.0, 0.0, 0.001]))
    floor = covariance.MIN_VIEW_COSINE
    for lobe in (asg.reflect_asg(view, Z, 8.0), asg.reflect_anisotropic_asg(view, Z, X, 8.0, 8.0)):
        assert asg.asg_sharpness(lobe) == pytest.approx((2.0 / floor**2, 2.0), rel=1e-9)
        assert lobe.determinant == pytest.approx(4.0 / floor**2, rel=1e-9)
        assert np.abs(matrix(lobe.precision) @ lobe.axis).max() < 1e-9


def draw_shading(rng, count):
    normal = normalize(rng.normal(size=(count, 3)))
    view = normalize(normal + 0.95 * normalize(rng.normal(size=(count, 3))))
    return view, normal, make_tangent(normal, rng.normal(size=(count, 3))), *rng.uniform(0.02, 0.9, (2, count))


def test_ggx_lobe_is_the_covariance_lobe_in_another_scale(rng):
    # the covariance lobe's own construction, with its shape matrix over 1.131
    view, normal, tangent_u, alpha_u, alpha_v = draw_shading(rng, 30)
    scale, tau = 1.131, 0.05

    def split(a):
        return tuple(np.moveaxis(a, -1, 0))

    u, v, n, w = (split(a) for a in (tangent_u, np.cross(normal, tangent_u), normal, view))
    alphas = [alpha_u, alpha_v]
    axis, shape, determinant = covariance._make_anisotropic_lobe(
        NUMPY,
        (u, v),
        (n, w, np.sum(normal * view, axis=-1)),
        alphas,
        [1.0 - alpha**2 for alpha in alphas],
        asg.GGX_LIMIT / scale,
        scale * tau**2,
    )
    lobe = asg.make_ggx_asg(view, normal, alpha_u, alpha_v, tangent_u, tau=tau)
    np.testing.assert_allclose(lobe.axis, np.stack(axis, axis=-1), atol=1e-13)
    expected = asg.asg_from_covariance(lobe.axis, np.stack(shape, axis=-1) / scale, determinant / scale**2)
    np.testing.assert_allclose(lobe.precision, expected.precision, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(lobe.determinant, expected.determinant, rtol=1e-9)


def test_ggx_lobe_about_the_normal_is_the_warp(rng):
    view, normal, tangent_u, alpha_u, alpha_v = draw_shading(rng, 30)
    lobe = asg.make_ggx_asg(view, normal, alpha_u, alpha_v, tangent_u, dominant=False)
    sharpness = [1.131 * (1.0 / alpha**2 - 1.0) for alpha in (alpha_u, alpha_v)]
    plain = asg.reflect_anisotropic_asg(view, normal, tangent_u, *sharpness)
    limit = asg.GGX_LIMIT * (np.eye(3) - plain.axis[:, :, None] * plain.axis[:, None, :])
    # 1e-9 of variance is added to every lobe, which the sharpest, of 1e5, notices at 1e-4
    np.testing.assert_allclose(matrix(lobe.precision), matrix(plain.precision) + limit, rtol=1e-3, atol=1e-2)
    isotropic = asg.make_ggx_asg(view, normal, alpha_u)
    np.testing.assert_allclose(
        isotropic.precision, asg.make_ggx_asg(view, normal, alpha_u, alpha_u, tangent_u).precision, rtol=1e-8, atol=1e-8
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("dominant", [False, True])
def test_ggx_lobe_is_finite_from_mirror_to_matte(rng, dtype, dominant):
    view, normal, tangent_u, *_ = (a.astype(dtype) for a in draw_shading(rng, 20))
    for alpha_u, alpha_v in ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.4, 0.2), (1e-3, 1e-3)):
        lobe = asg.make_ggx_asg(view, normal, dtype(alpha_u), dtype(alpha_v), tangent_u, dominant=dominant)
        assert all(np.isfinite(part).all() for part in lobe)
        assert (lobe.determinant > 0.0).all()
        np.testing.assert_allclose(asg.asg_approx_similarity(lobe, lobe, 8.0), 1.0, atol=1e-3)
    mirror = asg.make_ggx_asg(view, normal, dtype(0.0), tau=0.01)
    np.testing.assert_allclose(mirror.determinant, 0.25e8, rtol=1e-4)


def test_ggx_lobe_against_the_whole_brdf():
    for anisotropy, bound in (("none", 0.020), ("one", 0.027)):
        pairs = draw_pairs(PAIRS, anisotropy=anisotropy, seed=2)
        truth = np.array([measure_similarity(*pair, 60, 64) for pair in pairs])
        stacks = []
        for side in (0, 1):
            surfaces = [pair[side] for pair in pairs]
            view, normal, tangent_u = (
                np.array(rows) for rows in zip(*((s.view, s.frame[2], s.frame[0]) for s in surfaces), strict=True)
            )
            alphas = np.array([(s.alpha_u, s.alpha_v) for s in surfaces])
            stacks.append(asg.make_ggx_asg(view, normal, alphas[:, 0], alphas[:, 1], tangent_u))
        for function in (asg.asg_similarity, asg.asg_approx_similarity):
            assert rms(function(*stacks) - truth) < bound


def test_dominant_normal_is_that_of_the_brdf():
    view = normalize(np.array([0.7, -0.2, 0.4]))
    lobe = asg.make_ggx_asg(view, Z, 0.3, 0.1, X)
    m = brdf.ggx_dominant_visible_normal(view, 0.3, 0.1)
    np.testing.assert_allclose(lobe.axis, 2.0 * (m @ view) * m - view, atol=1e-15)
