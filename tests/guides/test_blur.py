"""The radius that a lens blurs over, from where positions are seen: discs, edges of things in focus, bent cameras."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.interchange.importing.blur import estimate_blur_radius

SIZE = (48, 64)


def spread(radius: float) -> NDArray[np.float32]:
    """Return offsets that fill a disc evenly."""
    rng = np.random.default_rng(4)
    away, turn = radius * np.sqrt(rng.random(SIZE)), rng.uniform(0.0, 2.0 * np.pi, SIZE)
    return np.stack([away * np.cos(turn), away * np.sin(turn)], axis=-1).astype(np.float32)


@pytest.mark.parametrize("radius", [3.0, 40.0])
def test_the_radius_of_a_disc_is_found(radius: float) -> None:
    found = estimate_blur_radius(spread(radius))
    assert np.median(found) == pytest.approx(radius, rel=0.1)
    assert np.quantile(found, 0.02) > 0.5 * radius


def test_a_thing_in_focus_stays_sharp_up_to_its_edge() -> None:
    offset = spread(8.0)
    offset[:, :30] = 0.0
    found = estimate_blur_radius(offset)
    assert (found[:, :30] == 0.0).all()
    assert np.median(found[:, 31:]) > 6.0


def test_pixels_without_a_position_are_left_out() -> None:
    offset = spread(8.0)
    offset[np.random.default_rng(5).random(SIZE) < 0.4] = np.nan
    offset[:, :20] = np.nan
    found = estimate_blur_radius(offset)
    assert np.isnan(found[:, :14]).all()
    assert np.median(found[:, 22:]) == pytest.approx(8.0, rel=0.2)


def test_a_lamp_before_the_sky_is_blurred_though_few_samples_meet_it() -> None:
    offset = spread(8.0)
    offset[np.random.default_rng(5).random(SIZE) < 0.95] = np.nan
    found = estimate_blur_radius(offset)
    assert np.nanmedian(found) == pytest.approx(8.0, rel=0.25)
    assert np.isfinite(found).mean() > 0.9


def test_a_camera_that_is_off_is_no_blur() -> None:
    """Neighbours that lie off alike, as through a lens that bends lines, and rays anywhere within the pixel."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    bent = np.stack([0.4 * x + 5.0, -0.3 * y], axis=-1).astype(np.float32)
    assert estimate_blur_radius(bent) is None
    offset = bent + np.random.default_rng(6).uniform(-0.5, 0.5, (*SIZE, 2)).astype(np.float32)
    found = estimate_blur_radius(offset)
    assert found.max() < 1.5
