"""A wrong alarm that an image is denoised already costs more than none: it takes clear evidence."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lobewise.frame import Frame, GBuffer, Radiance
from lobewise.interchange.checks.noise import check_noise

WALL = (128, 192)


def list_found(light: NDArray[np.float64], spp: int | None) -> list[str]:
    """Return what is found of the noise of a wall with this light, (height, width)."""
    normal = np.broadcast_to([0.0, 0.0, 1.0], (*light.shape, 3))
    guides = GBuffer(normal=normal, diffuse_albedo=np.full((*light.shape, 3), 0.5))
    frame = Frame(Radiance(np.repeat(light[..., None], 3, axis=-1).clip(0.0)), guides, spp=spp)
    return [one.what for one in check_noise(frame, has_normals=True)[1]]


def make_product(rng: np.random.Generator, noise: float) -> NDArray[np.float64]:
    """Return a backdrop that one large lamp lights almost without noise; a quarter shows a thing with reflections."""
    light = np.linspace(0.5, 1.0, WALL[1]) * np.ones((WALL[0], 1))
    deviation = np.full(WALL, 0.0003)
    deviation[:, 144:] = noise
    return light * (1.0 + deviation * rng.normal(size=WALL))


@pytest.mark.parametrize("spp", [None, 4, 16, 64])
def test_a_backdrop_without_noise_is_no_denoised_image(spp: int | None, rng: np.random.Generator) -> None:
    assert list_found(make_product(rng, 0.2 / np.sqrt(spp or 16)), spp) == []


@pytest.mark.parametrize("spp", [None, 16, 64])
def test_such_a_frame_is_none_through_a_wide_pixel_filter_either(spp: int | None, rng: np.random.Generator) -> None:
    light = gaussian_filter(make_product(rng, 0.6 / np.sqrt(spp or 16)), 0.8)
    assert "denoised already" not in list_found(light, spp)


@pytest.mark.parametrize("spp", [None, 4, 16, 64])
def test_a_filtered_frame_is_told(spp: int | None, rng: np.random.Generator) -> None:
    light = gaussian_filter(make_product(rng, 0.2 / np.sqrt(spp or 16)), 3.0)
    assert list_found(light, spp) == ["denoised already"]


def test_a_small_frame_shows_too_little_of_it(rng: np.random.Generator) -> None:
    assert list_found(gaussian_filter(make_product(rng, 0.05), 3.0)[:48, :48], 16) == []
