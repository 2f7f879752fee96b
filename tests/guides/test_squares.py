"""Sums, means and maxima over squares against the pixels of each square."""

import numpy as np
import pytest

from lobewise.guides.squares import average_square, compute_square_maximum, count_neighbours, sum_square


@pytest.mark.parametrize("radius", [1, 3, 9])
@pytest.mark.parametrize("shape", [(7, 11), (1, 5), (12, 1)])
def test_squares_are_those_of_the_pixels(radius: int, shape: tuple[int, int]) -> None:
    image = np.random.default_rng(radius).normal(-2.0, 1.0, shape).astype(np.float32)
    mask = image > -2.0
    found = [measure(image, radius) for measure in (compute_square_maximum, sum_square, average_square)]
    count = count_neighbours(mask, radius)
    for y, x in np.ndindex(*shape):
        square = slice(max(y - radius, 0), y + radius + 1), slice(max(x - radius, 0), x + radius + 1)
        near = image[square].astype(np.float64)
        expected = near.max(), near.sum(), near.mean()
        np.testing.assert_allclose([each[y, x] for each in found], expected, rtol=1e-5)
        assert count[y, x] == mask[square].sum() - mask[y, x]
