"""Small steps of recipes, pixel by pixel, between the kernels of the filters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from itertools import product
from operator import add, and_, or_

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import LARGEST_FLOAT, Grid, Vector, is_finite, select_bits, select_or_nan
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS


def define_bad(grid: Grid) -> list[Vector]:
    """Return where a pixel of any image is NaN, infinite or negative; see `mark_bad_pixels`."""
    return [[hl.u8(~reduce(and_, (is_good(grid.read(name)) for name in grid.images)))]]


def define_unmatched(grid: Grid, longest: float, least: float) -> list[Vector]:
    """Return the holes, and pixels of several surfaces that no sample matches; see `mark_unmatched`."""
    square = reduce(add, (value * value for value in grid.read("mean_normal")))
    is_mixed = (square > hl.f32(0.0)) & (square < hl.f32(longest**2))
    return [[hl.u8((grid.read_one("holes") != 0) | (is_mixed & (grid.read_one("weight") < hl.f32(least))))]]


def define_common_mask(grid: Grid) -> list[Vector]:
    """Return where all masks hold."""
    return [[hl.u8(reduce(and_, (grid.read_one(name) != 0 for name in grid.images)))]]


def define_apart(grid: Grid, count: int) -> list[Vector]:
    """Return the light of ``pixels``, the numbers beside it, and ``count`` further lights, each as an image."""
    values = grid.read("pixels")
    own = len(values) - count * COLORS
    lights = (values[first : first + COLORS] for first in range(own, len(values), COLORS))
    return [values[:COLORS], *([value] for value in values[COLORS:own]), *lights]


def read_parts(grid: Grid, prefix: str) -> list[Vector]:
    names = [f"{prefix}{number}" for number in range(len(grid.images))]
    return [grid.read_channels(name) for name in names if name in grid.images or f"{name}_channel0" in grid.images]


def read_rest(grid: Grid) -> Vector:
    """Return the light that is in none of the parts ``noisy0`` and so on of ``color``; see `compute_rest`."""
    zero = hl.f32(0.0)
    rest = grid.read("color")
    for part in read_parts(grid, "noisy"):
        rest = [value - _clamp_light(light) for value, light in zip(rest, part, strict=True)]
    good = [(value > zero) & (value <= hl.f32(LARGEST_FLOAT)) for value in rest]
    return [hl.select(known, value, zero) for known, value in zip(good, rest, strict=True)]


def _clamp_light(value: hl.Expr) -> hl.Expr:
    """Return 0 for a negative value; NaN stays, as with `numpy.maximum`."""
    return hl.select(value < hl.f32(0.0), hl.f32(0.0), value)


def define_rest(grid: Grid) -> list[Vector]:
    """Return the light of ``color`` that is in none of the parts."""
    return [read_rest(grid)]


def define_filtered_sum(grid: Grid, count: int) -> list[Vector]:
    """Return the sum of filtered layers and of the light in none of them, its holes, its support, and its parts.

    A part is the filtered radiance, or the noisy one where nothing was gathered. Support and parts come only if there
    are several layers, or light beside one.
    """
    parts = [keep_unfiltered(grid, number) for number in range(count)]
    total: Vector = reduce(add_colors, parts)
    if grid.has("exact"):
        exact = grid.read("exact")
        total = add_colors(total, [hl.select(is_good(exact), value, hl.f32(0.0)) for value in exact])
    elif grid.has("color"):
        total = add_colors(total, read_rest(grid))
    weights = [grid.read_one(f"weight{number}") for number in range(count)]
    untouched = reduce(and_, (weight <= hl.f32(0.0) for weight in weights))
    outputs = [total, [hl.u8(~is_good(total) | ((grid.read_one("bad") != 0) & untouched))]]
    if count > 1:
        outputs += [[value] for value in compute_support(grid, weights)]
    elif grid.has("exact") or grid.has("color"):
        outputs += [weights, [grid.read_one("effective0")]]
    return outputs + (parts if len(outputs) > 2 else [])


def keep_unfiltered(grid: Grid, number: int) -> Vector:
    """Return a layer's filtered radiance, or the noisy one where nothing was gathered; NaN where that is bad too."""
    noisy, lost = grid.read(f"noisy{number}"), grid.read_one(f"weight{number}") <= hl.f32(0.0)
    good = is_good(noisy)
    pairs = zip(noisy, grid.read_channels(f"image{number}"), strict=True)
    return [select_bits(lost, select_or_nan(good, raw), value) for raw, value in pairs]


def add_colors(first: Vector, second: Vector) -> list[hl.Expr]:
    """Return the sum of two colours."""
    return [a + b for a, b in zip(first, second, strict=True)]


def define_support(grid: Grid, count: int) -> list[Vector]:
    """Return weight sum and effective samples of the least supported of ``count`` layers; see `compute_support`."""
    supports = [grid.read(f"support{number}") for number in range(count)]
    weights, samples = ([support[k] for support in supports] for k in range(2))
    return [[value] for value in compute_support(grid, weights, samples)]


def compute_support(grid: Grid, weights: Sequence[hl.Expr], samples: Sequence[hl.Expr] | None = None) -> list[hl.Expr]:
    """Return weight sum and effective samples of the least supported layer that reflects anything at a pixel.

    Where no layer's lobe reflects (a light, the background) those of the first layer count.
    """
    samples = samples or [grid.read_one(f"effective{number}") for number in range(len(weights))]
    total, effective = weights[0], samples[0]
    known = _is_reflecting(grid, 0)
    for number, weight in enumerate(weights[1:], 1):
        here = _is_reflecting(grid, number)
        weaker = here & (~known | (weight < total))
        total = hl.select(weaker, weight, total)
        effective = hl.select(weaker, samples[number], effective)
        known = known | here
    return [total, effective]


def _is_reflecting(grid: Grid, number: int) -> hl.Expr:
    """Return whether a layer's lobe reflects more than `ALBEDO_FLOOR` of the light; everywhere without albedo."""
    there = grid.read_one(f"mask{number}") != 0
    if not grid.has(f"albedo{number}"):
        return there
    return there & reduce(or_, (tint > hl.f32(ALBEDO_FLOOR) for tint in grid.read(f"albedo{number}")))


def define_emptied(grid: Grid) -> list[Vector]:
    """Return an image that is NaN in its holes, and a mask of all pixels."""
    known = grid.read_one("holes") == 0
    return [[select_or_nan(known, value) for value in grid.read("image")], [hl.u8(1)]]


def define_refilled(grid: Grid) -> list[Vector]:
    """Return an image with filled holes, and the holes that are left; see `refill`."""
    hole = grid.read_one("holes") != 0
    reached = hole & (grid.read_one("weight") > hl.f32(0.0))
    values = zip(grid.read("image"), grid.read("filled"), strict=True)
    image = [select_bits(reached, filled, value) for value, filled in values]
    return [image, [hl.u8(hole & ~(grid.read_one("weight") > hl.f32(0.0)))]]


def define_patched(grid: Grid) -> list[Vector]:
    """Return an image with a colour in its holes."""
    hole = grid.read_one("holes") != 0
    pairs = zip(grid.read("image"), grid.get("mean"), strict=True)
    return [[select_bits(hole, mean, value) for value, mean in pairs]]


def define_tinted(grid: Grid, most: float) -> list[Vector]:
    """Return light, and its parts times the albedo at the pixel's centre over that of its area; see `tint_radiance`."""
    total, parts = grid.read("color"), []
    for number in range(2):
        old, mean = grid.read(f"part{number}"), grid.read(f"mean{number}")
        tinted = []
        for value, albedo, area in zip(old, grid.read(f"albedo{number}"), mean, strict=True):
            ratio = albedo / hl.max(area, hl.f32(ALBEDO_FLOOR))
            known = (area > hl.f32(ALBEDO_FLOOR)) & (ratio > hl.f32(0.0))
            tinted.append(value * hl.select(known, hl.min(ratio, hl.f32(most)), hl.f32(1.0)))
        parts.append(tinted)
        total = [value - untinted for value, untinted in zip(total, old, strict=True)]
    return [reduce(add_colors, [total, *parts]), *parts]


def define_good(grid: Grid) -> list[Vector]:
    """Return an image with 0 where a pixel is not finite or negative; see `blacken_bad`."""
    value = grid.read_channels("image")
    good = is_good(value)
    return [[hl.select(good, channel, hl.f32(0.0)) for channel in value]]


def define_whole_albedo(grid: Grid, least: float) -> list[Vector]:
    """Return the albedo of all light; see `compute_whole_albedo`."""
    known: Sequence[Vector] = [grid.read(name) for name in grid.images]
    albedo = reduce(add_colors, known)
    bound = hl.f32(least)
    # NumPy's maximum of channels is NaN where one is, and then counts as black.
    finite = reduce(and_, (~_is_nan(value) for value in albedo))
    bright = finite & (hl.max(*albedo) > bound)
    return [[hl.select(bright, hl.select(value > bound, value, bound), hl.f32(1.0)) for value in albedo]]


def _is_nan(value: hl.Expr) -> hl.Expr:
    return ~is_finite(value) & ~(hl.abs(value) > hl.f32(LARGEST_FLOAT))


def define_mean(grid: Grid) -> list[Vector]:
    """Return the mean of the images ``a`` and ``b``."""
    half = hl.f32(0.5)
    return [[half * p + half * q for p, q in zip(grid.read("a"), grid.read("b"), strict=True)]]


def define_joined_halves(grid: Grid) -> list[Vector]:
    """Return the mean of both halves and the light of highlights; see `join_halves`."""
    (mean,) = define_mean(grid)
    if grid.has("kept"):
        mean = add_colors(mean, grid.read("kept"))
    return [mean]


def define_joined_colours(grid: Grid) -> list[Vector]:
    """Return the image of both colours of a checkerboard, ``a`` and ``b``, and the light of highlights."""
    pairs = zip(grid.read("a"), grid.read("b"), strict=True)
    joined = [select_bits(_is_nan(even), odd, even) for even, odd in pairs]
    if grid.has("kept"):
        joined = add_colors(joined, grid.read("kept"))
    return [joined]


def define_lit(grid: Grid) -> list[Vector]:
    """Return where a layer has light that anything supports."""
    return [[hl.u8((grid.read_one("mask") != 0) & (grid.read("support")[0] > hl.f32(0.0)))]]


def define_with_highlights(grid: Grid) -> list[Vector]:
    """Return an image plus the light of highlights where there is light."""
    lit = grid.read_one("lit") != 0
    pairs = zip(grid.read("image"), grid.read("kept"), strict=True)
    return [[select_bits(lit, value + highlight, value) for value, highlight in pairs]]


def define_composed(grid: Grid) -> list[Vector]:
    """Return the sum of the parts ``part0`` and so on and of ``rest``; see `compose`."""
    parts = read_parts(grid, "part")
    if grid.has("rest"):
        parts.append(grid.read("rest"))
    return [reduce(add_colors, parts)]


def define_checked(grid: Grid) -> list[Vector]:
    """Return an image, and its holes: not finite or negative, or bad and not supported by ``support0`` and so on."""
    image = grid.read("image")
    supports = [name for name in grid.images if name.startswith("support")]
    untouched = reduce(and_, (grid.read(name)[0] <= hl.f32(0.0) for name in supports))
    return [image, [hl.u8(~is_good(image) | ((grid.read_one("bad") != 0) & untouched))]]


def define_channel(grid: Grid, number: int) -> list[Vector]:
    """Return one channel of an image."""
    return [[grid.read("image")[number]]]


def define_share_taken(grid: Grid, most: float) -> list[Vector]:
    """Return the share of the noisy image that is taken back: the network's, as far as it is trusted; see
    `estimate_share_lost`."""
    zero, color = hl.f32(0.0), grid.read("color")
    share = hl.select(is_good(color), grid.read("shares")[0], zero)
    dim = reduce(and_, (value < hl.f32(most) for value in color))
    return [[hl.select(dim, grid.get("trust")[0] * share, zero)]]


def define_mixed(grid: Grid) -> list[Vector]:
    """Return a part mixed with its noisy light; where the mixture is not finite, the part."""
    share = grid.read_one("share")
    mixed = [
        part + share * (_clamp_light(noisy) - part)
        for part, noisy in zip(grid.read("part"), grid.read("noisy"), strict=True)
    ]
    is_mixed = share > hl.f32(0.0)
    pairs = zip(mixed, grid.read("part"), strict=True)
    return [[select_bits(is_finite(value) & is_mixed, value, part) for value, part in pairs]]


def define_brightened(grid: Grid) -> list[Vector]:
    """Return an image plus the gain of a part's light; see `brighten`."""
    gain = hl.select(grid.read_one("mask") != 0, grid.get("gain")[0], hl.f32(0.0))
    return [[value + part * gain for value, part in zip(grid.read("image"), grid.read("part"), strict=True)]]


def define_smooth(grid: Grid) -> list[Vector]:
    """Return the mean of an image over 3x3 pixels, weighted by a Gaussian of their differences from the middle one.

    The number "deviation" is that of the Gaussian.

    Source: Tomasi and Manduchi 1998, "Bilateral Filtering for Gray and Color Images", equations 5 and 6.
    """
    read = grid.keep(grid.read("image", *grid.inside))
    own = read(grid.x, grid.y)
    total, weights = [hl.f32(0.0) for _ in own], hl.f32(0.0)
    steepness = hl.f32(-0.5 * math.log2(math.e)) / (grid.get("deviation")[0] * grid.get("deviation")[0])
    for down, across in product((-1, 0, 1), repeat=2):
        near = read(grid.x + across, grid.y + down)
        apart = reduce(add, ((there - here) * (there - here) for there, here in zip(near, own, strict=True)))
        weight = expressions.exp2(steepness * apart)
        total = [so_far + weight * there for so_far, there in zip(total, near, strict=True)]
        weights += weight
    return [[value / weights for value in total]]
