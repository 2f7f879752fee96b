"""Work in pieces is the work of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from lobewise import chunks


@pytest.mark.parametrize("shape", [(1, 1), (3, 40000), (257, 129)])
def test_mapping_pieces_is_mapping_the_whole(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    image, factor = rng.random((*shape, 3)).astype(np.float32), rng.random(shape)

    def work(image: np.ndarray, factor: np.ndarray) -> np.ndarray:
        return image[..., :2] * factor[..., None]

    whole = chunks.map_chunks(work, image, factor)
    np.testing.assert_array_equal(whole, work(image, factor))
    assert whole.dtype == np.float64


def test_several_results_come_back_as_several() -> None:
    image = np.random.default_rng(2).random((200, 300))
    doubled, flags = chunks.map_chunks(lambda each: (2.0 * each, each > 0.5), image)
    np.testing.assert_array_equal(doubled, 2.0 * image)
    np.testing.assert_array_equal(flags, image > 0.5)


def test_what_goes_wrong_in_a_piece_is_told() -> None:
    def work(image: np.ndarray) -> np.ndarray:
        if image.size > 1:
            raise ValueError("here")
        return image

    with pytest.raises(ValueError, match="here"):
        chunks.map_chunks(work, np.zeros((300, 300)))
