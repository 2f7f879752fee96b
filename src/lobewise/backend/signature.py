"""What a kernel is called with: its parameters by name, and the checks of a call before machine code that checks none.

A kernel's definition declares every image and number that it reads and every image that it writes, once; the compiled
function's order of arguments follows from it and is written nowhere else.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Protocol

import halide as hl
import numpy as np
from numpy.typing import NDArray

Axis = int | str
"""A number of entries, or the name of a size: axes of one name are as long as each other."""


@dataclass(frozen=True)
class Parameter:
    """One argument of a kernel.

    Parameters
    ----------
    name : str
        As in the call.
    role : {"input", "output", "number"}
    type : str
        NumPy's name of it.
    axes : tuple
        Of an image, in NumPy's order, rows first.
    strides : tuple
        Entries of memory from one to the next along each axis; None where that is free.
    bounds : tuple
        Of a whole number, the least and the largest.
    """

    name: str
    role: str
    type: str
    axes: tuple[Axis, ...] = ()
    strides: tuple[int | None, ...] = ()
    bounds: tuple[int, ...] = ()


class Memory(Protocol):
    """An image as it is lent to a kernel."""

    array: NDArray[Any]
    first: Sequence[int]
    """What the kernel calls its first row, column and so on; empty where that is 0."""
    address: int


class Signature:
    """The parameters of a kernel while it is defined.

    Parameters
    ----------
    name : str
        Of the kernel, for messages.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._given: list[Parameter] = []
        self._written: list[Parameter] = []
        self.arguments: list[Any] = []
        """Of the compiled function, without outputs: Halide's parameters, in the order of their declaration."""

    @property
    def parameters(self) -> list[Parameter]:
        """In the order of the compiled function: what is written comes last, whenever it was declared."""
        return [*self._given, *self._written]

    def image(
        self, name: str, *axes: Axis, type: hl.Type | None = None, strides: Sequence[int | None] | None = None
    ) -> hl.ImageParam:
        """Declare an image that is read, and return its parameter, whose axes are in the opposite order.

        Where the last axis is a number of channels, they lie together: loads of neighbouring pixels are then dense and
        are shuffled, instead of one load for every lane.

        Parameters
        ----------
        name : str
            Also of Halide's parameter.
        *axes
            In NumPy's order; each begins at 0.
        type : halide.Type
            float32 by default; uint8 for truth.
        strides : sequence of int or None, optional
            For each axis, in NumPy's order, entries of memory to the next; None where that is free.
        """
        kind = hl.Float(32) if type is None else type
        dense = strides is None
        if strides is None:
            strides = _find_strides(axes)
        param = hl.ImageParam(kind, len(axes), name)
        for place, stride in enumerate(reversed(strides)):
            param.dim(place).set_min(0)
            if place == 0 and stride is None:
                param.dim(place).set_stride(hl.Expr())
            elif stride is not None and (place > 0 or not dense):
                param.dim(place).set_stride(stride)
        self._given.append(Parameter(name, "input", _name_type(kind), tuple(axes), tuple(strides)))
        self.arguments.append(param)
        return param

    def number(self, name: str, type: hl.Type | None = None) -> hl.Param:
        """Declare a real number, float32 by default, and return its parameter."""
        return self._declare_number(name, hl.Float(32) if type is None else type)

    def count(self, name: str, least: int = 0, most: int = 1 << 16) -> hl.Param:
        """Declare a whole number, int32, and return its parameter; a call outside the bounds is refused.

        Counts decide what memory is touched.
        """
        return self._declare_number(name, hl.Int(32), (least, most))

    def _declare_number(self, name: str, kind: hl.Type, bounds: tuple[int, ...] = ()) -> hl.Param:
        param = hl.Param(kind, name)
        self._given.append(Parameter(name, "number", _name_type(kind), bounds=bounds))
        self.arguments.append(param)
        return param

    def output(
        self, name: str, *axes: Axis, type: hl.Type | None = None, strides: Sequence[int | None] | None = None
    ) -> None:
        """Declare an image that is written, in the order in which the kernel's functions give them."""
        kind = _name_type(hl.Float(32) if type is None else type)
        found = _find_strides(axes) if strides is None else strides
        self._written.append(Parameter(name, "output", kind, tuple(axes), tuple(found)))


def _find_strides(axes: Sequence[Axis]) -> list[int | None]:
    """Return the strides that a kernel relies on: entries of the last axis side by side, and so the pixels of rows."""
    found: list[int | None] = [None] * len(axes)
    if axes:
        found[-1] = 1
    if len(axes) > 1 and isinstance(axes[-1], int):
        found[-2] = axes[-1]
    return found


def _name_type(kind: hl.Type) -> str:
    if kind.is_float():
        return f"float{kind.bits()}"
    return f"{'u' if kind.is_uint() else ''}int{kind.bits()}"


def unpack_parameters(packed: Sequence[Sequence[Any]]) -> list[Parameter]:
    """Return parameters that were kept as lists of their fields, in JSON."""
    return [Parameter(name, role, kind, *map(tuple, rest)) for name, role, kind, *rest in packed]


def describe_call(given: Mapping[str, Any]) -> Hashable:
    """Return all that `check_call` looks at: a call that is described alike is as good."""
    return tuple(
        (name, value if isinstance(value, Integral) else type(value))
        if (array := getattr(value, "array", None)) is None
        else (name, array.dtype, array.shape, array.strides, tuple(value.first))
        for name, value in given.items()
    )


def check_call(kernel: str, parameters: Sequence[Parameter], given: Mapping[str, Any]) -> None:
    """Raise TypeError unless a call gives every parameter, and each is what the kernel takes it for.

    Images that are written may be part of a larger one, whose first row or column is not 0: they then lie within it.
    """
    names = [each.name for each in parameters]
    missing = [name for name in names if name not in given]
    unknown = [name for name in given if name not in names]
    if missing or unknown:
        told = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"has no {', '.join(unknown)}"] * bool(unknown)
        raise TypeError(f"a call of the kernel {kernel!r} {' and '.join(told)}")
    sizes: dict[str, tuple[int, str]] = {}
    for each in sorted(parameters, key=lambda each: ("input", "output", "number").index(each.role)):
        value = given[each.name]
        array = getattr(value, "array", None)
        if each.role == "number":
            if array is not None or not _is_number(each, value):
                raise _refuse(kernel, each, "an image" if array is not None else value, sizes)
        elif array is None or not _fits(each, value, sizes):
            got = value if array is None else f"{array.dtype} {array.shape}, strides {array.strides}"
            raise _refuse(kernel, each, got, sizes)


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
    told = [f"{axis} is {sizes[axis][0]} in {sizes[axis][1]}" for axis in map(str, parameter.axes) if axis in sizes]
    beside = f" ({', '.join(told)})" if told else ""
    kind = f"({', '.join(map(str, parameter.axes))}), strides {parameter.strides}" if parameter.axes else "number"
    if parameter.bounds:
        kind += f" from {parameter.bounds[0]} to {parameter.bounds[1]}"
    return TypeError(f"the kernel {kernel!r} takes as {parameter.name} {parameter.type} {kind}{beside}, and got {got}")
