"""The hit-distance term: comparing what two lobes see, and not only where they point.

Two pixels of a flat mirror have nearly the same lobe, but see different points of a thing that is near. At distance t
the footprint of a lobe is ``t^2 S``, centred at ``x + t z``; the offset of two footprints over t is
``(z_j - z_i) + P (x_j - x_i) / t`` with P the projection across the lobes. Putting that in place of the difference of
the axes narrows the kernel where the reflected thing is near and leaves it where it is far.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lobewise.frame import FloatArray
from lobewise.lobes.vectors import Vector, dot


class HitField(NamedTuple):
    """Where the surfaces of an image are and how far away is what their lobes see."""

    position: FloatArray
    """Surface points, world space, shape (height, width, 3)."""
    inverse_distance: FloatArray
    """1/t, shape (height, width); 0 where nothing is seen or known, which leaves the lobes as they are."""


def find_hit_shift(
    axis_i: Vector, axis_j: Vector, hit_i: tuple[Vector, Any], hit_j: tuple[Vector, Any], square: Any
) -> list[Any]:
    """Return what the hits add to ``z_j - z_i``: the step between the surface points over t, across the lobes.

    Parameters
    ----------
    axis_i, axis_j : Vector
        Unit lobe axes.
    hit_i, hit_j : pair of Vector and number
        Surface point, and inverse hit distance; the mean of both distances counts, which keeps the weight symmetric.
    square : number
        ``|axis_i - axis_j|^2``.

    Notes
    -----
    Source: this library, after the "secondary-ray information" that Tokuyoshi 2015 names as a remedy; for a flat mirror
    at infinity's other end it is the footprint ``t / (D + t)`` of the virtual image. Perpendicular to ``z_i + z_j`` to
    first order in ``square / 4``: the lobes of a tap that counts are near.
    """
    (place_i, inverse_i), (place_j, inverse_j) = hit_i, hit_j
    inverse = 0.5 * (inverse_i + inverse_j)
    step = [inverse * (q - p) for p, q in zip(place_i, place_j, strict=True)]
    middle = [p + q for p, q in zip(axis_i, axis_j, strict=True)]
    # 1 / |zi + zj|^2 = 1 / (4 - |d|^2)
    along = 0.25 * dot(middle, step) * (1.0 + 0.25 * square)
    return [p - along * q for p, q in zip(step, middle, strict=True)]
