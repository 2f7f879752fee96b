"""benchmarks/training/scenes.py: what its patterns and materials promise, and that the same seed is the same scene."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

NAMES = ("scenes", "settings", "materials")

SMALLEST, LARGEST = 0.004, 0.71
"""Bounds of every alpha, as far as the single precision of a texture lets them be kept."""

DIGITS = 0.01
"""Relative: the factor of the lights is rounded to three digits, at worst by half a percent."""

pytestmark = pytest.mark.nightly


@pytest.fixture
def modules(mi: Any) -> tuple[Any, ...]:
    """Return the program's three modules."""
    return tuple(importlib.import_module(f"benchmarks.training.{name}") for name in NAMES)


def _flatten(item: Any, prefix: str = "") -> dict[str, Any]:
    """Return every leaf of a scene's description by its path, arrays for what holds pixels."""
    if isinstance(item, tuple):
        item = dict(enumerate(item))
    if isinstance(item, dict):
        return {
            path: leaf for name, value in item.items() for path, leaf in _flatten(value, f"{prefix}/{name}").items()
        }
    return {prefix: np.array(item)}


def _list_bsdfs(item: Any) -> Iterator[dict[str, Any]]:
    if isinstance(item, dict):
        yield item
        for value in item.values():
            yield from _list_bsdfs(value)


@pytest.mark.mitsuba
def test_patterns_stay_between_0_and_1_and_are_not_all_alike(modules: Any, rng: np.random.Generator) -> None:
    _, _, materials = modules
    means = []
    for _ in range(40):
        pattern = materials.draw_pattern(rng, materials.draw_log(rng, 0.5, 12.0), 64)
        assert pattern.shape == (64, 64)
        assert pattern.min() >= 0.0
        assert pattern.max() <= 1.0
        means.append(pattern.mean())
    assert np.std(means) > 0.05


@pytest.mark.mitsuba
def test_slopes_of_waves_are_the_derivatives_of_their_height(modules: Any, rng: np.random.Generator) -> None:
    _, _, materials = modules
    height, slope_x, slope_y = materials.draw_waves(rng, 512, 4.0)
    down, right = np.gradient(height, 1.0 / 512)
    # Central differences of at most four periods over 512 texels are off by (2 pi 4 / 512)^2 / 6 = 0.04 percent.
    scale = 1e-3 * np.abs(slope_x).max()
    np.testing.assert_allclose(slope_x[:, 1:-1], right[:, 1:-1], rtol=0.0, atol=scale)
    np.testing.assert_allclose(slope_y[1:-1], down[1:-1], rtol=0.0, atol=scale)
    # 24 waves in random directions: the variance of their sum over a texture of a few periods is near to 1.
    assert 0.5 < height.std() < 1.5


@pytest.mark.mitsuba
def test_alphas_and_albedos_keep_their_bounds(modules: Any, rng: np.random.Generator) -> None:
    _, _, materials = modules
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
def test_the_same_seed_is_the_same_scene_and_another_is_not(modules: Any) -> None:
    scenes, _, _ = modules
    first, again, other = (_flatten(scenes._make_scene(seed, 8, 8, 1.0)) for seed in (18, 18, 6))
    assert first.keys() == again.keys()
    for path, value in first.items():
        np.testing.assert_array_equal(value, again[path], err_msg=path)
    assert first.keys() != other.keys()


@pytest.mark.mitsuba
@pytest.mark.parametrize("seed", [1, 2, 4])
def test_objects_are_placed_before_the_camera_and_not_on_it(modules: Any, seed: int) -> None:
    scenes, settings, _ = modules
    kind = scenes.SETTINGS[seed - 1]
    make = {"stage": settings.make_open_stage, "corridor": settings.make_corridor}.get(kind, settings.make_room)
    stage = make(np.random.default_rng(seed), 1.0)
    assert len(stage.places) >= 4
    for middle, radius in stage.places:
        assert np.linalg.norm(np.subtract(middle, stage.origin)) > radius
    assert any("emitter" in item or item["type"] == "envmap" for item in stage.items.values())


@pytest.mark.mitsuba
def test_lights_are_scaled_to_the_median_that_the_seed_draws(modules: Any, mi: Any) -> None:
    from lobewise.render import render_frame

    scenes, _, materials = modules
    low, high = scenes.MEDIANS["stage"]
    wanted = materials.draw_log(np.random.default_rng([scenes.SALT, 18, 1]), low, high)
    frame = render_frame(scenes.load_training_scene(18, scenes.PROBE_SIZE), spp=scenes.PROBE_SPP, seed=0)
    assert np.median(frame.radiance.color.mean(axis=-1)) == pytest.approx(wanted, rel=DIGITS)
    assert np.isfinite(frame.radiance.color).all()


def test_files_of_all_scenes_have_names_and_noise_of_their_own(modules: Any) -> None:
    scenes, _, _ = modules
    rows = [row for seed in range(1, 50) for row in scenes.list_files(Path("folder"), seed)]
    assert len({path for path, _, _ in rows}) == len(rows) == 49 * (len(scenes.SAMPLES) + 2)
    assert len({noise for _, _, noise in rows}) == len(rows)
