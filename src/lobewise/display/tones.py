"""Tone mapping, and colours of error maps."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError

MAX_LINEAR_VALUE = 0.8
"""Largest display value up to which `map_tones` is linear."""
WHITE_PERCENTILE = 98.0
"""Percentile of the reference's luminance that `choose_exposure` maps to `MAX_LINEAR_VALUE`."""
MIN_SHOWN_ERROR, MAX_SHOWN_ERROR = 0.01, 1.0
"""Relative errors at the ends of the logarithmic colour scale of error maps: 1 % and 100 %."""

_RAMP = ((8, 8, 20), (46, 28, 104), (122, 34, 118), (196, 58, 88), (240, 122, 60), (250, 196, 98), (254, 248, 205))
"""sRGB colours of error maps, dark blue to red to pale yellow. Lightness rises, so the order is kept in grey prints."""


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
    return MAX_LINEAR_VALUE / level if level > 0.0 else 1.0


def map_tones(image: ArrayLike, exposure: float) -> NDArray[np.uint8]:
    """Return the sRGB picture of linear radiance, uint8 of shape (height, width, 3).

    Each channel is multiplied by ``exposure``. A value x above 0.8 becomes ``0.8 + 0.2 (1 - exp(-(x - 0.8) / 0.2))``,
    which approaches 1 and has the slope 1 at 0.8. Then the sRGB curve is applied. NaN becomes black, infinity white.

    Notes
    -----
    Source of the curve from linear to encoded values: IEC 61966-2-1 (sRGB).
    """
    value = np.nan_to_num(np.asarray(image, dtype=np.float64) * exposure, nan=0.0, posinf=1e9, neginf=0.0)
    value = np.maximum(value, 0.0)
    rest = 1.0 - MAX_LINEAR_VALUE
    value = np.where(
        value <= MAX_LINEAR_VALUE,
        value,
        MAX_LINEAR_VALUE - rest * np.expm1(-np.maximum(value - MAX_LINEAR_VALUE, 0.0) / rest),
    )
    encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 0.0031308) ** (1.0 / 2.4) - 0.055)
    return round_codes(np.clip(encoded, 0.0, 1.0) * 255.0)


def round_codes(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Return numbers from 0 to 255 as whole ones."""
    return np.asarray(np.rint(values), np.uint8)


def map_tones_quickly(image: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """Return the picture of `map_tones`, to within one code value, in a few milliseconds for 512x512 pixels.

    Departs: a table holds the curve at every half float. Their eleven bits are eight times finer than the code values.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        value = (image * np.float32(exposure)).astype(np.float16)
    return np.take(_make_tone_table(), value.view(np.uint16))


@lru_cache(maxsize=1)
def _make_tone_table() -> NDArray[np.uint8]:
    """Return the display value of every half float, by its bits; shape (65536,)."""
    with np.errstate(invalid="ignore"):  # some bit patterns are signalling NaNs
        return map_tones(np.arange(65536, dtype=np.uint16).view(np.float16), 1.0)


def make_error_palette() -> NDArray[np.uint8]:
    """Return the 256 sRGB colours of an error map, least error first, uint8 of shape (256, 3)."""
    anchors = np.array(_RAMP, dtype=np.float64)
    places = np.linspace(0.0, len(anchors) - 1.0, 256)
    columns = [np.interp(places, np.arange(len(anchors)), anchors[:, channel]) for channel in range(3)]
    return round_codes(np.stack(columns, axis=-1))


def index_errors(error: ArrayLike) -> NDArray[np.uint8]:
    """Return indices into `make_error_palette` for relative errors, logarithmic from 1 % to 100 %, clamped outside."""
    value = np.clip(np.asarray(error, dtype=np.float64), MIN_SHOWN_ERROR, MAX_SHOWN_ERROR)
    place = np.log(value / MIN_SHOWN_ERROR) / np.log(MAX_SHOWN_ERROR / MIN_SHOWN_ERROR)
    return round_codes(place * 255.0)
