"""The resting picture of the chain against Mitsuba's own integrators, for scenes of every kind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lobewise.interactive import InteractiveSettings, Session
from tests.render.any_scene import SCENES, load

pytestmark = [pytest.mark.mitsuba, pytest.mark.slow]

PLAIN = InteractiveSettings(similarity="none", scale=1, adaptive=0.0, temporal=False, spp=4)
"""Nothing is filtered, so that the resting picture is the mean of each pixel's own samples."""
FRAMES = 64
BLOCK = 8
"""Width of the blocks whose means are compared, pixels."""
BLOCK_NOISE = 0.08
"""Largest difference of a block, relative to it and to a tenth of the image's mean: four times its noise."""
MEAN_NOISE = 0.02
"""Largest relative difference of the whole image: four times its noise."""


def sample_reference(mi: Any, scene: Any, spp: int = 1024) -> np.ndarray:
    """Return the light of the scene's integrator along rays through the centres of pixels, (height, width, 3)."""
    import drjit as dr

    sensor = scene.sensors()[0]
    width, height = (int(length) for length in sensor.film().crop_size())
    count = width * height * spp
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    pixel = dr.arange(mi.UInt32, count) % (width * height)
    place = mi.Point2f((mi.Float(pixel % width) + 0.5) / width, (mi.Float(pixel // width) + 0.5) / height)
    aperture = sampler.next_2d() if sensor.class_name() == "ThinLensCamera" else mi.Point2f(0.5)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, place, aperture)
    light = scene.integrator().sample(scene, sampler, ray, sensor.get_medium())[0]
    return np.array(light).T.reshape(spp, height, width, 3).mean(axis=0)


def check_picture(image: np.ndarray, reference: np.ndarray) -> None:
    """Compare the means of blocks, and of the image."""
    assert np.isfinite(image).all()
    mean = reference.mean()
    blocks = [
        picture.reshape(picture.shape[0] // BLOCK, BLOCK, -1, BLOCK, 3).mean(axis=(1, 3, 4))
        for picture in (image, reference)
    ]
    difference = np.abs(blocks[0] - blocks[1]) / (blocks[1] + 0.1 * mean)
    assert difference.max() < BLOCK_NOISE, difference.round(3)
    assert abs(image.mean() / mean - 1.0) < MEAN_NOISE


@pytest.mark.parametrize("name", SCENES)
def test_a_resting_picture_is_what_mitsuba_renders(mi: Any, name: str) -> None:
    scene = load(name)
    session = Session(scene, settings=PLAIN)
    for _ in range(FRAMES):
        frame = session.render()
    check_picture(frame.image, sample_reference(mi, scene))
