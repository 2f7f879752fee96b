"""Small scenes in closed form: a shiny floor under a pattern of light, and a card that is moved over it."""

import numpy as np

from lobewise.records.camera import Camera, compute_motion, project_points
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

SIZE = (48, 64)
CARD_HEIGHT = 0.6
"""Of the card over the floor, world units; the camera is about 3 away."""


def make_camera(turn: float = 0.0, shift: float = 0.0) -> Camera:
    """Return a camera that looks down at the floor y = 0, turned about the vertical and moved sideways."""
    position = np.array([shift, 2.0, 2.5])
    forward = np.array([np.sin(turn), -0.75, -np.cos(turn)])
    return Camera(position=position, forward=forward, up=(0.0, 1.0, 0.0), fov_y=0.7)


def make_light(point: FloatArray) -> FloatArray:
    """Return what arrives at points of the floor, (height, width, 3), > 0."""
    waves = np.stack([np.sin(1.2 * point[..., 0] + k) * np.cos(0.8 * point[..., 2] - k) for k in range(3)], axis=-1)
    return (1.0 + 0.5 * waves).astype(np.float32)


def make_frame(
    camera: Camera,
    previous: Camera | None = None,
    *,
    card: float | None = None,
    card_before: float | None = None,
    light: float = 1.0,
    noise: float = 0.0,
    seed: int = 0,
    apart: bool = True,
    motion: bool = True,
) -> Frame:
    """Return the floor, with a card whose centre is at x = ``card``, seen by ``camera``.

    With ``noise`` every sample is multiplied by a gamma variate of that relative variance, which the frame knows.
    """
    height, width = SIZE
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    floor = -camera.position[1] / rays[..., 1]
    position = camera.position + floor[..., None] * rays
    on_card = np.zeros(SIZE, dtype=bool)
    if card is not None:
        distance = (CARD_HEIGHT - camera.position[1]) / rays[..., 1]
        above = camera.position + distance[..., None] * rays
        on_card = (np.abs(above[..., 0] - card) < 0.3) & (np.abs(above[..., 2]) < 0.4)
        position = np.where(on_card[..., None], above, position)
    depth = np.linalg.norm(position - camera.position, axis=-1)
    rough = (np.floor(2.0 * position[..., 0]) + np.floor(2.0 * position[..., 2])) % 2 == 0
    alpha = np.where(on_card, 0.5, np.where(rough, 0.4, 0.15))
    before = None
    if previous is not None and motion:
        before = compute_motion(camera, previous, position.astype(np.float32), depth.astype(np.float32))
        if card is not None and card_before is not None:
            moved = position - np.array([card - card_before, 0.0, 0.0])
            column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
            own = project_points(previous, moved.astype(np.float32), width, height) - np.stack([column, row], axis=-1)
            before = np.where(on_card[..., None], own, before)
    radiance = light * make_light(position)
    radiance = np.where(on_card[..., None], np.float32([0.2, 0.3, 2.0]), radiance)
    rng = np.random.default_rng(seed)
    grain = rng.gamma(1.0 / noise, noise, (2, *SIZE, 1)) if noise else np.ones((2, *SIZE, 1))
    diffuse, specular = 0.4 * radiance * grain[0], 0.6 * radiance * grain[1]
    albedos = np.broadcast_to(np.float32(0.4), (*SIZE, 3)), np.broadcast_to(np.float32(0.6), (*SIZE, 3))
    guides = GBuffer(
        depth=depth,
        position=position,
        normal=np.broadcast_to(np.array([0.0, 1.0, 0.0]), (*SIZE, 3)),
        alpha_u=alpha,
        diffuse_albedo=albedos[0],
        specular_albedo=albedos[1],
        motion=before,
    )
    variance = [noise * part**2 for part in (diffuse, specular)]
    return Frame(
        Radiance(diffuse + specular, diffuse=diffuse if apart else None, specular=specular if apart else None),
        guides,
        camera,
        variance=Radiance(variance[0] + variance[1], diffuse=variance[0], specular=variance[1]),
        spp=4,
    )
