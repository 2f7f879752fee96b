"""The hit-distance term: compare the points that two lobes see, not only their directions.

Two pixels of a flat mirror have nearly the same lobe, but see different points of a near object. At distance t the
footprint of a lobe is ``t^2 S``, centred at ``x + t z``. The offset of two footprints over t is
``(z_j - z_i) + P (x_j - x_i) / t`` with the projection P across the lobes. Using it in place of the difference of the
axes narrows the kernel where the reflected object is near and does not change it where the object is far.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lobewise.lobes.vectors import Vector, dot
from lobewise.work.arrays import FloatArray


class HitField(NamedTuple):
    """The surface points of an image, and the inverse distances to what their lobes hit."""

    position: FloatArray
    """Surface points, world space, shape (height, width, 3)."""
    inverse_distance: FloatArray
    """1/t, shape (height, width); 0 where nothing is hit or known, which switches the term off."""


def compute_hit_shift(
    axis_i: Vector, axis_j: Vector, hit_i: tuple[Vector, Any], hit_j: tuple[Vector, Any], square: Any
) -> list[Any]:
    """Return the shift added to ``z_j - z_i``: the step between the surface points over t, projected across the lobes.

    Parameters
    ----------
    axis_i, axis_j : Vector
        Unit lobe axes.
    hit_i, hit_j : pair of Vector and number
        Surface point, and inverse hit distance; the mean of both inverses is used, which keeps the weight symmetric.
    square : number
        ``|axis_i - axis_j|^2``.

    Notes
    -----
    Source: this library, after the "secondary-ray information" that Tokuyoshi 2015 names as a remedy. The result is
    perpendicular to ``z_i + z_j`` to first order in ``square / 4``. This suffices, because distant lobes weigh nothing.
    """
    (place_i, inverse_i), (place_j, inverse_j) = hit_i, hit_j
    inverse = 0.5 * (inverse_i + inverse_j)
    step = [inverse * (q - p) for p, q in zip(place_i, place_j, strict=True)]
    middle = [p + q for p, q in zip(axis_i, axis_j, strict=True)]
    # 1 / |zi + zj|^2 = 1 / (4 - |d|^2)
    along = 0.25 * dot(middle, step) * (1.0 + 0.25 * square)
    return [p - along * q for p, q in zip(step, middle, strict=True)]
