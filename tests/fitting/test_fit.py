"""Fitting lobes: the quadrature, what is recovered, how near the fit is, what is refused."""

import math
import sys

import numpy as np
import pytest
from scipy.integrate import quad

from lobewise.errors import InputError, MissingDependencyError
from lobewise.fitting.fit import COSINES, fit_lobes
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.nodes import make_nodes
from lobewise.fitting.table import evaluate_lobes, evaluate_table
from lobewise.lobes.albedo import ggx_directional_albedo
from lobewise.lobes.gaussian import GGX_MIXTURES
from tests.fitting.merl_tables import make_merl
from tests.lobes.oracles.brdf import beckmann_brdf, lambert_brdf, oren_nayar_brdf
from tests.lobes.oracles.sg import sg_integral
from tests.mistakes import refuses

MIN_COSINE_L2 = 0.993
"""What three anisotropic lobes must reach for tabulated GGX at n.v >= 0.3."""


def make_view(cosine, azimuth=0.0):
    """Return the view at n.v = ``cosine``."""
    sine = math.sqrt(1.0 - cosine * cosine)
    return np.asarray([sine * math.cos(azimuth), sine * math.sin(azimuth), cosine])


def measure_nearness(table, brdf, view, tangent=None):
    """Return the L2 cosine of table and BRDF on a grid about the mirror direction that the fit does not use."""
    angle = (np.arange(700) + 0.5) / 700.0
    theta, phi = (math.pi * angle**3)[:, None], 2.0 * math.pi * (np.arange(128) + 0.5) / 128
    weight = np.sin(theta) * 3.0 * angle[:, None] ** 2 * np.ones_like(phi)
    mirror = view * [-1.0, -1.0, 1.0]
    first = np.cross(mirror, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    light = np.cos(theta)[..., None] * mirror + np.sin(theta)[..., None] * (
        np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * np.cross(mirror, first)
    )
    data = np.asarray(brdf(np.broadcast_to(view, light.shape), light)) * np.maximum(light[..., 2], 0.0)
    fit = evaluate_lobes(evaluate_table(table, np.asarray([0.0, 0.0, 1.0]), view, tangent), light, table.kind)
    return np.sum(weight * data * fit) / math.sqrt(np.sum(weight * data**2) * np.sum(weight * fit**2))


def make_lobe_brdf(table):
    """Return the BRDF that reflects exactly the lobes of a table."""

    def brdf(view, light):
        lobes = evaluate_table(table, np.asarray([0.0, 0.0, 1.0]), view, np.asarray([1.0, 0.0, 0.0]))
        return evaluate_lobes(lobes, light, table.kind) / light[:, 2]

    return brdf


class TestNodes:
    @pytest.mark.parametrize("cosine", [0.05, 0.2, 0.6, 1.0])
    def test_they_integrate_over_the_sphere(self, cosine):
        nodes = make_nodes(cosine)
        np.testing.assert_allclose(np.linalg.norm(nodes.light, axis=-1), 1.0, rtol=1e-12)
        # At grazing views the edge of the half vectors turns sharply, and a round lobe's half vectors are a thin line.
        loose = cosine < 0.1
        assert math.isclose(nodes.weight.sum(), 4.0 * math.pi, rel_tol=1e-5 if loose else 1e-7)
        mirror = make_view(cosine) * [-1.0, 1.0, 1.0]
        for sharpness in (3.0, 100.0, 1e4):
            value = nodes.weight @ np.exp(sharpness * (nodes.light @ mirror - 1.0))
            assert math.isclose(value, sg_integral(sharpness), rel_tol=5e-3 if loose else 1e-5), sharpness

    def test_a_lobe_elsewhere(self):
        nodes = make_nodes(0.7)
        axis = np.asarray([0.6, 0.64, 0.48])
        value = nodes.weight @ np.exp(30.0 * (nodes.light @ axis - 1.0))
        assert math.isclose(value, sg_integral(30.0), rel_tol=1e-3)

    def test_they_see_the_albedo_of_a_sharp_lobe(self):
        for cosine in (0.1, 0.5, 1.0):
            nodes = make_nodes(cosine)
            value = ggx_brdf(make_view(cosine), nodes.light, 0.02) * np.maximum(nodes.light[:, 2], 0.0)
            # 0.011: the error of the rational fit, which is not of these nodes
            assert abs(nodes.weight @ value - ggx_directional_albedo(cosine, 0.02, 1.0)) < 0.011


@pytest.mark.parametrize(("lobes", "error"), [(1, 0.140), (2, 0.031), (3, 0.0085), (4, 0.0027)])
def test_sums_of_gaussians_for_ggx(lobes, error):
    """The relative error in the plane, by quadrature; the gradient of the squared error over all numbers is 0."""

    def miss(numbers):
        b, w = np.split(np.asarray(numbers), 2)
        return quad(lambda q: ((1 + q) ** -2 - np.sum(w * np.exp(-b * q))) ** 2, 0, np.inf, epsabs=1e-12, limit=200)[0]

    best = np.concatenate(GGX_MIXTURES[lobes])
    # The norm of (1 + q)^-2 over q from 0 is 1/3.
    assert math.isclose(math.sqrt(3.0 * miss(best)), error, rel_tol=0.03)
    for index in range(best.size):
        for factor in (0.99, 1.01):
            moved = best.copy()
            moved[index] *= factor
            assert miss(moved) > miss(best)


class TestQuality:
    @pytest.mark.sampled("0.1")
    @pytest.mark.parametrize("alpha", [0.1, 0.3, 0.5])
    def test_three_lobes_for_tabulated_ggx(self, alpha):
        def brdf(view, light):
            return ggx_brdf(view, light, alpha)

        table = fit_lobes(make_merl(brdf), name="ggx", cosines=COSINES[7::2])
        assert (table.name, table.kind, table.lobe_count, table.is_isotropic) == ("ggx", "asg", 3, True)
        np.testing.assert_allclose(table.cosine, COSINES[7::2], rtol=1e-6)
        assert table.cosine_l2[table.cosine >= 0.3].min() >= MIN_COSINE_L2
        # At a view of the grid, and between views, by another quadrature and against the BRDF itself.
        for cosine in (float(table.cosine[2]), 0.3, 0.52, 0.75, 0.97):
            assert measure_nearness(table, brdf, make_view(cosine)) >= MIN_COSINE_L2, cosine
        index = 2
        ours = measure_nearness(table, brdf, make_view(float(table.cosine[index])))
        assert math.isclose(ours, table.cosine_l2[index, 0], abs_tol=5e-4)
        # The table of bins is coarse at grazing angles.
        np.testing.assert_allclose(table.alpha[table.cosine >= 0.3], alpha, rtol=0.01)
        albedo = ggx_directional_albedo(table.cosine, alpha, 1.0)
        seen = table.cosine >= 0.3
        np.testing.assert_allclose(table.albedo[seen, 0, 1], albedo[seen], atol=0.03)

    def test_more_lobes_are_nearer(self):
        errors = [
            1.0 - fit_lobes(lambda v, l: ggx_brdf(v, l, 0.2), lobes=count, cosines=[0.5, 0.8]).cosine_l2.min()
            for count in (1, 2, 3)
        ]
        assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]

    def test_roughness_of_other_normals(self):
        table = fit_lobes(lambda v, l: beckmann_brdf(v, l, 0.2), cosines=[0.5, 0.9], lobes=1)
        # Beckmann has no tails: the nearest GGX is a little wider than its core and narrower than its variance.
        assert np.all((table.alpha > 0.2) & (table.alpha < 0.26))
        assert table.cosine_l2.min() > 0.994

    def test_lambert(self):
        table = fit_lobes(lambert_brdf, kind="sg", lobes=1, cosines=[0.5, 1.0])
        # The L2-best SG for max(n.w, 0) over the sphere: sharpness 2.1438, amplitude 1.1766, relative error 0.1774.
        np.testing.assert_allclose(table.sharpness, 2.1438 / 2.0, rtol=2e-3)
        np.testing.assert_allclose(table.amplitude, 1.1766 / math.pi, rtol=1e-3)
        np.testing.assert_allclose(table.axis[..., 2], 1.0, atol=1e-4)
        np.testing.assert_allclose(np.sqrt(1.0 - table.cosine_l2**2), 0.1774, rtol=1e-3)

    def test_oren_nayar_leans_towards_the_viewer(self):
        table = fit_lobes(lambda v, l: oren_nayar_brdf(v, l, 0.6), kind="sg", lobes=1, cosines=[0.2, 0.6])
        tilt = np.degrees(np.arctan2(table.axis[:, 0, 0, 0], table.axis[:, 0, 0, 2]))
        # 13.0 and 8.2 degrees by an independent search
        np.testing.assert_allclose(tilt, [13.0, 8.2], atol=0.15)


class TestRecovery:
    @pytest.mark.parametrize("kind", ["sg", "asg"])
    def test_lobes_in_the_plane(self, kind):
        # Lobes that are too narrow to reach the horizon; what is below it cannot be recovered.
        truth = fit_lobes(lambda v, l: ggx_brdf(v, l, 0.05), kind=kind, lobes=2, cosines=[0.7, 0.9])
        again = fit_lobes(make_lobe_brdf(truth), kind=kind, lobes=2, cosines=[0.7, 0.9])
        assert again.cosine_l2.min() > 0.99999
        np.testing.assert_allclose(again.sharpness, truth.sharpness, rtol=2e-3)
        np.testing.assert_allclose(again.amplitude, truth.amplitude, rtol=2e-3)
        np.testing.assert_allclose(again.axis, truth.axis, atol=1e-4)

    @pytest.mark.sampled("sg")
    @pytest.mark.parametrize("kind", ["sg", "asg"])
    def test_anisotropic_material(self, kind):
        azimuths = np.asarray([0.0, 0.25, 0.5, 1.0]) * math.pi

        def brdf(view, light):
            return ggx_brdf(view, light, 0.25, 0.1)

        table = fit_lobes(brdf, kind=kind, cosines=[0.6, 0.9], azimuths=azimuths)
        assert not table.is_isotropic
        np.testing.assert_allclose(table.alpha[:, 0], [[0.25, 0.1]] * 2, rtol=1e-3)
        np.testing.assert_allclose(table.alpha[:, 2], [[0.1, 0.25]] * 2, rtol=1e-3)
        np.testing.assert_allclose(table.cosine_l2[:, 0], table.cosine_l2[:, 3], atol=1e-3)
        assert table.cosine_l2.min() > (0.995 if kind == "asg" else 0.93)
        tangent = np.asarray([1.0, 0.0, 0.0])
        for index in range(4):
            near = measure_nearness(table, brdf, make_view(0.9, azimuths[index]), tangent)
            assert math.isclose(near, table.cosine_l2[1, index], abs_tol=2e-3)

    def test_missing_data_have_no_weight(self, rng):
        def brdf(view, light):
            value = ggx_brdf(view, light, 0.3)
            return np.where(light[:, 1] > 0.3, np.where(light[:, 0] > 0.0, np.nan, -1.0), value)

        whole = fit_lobes(lambda v, l: ggx_brdf(v, l, 0.3), cosines=[0.6])
        holed = fit_lobes(brdf, cosines=[0.6])
        np.testing.assert_allclose(holed.sharpness[..., :2, :], whole.sharpness[..., :2, :], rtol=0.1)
        np.testing.assert_allclose(holed.albedo, whole.albedo, rtol=0.02)
        np.testing.assert_allclose(holed.alpha, 0.3, rtol=1e-3)

    def test_a_view_without_data_takes_its_neighbours_lobes(self):
        def brdf(view, light):
            return ggx_brdf(view, light, 0.3) * (view[:, 2] > 0.3)

        table = fit_lobes(brdf, cosines=[0.2, 0.5])
        assert table.cosine_l2[0, 0] == 0.0
        np.testing.assert_array_equal(table.amplitude[0], table.amplitude[1])
        with refuses(InputError, "reflection at n.v = 0.2", expected="values above 0"):
            fit_lobes(brdf, cosines=[0.1, 0.2])

    def test_a_view_that_shows_only_the_tail_of_a_lobe_takes_its_neighbours(self):
        def brdf(view, light):
            value = ggx_brdf(view, light, 0.1)
            return np.where((view[:, 2] < 0.3) & (light[:, 2] < 0.5), -1.0, value)

        table = fit_lobes(brdf, cosines=[0.2, 0.5])
        assert table.cosine_l2[0, 0] == 0.0
        np.testing.assert_array_equal(table.alpha[0], table.alpha[1])
        mirror = evaluate_table(table, np.asarray([0.0, 0.0, 1.0]), make_view(0.2)).axis[0]
        np.testing.assert_allclose(mirror @ (make_view(0.2) * [-1.0, 1.0, 1.0]), 1.0, atol=1e-3)


class TestArguments:
    def test_progress_is_monotone_and_complete(self):
        calls = []
        fit_lobes(lambert_brdf, lobes=1, cosines=[0.5, 0.9], progress=lambda done, total: calls.append((done, total)))
        assert [total for _, total in calls] == [calls[-1][0]] * len(calls)
        assert [done for done, _ in calls] == sorted(done for done, _ in calls)

    @pytest.mark.parametrize(
        ("change", "refused"),
        [
            ({"lobes": 0}, ("lobes", "0")),
            ({"lobes": 5}, ("lobes", "5")),
            ({"lobes": True}, ("lobes", "True")),
            ({"lobes": 2.0}, ("lobes", "2.0")),
            ({"kind": "gauss"}, ("kind",)),
            ({"cosines": []}, ("cosines", "[]")),
            ({"cosines": [0.0, 0.5]}, ("cosines", "[0.0, 0.5]")),
            ({"cosines": [0.5, 0.4]}, ("cosines", "[0.5, 0.4]")),
            ({"cosines": [0.5, math.nan]}, ("cosines", "[0.5, nan]")),
            ({"cosines": "many"}, ("cosines", "'many'")),
            ({"azimuths": [0.0, 7.0]}, ("azimuths",)),
        ],
    )
    def test_wrong_ones_are_refused(self, change, refused):
        with refuses(InputError, *refused):
            fit_lobes(lambert_brdf, **change)

    def test_wrong_shapes_are_refused(self):
        with refuses(InputError, "evaluate"):
            fit_lobes(lambda v, l: np.ones((len(l), 2)), cosines=[0.5])

    def test_without_scipy(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "scipy.optimize", None)
        with refuses(MissingDependencyError, "fitting lobes"):
            fit_lobes(lambert_brdf, cosines=[0.5])
