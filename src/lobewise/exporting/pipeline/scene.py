"""The frames of the example: a floor and two balls under a moving camera, with the noise of a few samples.

Every ray is traced in NumPy, so that the frames are small, the same everywhere, and have all images that a pipeline
may read. The light is invented: smooth functions of place and direction times random numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.records.camera import Camera, project_points
from lobewise.records.frame import FloatArray, Frame, GBuffer, LobeKind, Radiance

Image = NDArray[np.float64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
WIDTH, HEIGHT = 75, 200
"""Size of the frames: an odd width, and several bands of rows, of which the last is not full."""
SPP = 8
FOV_Y = 0.8
BALLS = (((-0.7, 0.8, 0.0), 0.8, 0.3), ((0.9, 0.5, 0.6), 0.5, 0.02))
"""Centre, radius and roughness alpha of each ball."""
BALL_STEP = np.array([0.04, 0.0, -0.02])
"""Way of the last ball from frame to frame."""
LIGHT = np.array([0.4, 0.8, 0.45]) / np.linalg.norm([0.4, 0.8, 0.45])
NO_BALL = -1
LIGHTS = "color", "diffuse", "specular"
BRUSH = np.array([0.3, 0.9, 0.1])
"""Direction across which surfaces are brushed."""
CUT = 4
"""Number of the frame from which on another camera looks at the scene."""


class Traced(NamedTuple):
    """What the rays of an image hit."""

    distance: Image
    """Length of the ray; infinite where it hits nothing."""
    which: Numbers
    """Number of the ball, or `NO_BALL`."""


def place_camera(number: int) -> Camera:
    """Return the camera of a frame."""
    if number >= CUT:
        position = np.array([-3.0, 0.9, -2.5])
        return Camera(position, np.array([0.3, 0.5, 0.0]) - position, (0.0, 1.0, 0.0), FOV_Y)
    position = np.array([0.3 + 0.05 * number, 1.3 + 0.01 * number, 4.2 - 0.03 * number])
    return Camera(position, np.array([0.02, 0.5, 0.0]) - position, (0.0, 1.0, 0.0), FOV_Y)


def place_balls(number: int) -> list[tuple[Image, float, float]]:
    """Return centre, radius and roughness of the balls of a frame."""
    balls = [(np.array(centre), radius, alpha) for centre, radius, alpha in BALLS]
    centre, radius, alpha = balls[-1]
    return [*balls[:-1], (centre + number * BALL_STEP, radius, alpha)]


def trace(origin: Image, ray: Image, number: int) -> Traced:
    """Return what rays hit; ``ray`` has unit length."""
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = -origin[..., 1] / ray[..., 1]
    distance = np.where((floor > 1e-4) & (floor < 12.0), floor, np.inf)
    which = np.full(distance.shape, NO_BALL)
    for k, (centre, radius, _) in enumerate(place_balls(number)):
        step = origin - centre
        half = np.sum(step * ray, axis=-1)
        inside = half**2 - np.sum(step * step, axis=-1) + radius**2
        near = -half - np.sqrt(np.maximum(inside, 0.0))
        closer = (inside > 0.0) & (near > 1e-4) & (near < distance)
        distance, which = np.where(closer, near, distance), np.where(closer, k, which)
    return Traced(distance, which)


def shade_sky(ray: Image) -> Image:
    """Return the light that comes along rays from far away."""
    glow = 6.0 * np.maximum(ray @ LIGHT, 0.0) ** 40
    return np.stack([0.3 + glow, 0.4 + 0.2 * ray[..., 1] + glow, 0.7 + 0.3 * ray[..., 1] + 0.8 * glow], axis=-1)


def make_frame(number: int, *, size: tuple[int, int] = (HEIGHT, WIDTH), halves: bool = False) -> Frame:
    """Return a frame of the example's sequence, with every image that a pipeline may read."""
    camera, (height, width) = place_camera(number), size
    ray = camera.make_ray_directions(width, height).astype(np.float64)
    eye = np.broadcast_to(camera.position, ray.shape)
    hit = trace(eye, ray, number)
    there = np.isfinite(hit.distance)
    place = eye + np.where(there, hit.distance, 0.0)[..., None] * ray
    normal, alpha, albedos = _describe_surfaces(place, hit.which, there, number)
    mirrored = ray - 2.0 * np.sum(ray * normal, axis=-1, keepdims=True) * normal
    second = trace(place + 1e-3 * normal, mirrored, number)
    light = _shade(normal, mirrored, second, albedos, there)
    emission = np.where(there[..., None], 0.0, np.maximum(shade_sky(ray), 0.0))
    noise = np.random.default_rng(number)
    parts = [_add_noise(each, noise, halves) for each in light]
    guides = GBuffer(
        depth=np.where(there, hit.distance, 0.0),
        position=place,
        normal=normal,
        alpha_u=alpha,
        alpha_v=0.5 * alpha,
        tangent=np.cross(normal, BRUSH),
        # Diffuse surfaces have no lobe; the smoothest are mirrors.
        lobe_kind=np.select([alpha > 0.2, alpha < 0.04], [LobeKind.NONE, LobeKind.DELTA], LobeKind.GGX),
        diffuse_albedo=albedos[0],
        specular_albedo=albedos[1],
        motion=compute_motion(place, ray, hit.which, there, number),
        mean_emission=emission,
        hit_distance=np.where(there, second.distance, 0.0),
        # Reflections show what is some rows away.
        **cover_pixels(albedos),
    )
    first, second_half = (_join(diffuse, specular, emission) for diffuse, specular in zip(*parts, strict=True))
    if not halves:
        return Frame(first, guides, camera, spp=SPP)
    whole = Radiance(**{name: average(getattr(first, name), getattr(second_half, name)) for name in LIGHTS})
    return Frame(whole, guides, camera, spp=SPP, half_a=first, half_b=second_half)


def average(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the mean of two images, as a pipeline computes it."""
    return np.float32(0.5) * first + np.float32(0.5) * second


def cover_pixels(albedos: list[Image]) -> dict[str, Image]:
    """Return shares of pixels that near surfaces cover, and the albedos over pixel areas that follow."""
    height, width, _ = albedos[0].shape
    share = np.random.default_rng(9).uniform(0.0, 0.2, (height, width, 9))
    share[..., 4] += 1.0 - share.sum(axis=-1)
    images = {"coverage": share}
    for name, albedo in zip(("diffuse", "specular"), albedos, strict=True):
        wide = np.pad(albedo, ((1, 1), (1, 1), (0, 0)), mode="edge")
        near = [wide[k // 3 :, k % 3 :][:height, :width] for k in range(9)]
        images[f"mean_{name}_albedo"] = np.sum([share[..., k, None] * near[k] for k in range(9)], axis=0)
    return images


def _describe_surfaces(place: Image, which: Numbers, there: Mask, number: int) -> tuple[Image, Image, list[Image]]:
    """Return normals, roughness, and the albedos of diffuse and specular light."""
    checker = (np.floor(2.0 * place[..., 0]) + np.floor(2.0 * place[..., 2])) % 2.0
    normal = np.where(there[..., None], np.array([0.0, 1.0, 0.0]), 0.0)
    alpha = np.where(there, 0.05 + 0.2 * checker, 0.0)
    diffuse = np.where(checker[..., None] > 0.0, np.array([0.7, 0.6, 0.5]), np.array([0.2, 0.25, 0.3]))
    specular = np.full_like(diffuse, 0.2)
    for k, (centre, radius, rough) in enumerate(place_balls(number)):
        own = which == k
        normal = np.where(own[..., None], (place - centre) / radius, normal)
        alpha = np.where(own, rough, alpha)
        diffuse = np.where(own[..., None], np.array([0.6, 0.1, 0.1]) * (k == 0), diffuse)
        specular = np.where(
            own[..., None], np.array([0.1, 0.1, 0.1]) if k == 0 else np.array([0.9, 0.8, 0.6]), specular
        )
    return normal, alpha, [np.where(there[..., None], each, 0.0) for each in (diffuse, specular)]


def _shade(normal: Image, mirrored: Image, second: Traced, albedos: list[Image], there: Mask) -> list[Image]:
    """Return diffuse and specular light without noise."""
    facing = np.maximum(normal @ LIGHT, 0.0)[..., None]
    seen = np.where(
        np.isfinite(second.distance)[..., None], 0.25 + 0.2 * (second.which[..., None] == 0), shade_sky(mirrored)
    )
    parts = albedos[0] * (0.15 + 1.2 * facing), albedos[1] * np.maximum(seen, 0.0)
    return [np.where(there[..., None], each, 0.0) for each in parts]


def _add_noise(light: Image, noise: np.random.Generator, halves: bool) -> list[Image]:
    """Return light with the noise of all samples, or of each half of them, twice."""
    share = SPP / 2 if halves else float(SPP)
    draws = [noise.gamma(0.8 * share, 1.0 / (0.8 * share), light.shape[:2])[..., None] for _ in range(2)]
    # A few fireflies.
    return [light * each * np.where(noise.random(each.shape) > 0.995, 30.0, 1.0) for each in draws]


def _join(diffuse: Image, specular: Image, emission: Image) -> Radiance:
    parts = [each.astype(np.float32) for each in (diffuse, specular, emission)]
    # Some pixels have no value, as renderers write them: on a ball, where its light fills them, and in the sky.
    color = parts[0] + parts[1] + parts[2]
    for image in (color, parts[0], parts[1]):
        image[20:21, 30:33] = np.nan
        image[4:7, 50:54] = np.nan
    return Radiance(color, diffuse=parts[0], specular=parts[1])


def compute_motion(place: Image, ray: Image, which: Numbers, there: Mask, number: int) -> FloatArray:
    """Return from every pixel to its surface's pixel in the frame before: columns and rows."""
    height, width = which.shape
    before = place_camera(number - 1)
    moved = np.where((which == len(BALLS) - 1)[..., None], BALL_STEP, 0.0)
    old = np.where(there[..., None], place - moved, before.position + 1e6 * ray)
    rows, columns = np.indices(which.shape)
    centres = np.stack([columns, rows], axis=-1) + 0.5
    return np.asarray(project_points(before, old, width, height) - centres, np.float32)
