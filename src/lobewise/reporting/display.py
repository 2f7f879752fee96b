"""From radiance and errors to pictures on a screen."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError

SHOULDER = 0.8
"""Display value up to which `map_tones` is linear."""
WHITE_PERCENTILE = 98.0
"""Percentile of the reference's luminance that `choose_exposure` puts at the shoulder."""
LOWEST_ERROR, HIGHEST_ERROR = 0.01, 1.0
"""Ends of the error maps' logarithmic colour scale, as relative errors: 1 % and 100 %."""

# Dark blue to pale yellow by way of red: lightness rises all along, so that the order survives grey print and any eye.
_RAMP = ((8, 8, 20), (46, 28, 104), (122, 34, 118), (196, 58, 88), (240, 122, 60), (250, 196, 98), (254, 248, 205))


def choose_exposure(reference: ArrayLike) -> float:
    """Return the factor that puts the 98th percentile of the luminance at the display value 0.8.

    Raises InputError if no pixel is finite.
    """
    image = np.asarray(reference, dtype=np.float64)
    luminance = image @ np.array([0.2126, 0.7152, 0.0722])
    finite = luminance[np.isfinite(luminance)]
    if finite.size == 0:
        raise InputError("reference", expected="finite pixels", got="none", action="pass another image")
    level = float(np.percentile(finite, WHITE_PERCENTILE))
    return SHOULDER / level if level > 0.0 else 1.0


def map_tones(image: ArrayLike, exposure: float) -> NDArray[np.uint8]:
    """Return the sRGB picture of linear radiance, uint8 of shape (height, width, 3).

    Each channel is multiplied by ``exposure``; up to 0.8 it stays as it is, above it goes to 1 as
    ``0.8 + 0.2 (1 - exp(-(x - 0.8) / 0.2))``, with equal slope at the joint; then the sRGB curve. Pixels that are NaN
    become black and infinite ones white.

    Notes
    -----
    Source of the curve from linear to encoded values: IEC 61966-2-1 (sRGB).
    """
    value = np.nan_to_num(np.asarray(image, dtype=np.float64) * exposure, nan=0.0, posinf=1e9, neginf=0.0)
    value = np.maximum(value, 0.0)
    rest = 1.0 - SHOULDER
    value = np.where(value <= SHOULDER, value, SHOULDER - rest * np.expm1(-np.maximum(value - SHOULDER, 0.0) / rest))
    encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 0.0031308) ** (1.0 / 2.4) - 0.055)
    out: NDArray[np.uint8] = np.rint(np.clip(encoded, 0.0, 1.0) * 255.0).astype(np.uint8)
    return out


def map_tones_quickly(image: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """Return what `map_tones` returns, to within one code value, in a few milliseconds for 512x512 pixels.

    Departs: the curve is read from a table by the value as a half float, whose eleven bits are eight times finer than
    the codes.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        value = (image * np.float32(exposure)).astype(np.float16)
    return np.take(_make_tone_table(), value.view(np.uint16))


@lru_cache(maxsize=1)
def _make_tone_table() -> NDArray[np.uint8]:
    """Return the display value of every half float, by its bits; shape (65536,)."""
    with np.errstate(invalid="ignore"):  # some of the patterns are signalling NaNs
        return map_tones(np.arange(65536, dtype=np.uint16).view(np.float16), 1.0)


def make_error_palette() -> NDArray[np.uint8]:
    """Return the 256 sRGB colours of an error map, least error first, uint8 of shape (256, 3)."""
    anchors = np.array(_RAMP, dtype=np.float64)
    places = np.linspace(0.0, len(anchors) - 1.0, 256)
    columns = [np.interp(places, np.arange(len(anchors)), anchors[:, channel]) for channel in range(3)]
    out: NDArray[np.uint8] = np.rint(np.stack(columns, axis=-1)).astype(np.uint8)
    return out


def index_errors(error: ArrayLike) -> NDArray[np.uint8]:
    """Return indices into `make_error_palette` for relative errors: logarithmic from 1 % to 100 %, clamped beyond."""
    value = np.clip(np.asarray(error, dtype=np.float64), LOWEST_ERROR, HIGHEST_ERROR)
    place = np.log(value / LOWEST_ERROR) / np.log(HIGHEST_ERROR / LOWEST_ERROR)
    out: NDArray[np.uint8] = np.rint(place * 255.0).astype(np.uint8)
    return out
