"""From images and guides to pictures: tone curve, false colours, the wipe with its line and labels, the window."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lobewise.reporting.display import choose_exposure, make_error_palette, map_tones_quickly
from lobewise.viewer.messages import Window

Pixels = NDArray[np.uint8]

MAX_SHOWN_SAMPLES = 256.0
"""Effective samples that are shown as 1."""
MOST_STOPS = 10.0
"""Exposures of the page go from minus this to this, in steps of a tenth."""

VIEWS = {
    "image": "image",
    "noisy": "noisy input",
    "diffuse": "diffuse light",
    "specular": "specular light",
    "direct": "direct light",
    "indirect": "indirect light",
    "sharpness": "lobe sharpness",
    "weight_sum": "weight sum",
    "effective_samples": "effective samples",
    "history": "history length",
    "recomputed": "re-computed pixels",
    "hit_distance": "hit distance",
    "normal": "normals",
    "albedo": "albedo",
}
"""What can be shown, by the name of the array, with its name on the page."""

LEGENDS = {
    "sharpness": "dark: sharpness 1, bright: a million (a mirror), logarithmic",
    "weight_sum": "W / (1 + W): half is the support of one sample that matches fully",
    "effective_samples": f"dark: 1, bright: {MAX_SHOWN_SAMPLES:.0f}, logarithmic",
    "history": "dark: none, bright: 40 frames or more",
    "recomputed": "bright: shaded again",
    "hit_distance": "t / (t + d): dark on the surface, half as far as the camera, bright at infinity",
    "normal": "x, y, z from -1 to 1 as red, green, blue",
}
"""What the colours of a view mean."""

_RADIANCE = ("image", "noisy", "diffuse", "specular", "direct", "indirect")
_COLORS = ("normal", "albedo")
BARS = (16, 17, 20)
"""Colour of what lies outside the picture."""
_LABEL_MARGIN = 6
_MOST_MAGNIFIED = 24
MAX_PIXELS_WITH_BARS = 4.0
"""Pixels of picture and bars, over those of the picture. A longer window gets a coarser picture, not more bars."""


def choose_stops(image: NDArray[np.float32]) -> float:
    """Return the exposure of an image, base-2 logarithm, as the page's slider can show and ask for it.

    Raises InputError if no pixel is finite.
    """
    stops = math.log2(choose_exposure(np.ascontiguousarray(image[::4, ::4])))
    return round(min(max(stops, -MOST_STOPS), MOST_STOPS), 1)


def paint(view: str, values: NDArray[np.float32], exposure: float) -> Pixels:
    """Return the picture of one view, a key of `VIEWS`.

    ``values`` are radiance or colours in [0, 1], (height, width, 3), or numbers in [0, 1], (height, width), which are
    shown from dark to bright. ``exposure`` is a factor for radiance; nothing else is changed by it.
    """
    if view in _RADIANCE:
        return map_tones_quickly(values, exposure)
    codes = np.clip(np.nan_to_num(values) * 255.0, 0.0, 255.0).astype(np.uint8)
    out: Pixels = codes if view in _COLORS else make_error_palette()[codes]
    return out


def fit_window(picture: Pixels, window: Window) -> Pixels:
    """Return what the window shows of a picture, with its aspect: bars where it is larger, whole pixels where zoomed.

    A window so long that bars would be most of the picture gets every second or third pixel.
    A picture of the window's aspect at zoom 1 comes back as it is.
    """
    height, width = picture.shape[:2]
    aspect = window.width / window.height
    tall = min(float(height), width / aspect) if window.fill else max(float(height), width / aspect)
    # A pixel's difference is not worth a bar.
    alike = abs(tall * aspect - width) < 1.5 and abs(tall - height) < 1.5
    if window.zoom == 1.0 and window.centre == (0.0, 0.0) and alike:
        return picture
    seen = tall / window.zoom
    times = max(1.0, min(np.ceil(window.height / seen), _MOST_MAGNIFIED)) if seen * 1.5 < window.height else 1.0
    if times == 1.0:
        times = min(1.0, math.sqrt(MAX_PIXELS_WITH_BARS * height * width / (seen * seen * aspect)))
    rows, columns = max(round(seen * times), 1), max(round(seen * aspect * times), 1)
    row = np.floor(0.5 * height - 0.5 * window.centre[1] * tall - 0.5 * seen + (np.arange(rows) + 0.5) / times)
    column = np.floor(
        0.5 * width + 0.5 * window.centre[0] * tall - 0.5 * seen * aspect + (np.arange(columns) + 0.5) / times
    )
    inside_rows, inside_columns = (row >= 0) & (row < height), (column >= 0) & (column < width)
    out = np.empty((rows, columns, 3), np.uint8)
    out[:] = BARS
    if inside_rows.any() and inside_columns.any():
        top, bottom = _find_run(inside_rows)
        left, right = _find_run(inside_columns)
        rows_taken, columns_taken = row[inside_rows].astype(int), column[inside_columns].astype(int)
        if times == 1.0:
            # Pixel for pixel, and slices are several times faster than lists of places.
            part = picture[rows_taken[0] : rows_taken[-1] + 1, columns_taken[0] : columns_taken[-1] + 1]
        else:
            part = picture[rows_taken[:, None], columns_taken[None, :]]
        out[top:bottom, left:right] = part
    return out


def _find_run(inside: NDArray[np.bool_]) -> tuple[int, int]:
    """Return where the one run of True begins, and where it has ended."""
    places = np.flatnonzero(inside)
    return int(places[0]), int(places[-1]) + 1


def wipe(left: Pixels, right: Pixels, place: float, labels: tuple[str, str]) -> Pixels:
    """Return the left picture up to ``place`` (0 to 1) of the width and the right one beyond, with line and labels."""
    height, width = left.shape[:2]
    edge = int(np.clip(round(place * width), 0, width))
    out = left.copy()
    out[:, edge:] = right[:, edge:]
    half = max(height // 700, 1)
    out[:, max(edge - half, 0) : edge + half] = (255, 196, 64)
    for text, at_right in zip(labels, (False, True), strict=True):
        _write(out, text, edge, at_right)
    return out


def _write(picture: Pixels, text: str, edge: int, at_right: bool) -> None:
    """Write a label beside the line, at the bottom, where it fits."""
    height, width = picture.shape[:2]
    mask = _draw_text(text, max(height // 36, 11))
    rows, columns = mask.shape
    top = height - rows - _LABEL_MARGIN
    left = edge + _LABEL_MARGIN if at_right else edge - columns - _LABEL_MARGIN
    if top < 0 or left < 0 or left + columns > width:
        return
    region = picture[top : top + rows, left : left + columns]
    dark = region.astype(np.float32) * 0.35
    region[:] = (dark + (255.0 - dark) * mask[..., None]).astype(np.uint8)


@lru_cache(maxsize=64)
def _draw_text(text: str, size: int) -> NDArray[np.float32]:
    """Return the coverage of a line of text, 0 to 1, with a margin around it."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(size)
    left, top, right, bottom = font.getbbox(text)
    image = Image.new("L", (int(right - left) + size, int(bottom - top) + size // 2 + 2))
    ImageDraw.Draw(image).text((size // 2 - left, size // 4 + 1 - top), text, fill=255, font=font)
    return np.asarray(image, dtype=np.float32) / 255.0
