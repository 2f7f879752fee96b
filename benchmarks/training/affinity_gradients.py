"""The gradients of the affinity filter, compiled from the expressions of the filter itself.

With ``A_i = g_i / s_i``, where g is the gradient of the filtered light and s the sum of all weights, a weight w_ij has
the gradient ``d_ij = A_i . (x_j - y_i)``. Every pixel gathers from its 24 neighbours: once as the centre i of its mean,
once as the source j in the means of its neighbours. No two threads write one number, and the sum has one order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from typing import NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.backend.signature import Signature
from lobewise.filters.affinity import (
    MAX_STEP,
    AffinityFuncs,
    AffinityInputs,
    AffinityKey,
    Inputs,
    Pixel,
    add_terms,
    compute_affinity,
    declare_inputs,
    flatten_pixel,
    make_window,
    measure_distance,
    read_pixel,
    rebuild_pixel,
    stack_pixels,
)
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y
from lobewise.filters.schedules.affinity import schedule_affinity

Array = NDArray[np.float32]


class AffinityGradients(NamedTuple):
    """Gradients of what the filter reads, in the shapes of `AffinityInputs`; lobes are fixed and have none."""

    light: Array
    features: Array
    centre: Array
    source: Array
    exponent: Array | None


class _Pair(NamedTuple):
    """What the gradient of a pair reads of one of its pixels."""

    pixel: Pixel
    slope: list[hl.Expr]
    """A, the gradient of the undivided sum."""
    offset: hl.Expr
    """``-A . y``, the gradient of the sum of weights."""

    def find_weight_slope(self, light: Sequence[hl.Expr]) -> hl.Expr:
        """Return the gradient of the weight that this pixel, as the centre, gives a tap of some ``light``."""
        return sum((a * x for a, x in zip(self.slope, light, strict=True)), self.offset)


def _list_values(
    inputs: Inputs, key: AffinityKey, results: tuple[hl.ImageParam, hl.ImageParam], x: hl.Expr
) -> list[hl.Expr]:
    """Return all values of a pixel of column ``x`` and row Y, from the images."""
    filtered, slope = results
    total = filtered[x, Y, COLORS]
    slopes = [slope[x, Y, k] / total for k in range(COLORS)]
    offset = sum((-slopes[k] * filtered[x, Y, k] for k in range(COLORS)), hl.f32(0.0))
    return [*flatten_pixel(read_pixel(inputs, key, x)), *slopes, offset]


def _rebuild(key: AffinityKey, values: Iterator[hl.Expr]) -> _Pair:
    """Return the pixel that `_list_values` gave the values of."""
    return _Pair(rebuild_pixel(key, values), list(islice(values, COLORS)), next(values))


def _find_terms(key: AffinityKey, here: _Pair, there: _Pair) -> list[hl.Expr]:
    """Return what a neighbour adds to the gradients of a pixel: of its light, features, source weight and exponent."""
    distance = measure_distance(here.pixel, there.pixel)
    given, taken = (compute_affinity(distance, each.pixel.exponent) for each in (there, here))
    given_slope, taken_slope = there.find_weight_slope(here.pixel.light), here.find_weight_slope(there.pixel.light)
    given_weight, taken_weight = given * here.pixel.source, taken * there.pixel.source
    light = [given_weight * a for a in there.slope]
    log_slope = taken_slope * taken_weight
    # Both weights depend on the difference of the features by -2 times itself.
    pull = hl.f32(-2.0) * (log_slope + given_slope * given_weight)
    features = [pull * (p - q) for p, q in zip(here.pixel.features, there.pixel.features, strict=True)]
    exponents = [-log_slope * distance.lobes] if key.lobes else []
    return [*light, *features, given_slope * given, *exponents]


def _make_gradients(key: AffinityKey, target: hl.Target) -> Scheduled:
    """Return the gradients, to be compiled."""
    signature = Signature("affinity gradients")
    inputs = declare_inputs(signature, key)
    filtered = signature.image("filtered", COLORS + 1, "height", "width")
    slope = signature.image("slope", COLORS, "height", "width")
    step = signature.count("step", 1, MAX_STEP)
    channels = COLORS + key.features + 2 + (key.lobes > 0)
    signature.output("gradients", channels, "height", "width")
    pixels, pixel_channels = stack_pixels(
        inputs.centre.dim(0).extent(), lambda column: _list_values(inputs, key, (filtered, slope), column)
    )
    window, *at = make_window(inputs.centre.dim(1).extent(), step)
    here, there = (_rebuild(key, (pixels[x, k, y] for k in range(pixel_channels))) for x, y in ((X, Y), at))
    terms = _find_terms(key, here, there)
    sums, out = hl.Func("sums"), hl.Func("gradients")
    light = [here.pixel.centre * a for a in here.slope]
    sums[X, Y] = hl.Tuple([*light, *[hl.f32(0.0)] * (len(terms) - COLORS)])
    add_terms(sums, terms)
    found = [sums[X, Y][k] for k in range(len(terms))]
    out[X, Y, C] = hl.mux(C, [*found, here.find_weight_slope(here.pixel.light)])
    schedule_affinity(AffinityFuncs(pixels, pixel_channels, sums, window, out, channels), target)
    return Scheduled([out], signature)


def find_gradients(
    inputs: AffinityInputs, filtered: Array, slope: Array, *, step: int, device: str = "cpu"
) -> AffinityGradients:
    """Return the gradients of what the filter reads.

    Parameters
    ----------
    inputs : AffinityInputs
        What `run_affinity` was called with.
    filtered : (4, height, width)
        What it returned.
    slope : (3, height, width)
        Gradient of the filtered light.
    step, device
        As in `run_affinity`.
    """
    key = inputs.find_key()
    kernel = get_kernel(device, ("gradients", key), partial(_make_gradients, key))
    images = inputs.name_images() | {"filtered": filtered, "slope": np.ascontiguousarray(slope, np.float32)}
    found = np.asarray(run_kernel(kernel, device, images, step=step)["gradients"])
    light, features, rest = np.split(found, [COLORS, COLORS + key.features])
    source, *exponent, centre = rest
    return AffinityGradients(light, features, centre, source, exponent[0] if exponent else None)
