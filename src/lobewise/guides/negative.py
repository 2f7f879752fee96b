"""Light below 0, which is split off a frame, filtered apart and subtracted from the result.

Colours outside of the gamut have a negative channel. Pixel filters with negative lobes (Lanczos, Mitchell, Blackman)
ring below 0 beside lamps. Both is light: without it edges get brighter and colours paler. Estimates of noise, networks
and Open Image Denoise know no light below 0. So a frame is the difference of two frames that are nowhere negative. The
second is mostly smooth and dim, and is then filtered by the guides alone (docs/developers/decisions.md). Lamps that
take light away make it bright. Then it has highlights and noise, and is filtered as other light is.

A pixel far below everything around it is no light but damage, as of an overflow. It stays negative, and filters leave
it out. What a renderer's rounding leaves below 0 becomes 0: half of Blender's frames with glass have some.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.engine.rows import list_rows
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.radiance import Radiance, RadianceLayer
from lobewise.records.sparse_frame import AnyFrame, SparseFrame

NEGATIVE_REACH = 2
"""Distance of the farthest pixel that decides whether a pixel is damaged, rows or columns."""
MAX_RATIO_BELOW = 4.0
"""Largest negative light of a pixel, over the second largest light around it and over its own light, that is no damage.
The largest light around is ignored, because damaged pixels may come in pairs."""
MAX_ROUNDING = 2.0**-20
"""Largest light below 0, over the largest channel of the pixel's color, that is rounding; Blender has up to 2^-23."""
MAX_DIM_SHARE = 0.01
"""Largest light below 0, as a share of the light of a frame, that is dim."""
_PARTS = ("diffuse", "specular", "direct", "indirect")

Split = tuple[FloatArray, FloatArray]


class _Nothing(NamedTuple):
    """What counts as no light below 0.

    Parameters
    ----------
    rounding : (height, width, 1)
        Largest light below 0 that is rounding.
    image : (height, width, 3)
        The light below 0 of every image that has none. All of them share it, so that it takes no memory.
    """

    rounding: FloatArray
    image: FloatArray

    def get_image(self, shape: tuple[int, ...]) -> FloatArray:
        """Return the light below 0 of an image of a shape that has none."""
        return self.image if self.image.shape == shape else np.zeros(shape, np.float32)


def split_negative(frame: AnyFrame) -> tuple[Any, Any]:
    """Return a frame without light below 0, and a frame of this light, >= 0; the second is None where there is none.

    The difference of both is the frame, but for rounding (`MAX_ROUNDING`). Damaged pixels stay in the first. Where the
    frame has halves, so do both: the light of a half may be below 0 where the mean of both halves is not.
    ``unscattered`` stays as it is.
    """
    if not any(map(_is_below, _list_light(frame))):
        return frame, None
    color = frame.radiance.color
    rounding = np.float32(MAX_ROUNDING) * np.where(np.isfinite(color), color, np.float32(0.0)).max(
        axis=-1, keepdims=True
    )
    nothing = _Nothing(rounding, _keep(np.zeros(color.shape, np.float32)))
    first: AnyFrame
    second: AnyFrame
    if isinstance(frame, SparseFrame):
        above, below = _split_radiance(frame.radiance, nothing)
        first, second = replace(frame, radiance=above), replace(frame, radiance=below, variance=None)
    else:
        first, second = _split_frame(frame, nothing)
    return first, second if any(image.any() for image in _list_light(second) if image is not nothing.image) else None


def _split_frame(frame: Frame, nothing: _Nothing) -> tuple[Frame, Frame]:
    halves = [None if half is None else _split_radiance(half, nothing) for half in (frame.half_a, frame.half_b)]
    layers = [_split_layer(layer, nothing) for layer in frame.layers]
    below_halves = [half[1] for half in halves if half is not None]
    above, below = _split_radiance(frame.radiance, nothing, below_halves if len(below_halves) == 2 else (), layers)
    also = _split_all(frame.also, nothing)
    first = replace(
        frame,
        radiance=above,
        half_a=halves[0] and halves[0][0],
        half_b=halves[1] and halves[1][0],
        layers=tuple(layer for layer, _ in layers),
        also=also[0],
    )
    second = replace(
        frame,
        radiance=below,
        half_a=None,
        half_b=None,
        variance=None,
        layers=tuple(layer for _, layer in layers),
        unscattered={},
        also=also[1],
    )
    return first, second


def is_dim(below: Frame, above: Frame) -> bool:
    """Return whether the light below 0 of a frame is dim beside its other light; see `split_negative`."""
    return not describe_bright([sum_below(below, above)])


def sum_below(below: Frame | None, above: Frame, rows: slice = slice(None)) -> NDArray[np.float64]:
    """Return the light of some rows that is below 0, and the light that is not, (2,)."""
    colors = [np.zeros(1) if frame is None else frame.radiance.color[rows] for frame in (below, above)]
    return np.array([np.sum(color, where=np.isfinite(color), dtype=np.float64) for color in colors])


def describe_bright(sums: Sequence[NDArray[np.float64]]) -> tuple[str, ...]:
    """Return what a user should know where bands filter bright light below 0; ``sums`` are those of `sum_below`."""
    dark, bright = np.sum([np.zeros(2), *sums], axis=0)
    if dark <= MAX_DIM_SHARE * bright:
        return ()
    share = 100.0 * dark / bright
    return (
        f"Light below 0 is {share:.2g} % of the light. Bands filter it by the guides alone: --bands off is better.",
    )


def mark_damaged(image: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels of an image, (height, width, 3), are so far below 0 that they are damage, (height, width)."""
    damaged = np.zeros(image.shape[:2], np.bool_)
    if not (image < 0.0).any():
        return damaged
    # Channel by channel: NumPy is several times slower over a last axis of three.
    channels = [np.where(np.isfinite(one), one, np.float32(0.0)) for one in np.moveaxis(image, -1, 0)]
    below, above = -reduce(np.minimum, channels), reduce(np.maximum, channels)
    doubtful = below > np.float32(MAX_RATIO_BELOW) * np.maximum(above, np.float32(0.0))
    if not doubtful.any():
        return damaged
    light = np.pad(np.maximum(below, above), NEGATIVE_REACH)
    rows, columns = np.nonzero(doubtful)
    steps = range(2 * NEGATIVE_REACH + 1)
    around = [light[rows + y, columns + x] for y in steps for x in steps if (y, x) != (NEGATIVE_REACH, NEGATIVE_REACH)]
    damaged[rows, columns] = below[doubtful] > MAX_RATIO_BELOW * np.sort(np.array(around), axis=0)[-2]
    return damaged


def _list_light(frame: AnyFrame) -> list[FloatArray]:
    """Return all images whose light is filtered."""
    parts: list[Radiance | None] = [frame.radiance]
    images: list[FloatArray | None] = []
    if isinstance(frame, Frame):
        parts += [frame.half_a, frame.half_b]
        for layer in frame.layers:
            images += [layer.radiance, layer.half_a, layer.half_b, *layer.parts.values()]
        images += frame.also.values()
    images += [getattr(part, name) for part in parts if part is not None for name in part.names]
    return [image for image in images if image is not None]


def _is_below(image: FloatArray, *rounding: FloatArray) -> bool:
    """Return whether any light of an image is below 0, or below minus ``rounding``, (height, width, 1)."""
    return any((light < (-least[0] if least else 0.0)).any() for light, *least in list_rows(image, *rounding))


def _keep(image: FloatArray) -> FloatArray:
    """Return an image that is read-only, which frames keep without a copy."""
    image.flags.writeable = False
    return image


def _split_image(image: FloatArray, nothing: _Nothing, below: Sequence[FloatArray] = ()) -> Split:
    """Return an image without light below 0, and this light where it is more than rounding.

    ``below`` is the light below 0 of both of the image's halves.
    """
    if not any(each.any() for each in below):
        below = ()
        if not _is_below(image):
            return image, nothing.get_image(image.shape)
        if not _is_below(image, nothing.rounding):
            return _keep(np.maximum(image, np.float32(0.0))), nothing.get_image(image.shape)
    least = np.mean(below, axis=0, dtype=np.float32) if below else np.float32(0.0)
    with np.errstate(invalid="ignore"):
        damaged = mark_damaged(image)[..., None] & (image < -nothing.rounding).any(axis=-1, keepdims=True)
        known = np.isfinite(image) & ~damaged
        taken = np.where(known, np.maximum(-image, least), np.float32(0.0))
    if not taken.any():
        return image, nothing.get_image(image.shape)
    return _keep(image + taken), _keep(np.where(taken > nothing.rounding, taken, np.float32(0.0)))


def _split_all(
    images: Mapping[str, FloatArray], nothing: _Nothing
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    splits = {name: _split_image(image, nothing) for name, image in images.items()}
    return {name: above for name, (above, _) in splits.items()}, {name: below for name, (_, below) in splits.items()}


def _split_radiance(
    radiance: Radiance,
    nothing: _Nothing,
    halves: Sequence[Radiance] = (),
    layers: Sequence[tuple[RadianceLayer, RadianceLayer]] = (),
) -> tuple[Radiance, Radiance]:
    """Return radiance without light below 0, and this light: the total has that of its parts, so that sums hold."""
    splits: dict[str, Split] = {}
    for name in (name for name in _PARTS if getattr(radiance, name) is not None):
        below = [getattr(half, name) for half in halves if getattr(half, name) is not None]
        mine = [layer.radiance for _, layer in layers if layer.is_diffuse == (name == "diffuse")]
        if name in _PARTS[:2] and mine:
            below = [reduce(np.add, mine)]
        splits[name] = _split_image(getattr(radiance, name), nothing, below)
    if radiance.parts is None:
        splits["color"] = _split_image(radiance.color, nothing, [half.color for half in halves])
    else:
        splits["color"] = _split_image(radiance.color, nothing, [splits["diffuse"][1] + splits["specular"][1]])
    first, second = ({name: pair[side] for name, pair in splits.items()} for side in (0, 1))
    return Radiance(**first), Radiance(**second)


def _split_layer(layer: RadianceLayer, nothing: _Nothing) -> tuple[RadianceLayer, RadianceLayer]:
    halves = [None if half is None else _split_image(half, nothing) for half in (layer.half_a, layer.half_b)]
    below = [half[1] for half in halves if half is not None]
    first, second = _split_image(layer.radiance, nothing, below if len(below) == 2 else ())
    parts = _split_all(layer.parts, nothing)
    above_a, above_b = (None if half is None else half[0] for half in halves)
    return (
        replace(layer, radiance=first, half_a=above_a, half_b=above_b, parts=parts[0]),
        replace(layer, radiance=second, half_a=None, half_b=None, parts=parts[1]),
    )
