"""Guides, direct and indirect light of the interactive chain, against the renderer of whole frames."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lobewise.render import load_scene, make_orbit, render_frame
from lobewise.render.stages import Stages
from tests.render.items import make_camera, make_lamp, make_square
from tests.render.materials.python_bsdf import register_lobes

pytestmark = pytest.mark.mitsuba

SIZE = 48

MEAN_NOISE = 0.02
"""Relative, of the mean of an image over 256 samples of a pixel: four times what another seed changes."""
BIT = 1e-5
"""The same formulas in kernels that the compiler arranges differently."""


@pytest.fixture(scope="module")
def showroom(mi: Any) -> Any:
    return load_scene("showroom", width=SIZE, height=SIZE)


@pytest.fixture(scope="module")
def stages(showroom: Any) -> Stages:
    return Stages(showroom)


def get_path_light(stages: Stages, max_depth: int = 8) -> Any:
    from lobewise.render.tracing.paths import PathLight

    return PathLight(stages.scene, stages.materials, max_depth=max_depth)


def shade_direct(stages: Stages, seed: int, camera: Any = None) -> Any:
    return stages.trace_first(camera or stages.start_camera, seed)[1]


def list_pixels(size: int = SIZE) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.indices((size, size))
    return rows.ravel(), columns.ravel()


@pytest.mark.nightly
def test_guides_are_those_of_a_whole_frame_but_for_averages(stages: Stages, showroom: Any) -> None:
    stages.place_camera(stages.start_camera, SIZE, SIZE)
    hits, _ = stages.trace_first(stages.start_camera, 0)
    frame = render_frame(showroom, spp=64, aov_only=True)
    for name in ("depth", "position", "normal", "tangent", "alpha_u", "alpha_v", "lobe_kind"):
        assert np.allclose(getattr(hits.gbuffer, name), getattr(frame.gbuffer, name), atol=BIT, rtol=BIT), name
    # Averages over a pixel's area against its centre.
    for name in ("diffuse_albedo", "specular_albedo"):
        assert np.median(np.abs(getattr(hits.gbuffer, name) - getattr(frame.gbuffer, name))) < 0.005, name
    mirrors = (frame.gbuffer.lobe_kind > 0) & (frame.gbuffer.alpha_u < 0.1) & (hits.gbuffer.hit_distance > 0.0)
    assert mirrors.sum() > 50
    ratio = hits.gbuffer.hit_distance[mirrors] / frame.gbuffer.hit_distance[mirrors]
    assert abs(np.median(ratio) - 1.0) < 0.05


@pytest.mark.nightly
def test_replayed_guides_follow_camera_and_size(showroom: Any) -> None:
    stages = Stages(showroom)
    for camera in make_orbit(stages.start_camera, (0.0, 0.75, -0.6), 3, 20.0):
        for size in (24, 40):
            stages.place_camera(camera, size, size)
            hits, _ = stages.trace_first(camera, 0)
            frame = render_frame(showroom, spp=1, aov_only=True)
            assert hits.gbuffer.shape == (size, size)
            assert np.allclose(hits.gbuffer.position, frame.gbuffer.position, atol=1e-4)
    stages.place_camera(stages.start_camera, SIZE, SIZE)


@pytest.mark.nightly
def test_direct_light_is_the_path_tracers(stages: Stages, showroom: Any) -> None:
    stages.place_camera(stages.start_camera, SIZE, SIZE)
    parts = [shade_direct(stages, seed) for seed in range(256)]
    reference = render_frame(showroom, spp=1024, max_depth=2).radiance
    for name, expected in (("diffuse", reference.diffuse), ("specular", reference.specular)):
        mean = np.mean([getattr(part, name) for part in parts], axis=0)
        assert mean.mean() == pytest.approx(expected.mean(), rel=MEAN_NOISE), name
        # Pixel by pixel but for edges, where a centre is no average.
        assert np.median(np.abs(mean - expected) / (expected + 0.01)) < 0.1, name


@pytest.mark.nightly
def test_sixteen_neighbours_know_more_of_a_lamp_than_chance_would(stages: Stages) -> None:
    """Interleaved samples of a soft shadow: their 4x4 means vary less than those of independent ones."""
    stages.place_camera(stages.start_camera, 256, 256)
    mean = np.mean([shade_direct(stages, seed).diffuse for seed in range(64)], axis=0)
    error = shade_direct(stages, 100).diffuse - mean
    blocks = error.reshape(64, 4, 64, 4, 3).mean(axis=(1, 3))
    stages.place_camera(stages.start_camera, SIZE, SIZE)
    independent = np.square(error).reshape(64, 4, 64, 4, 3).mean(axis=(1, 3)) / 16.0
    lit = independent.mean(axis=-1) > 1e-6
    assert lit.mean() > 0.2
    # The mean that stands for the truth is no better than a 64th of one sample's noise.
    assert np.median(np.square(blocks)[lit]) < 0.3 * np.median(independent[lit])


def test_lights_and_sky_are_seen_where_they_are(mi: Any, make_furnace: Callable[..., Any]) -> None:
    stages = Stages(make_furnace({"type": "diffuse", "reflectance": 0.5}))
    stages.place_camera(stages.start_camera, 8, 8)
    light = shade_direct(stages, 0)
    assert np.allclose(light.emitted, 0.0)
    assert np.allclose(light.specular, 0.0)
    assert np.mean([shade_direct(stages, seed).diffuse for seed in range(32)]) == pytest.approx(0.5, rel=MEAN_NOISE)
    away = stages.start_camera
    backwards = type(away)(away.position, -away.forward, away.up, away.fov_y)
    stages.place_camera(backwards, 8, 8)
    light = shade_direct(stages, 0)
    assert np.allclose(light.emitted, 1.0)
    assert np.allclose(light.diffuse + light.specular, 0.0)


def test_a_mirror_shows_the_sky_as_direct_light(make_furnace: Callable[..., Any]) -> None:
    stages = Stages(make_furnace({"type": "conductor", "material": "none"}))
    stages.place_camera(stages.start_camera, 8, 8)
    light = shade_direct(stages, 3)
    assert np.allclose(light.specular, 1.0, atol=1e-4)
    assert np.allclose(light.diffuse, 0.0)


@pytest.mark.parametrize("count", [1, 6])
def test_only_rays_that_may_meet_a_lamp_are_traced(mi: Any, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    scene = mi.load_dict(make_mirror_room(mi, count))
    wise = Stages(scene)
    monkeypatch.setattr("lobewise.render.stages.list_lamps", lambda _: None)
    thorough = Stages(scene)
    lamp = mi.traverse(scene)
    there = mi.Transform4f().translate([-1.5, 0.5, 0.0]) @ lamp["lamp0.to_world"]
    for move in (None, there):
        if move is not None:
            lamp["lamp0.to_world"] = move
            lamp.update()
        found = []
        for stages in (wise, thorough):
            stages.place_camera(stages.start_camera, SIZE, SIZE)
            found.append(shade_direct(stages, 3).specular)
        assert found[0].max() > 1.0
        assert np.array_equal(*found)


def make_mirror_room(mi: Any, lamps: int) -> dict[str, Any]:
    """Return a floor that is nearly a mirror, under small lamps in a row."""
    at = mi.ScalarTransform4f
    floor = {"type": "roughconductor", "alpha": 0.05}
    room: dict[str, Any] = {
        "type": "scene",
        "sensor": make_camera(mi, [0.0, 2.0, 5.0], size=(SIZE, SIZE), box=False, fov=60.0),
        "floor": make_square(at().rotate([1, 0, 0], -90).scale(4), bsdf=floor),
    }
    for k in range(lamps):
        place = at().translate([k - 0.5 * (lamps - 1), 1.5, 0.0]).rotate([1, 0, 0], 90).scale(0.3)
        room[f"lamp{k}"] = make_lamp(place, 6.0)
    return room


@pytest.mark.nightly
def test_path_light_is_the_renderers_indirect_light(stages: Stages, showroom: Any) -> None:
    stages.place_camera(stages.start_camera, SIZE, SIZE)
    method = get_path_light(stages)
    diffuse, specular, distance, *_ = stages.shade_indirect(method, *list_pixels(), 256, 5)
    reference = render_frame(showroom, spp=256, light="indirect").radiance
    assert diffuse.mean() == pytest.approx(reference.diffuse.mean(), rel=MEAN_NOISE)
    assert specular.mean() == pytest.approx(reference.specular.mean(), rel=MEAN_NOISE)
    hits = stages.trace_first(stages.start_camera, 0)[0].gbuffer
    mirrors = (hits.alpha_u < 0.06) & (hits.lobe_kind > 0) & (hits.hit_distance > 0)
    ratio = distance.reshape(SIZE, SIZE)[mirrors] / hits.hit_distance[mirrors]
    assert abs(np.median(ratio) - 1.0) < 0.05


def test_what_a_pixel_gets_does_not_depend_on_the_others(stages: Stages) -> None:
    stages.place_camera(stages.start_camera, SIZE, SIZE)
    method = get_path_light(stages)
    rows, columns = list_pixels()
    everything = stages.shade_indirect(method, rows, columns, 2, 7)
    some = np.flatnonzero((rows * 7 + columns) % 5 == 2)[::-1]
    part = stages.shade_indirect(method, rows[some], columns[some], 2, 7)
    again = stages.shade_indirect(method, rows, columns, 2, 7)
    other = stages.shade_indirect(method, rows, columns, 2, 8)
    both = stages.shade_indirect(method, rows, columns, 2, 7, 8)
    for whole, few, same, different, pair in zip(everything, part, again, other, both, strict=True):
        assert np.array_equal(whole[some], few)
        assert np.array_equal(whole, same)
        assert not np.array_equal(whole, different)
        assert np.array_equal(pair, np.stack([whole, different], axis=1).reshape(pair.shape))


@pytest.mark.nightly
def test_scenes_that_cannot_be_recorded_are_rendered_all_the_same(mi: Any) -> None:
    """A BSDF of a plugin written in Python, whose fitted lobes lie outside the scene."""
    square = {"type": "rectangle", "bsdf": {"type": register_lobes()}}
    sensor = make_camera(mi, [0, 2, 4], size=(12, 12), fov=30.0)
    scene = mi.load_dict({"type": "scene", "sensor": sensor, "square": square, "sky": {"type": "constant"}})
    stages = Stages(scene)
    for size in (12, 12, 16):
        stages.place_camera(stages.start_camera, size, size)
        hits, light = stages.trace_first(stages.start_camera, 0)
        expected = render_frame(scene, spp=1, aov_only=True).gbuffer
        assert len(hits.lobe_tables) == 1
        for name in ("depth", "alpha_u", "alpha_v", "material"):
            assert np.allclose(getattr(hits.gbuffer, name), getattr(expected, name), atol=BIT, rtol=BIT), name
        assert np.isfinite(light.diffuse).all()
        assert (light.diffuse + light.specular).max() > 0.1


@pytest.mark.sampled("roughconductor")
@pytest.mark.parametrize("kind", ["roughconductor", "conductor", "roughplastic", "dielectric"])
def test_paths_tell_the_rays_of_their_samples(mi: Any, kind: str) -> None:
    """A surface inside a white sphere whose light was scattered before: all rays bring the same radiance."""
    roughness = {"alpha": 0.2, "distribution": "ggx"} if kind.startswith("rough") else {}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": make_camera(mi, [0, -3, 0.5], up=[0, 0, 1], size=(SIZE, SIZE), fov=20),
            "ball": {"type": "sphere", "radius": 0.4, "bsdf": {"type": kind, **roughness}},
            "room": {"type": "sphere", "radius": 10, "flip_normals": True, "bsdf": white},
            "lamp": {"type": "sphere", "center": [0, 8, 0], "radius": 0.5, "emitter": lamp},
        }
    )
    stages = Stages(scene)
    stages.place_camera(stages.start_camera, SIZE, SIZE)
    rows, columns = list_pixels()
    light = stages.shade_indirect(get_path_light(stages), rows, columns, 1, 3)
    guides = stages.trace_first(stages.start_camera, 0)[0].gbuffer
    ball = (guides.specular_albedo.max(axis=-1) > 0.0).ravel()
    assert ball.sum() > 300
    weight = light.ray_weight[ball]
    if kind == "dielectric":
        assert (weight == 1.0).all()
        return
    # The albedo of plastic is that of a fit, and its weights are noisy: the lobe is sampled seldom.
    assert weight.mean() == pytest.approx(1.0, abs=0.25 if kind == "roughplastic" else 0.05)
    assert not light.specular[ball][weight == 0.0].any()
