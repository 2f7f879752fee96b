"""Conversion of images of Mitsuba (tensors of any variant, bitmaps) to NumPy arrays, and back.

Types are recognised by their names, so that this module does not import Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.records.frame import FloatArray

ROOT = "<root>"
"""Mitsuba's name for the layer of the channels that have no layer in their names."""


def is_bitmap(value: Any) -> bool:
    """Return whether a value is a ``mitsuba.Bitmap``."""
    return any(
        kind.__name__ == "Bitmap" and kind.__module__.partition(".")[0] == "mitsuba" for kind in type(value).__mro__
    )


def is_tensor(value: Any) -> bool:
    """Return whether a value is a Dr.Jit array of any variant."""
    return any(kind.__module__.partition(".")[0] == "drjit" for kind in type(value).__mro__)


def carries_gradients(value: Any) -> bool:
    """Return whether a value is a Dr.Jit array that is differentiated."""
    if not is_tensor(value):
        return False
    from lobewise.render.bridge import dr

    return bool(dr.grad_enabled(value))


def to_array(what: str, value: Any) -> FloatArray:
    """Return a tensor or an array as float32, detached.

    Raises
    ------
    InputError
        If the value is neither.
    """
    if is_tensor(value):
        from lobewise.render.bridge import dr

        return np.array(dr.detach(value), dtype=np.float32)
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        return value.astype(np.float32)
    raise InputError(
        what,
        expected="a tensor of Mitsuba's (TensorXf) or a NumPy array of numbers",
        got=f"a {type(value).__name__}",
        action="convert it",
    )


def take_image(what: str, value: Any, size: tuple[int, int], channels: tuple[int, ...]) -> FloatArray:
    """Return an image, (height, width, channels).

    Parameters
    ----------
    what : str
        Name of the argument, for messages.
    value : TensorXf or array
        Of shape (height, width, channels); with one channel also (height, width).
    size : (int, int)
        Required width and height.
    channels : tuple of int
        Allowed numbers of channels.

    Raises
    ------
    InputError
        If the value is no image of this size with these channels.
    """
    image = to_array(what, value)
    if image.ndim == 2 and 1 in channels:
        image = image[..., None]
    width, height = size
    if image.ndim != 3 or image.shape[:2] != (height, width) or image.shape[2] not in channels:
        counts = " or ".join(map(str, channels))
        turned = image.ndim == 3 and image.shape[:2] == (width, height) != (height, width)
        raise InputError(
            what,
            expected=f"an image of {width}x{height} pixels (width x height) and {counts} channels, of shape "
            f"({height}, {width}, {counts})",
            got=f"shape {image.shape}",
            action="give input_size as (width, height)" if turned else "make a denoiser of its size",
        )
    return np.ascontiguousarray(image)


def give_back(like: Any, image: FloatArray) -> Any:
    """Return an image as the type of ``like``: a tensor of its variant, or a NumPy array."""
    image = np.ascontiguousarray(image, dtype=np.float32)
    return type(like)(image) if is_tensor(like) else image


def take_matrix(what: str, value: Any) -> NDArray[np.float64]:
    """Return the matrix, (4, 4), of a Mitsuba transform or of an array.

    Raises
    ------
    InputError
        If the value is no matrix, or the matrix cannot be inverted.
    """
    try:
        matrix = np.array(getattr(value, "matrix", value), dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError):
        matrix = np.zeros((4, 4))
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        action = "pass sensor.world_transform().inverse()"
        raise InputError(what, expected="a Transform4f", got=f"a {type(value).__name__}", action=action)
    return matrix


@dataclass(frozen=True)
class BitmapLayer:
    """One layer of a bitmap: its image, (height, width, channels), and the last words of its channel names."""

    image: FloatArray
    components: tuple[str, ...]


def split_bitmap(bitmap: Any) -> dict[str, BitmapLayer]:
    """Return the layers of a bitmap by name. Channels without a layer are under `ROOT`.

    Raises
    ------
    InputError
        If the bitmap does not hold linear floats.
    """
    several = bitmap.pixel_format().name == "MultiChannel"
    return {name: _read_layer(layer) for name, layer in (bitmap.split() if several else [(ROOT, bitmap)])}


def _read_layer(bitmap: Any) -> BitmapLayer:
    image = np.array(bitmap)
    if image.dtype.kind in "iu" or bitmap.srgb_gamma():
        raise InputError(
            "noisy",
            expected="a bitmap of linear floats",
            got=f"{image.dtype}{', gamma corrected' if bitmap.srgb_gamma() else ''}",
            action="convert it with bitmap.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False)",
        )
    image = image.astype(np.float32)
    components = tuple(str(field.name).rpartition(".")[2] for field in bitmap.struct_())
    return BitmapLayer(image[..., None] if image.ndim == 2 else image, components)


def make_bitmap(like: Any, name: str, image: FloatArray) -> Any:
    """Return an image as a bitmap of the pixel format of layer ``name`` of a bitmap, with 32-bit floats."""
    layer = like if like.pixel_format().name != "MultiChannel" else dict(like.split())[name]
    made = type(like)(np.ascontiguousarray(image, dtype=np.float32), layer.pixel_format())
    made.set_srgb_gamma(False)
    return made
