"""Checks of images: they are real, nobody can change them afterwards, and all images of a frame have one size."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError
from lobewise.work.arrays import FloatArray as FloatArray

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
_BETWEEN = "\n"
"""Stands between the names of planes in the name of the image that holds them."""
_BAND = re.compile(r"\d+([.,]\d+)?\s*nm$", re.IGNORECASE)
ABSENT: Any = None
"""Default of a field that holds an optional image."""
MAX_HALF_ROUNDING = 2e-3
"""Largest error of an image by the rounding of its passes to 16-bit floats, as a share of the pixel's light."""
HOST_DEVICES = (1, 3, 11, 13)
"""DLPack's numbers of devices whose memory the processor reads: its own, pinned for CUDA and ROCm, and shared."""


def as_image(name: str, value: ArrayLike | None, channels: int | None, *, is_light: bool = False) -> FloatArray | None:
    """Return ``value`` as an array (H, W) or (H, W, channels), as `keep_array` keeps it.

    ``is_light`` says that it is radiance, which integers are not.
    """
    if value is None:
        return None
    array = read_array(name, value)
    shape = "(height, width)" if channels is None else f"(height, width, {channels})"
    good = array.ndim == (2 if channels is None else 3) and (channels is None or array.shape[-1] == channels)
    if not good or array.dtype.kind not in "fiub":
        raise InputError(
            name,
            expected=f"a real array of shape {shape}",
            got=f"{array.dtype} of shape {array.shape}",
            action=advise_shape(array.shape, channels) if array.dtype.kind in "fiub" else "convert it to real numbers",
        )
    if is_light and array.dtype.kind in "iu":
        raise InputError(
            name,
            expected="linear radiance in floating point",
            got=f"{array.dtype}, as pictures for screens have",
            action=f"divide it by {255 if array.dtype.itemsize == 1 else 'the value of white'} and undo the curve for "
            "screens, such as (image / 255.0) ** 2.2",
        )
    if 0 in array.shape:
        raise InputError(
            name, expected="at least one pixel", got=f"an image of shape {array.shape}", action="give it pixels"
        )
    return keep_array(array)


def keep_array(array: NDArray[Any]) -> FloatArray:
    """Return an array as read-only C-contiguous float32. It is a copy if the array, or one that it views, is writeable.

    Views that were made before an array became read-only may still be writeable; no array knows its views.
    """
    out = np.ascontiguousarray(array, dtype=np.float32)
    if np.may_share_memory(out, array) and _is_writeable(array):
        out = out.copy()
    out.flags.writeable = False
    return out


def _is_writeable(array: NDArray[Any]) -> bool:
    """Return whether an array, one that it views, or the buffer that owns the memory, can be written to."""
    owner: Any = array
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return True
        owner = owner.base
    try:
        return owner is not None and not memoryview(owner).readonly
    except TypeError:
        # The library that owns the memory gave it as read-only.
        return False


def make_read_only(**images: Any) -> dict[str, Any]:
    """Return images by name, read-only with the arrays that they view. A data class keeps them without a copy.

    Only for arrays that nobody will write to. Everything that is no array stays as it is.
    """
    for image in images.values():
        while isinstance(image, np.ndarray):
            image.flags.writeable = False
            image = image.base
    return images


def wrap_columns(value: Any, margin: int) -> Any:
    """Return an image, or a record or collection of images, with columns of the other border beside each border.

    Parameters
    ----------
    value : array, `Images`, mapping or tuple
        Images of one size; everything else in it stays as it is.
    margin : int
        Columns to each side.
    """
    if not margin:
        return value

    def wrap(image: NDArray[Any]) -> NDArray[Any]:
        around = np.pad(image, [(0, 0), (margin, margin), *[(0, 0)] * (image.ndim - 2)], mode="wrap")
        return make_read_only(image=around)["image"]  # type: ignore[no-any-return]

    return _change_images(value, wrap)


def crop_columns(value: Any, width: int) -> Any:
    """Return only the ``width`` columns in the middle: what `wrap_columns` was given."""

    def crop(image: NDArray[Any]) -> NDArray[Any]:
        margin = (image.shape[1] - width) // 2
        return np.ascontiguousarray(image[:, margin : margin + width])

    return _change_images(value, crop)


def _change_images(value: Any, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Any:
    if isinstance(value, np.ndarray):
        return change(value)
    if isinstance(value, Mapping):
        return {name: _change_images(each, change) for name, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_change_images(each, change) for each in value)
    if isinstance(value, Images):
        images = {item.name: _change_images(getattr(value, item.name), change) for item in fields(value)}  # type: ignore[arg-type]
        return replace(value, **images)  # type: ignore[type-var]
    return value


def advise_shape(shape: tuple[int, ...], channels: int | None) -> str:
    """Return what to do with an array of a wrong shape, so that it becomes an image (height, width, channels)."""
    if len(shape) == 4:
        return "it looks like a batch: pass one image at a time"
    if len(shape) == 2 and channels == 3:
        return "it looks gray: pass np.repeat(image[..., None], 3, axis=-1)"
    if len(shape) != 3:
        return "reshape it or leave it out"
    count, (first, _, last) = channels or 1, shape
    if channels == 3 and last == 1:
        return "it looks gray: pass np.repeat(image, 3, axis=-1)"
    if channels == 3 and first == 1:
        return "it looks gray: pass np.repeat(image[0][..., None], 3, axis=-1)"
    if last == count + 1 and channels is not None:
        return f"{'it looks like RGBA: ' if channels == 3 else ''}pass image[..., :{count}]"
    if first in (count, count + 1) and last > 4:
        alpha = f"[..., :{count}]" if first > count else ""
        mended = f"image.transpose(1, 2, 0){alpha}" if channels else "image[0]"
        return f"it looks like channels first (CHW): pass {mended}"
    return "pass one channel, such as image[..., 0]" if channels is None else "reshape it or leave it out"


def read_array(name: str, value: Any) -> NDArray[Any]:
    """Return an array of any library as a NumPy array.

    Raises
    ------
    InputError
        If it is no array, lies on another device, or has gradients, which would be lost.
    """
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
        if hasattr(value, "__dlpack_device__") and int(value.__dlpack_device__()[0]) not in HOST_DEVICES:
            moves = [f"x.{move}()" for move in ("cpu", "get", "numpy") if hasattr(value, move)]
            raise InputError(
                name,
                expected="an array in the memory of the processor",
                got=f"a {type(value).__name__} on another device",
                action=f"move it to the CPU: {[*moves, 'numpy.asarray(x)'][0]}",
            )
        if hasattr(value, "__dlpack__") and not hasattr(value, "__array__"):
            # Older DLPack does not say whether its owner may write to the memory.
            return make_read_only(copy=np.from_dlpack(value).copy())["copy"]  # type: ignore[no-any-return]
        return np.asarray(value)
    except InputError:
        raise
    except (TypeError, ValueError, OverflowError, RuntimeError, BufferError) as problem:
        raise InputError(
            name, expected="an array of numbers", got=f"a {type(value).__name__} ({problem})", action="convert it"
        ) from None


def name_maker(value: Any) -> str:
    """Return "module:name" of the function that makes arrays such as ``value`` from NumPy's; empty for NumPy's own."""
    if isinstance(value, np.ndarray) or not hasattr(value, "__dlpack__"):
        return ""
    kind = type(value)
    has_namespace = hasattr(value, "__array_namespace__")
    library = value.__array_namespace__() if has_namespace else sys.modules.get(kind.__module__.partition(".")[0])
    if library is not None and hasattr(library, "from_dlpack"):
        return f"{library.__name__}:from_dlpack"
    # Dr.Jit's types take arrays themselves.
    return f"{kind.__module__}:{kind.__name__}"


def make_array(maker: str, image: NDArray[Any]) -> Any:
    """Return an array of the library that `name_maker` told, over the memory of ``image`` where that is writeable."""
    library, _, name = maker.partition(":")
    make = getattr(sys.modules.get(library), name, None)
    return image if make is None else make(np.require(image, requirements=["C", "W"]))


def as_images(
    what: str, images: Mapping[str, ArrayLike], shape: tuple[int, int] | None, *, with_planes: bool = False
) -> Mapping[str, FloatArray]:
    """Return images of light (height, width, 3) by name, checked like `as_image`, and of the size ``shape``.

    With ``with_planes`` an image may also be a plane (height, width).
    """
    checked = {}
    for name, value in images.items():
        is_plane = with_planes and len(getattr(value, "shape", ())) == 2
        image = as_image(f"{what} {name!r}", value, None if is_plane else 3, is_light=True)
        if image is None:
            continue
        if shape is not None and image.shape[:2] != shape:
            raise refuse_size(f"{what} {name!r}", "the radiance", shape, image.shape)
        checked[name] = image
    return checked


def is_band(name: str) -> bool:
    """Return whether the name of a plane is that of a spectral band, such as ``S0.550,000000nm``.

    Source: Fichet et al. 2021, "An OpenEXR Layout for Spectral Images".
    """
    return bool(_BAND.search(name))


def pack_planes(images: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return images by name with up to three planes (height, width) as one image (height, width, 3).

    Kernels take images of three channels. Spectral bands and other planes are packed apart. The last plane of an image
    stands for what lacks to three. The name of the image holds the names of all its planes.
    """
    packed = {name: image for name, image in images.items() if image.ndim == 3}
    planes = [name for name in images if name not in packed]
    for names in ([name for name in planes if is_band(name) == are_bands] for are_bands in (True, False)):
        for start in range(0, len(names), 3):
            some = names[start : start + 3]
            some += some[-1:] * (3 - len(some))
            packed[_BETWEEN.join(some)] = np.stack([images[name] for name in some], axis=-1)
    return packed


def list_packed(name: str) -> list[str]:
    """Return the names of the planes of an image of `pack_planes`; of another image its own name."""
    return name.split(_BETWEEN)


def unpack_planes(images: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return images with the planes of `pack_planes` by their own names."""
    unpacked: dict[str, FloatArray] = {}
    for name, image in images.items():
        names = list_packed(name)
        planes = np.moveaxis(image, -1, 0) if len(names) > 1 else [image]
        unpacked |= {each: np.ascontiguousarray(plane) for each, plane in zip(names, planes, strict=True)}
    return unpacked


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
    """Shared checks of the frozen data classes whose fields are images of one size. They own their images."""

    def check_images(self, channels: Mapping[str, int | None], lights: Collection[str] = ()) -> None:
        """Make the named fields read-only images of one size.

        ``channels`` gives the number of channels of each field; None stands for an image (height, width). ``lights``
        are the fields that hold radiance.
        """
        size: tuple[str, tuple[int, int]] | None = None
        for name, count in channels.items():
            image = as_image(name, getattr(self, name), count, is_light=name in lights)
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
