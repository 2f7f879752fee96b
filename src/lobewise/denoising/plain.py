"""The sum of layers that were filtered by their guides alone, as the quality "fast" and histories do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.pointwise import give_channels
from lobewise.denoising.layers import Layer
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.glue import define_filtered_sum
from lobewise.records.frame import FloatArray, Frame


class FilteredSum(NamedTuple):
    """The layers of a frame after one pass, and their sum.

    Parameters
    ----------
    layers, outputs : sequences
        The layers, and what the filter made of them.
    image : (height, width, 3)
        Sum of all parts and of the light that is in none of them.
    holes : (height, width), bool
        Pixels without a value: not finite or negative, or bad and reached by no layer.
    parts : sequence of (height, width, 3)
        Filtered radiance of every layer, albedo included; the noisy radiance where nothing was gathered.
    weight_sum, effective_samples : (height, width)
        Those of the least supported layer that reflects anything at a pixel.
    """

    layers: Sequence[Layer]
    outputs: Sequence[FilterOutput]
    image: FloatArray
    holes: NDArray[np.bool_]
    parts: Sequence[FloatArray]
    weight_sum: FloatArray
    effective_samples: FloatArray


def add_up(
    frame: Frame,
    layers: Sequence[Layer],
    outputs: Sequence[FilterOutput],
    bad: NDArray[np.bool_],
    exact: FloatArray | None = None,
) -> FilteredSum:
    """Return the sum of filtered layers, in one pass over memory.

    Parameters
    ----------
    frame : Frame
    layers, outputs : sequences
        The layers, and what the filter made of them.
    bad : (height, width), bool
        Pixels whose radiance is NaN, infinite or negative.
    exact : (height, width, 3), optional
        The light in no layer, without noise; by default what the layers leave of all light.
    """
    images: dict[str, Any] = {"bad": bad}
    for number, (layer, output) in enumerate(zip(layers, outputs, strict=True)):
        images |= {f"noisy{number}": layer.radiance, f"weight{number}": output.weight_sum}
        images |= give_channels(f"image{number}", output.image)
        if len(layers) > 1 or frame.radiance.parts is not None:
            images |= {f"effective{number}": output.effective_samples, f"mask{number}": layer.mask}
            images |= {f"albedo{number}": layer.albedo}
    # Emission and background are in no layer. They are not filtered.
    if exact is not None:
        images["exact"] = exact
    elif frame.radiance.parts is not None:
        images["color"] = frame.radiance.color
    image, holes, *joined = engine.pixels(
        define_filtered_sum,
        images,
        {},
        len(layers),
        names=["", "holes", "weight_sum", "effective_samples", *(f"{layer.name}_part" for layer in layers)],
        into=[engine.take("image", "height", "width", 3, text="the denoised frame", unit="any")],
        text="the sum of all light, and its holes",
    )
    weight_sum, effective, *parts = joined or (outputs[0].weight_sum, outputs[0].effective_samples, image)
    return FilteredSum(layers, outputs, image, holes, parts, weight_sum, effective)
