"""The cross filter: runs the passes of a form on a frame."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import Image, device_scope, take_image, take_mask
from lobewise.engine.here import MAX_VECTOR_PIXELS, KernelPass
from lobewise.errors import require_choice
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature, describe_structure
from lobewise.filters.cross_pass import COLORS, PassKey, Reads, Writes, chain_passes, make_pass
from lobewise.filters.forms import ATROUS_RADIUS, Taps, list_form_passes
from lobewise.filters.glue import define_apart
from lobewise.filters.scheduling import STRIP_ROWS
from lobewise.records.frame import FloatArray
from lobewise.settings import FORM_NAMES

MIN_TILE_STRIPS = 16
"""Smallest number of strips in a tile of the separable form."""
MAX_TILE_COLUMNS = 2048
"""Largest width of a tile of the separable form, pixels: the planes of a wider strip would not fit into the cache."""


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
    more : sequence of (height, width, 3)
        Further images, filtered by the same weights; 0 where none of their good pixels has any weight.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray
    moment: FloatArray | None = None
    more: Sequence[FloatArray] = ()


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
    more: Sequence[FloatArray] = (),
    name: str = "filtered",
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
    more : sequence of array, shape (height, width, 3)
        Further images that are filtered by the same weights.
    name : str
        Name of the result in recorded plans.

    Returns
    -------
    FilterOutput
    """
    if form not in FORM_NAMES:
        require_choice("form", form, FORM_NAMES)
    size, taps = (mask.shape[0], mask.shape[1]), list_form_passes(form, radius)
    images: dict[str, Image] = {"source": take_image("radiance", radiance, (*size, COLORS)), "mask": take_mask(mask)}
    images |= give_features("tap", features, size)
    if albedo is not None:
        images["albedo"] = take_image("albedo", albedo, (*size, COLORS))
    for number, image in enumerate(more):
        images[f"more{number}"] = take_image("image", image, (*size, COLORS))
    if strictness is not None:
        images["strictness"] = take_image("strictness", strictness, size)
    on_processor = engine.get_engine().device == "cpu"
    whole = PassKey(
        taps[0][0],
        tuple(describe_structure(feature) for feature in features),
        reads=Reads.RADIANCE if albedo is None else Reads.DEMODULATED,
        # On graphics cards a kernel with several output images would compute everything once per image.
        writes=Writes.IMAGES if on_processor else Writes.PIXELS,
        modulate=albedo is not None and modulate,
        moment=moment,
        strict=strictness is not None,
        other_count=len(more),
    )
    keys = chain_passes(whole, [kind for kind, _, _ in taps], mirror=on_processor)
    passes = [
        KernelPass(key, partial(make_pass, key, features), reach, step, describe_pass(kind, reach, step))
        for key, (kind, reach, step) in zip(keys, taps, strict=True)
    ]
    tiles = _list_tiles(*size) if form == "separable" and isinstance(size[0], int) else []
    outputs = engine.passes(passes, images, give_scalars(features), tiles=tiles, name=name)
    if not on_processor:
        beside = ["weight_sum", "effective_samples", *(["moment"] if moment else [])]
        names = [name, *(f"{name}_{ending}" for ending in [*beside, *(f"more{number}" for number in range(len(more)))])]
        text = "what the filter found"
        image, weight, effective, *others = engine.pixels(define_apart, outputs, {}, len(more), names=names, text=text)
        return FilterOutput(image, weight, effective, others[0] if moment else None, others[int(moment) :])
    return FilterOutput(more=[outputs.pop(f"filtered{number}") for number in range(len(more))], **outputs)


def describe_pass(taps: Taps, radius: int, step: int) -> str:
    """Return what a pass sums over."""
    size = 2 * radius + 1 if radius else 2 * ATROUS_RADIUS + 1
    return f"{taps.value} taps, {size} across" + (f", {step} pixels apart" if step > 1 else "")


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
