"""From a lobe table to lobes of points: interpolation, frames, the two kinds."""

import math

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.fitting.table import (
    TableLobes,
    evaluate_lobes,
    evaluate_table,
    get_albedo,
    get_equivalent_alphas,
    order_lobes,
)
from lobewise.records.lobe_table import LobeTable
from tests.fitting.test_fit import make_view
from tests.mistakes import refuses

UP = np.asarray([0.0, 0.0, 1.0])
EAST = np.asarray([1.0, 0.0, 0.0])


def make_table(tilt, cosine, azimuth=(0.0,), kind="asg", **changes):
    """Return a table of one lobe whose axis is ``tilt`` further from the normal than the mirror direction."""
    cosine, azimuth = np.asarray(cosine, dtype=np.float64), np.asarray(azimuth)
    size = (cosine.size, azimuth.size, 1)
    angle = np.broadcast_to((np.arccos(cosine) + tilt)[:, None, None], size)
    values = {
        "axis": np.stack([-np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1),
        "sharpness": np.full((*size, 2), 8.0),
        "twist": np.zeros(size),
        "amplitude": np.ones(size),
        "alpha": np.full((*size[:2], 2), 0.3),
        "albedo": np.full((*size[:2], 3), 0.5),
        "cosine_l2": np.ones(size[:2]),
    }
    return LobeTable(name="test", kind=kind, cosine=cosine, azimuth=azimuth, **{**values, **changes})


def draw_rotation(rng):
    """Return a random rotation matrix."""
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))


class TestInterpolation:
    @pytest.mark.parametrize("cosine", [0.05, 0.2, 0.35, 0.5, 0.93, 1.0])
    def test_the_mirror_is_followed_between_views(self, cosine):
        # Two views a long way apart: an axis that were interpolated by itself would be 13 degrees off.
        lobes = evaluate_table(make_table(0.0, [0.2, 1.0]), UP, make_view(cosine))
        np.testing.assert_allclose(lobes.axis[0], make_view(cosine) * [-1.0, -1.0, 1.0], atol=1e-6)
        np.testing.assert_allclose(lobes.x[0], [0.0, 1.0, 0.0], atol=1e-12)

    def test_tilts_are_between_those_of_the_views(self):
        table = make_table(np.asarray([0.2, 0.1]), np.cos([1.2, 0.6]))
        axis = evaluate_table(table, UP, make_view(math.cos(0.9))).axis[0]
        # linear in the chord, not the arc
        assert math.isclose(math.atan2(-axis[0], axis[2]) - 0.9, 0.15, abs_tol=1e-4)

    def test_numbers(self):
        table = make_table(
            0.0,
            np.cos([1.2, 0.6]),
            sharpness=np.asarray([[[[2.0, 10.0]]], [[[8.0, 1000.0]]]]),
            amplitude=np.asarray([[[1.0]], [[3.0]]]),
            alpha=np.asarray([[[0.1, 0.2]], [[0.3, 0.6]]]),
            albedo=np.asarray([[[0.1, 0.2, 0.3]], [[0.3, 0.2, 0.1]]]),
        )
        cosine = np.cos([1.5, 1.2, 0.9, 0.6, 0.0])
        share = np.asarray([0.0, 0.0, 0.5, 1.0, 1.0])
        lobes = evaluate_table(table, UP, np.stack([make_view(c) for c in cosine]))
        np.testing.assert_allclose(lobes.sharpness[:, 0, 0], 2.0 * 4.0**share, rtol=1e-6)
        np.testing.assert_allclose(lobes.sharpness[:, 0, 1], 10.0 * 100.0**share, rtol=1e-6)
        np.testing.assert_allclose(lobes.amplitude[:, 0], 1.0 + 2.0 * share, rtol=1e-6)
        np.testing.assert_allclose(get_equivalent_alphas(table, cosine)[:, 1], 0.2 + 0.4 * share, rtol=1e-6)
        np.testing.assert_allclose(get_albedo(table, cosine)[:, 2], 0.3 - 0.2 * share, rtol=1e-6)
        assert get_albedo(table, 0.6).shape == (3,)
        assert get_albedo(table, np.float32([[0.6]])).dtype == np.float32

    def test_azimuths_wrap(self):
        amplitude = np.asarray([[[1.0], [2.0], [5.0]]])
        table = make_table(0.0, [0.5], [1.0, 2.0, 4.0], amplitude=amplitude)
        for azimuth, expected in ((1.0, 1.0), (1.5, 1.5), (3.0, 3.5), (4.0, 5.0), (0.0, 1.0), (-0.5, 0.0)):
            if azimuth < 1.0:  # in the last cell, from 4 to 1 + 2 pi
                share = (azimuth + 2.0 * math.pi - 4.0) / (2.0 * math.pi - 3.0)
                expected = 5.0 - 4.0 * share
            lobes = evaluate_table(table, UP, make_view(0.5, azimuth), EAST)
            assert math.isclose(lobes.amplitude[0], expected, rel_tol=1e-6), azimuth

    def test_twists_take_the_shorter_way(self):
        # 170 and 10 degrees are 20 apart for a lobe, which looks the same after half a turn.
        twist = np.radians([[[170.0], [10.0]]])
        table = make_table(0.0, [1.0], [0.0, 3.0], twist=twist, sharpness=np.asarray([[[[9.0, 1.0]], [[9.0, 1.0]]]]))
        x = evaluate_table(table, UP, make_view(1.0 - 1e-9, 1.5), EAST).x[0]
        across = np.asarray([-math.sin(1.5), math.cos(1.5), 0.0])
        assert math.isclose(abs(x @ across), 1.0, abs_tol=1e-6)

    def test_anisotropic_needs_a_tangent(self):
        with refuses(InputError, "tangent"):
            evaluate_table(make_table(0.0, [0.5], [0.0, 1.0]), UP, UP)


class TestFrames:
    @pytest.mark.parametrize("azimuths", [(0.0,), (0.0, 1.0, 2.5)])
    def test_turning_the_scene_turns_the_lobes(self, azimuths, rng):
        size = (2, len(azimuths), 1)
        axis = np.asarray([-0.6, 0.3, 0.7]) + 0.1 * rng.normal(size=(*size, 3))
        table = make_table(
            0.0,
            [0.3, 0.9],
            azimuths,
            axis=axis / np.linalg.norm(axis, axis=-1, keepdims=True),
            twist=rng.uniform(-0.3, 0.3, size),
            sharpness=rng.uniform(2.0, 20.0, (*size, 2)),
        )
        turn, view, light = draw_rotation(rng), make_view(0.6, 0.8), make_view(0.7, 3.0)
        here = evaluate_table(table, UP, view, EAST)
        there = evaluate_table(table, turn @ UP, turn @ view, turn @ EAST)
        np.testing.assert_allclose(there.axis, here.axis @ turn.T, atol=1e-6)
        np.testing.assert_allclose(there.x, here.x @ turn.T, atol=1e-6)
        np.testing.assert_allclose(np.sum(here.axis * here.x, axis=-1), 0.0, atol=1e-6)
        assert math.isclose(
            evaluate_lobes(here, light, "asg"), evaluate_lobes(there, turn @ light, "asg"), rel_tol=1e-5
        )

    def test_stored_axis_and_twist_at_a_view_of_the_table(self):
        axis, twist, azimuth = np.asarray([-0.5, 0.3, math.sqrt(0.66)]), 0.4, 1.0
        table = make_table(
            0.0, [0.5], [0.0, azimuth], axis=np.tile(axis, (1, 2, 1, 1)), twist=np.full((1, 2, 1), twist)
        )
        lobes = evaluate_table(table, UP, make_view(0.5, azimuth), EAST)
        turn = np.asarray([[math.cos(1), -math.sin(1), 0], [math.sin(1), math.cos(1), 0], [0, 0, 1]])
        np.testing.assert_allclose(lobes.axis[0], turn @ axis, atol=1e-6)
        # The definition: y without its part along the axis, then a rotation about the axis (Rodrigues).
        first = np.asarray([0.0, 1.0, 0.0]) - axis[1] * axis
        first /= np.linalg.norm(first)
        x = math.cos(twist) * first + math.sin(twist) * np.cross(axis, first)
        sign = np.sign(lobes.x[0] @ turn @ x)
        np.testing.assert_allclose(sign * lobes.x[0], turn @ x, atol=1e-6)

    def test_from_straight_above(self, rng):
        lobes = evaluate_table(make_table(0.0, [0.5, 1.0]), UP, UP)
        np.testing.assert_allclose(lobes.axis[0], UP, atol=1e-12)
        assert math.isclose(np.linalg.norm(lobes.x), 1.0, rel_tol=1e-6)
        normal = rng.normal(size=(1000, 3))
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        lobes = evaluate_table(make_table(0.0, [0.5, 1.0]), normal, normal)
        np.testing.assert_allclose(lobes.axis[:, 0], normal, atol=1e-6)
        np.testing.assert_allclose(np.sum(lobes.x[:, 0] * normal, axis=-1), 0.0, atol=1e-6)

    def test_from_below_is_finite(self):
        lobes = evaluate_table(make_table(0.1, [0.5, 1.0]), UP, make_view(0.3) * [1.0, 1.0, -1.0])
        assert all(np.isfinite(part).all() for part in lobes)

    def test_no_points(self):
        lobes = evaluate_table(make_table(0.1, [0.5, 1.0]), np.empty((0, 3)), UP)
        assert [part.shape for part in lobes] == [(0, 1, 3), (0, 1, 3), (0, 1, 2), (0, 1)]

    def test_shapes_and_precision(self, rng):
        normal = rng.normal(size=(130, 90, 3)).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        view = np.float32([0.0, 0.6, 0.8])
        single = evaluate_table(make_table(0.1, [0.2, 0.5, 1.0]), normal, view)
        double = evaluate_table(make_table(0.1, [0.2, 0.5, 1.0]), normal.astype(np.float64), view.astype(np.float64))
        assert [part.shape for part in single] == [(130, 90, 1, 3), (130, 90, 1, 3), (130, 90, 1, 2), (130, 90, 1)]
        assert {part.dtype for part in single} == {np.dtype(np.float32)}
        np.testing.assert_allclose(single.axis, double.axis, atol=1e-5)


class TestValues:
    def test_kinds(self, rng):
        axis = rng.normal(size=(2, 3))
        axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        x = np.cross(axis, UP)
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        amplitude = np.asarray([2.0, 0.5])
        direction = np.asarray([0.6, 0.0, 0.8])
        lobes = TableLobes(axis, x, np.full((2, 2), 3.0), amplitude)
        expected = sum(a * math.exp(6.0 * (z @ direction - 1.0)) for a, z in zip(amplitude, axis, strict=True))
        assert math.isclose(evaluate_lobes(lobes, direction, "sg"), expected, rel_tol=1e-12)
        wide = TableLobes(axis, x, np.asarray([[3.0, 1.0]] * 2), amplitude)
        expected = sum(
            a * max(z @ direction, 0.0) * math.exp(-3.0 * (e @ direction) ** 2 - (np.cross(z, e) @ direction) ** 2)
            for a, z, e in zip(amplitude, axis, x, strict=True)
        )
        assert math.isclose(evaluate_lobes(wide, direction, "asg"), expected, rel_tol=1e-12)


def test_lobes_are_put_in_the_order_of_the_azimuth_before():
    # three lobes about the normal that differ in width and place, fixed to the surface while the viewer walks round it
    azimuth = np.arange(8) * (math.pi / 4.0)
    fixed = np.asarray([[0.0, 0.0, 1.0], [0.3, 0.1, 0.9], [-0.2, 0.25, 0.9]])
    fixed /= np.linalg.norm(fixed, axis=-1, keepdims=True)
    cosine, sine = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    turned = np.stack([cosine * fixed[:, 0] + sine * fixed[:, 1], cosine * fixed[:, 1] - sine * fixed[:, 0]], axis=-1)
    axis = np.concatenate([turned, np.broadcast_to(fixed[:, 2:], (8, 3, 1))], axis=-1)[None]
    sharpness = np.broadcast_to(np.asarray([200.0, 30.0, 32.0])[:, None], (1, 8, 3, 2))
    arrays = {
        "axis": axis,
        "sharpness": sharpness,
        "twist": np.zeros((1, 8, 3)),
        "amplitude": np.broadcast_to([1.0, 2.0, 3.0], (1, 8, 3)),
    }
    ordered = make_table(0.0, [1.0], azimuth, "sg", **arrays)
    rng = np.random.default_rng(4)
    orders = np.stack([rng.permutation(3) for _ in azimuth])
    orders[0] = [0, 1, 2]
    assert len(np.unique(orders, axis=0)) > 2
    mixed = {name: np.stack([value[:, p, orders[p]] for p in range(8)], axis=1) for name, value in arrays.items()}
    restored = order_lobes(make_table(0.0, [1.0], azimuth, "sg", **mixed))
    for name in arrays:
        np.testing.assert_array_equal(getattr(restored, name), getattr(ordered, name))
