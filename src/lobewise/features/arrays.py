"""What features hand over to a kernel: their arrays, checked, and their scalars."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.buffers import Image, take_dense
from lobewise.errors import InputError, describe_problem
from lobewise.features.base import Feature
from lobewise.frame import FloatArray


def take_arrays(features: Sequence[Feature], size: tuple[int, int]) -> list[FloatArray]:
    """Return the arrays of every feature, one after the other; raise InputError where one does not fit."""
    return [_take_array(feature, array, size) for feature in features for array in feature.get_arrays()]


def take_parameters(features: Sequence[Feature]) -> list[float]:
    """Return the scalars of every feature, one after the other."""
    return [value for feature in features for value in feature.get_parameters()]


def _take_array(feature: Feature, array: Image, size: tuple[int, int]) -> FloatArray:
    """Return an input of a feature as the kernels take it; raise InputError where it is no image of this size."""
    if array.ndim not in (2, 3) or array.shape[:2] != size or array.dtype.kind not in "fiub":
        raise InputError(
            describe_problem(
                f"an array of feature {feature.name!r}",
                expected=f"real numbers of shape {size} or {(*size, 'channels')}",
                got=f"{array.dtype} of shape {array.shape}",
                action="give one value, or one row of channels, for every pixel of the frame",
            )
        )
    return take_dense(array)
