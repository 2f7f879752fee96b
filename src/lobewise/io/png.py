"""Pictures as PNG bytes, with nothing but the standard library: 8-bit colour, or 8-bit indices into a palette."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, describe_problem

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def encode_png(image: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None) -> bytes:
    """Return a PNG file.

    Parameters
    ----------
    image : ndarray of uint8
        Shape (height, width, 3): sRGB colour. With a palette, shape (height, width): indices into it.
    palette : ndarray of uint8, shape (up to 256, 3), optional
        sRGB colours.

    Raises
    ------
    InputError
        If the arrays are not of these types and shapes, or there is no pixel.

    Notes
    -----
    Source: "Portable Network Graphics (PNG) Specification", W3C, section 9 on filters.
    """
    expected = 3 if palette is None else 2
    colored = palette is not None or image.shape[-1:] == (3,)
    if image.dtype != np.uint8 or image.ndim != expected or not colored or 0 in image.shape:
        raise InputError(
            describe_problem(
                "picture",
                expected="uint8 of shape (height, width, 3), or (height, width) with a palette",
                got=f"{image.dtype} of shape {image.shape}",
                action="convert it",
            )
        )
    height, width = image.shape[:2]
    kind = 2 if palette is None else 3
    pieces = [_pack("IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0))]
    if palette is not None:
        pieces.append(_pack("PLTE", np.ascontiguousarray(palette, dtype=np.uint8).tobytes()))
        rows = np.concatenate([np.zeros((height, 1), np.uint8), image], axis=1)
    else:
        rows = _filter_rows(image)
    pieces += [_pack("IDAT", zlib.compress(rows.tobytes(), 6)), _pack("IEND", b"")]
    return SIGNATURE + b"".join(pieces)


def _pack(name: str, data: bytes) -> bytes:
    body = name.encode("ascii") + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def _filter_rows(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return rows of filter type and residuals; each row takes the filter whose residuals are smallest."""
    height, width = image.shape[:2]
    # Neighbours to the left, above, and above left; outside the image they are 0.
    padded = np.zeros((height + 1, width + 1, 3), np.int16)
    padded[1:, 1:] = image
    x, a, b, c = padded[1:, 1:], padded[1:, :-1], padded[:-1, 1:], padded[:-1, :-1]
    guess = a + b - c
    near_a, near_b, near_c = abs(guess - a), abs(guess - b), abs(guess - c)
    paeth = np.where((near_a <= near_b) & (near_a <= near_c), a, np.where(near_b <= near_c, b, c))
    predictions: list[Any] = [0, a, b, (a + b) // 2, paeth]
    residuals = np.stack([(x - prediction).astype(np.uint8) for prediction in predictions])
    size = np.abs(residuals.view(np.int8).astype(np.int32)).sum(axis=(2, 3))
    best = size.argmin(axis=0)
    chosen = residuals[best, np.arange(height)].reshape(height, width * 3)
    return np.concatenate([best[:, None].astype(np.uint8), chosen], axis=1)
