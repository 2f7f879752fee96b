"""Fit the polynomials of ``lobewise.backend.expressions``: run it, compare with what stands there.

Lawson's algorithm (iteratively reweighted least squares) converges to the minimax polynomial. The exponential's values
at both ends are left free. The logarithm's are fixed: with a step at every power of two, where the logarithm of what is
all but 1 is taken all the time, rounding would decide on which side of it a weight falls.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def fit_minimax(
    function: Callable[[Array], Array], low: float, high: float, degree: int, *, relative: bool, rooted: bool = False
) -> tuple[Array, float]:
    """Return the coefficients (highest power first) and the largest error of the minimax fit on [low, high].

    A ``rooted`` one is 0 at both ends.
    """
    x = 0.5 * (high + low) + 0.5 * (high - low) * np.cos(np.linspace(0.0, np.pi, 4001))
    y = function(x)
    scale = 1.0 / np.abs(y) if relative else np.ones_like(x)
    ends = np.poly([low, high]) if rooted else np.ones(1)
    basis = np.vander(x, degree + 2 - len(ends)) * np.polyval(ends, x)[:, None]
    weight = np.ones_like(x)
    best: tuple[Array, float] | None = None
    for _ in range(400):
        root = np.sqrt(weight) * scale
        coefficients = np.linalg.lstsq(basis * root[:, None], y * root, rcond=None)[0]
        error = np.abs((basis @ coefficients - y) * scale)
        if best is None or error.max() < best[1]:
            best = np.polymul(coefficients, ends), float(error.max())
        weight *= error / error.max()
        weight /= weight.sum()
    assert best is not None
    return best


def _compute_bend(m: Array) -> Array:
    """Return by how much the logarithm of a mantissa is above the straight line."""
    return np.log2(m) - (m - 1.0)


def main() -> None:
    """Print both fits."""
    for name, fit in (
        ("EXP2_COEFFICIENTS", fit_minimax(np.exp2, 0.0, 1.0, 4, relative=True)),
        ("LOG2_COEFFICIENTS", fit_minimax(_compute_bend, 1.0, 2.0, 4, relative=False, rooted=True)),
    ):
        print(f"{name} = {tuple(float(f'{c:.9g}') for c in fit[0])}  # error {fit[1]:.2e}")


if __name__ == "__main__":
    main()
