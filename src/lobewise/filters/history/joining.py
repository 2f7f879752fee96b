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
from lobewise.engine.numbers import make_single
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.glue import compute_support
from lobewise.records.frame import FloatArray


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
    is_black_beside: bool = False,
    names: Sequence[str] = (),
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
    is_black_beside : bool
        Whether nothing is scattered where no layer has light, so that these pixels need no support.
    names : sequence of str
        Names of the layers that lobes scattered, for recorded plans.
    """
    images: dict[str, Any] = {"exact": exact}
    for number, output in enumerate(outputs):
        images |= give_channels(f"mean{number}", output.image)
        images |= {f"weight{number}": output.weight_sum}
    images |= {f"variance{number}": variance for number, variance in enumerate(variances)}
    for number, (mask, albedo) in enumerate(lobes):
        images |= {f"effective{number}": outputs[number].effective_samples}
        images |= {f"mask{number}": mask, f"albedo{number}": albedo}
    image, holes, weight_sum, effective, *radiances = engine.pixels(
        define_joined,
        images,
        {},
        len(outputs),
        len(lobes),
        is_black_beside,
        names=[
            "",
            "holes",
            "weight_sum",
            "effective_samples",
            *["variance"] * bool(variances),
            *(f"{name}_part" for name in names),
        ],
        into=[engine.take("image", "height", "width", COLORS, text="the denoised frame", unit="any")],
        text="the sum of all light, and its holes",
    )
    variance = radiances.pop(0) if variances else None
    return JoinedLayers(image, tuple(radiances), weight_sum, effective, variance, holes)


def mark_reflecting(mask: NDArray[np.bool_], albedo: FloatArray | None, floor: float) -> NDArray[np.bool_]:
    """Return where pixels of a mask have an albedo with a channel above ``floor``; the mask itself without albedo."""
    if albedo is None:
        return mask
    images, text = {"mask": mask, "albedo": albedo}, "pixels that reflect light"
    (reflecting,) = engine.pixels(
        define_reflecting, images, {"floor": make_single(floor)}, names=["reflecting"], text=text
    )
    return reflecting


def define_reflecting(grid: Grid) -> list[Vector]:
    (floor,) = grid.get("floor")
    return [[hl.u8((grid.read_one("mask") != 0) & reduce(or_, (tint > floor for tint in grid.read("albedo"))))]]


def define_joined(grid: Grid, layers: int, lobes: int, is_black_beside: bool) -> list[Vector]:
    zero = hl.f32(0.0)
    means = [grid.read_channels(f"mean{number}") for number in range(layers)]
    total = [_add([mean[k] for mean in means]) for k in range(COLORS)]
    if grid.has("exact"):
        exact = grid.read("exact")
        good = expressions.is_good(exact)
        total = [value + hl.select(good, light, zero) for value, light in zip(total, exact, strict=True)]
    weights = [grid.read_one(f"weight{number}") for number in range(layers)]
    supported = reduce(or_, (weight > zero for weight in weights))
    if is_black_beside:
        supported = supported | ~reduce(or_, (grid.read_one(f"mask{number}") != 0 for number in range(lobes)))
    parts = []
    for mean in means[:lobes] if lobes > 1 else []:
        usable = expressions.is_good(mean)
        parts.append([hl.select(usable, value, zero) for value in mean])
    holes = hl.u8(~(supported & expressions.is_good(total)))
    support = [[value] for value in compute_support(grid, weights[:lobes])]
    if grid.has("variance0"):
        support.append([_add([grid.read_one(f"variance{number}") for number in range(layers)])])
    return [total, [holes], *support, *parts]


def _add(values: Sequence[hl.Expr]) -> hl.Expr:
    return sum(values[1:], values[0])
