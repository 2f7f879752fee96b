"""Tone curve by table, false colours, the part of a picture that a window shows, the wipe."""

import numpy as np
import pytest

from lobewise.display.tones import map_tones, map_tones_quickly
from lobewise.interactive.settings import VIEWS, InteractiveSettings
from lobewise.viewer.messages import Window
from lobewise.viewer.pictures import BARS, LEGENDS, MAX_STOPS, choose_stops, fit_window, paint, wipe
from lobewise.viewer.scene_settings import name_sides


class TestTones:
    @pytest.mark.parametrize("exposure", [1.0, 0.037, 300.0])
    def test_the_table_is_the_curve_to_within_a_code(self, exposure):
        values = np.concatenate([np.geomspace(1e-9, 1e6, 30000), np.linspace(0.0, 2.0, 30000)]).astype(np.float32)
        image = values.reshape(-1, 1, 1).repeat(3, axis=-1)
        slow, quick = (curve(image, exposure).astype(int) for curve in (map_tones, map_tones_quickly))
        assert np.abs(slow - quick).max() <= 1
        assert (slow == quick).mean() > 0.97

    def test_what_is_no_radiance(self):
        image = np.array([[[np.nan, -1.0, np.inf], [1e38, -np.inf, 0.0]]], dtype=np.float32)
        np.testing.assert_array_equal(map_tones_quickly(image, 2.0), [[[0, 0, 255], [255, 0, 0]]])


class TestStops:
    @pytest.mark.parametrize("level", [1e-6, 0.03, 1.0, 2.7, 1e6])
    def test_it_is_a_step_of_the_slider(self, level):
        stops = choose_stops(np.full((8, 8, 3), level, np.float32))
        expected = np.clip(np.log2(0.8 / level), -MAX_STOPS, MAX_STOPS)
        assert stops == round(stops, 1)
        assert stops == pytest.approx(expected, abs=0.0501)


class TestPaint:
    def test_numbers_go_from_dark_to_bright(self):
        shown = paint("sharpness", np.linspace(-0.5, 1.5, 64, dtype=np.float32).reshape(1, 64), 5.0)
        light = shown.astype(float) @ [0.2126, 0.7152, 0.0722]
        assert (np.diff(light[0]) >= 0.0).all()
        assert light[0, -1] > light[0, 0] + 200.0

    def test_nothing_but_radiance_has_an_exposure(self):
        values = np.full((2, 2, 3), 0.25, np.float32)
        for view in (*VIEWS, "effective_samples"):
            array = values if view in ("normal", "albedo") or view not in LEGENDS else values[..., 0]
            differs = (paint(view, array, 1.0) != paint(view, array, 2.0)).any()
            assert differs == (view not in LEGENDS and view != "albedo"), view

    def test_what_is_unknown_is_dark(self):
        assert paint("history", np.full((1, 1), np.nan, np.float32), 1.0).max() < 30


class TestWindow:
    picture = np.random.default_rng(3).integers(30, 255, (30, 40, 3)).astype(np.uint8)

    def test_the_same_aspect_is_left_alone(self):
        assert fit_window(self.picture, Window(400, 300)) is self.picture

    def test_bars_beside_and_above(self):
        wide = fit_window(self.picture, Window(60, 30))
        assert wide.shape == (30, 60, 3)
        np.testing.assert_array_equal(wide[:, 10:50], self.picture)
        assert (wide[:, :10] == BARS).all()
        assert (wide[:, 50:] == BARS).all()
        tall = fit_window(self.picture, Window(40, 50))
        np.testing.assert_array_equal(tall[10:40], self.picture)
        assert (tall[:10] == BARS).all()

    def test_a_picture_that_fills_is_cut(self):
        np.testing.assert_array_equal(fit_window(self.picture, Window(60, 30, fill=True)), self.picture[5:25])
        np.testing.assert_array_equal(fit_window(self.picture, Window(30, 30, fill=True)), self.picture[:, 5:35])


class TestWipe:
    left, right = np.full((100, 200, 3), 40, np.uint8), np.full((100, 200, 3), 90, np.uint8)

    @pytest.mark.parametrize("place", [0.0, 0.25, 0.5, 1.0])
    def test_each_side_is_its_picture(self, place):
        out = wipe(self.left, self.right, place, ("", ""))
        edge = round(200 * place)
        assert (out[:80, : max(edge - 2, 0)] == 40).all()
        assert (out[:80, edge + 2 :] == 90).all()
        if 0.0 < place < 1.0:
            assert (out[:, edge] == (255, 196, 64)).all()

    def test_labels_stand_on_their_sides(self):
        plain, labelled = (wipe(self.left, self.right, 0.5, text) for text in (("", ""), ("A: ggx", "B: sg")))
        changed = (plain != labelled).any(axis=(0, 2)).nonzero()[0]
        assert changed.min() > 10
        assert changed.max() < 190
        assert (labelled[-30:].max(), self.left[0, 0, 0]) == (255, 40)

    def test_labels_that_do_not_fit_are_left_out(self):
        out = wipe(self.left, self.right, 0.05, ("A: a label that is far too long", ""))
        assert (out[:, :8] == 40).all()

    @pytest.mark.parametrize(
        ("left", "right", "labels"),
        [
            (InteractiveSettings(), InteractiveSettings(), ("A", "B")),
            (
                InteractiveSettings(),
                InteractiveSettings(method="voxel_cones", radius=9),
                ("A: paths", "B: voxel cones"),
            ),
            (
                InteractiveSettings(temporal=True),
                InteractiveSettings(temporal=False),
                ("A: temporal", "B: no temporal"),
            ),
            (InteractiveSettings(beta="auto"), InteractiveSettings(beta=2.5), ("A: beta auto", "B: beta 2.5")),
            (InteractiveSettings(), InteractiveSettings(similarity="none", radius=3), ("A: ggx", "B: no filter")),
        ],
    )
    def test_labels_say_what_differs(self, left, right, labels):
        assert name_sides(left, right) == labels
