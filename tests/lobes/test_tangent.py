"""Covariance lobes: their construction step by step, laws, and the similarity against quadrature."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lobewise.lobes.covariance import GGX_LIMIT

from .oracles import brdf, tangent
from .oracles.tangent import TangentLobe, make_tangent_lobe
from .quadrature import draw_pairs, measure_similarity, normalize, rms, rotate, stack_lobes, unpack
from .tolerances import ROUNDING, SIMILARITY

X, Y, Z = np.eye(3)
UPPER = np.triu_indices(3)


def build_by_steps(view, frame, alpha_u, alpha_v, limit, tau, beckmann):
    """The construction with explicit frames and 2x2 matrices: (axis, 3x3 covariance, determinant)."""
    t, b, _ = frame
    w = frame @ view
    scale = min(1.0, 0.7 + 0.6 * np.sqrt(alpha_u * alpha_v))
    m = np.array([scale * alpha_u**2 * w[0], scale * alpha_v**2 * w[1], 0.0])
    m[2] = np.sqrt(scale * alpha_u**2 * w[0] ** 2 + scale * alpha_v**2 * w[1] ** 2 + w[2] ** 2) + w[2]
    m = normalize(m)
    cosine, m = m[2], m @ frame
    z = 2.0 * (m @ view) * m - view
    x = normalize(np.cross(view, m))
    y_half = np.cross(m, x)
    y = np.cross(z, x)
    deficit_u, deficit_v = (1.0, 1.0) if beckmann else (1.0 - alpha_u**2, 1.0 - alpha_v**2)
    p = alpha_u**2 / deficit_u * np.outer(t, t) + alpha_v**2 / deficit_v * np.outer(b, b)
    half_basis = np.stack([x, y_half])
    jacobian = np.diag([2.0 * max(m @ view, 0.03), 2.0])
    a = jacobian @ (half_basis @ p @ half_basis.T) @ jacobian / cosine
    sigma = 0.5 * np.linalg.inv(np.linalg.inv(a) + limit * np.eye(2)) + tau**2 * np.eye(2)
    basis = np.stack([x, y])
    return z, basis.T @ sigma @ basis, np.linalg.det(sigma)


def random_surface(rng, alphas=(0.01, 0.999), cosines=(0.02, 0.999)):
    n, helper = normalize(rng.normal(size=(2, 3)))
    t = normalize(np.cross(n, helper))
    frame = np.stack([t, np.cross(n, t), n])
    cosine, phi = rng.uniform(*cosines), rng.uniform(0.0, 2.0 * np.pi)
    sine = np.sqrt(1.0 - cosine**2)
    view = np.array([sine * np.cos(phi), sine * np.sin(phi), cosine]) @ frame
    return frame, view, np.exp(rng.uniform(*np.log(alphas), 2))


@pytest.mark.sampled("False-True", "True-False")
@pytest.mark.parametrize("beckmann", [False, True])
@pytest.mark.parametrize("grazing", [False, True])
def test_construction_is_the_one_by_steps(rng, beckmann, grazing):
    for _ in range(300):
        frame, view, alpha = random_surface(rng, cosines=(0.001, 0.04) if grazing else (0.02, 0.999))
        limit = 0.5 if beckmann else 0.35
        z, covariance, determinant = build_by_steps(view, frame, *alpha, limit, 0.01, beckmann)
        lobe = make_tangent_lobe(view, frame[2], *alpha, frame[0], tau=0.01, beckmann=beckmann)
        np.testing.assert_allclose(lobe.axis, z, atol=1e-13)
        np.testing.assert_allclose(lobe.covariance, covariance[UPPER], atol=1e-11 * np.trace(covariance))
        assert lobe.determinant == pytest.approx(determinant, rel=1e-8)


@pytest.mark.parametrize("beckmann", [False, True])
def test_isotropic_lobe_is_the_anisotropic_one_with_equal_alphas(rng, beckmann):
    for cosines in ((0.001, 0.04), (0.02, 1.0)):
        for _ in range(200):
            frame, view, (alpha, _) = random_surface(rng, cosines=cosines)
            plain = make_tangent_lobe(view, frame[2], alpha, tau=1e-3, beckmann=beckmann)
            other = make_tangent_lobe(view, frame[2], alpha, alpha, frame[0], tau=1e-3, beckmann=beckmann)
            for a, b in zip(plain, other, strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("anisotropic", [False, True])
def test_stored_numbers_belong_together(rng, anisotropic):
    for _ in range(100):
        frame, view, (alpha_u, alpha_v) = random_surface(rng)
        lobe = make_tangent_lobe(view, frame[2], alpha_u, *((alpha_v, frame[0]) if anisotropic else ()), tau=0.002)
        matrix = unpack(lobe.covariance)
        assert np.linalg.norm(lobe.axis) == pytest.approx(1.0, abs=1e-13)
        np.testing.assert_allclose(matrix @ lobe.axis, 0.0, atol=1e-13)
        values = np.linalg.eigvalsh(matrix)
        assert values[1] * values[2] == pytest.approx(float(lobe.determinant), rel=1e-7)
        assert values[1] > 0.002**2 * (1.0 - 1e-6)


def test_published_construction():
    view = np.array([0.6, 0.0, 0.8])
    lobe = make_tangent_lobe(view, Z, 0.1, 0.2, X)
    np.testing.assert_allclose(lobe.axis, [-0.59528574, 0.0, 0.80351409], atol=6e-9)
    np.testing.assert_allclose(lobe.covariance, [0.0128612, 0.0, 0.00952826, 0.05163244, 0.0, 0.00705904], atol=6e-9)
    assert lobe.determinant == pytest.approx(0.0010285303731129433, rel=1e-9)


def test_covariance_is_how_reflection_spreads_normals():
    # narrow lobes: normals with slopes of covariance alpha^2/2, reflected one by one about each of them
    frame, view, _ = random_surface(np.random.default_rng(5), cosines=(0.3, 0.9))
    alpha = np.array([2e-4, 5e-4])
    lobe = make_tangent_lobe(view, frame[2], *alpha, frame[0])
    u, w = np.polynomial.hermite_e.hermegauss(5)
    w = w / np.sum(w)
    slopes = alpha[:, None] / np.sqrt(2.0) * u
    normals = normalize(frame[2] + slopes[0][:, None, None] * frame[0] + slopes[1][None, :, None] * frame[1])
    spread = brdf.reflect(np.broadcast_to(view, normals.shape), normals) - brdf.reflect(view, frame[2])
    covariance = np.einsum("i,j,ijk,ijl->kl", w, w, spread, spread)
    np.testing.assert_allclose(lobe.covariance, covariance[UPPER], atol=2e-6 * np.trace(covariance))


def test_limits_of_roughness():
    view = normalize(np.array([0.5, 0.2, 0.6]))
    mirror = make_tangent_lobe(view, Z, 0.0, tau=0.01)
    np.testing.assert_allclose(mirror.axis, brdf.reflect(view, Z))
    across = (np.eye(3) - np.outer(mirror.axis, mirror.axis)) * 1e-4
    np.testing.assert_allclose(mirror.covariance, across[UPPER], atol=1e-18)
    assert mirror.determinant == pytest.approx(1e-8)
    for tangents in ((), (1.0, X)):
        rough = make_tangent_lobe(view, Z, 1.0, *tangents)
        assert rough.determinant == pytest.approx((0.5 / GGX_LIMIT) ** 2)
        assert np.isfinite(rough.covariance).all()
    # continuous up to both ends
    for end, inside in ((0.0, 1e-12), (1.0, 1.0 - 1e-9)):
        a, b = (make_tangent_lobe(view, Z, alpha, 0.5, X, tau=0.01) for alpha in (end, inside))
        np.testing.assert_allclose(a.covariance, b.covariance, atol=1e-7)
    # straight from above there is no plane of incidence
    above = make_tangent_lobe(Z, Z, 0.3)
    np.testing.assert_allclose(above.axis, Z)
    assert above.covariance[0] == pytest.approx(float(above.covariance[3]))


def judge(pairs, *grid):
    i, j = (stack_lobes(side) for side in zip(*pairs, strict=True))
    return np.array([measure_similarity(*pair, *grid or (60, 64)) for pair in pairs]), i, j


@pytest.mark.sampled("one-False-0.027-0.048")
@pytest.mark.parametrize(
    ("anisotropy", "wide", "bound", "bound_16"),
    [
        ("none", False, 0.023, 0.048),
        ("one", False, 0.027, 0.048),
        ("two", False, 0.035, 0.048),
        ("none", True, 0.030, 0.070),
        ("one", True, 0.040, 0.070),
    ],
)
def test_ggx_similarity_against_quadrature(anisotropy, wide, bound, bound_16):
    truth, i, j = judge(draw_pairs(300, anisotropy=anisotropy, wide=wide, seed=7), *((80, 96) if wide else ()))
    assert 0.1 < truth.std() < 0.4  # the population asks something
    value = tangent.tangent_approx_similarity(i, j)
    assert rms(value - truth) < bound
    assert rms(value**16 - truth**16) < bound_16


@pytest.mark.nightly
def test_one_spherical_gaussian_is_several_times_worse():
    from .oracles import sg

    pairs = draw_pairs(300, seed=7)
    truth, i, j = judge(pairs)
    values = []
    for pair in pairs:
        lobes = []
        for surface in pair:
            axis, sharpness = brdf.reflect_ggx_sg(surface.local_view, surface.alpha_u)
            lobes += [axis @ surface.frame, sharpness]
        values.append(float(sg.sg_slide_similarity(*lobes)))
    assert rms(np.array(values) - truth) > 4.0 * rms(tangent.tangent_approx_similarity(i, j) - truth)


@given(seed=st.integers(0, 2**32 - 1), beta=st.floats(0.25, 40.0))
def test_laws(seed, beta):
    function = tangent.tangent_approx_similarity
    rng = np.random.default_rng(seed)
    lobes, turned = [], []
    turn = rotate(normalize(rng.normal(size=3)), rng.uniform(0.0, 3.0))
    for _ in range(2):
        frame, view, alpha = random_surface(rng)
        lobes.append(make_tangent_lobe(view, frame[2], *alpha, frame[0], tau=1e-3))
        turned.append(make_tangent_lobe(turn @ view, turn @ frame[2], *alpha, turn @ frame[0], tau=1e-3))
    value = function(*lobes)
    assert 0.0 <= value <= 1.0
    assert value == pytest.approx(float(function(lobes[1], lobes[0])), rel=ROUNDING)
    assert function(lobes[0], lobes[0]) == pytest.approx(1.0, abs=1e-8)
    assert function(*turned) == pytest.approx(float(value), rel=1e-5, abs=1e-12)
    assert function(*lobes, beta) == pytest.approx(float(value) ** beta, rel=1e-9, abs=1e-70)


@pytest.mark.parametrize("angle", [0.01, 0.3, 1.0, 2.0])
def test_invariants_of_two_round_lobes(angle):
    # with v along the axis as well the turned covariance of a round lobe is v I: Q = 2 v |d|^2 and P = 4 v^2
    variance = 0.05
    axes = [np.array([np.sin(0.5 * a), 0.0, np.cos(0.5 * a)]) for a in (angle, -angle)]
    lobes = [TangentLobe(z, variance * (np.eye(3) - np.outer(z, z))[UPPER], np.asarray(variance**2)) for z in axes]
    square = (2.0 * np.sin(0.5 * angle)) ** 2
    q = square / (2.0 * variance)
    assert tangent.tangent_approx_similarity(*lobes) == pytest.approx((1.0 + 0.25 * q) ** -2.4, rel=1e-10)


def test_opposite_and_sharp_lobes_are_not_alike():
    function = tangent.tangent_approx_similarity
    lobe = make_tangent_lobe(Z, Z, 0.3)
    opposite = TangentLobe(-lobe.axis, lobe.covariance, lobe.determinant)
    assert function(lobe, opposite) < 0.05
    sharp, far = (make_tangent_lobe(Z, n, 1e-4, tau=1e-4) for n in (Z, normalize(np.array([0.5, 0.0, 1.0]))))
    assert function(sharp, far) < 1e-12


def test_concentric_lobes_of_two_sizes():
    i, j = (make_tangent_lobe(Z, Z, alpha) for alpha in (0.1, 0.25))
    a, b = (float(lobe.covariance[0]) for lobe in (i, j))
    ratio = 2.0 * np.sqrt(a * b) / (a + b)
    assert tangent.tangent_approx_similarity(i, j) == pytest.approx(ratio**0.6, rel=1e-12)


def test_width_power_is_that_of_concentric_lobes():
    for ratio, error in ((2.0, 6e-4), (4.0, 0.007), (9.0, 0.026)):
        a, b = 1.0, ratio
        exact = 3.0 * (a * b) ** 1.5 * ((a + b) / (a * b * (a - b) ** 2) - 2.0 * np.log(a / b) / (a - b) ** 3)
        power = (2.0 * np.sqrt(a * b) / (a + b)) ** tangent.GGX_WIDTH_POWER
        assert 0.0 < power - exact < error


def test_similarity_tolerance_covers_the_small_grid():
    for pair in draw_pairs(10, anisotropy="two", seed=4):
        assert measure_similarity(*pair, 60, 64) == pytest.approx(measure_similarity(*pair, 200, 256), abs=SIMILARITY)
