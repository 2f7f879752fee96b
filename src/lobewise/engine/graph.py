"""The steps of a pipeline as data: images, calls of kernels and C functions in order, and the memory that they need.

A `GraphImage` stands for an array that a frame will have. It has the shape and the type of the array, and no values.
Code that assembles features for the filters of this package therefore works with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.signature import Axis, Parameter
from lobewise.engine.numbers import write_number


class Length(str):
    """The length of an axis that follows from another one: a name, its expression of C, and its share of that axis."""

    code: str
    share: float

    def __new__(cls, name: str, code: str, share: float) -> Length:
        length = super().__new__(cls, name)
        length.code, length.share = code, share
        return length


def write_length(length: Axis) -> str:
    """Return the length of an axis as an expression of C."""
    if isinstance(length, Length):
        return length.code
    return f"p->{length}" if isinstance(length, str) else str(length)


SIZES = ("height", "width", "rows", "columns", "band")
"""Named axes: those of the image, those of the samples, which are the same unless samples are sparse, and the rows of a
band."""


@dataclass(frozen=True, eq=False)
class GraphImage:
    """An image of a pipeline.

    Parameters
    ----------
    name : str
        Identifier, unique in the pipeline.
    shape : tuple
        Axes in NumPy's order: a name of `SIZES`, a `Length`, or a number.
    type : str
        Name of the NumPy type.
    source : {"given", "made", "kept", "flat", "held"}
        "given": memory of the caller; "made": memory that the pipeline shares out; "kept": state, which the next frame
        reads; "flat": one value at all pixels; "held": values that are compiled in.
    text, unit : str
        Meaning, for images that the caller gives.
    whole : GraphImage, optional
        The stack of planes that holds this plane.
    plane : int
        Number of the plane.
    flat : float, optional
        Value of all pixels, if it is one. All rows then lie in one place.
    """

    name: str
    shape: tuple[Axis, ...]
    type: str = "float32"
    source: str = "made"
    text: str = ""
    unit: str = ""
    whole: GraphImage | None = None
    plane: int = 0
    flat: float | None = None

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the entries."""
        return np.dtype(self.type)

    @property
    def memory(self) -> GraphImage:
        """The image whose memory this one is, or is a part of."""
        return self if self.whole is None else self.whole.memory

    @property
    def still(self) -> int:
        """Number of the axis whose entries lie in one place; -1 for none."""
        return -1 if self.flat is None else self.ndim - 2

    @property
    def channels(self) -> int:
        """Number of values of a pixel."""
        return math.prod(length for length in self.shape if isinstance(length, int))

    def __getitem__(self, at: int | slice) -> Any:
        """Return a plane of a stack, its first planes as a stack, or others as a list."""
        if isinstance(at, int):
            return self.take_plane(at)
        if at.start:
            return self.list_planes()[at]
        return replace(self, name=f"{self.name}_first", shape=(at.stop, *self.shape[1:]), whole=self)

    def __iter__(self) -> Iterator[GraphImage]:
        """Yield the planes of a stack."""
        return iter(self.list_planes())

    def take_plane(self, number: int) -> GraphImage:
        """Return a plane of a stack (count, height, width)."""
        return replace(self, name=f"{self.name}_plane{number}", shape=self.shape[1:], whole=self, plane=number)

    def list_planes(self) -> list[GraphImage]:
        """Return all planes of a stack (count, height, width)."""
        count = self.shape[0]
        assert isinstance(count, int)
        return [self.take_plane(number) for number in range(count)]

    def count_bytes(self, share: float) -> float:
        """Return the bytes for a pixel of the image; ``share`` is the share of the pixels that have a sample."""
        shares = [axis.share for axis in self.shape if isinstance(axis, Length)]
        if (
            self.flat is not None
            or "band" in self.shape
            or not (shares or {"width", "columns"}.intersection(self.shape))
        ):
            return 0.0
        size = math.prod(shares) * float(self.channels * self.dtype.itemsize)
        return size * share if "rows" in self.shape or "columns" in self.shape else size


@dataclass(frozen=True)
class Operation:
    """One step of a pipeline: a call of a kernel or of a C function.

    Parameters
    ----------
    function : str
        Name of the function in C.
    arguments : sequence of (str, GraphImage or str)
        By the name of the parameter: an image, or an expression of C.
    reads, writes : tuple of GraphImage
    text : str
        What it does.
    when : str
        Expression of C; the step is skipped where it is 0. Empty for always.
    is_kernel : bool
        Whether it is a compiled kernel of Halide.
    stage : str
        Part of the plan that it belongs to.
    in_box : bool
        Whether it is given the box of its images that a C function has found.
    in_band : bool
        Whether it runs for bands of rows, one after the other. The box is the band then.
    on_device : bool
        Whether it runs on the graphics processor of the target.
    """

    function: str
    arguments: Sequence[tuple[str, GraphImage | str]]
    reads: tuple[GraphImage, ...]
    writes: tuple[GraphImage, ...]
    text: str
    when: str = ""
    is_kernel: bool = True
    stage: str = ""
    in_box: bool = False
    in_band: bool = False
    on_device: bool = False


@dataclass
class Graph:
    """The steps of a pipeline in order, and its images."""

    operations: list[Operation] = field(default_factory=list)
    inputs: dict[str, GraphImage] = field(default_factory=dict)
    """Images that the caller gives, by name."""
    results: dict[str, GraphImage] = field(default_factory=dict)
    """Images that the caller takes, by name."""
    state_pairs: list[tuple[GraphImage, GraphImage]] = field(default_factory=list)
    """Pairs of state: the image that this frame writes, and the one that the frame before wrote."""
    flats: dict[str, GraphImage] = field(default_factory=dict)
    """Images of one value, by name."""
    stage: str = ""
    when: str = ""
    in_box: bool = False
    in_band: bool = False
    reals: list[str] = field(default_factory=list)
    """Names of numbers that C functions write and conditions read, as C declares them."""
    held: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Arrays that are compiled in, by the names of their images."""
    _names: set[str] = field(default_factory=set)

    def name(self, base: str) -> str:
        """Return a name that no other image has."""
        name, number = base, 2
        while name in self._names:
            name, number = f"{base}_{number}", number + 1
        self._names.add(name)
        return name

    def give(self, name: str, *shape: Axis, text: str, unit: str = "", type: str = "float32") -> GraphImage:
        """Return an image that the caller gives; asked for twice, it is the same."""
        if name not in self.inputs:
            self.inputs[name] = GraphImage(self.name(name), shape, type, "given", text, unit)
        return self.inputs[name]

    def make(self, name: str, *shape: Axis, type: str = "float32") -> GraphImage:
        """Return an image in memory of the pipeline."""
        return GraphImage(self.name(name), shape, type)

    def make_flat(self, name: str, value: float, *shape: Axis) -> GraphImage:
        """Return an image of one value, 0 or 1; asked for twice, it is the same. Its rows lie in one place."""
        if name not in self.flats:
            self.flats[name] = GraphImage(self.name(name), shape, source="flat", flat=value)
        return self.flats[name]

    def take(self, name: str, *shape: Axis, text: str, unit: str = "") -> GraphImage:
        """Return an image that the caller takes: a result."""
        self.results[name] = GraphImage(self.name(name), shape, "float32", "given", text, unit)
        assert self.results[name].name == name, f"another image has the name of the result {name}"
        return self.results[name]

    def keep(self, name: str, *shape: Axis, type: str = "float32") -> tuple[GraphImage, GraphImage]:
        """Return an image that the next frame reads, and the same image of the frame before: 0 before the first."""
        pair = tuple(GraphImage(self.name(each), shape, type, "kept") for each in (name, f"{name}_before"))
        self.state_pairs.append((pair[0], pair[1]))
        return pair[0], pair[1]

    @contextmanager
    def _set(self, **fields: Any) -> Iterator[None]:
        """Give some fields other values inside the context."""
        before = {name: getattr(self, name) for name in fields}
        vars(self).update(fields)
        try:
            yield
        finally:
            vars(self).update(before)

    def part(self, stage: str) -> AbstractContextManager[None]:
        """Name the part of the plan that steps belong to."""
        return self._set(stage=stage)

    def only_when(self, condition: str) -> AbstractContextManager[None]:
        """Skip steps where an expression of C is 0."""
        return self._set(when=f"{self.when} && {condition}" if self.when else condition)

    def only_in_box(self) -> AbstractContextManager[None]:
        """Give steps the box of their images that a C function has found."""
        return self._set(in_box=True)

    def only_in_bands(self) -> AbstractContextManager[None]:
        """Run steps for bands of rows, one after the other. Images with the axis "band" hold one band."""
        return self._set(in_box=True, in_band=True)

    def add_real(self, name: str, count: int = 1) -> str:
        """Return the C expression of a new number, or of several."""
        real = self.name(name)
        self.reals.append(real if count == 1 else f"{real}[{count}]")
        return f"p->{real}"

    def hold(self, name: str, values: NDArray[np.floating[Any]]) -> GraphImage:
        """Return an image whose values are compiled in."""
        image = GraphImage(self.name(name), values.shape, source="held")
        self.held[image.name] = np.ascontiguousarray(values, np.float32)
        return image

    def call(
        self,
        function: str,
        arguments: Mapping[str, Any],
        parameters: Sequence[Parameter],
        text: str,
        *,
        on_device: bool = False,
    ) -> None:
        """Add a call of a kernel, after comparing the arguments with its parameters."""
        sizes: dict[str, Axis] = {}
        passed: list[tuple[str, GraphImage | str]] = []
        for parameter in parameters:
            value = arguments[parameter.name]
            if parameter.role == "number":
                passed.append((parameter.name, _write_argument(parameter, value)))
                continue
            assert isinstance(value, GraphImage), f"{function} wants an image for {parameter.name}"
            _require_fit(function, parameter, value, sizes)
            passed.append((parameter.name, value))
        unknown = set(arguments) - {parameter.name for parameter in parameters}
        assert not unknown, f"{function} has no {unknown}"
        roles = {parameter.name: parameter.role for parameter in parameters}
        images = [(name, value) for name, value in passed if isinstance(value, GraphImage)]
        reads = tuple(image for name, image in images if roles[name] == "input")
        writes = tuple(image for name, image in images if roles[name] == "output")
        overlap = {image.name for image in reads} & {image.name for image in writes}
        assert not overlap, f"{function} reads what it writes: {overlap}"
        where = self.stage, self.in_box, self.in_band, on_device
        self.operations.append(Operation(function, passed, reads, writes, text, self.when, True, *where))

    def run(
        self,
        function: str,
        images: Sequence[GraphImage],
        numbers: Sequence[str],
        text: str,
        writes: Sequence[GraphImage] = (),
    ) -> None:
        """Add a call of a C function of the driver: the images, then expressions of C."""
        arguments: list[tuple[str, GraphImage | str]] = [(image.name, image) for image in images]
        arguments += [("", number) for number in numbers]
        reads = tuple(image for image in images if image not in writes)
        where = self.stage, self.in_box, self.in_band
        self.operations.append(Operation(function, arguments, reads, tuple(writes), text, self.when, False, *where))

    def list_images(self) -> list[GraphImage]:
        """Return every image that a step names, in order of first use."""
        named: dict[str, GraphImage] = {}
        for operation in self.operations:
            for _, value in operation.arguments:
                if isinstance(value, GraphImage):
                    named.setdefault(value.name, value)
        return list(named.values())


def group_bands(operations: Iterable[Operation]) -> list[list[Operation]]:
    """Return steps in the order in which they run: those of a group run for one band of rows after the other.

    Steps in bands that follow each other in one part of the plan are one group. Any other step is a group by itself.
    """
    groups: list[list[Operation]] = []
    for _, steps in groupby(operations, key=lambda each: (each.stage, each.in_band)):
        group = list(steps)
        groups += [group] if group[0].in_band else [[step] for step in group]
    return groups


def _write_argument(parameter: Parameter, value: Any) -> str:
    kind = {"float32": "float", "int32": "int32_t", "float64": "double"}[parameter.type]
    if isinstance(value, str):
        return value
    if kind == "int32_t" and not hasattr(value, "code"):
        return str(int(value))
    return f"({kind}){write_number(value)}"


def _require_fit(function: str, parameter: Parameter, image: GraphImage, sizes: dict[str, Axis]) -> None:
    """Compare an image with the parameter of a kernel: its type, its axes, and its strides."""
    mismatch = f"{function}: {parameter.name} is {parameter.type} {parameter.axes}, got {image.name} {image.shape}"
    assert image.type == parameter.type, mismatch
    assert image.ndim == len(parameter.axes), mismatch
    for axis, length in zip(parameter.axes, image.shape, strict=True):
        length = "height" if length == "band" else length
        if isinstance(axis, int):
            assert axis == length, mismatch
        else:
            assert sizes.setdefault(axis, length) == length, mismatch
    dense = 1
    for stride, length in zip(reversed(parameter.strides), reversed(image.shape), strict=True):
        assert stride is None or stride == dense, mismatch
        dense = dense * length if isinstance(length, int) and isinstance(dense, int) else -1
