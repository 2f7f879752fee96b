"""The light of a frame that is in none of its layers, and the sum of all light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lobewise import engine
from lobewise.chunks import cut_rows
from lobewise.filters.compositing import average_emission
from lobewise.filters.glue import define_composed
from lobewise.frame import FloatArray, Frame


def find_rest(frame: Frame) -> FloatArray | None:
    """Return what is in none of the parts of a frame (emission, background), finite and >= 0; None without parts."""
    if frame.radiance.parts is None:
        return None
    noisy = [layer.radiance for layer in frame.layers] or frame.radiance.parts
    rest, nothing = np.empty_like(frame.radiance.color), np.float32(0.0)
    for chunk in cut_rows(*frame.shape):  # a chunk stays in the core's cache
        here = rest[chunk]
        with np.errstate(invalid="ignore", over="ignore"):  # bad pixels are infinite or NaN until the end
            # A negative part is no light: subtracting it would add light that is not in the total.
            np.subtract(frame.radiance.color[chunk], np.maximum(noisy[0][chunk], nothing), out=here)
            for part in noisy[1:]:
                here -= np.maximum(part[chunk], nothing)
        np.fmax(here, nothing, out=here)
        here += nothing  # -0 becomes 0
        here[here > np.finfo(np.float32).max] = nothing
    return rest


def find_averaged_rest(frame: Frame) -> FloatArray | None:
    """Return what `find_rest` does, averaged with `GBuffer.mean_emission` where the frame has it."""
    rest, emission = find_rest(frame), frame.gbuffer.mean_emission
    return rest if rest is None or emission is None else average_emission(rest, emission, frame.spp)


def compose(parts: Sequence[FloatArray], rest: FloatArray | None) -> FloatArray:
    """Return the total: the filtered parts, and what was in none of them."""
    if rest is None and len(parts) == 1:
        return parts[0]
    images = {**{f"part{number}": part for number, part in enumerate(parts)}, "rest": rest}
    (total,) = engine.pixels(define_composed, images, {}, names=["total"], text="the sum of all light")
    return total
