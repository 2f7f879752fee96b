"""Work in pieces is the work of the whole."""

import numpy as np
import pytest

from lobewise.work.chunks import Chunk, run_chunks


@pytest.mark.parametrize("shape", [(1, 1), (3, 40000), (257, 129)])
def test_every_pixel_is_worked_on_once(shape: tuple[int, int]) -> None:
    image = np.zeros(shape)

    def work(chunk: Chunk) -> None:
        image[chunk] += 1.0

    run_chunks(work, *shape)
    np.testing.assert_array_equal(image, 1.0)


def test_what_goes_wrong_in_a_piece_is_told() -> None:
    def work(chunk: Chunk) -> None:
        if chunk[0].start > 0:
            raise ValueError("here")

    with pytest.raises(ValueError, match="here"):
        run_chunks(work, 300, 300)
