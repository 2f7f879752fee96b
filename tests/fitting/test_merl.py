"""MERL tables: coordinates, layout, interpolation, and every way in which a file can be wrong."""

import math
import struct

import numpy as np
import pytest

from lobewise.errors import FileError
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.merl import BINS, FILE_BYTES, SCALES, parse_merl, to_half_difference
from tests.fitting.merl_tables import from_half_difference, get_bin_centres, make_merl, to_bytes
from tests.mistakes import refuses


def draw_pairs(rng, count=4000):
    """Return views and lights above the horizon, uniform over the hemisphere."""
    pair = rng.normal(size=(2, count, 3))
    pair[..., 2] = np.abs(pair[..., 2])
    return pair / np.linalg.norm(pair, axis=-1, keepdims=True)


def rotate(axis, angle, vectors):
    """Return ``vectors`` rotated about a coordinate axis, by its matrix."""
    c, s = math.cos(angle), math.sin(angle)
    matrices = {"y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}
    return vectors @ np.asarray(matrices[axis]).T


@pytest.fixture(scope="module")
def ggx():
    """Return a tabulated GGX of roughness 0.3, coloured."""
    color = np.asarray([1.0, 0.5, 0.25])
    return make_merl(lambda view, light: ggx_brdf(view, light, 0.3)[:, None] * color, "copper")


class TestCoordinates:
    def test_they_are_the_angles_after_two_rotations(self, rng):
        view, light = draw_pairs(rng, 50)
        for v, l in zip(view, light, strict=True):
            theta_h, theta_d, phi_d = to_half_difference(v, l)
            half = (v + l) / np.linalg.norm(v + l)
            assert math.isclose(theta_h, math.acos(half[2]), abs_tol=1e-7)
            turned = rotate("y", -theta_h, rotate("z", -math.atan2(half[1], half[0]), l))
            assert math.isclose(theta_d, math.acos(turned[2]), abs_tol=1e-7)
            assert math.isclose(phi_d, math.atan2(turned[1], turned[0]) % math.pi, abs_tol=1e-9)

    def test_round_trip(self, rng):
        angles = rng.uniform(1e-3, math.pi / 2 - 1e-3, (3, 4000)) * np.asarray([[1.0], [1.0], [2.0]])
        np.testing.assert_allclose(to_half_difference(*from_half_difference(*angles)), angles, atol=1e-9)

    def test_reciprocity_and_isotropy(self, rng):
        view, light = draw_pairs(rng)
        angles = to_half_difference(view, light)
        np.testing.assert_allclose(to_half_difference(light, view), angles, atol=1e-9)
        np.testing.assert_allclose(
            to_half_difference(rotate("z", 1.0, view), rotate("z", 1.0, light)), angles, atol=1e-9
        )

    def test_degenerate_pairs_are_finite(self):
        up, side = np.asarray([0.0, 0.0, 1.0]), np.asarray([0.6, 0.0, 0.8])
        for pair in ((up, up), (side, side), (side, side * [-1, 1, 1])):
            angles = np.asarray(to_half_difference(*pair))
            assert np.isfinite(angles).all()
            assert 0.0 <= angles[2] < math.pi


class TestInterpolation:
    def test_centres_are_kept(self, ggx):
        view, light = from_half_difference(
            get_bin_centres()[0][:, None, None], get_bin_centres()[1][:, None], get_bin_centres()[2]
        )
        np.testing.assert_allclose(ggx(view, light)[ggx.valid], ggx.samples[ggx.valid][:, :3], rtol=2e-4)
        assert ggx(view, light).dtype == np.float32

    def test_it_is_the_function_between_the_centres(self, ggx, rng):
        view, light = draw_pairs(rng)
        # Grazing directions are where the table is coarsest.
        seen = (view[:, 2] > 0.3) & (light[:, 2] > 0.3)
        expected = ggx_brdf(view, light, 0.3)[seen]
        assert np.abs(ggx(view, light)[seen, 0] - expected).max() < 5e-3 * expected.max()
        np.testing.assert_allclose(ggx(view, light)[seen, 2], 0.25 * ggx(view, light)[seen, 0], rtol=1e-4)

    def test_symmetry(self, ggx, rng):
        view, light = draw_pairs(rng)
        values = ggx(view, light)
        np.testing.assert_allclose(ggx(light, view), values, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(ggx(rotate("z", 2.0, view), rotate("z", 2.0, light)), values, rtol=1e-4, atol=1e-6)

    def test_phi_wraps(self):
        # 1 in the bin that straddles phi_d = 0 from below, 0 in all others: half of it at phi_d = 0.
        _, _, centres = get_bin_centres()
        step = make_merl(lambda v, l: 1.0 * (to_half_difference(v, l)[2] > centres[-2] + 1e-3))
        for phi, expected in ((0.0, 0.5), (math.pi - 1e-6, 0.5), (math.pi - centres[0], 1.0), (centres[0], 0.0)):
            value = step(*from_half_difference(0.2, 0.3, phi))
            np.testing.assert_allclose(value, expected, atol=1e-3)

    def test_below_the_horizon_is_zero(self, ggx):
        up, down = np.asarray([0.0, 0.0, 1.0]), np.asarray([0.0, 0.6, -0.8])
        assert not ggx(up, down).any()
        assert not ggx(down, up).any()
        assert ggx(up, np.stack([up, down]))[:, 0].tolist()[1] == 0.0

    def test_missing_samples_are_left_out(self, rng):
        # A constant BRDF with holes is still the constant, or nothing where the hole is wider than a cell.
        holes = rng.random(BINS) < 0.2
        holes[20:24, 20:24, 60:64] = True
        table = make_merl(lambda v, l: np.full(len(v), 2.0))
        table.samples.flags.writeable = True
        table.samples[holes] = 0.0
        values = table(*draw_pairs(rng))
        known = np.isfinite(values)
        np.testing.assert_allclose(values[known], 2.0, rtol=1e-5)
        assert known.mean() > 0.99
        centres = get_bin_centres()
        inside = from_half_difference(centres[0][21], centres[1][21], centres[2][61] + 1e-3)
        assert np.isnan(table(*inside)).all()


class TestFiles:
    def test_layout_is_that_of_the_database(self, ggx):
        data = to_bytes(ggx)
        assert len(data) == FILE_BYTES == 34_992_012
        assert struct.unpack("<3i", data[:12]) == (90, 90, 180)
        h, d, p, channel = 5, 17, 120, 1
        offset = 12 + 8 * (p + 180 * (d + 90 * (h + 90 * channel)))
        stored = struct.unpack("<d", data[offset : offset + 8])[0]
        assert math.isclose(stored * 1.15 / 1500.0, ggx.samples[h, d, p, channel], rel_tol=1e-6)

    def test_round_trip(self, ggx):
        again = parse_merl(to_bytes(ggx), "copper")
        np.testing.assert_allclose(again.samples, ggx.samples, rtol=1e-6)
        np.testing.assert_array_equal(again.valid, ggx.valid)
        assert not again.valid[89, 89].any()

    def test_negative_values_are_no_measurements(self, ggx):
        data = np.frombuffer(to_bytes(ggx), "<f8", offset=12).copy().reshape(3, *BINS)
        data[2, 3, 4, 5] = -0.5
        again = parse_merl(np.asarray(BINS, "<i4").tobytes() + data.tobytes())
        assert ggx.valid[3, 4, 5]
        assert not again.valid[3, 4, 5]
        assert not again.samples[3, 4, 5].any()

    def test_broken_files(self, ggx):
        good = to_bytes(ggx)
        header = good[:12]
        cases = {
            "5 bytes": good[:5],
            "90, 90, 360": struct.pack("<3i", 90, 90, 360) + good[12:],
            "34992004, so the end is missing": good[:-8],
            "34992013, so something follows the table": good + b"\0",
            "none: all are marked as not measured": header + np.full(3 * 90 * 90 * 180, -1.0).tobytes(),
            "a table that is black": header + np.zeros(3 * 90 * 90 * 180).tobytes(),
            "1 values that are not": good[:12] + struct.pack("<d", math.nan) + good[20:],
        }
        for got, data in cases.items():
            with refuses(FileError, "MERL file 'copper'", got):
                parse_merl(data, "copper")


def test_scales():
    np.testing.assert_allclose(np.asarray(SCALES) * 1500.0, [1.0, 1.15, 1.66])
