"""Sparsely shaded frames on disk."""

from dataclasses import fields

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.interchange import read_image
from lobewise.io import read_frame, read_sparse_frame, write_frame, write_sparse_frame
from lobewise.records.frame import GBuffer, Radiance
from lobewise.records.sparse_frame import make_sparse
from tests.mistakes import refuses


@pytest.fixture
def sparse(full_frame):
    return make_sparse(full_frame, 4, (1, 3))


def test_round_trip_is_exact(sparse, tmp_path):
    write_sparse_frame(tmp_path / "s.exr", sparse, half=False)
    again = read_sparse_frame(tmp_path / "s.exr")
    assert (again.scale, again.place, again.spp) == (4, (1, 3), sparse.spp)
    for name in Radiance.__dataclass_fields__:
        for part in ("radiance", "variance"):
            np.testing.assert_array_equal(getattr(getattr(again, part), name), getattr(getattr(sparse, part), name))
    for item in fields(GBuffer):
        np.testing.assert_array_equal(getattr(again.gbuffer, item.name), getattr(sparse.gbuffer, item.name))
    np.testing.assert_allclose(again.camera.position, sparse.camera.position)
    assert len(again.lobe_tables) == len(sparse.lobe_tables)


def test_pixels_that_were_not_shaded_are_black(sparse, tmp_path):
    write_sparse_frame(tmp_path / "s.exr", sparse, half=False)
    image = read_image(tmp_path / "s.exr")
    np.testing.assert_array_equal(image[sparse.shaded], sparse.radiance.color)
    image[sparse.shaded] = 0.0
    assert not image.any()


def test_it_is_no_whole_frame(sparse, tmp_path):
    write_sparse_frame(tmp_path / "s.exr", sparse)
    with refuses(InputError, "input 's.exr'"):
        read_frame(tmp_path / "s.exr")


def test_any_frame_can_be_thinned(full_frame, tmp_path):
    write_frame(tmp_path / "f.exr", full_frame, half=False)
    with refuses(InputError, "input 'f.exr'", "no such attribute"):
        read_sparse_frame(tmp_path / "f.exr")
    thin = read_sparse_frame(tmp_path / "f.exr", scale=3, place=(2, 0))
    np.testing.assert_array_equal(thin.radiance.color, full_frame.radiance.color[2::3, 0::3])
    with refuses(InputError, "place", "(3, 0)", "row and column from 0 to 2", holder="input 'f.exr'"):
        read_sparse_frame(tmp_path / "f.exr", scale=3, place=(3, 0))


@pytest.mark.parametrize(
    ("text", "got"),
    [
        *((text, repr(text.encode())) for text in ("", "4", "4 1 x", "4 1 2 3", "-4 0 0")),
        ("4 9 9", "(9, 9)"),
        ("0 0 0", "0"),
    ],
)
def test_senseless_headers(full_frame, tmp_path, text, got):
    write_frame(tmp_path / "f.exr", full_frame, attributes={"lobewise/sparse": text})
    with refuses(InputError, got=got):
        read_sparse_frame(tmp_path / "f.exr")


@pytest.mark.parametrize(("scale", "place"), [(2, (1, 1)), (4, (0, 0)), (6, (1, 3))])
def test_pixels_that_were_not_shaded_are_refused(scale, place, sparse, tmp_path):
    write_sparse_frame(tmp_path / "s.exr", sparse)
    with pytest.raises(InputError, match=r"every 4 from row 1, column 3 on, got every"):
        read_sparse_frame(tmp_path / "s.exr", scale=scale, place=place)
    assert read_sparse_frame(tmp_path / "s.exr", scale=8, place=(5, 3)).place == (5, 3)
