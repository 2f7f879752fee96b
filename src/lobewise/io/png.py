"""Pictures as PNG bytes: 8-bit colour, or 8-bit indices into a palette."""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.io.files import PathLike


def encode_png(
    image: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None, texts: Mapping[str, str] | None = None
) -> bytes:
    """Return a PNG file of sRGB colour, uint8 of shape (height, width, 3).

    With a palette, sRGB colours of shape (up to 256, 3), the image has shape (height, width): indices into it.
    ``texts`` are kept in the file by their names, in Latin-1.

    Raises InputError if the arrays are not of these types and shapes, or there is no pixel.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

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
    info = PngInfo()
    for name, text in (texts or {}).items():
        info.add_text(name, text)
    out = io.BytesIO()
    picture.save(out, "PNG", pnginfo=info)
    return out.getvalue()


def read_png_text(path: PathLike, name: str) -> str | None:
    """Return a text that `encode_png` kept in a file; None if there is no such file or text."""
    from PIL.PngImagePlugin import PngImageFile

    try:
        # `Image.open` would refuse pictures of very many pixels, of which none is read here.
        with PngImageFile(path) as picture:
            text = picture.info.get(name)
    except (OSError, SyntaxError, ValueError):
        return None
    return text if isinstance(text, str) else None
