"""Shares of a pixel from Cryptomatte's ranks, on silhouettes that are drawn by area."""

import numpy as np

from lobewise.errors import InputError
from lobewise.interchange.silhouettes import compute_coverage
from tests.mistakes import refuses

SIZE, FINE = 24, 16
RED, BLUE = 0x3F8A1C01, 0x3E11FF07


def draw(*inside: tuple[int, np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return ids and shares in ranks, the largest share first, of objects given by where they are on a finer grid."""
    shares = {name: mask.reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3)) for name, mask in inside}
    names = np.array(list(shares), np.uint32)
    planes = np.stack([share.astype(np.float32) for share in shares.values()])
    order = np.argsort(-planes, axis=0, kind="stable")
    ranked = np.take_along_axis(planes, order, axis=0)
    ids = np.where(ranked > 0.0, names[order], np.uint32(0))
    return list(ids), list(ranked)


def make_grid() -> tuple[np.ndarray, np.ndarray]:
    """Return the x and y of every point of the finer grid, pixels."""
    steps = (np.arange(SIZE * FINE) + 0.5) / FINE
    return np.meshgrid(steps, steps)


def test_an_edge_is_shared_with_the_pixels_on_its_other_side() -> None:
    x, _ = make_grid()
    left = x < 10.25
    coverage = compute_coverage(*draw((RED, left), (BLUE, ~left)))
    assert coverage.shape == (SIZE, SIZE, 9)
    # Column 10 shows a quarter of what column 9 shows wholly, and is blue itself.
    np.testing.assert_allclose(coverage[5, 10, [3, 4]], [0.25, 0.75], atol=1e-6)
    np.testing.assert_array_equal(coverage[5, 9], np.eye(9, dtype=np.float32)[4])
    np.testing.assert_array_equal(coverage[5, 11], np.eye(9, dtype=np.float32)[4])


def test_shares_of_a_disc_composite_to_its_area() -> None:
    x, y = make_grid()
    inside = np.hypot(x - 11.3, y - 12.6) < 7.4
    ids, shares = draw((RED, inside))
    coverage = compute_coverage(ids, shares)
    np.testing.assert_allclose(coverage.sum(axis=-1), 1.0, atol=1e-5)
    area = shares[0]
    owned = (area > 0.5).astype(np.float32)
    padded = np.pad(owned, 1)
    around = np.stack([padded[dy : dy + SIZE, dx : dx + SIZE] for dy in range(3) for dx in range(3)], axis=-1)
    # What is composited from whole pixels is the area within each; the few that no neighbour stands for stay whole.
    shown = (coverage * around).sum(axis=-1)
    assert np.abs(shown - area).mean() < 0.1 * np.abs(owned - area).mean()


def test_what_no_neighbour_stands_for_stays_with_the_pixel() -> None:
    x, y = make_grid()
    speck = (np.abs(x - 5.5) < 0.2) & (np.abs(y - 5.5) < 0.2)
    coverage = compute_coverage(*draw((RED, ~speck), (BLUE, speck)))
    np.testing.assert_allclose(coverage[5, 5], np.eye(9)[4], atol=1e-6)


def test_the_background_is_an_object_too() -> None:
    x, _ = make_grid()
    coverage = compute_coverage(*draw((RED, x < 10.75)))
    np.testing.assert_allclose(coverage[3, 10, [4, 5]], [0.75, 0.25], atol=1e-6)


def test_ranks_that_are_no_shares_do_no_harm() -> None:
    x, _ = make_grid()
    left = x < 10.25
    ids, shares = draw((RED, left), (BLUE, ~left))
    shares[0][2, 2], shares[0][3, 3], shares[1][4, 4] = np.nan, np.inf, -1.0
    coverage = compute_coverage(ids, shares)
    assert np.isfinite(coverage).all()
    assert (coverage >= 0.0).all()
    np.testing.assert_allclose(coverage.sum(axis=-1), 1.0, atol=1e-5)


def test_planes_must_fit() -> None:
    plane = np.zeros((4, 5), np.uint32)
    with refuses(InputError, "Cryptomatte", "1 ids and 1 shares of the shapes [(4, 5), (5, 4)]"):
        compute_coverage([plane], [np.zeros((5, 4), np.float32)])
    with refuses(InputError, "Cryptomatte", "2 ids and 1 shares of the shapes [(4, 5)]"):
        compute_coverage([plane, plane], [np.zeros((4, 5), np.float32)])
    with refuses(InputError, "Cryptomatte", "0 ids and 0 shares of the shapes []"):
        compute_coverage([], [])
