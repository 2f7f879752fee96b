"""Which part of the lights a pixel takes."""

from __future__ import annotations

from typing import Any

from lobewise.render.bridge import dr

# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": 1/g, 1/g^2 of the plastic number and 1/g of
# the golden one, as parts of 2^32: products that wrap around are fractions.
_STEP_X, _STEP_Y, _STEP_FRAME = 3242174889, 2447445414, 2654435769


def choose_place(pixel: Any, width: Any, count: Any, seed: Any) -> Any:
    """Return a number below ``count`` (UInt32), far apart for neighbouring pixels and for successive seeds.

    ``pixel`` is the row-major number of pixels of an image of this ``width``.
    """
    return dr.mul_hi(pixel % width * _STEP_X + pixel // width * _STEP_Y + seed * _STEP_FRAME, count)
