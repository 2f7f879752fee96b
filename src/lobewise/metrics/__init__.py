"""Errors of images and of sequences, compared with references."""

from __future__ import annotations

from lobewise.metrics.disocclusion import find_disoccluded
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
from lobewise.metrics.sequences import Flicker, flicker, ghosting

__all__ = [
    "EPSILON",
    "FLIP_PIXELS_PER_DEGREE",
    "METRICS",
    "Flicker",
    "evaluate",
    "find_disoccluded",
    "find_specular_pixels",
    "flicker",
    "flip",
    "ghosting",
    "make_error_map",
    "mse",
    "psnr",
    "rel_mse",
    "smape",
]
