"""Checks of images: they are real, read-only, and all images of a frame have one size."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError

FloatArray = NDArray[np.float32]

if TYPE_CHECKING:

    class MaybeImage:
        """For type checkers: a field that takes anything array-like or None, and gives a float32 image or None."""

        @overload
        def __get__(self, owner: None, kind: type) -> None: ...
        @overload
        def __get__(self, owner: object, kind: type) -> FloatArray | None: ...
        def __get__(self, owner: object | None, kind: type) -> FloatArray | None: ...
        def __set__(self, owner: object, value: ArrayLike | None) -> None: ...

else:
    MaybeImage = FloatArray | None
ABSENT: Any = None
"""Default of a field that holds an optional image."""


def as_image(name: str, value: ArrayLike | None, channels: int | None) -> FloatArray | None:
    """Return ``value`` as a read-only C-contiguous float32 array (H, W) or (H, W, channels)."""
    if value is None:
        return None
    array = _read_array(name, value)
    shape = "(height, width)" if channels is None else f"(height, width, {channels})"
    good = array.ndim == (2 if channels is None else 3) and (channels is None or array.shape[-1] == channels)
    if not good or array.dtype.kind not in "fiub":
        raise InputError(
            name,
            expected=f"a real array of shape {shape}",
            got=f"{array.dtype} of shape {array.shape}",
            action="reshape it or leave it out",
        )
    if 0 in array.shape:
        raise InputError(
            name, expected="at least one pixel", got=f"an image of shape {array.shape}", action="give it pixels"
        )
    out = np.ascontiguousarray(array, dtype=np.float32)
    if out is value or not out.flags.owndata:
        out = out.view()
    out.flags.writeable = False
    return out


def _read_array(name: str, value: Any) -> NDArray[Any]:
    """Return an array of any library as a NumPy array. Raises InputError for one with gradients: they would be lost."""
    drjit = sys.modules.get("drjit")
    is_traced = drjit is not None and any(kind.__module__.partition(".")[0] == "drjit" for kind in type(value).__mro__)
    # PyTorch's tensors have the attribute requires_grad.
    if getattr(value, "requires_grad", False) is True or (is_traced and drjit.grad_enabled(value)):  # type: ignore[union-attr]
        raise InputError(
            name,
            expected="an array without gradients, which would be lost",
            got="an array with gradients",
            action="detach it, or use lobewise.mitsuba.Denoiser with quality='fast', which keeps gradients",
        )
    try:
        return np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as problem:
        raise InputError(
            name, expected="an array of numbers", got=f"a {type(value).__name__} ({problem})", action="convert it"
        ) from None


def as_images(what: str, images: Mapping[str, ArrayLike], shape: tuple[int, int] | None) -> Mapping[str, FloatArray]:
    """Return images (height, width, 3) by name, each checked like `as_image` and of the size ``shape``."""
    found = {}
    for name, value in images.items():
        image = as_image(f"{what} {name!r}", value, 3)
        if image is None:
            continue
        if shape is not None and image.shape[:2] != shape:
            raise refuse_size(f"{what} {name!r}", "the radiance", shape, image.shape)
        found[name] = image
    return found


def refuse_size(
    name: str,
    whose: str,
    expected: tuple[int, ...],
    got: tuple[int, ...],
    action: str = "give every image of a frame the same width and height",
) -> InputError:
    """Return the error for an image whose size, (height, width, ...), differs from that of ``whose``."""
    return InputError(
        name,
        expected=f"the size of {whose}, {expected[1]}x{expected[0]} pixels",
        got=f"{got[1]}x{got[0]}",
        action=action,
    )


class Images:
    """Shared checks of the frozen data classes whose fields are images of one size."""

    def check_images(self, channels: Mapping[str, int | None]) -> None:
        """Make the named fields read-only images of one size.

        ``channels`` gives the number of channels of each field; None stands for an image (height, width).
        """
        size: tuple[str, tuple[int, int]] | None = None
        for name, count in channels.items():
            image = as_image(name, getattr(self, name), count)
            object.__setattr__(self, name, image)
            if image is None:
                continue
            this = (int(image.shape[0]), int(image.shape[1]))
            if size is not None and size[1] != this:
                raise refuse_size(name, *size, this)
            size = size or (name, this)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields that hold an image."""
        return tuple(name for name, value in vars(self).items() if isinstance(value, np.ndarray))

    @property
    def shape(self) -> tuple[int, int] | None:
        """(height, width), or None where there is no image."""
        for name in self.names:
            height, width = getattr(self, name).shape[:2]
            return int(height), int(width)
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({say_size(self.shape)}{', '.join(self.names)})"


def say_size(shape: tuple[int, int] | None) -> str:
    """Return "columns x rows: " as the beginning of a short description; empty without a shape."""
    return f"{shape[1]}x{shape[0]}: " if shape else ""
