"""The hit-distance term of `lobewise.lobes.hits` without its expansion, in arrays of vectors."""

import numpy as np
from numpy.typing import ArrayLike

from .vectors import Array, as_reals, dot


def compute_hit_shift(
    axis_i: ArrayLike,
    axis_j: ArrayLike,
    position_i: ArrayLike,
    position_j: ArrayLike,
    inverse_i: ArrayLike,
    inverse_j: ArrayLike,
) -> Array:
    """Return the shift added to ``z_j - z_i``: the step between the surface points over t, across the lobes.

    Parameters
    ----------
    axis_i, axis_j : array_like, shape (..., 3)
        Unit lobe axes.
    position_i, position_j : array_like, shape (..., 3)
        Surface points.
    inverse_i, inverse_j : array_like, shape (...)
        Inverse hit distances; their mean counts, which keeps the weight symmetric.

    Returns
    -------
    ndarray, shape (..., 3)
        Perpendicular to ``z_i + z_j``, radians to first order.

    Notes
    -----
    Source: this library, after the "secondary-ray information" that Tokuyoshi 2015 names as a remedy; for a flat mirror
    at infinity's other end it is the footprint ``t / (D + t)`` of the virtual image.
    """
    axis_i, axis_j, position_i, position_j, inverse_i, inverse_j = as_reals(
        axis_i, axis_j, position_i, position_j, inverse_i, inverse_j
    )
    step = (0.5 * (inverse_i + inverse_j))[..., None] * (position_j - position_i)
    middle = axis_i + axis_j
    square = np.maximum(dot(middle, middle), 1e-12)
    return np.asarray(step - (dot(middle, step) / square)[..., None] * middle)
