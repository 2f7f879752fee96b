"""The light of a frame that is in none of its layers, and the sum of all light."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise import engine
from lobewise.filters.compositing import average_emission
from lobewise.filters.glue import define_composed, define_good, define_rest
from lobewise.records.frame import FloatArray, Frame


def compute_rest(frame: Frame) -> FloatArray | None:
    """Return what is in none of the parts of a frame (emission, background), finite and >= 0; None without parts.

    A negative part is no light: subtracting it would add light that is not in the total.
    """
    if frame.radiance.parts is None:
        return None
    noisy = [layer.radiance for layer in frame.layers] or frame.radiance.parts
    images = {"color": frame.radiance.color, **{f"noisy{number}": part for number, part in enumerate(noisy)}}
    (rest,) = engine.pixels(define_rest, images, {}, names=["rest"], text="emission and background")
    return rest


def compute_averaged_rest(frame: Frame, exact: FloatArray | None = None) -> FloatArray | None:
    """Return what `compute_rest` does, averaged with `GBuffer.mean_emission` where the frame has it.

    ``exact`` is the light in no layer, (height, width, 3), if it is known apart.
    """
    if exact is not None:
        text = "emission and background, which are not filtered"
        (good,) = engine.pixels(define_good, {"image": exact}, {}, names=["rest"], text=text)
        return good
    rest, emission = compute_rest(frame), frame.gbuffer.mean_emission
    return rest if rest is None or emission is None else average_emission(rest, emission, frame.spp)


def compose(parts: Sequence[FloatArray], rest: FloatArray | None) -> FloatArray:
    """Return the total: the filtered parts, and what was in none of them."""
    if rest is None and len(parts) == 1:
        return parts[0]
    images = {**{f"part{number}": part for number, part in enumerate(parts)}, "rest": rest}
    (total,) = engine.pixels(define_composed, images, {}, names=["total"], text="the sum of all light")
    return total
