"""Make pictures of images and guides: tone curve, false colours, the wipe with its line and labels, the window."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lobewise.display.tones import choose_exposure, make_error_palette, map_tones_quickly
from lobewise.interactive.settings import MAX_SHOWN_FRAMES, MAX_SHOWN_SAMPLES, MAX_SHOWN_SHARPNESS
from lobewise.viewer.messages import Window

Pixels = NDArray[np.uint8]

MAX_STOPS = 10.0
"""Largest exposure of the page, either way, stops; its slider has steps of a tenth."""

LEGENDS = {
    "sharpness": f"dark: sharpness 1, bright: {MAX_SHOWN_SHARPNESS:,.0f} (a mirror), logarithmic",
    "weight_sum": "W / (1 + W): half is the support of one sample that matches fully",
    "effective_samples": f"dark: 1, bright: {MAX_SHOWN_SAMPLES:.0f}, logarithmic",
    "history": f"dark: none, bright: {MAX_SHOWN_FRAMES:.0f} frames or more",
    "recomputed": "bright: shaded again",
    "hit_distance": "t / (t + d): dark on the surface, half as far as the camera, bright at infinity",
    "normal": "x, y, z from -1 to 1 as red, green, blue",
}
"""Meaning of the colours of a view."""

RADIANCE = ("image", "noisy", "diffuse", "specular", "direct", "indirect")
_COLORS = ("normal", "albedo")
BARS = (16, 17, 20)
"""Colour of the bars beside a picture, sRGB."""
_LABEL_MARGIN = 6
"""Pixels between a label and the line of the wipe, or the edge of the picture."""
MAX_PIXELS_WITH_BARS = 4.0
"""Largest number of pixels of picture and bars, relative to the picture alone. In a longer window the picture gets
coarser."""


def choose_stops(image: NDArray[np.float32]) -> float:
    """Return an exposure for an image, base-2 logarithm, within range and steps of the page's slider.

    Raises InputError if no pixel is finite.
    """
    stops = math.log2(choose_exposure(np.ascontiguousarray(image[::4, ::4])))
    return round(min(max(stops, -MAX_STOPS), MAX_STOPS), 1)


def paint(view: str, values: NDArray[np.float32], exposure: float) -> Pixels:
    """Return the picture of one view.

    ``values`` are radiance or colours in [0, 1], (height, width, 3), or numbers in [0, 1], (height, width), which are
    shown from dark to bright. ``exposure`` is a factor for radiance and changes nothing else.
    """
    if view in RADIANCE:
        return map_tones_quickly(values, exposure)
    codes = np.clip(np.nan_to_num(values) * 255.0, 0.0, 255.0).astype(np.uint8)
    out: Pixels = codes if view in _COLORS else make_error_palette()[codes]
    return out


def fit_window(picture: Pixels, window: Window) -> Pixels:
    """Return the part of a picture that the window shows, with the window's aspect.

    Bars fill the rest of the window. In a window so long that bars would be most of the result, the picture keeps only
    every second or third pixel. A picture with the window's aspect is returned as it is.
    """
    height, width = picture.shape[:2]
    aspect = window.width / window.height
    tall = min(float(height), width / aspect) if window.fill else max(float(height), width / aspect)
    # Ignore differences of about a pixel.
    if abs(tall * aspect - width) < 1.5 and abs(tall - height) < 1.5:
        return picture
    times = min(1.0, math.sqrt(MAX_PIXELS_WITH_BARS * height * width / (tall * tall * aspect)))
    rows, columns = max(round(tall * times), 1), max(round(tall * aspect * times), 1)
    row = np.floor(0.5 * height - 0.5 * tall + (np.arange(rows) + 0.5) / times)
    column = np.floor(0.5 * width - 0.5 * tall * aspect + (np.arange(columns) + 0.5) / times)
    inside_rows, inside_columns = (row >= 0) & (row < height), (column >= 0) & (column < width)
    out = np.empty((rows, columns, 3), np.uint8)
    out[:] = BARS
    if inside_rows.any() and inside_columns.any():
        top, bottom = _locate_run(inside_rows)
        left, right = _locate_run(inside_columns)
        rows_taken, columns_taken = row[inside_rows].astype(int), column[inside_columns].astype(int)
        if times == 1.0:
            # Slices are several times faster than lists of indices.
            part = picture[rows_taken[0] : rows_taken[-1] + 1, columns_taken[0] : columns_taken[-1] + 1]
        else:
            part = picture[rows_taken[:, None], columns_taken[None, :]]
        out[top:bottom, left:right] = part
    return out


def _locate_run(inside: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first index of the only run of True, and the index after it."""
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
