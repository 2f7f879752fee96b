"""The cross filter: which passes make up a form, and what goes into each."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Buffer, Image, device_scope, download, lend, make_output, take_image, take_mask
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

LARGEST_SCRATCH = 1 << 29
"""Bytes of an image between two passes that are kept for the next call."""
LEAST_STRIPS = 16
"""Strips of rows of a tile of the separable form, at least."""
WIDEST_TILE = 2048
"""Columns of a tile, at most: planes of a wider strip would lie in memory instead of in a cache."""
WIDEST_VECTOR = 16
"""Pixels of the widest vector of any processor."""


@dataclass(frozen=True)
class FilterOutput:
    """What a filter run gives.

    Parameters
    ----------
    image : (height, width, 3)
        Filtered radiance; 0 where no tap had any weight.
    weight_sum, effective_samples : (height, width)
        Sum of the weights; ``(sum w)^2 / sum w^2``.
    moment : (height, width), optional
        Weighted mean of the squared luminance of the samples, over their albedo.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray
    moment: FloatArray | None = None


class _Scratch(threading.local):
    """What passes hand on, by thread: memory that the system gave once costs nothing the next time."""

    def __init__(self) -> None:
        self._held: dict[int, FloatArray] = {}

    def lend(self, slot: int, shape: tuple[int, ...]) -> FloatArray | None:
        """Return memory of a shape, whose content is of no use; None where it would be too much to keep."""
        count = math.prod(shape)
        if 4 * count > LARGEST_SCRATCH:
            return None
        if slot not in self._held or self._held[slot].size < count:
            self._held[slot] = np.empty(count, np.float32)
        return self._held[slot][:count].reshape(shape)


_scratch = _Scratch()


def _split_output(pixels: FloatArray) -> FilterOutput:
    """Return what a last pass wrote, (height, width, channels), channel by channel."""
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
        Linear radiance. NaN, infinite and negative pixels get weight 0 and are filled from their neighbours.
    mask : bool array, shape (height, width)
        False where a pixel has no meaning for these features: it neither gives nor takes.
    features : sequence of Feature
        Their similarities are multiplied.
    form : {"full", "separable", "atrous"}
        All (2r+1)^2 taps; a row pass and a column pass; five 5x5 passes with doubling steps (``radius`` is unused).
    radius : int
        Kernel radius, pixels, >= 0.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance on the way in and multiplies it on the way out.
    modulate : bool
        Whether it does the latter.
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
        *passes[0][:2],
        tuple(describe_structure(feature) for feature in features),
        reads=Reads.RADIANCE if albedo is None else Reads.DEMODULATED,
        # Several images from one kernel would be computed several times elsewhere.
        writes=Writes.IMAGES if device == "cpu" else Writes.PIXELS,
        modulate=albedo is not None and modulate,
        moment=moment,
        strict=strictness is not None,
    )
    keys = chain_passes(whole, [taps for taps, _, _ in passes], mirror=device == "cpu")
    kernels = [get_kernel(device, key, partial(_make_scheduled, key, features)) for key in keys]
    run = _Run(kernels, beside, give_scalars(features), device)
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
    """The kernels of a form, and what they read beside the image; not every pass reads all."""

    kernels: Sequence[Kernel]
    beside: Mapping[str, Image]
    scalars: Mapping[str, float]
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
        """Run a pass over the pixels ``part``, which ``source`` has already; over all without it."""
        read = {each.name for each in kernel.parameters}
        lent = {
            name: lend(download(image)[part] if part else image, self.device)
            for name, image in self.beside.items()
            if name in read
        }
        kernel(source=source, step=step, **lent, **self.scalars, **outputs)

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
        """Filter a tile: along its rows and those that columns reach above and below, and then along its columns."""
        # Vectors begin and end where they do in the image, so that every pixel is computed as it is there.
        beside = -(-radius // WIDEST_VECTOR) * WIDEST_VECTOR
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
    """Return the rows and columns that the separable form filters one after the other.

    So that what its first pass writes takes little memory, and the same for all tiles; each gives every thread some
    strips, and no strip is so wide that its planes lie far from the processor.
    """
    rows = STRIP_ROWS * max(LEAST_STRIPS, 2 * (os.cpu_count() or 1))
    columns = -(-width // -(-width // WIDEST_TILE))
    columns = -(-columns // WIDEST_VECTOR) * WIDEST_VECTOR
    return [
        (slice(top, min(top + rows, height)), slice(left, min(left + columns, width)))
        for top in range(0, height, rows)
        for left in range(0, width, columns)
    ]


def _make_scheduled(key: PassKey, features: Sequence[Feature], target: hl.Target) -> Scheduled:
    """Return a pass, ready to be compiled."""
    funcs = make_pass(key, features, lanes=count_lanes(target))
    schedule_pass(funcs, target)
    return Scheduled([funcs.out] if funcs.rest is None else [funcs.out, funcs.rest], funcs.signature)
