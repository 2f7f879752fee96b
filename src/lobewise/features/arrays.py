"""Arrays and scalars of features as arguments of a kernel, declared and given under the same names."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.buffers import Image, take_dense
from lobewise.backend.compiler import hl
from lobewise.backend.signature import Signature
from lobewise.errors import InputError
from lobewise.features.base import Feature


def declare_features(signature: Signature, prefix: str, features: Sequence[Feature], *axes: str) -> list[hl.ImageParam]:
    """Declare the arrays of all features as input images of a kernel, and return their parameters in order.

    Parameters
    ----------
    signature : Signature
        Signature of the kernel.
    prefix : str
        Prefix of the names, which tells the grids of a kernel apart.
    features : sequence of Feature
        The kernel is compiled for the numbers of channels of their arrays.
    *axes
        Names of the axes: rows and columns, or one axis for all pixels.
    """
    return [signature.image(name, *axes, *array.shape[2:]) for name, array in name_arrays(prefix, features).items()]


def give_features(prefix: str, features: Sequence[Feature], size: tuple[int, int]) -> dict[str, Image]:
    """Return the arrays that `declare_features` declares, by name; raise InputError if an array has another size."""
    held = [feature.get_arrays() for feature in features]
    for feature, arrays in zip(features, held, strict=True):
        for array in arrays:
            _require_image(feature, array, size)
    return {name: take_dense(array) for name, array in _name_all(prefix, held).items()}


def declare_scalars(signature: Signature, features: Sequence[Feature], prefix: str = "") -> list[list[hl.Param]]:
    """Declare the scalars of all features as numbers, and return their parameters, one list per feature."""
    return [
        [signature.number(_name_scalar(prefix, number, k)) for k in range(len(feature.get_parameters()))]
        for number, feature in enumerate(features)
    ]


def give_scalars(features: Sequence[Feature], prefix: str = "") -> dict[str, float]:
    """Return the scalars that `declare_scalars` declares, by name."""
    scalars = [feature.get_parameters() for feature in features]
    return {
        _name_scalar(prefix, number, k): value for number, each in enumerate(scalars) for k, value in enumerate(each)
    }


def name_arrays(prefix: str, features: Sequence[Feature]) -> dict[str, Image]:
    """Return the arrays of all features by the names that `declare_features` declares."""
    return _name_all(prefix, [feature.get_arrays() for feature in features])


def _name_all(prefix: str, held: Sequence[Sequence[Image]]) -> dict[str, Image]:
    return {
        f"{prefix}_feature{number}_{slot}": array
        for number, arrays in enumerate(held)
        for slot, array in enumerate(arrays)
    }


def _name_scalar(prefix: str, number: int, k: int) -> str:
    return f"{prefix}_feature{number}_scalar{k}".removeprefix("_")


def _require_image(feature: Feature, array: Image, size: tuple[int, int]) -> None:
    """Raise InputError if an array of a feature is not an image of this size."""
    if array.ndim not in (2, 3) or array.shape[:2] != size or array.dtype.kind not in "fiub":
        raise InputError(
            f"an array of feature {feature.name!r}",
            expected=f"real numbers of shape {size} or {(*size, 'channels')}",
            got=f"{array.dtype} of shape {array.shape}",
            action="give one value, or one row of channels, for every pixel of the frame",
        )
