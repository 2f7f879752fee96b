"""Clusters of virtual lights against closed forms, against paths, against point lights, and against themselves."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.metrics import rel_mse
from tests.mistakes import refuses
from tests.render.virtual_lights.test_virtual_lights import (
    PATHS_NOISE,
    expect_one_light,
    get_image,
    make_cornell_box,
    make_corner,
    make_lights,
    render_paths,
    total,
    view,
)

DARKER = 0.08
"""Light that metal boxes lack: clusters near an edge reach beyond it."""

pytestmark = pytest.mark.mitsuba


def make_clusters(scene: Any, **options: Any) -> Any:
    return make_lights(scene, kind="gaussians", **options)


@pytest.fixture(scope="module")
def cornell(mi: Any) -> Any:
    return make_cornell_box(mi)


def test_one_light_is_the_closed_form(mi: Any) -> None:
    scene = make_corner(mi)
    points = view(scene)
    method = make_clusters(scene, count=1, max_depth=3)
    expected = expect_one_light(method, points)
    assert expected.max() > 0.0
    for all_lights in (False, True):
        found = method.shade(points, samples=1, seed=0, all_lights=all_lights)
        np.testing.assert_allclose(get_image(found.diffuse), expected, rtol=2e-3, atol=1e-4 * expected.max())
        assert get_image(found.specular).max() == 0.0
        assert np.array(found.hit_distance).max() == 0.0


@pytest.mark.nightly
@pytest.mark.parametrize("alpha", [None, 0.12])
def test_drawn_clusters_are_the_sum_over_all(mi: Any, alpha: float | None) -> None:
    scene = make_cornell_box(mi, alpha)
    points = view(scene)
    method = make_clusters(scene, count=512)
    whole = np.mean([total(method.shade(points, samples=4, seed=k, all_lights=True)) for k in range(16)], axis=0)
    drawn = np.array([total(method.shade(points, samples=16, seed=k)) for k in range(32)])
    error = drawn.std(axis=0) / np.sqrt(len(drawn))
    assert drawn.mean() == pytest.approx(whole.mean(), rel=5e-3)
    lit = whole > 0.05 * whole.mean()
    assert np.median(error[lit] / whole[lit]) < 0.03
    # Each of the two means has noise of its own.
    off = np.abs(drawn.mean(axis=0) - whole)[lit] / (error[lit] + 0.02 * whole[lit])
    assert np.percentile(off, 95) < 3.0


@pytest.mark.nightly
def test_light_comes_near_paths(cornell: Any) -> None:
    points = view(cornell)
    paths = total(render_paths(cornell, points, samples=1024))
    errors = []
    for count in (256, 2048, 16384):
        image = total(make_clusters(cornell, count=count).shade(points, samples=64, seed=0))
        errors.append(rel_mse(image, paths))
    assert errors[2] < 0.5 * errors[0]
    assert errors[2] < 0.01
    assert image.mean() == pytest.approx(paths.mean(), rel=2 * PATHS_NOISE)


@pytest.mark.nightly
@pytest.mark.parametrize("alpha", [0.03, 0.12, 0.35])
def test_glossy_surfaces_have_less_error_than_by_point_lights(mi: Any, alpha: float) -> None:
    scene = make_cornell_box(mi, alpha)
    points = view(scene)
    metal = (np.array(points.surface.alpha_u) > 0)[None]
    assert 0.1 < metal.mean() < 0.5
    paths = total(render_paths(scene, points, samples=2048))
    spikes = total(make_lights(scene).shade(points, samples=1, seed=0))
    all_spikes = total(make_lights(scene).shade(points, samples=1, seed=0, all_lights=True))
    found = total(make_clusters(scene).shade(points, samples=1, seed=0))
    converged = total(make_clusters(scene).shade(points, samples=64, seed=1))
    assert rel_mse(found, paths, metal) < 0.5 * rel_mse(spikes, paths, metal)
    # Lobes of this width have no spikes when all lights are taken.
    assert rel_mse(converged, paths, metal) < (1.0 if alpha > 0.3 else 0.1) * rel_mse(all_spikes, paths, metal)
    assert converged[metal].mean() == pytest.approx(paths[metal].mean(), rel=DARKER)


def test_light_behind_a_mask_passes(mi: Any) -> None:
    mask = {"type": "mask", "opacity": 0.25, "inner": {"type": "diffuse"}}
    transform = mi.ScalarTransform4f().translate([0, 1.0, -0.3]).scale([2, 2, 1])
    scene = make_corner(mi, screen={"type": "rectangle", "to_world": transform, "bsdf": mask})
    points = view(scene)
    wall = np.array(points.si.p)[2] < -0.99
    method = make_clusters(scene, count=1, max_depth=3)
    found = get_image(method.shade(points, samples=256, seed=0).diffuse)[:, wall]
    expected = 0.75 * expect_one_light(method, points)[:, wall]
    np.testing.assert_allclose(found, expected, rtol=5e-3, atol=1e-4 * expected.max())


def test_light_that_hits_nothing_is_dark(mi: Any) -> None:
    away = mi.ScalarTransform4f().look_at(origin=[0, 3, 0], target=[0, 9, 0], up=[1, 0, 0])
    spot = {"type": "spot", "to_world": away, "intensity": {"type": "rgb", "value": 10.0}}
    scene = make_corner(mi, spot=spot)
    method = make_clusters(scene, count=64)
    assert method.lights.number == 0
    for all_lights in (False, True):
        found = total(method.shade(view(scene), samples=2, seed=0, all_lights=all_lights))
        np.testing.assert_array_equal(found, 0.0)


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        ({"kind": "spheres"}, ("kind", "'spheres'")),
        ({"kind": "gaussians", "radius": 0.1}, ("kind", "radius 0.1")),
        ({"kind": "gaussians", "compensate": True}, ("kind", "compensate")),
        ({"kind": "gaussians", "cluster_size": 0}, ("cluster_size", "0")),
        ({"kind": "gaussians", "cluster_size": 257}, ("cluster_size", "257")),
    ],
)
def test_bad_options_are_told(mi: Any, options: dict[str, Any], refused: tuple[str, ...]) -> None:
    with refuses(InputError, *refused):
        make_lights(make_corner(mi), **options)


def test_clusters_need_no_band_limit(mi: Any) -> None:
    scene = make_corner(mi)
    method = make_clusters(scene, count=16)
    assert method.get_band_limit(view(scene), 1) == 0.0
    with refuses(InputError, "kind"):
        method.count_lights_seen(view(scene))
