"""Pictures of guides: each value has one shade, and what is missing is grey."""

import numpy as np
import pytest

from lobewise.display.guides import paint_guide, paint_light


def test_normals_go_from_black_to_white_by_channel() -> None:
    image = np.array([[[1.0, 0.0, -1.0]]], np.float32)
    np.testing.assert_array_equal(paint_guide("normal", image), [[[255, 128, 0]]])


def test_depths_keep_their_order() -> None:
    image = np.linspace(1.0, 9.0, 50, dtype=np.float32)[None]
    row = paint_guide("depth", image)[0, :, 0].astype(int)
    assert (np.diff(row) >= 0).all()
    assert row[0] < 40
    assert row[-1] == 255


def test_motion_is_grey_where_nothing_moves() -> None:
    image = np.zeros((4, 4, 2), np.float32)
    image[0, 0] = 3.0, -3.0
    picture = paint_guide("motion", image)
    assert (picture[1:] == 128).all()
    np.testing.assert_array_equal(picture[0, 0], [255, 0, 128])
    assert np.ptp(paint_guide("motion", image * 1e-6).astype(int)) <= 1


@pytest.mark.parametrize("name", ["depth", "normal", "diffuse_albedo", "motion", "position"])
def test_values_that_are_not_finite_are_grey(name: str) -> None:
    shape = (3, 3) if name == "depth" else (3, 3, 2 if name == "motion" else 3)
    image = np.full(shape, 0.25, np.float32)
    image[1, 1] = np.nan
    picture = paint_guide(name, image)
    assert picture.shape == (3, 3, 3)
    assert (picture[1, 1] == 128).all()


def test_coverage_shows_the_pixel_itself() -> None:
    image = np.zeros((1, 2, 9), np.float32)
    image[0, 1, 4] = 1.0
    assert paint_guide("coverage", image)[0, :, 0].tolist() == [0, 255]


def test_light_without_a_finite_pixel_is_black() -> None:
    assert not paint_light(np.full((2, 2, 3), np.inf, np.float32)).any()
