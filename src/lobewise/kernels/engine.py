"""The filter's kernels, called: which passes make up a form, and what goes into each."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.errors import require_choice
from lobewise.frame import FloatArray
from lobewise.kernels.buffers import comes_down, lend, make_output, take_arrays, take_image, take_mask, take_parameters
from lobewise.kernels.cross_filter import PassKey, describe_structure, make_pass
from lobewise.kernels.features import Feature
from lobewise.kernels.forms import FORMS, Taps, list_passes
from lobewise.kernels.loading import Compilable, Scheduled, get_kernel
from lobewise.kernels.schedules import schedule_pass

COLORS = 3
LARGEST_SCRATCH = 1 << 29
"""Bytes of an image between two passes that are kept for the next call."""


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
    structure = tuple(describe_structure(feature) for feature in features)
    require_choice("form", form, FORMS)
    passes = list_passes(form, radius)
    height, width = mask.shape
    # Every array is held in a local name until the last call has returned: Halide keeps no reference.
    held: list[NDArray[Any]] = [take_mask(mask), *take_arrays(features, (height, width))]
    parameters = take_parameters(features)
    fixed = [lend(array, device) for array in held]
    tint = take_image("albedo", albedo, (height, width, 3)) if albedo is not None else None
    tints = [lend(tint, device)] if tint is not None else []
    power = take_image("strictness", strictness, (height, width)) if strictness is not None else None
    powers = [lend(power, device)] if power is not None else []
    source = take_image("radiance", radiance, (height, width, 3))
    for number, (taps, reach, step) in enumerate(passes):
        first, last = number == 0, number == len(passes) - 1
        key = PassKey(
            taps,
            reach,
            structure,
            first,
            last,
            demodulate=albedo is not None and first,
            modulate=albedo is not None and last and modulate,
            moment=moment,
            strict=strictness is not None,
            # Several images from one kernel would be computed several times elsewhere.
            apart=last and device == "cpu",
            paired=device == "cpu" and strictness is None and taps is Taps.HORIZONTAL and reach > 0,
        )

        def make(target: hl.Target, key: PassKey = key) -> Compilable:
            funcs = make_pass(key, features)
            schedule_pass(funcs, target)
            return Scheduled([funcs.out] if funcs.rest is None else [funcs.out, funcs.rest], funcs.arguments)

        kernel = get_kernel(device, key, make)
        shapes: list[tuple[int, ...]] = [(height, key.channels, width)]
        if last:
            planes = [(height, width)] * (key.channels - COLORS)
            shapes = [(height, width, COLORS), *planes] if key.apart else [(height, width, key.channels)]
        memory = None if last or device != "cpu" else _scratch.lend(number % 2, shapes[0])
        outputs = [make_output(shape, device, memory) for shape in shapes]
        tinted = tints if key.demodulate or key.modulate else []
        written = (buffer for buffer, _ in outputs)
        kernel(lend(source, device), *tinted, *fixed, step, *parameters, *powers, *written)
        source = outputs[0][1]
    images = [image for _, image in outputs]
    return FilterOutput(*images) if len(images) > 1 else _split_output(images[0])
