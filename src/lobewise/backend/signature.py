"""The parameters of a kernel by name, and the checks of a call: machine code itself checks nothing.

A kernel's definition declares each image and number that it reads and each image that it writes, once. The order of the
compiled function's arguments follows from the declarations and is written nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.compiler import hl

Axis = int | str
"""The length of an axis, or a name: axes of one name have one length."""


@dataclass(frozen=True)
class Parameter:
    """One argument of a kernel.

    Parameters
    ----------
    name : str
        Name in the call.
    role : {"input", "output", "number"}
    type : str
        Name of the NumPy type.
    axes : tuple
        Axes of an image in NumPy's order, rows first.
    strides : tuple
        Stride of each axis in entries; None if any stride is allowed.
    bounds : tuple
        Smallest and largest value of a whole number.
    """

    name: str
    role: str
    type: str
    axes: tuple[Axis, ...] = ()
    strides: tuple[int | None, ...] = ()
    bounds: tuple[int, ...] = ()


class Memory(Protocol):
    """An image that is lent to a kernel."""

    array: NDArray[Any]
    first: Sequence[int]
    """Coordinates of the first row, column and so on for the kernel; empty if they are 0."""
    address: int


class Signature:
    """Collects the parameters of a kernel while it is defined.

    Parameters
    ----------
    name : str
        Name of the kernel, for messages.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._given: list[Parameter] = []
        self._written: list[Parameter] = []
        self.arguments: list[Any] = []
        """Halide's parameters for the inputs of the compiled function, in the order of declaration."""

    @property
    def parameters(self) -> list[Parameter]:
        """All parameters in the order of the compiled function: outputs come last, whenever they are declared."""
        return [*self._given, *self._written]

    def image(self, name: str, *axes: Axis, type: hl.Type | None = None) -> hl.ImageParam:
        """Declare an input image and return its Halide parameter, whose axes are in the opposite order.

        If the last axis has a fixed number of channels, the channels of a pixel lie together: neighbouring pixels are
        then loaded densely and shuffled, instead of lane by lane.

        Parameters
        ----------
        name : str
            Name of the argument and of Halide's parameter.
        *axes
            Axes in NumPy's order; coordinates begin at 0.
        type : halide.Type
            float32 by default; uint8 for masks.
        """
        kind, strides = hl.Float(32) if type is None else type, _compute_strides(axes)
        param = hl.ImageParam(kind, len(axes), name)
        for place, stride in enumerate(reversed(strides)):
            param.dim(place).set_min(0)
            # Halide itself asks for a stride of 1 along the innermost axis.
            if place > 0 and stride is not None:
                param.dim(place).set_stride(stride)
        self._given.append(Parameter(name, "input", _name_type(kind), axes, strides))
        self.arguments.append(param)
        return param

    def number(self, name: str, type: hl.Type | None = None) -> hl.Param:
        """Declare a real number, float32 by default, and return its parameter."""
        return self._declare_number(name, hl.Float(32) if type is None else type)

    def count(self, name: str, least: int = 0, most: int = 1 << 16) -> hl.Param:
        """Declare a whole number, int32, and return its parameter.

        A call outside the bounds is refused, because counts decide which memory the kernel touches.
        """
        return self._declare_number(name, hl.Int(32), (least, most))

    def _declare_number(self, name: str, kind: hl.Type, bounds: tuple[int, ...] = ()) -> hl.Param:
        param = hl.Param(kind, name)
        self._given.append(Parameter(name, "number", _name_type(kind), bounds=bounds))
        self.arguments.append(param)
        return param

    def output(self, name: str, *axes: Axis, type: hl.Type | None = None) -> None:
        """Declare an output image, in the order of the kernel's output functions."""
        kind = _name_type(hl.Float(32) if type is None else type)
        self._written.append(Parameter(name, "output", kind, axes, _compute_strides(axes)))


def _compute_strides(axes: Sequence[Axis]) -> tuple[int | None, ...]:
    """Return the strides: entries of the last axis are adjacent, and so are pixels if it holds channels."""
    strides: list[int | None] = [None] * len(axes)
    if axes:
        strides[-1] = 1
    if len(axes) > 1 and isinstance(axes[-1], int):
        strides[-2] = axes[-1]
    return tuple(strides)


def list_outputs(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Return the parameters that are output images."""
    return [each for each in parameters if each.role == "output"]


def list_axis_lengths(parameters: Sequence[Parameter], images: Mapping[str, Any]) -> dict[str, Any]:
    """Return the lengths of named axes by the input images of a call, each by its first image."""
    lengths: dict[str, Any] = {}
    for each in parameters:
        if each.role == "input" and each.name in images:
            for axis, length in zip(each.axes, images[each.name].shape, strict=False):
                if isinstance(axis, str):
                    lengths.setdefault(axis, length)
    return lengths


def _name_type(kind: hl.Type) -> str:
    if kind.is_float():
        return f"float{kind.bits()}"
    return f"{'u' if kind.is_uint() else ''}int{kind.bits()}"


def unpack_parameters(packed: Sequence[Sequence[Any]]) -> list[Parameter]:
    """Return parameters from lists of their fields, as JSON holds them."""
    return [Parameter(name, role, kind, *map(tuple, rest)) for name, role, kind, *rest in packed]


def check_call(kernel: str, parameters: Sequence[Parameter], arguments: Mapping[str, Any]) -> None:
    """Raise TypeError unless a call gives every parameter with the type, size and layout that the kernel expects.

    An output may be a part of the kernel's image, with a first row or column other than 0: it must lie inside.
    """
    names = [parameter.name for parameter in parameters]
    missing = [name for name in names if name not in arguments]
    unknown = [name for name in arguments if name not in names]
    if missing or unknown:
        complaints = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"has no {', '.join(unknown)}"] * bool(unknown)
        raise TypeError(f"a call of the kernel {kernel!r} {' and '.join(complaints)}")
    sizes: dict[str, tuple[int, str]] = {}
    for parameter in sorted(parameters, key=lambda parameter: ("input", "output", "number").index(parameter.role)):
        value = arguments[parameter.name]
        array = getattr(value, "array", None)
        if parameter.role == "number":
            if array is not None or not _is_number(parameter, value):
                raise _refuse(kernel, parameter, "an image" if array is not None else value, sizes)
        elif array is None or not _fits(parameter, value, sizes):
            got = value if array is None else f"{array.dtype} {array.shape}, strides {array.strides}"
            raise _refuse(kernel, parameter, got, sizes)


def _is_number(parameter: Parameter, value: Any) -> bool:
    if not parameter.bounds:
        return isinstance(value, Real)
    least, most = parameter.bounds
    return isinstance(value, Integral) and least <= int(value) <= most


def _fits(parameter: Parameter, memory: Memory, sizes: dict[str, tuple[int, str]]) -> bool:
    array = memory.array
    if array.dtype != np.dtype(parameter.type) or array.ndim != len(parameter.axes):
        return False
    first = [*memory.first, *[0] * (array.ndim - len(memory.first))]
    for axis, length, stride, start, step in zip(
        parameter.axes, array.shape, parameter.strides, first, array.strides, strict=True
    ):
        expected = axis if isinstance(axis, int) else sizes.setdefault(axis, (length, parameter.name))[0]
        window = parameter.role == "output" and len(memory.first) > 0 and isinstance(axis, str)
        inside = window and 0 <= start <= start + length <= expected
        if length != expected and not inside:
            return False
        if stride is not None and length > 1 and step != stride * array.itemsize:
            return False
    return True


def _refuse(kernel: str, parameter: Parameter, got: Any, sizes: Mapping[str, tuple[int, str]]) -> TypeError:
    other_sizes = [
        f"{axis} is {sizes[axis][0]} in {sizes[axis][1]}" for axis in map(str, parameter.axes) if axis in sizes
    ]
    beside = f" ({', '.join(other_sizes)})" if other_sizes else ""
    kind = f"({', '.join(map(str, parameter.axes))}), strides {parameter.strides}" if parameter.axes else "number"
    if parameter.bounds:
        kind += f" from {parameter.bounds[0]} to {parameter.bounds[1]}"
    return TypeError(f"the kernel {kernel!r} expects {parameter.name}: {parameter.type} {kind}{beside}, got {got}")
