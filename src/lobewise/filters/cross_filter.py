"""The cross filter: runs the passes of a form on a frame."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Buffer, Image, device_scope, download, lend, make_output, take_image, take_mask
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Kernel, Scheduled, get_kernel
from lobewise.errors import require_choice
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import COLORS, PassKey, Reads, Writes, chain_passes, describe_structure, make_pass
from lobewise.filters.forms import list_passes
from lobewise.filters.schedules.cross_pass import schedule_pass
from lobewise.filters.schedules.rows import STRIP_ROWS, count_lanes
from lobewise.frame import FloatArray
from lobewise.settings import FORMS

MAX_SCRATCH_BYTES = 1 << 29
"""Largest image between two passes whose memory is kept for the next call, bytes."""
MIN_TILE_STRIPS = 16
"""Smallest number of strips in a tile of the separable form."""
MAX_TILE_COLUMNS = 2048
"""Largest width of a tile of the separable form, pixels: the planes of a wider strip would not fit into the cache."""
MAX_VECTOR_PIXELS = 16
"""Pixels of the widest vector of any processor."""


@dataclass(frozen=True)
class FilterOutput:
    """The result of a filter.

    Parameters
    ----------
    image : (height, width, 3)
        Filtered radiance; 0 where all taps have weight 0.
    weight_sum, effective_samples : (height, width)
        Sum of the weights; ``(sum w)^2 / sum w^2``.
    moment : (height, width), optional
        Weighted mean of the squared luminance of radiance over albedo.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray
    moment: FloatArray | None = None


class _Scratch(threading.local):
    """Memory for images between two passes, per thread. Reusing it saves the page faults of fresh memory."""

    def __init__(self) -> None:
        self._held: dict[int, FloatArray] = {}

    def lend(self, slot: int, shape: tuple[int, ...]) -> FloatArray | None:
        """Return uninitialised memory of a shape; None if it is too large to keep."""
        count = math.prod(shape)
        if 4 * count > MAX_SCRATCH_BYTES:
            return None
        if slot not in self._held or self._held[slot].size < count:
            self._held[slot] = np.empty(count, np.float32)
        return self._held[slot][:count].reshape(shape)


_scratch = _Scratch()


def _split_output(pixels: FloatArray) -> FilterOutput:
    """Return the output of a last pass, (height, width, channels), split into its channels."""
    parts = slice(0, COLORS), *range(COLORS, pixels.shape[2])
    image, *rest = (np.ascontiguousarray(pixels[..., part]) for part in parts)
    return FilterOutput(image, *rest)


@device_scope()
def run_filter(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    form: str,
    radius: int,
    albedo: FloatArray | None = None,
    modulate: bool = True,
    moment: bool = False,
    strictness: FloatArray | None = None,
    device: str = "cpu",
) -> FilterOutput:
    """Run the cross filter.

    Parameters
    ----------
    radiance : array, shape (height, width, 3)
        Linear radiance. NaN, infinite and negative pixels have weight 0 and are filled from their neighbours.
    mask : bool array, shape (height, width)
        False where a pixel has no meaning for the features: it has weight 0 and its result is 0.
    features : sequence of Feature
        Their similarities are multiplied.
    form : {"full", "separable", "atrous"}
        All (2r+1)^2 taps; a row pass and a column pass; five 5x5 passes with doubling steps (``radius`` is unused).
    radius : int
        Kernel radius, pixels, >= 0.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance on the way in and multiplies it on the way out.
    modulate : bool
        Whether to multiply by the albedo on the way out.
    moment : bool
        Whether to average the squared luminance as well.
    strictness : array, shape (height, width), optional
        Power to which each pixel raises the weights of its taps, > 0.
    device : str
        A name from `list_devices`.

    Returns
    -------
    FilterOutput
    """
    require_choice("form", form, FORMS)
    passes = list_passes(form, radius)
    size = mask.shape[0], mask.shape[1]
    # Every array is held in a local name until the last call has returned: Halide keeps no reference.
    image = take_image("radiance", radiance, (*size, COLORS))
    beside: dict[str, Image] = {"mask": take_mask(mask), **give_features("tap", features, size)}
    if albedo is not None:
        beside["albedo"] = take_image("albedo", albedo, (*size, COLORS))
    if strictness is not None:
        beside["strictness"] = take_image("strictness", strictness, size)
    whole = PassKey(
        passes[0][0],
        tuple(describe_structure(feature) for feature in features),
        reads=Reads.RADIANCE if albedo is None else Reads.DEMODULATED,
        # On graphics cards a kernel with several output images would compute everything once per image.
        writes=Writes.IMAGES if device == "cpu" else Writes.PIXELS,
        modulate=albedo is not None and modulate,
        moment=moment,
        strict=strictness is not None,
    )
    keys = chain_passes(whole, [taps for taps, _, _ in passes], mirror=device == "cpu")
    kernels = [get_kernel(device, key, partial(make_scheduled_pass, key, features)) for key in keys]
    run = _Run(kernels, beside, {**give_scalars(features), "radius": passes[0][1]}, device)
    shapes = kernels[-1].list_shapes(height=size[0], width=size[1])
    outputs = {name: make_output(shape, device) for name, shape in shapes.items()}
    if form == "separable" and device == "cpu":
        arrays = {name: buffer.array for name, (buffer, _) in outputs.items()}
        for rows, columns in _list_tiles(*size):
            run.filter_tile(image, arrays, radius, rows, columns)
    else:
        buffers = {name: buffer for name, (buffer, _) in outputs.items()}
        run.filter_whole(image, buffers, [step for _, _, step in passes])
    results = {name: download(each) for name, (_, each) in outputs.items()}
    return FilterOutput(**results) if device == "cpu" else _split_output(results["pixels"])


@dataclass(frozen=True)
class _Run:
    """The kernels of a form, and the arguments of all of them beside the image. Not every pass reads all images."""

    kernels: Sequence[Kernel]
    beside: Mapping[str, Image]
    numbers: Mapping[str, float]
    device: str

    def _call(
        self,
        kernel: Kernel,
        source: Buffer,
        outputs: Mapping[str, Buffer],
        *,
        step: int = 1,
        part: tuple[slice, ...] = (),
    ) -> None:
        """Run a pass over the pixels ``part``, or over all; ``source`` is already cut to the part."""
        read = {each.name for each in kernel.parameters}
        lent = {
            name: lend(download(image)[part] if part else image, self.device)
            for name, image in self.beside.items()
            if name in read
        }
        kernel(source=source, step=step, **lent, **self.numbers, **outputs)

    def filter_whole(self, image: Image, outputs: Mapping[str, Buffer], steps: Sequence[int]) -> None:
        """Filter all pixels, pass by pass."""
        height, width = image.shape[:2]
        for number, (kernel, step) in enumerate(zip(self.kernels[:-1], steps, strict=False)):
            shape = kernel.list_shapes(height=height, width=width)["sums"]
            memory = _scratch.lend(number % 2, shape) if self.device == "cpu" else None
            written, sums = make_output(shape, self.device, memory)
            self._call(kernel, lend(image, self.device), {"sums": written}, step=step)
            image = sums
        self._call(self.kernels[-1], lend(image, self.device), outputs, step=steps[-1])

    def filter_tile(
        self, image: Image, results: Mapping[str, FloatArray], radius: int, rows: slice, columns: slice
    ) -> None:
        """Filter a tile along rows, with the rows above and below that columns reach; then along columns."""
        # Align vectors with those of the whole image, so that every pixel is computed by the same instructions.
        beside = -(-radius // MAX_VECTOR_PIXELS) * MAX_VECTOR_PIXELS
        tall = slice(max(rows.start - radius, 0), min(rows.stop + radius, image.shape[0]))
        wide = slice(max(columns.start - beside, 0), min(columns.stop + beside, image.shape[1]))
        along, down = self.kernels
        shape = along.list_shapes(height=tall.stop - tall.start, width=columns.stop - columns.start)["sums"]
        between = _scratch.lend(0, shape)
        if between is None:
            between = np.empty(shape, np.float32)
        sums = Buffer(between, (0, 0, columns.start - wide.start))
        self._call(along, Buffer(download(image)[tall, wide]), {"sums": sums}, part=(tall, wide))
        window = rows.start - tall.start, 0
        written = {name: Buffer(whole[rows, columns], window) for name, whole in results.items()}
        self._call(down, Buffer(between), written, part=(tall, columns))


def _list_tiles(height: int, width: int) -> list[tuple[slice, slice]]:
    """Return the rows and columns of tiles that the separable form filters one after the other.

    Tiles keep the memory between both passes small. Each tile has several strips for every thread, and is narrow enough
    that the planes of a strip stay in cache.
    """
    rows = STRIP_ROWS * max(MIN_TILE_STRIPS, 2 * (os.cpu_count() or 1))
    columns = -(-width // -(-width // MAX_TILE_COLUMNS))
    columns = -(-columns // MAX_VECTOR_PIXELS) * MAX_VECTOR_PIXELS
    return [
        (slice(top, min(top + rows, height)), slice(left, min(left + columns, width)))
        for top in range(0, height, rows)
        for left in range(0, width, columns)
    ]


def make_scheduled_pass(key: PassKey, features: Sequence[Feature], target: hl.Target) -> Scheduled:
    """Return a pass, ready to be compiled."""
    funcs = make_pass(key, features, lanes=count_lanes(target))
    schedule_pass(funcs, target)
    return Scheduled([funcs.out] if funcs.rest is None else [funcs.out, funcs.rest], funcs.signature)
