"""Join the layers of a sparse frame, pixel by pixel, in one pass over memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, give_channels
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.glue import find_support
from lobewise.frame import FloatArray


@dataclass(frozen=True)
class JoinedLayers:
    """The sum of all layers, and how well it is supported.

    Parameters
    ----------
    image : array, shape (height, width, 3)
        Sum of all layers and of the exact light.
    parts : tuple of array, shape (height, width, 3)
        The layers that lobes scattered, 0 where a layer is not finite or negative; empty if there is only one.
    weight_sum, effective_samples : array, shape (height, width)
        Those of the least supported layer that reflects anything at a pixel.
    variance : array, shape (height, width), or None
        Sum of the layers' variances, if they were given.
    holes : bool array, shape (height, width)
        Pixels that no sample supports, or whose sum is not finite or negative.
    """

    image: FloatArray
    parts: tuple[FloatArray, ...]
    weight_sum: FloatArray
    effective_samples: FloatArray
    variance: FloatArray | None
    holes: NDArray[np.bool_]


def join_layers(
    outputs: Sequence[FilterOutput],
    lobes: Sequence[tuple[NDArray[np.bool_], FloatArray | None]],
    *,
    variances: Sequence[FloatArray] = (),
    exact: FloatArray | None = None,
    reflecting: NDArray[np.bool_] | None = None,
) -> JoinedLayers:
    """Return the sum of the layers of a frame.

    Parameters
    ----------
    outputs : sequence of FilterOutput
        One for each layer; the layers that lobes scattered come first.
    lobes : sequence of (mask, albedo)
        Pixels that have the light of a layer, and its albedo or None, for each layer that lobes scattered.
    variances : sequence of array, shape (height, width)
        Variance of the luminance of each layer; none if it is not known.
    exact : array, shape (height, width, 3), optional
        Light without noise that is added; pixels that are not finite or negative add nothing.
    reflecting : bool array, shape (height, width), optional
        Where it is False nothing is scattered, so that the pixel needs no support.
    """
    images: dict[str, Any] = {"exact": exact, "reflecting": reflecting}
    for number, output in enumerate(outputs):
        images |= give_channels(f"mean{number}", output.image)
        images |= {f"weight{number}": output.weight_sum}
    images |= {f"variance{number}": variance for number, variance in enumerate(variances)}
    for number, (mask, albedo) in enumerate(lobes):
        images |= {f"effective{number}": outputs[number].effective_samples}
        images |= {f"mask{number}": mask, f"albedo{number}": albedo}
    told = engine.pixels(define_joined, images, {}, len(outputs), len(lobes))
    image, holes, weight_sum, effective, *more = told
    variance = more.pop(0) if variances else None
    return JoinedLayers(image, tuple(more), weight_sum, effective, variance, holes)


def find_reflecting(mask: NDArray[np.bool_], albedo: FloatArray | None, floor: float) -> NDArray[np.bool_]:
    """Return where pixels of a mask have an albedo with a channel above ``floor``; the mask itself without albedo."""
    if albedo is None:
        return mask
    (found,) = engine.pixels(define_reflecting, {"mask": mask, "albedo": albedo}, {"floor": np.float32(floor)})
    return np.asarray(found)


def define_reflecting(grid: Grid) -> list[Vector]:
    (floor,) = grid.get("floor")
    return [[hl.u8((grid.read_one("mask") != 0) & reduce(or_, (tint > floor for tint in grid.read("albedo"))))]]


def define_joined(grid: Grid, layers: int, lobes: int) -> list[Vector]:
    zero = hl.f32(0.0)
    means = [grid.read_channels(f"mean{number}") for number in range(layers)]
    total = [_add([mean[k] for mean in means]) for k in range(COLORS)]
    if grid.has("exact"):
        exact = grid.read("exact")
        good = expressions.is_good(exact)
        total = [value + hl.select(good, more, zero) for value, more in zip(total, exact, strict=True)]
    weights = [grid.read_one(f"weight{number}") for number in range(layers)]
    supported = reduce(or_, (weight > zero for weight in weights))
    if grid.has("reflecting"):
        supported = supported | (grid.read_one("reflecting") == 0)
    parts = []
    for mean in means[:lobes] if lobes > 1 else []:
        usable = expressions.is_good(mean)
        parts.append([hl.select(usable, value, zero) for value in mean])
    holes = hl.u8(~(supported & expressions.is_good(total)))
    support = [[value] for value in find_support(grid, weights[:lobes])]
    if grid.has("variance0"):
        support.append([_add([grid.read_one(f"variance{number}") for number in range(layers)])])
    return [total, [holes], *support, *parts]


def _add(values: Sequence[hl.Expr]) -> hl.Expr:
    return sum(values[1:], values[0])
