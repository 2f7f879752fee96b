"""Pictures as PNG bytes: 8-bit colour, or 8-bit indices into a palette."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError


def encode_png(image: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None) -> bytes:
    """Return a PNG file of sRGB colour, uint8 of shape (height, width, 3).

    With a palette, sRGB colours of shape (up to 256, 3), the image has shape (height, width): indices into it.

    Raises InputError if the arrays are not of these types and shapes, or there is no pixel.
    """
    from PIL import Image

    expected = 3 if palette is None else 2
    colored = palette is not None or image.shape[-1:] == (3,)
    if image.dtype != np.uint8 or image.ndim != expected or not colored or 0 in image.shape:
        raise InputError(
            "picture",
            expected="uint8 of shape (height, width, 3), or (height, width) with a palette",
            got=f"{image.dtype} of shape {image.shape}",
            action="convert it",
        )
    picture = Image.fromarray(image)
    if palette is not None:
        picture.putpalette(palette.tobytes())
    out = io.BytesIO()
    picture.save(out, "PNG")
    return out.getvalue()
