"""The filter's kernels, called: which passes make up a form, and what goes into each."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Buffer, comes_down, lend, make_output, take_image, take_mask
from lobewise.backend.jit import Kernel, get_kernel
from lobewise.errors import require_choice
from lobewise.features.arrays import take_arrays, take_parameters
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import PassKey, describe_structure, make_pass
from lobewise.filters.forms import can_mirror, list_passes
from lobewise.filters.schedules.cross_pass import schedule_pass
from lobewise.filters.schedules.rows import STRIP_ROWS, count_lanes
from lobewise.frame import FloatArray
from lobewise.settings import FORMS

COLORS = 3
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


@comes_down
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
    keys = [
        PassKey(
            taps,
            reach,
            tuple(describe_structure(feature) for feature in features),
            first=number == 0,
            last=number == len(passes) - 1,
            demodulate=albedo is not None and number == 0,
            modulate=albedo is not None and number == len(passes) - 1 and modulate,
            moment=moment,
            strict=strictness is not None,
            # Several images from one kernel would be computed several times elsewhere.
            apart=number == len(passes) - 1 and device == "cpu",
            mirrored=device == "cpu" and strictness is None and can_mirror(taps, reach),
        )
        for number, (taps, reach, _) in enumerate(passes)
    ]
    height, width = mask.shape
    # Every array is held in a local name until the last call has returned: Halide keeps no reference.
    held: list[NDArray[Any]] = [take_mask(mask), *take_arrays(features, (height, width))]
    parameters = take_parameters(features)
    tint = take_image("albedo", albedo, (height, width, 3)) if albedo is not None else None
    power = take_image("strictness", strictness, (height, width)) if strictness is not None else None
    image = take_image("radiance", radiance, (height, width, 3))
    shapes: list[tuple[int, ...]] = [(height, width, keys[-1].channels)]
    if keys[-1].apart:
        shapes = [(height, width, COLORS), *[(height, width)] * (keys[-1].channels - COLORS)]
    results = [make_output(shape, device) for shape in shapes]
    kernels = [get_kernel(device, key, partial(_make_scheduled, key, features)) for key in keys]
    given = _Given(held, parameters, tint, power)
    if form == "separable" and device == "cpu":
        for rows, columns in _list_tiles(height, width):
            _run_tile(kernels, keys, given, image, [whole for _, whole in results], rows, columns)
    else:
        source = image
        for number, (kernel, key, (_, _, step)) in enumerate(zip(kernels, keys, passes, strict=True)):
            outputs = results
            if not key.last:
                shape = height, key.channels, width
                memory = _scratch.lend(number % 2, shape) if device == "cpu" else None
                outputs = [make_output(shape, device, memory)]
            given.call(kernel, key, step, lend(source, device), [buffer for buffer, _ in outputs], device)
            source = outputs[0][1]
    images = [each for _, each in results]
    return FilterOutput(*images) if len(images) > 1 else _split_output(images[0])


@dataclass(frozen=True)
class _Given:
    """What all passes of a run read beside the image."""

    held: list[NDArray[Any]]
    """Mask, and the arrays of every feature."""
    parameters: list[float]
    tint: FloatArray | None
    power: FloatArray | None

    def call(
        self,
        kernel: Kernel,
        key: PassKey,
        step: int,
        source: Buffer,
        outputs: Sequence[Buffer],
        device: str,
        part: tuple[slice, slice] | None = None,
    ) -> None:
        """Run a pass over the pixels ``part``, which ``source`` has already; over all without it."""

        def take(array: NDArray[Any]) -> Buffer:
            return lend(array if part is None else array[part], device)

        tints = [take(self.tint)] if self.tint is not None and (key.demodulate or key.modulate) else []
        powers = [take(self.power)] if self.power is not None else []
        kernel(source, *tints, *map(take, self.held), step, *self.parameters, *powers, *outputs)


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


def _run_tile(
    kernels: Sequence[Kernel],
    keys: Sequence[PassKey],
    given: _Given,
    image: FloatArray,
    results: Sequence[FloatArray],
    rows: slice,
    columns: slice,
) -> None:
    """Filter a tile: along its rows and those that columns reach above and below, and then along its columns."""
    radius = keys[0].radius
    # Vectors begin and end where they do in the image, so that every pixel is computed as it is there.
    beside = -(-radius // WIDEST_VECTOR) * WIDEST_VECTOR
    tall = slice(max(rows.start - radius, 0), min(rows.stop + radius, image.shape[0]))
    wide = slice(max(columns.start - beside, 0), min(columns.stop + beside, image.shape[1]))
    shape = tall.stop - tall.start, keys[0].channels, columns.stop - columns.start
    between = _scratch.lend(0, shape)
    if between is None:
        between = np.empty(shape, np.float32)
    written = [Buffer(between, (0, 0, columns.start - wide.start))]
    given.call(kernels[0], keys[0], 1, Buffer(image[tall, wide]), written, "cpu", (tall, wide))
    written = [Buffer(whole[rows, columns], (rows.start - tall.start, 0)) for whole in results]
    given.call(kernels[1], keys[1], 1, Buffer(between), written, "cpu", (tall, columns))


@dataclass(frozen=True)
class _Scheduled:
    out: list[Any]
    arguments: list[Any]


def _make_scheduled(key: PassKey, features: Sequence[Feature], target: hl.Target) -> _Scheduled:
    """Return a pass, ready to be compiled."""
    funcs = make_pass(key, features, lanes=count_lanes(target))
    schedule_pass(funcs, target)
    return _Scheduled([funcs.out] if funcs.rest is None else [funcs.out, funcs.rest], funcs.arguments)
