"""A sequence in closed form: a floor, a still and a moving sphere under a sky, seen by a moving camera."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.records.camera import Camera, compute_motion, project_points
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import SparseFrame

SIZE = (45, 61)
"""Height and width: no multiples of a workgroup."""
STILL, RADIUS = np.array([-0.7, 0.6, -0.4]), 0.6


def make_camera(number: int) -> Camera:
    """Return the camera of a frame."""
    position = np.array([0.3 + 0.05 * number, 1.5 + 0.01 * number, 3.5])
    return Camera(position=position, forward=(-0.05 - 0.004 * number, -0.3, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7)


def locate_ball(number: int) -> NDArray[np.float64]:
    """Return the centre of the moving sphere."""
    return np.array([0.7 - 0.06 * number, 0.6, 0.3])


def trace(
    origin: NDArray[Any], rays: NDArray[Any], ball: NDArray[np.float64]
) -> tuple[NDArray[Any], NDArray[np.int_], NDArray[Any]]:
    """Return the distances (0 for the sky), what a ray shows (0 sky, 1 floor, 2 still, 3 ball), and the normals."""
    best = np.full(SIZE, np.inf)
    shown = np.zeros(SIZE, dtype=int)
    normal = np.zeros((*SIZE, 3))
    with np.errstate(divide="ignore"):
        floor = -origin[..., 1] / rays[..., 1]
    on_floor = (floor > 1e-6) & (floor < 9.0)
    best[on_floor], shown[on_floor], normal[on_floor] = floor[on_floor], 1, (0.0, 1.0, 0.0)
    for number, centre in ((2, STILL), (3, ball)):
        path = origin - centre
        b, c = np.sum(rays * path, axis=-1), np.sum(path * path, axis=-1) - RADIUS**2
        root = b * b - c
        distance = -b - np.sqrt(np.maximum(root, 0.0))
        hit = (root > 0) & (distance > 1e-6) & (distance < best)
        best[hit], shown[hit] = distance[hit], number
        normal[hit] = ((origin + distance[..., None] * rays - centre) / RADIUS)[hit]
    return np.where(np.isfinite(best), best, 0.0), shown, normal


def compute_hits(
    position: NDArray[Any], rays: NDArray[Any], normal: NDArray[Any], ball: NDArray[np.float64]
) -> NDArray[Any]:
    """Return the distance to what a mirror would show at each surface, infinite for the sky."""
    mirrored = rays - 2.0 * np.sum(rays * normal, axis=-1, keepdims=True) * normal
    distance, shown, _ = trace(position, mirrored, ball)
    return np.where(shown > 0, distance, np.inf)


def shade(position: NDArray[Any], shown: NDArray[np.int_]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return noiseless diffuse and specular light over albedo."""
    waves = np.stack([np.sin(2.0 * position[..., 0] + k) * np.cos(1.5 * position[..., 2] - k) for k in range(3)], -1)
    return 1.0 + 0.6 * waves, np.where((shown == 3)[..., None], np.array([2.0, 1.0, 0.3]), 0.7 - 0.5 * waves)


def make_frame(number: int, *, bad: bool = True, noisy: bool = True, hits: bool = False) -> Frame:
    """Return a frame of the sequence, with motion from frame 1 on.

    With ``bad`` some samples are no numbers; with ``hits`` the frame has hit distances.
    """
    camera, ball = make_camera(number), locate_ball(number)
    rays = camera.make_ray_directions(SIZE[1], SIZE[0]).astype(np.float64)
    depth, shown, normal = trace(np.broadcast_to(camera.position, (*SIZE, 3)), rays, ball)
    position = camera.position + depth[..., None] * rays
    there = shown > 0
    tiles = (np.floor(2.0 * position[..., 0]) + np.floor(2.0 * position[..., 2])) % 2 == 0
    alpha = np.choose(shown, [0.0, np.where(tiles, 0.5, 0.12), 0.04, 0.25])
    rng = np.random.default_rng(5 + number)
    diffuse_albedo = np.where(there[..., None], np.array([0.2, 0.22, 0.25]) + 0.3 * tiles[..., None], 0.0)
    # Too dark to show the light of samples.
    diffuse_albedo[shown == 2] = 6e-4
    specular_albedo = np.where(there[..., None], [0.3, 0.5, 0.4], 0.0)
    lights = shade(np.where((shown == 3)[..., None], position - ball, position), shown)
    grain = rng.gamma(2.0, 0.5, (2, *SIZE, 1)) if noisy else np.ones((2, 1, 1, 1))
    diffuse, specular = (
        light * grain[k] * albedo
        for k, (light, albedo) in enumerate(zip(lights, (diffuse_albedo, specular_albedo), strict=True))
    )
    emission = np.where(there[..., None], 0.0, np.array([0.4, 0.6, 1.0]))
    color = diffuse + specular + emission
    if bad:
        diffuse[38:40, 20:23], specular[30, 5] = np.nan, np.nan
        # A pixel of unknown emission, and normals so short that they mean no surface, which scatters no light.
        diffuse[36, 45:47], specular[36, 45:47] = 0.0, 0.0
        color = diffuse + specular + emission
        emission[35, 40], normal[36, 45:47] = np.nan, 0.05 * normal[36, 45:47]
    motion = None
    if number:
        previous = make_camera(number - 1)
        motion = compute_motion(camera, previous, position.astype(np.float32), depth.astype(np.float32))
        earlier = position - (ball - locate_ball(number - 1))
        column, row = np.meshgrid(np.arange(SIZE[1]) + 0.5, np.arange(SIZE[0]) + 0.5)
        own = project_points(previous, earlier.astype(np.float32), SIZE[1], SIZE[0]) - np.stack([column, row], axis=-1)
        motion = np.where((shown == 3)[..., None], own, motion)
    guides = GBuffer(
        depth=depth,
        position=np.where(there[..., None], position, 0.0),
        normal=normal,
        alpha_u=alpha,
        diffuse_albedo=diffuse_albedo,
        specular_albedo=specular_albedo,
        mean_emission=emission,
        motion=motion,
        hit_distance=np.where(there, compute_hits(position, rays, normal, ball), 0.0) if hits else None,
    )
    return Frame(Radiance(color, diffuse=diffuse, specular=specular), guides, camera, spp=4)


def make_clean_image(number: int) -> NDArray[Any]:
    """Return the radiance of a frame without noise."""
    return make_frame(number, bad=False, noisy=False).radiance.color


def make_sparse_frame(number: int, scale: int, place: tuple[int, int], *, hits: bool = False) -> SparseFrame:
    """Return frame ``number`` of which one pixel in every block is shaded."""
    frame = make_frame(number, hits=hits)
    shaded = slice(place[0], None, scale), slice(place[1], None, scale)
    parts = {name: getattr(frame.radiance, name)[shaded] for name in ("color", "diffuse", "specular")}
    return SparseFrame(Radiance(**parts), frame.gbuffer, scale=scale, camera=frame.camera, place=place, spp=4)
