"""The engine that runs every call at once, in this process."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Buffer, HostImage, Image, download, lend, make_array, make_output, make_plane_stack
from lobewise.backend.devices import count_host_lanes
from lobewise.backend.jit import Kernel, get_kernel, run_kernel
from lobewise.backend.pointwise import PointwiseKey, make_pointwise
from lobewise.backend.signature import list_axis_lengths
from lobewise.errors import InputError
from lobewise.records.images import FloatArray

MAX_VECTOR_PIXELS = 16
"""Pixels of the widest vector of any processor."""


class KernelPass(NamedTuple):
    """One of the kernels of `lobewise.engine.passes`: its key, its definition, its own numbers, and what it does."""

    key: Hashable
    make: Callable[[Any], Any]
    radius: int
    step: int
    text: str


@dataclass(frozen=True)
class Here:
    """The engine that runs every call at once; see `lobewise.engine`.

    Parameters
    ----------
    device : str
        Where kernels run, a name from `lobewise.list_devices`. What is computed pixel by pixel runs on the processor.
    """

    device: str = "cpu"

    def pixels(
        self,
        define: Callable[..., Any],
        images: Mapping[str, NDArray[Any] | None],
        numbers: Mapping[str, Any],
        options: tuple[Hashable, ...] = (),
        names: Sequence[str] = (),
        into: Sequence[Any] = (),
        text: str = "",
    ) -> tuple[NDArray[Any], ...]:
        """See `lobewise.engine.pixels`."""
        held: dict[str, NDArray[Any]] = {n: _take_image(image) for n, image in images.items() if image is not None}
        sizes = {image.shape[:2] for image in held.values()}
        if len(sizes) != 1:
            raise InputError(
                "guides", expected="images of one size", got=str(sorted(sizes)), action="give all of one frame"
            )
        ((_, width),) = sizes
        vectors = {name: np.atleast_1d(np.asarray(value)) for name, value in numbers.items()}
        key = PointwiseKey(
            define,
            options,
            tuple((name, image[0, 0].size, image.dtype == np.uint8) for name, image in held.items()),
            tuple((name, len(vector), vector.dtype != np.float32) for name, vector in vectors.items()),
            # A row of differences is a pixel shorter.
            narrow=width <= count_host_lanes(),
        )
        kernel = get_kernel("cpu", key, partial(make_pointwise, key), strict=True)
        named = {f"{name}_{k}": float(value) for name, vector in vectors.items() for k, value in enumerate(vector)}
        results: list[Any] = list(run_kernel(kernel, "cpu", held, **named).values())
        for number, memory in enumerate(into):
            if memory is not None:
                np.copyto(memory, results[number])
        return tuple(result.view(np.bool_) if result.dtype == np.uint8 else result for result in results)

    def kernel(
        self,
        key: Hashable,
        make: Callable[[Any], Any],
        images: Mapping[str, Image],
        numbers: Mapping[str, float],
        names: Mapping[str, str] | None = None,
        text: str = "",
        *,
        strict: bool = False,
        sizes: Mapping[str, int] | None = None,
        into: Image | None = None,
    ) -> dict[str, Image]:
        """See `lobewise.engine.kernel`."""
        kernel = get_kernel(self.device, key, make, strict=strict)
        return run_kernel(kernel, self.device, images, sizes or {}, into, **numbers)

    @property
    def lanes(self) -> int:
        """Pixels of a vector of the processor; 0 for a graphics card."""
        return count_host_lanes() if self.device == "cpu" else 0

    def hold(self, name: str, array: FloatArray) -> FloatArray:
        """See `lobewise.engine.hold`."""
        return array

    def halve(self, length: int) -> int:
        """See `lobewise.engine.halve`."""
        return (length + 1) // 2

    def pad(self, length: int, multiple: int) -> int:
        """See `lobewise.engine.pad`."""
        return -(-length // multiple) * multiple

    def planes(
        self,
        key: Hashable,
        make: Callable[[Any], Any],
        images: Mapping[str, Image],
        numbers: Mapping[str, float],
        name: str = "",
        keep: str = "",
        text: str = "",
        *,
        strict: bool = False,
    ) -> FloatArray:
        """See `lobewise.engine.planes`."""
        kernel = get_kernel(self.device, key, make, strict=strict)
        (shape,) = set(kernel.list_shapes(**list_axis_lengths(kernel.parameters, images)).values())
        # All planes lie in one array, so that the next kernel reads them without a copy.
        memory = make_plane_stack((len(kernel.outputs), *shape))
        planes = [
            (each.name, make_output(plane.shape, self.device, plane))
            for each, plane in zip(kernel.outputs, memory, strict=True)
        ]
        # Every buffer is held in a local name until the call has returned: Halide keeps no reference.
        lent = {each: lend(image, self.device) for each, image in images.items()}
        kernel(**lent, **numbers, **{each: buffer for each, (buffer, _) in planes})
        for _, (_, plane) in planes:
            download(plane)
        return memory

    def passes(
        self,
        passes: Sequence[KernelPass],
        images: Mapping[str, Image],
        numbers: Mapping[str, float],
        tiles: Sequence[tuple[slice, slice]] = (),
        name: str = "",
    ) -> dict[str, Image]:
        """See `lobewise.engine.passes`."""
        beside = {each: image for each, image in images.items() if each != "source"}
        kernels = [get_kernel(self.device, each.key, each.make) for each in passes]
        run = _Chain(kernels, [each.step for each in passes], beside, numbers, passes[0].radius, self.device)
        image = images["source"]
        shapes = kernels[-1].list_shapes(height=image.shape[0], width=image.shape[1])
        outputs = {each: make_output(shape, self.device) for each, shape in shapes.items()}
        if tiles and self.device == "cpu":
            arrays = {each: buffer.array for each, (buffer, _) in outputs.items()}
            for rows, columns in tiles:
                run.filter_tile(image, arrays, rows, columns)
        else:
            run.filter_whole(image, {each: buffer for each, (buffer, _) in outputs.items()})
        return {each: download(image) for each, (_, image) in outputs.items()}

    def pick(self, image: HostImage, scale: int, place: tuple[int, int], *, stacked: bool) -> HostImage:
        """See `lobewise.engine.pick`."""
        shaded = slice(place[0], None, scale), slice(place[1], None, scale)
        return np.ascontiguousarray(image[(slice(None), *shaded)] if stacked else image[shaded])

    def fill(self, name: str, value: float, shape: tuple[int, ...]) -> FloatArray:
        """See `lobewise.engine.fill`."""
        row = np.full((*shape[:-2], 1, shape[-1]), value, np.float32)
        return np.broadcast_to(row, shape)

    def total(
        self,
        measure: Callable[..., Any],
        images: Sequence[Any],
        numbers: Sequence[float],
        name: str = "",
        count: int = 1,
    ) -> Any:
        """See `lobewise.engine.total`."""
        return measure(*images, *numbers)

    def own(self, image: HostImage) -> HostImage:
        """See `lobewise.engine.own`."""
        return image.copy()

    def in_box(
        self, mask: NDArray[np.bool_], reach: int, run: Callable[..., None], images: Sequence[HostImage]
    ) -> None:
        """See `lobewise.engine.in_box`."""
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        if len(rows):
            box = tuple(slice(max(int(at[0]) - reach, 0), int(at[-1]) + reach + 1) for at in (rows, columns))
            run(*(image[box] for image in images))

    def in_bands(
        self,
        gather: Callable[[dict[str, Any]], dict[str, Any]],
        finish: Callable[[dict[str, Any]], Any],
        images: Mapping[str, HostImage],
        rows: int,
        reach: int,
    ) -> HostImage:
        """See `lobewise.engine.in_bands`."""
        height, bands = len(next(iter(images.values()))), []
        for top in range(0, height, rows):
            first, bottom = max(top - reach, 0), min(top + rows, height)
            gathered = gather({name: image[first : bottom + reach] for name, image in images.items()})
            bands.append(finish({name: image[top - first : bottom - first] for name, image in gathered.items()}))
        return np.concatenate(bands)

    def by_value(self, run: Callable[[Any], Any], image: HostImage) -> HostImage:
        """See `lobewise.engine.by_value`."""
        result: HostImage = run(image.reshape(len(image), -1)).reshape(image.shape)
        return result

    def chain(
        self,
        define: Callable[..., Any],
        images: Mapping[str, HostImage],
        numbers: Mapping[str, Any],
        key: Hashable,
        make: Callable[[Any], Any],
        arrays: Mapping[str, FloatArray],
        rows: int,
        name: str,
        channels: int,
        texts: tuple[str, str],
    ) -> HostImage:
        """See `lobewise.engine.chain`."""
        height, parts = len(next(iter(images.values()))), []
        for top in range(0, height, rows):
            part = {each: image[top : top + rows] for each, image in images.items()}
            (between,) = self.pixels(define, part, numbers)
            (result,) = self.host.kernel(key, make, {name: between, **arrays}, {}).values()
            parts.append(np.asarray(result))
        return np.concatenate(parts)

    def compare(self, first: float, sign: str, second: float) -> bool:
        """See `lobewise.engine.compare`."""
        return first > second if sign == ">" else first >= second

    def both(self, first: bool, second: bool) -> bool:
        """See `lobewise.engine.both`."""
        return first and second

    def when(self, condition: bool, run: Callable[[], Any], otherwise: Callable[[], Any] | None) -> Any:
        """See `lobewise.engine.when`."""
        if condition:
            return run()
        return otherwise() if otherwise is not None else None

    def keep(self, name: str, make: Callable[[], Any]) -> None:
        """See `lobewise.engine.keep`."""

    def clear(self, image: HostImage) -> None:
        """See `lobewise.engine.clear`."""
        image[...] = 0

    def only(self, condition: bool, image: Any) -> Any:
        """See `lobewise.engine.only`."""
        return image if condition else None

    def some(self, image: HostImage) -> HostImage | None:
        """See `lobewise.engine.some`."""
        return image if image.any() else None

    @property
    def host(self) -> Here:
        """The engine that runs calls on the processor."""
        return HERE

    def part(self, name: str) -> AbstractContextManager[None]:
        """See `lobewise.engine.part`."""
        return nullcontext()

    def take(self, name: str, shape: Any, text: str, unit: str) -> None:
        """See `lobewise.engine.take`."""


HERE = Here()
"""The engine on the processor, which is the current one unless another is chosen."""


def _take_image(image: NDArray[Any]) -> NDArray[Any]:
    """Return an image as dense float32, a mask as uint8."""
    if image.dtype == np.bool_:
        return np.ascontiguousarray(image).view(np.uint8)
    return np.ascontiguousarray(image, np.float32)


@dataclass(frozen=True)
class _Chain:
    """Kernels that run one after the other, and the arguments of all of them beside the source."""

    kernels: Sequence[Kernel]
    steps: Sequence[int]
    beside: Mapping[str, Image]
    numbers: Mapping[str, float]
    radius: int
    device: str

    def _call(
        self, kernel: Kernel, source: Buffer, outputs: Mapping[str, Buffer], step: int, part: tuple[slice, ...] = ()
    ) -> None:
        """Run a pass over the pixels ``part``, or over all; ``source`` is already cut to the part."""
        # Not every pass reads all images.
        read = {each.name for each in kernel.parameters}
        lent = {
            name: lend(download(image)[part] if part else image, self.device)
            for name, image in self.beside.items()
            if name in read
        }
        kernel(source=source, step=step, radius=self.radius, **lent, **self.numbers, **outputs)

    def filter_whole(self, image: Image, outputs: Mapping[str, Buffer]) -> None:
        """Filter all pixels, pass by pass."""
        height, width = image.shape[:2]
        for kernel, step in zip(self.kernels[:-1], self.steps, strict=False):
            shape = kernel.list_shapes(height=height, width=width)["sums"]
            written, sums = make_output(shape, self.device)
            self._call(kernel, lend(image, self.device), {"sums": written}, step)
            image = sums
        self._call(self.kernels[-1], lend(image, self.device), outputs, self.steps[-1])

    def filter_tile(self, image: Image, results: Mapping[str, HostImage], rows: slice, columns: slice) -> None:
        """Filter a tile along rows, with the rows above and below that columns reach; then along columns."""
        # Align vectors with those of the whole image, so that every pixel is computed by the same instructions.
        beside = -(-self.radius // MAX_VECTOR_PIXELS) * MAX_VECTOR_PIXELS
        tall = slice(max(rows.start - self.radius, 0), min(rows.stop + self.radius, image.shape[0]))
        wide = slice(max(columns.start - beside, 0), min(columns.stop + beside, image.shape[1]))
        along, down = self.kernels
        shape = along.list_shapes(height=tall.stop - tall.start, width=columns.stop - columns.start)["sums"]
        between = make_array(shape)
        sums = Buffer(between, (0, 0, columns.start - wide.start))
        self._call(along, Buffer(download(image)[tall, wide]), {"sums": sums}, 1, (tall, wide))
        window = rows.start - tall.start, 0
        written = {name: Buffer(whole[rows, columns], window) for name, whole in results.items()}
        self._call(down, Buffer(between), written, 1, (tall, columns))
