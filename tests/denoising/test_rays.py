"""Frames whose samples know their rays: constant light stays, mirrors get sharper, and bad rays are refused."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.guides.rays import compute_ray_weights
from lobewise.recipes.temporal import TemporalFilter
from lobewise.recipes.upsampling import upsample
from lobewise.records.camera import Camera
from lobewise.records.frame import GBuffer, Radiance
from lobewise.records.sparse_frame import Rays, SparseFrame, list_places
from tests.mistakes import refuses

SIZE, SCALE, ALPHA = 64, 4, 0.03
CAMERA = Camera(position=(0.0, 0.0, 4.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.6)
Array = NDArray[np.float64]


def make_guides() -> GBuffer:
    """Return a mirror that is bent in waves."""
    y, x = (np.indices((SIZE, SIZE)) + 0.5) / SIZE
    normal = np.stack([0.1 * np.sin(9.0 * x), 0.1 * np.cos(7.0 * y), np.ones((SIZE, SIZE))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    white = np.ones((SIZE, SIZE, 3))
    return GBuffer(
        depth=np.full((SIZE, SIZE), 4.0),
        normal=normal,
        alpha_u=np.full((SIZE, SIZE), ALPHA),
        lobe_kind=np.ones((SIZE, SIZE)),
        diffuse_albedo=0.5 * white,
        specular_albedo=white,
        motion=np.zeros((SIZE, SIZE, 2)),
    )


def compute_view() -> Array:
    """Return unit vectors towards the camera."""
    half = np.tan(0.3)
    y, x = (np.indices((SIZE, SIZE)) + 0.5) / SIZE * 2.0 - 1.0
    ray = np.stack([half * x, -half * y, -np.ones((SIZE, SIZE))], axis=-1)
    return np.asarray(-ray / np.linalg.norm(ray, axis=-1, keepdims=True))


def sample_rays(normal: Array, view: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return directions sampled by ``D cos`` of GGX, and weights ``f cos / p`` without masking."""
    first, second = rng.random((2, *normal.shape[:-1]))
    slope, phi = ALPHA * np.sqrt(first / (1.0 - first)), 2.0 * np.pi * second
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    up = np.cross(normal, across)
    half = normal + slope[..., None] * (np.cos(phi)[..., None] * across + np.sin(phi)[..., None] * up)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cosine = (half * view).sum(axis=-1)
    direction = 2.0 * cosine[..., None] * half - view
    weight = cosine / ((normal * view).sum(axis=-1) * (half * normal).sum(axis=-1))
    return direction, np.where((direction * normal).sum(axis=-1) > 0.0, weight, 0.0)


def compute_light(direction: Array) -> Array:
    """Return the radiance of surroundings with soft stripes."""
    return np.asarray(1.0 + 0.9 * np.sin(10.0 * direction[..., :1])) * np.ones(3)


def make_frames(count: int, *, constant: bool = False) -> list[SparseFrame]:
    """Return frames of one ray per shaded pixel; a third of the rays is lost to another lobe."""
    guides, view, frames = make_guides(), compute_view(), []
    rng = np.random.default_rng(1)
    for place in list_places(SCALE)[:count]:
        shaded = slice(place[0], None, SCALE), slice(place[1], None, SCALE)
        direction, weight = sample_rays(guides.normal[shaded], view[shaded], rng)
        weight *= 1.5 * (rng.random(weight.shape) < 2.0 / 3.0)
        arriving = np.full((*weight.shape, 3), 0.7) if constant else compute_light(direction)
        light = arriving * weight[..., None]
        radiance = Radiance(light, diffuse=np.zeros_like(light), specular=light)
        frames.append(SparseFrame(radiance, guides, SCALE, place, CAMERA, spp=1, rays=Rays(weight)))
    return frames


def compute_truth() -> Array:
    """Return the light of the mirror by many rays at every pixel."""
    guides, view, rng = make_guides(), compute_view(), np.random.default_rng(2)
    total, weights = np.zeros((SIZE, SIZE, 3)), np.zeros((SIZE, SIZE, 1))
    for _ in range(256):
        direction, weight = sample_rays(np.asarray(guides.normal, np.float64), view, rng)
        total += weight[..., None] * compute_light(direction)
        weights += weight[..., None]
    return total / weights


def filter_all(frames: list[SparseFrame]) -> Any:
    temporal = TemporalFilter()
    return [temporal.add(frame) for frame in frames][-1]


FILTERS: dict[int, Callable[[list[SparseFrame]], Any]] = {1: lambda frames: upsample(frames[0]), 8: filter_all}
"""What filters a number of frames."""


def forget(frames: list[SparseFrame]) -> list[SparseFrame]:
    return [replace(frame, rays=None) for frame in frames]


@pytest.mark.parametrize("count", [1, 8])
def test_constant_light_comes_out_exactly(count: int) -> None:
    frames, run = make_frames(count, constant=True), FILTERS[count]
    assert np.allclose(run(frames).specular, 0.7, rtol=1e-4)
    assert not np.allclose(run(forget(frames)).specular, 0.7, rtol=1e-2)


@pytest.mark.sampled("1")
@pytest.mark.parametrize("count", [1, 8])
def test_mirror_gets_sharper(count: int) -> None:
    truth, frames, run = compute_truth(), make_frames(count), FILTERS[count]
    weighed, without = (np.mean((run(given).specular - truth) ** 2) for given in (frames, forget(frames)))
    assert weighed < 0.95 * without


@pytest.mark.parametrize(
    ("weight", "got"),
    [
        (np.ones((4, 4, 3)), "shape (4, 4, 3)"),
        (-np.ones((4, 4)), "others"),
        (np.full((4, 4), np.nan), "others"),
    ],
)
def test_bad_rays_are_refused(weight: Array, got: str) -> None:
    with refuses(InputError, "rays", got):
        Rays(weight)


def test_rays_must_fit_their_frame() -> None:
    frame = make_frames(1)[0]
    few = Rays(np.ones((3, 3)))
    with refuses(InputError, "rays", "Rays(3x3)", "16x16 rays, and radiance in diffuse and specular parts"):
        SparseFrame(frame.radiance, frame.gbuffer, SCALE, frame.place, CAMERA, rays=few)
    with refuses(InputError, "rays", "no specular radiance"):
        SparseFrame(Radiance(frame.radiance.color), frame.gbuffer, SCALE, frame.place, CAMERA, rays=frame.rays)


def test_weights_count_where_a_surface_has_a_diffuse_lobe() -> None:
    frame = make_frames(1)[0]
    albedo = np.full((SIZE, SIZE, 3), 0.5)
    albedo[: SIZE // 2] = 0.0
    half = replace(frame, gbuffer=replace(frame.gbuffer, diffuse_albedo=albedo))
    weights = compute_ray_weights(half)
    rows = SIZE // SCALE // 2
    assert np.array_equal(weights[:rows], np.ones_like(weights[:rows]))
    assert np.array_equal(weights[rows:], frame.rays.weight[rows:])
    untold = compute_ray_weights(replace(frame, gbuffer=replace(frame.gbuffer, diffuse_albedo=None)))
    assert np.array_equal(untold, frame.rays.weight)
