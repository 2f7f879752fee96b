"""The short history of direct light, against a definition in NumPy and its laws."""

from typing import Any

import numpy as np
import pytest

from lobewise.filters.history.light import (
    DIFFUSE_SPREAD,
    MAX_DEPTH_CHANGE,
    MAX_FRAMES,
    MAX_TURN_PER_ALPHA,
    RADIUS_PIXELS,
    SPECULAR_SPREAD,
    LightPast,
    blend_light,
)
from lobewise.lobes.vectors import LUMINANCE
from lobewise.records.camera import Camera
from lobewise.records.frame import GBuffer

HEIGHT, WIDTH = 37, 50
FIELD_RADIANS = 0.6


def make_camera(column: float = 0.0) -> Camera:
    """Return a camera that is moved sideways by some pixels of a plane at the distance 4."""
    step = 2.0 * 4.0 * np.tan(0.5 * FIELD_RADIANS) / HEIGHT
    return Camera(position=(column * step, 0, 4), forward=(0, 0, -1), up=(0, 1, 0), fov_y=FIELD_RADIANS)


def make_plane(camera: Camera, alpha: float = 0.3, height: float = 0.0) -> GBuffer:
    """Return the guides of a plane that faces the camera; its left part is the background."""
    half = np.tan(0.5 * FIELD_RADIANS)
    far = 4.0 - height
    x = ((np.arange(WIDTH) + 0.5) / WIDTH * 2.0 - 1.0) * half * WIDTH / HEIGHT * far + camera.position[0]
    y = (1.0 - (np.arange(HEIGHT) + 0.5) / HEIGHT * 2.0) * half * far
    position = np.stack([*np.meshgrid(x, y), np.full((HEIGHT, WIDTH), height)], axis=-1)
    rng = np.random.default_rng(3)
    depth = np.full((HEIGHT, WIDTH), far)
    depth[:, :4] = 0.0
    one = np.ones((HEIGHT, WIDTH))
    return GBuffer(
        depth=depth,
        position=position,
        normal=np.broadcast_to((0.0, 0.0, 1.0), (HEIGHT, WIDTH, 3)),
        alpha_u=alpha * one,
        alpha_v=alpha * one,
        diffuse_albedo=rng.uniform(0.2, 0.9, (HEIGHT, WIDTH, 3)),
        specular_albedo=rng.uniform(0.2, 0.9, (HEIGHT, WIDTH, 3)),
    )


def make_light(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random diffuse and specular light."""
    rng = np.random.default_rng(seed)
    first, second = rng.gamma(2.0, 0.5, (2, HEIGHT, WIDTH, 3)).astype(np.float32)
    return first, second


def compute_luminance(image: Any) -> np.ndarray:
    """Return the luminance of an image."""
    return np.asarray(image) @ np.array(LUMINANCE)


def blend_in_numpy(
    light: tuple[Any, Any], gbuffer: GBuffer, camera: Camera, past: LightPast, samples: int, shift: int
) -> list[np.ndarray]:
    """Return diffuse and specular light by the definition, for a plane whose past lies ``shift`` columns to the right.

    Only pixels away from the border count.
    """
    inner = np.s_[RADIUS_PIXELS:-RADIUS_PIXELS, 12:-12]
    means = np.asarray(past.means, np.float64)
    old = np.roll(means, -shift, axis=1)[inner]
    position = np.asarray(gbuffer.position, np.float64)[inner]
    views = [position - eye for eye in (camera.position, past.camera.position)]
    far = [np.linalg.norm(view, axis=-1) for view in views]
    same = np.abs(old[..., 4] - far[1]) < MAX_DEPTH_CHANGE * far[1]
    turn = np.linalg.norm(views[0] / far[0][..., None] - views[1] / far[1][..., None], axis=-1)
    length, narrow = (np.minimum(old[..., k], MAX_FRAMES - 1.0) + 1.0 for k in (2, 3))
    narrow = np.minimum(narrow, 1.0 + MAX_TURN_PER_ALPHA * np.asarray(gbuffer.alpha_u)[inner] / np.maximum(turn, 1e-9))
    albedos = (gbuffer.diffuse_albedo, gbuffer.specular_albedo)
    images = []
    for k, (shown, albedo, count) in enumerate(zip(light, albedos, (length, narrow), strict=True)):
        value = compute_luminance(shown) / compute_luminance(albedo)
        size = 2 * RADIUS_PIXELS + 1
        squares = np.lib.stride_tricks.sliding_window_view(value, (size, size))[:, 12 - RADIUS_PIXELS :][:, : -12 + 2]
        mean, spread = squares.mean(axis=(-2, -1)), squares.std(axis=(-2, -1))
        most = (DIFFUSE_SPREAD, SPECULAR_SPREAD)[k] * spread
        bounded = np.clip(old[..., k], mean - most, mean + most)
        value = value[inner]
        mixed = bounded + samples / (samples + count - 1.0) * (value - bounded)
        mixed = np.where(same & (old[..., 2] > 0.0), mixed, value)
        images.append(np.asarray(shown)[inner] * (mixed / value)[..., None])
    return images


@pytest.mark.parametrize(("shift", "samples"), [(0, 1), (3, 1), (3, 5)])
def test_light_is_mixed_as_defined(shift: int, samples: int) -> None:
    first, second = make_camera(), make_camera(shift)
    earlier = make_camera(-5.0)
    past = blend_light(*make_light(1), make_plane(earlier), earlier, None, 1)[2]
    for seed in (2, 3):
        past = blend_light(*make_light(seed), make_plane(first), first, past, 1)[2]
    light, gbuffer = make_light(4), make_plane(second)
    *found, now = blend_light(*light, gbuffer, second, past, samples)
    inner = np.s_[RADIUS_PIXELS:-RADIUS_PIXELS, 12:-12]
    for image, expected in zip(found, blend_in_numpy(light, gbuffer, second, past, samples, shift), strict=True):
        np.testing.assert_allclose(image[inner], expected, rtol=2e-3)
    np.testing.assert_allclose(now.means[inner][..., 2], 4.0, rtol=1e-5)
    assert (now.means[inner][..., 3] < 3.99).all()


def test_a_history_lessens_noise_and_light_keeps_its_hue() -> None:
    camera, past = make_camera(), None
    gbuffer = make_plane(camera)
    for seed in range(12):
        light = make_light(seed)
        diffuse, specular, past = blend_light(*light, gbuffer, camera, past, 1)
    there = np.asarray(gbuffer.depth) > 0.0
    for image, noisy in ((diffuse, light[0]), (specular, light[1])):
        ratio = image / noisy
        np.testing.assert_allclose(ratio[..., 1:], ratio[..., :1].repeat(2, axis=-1), rtol=1e-4)
        np.testing.assert_array_equal(image[~there], noisy[~there])
    albedo = compute_luminance(gbuffer.diffuse_albedo)
    noise = [np.std((compute_luminance(image) / albedo)[there]) for image in (light[0], diffuse)]
    assert noise[1] < 0.6 * noise[0]


def test_the_first_frame_and_another_size_change_nothing() -> None:
    camera, light = make_camera(), make_light(1)
    *first, past = blend_light(*light, make_plane(camera), camera, None, 1)
    small = LightPast(past.means[:-1], camera)
    for found in (first, blend_light(*light, make_plane(camera), camera, small, 1)[:2]):
        for image, expected in zip(found, light, strict=True):
            np.testing.assert_array_equal(image, expected)


def test_another_surface_gives_no_history() -> None:
    camera, light = make_camera(), make_light(2)
    past = blend_light(*make_light(1), make_plane(camera, height=0.5), camera, None, 1)[2]
    *found, now = blend_light(*light, make_plane(camera), camera, past, 1)
    for image, expected in zip(found, light, strict=True):
        np.testing.assert_allclose(image, expected, rtol=1e-6)
    assert now.means[..., 2].max() == 1.0


def test_a_mirror_keeps_its_light_of_this_frame_while_the_view_turns() -> None:
    first, light = make_camera(), make_light(2)
    past = blend_light(*make_light(1), make_plane(first, 1e-6), first, None, 1)[2]
    for shift, is_same in ((3, True), (0, False)):
        camera = make_camera(shift)
        _, specular, _ = blend_light(*light, make_plane(camera, 1e-6), camera, past, 1)
        assert np.allclose(specular[:, 12:-12], light[1][:, 12:-12], rtol=1e-2) == is_same


def test_light_that_went_out_is_gone() -> None:
    camera = make_camera()
    past = blend_light(*make_light(1), make_plane(camera), camera, None, 1)[2]
    dark = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    diffuse, specular, past = blend_light(dark, dark, make_plane(camera), camera, past, 1)
    assert not diffuse.any()
    assert not specular.any()
    assert not past.means[..., :2].any()


def test_bad_light_does_not_stay() -> None:
    camera, light = make_camera(), make_light(1)
    light[0][20, 30] = np.nan
    light[1][21, 31] = np.inf
    first = blend_light(*light, make_plane(camera), camera, None, 1)[2]
    assert np.isfinite(first.means).all()
    diffuse, specular, second = blend_light(*light, make_plane(camera), camera, first, 1)
    assert np.isfinite(second.means).all()
    assert np.count_nonzero(~np.isfinite(diffuse)) == np.count_nonzero(~np.isfinite(specular)) == 3
    diffuse, specular, _ = blend_light(*make_light(2), make_plane(camera), camera, second, 1)
    assert np.isfinite(diffuse).all()
    assert np.isfinite(specular).all()
