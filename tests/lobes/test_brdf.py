"""Reference BRDFs against the integrals that define them, and single lobes against the best fit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from lobewise.fitting import ggx
from lobewise.lobes import albedo

from .oracles import brdf, sg
from .quadrature import Surface, gauss, lobe_stretch, normalize, rms, sphere_grid
from .tolerances import HORIZON, QUADRATURE, ROUNDING

ALPHAS = [(0.01, 0.01), (0.1, 0.1), (0.5, 0.5), (1.0, 1.0), (0.05, 0.3), (0.8, 0.2)]
COSINES = [0.02, 0.1, 0.3, 0.7, 1.0]
NORMAL = np.array([0.0, 0.0, 1.0])


def look(cosine, phi=0.4):
    sine = np.sqrt(1.0 - cosine * cosine)
    return np.array([sine * np.cos(phi), sine * np.sin(phi), cosine])


def normals_grid(alpha_u, alpha_v, radial=300, angular=256):
    """A grid of normals whose tangents are spread as those of the density, by elliptic rings."""
    return sphere_grid(NORMAL, 1.0, radial, angular, np.diag([alpha_u, alpha_v, 0.0]))


hemisphere = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.02, 1.0)).map(np.array).map(normalize)
alphas = st.floats(0.01, 1.0)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_densities_are_normalised(alpha):
    half, weights = normals_grid(*alpha)
    upper = weights * np.maximum(half[:, 2], 0.0)
    assert np.sum(upper * ggx.ggx_normal_density(half, *alpha)) == pytest.approx(1.0, abs=HORIZON)
    assert np.sum(upper * brdf.beckmann_normal_density(half, *alpha)) == pytest.approx(1.0, abs=HORIZON)


@pytest.mark.sampled("alpha0-0.02", "alpha1-0.3", "alpha3-0.1", "alpha5-1.0")
@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_masking_is_what_makes_visible_area_come_out(alpha, cosine):
    # Smith: cos(theta) = G1 * integral of D <v, h>; it defines Lambda without any formula for it
    view = look(cosine)
    half, weights = normals_grid(*alpha, 500, 384)
    facing = weights * np.maximum(half @ view, 0.0)
    for density, smith in (
        (ggx.ggx_normal_density, ggx.ggx_smith_lambda),
        (brdf.beckmann_normal_density, brdf.beckmann_smith_lambda),
    ):
        area = np.sum(facing * density(half, *alpha))
        assert area / cosine == pytest.approx(1.0 + float(smith(view, *alpha)), rel=5e-3)


@given(hemisphere, hemisphere, alphas, alphas)
def test_reciprocity_and_sign(view, light, alpha_u, alpha_v):
    for function in (ggx.ggx_brdf, brdf.beckmann_brdf):
        value = function(view, light, alpha_u, alpha_v)
        assert value >= 0.0
        assert value == pytest.approx(float(function(light, view, alpha_u, alpha_v)), rel=1e-9, abs=1e-300)
        assert function(view, light * np.array([1.0, 1.0, -1.0]), alpha_u, alpha_v) == 0.0
        assert function(view * np.array([1.0, 1.0, -1.0]), light, alpha_u, alpha_v) == 0.0
    value = brdf.oren_nayar_brdf(view, light, alpha_u)
    assert value == pytest.approx(float(brdf.oren_nayar_brdf(light, view, alpha_u)), rel=1e-9)


@given(hemisphere, hemisphere, alphas)
def test_ggx_is_the_usual_real_time_form(view, light, alpha):
    half = normalize(view + light)
    square = alpha * alpha
    density = square / (np.pi * (half[2] ** 2 * (square - 1.0) + 1.0) ** 2)
    shadow_l = light[2] * np.sqrt(view[2] ** 2 * (1.0 - square) + square)
    shadow_v = view[2] * np.sqrt(light[2] ** 2 * (1.0 - square) + square)
    expected = density * 0.5 / (shadow_l + shadow_v)
    assert ggx.ggx_brdf(view, light, alpha) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", ALPHAS)
def test_reflection_keeps_energy(alpha, kind, cosine):
    surface = Surface(np.eye(3), look(cosine), *alpha, kind)
    axis, stretch = lobe_stretch([surface.lobe()])
    directions, weights = sphere_grid(axis, 2.0, 160, 160, stretch)
    albedo = np.sum(weights * surface.evaluate(directions))
    assert 0.25 < albedo < 1.0 + HORIZON
    if max(alpha) <= 0.1 and cosine >= 0.3:
        assert albedo > 0.93


def test_oren_nayar_in_angles_and_its_smooth_limit():
    view, light, sigma = look(0.7, 0.2), look(0.4, 0.9), 0.5
    a, b = 1.0 - 0.5 * 0.25 / 0.58, 0.45 * 0.25 / 0.34
    angles = np.arccos([0.7, 0.4])
    value = (a + b * np.cos(0.7) * np.sin(angles.max()) * np.tan(angles.min())) / np.pi
    assert brdf.oren_nayar_brdf(view, light, sigma) == pytest.approx(value, rel=1e-12)
    assert brdf.oren_nayar_brdf(view, light, 0.0) == pytest.approx(1.0 / np.pi, rel=ROUNDING)
    assert brdf.lambert_brdf(view, light) == pytest.approx(1.0 / np.pi)
    assert brdf.lambert_brdf(view, -light) == 0.0


@pytest.mark.parametrize("angle", [0.0, 1e-5, 0.3, 1.2, 2.0, 3.0, np.pi])
def test_lambert_similarity_against_quadrature(angle):
    other = np.array([np.sin(angle), 0.0, np.cos(angle)])
    # by longitude around the y axis both horizons are grid lines: [angle - pi/2, pi/2] is where both are lit
    u, w = gauss(100)
    low = angle - np.pi / 2.0
    longitude = low + (np.pi / 2.0 - low) * u
    inner = 4.0 / 3.0 * (np.pi / 2.0 - low) * np.sum(w * np.cos(longitude) * np.cos(longitude - angle))
    assert brdf.lambert_similarity(NORMAL, other) == pytest.approx(inner / (2.0 * np.pi / 3.0), abs=1e-12)


@given(hemisphere, alphas, alphas)
def test_dominant_normal_is_between_view_and_normal(view, alpha_u, alpha_v):
    m = brdf.ggx_dominant_visible_normal(view, alpha_u, alpha_v)
    assert np.linalg.norm(m) == pytest.approx(1.0, abs=ROUNDING)
    assert m @ view >= view[2] - 1e-12
    assert m[2] >= normalize(view + NORMAL)[2] - 1e-12 or alpha_u > 1.0


def test_dominant_normal_by_numbers():
    view = np.array([0.6, 0.48, 0.64])
    # 0.09 * 0.36 + 0.01 * 0.2304 = 0.034704
    scale = 0.7 + 0.6 * np.sqrt(0.03)
    expected = normalize(np.array([0.054 * scale, 0.0048 * scale, np.sqrt(0.4096 + scale * 0.034704) + 0.64]))
    np.testing.assert_allclose(brdf.ggx_dominant_visible_normal(view, 0.3, 0.1), expected, rtol=1e-12)


def test_dominant_normal_limits():
    view = look(0.3)
    np.testing.assert_allclose(brdf.ggx_dominant_visible_normal(view, 0.0), NORMAL)
    # alpha 1 is a hemisphere of normals: half way to the viewer
    np.testing.assert_allclose(brdf.ggx_dominant_visible_normal(view, 1.0), normalize(view + NORMAL))


# alpha, n.v, then degrees from the normal: mirror, best single spherical Gaussian, about the dominant visible normal
# whose squares are not scaled
SINGLE_LOBES = [
    (0.05, 0.2, 78.5, 78.0, 77.8),
    (0.1, 0.2, 78.5, 76.6, 75.8),
    (0.1, 0.7, 45.6, 45.4, 45.0),
    (0.2, 0.2, 78.5, 71.0, 69.1),
    (0.2, 0.7, 45.6, 44.8, 43.3),
    (0.35, 0.2, 78.5, 59.5, 55.7),
    (0.35, 0.7, 45.6, 40.9, 38.6),
    (0.5, 0.2, 78.5, 44.8, 41.3),
    (0.5, 0.7, 45.6, 32.4, 31.9),
    (0.7, 0.4, 66.4, 23.0, 24.0),
]


@pytest.mark.parametrize("row", SINGLE_LOBES)
def test_single_lobes_against_the_best_one(row):
    alpha, cosine, mirror, best, dominant = row
    view = look(cosine, np.pi)  # so that the reflection is on the side of +x
    surface = Surface(np.eye(3), view, alpha, alpha)
    axis, stretch = lobe_stretch([surface.lobe()])
    directions, weights = sphere_grid(axis, 2.0, 100, 96, stretch)
    values = weights * surface.evaluate(directions)

    def misfit(parameters):
        angle, logarithm = parameters
        lobe = np.array([np.sin(angle), 0.0, np.cos(angle)]), np.exp(logarithm)
        return -np.sum(values * sg.sg_evaluate(directions, *lobe)) / np.sqrt(sg.sg_integral(2.0 * lobe[1]))

    lobe, sharpness = brdf.reflect_ggx_sg(view, alpha)
    start = [np.radians(best), np.log(sharpness)]
    found = minimize(misfit, start, method="Nelder-Mead", options={"xatol": 1e-5}).x
    assert np.degrees(found[0]) == pytest.approx(best, abs=0.1)
    turned = np.degrees(np.arctan2(lobe[0], lobe[2]))
    assert dominant - 0.06 <= turned <= mirror
    if alpha <= 0.2:  # what the scale of the squares is for
        assert abs(turned - best) < 0.75 * abs(dominant - best) + 0.1


def test_reflected_sharpness_is_the_determinant_of_the_warp():
    view = look(0.6)

    def reflect(x, y):
        return brdf.reflect(view, normalize(np.array([x, y, 1.0])))

    step = 1e-6
    columns = np.stack([reflect(step, 0.0) - reflect(-step, 0.0), reflect(0.0, step) - reflect(0.0, -step)]) / (
        2 * step
    )
    area = np.sqrt(np.linalg.det(columns @ columns.T))
    assert area == pytest.approx(4.0 * 0.6, rel=1e-9)
    axis, sharpness = brdf.reflect_sg(view, 100.0, NORMAL)
    assert sharpness == pytest.approx(100.0 / area, rel=1e-9)
    np.testing.assert_allclose(axis, brdf.reflect(view, NORMAL))
    # grazing: no sharper than at n.v = 0.1
    assert brdf.reflect_sg(look(0.02), 100.0, NORMAL)[1] == pytest.approx(250.0)


def measure_albedo(cosine, alpha):
    """Return (white albedo, its part under Schlick's fifth power) by sampling normals as the density does."""
    view = look(cosine, 0.0)
    u, w = gauss(160)
    phi = 2.0 * np.pi * (np.arange(192) + 0.5) / 192
    tangent = alpha * np.sqrt(u / (1.0 - u))[:, None]
    half = np.stack([tangent * np.cos(phi), tangent * np.sin(phi), np.ones((160, 192))], axis=-1)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cos_half = half @ view
    light = 2.0 * cos_half[..., None] * half - view
    value = ggx.ggx_brdf(view, light, alpha) * np.maximum(light[..., 2], 0.0) * 4.0 * np.maximum(cos_half, 0.0)
    value = w[:, None] / 192 * value / (ggx.ggx_normal_density(half, alpha) * half[..., 2])
    return np.sum(value), np.sum(value * (1.0 - np.clip(cos_half, 0.0, 1.0)) ** 5)


def test_directional_albedo_against_quadrature():
    errors, relative = [], []
    for alpha in (0.01, 0.03, 0.1, 0.25, 0.5, 0.75, 1.0):
        for cosine in (0.02, 0.06, 0.15, 0.3, 0.6, 1.0):
            white, grazing = measure_albedo(cosine, alpha)
            bias, scale = albedo.ggx_directional_albedo_terms(cosine, alpha)
            errors.append(bias + scale - white)
            dielectric = 0.04 * white + 0.96 * grazing
            relative.append(albedo.ggx_directional_albedo(cosine, alpha, 0.04) / dielectric - 1.0)
    assert np.abs(errors).max() < 0.0125
    assert rms(errors) < 0.006
    assert np.abs(relative).max() < 0.04
    assert rms(relative) < 0.02


def test_directional_albedo_stays_in_range():
    cosine, alpha = np.meshgrid(np.linspace(0.0, 1.0, 301), np.linspace(0.0, 1.0, 301))
    bias, scale = albedo.ggx_directional_albedo_terms(cosine, alpha)
    assert bias.min() >= 0.0
    assert scale.min() >= 0.0
    assert (bias + scale).max() < 1.003
    # a mirror: everything for white, Schlick for the rest
    np.testing.assert_allclose((bias + scale)[0], 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(bias[0, 3:], (1.0 - cosine[0, 3:]) ** 5, atol=0.03)


class Symbol:
    """A number that knows arithmetic and nothing else, as an array of a just-in-time compiler does."""

    def __init__(self, value):
        self.value = value

    def _apply(self, other, function):
        return Symbol(function(self.value, other.value if isinstance(other, Symbol) else other))

    def __add__(self, other):
        return self._apply(other, lambda a, b: a + b)

    def __sub__(self, other):
        return self._apply(other, lambda a, b: a - b)

    def __mul__(self, other):
        return self._apply(other, lambda a, b: a * b)

    def __truediv__(self, other):
        return self._apply(other, lambda a, b: a / b)

    def __rsub__(self, other):
        return self._apply(other, lambda a, b: b - a)

    __radd__, __rmul__ = __add__, __mul__


def test_directional_albedo_needs_arithmetic_only():
    value = albedo.ggx_directional_albedo(Symbol(0.4), Symbol(0.3), Symbol(0.5))
    assert value.value == albedo.ggx_directional_albedo(0.4, 0.3, 0.5)


def test_quadrature_tolerance_is_not_idle():
    # the sphere grid that the energies above stand on, on a lobe whose integral is known
    directions, weights = sphere_grid(NORMAL, 0.3)
    total = np.sum(weights * sg.sg_evaluate(directions, NORMAL, 30.0))
    assert total == pytest.approx(float(sg.sg_integral(30.0)), rel=QUADRATURE)
