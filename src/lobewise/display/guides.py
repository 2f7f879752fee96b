"""Pictures of what is no light: normals, positions, depths, roughness, motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.display.tones import choose_exposure, map_tones, round_codes
from lobewise.errors import InputError

SHOWN_PERCENTILES = (1.0, 99.0)
"""The values that a picture of numbers shows as black and as white."""
UNIT_VECTORS = ("normal", "tangent")
UNIT_RANGE = ("albedo", "coverage", "share")
SIGNED = ("motion",)
MIN_SHOWN_MOTION_PIXELS = 0.5
"""The least motion that a picture of motion shows as full color: less is rounding."""
_GREY = np.full(3, 128, np.uint8)


def paint_guide(name: str, image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a picture of an image of a frame.

    Parameters
    ----------
    name : str
        Its field, which tells what the numbers are.
    image : (height, width) or (height, width, channels)

    Returns
    -------
    (height, width, 3), uint8
        Unit vectors from -1 as black to 1 as white, by channel; albedos and shares as they are; other numbers between
        their percentiles `SHOWN_PERCENTILES`, motion symmetric around grey. Values that are not finite are grey.
    """
    value = np.asarray(image, np.float64)
    value = value[..., None] if value.ndim == 2 else value
    if name.endswith(UNIT_VECTORS):
        shown = 0.5 * value + 0.5
    elif name.endswith("coverage"):
        shown = value[..., 4:5]
    elif name.endswith(UNIT_RANGE):
        return _fill(map_tones(_make_rgb(value), 1.0), value)
    else:
        least = MIN_SHOWN_MOTION_PIXELS if name == "motion" else 0.0
        shown = _stretch_signed(value, least) if name.endswith(SIGNED) else _stretch(value)
    codes = np.nan_to_num(np.clip(_make_rgb(shown), 0.0, 1.0)) * 255.0
    return _fill(round_codes(codes), value)


def paint_light(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the tone-mapped picture of linear radiance, (height, width, 3); black where no pixel is finite."""
    try:
        return map_tones(image, choose_exposure(image))
    except InputError:
        return np.zeros(image.shape, np.uint8)


def _make_rgb(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return three channels: one is repeated, two get a third of 0.5."""
    if value.shape[-1] == 1:
        return np.repeat(value, 3, axis=-1)
    if value.shape[-1] == 2:
        return np.concatenate([value, np.full_like(value[..., :1], 0.5)], axis=-1)
    return value[..., :3]


def _stretch(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values mapped to [0, 1] by percentiles of the finite ones that are not 0: 0 often means "nothing here"."""
    used = value[np.isfinite(value) & (value != 0.0)]
    if used.size == 0:
        return np.zeros_like(value)
    low, high = (float(bound) for bound in np.percentile(used, SHOWN_PERCENTILES))
    low = min(low, 0.0) if low < 0.5 * high else low
    return (value - low) / max(high - low, 1e-30)


def _stretch_signed(value: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Return values mapped to [0, 1] with 0 in the middle; the range is at least ``least`` to each side."""
    used = np.abs(value[np.isfinite(value) & (value != 0.0)])
    most = float(np.percentile(used, SHOWN_PERCENTILES[1])) if used.size else 0.0
    return 0.5 + 0.5 * value / max(most, least, 1e-30)


def _fill(picture: NDArray[np.uint8], value: NDArray[np.float64]) -> NDArray[np.uint8]:
    picture[~np.isfinite(value).all(axis=-1)] = _GREY
    return picture
