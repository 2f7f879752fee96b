"""benchmarks/upsampling/skies.py: its sky, its materials and its measure."""

from __future__ import annotations

import numpy as np

from benchmarks.upsampling.skies import SCENES, make_brushed, make_glass, make_sky, measure_error


def test_the_sky_has_a_horizon_and_a_sun() -> None:
    sky = make_sky(64)
    assert sky.shape == (64, 128, 3)
    assert sky[:32].mean() > 4.0 * sky[32:].mean()
    assert 0 < (sky.max(axis=-1) >= 300.0).sum() < 30
    assert (sky > 0.0).all()


def test_five_scenes_have_materials_for_three_balls() -> None:
    assert len(SCENES) == 5
    assert [make_glass(k)["type"] for k in range(3)] == ["dielectric", "roughdielectric", "conductor"]
    assert all(make_brushed(k)["alpha_u"] != make_brushed(k)["alpha_v"] for k in range(3))


def test_errors_are_relative_and_squared() -> None:
    reference = np.full((2, 2, 3), 1.0, np.float32)
    image = reference.copy()
    image[0, 0] = 3.0
    np.testing.assert_allclose(measure_error(image, reference), [[4.0 / 1.01, 0.0], [0.0, 0.0]], rtol=1e-6)
