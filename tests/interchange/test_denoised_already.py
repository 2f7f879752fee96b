"""A wrong alarm that an image is denoised already costs more than none: it takes clear evidence."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lobewise.interchange.checks.noise import check_noise
from lobewise.records.frame import Frame, GBuffer, Radiance

WALL = (128, 192)


def list_found(
    light: NDArray[np.float64],
    spp: int | None,
    *,
    albedo: NDArray[np.float64] | float = 0.5,
    facing: NDArray[np.float64] | float = 1.0,
    unscattered: NDArray[np.float64] | None = None,
) -> list[str]:
    """Return what is found of the noise of a wall with this light, (height, width)."""

    def spread(image: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.ones((*light.shape, 3)) * np.asarray(image)[..., None]

    guides = GBuffer(normal=spread(facing) * [0.0, 0.0, 1.0], diffuse_albedo=spread(albedo))
    beside = {} if unscattered is None else {"environment": spread(unscattered)}
    frame = Frame(Radiance(spread(light).clip(0.0)), guides, spp=spp, unscattered=beside)
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


@pytest.mark.parametrize("spp", [None, 4, 16, 64])
@pytest.mark.parametrize("told_by", ["albedo", "facing", "unscattered"])
def test_a_clean_sky_says_nothing_of_the_noise_below(told_by: str, spp: int | None, rng: np.random.Generator) -> None:
    # The sky, or one large lamp, fills all but a strip of noisy ground.
    sky = np.arange(WALL[0])[:, None] < WALL[0] - 14
    light = np.linspace(0.5, 1.0, WALL[0])[:, None] * np.ones(WALL) * (1.0 + ~sky * 0.1 * rng.normal(size=WALL))
    guide = light * sky if told_by == "unscattered" else 0.5 * ~sky
    assert list_found(light, spp, **{told_by: guide * np.ones(WALL)}) == []


def test_a_small_frame_shows_too_little_of_it(rng: np.random.Generator) -> None:
    assert list_found(gaussian_filter(make_product(rng, 0.05), 3.0)[:48, :48], 16) == []
