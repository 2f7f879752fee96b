"""Indirect light apart: what remains when emission and direct light are taken away, with the same random numbers."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.records.frame import Frame
from lobewise.render import render_frame, render_pixels, render_reference, render_sparse_frame
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba

SEED = 11

ROUNDING = {"rtol": 1e-4, "atol": 2e-5}
"""Sums of 4 samples of single precision, of values up to 7, that are taken apart in another order."""


@pytest.fixture(scope="module")
def scene(mi: Any, make_box_scene: Callable[..., Any]) -> Any:
    plastic = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.2}
    ball = {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.7, "bsdf": plastic}
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [3.0, 2.0, 1.0]}}
    bulb = {"type": "sphere", "center": [-1.0, 1.3, -1.0], "radius": 0.3, "emitter": glow}
    return make_box_scene({"ball": ball, "bulb": bulb}, size=16)


@pytest.fixture(scope="module")
def everything(scene: Any) -> Frame:
    return render_frame(scene, spp=4, seed=SEED)


@pytest.fixture(scope="module")
def indirect(scene: Any) -> Frame:
    return render_frame(scene, spp=4, seed=SEED, light="indirect")


@pytest.mark.nightly
def test_indirect_is_all_without_emission_and_direct_light(everything: Frame, indirect: Frame) -> None:
    radiance = everything.radiance
    emitted = radiance.color - radiance.diffuse - radiance.specular
    assert emitted.max() > 1.0
    assert radiance.direct.max() > 0.1
    assert indirect.radiance.color.mean() > 0.01
    assert np.allclose(indirect.radiance.color, radiance.color - emitted - radiance.direct, **ROUNDING)
    assert np.allclose(indirect.radiance.indirect, radiance.indirect, **ROUNDING)


def test_parts_sum_to_the_color_and_nothing_is_direct(indirect: Frame) -> None:
    radiance = indirect.radiance
    assert radiance.direct is None
    assert np.allclose(radiance.indirect, radiance.color, **ROUNDING)
    for part in (radiance, indirect.half_a, indirect.half_b):
        assert part.diffuse.max() > 0.0
        assert part.specular.max() > 0.0
        assert np.allclose(part.diffuse + part.specular, part.color, **ROUNDING)


def test_lobes_keep_what_longer_paths_add_to_direct_light(scene: Any, everything: Frame, indirect: Frame) -> None:
    # Paths of two vertices are the same paths, cut after the first scattering.
    short = render_frame(scene, spp=4, seed=SEED, max_depth=2)
    for name in ("diffuse", "specular"):
        longer = getattr(everything.radiance, name) - getattr(short.radiance, name)
        assert np.allclose(getattr(indirect.radiance, name), longer, **ROUNDING), name


def test_variance_is_that_of_the_halves(scene: Any) -> None:
    frame = render_frame(scene, spp=2, seed=SEED, light="indirect")
    for name in ("color", "diffuse", "specular"):
        difference = getattr(frame.half_a, name) - getattr(frame.half_b, name)
        assert np.allclose(getattr(frame.variance, name), 0.25 * difference**2, rtol=1e-4, atol=1e-7), name


def test_guides_are_those_of_all_light(everything: Frame, indirect: Frame) -> None:
    for name in ("position", "normal", "diffuse_albedo", "specular_albedo", "hit_distance"):
        assert np.array_equal(getattr(everything.gbuffer, name), getattr(indirect.gbuffer, name)), name


@pytest.mark.nightly
def test_references_pixels_and_sparse_frames_agree_with_the_frame(scene: Any, indirect: Frame) -> None:
    reference = render_reference(scene, spp=4, seed=SEED, light="indirect")
    assert np.allclose(reference.radiance.color, indirect.radiance.color, **ROUNDING)
    rows, columns = np.array([3, 9]), np.array([0, 12])
    pixels = render_pixels(scene, rows, columns, spp=4, seed=SEED, light="indirect")
    sparse = render_sparse_frame(scene, spp=4, seed=SEED, scale=2, place=(1, 0), light="indirect")
    for name in ("color", "diffuse", "specular", "indirect"):
        whole = getattr(indirect.radiance, name)
        np.testing.assert_array_equal(getattr(pixels, name)[:, 0], whole[rows, columns])
        np.testing.assert_array_equal(getattr(sparse.radiance, name), whole[sparse.shaded])
    assert pixels.direct is None
    assert sparse.radiance.direct is None


def test_unknown_light_is_an_error(scene: Any) -> None:
    calls: list[Callable[..., Any]] = [render_frame, render_reference]
    calls.append(lambda scene, **rest: render_sparse_frame(scene, scale=2, **rest))
    calls.append(lambda scene, **rest: render_pixels(scene, np.array([0]), np.array([0]), **rest))
    for call in calls:
        with refuses(InputError, "light"):
            call(scene, spp=1, light="indirekt")
