"""How far images are from their references, and sequences of them: one figure each."""

from __future__ import annotations

from lobewise.metrics.images import (
    EPSILON,
    FLIP_PIXELS_PER_DEGREE,
    METRICS,
    evaluate,
    find_specular_pixels,
    flip,
    make_error_map,
    mse,
    psnr,
    rel_mse,
    smape,
)

__all__ = [
    "EPSILON",
    "FLIP_PIXELS_PER_DEGREE",
    "METRICS",
    "evaluate",
    "find_specular_pixels",
    "flip",
    "make_error_map",
    "mse",
    "psnr",
    "rel_mse",
    "smape",
]
