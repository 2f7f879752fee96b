"""The image of the color alone, which the quality "high" mixes in where guides are noise."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.denoising import chain, denoise
from lobewise.denoising.refining.unguided import (
    DISC_RADIUS,
    LEFT_OUT,
    MAX_SHARE,
    MIN_SHARE,
    compute_unguided_share,
    count_isolated,
    judge_guides,
    limit_to_noise,
)
from lobewise.io import write_frame
from lobewise.metrics import rel_mse
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

SHAPE = (64, 72)
CHEAP: dict[str, Any] = {"quality": "high", "similarity": "normal", "with_oidn": False}


def make_normals(rng: np.random.Generator, spread: float) -> FloatArray:
    """Return normals of a sphere and of the wall behind it, plus noise."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 24.0 - 1.2
    outside = np.maximum(1.0 - x * x - y * y, 0.0)
    normal = np.where((outside > 0.0)[..., None], np.stack([x, y, np.sqrt(outside)], axis=-1), [0.0, 0.0, 1.0])
    normal = normal + rng.normal(0.0, spread, normal.shape)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True), np.float32)


def make_noise(rng: np.random.Generator) -> FloatArray:
    return rng.gamma(0.5, 2.0, (*SHAPE, 1)).astype(np.float32) * np.ones(3, np.float32)


def make_noisy(rng: np.random.Generator, spread: float) -> tuple[Frame, FloatArray]:
    """Return a frame of smooth light by both lobes, with light passes, and its clean image."""
    clean = np.linspace(0.5, 1.0, SHAPE[1], dtype=np.float32)[None, :, None] * np.ones((*SHAPE, 3), np.float32)
    noise, lamps = make_noise(rng), {}
    parts = 0.7 * clean * noise, 0.3 * clean * noise
    lamps = {"key": 0.6 * clean * noise, "fill": 0.4 * clean * noise}
    guides = GBuffer(normal=make_normals(rng, spread))
    radiance = Radiance(parts[0] + parts[1], diffuse=parts[0], specular=parts[1])
    return Frame(radiance, guides, also=lamps), clean


def test_noise_of_normals_gives_the_largest_share_and_a_sphere_none(rng: np.random.Generator) -> None:
    color = make_noise(rng)
    assert compute_unguided_share(color, GBuffer(normal=make_normals(rng, 0.0))).max() < MIN_SHARE
    noisy = GBuffer(normal=make_normals(rng, 0.2))
    np.testing.assert_array_equal(compute_unguided_share(color, noisy), np.full(SHAPE, MAX_SHARE, np.float32))
    assert compute_unguided_share(color, GBuffer()).max() == 0.0


def test_few_odd_pixels_have_a_share_in_proportion(rng: np.random.Generator) -> None:
    normal = make_normals(rng, 0.0)
    normal[::8, 4::8] = [0.0, 0.8, -0.6]
    share = judge_guides(count_isolated(make_noise(rng), GBuffer(normal=normal)))
    assert 0.5 * 15.0 / 64.0 * MAX_SHARE < share < 1.1 * 15.0 / 64.0 * MAX_SHARE


@pytest.mark.parametrize(("kind", "expected"), [("noise", 1.0), ("sky", 0.0), ("stars", 0.0), ("black", 0.0)])
def test_light_without_a_surface_is_replaced_where_it_is_noise(
    rng: np.random.Generator, kind: str, expected: float
) -> None:
    normal = make_normals(rng, 0.0)
    normal[:32] = 0.0
    color = make_noise(rng)
    y, x = np.mgrid[:32, : SHAPE[1]]
    color[:32] = {
        "noise": color[:32],
        "sky": (2.0 + np.sin(0.3 * x + 0.2 * y))[..., None],
        "stars": (rng.random((32, SHAPE[1], 1)) < 0.02) * 10.0,
        "black": 0.0 * color[:32],
    }[kind]
    share = compute_unguided_share(color, GBuffer(normal=normal))
    assert share[:32].mean() == pytest.approx(expected, abs=0.05)
    # Fog lies before surfaces, too.
    assert share[40:].min() == share[40:].max()
    assert (share[40:].max() == np.float32(MAX_SHARE)) == (kind == "noise")


def test_light_of_no_surface_is_left_in_focus_and_filtered_by_its_color_in_discs() -> None:
    rest = np.array([0.0, 1.0, 4.0, *[0.0] * 20, 0.0, 1.0, 3.0, 4.0], np.float32)[None, :, None] * np.ones(
        3, np.float32
    )
    image, share = np.full_like(rest, 4.0), np.full(rest.shape[:2], 0.4, np.float32)
    in_focus = 0.4 * (1.0 - rest[0, :, 0] / 4.0)
    np.testing.assert_allclose(limit_to_noise(share, rest, image, None)[0], in_focus, atol=1e-6)
    blur = np.zeros_like(share)
    blur[0, -1], blur[0, -4] = np.nan, 3.0
    np.testing.assert_allclose(
        limit_to_noise(share, rest, image, blur)[0, :-1], [*in_focus[:-4], 0.4, *in_focus[-3:-1]]
    )
    # A lit pixel out of focus marks its surroundings.
    blur[0, -3] = 3.0
    found = limit_to_noise(share, rest, image, blur)[0]
    np.testing.assert_allclose(found[: -DISC_RADIUS - 3], in_focus[: -DISC_RADIUS - 3], atol=1e-6)
    np.testing.assert_allclose(found[-DISC_RADIUS - 3 :], [0.4] * 8 + [0.4, 0.75, 0.4], atol=1e-6)


def test_bad_pixels_and_normals_are_isolated_from_nothing(rng: np.random.Generator) -> None:
    color, normal = make_noise(rng), make_normals(rng, 0.0)
    normal[:8] = 0.0
    color[:8] = 1.0
    for value in (np.nan, np.inf):
        color[4, ::2], normal[20, ::2] = value, value
        assert compute_unguided_share(color, GBuffer(normal=normal)).max() < MIN_SHARE


def test_an_image_that_is_too_small_has_no_share() -> None:
    assert compute_unguided_share(np.ones((4, 2, 3), np.float32), GBuffer(normal=np.ones((4, 2, 3)))).max() == 0.0


@pytest.fixture
def guided(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the image of the color alone out."""
    monkeypatch.setattr(chain, "mix_unguided", lambda frame, settings, found, *_: (found, []))


def test_noise_of_normals_does_no_harm_any_more(rng: np.random.Generator, request: pytest.FixtureRequest) -> None:
    frame, clean = make_noisy(rng, 0.5)
    result = denoise(frame, **CHEAP)
    total = result.also["key"] + result.also["fill"]
    np.testing.assert_allclose(total, result.image, rtol=2e-3)
    np.testing.assert_allclose(result.diffuse + result.specular, result.image, rtol=1e-4)
    request.getfixturevalue("guided")
    assert rel_mse(result.image, clean) < 0.7 * rel_mse(denoise(frame, **CHEAP).image, clean)


def test_guides_without_noise_are_not_left_out(rng: np.random.Generator, request: pytest.FixtureRequest) -> None:
    frame, _ = make_noisy(rng, 0.0)
    result = denoise(frame, **CHEAP)
    request.getfixturevalue("guided")
    np.testing.assert_array_equal(result.image, denoise(frame, **CHEAP).image)


def test_bands_say_what_they_leave_out(rng: np.random.Generator, tmp_path: Path) -> None:
    """Noisy guides, none, and a lamp out of focus."""
    for spread, blur, told in ((0.5, 0.0, True), (0.0, 0.0, False), (0.0, 5.0, True)):
        frame, _ = make_noisy(rng, spread)
        light, parts = np.array(frame.radiance.color), frame.radiance.parts
        light[5:9, 5:9] += blur
        radius = np.full(light.shape[:2], blur, np.float32)
        guides = replace(frame.gbuffer, blur_radius=radius)
        frame = replace(frame, radiance=Radiance(light, *(parts or ())), gbuffer=guides, also={})
        write_frame(tmp_path / "in.exr", frame)
        done = denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", rows=32, quality="high", similarity="normal")
        assert (LEFT_OUT in done.notes) == told
