"""benchmarks/training/materials.py and settings.py: what patterns and materials promise, and where objects stand."""

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

SMALLEST, LARGEST = 0.004, 0.71
"""Bounds of every alpha, as far as the single precision of a texture lets them be kept."""

pytestmark = pytest.mark.nightly


@pytest.fixture
def settings(mi: Any) -> Any:
    """Return the module that makes rooms and stages."""
    return importlib.import_module("benchmarks.training.settings")


@pytest.fixture
def materials(mi: Any) -> Any:
    """Return the module that draws patterns and materials."""
    return importlib.import_module("benchmarks.training.materials")


def _list_bsdfs(item: Any) -> Iterator[dict[str, Any]]:
    if isinstance(item, dict):
        yield item
        for value in item.values():
            yield from _list_bsdfs(value)


@pytest.mark.mitsuba
def test_patterns_stay_between_0_and_1_and_are_not_all_alike(materials: Any, rng: np.random.Generator) -> None:
    means = []
    for _ in range(40):
        pattern = materials.draw_pattern(rng, materials.draw_log(rng, 0.5, 12.0), 64)
        assert pattern.shape == (64, 64)
        assert pattern.min() >= 0.0
        assert pattern.max() <= 1.0
        means.append(pattern.mean())
    assert np.std(means) > 0.05


@pytest.mark.mitsuba
def test_slopes_of_waves_are_the_derivatives_of_their_height(materials: Any, rng: np.random.Generator) -> None:
    height, slope_x, slope_y = materials.draw_waves(rng, 512, 4.0)
    down, right = np.gradient(height, 1.0 / 512)
    # Central differences of at most four periods over 512 texels are off by (2 pi 4 / 512)^2 / 6 = 0.04 percent.
    scale = 1e-3 * np.abs(slope_x).max()
    np.testing.assert_allclose(slope_x[:, 1:-1], right[:, 1:-1], rtol=0.0, atol=scale)
    np.testing.assert_allclose(slope_y[1:-1], down[1:-1], rtol=0.0, atol=scale)
    # 24 waves in random directions: the variance of their sum over a texture of a few periods is near to 1.
    assert 0.5 < height.std() < 1.5


@pytest.mark.mitsuba
def test_alphas_and_albedos_keep_their_bounds(materials: Any, rng: np.random.Generator) -> None:
    plugins = set()
    for _ in range(40):
        name = str(rng.choice(sorted(materials.FAMILIES)))
        for item in _list_bsdfs(materials.FAMILIES[name](rng, 3.0)):
            plugins.add(item.get("type"))
            alphas = [item[key] for key in ("alpha", "alpha_u", "alpha_v") if key in item]
            values = [np.array(each["bitmap"]) if isinstance(each, dict) else np.array(each) for each in alphas]
            assert all(value.min() > SMALLEST and value.max() < LARGEST for value in values)
            if len(values) == 2:
                assert max(values) <= 1.001 * materials.MOST_STRETCH * min(values)
            for key in ("reflectance", "diffuse_reflectance", "base_color"):
                if item.get(key, {}).get("type") == "rgb":
                    assert 0.0 < min(item[key]["value"]) <= max(item[key]["value"]) <= 0.95
    assert {"diffuse", "roughconductor", "roughplastic", "plastic", "conductor", "principled"} <= plugins


@pytest.mark.mitsuba
@pytest.mark.parametrize("make", ["make_room", "make_open_stage", "make_corridor"])
def test_objects_are_placed_before_the_camera_and_not_on_it(settings: Any, make: str) -> None:
    stage = getattr(settings, make)(np.random.default_rng(1), 1.0)
    assert len(stage.places) >= 4
    for middle, radius in stage.places:
        assert np.linalg.norm(np.subtract(middle, stage.origin)) > radius
    assert any("emitter" in item or item["type"] == "envmap" for item in stage.items.values())
