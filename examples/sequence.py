"""An engine of your own, and a history: shade one of sixteen pixels a frame, show all of them.

The engine here is a few lines of NumPy: a lacquered floor that reflects a striped wall, seen by a camera that moves.
Guides are cheap and made for every pixel; shading is dear (and noisy), and done for one pixel of every 4x4, another one
in each frame. What the engine hands over are arrays; what comes back is a whole image for every frame.

    python examples/sequence.py
"""

from __future__ import annotations

import numpy as np

import lobewise
from lobewise.metrics import rel_mse
from lobewise.records.sparse_frame import list_places

SCALE = 4
NOISE = 0.1
"""Relative variance of what is shaded."""
WALL = -9.0
"""z of the wall that is reflected; the floor is y = 0."""


def trace(camera: lobewise.Camera, width: int, height: int) -> dict[str, np.ndarray]:
    """Return what a pixel's ray hits on the floor, and what its mirror ray hits on the wall."""
    rays = camera.make_ray_directions(width, height).astype(float)
    depth = -camera.position[1] / rays[..., 1]
    position = camera.position + depth[..., None] * rays
    mirrored = rays * (1.0, -1.0, 1.0)
    hit_distance = (WALL - position[..., 2]) / mirrored[..., 2]
    alpha = np.where(np.floor(2 * position[..., 0]) % 2 == 0, 0.03, 0.25)  # polished and worn boards
    return {
        "depth": depth,
        "position": position,
        "hit_distance": hit_distance,
        "hit": position + hit_distance[..., None] * mirrored,
        "alpha": alpha,
    }


def shade(scene: dict[str, np.ndarray], rng: np.random.Generator | None) -> np.ndarray:
    """Return the reflected light: stripes, washed out as far as the floor is rough. With ``rng`` it is noisy."""
    blur = scene["alpha"] * scene["hit_distance"]
    contrast = np.exp(-0.5 * (2.0 * blur) ** 2)
    stripes = 1.0 + 0.9 * contrast * np.sin(2.0 * scene["hit"][..., 0])
    color = stripes[..., None] * (0.9, 0.6, 0.3)
    return color if rng is None else color * rng.gamma(1.0 / NOISE, NOISE, (*stripes.shape, 1))


def main(frames: int = 24, width: int = 192, height: int = 128) -> dict[str, float]:
    """Return the error of the last frame without and with a history."""
    rng = np.random.default_rng(1)
    temporal = lobewise.TemporalFilter()
    places = list_places(SCALE)
    for number in range(frames):
        camera = lobewise.Camera((0.02 * number, 1.2, 3.0), (0.0, -0.5, -1.0), (0.0, 1.0, 0.0), fov_y=0.6)
        scene = trace(camera, width, height)
        guides = lobewise.GBuffer(
            depth=scene["depth"],
            position=scene["position"],
            normal=np.broadcast_to((0.0, 1.0, 0.0), (height, width, 3)),
            alpha_u=scene["alpha"],
            hit_distance=scene["hit_distance"],
        )
        place = places[number % len(places)]
        shaded = {name: values[place[0] :: SCALE, place[1] :: SCALE] for name, values in scene.items()}
        radiance = shade(shaded, rng)
        frame = lobewise.SparseFrame(
            lobewise.Radiance(radiance, diffuse=np.zeros_like(radiance), specular=radiance),
            guides,
            SCALE,
            place,
            camera,
            variance=lobewise.Radiance(NOISE * radiance**2),
        )
        result = temporal.add(frame)
    truth = shade(scene, None)
    return {
        "alone": rel_mse(lobewise.upsample(frame).image, truth),
        "with its history": rel_mse(result.image, truth),
    }


if __name__ == "__main__":
    for what, error in main().items():
        print(f"{what:>18}: rel_mse {error:.4f}")
