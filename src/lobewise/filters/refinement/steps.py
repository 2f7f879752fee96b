"""Small steps before and after the refining network, pixel by pixel."""

from __future__ import annotations

import math
from functools import reduce
from operator import or_

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.filters.cross_pass import compute_expression_luminance
from lobewise.filters.glue import add_colors, read_parts


def _sum_good(parts: list[Vector]) -> Vector:
    """Return the sum of colours, finite and >= 0; bad ones count as black."""
    total = reduce(add_colors, map(_blacken, parts))
    return [hl.max(value, hl.f32(0.0)) for value in _blacken(total)]


def _blacken(colour: Vector) -> Vector:
    good = is_good(colour)
    return [hl.select(good, value, hl.f32(0.0)) for value in colour]


def _read_finite(grid: Grid, name: str) -> Vector:
    return [hl.select(is_finite(value), value, hl.f32(0.0)) for value in grid.read(name)]


def define_inputs(grid: Grid, least: float) -> list[Vector]:
    """Return what the refining network reads; see `lobewise.denoising.refining.inputs.collect_inputs`.

    Noisy and filtered light come first, then those of albedo, normal, depth, roughness, specular share and change that
    the images tell. ``least`` is the smallest sum of luminances of albedos that the share is told of.
    """
    zero = hl.f32(0.0)
    noisy, parts = read_parts(grid, "noisy"), read_parts(grid, "part")
    if grid.has("rest"):
        rest = grid.read("rest")
        noisy, parts = [*noisy, rest], [*parts, rest]
    filtered, samples = _sum_good(parts), reduce(add_colors, noisy)
    good = is_good(samples)
    pairs = zip(samples, filtered, strict=True)
    planes: list[Vector] = [[hl.select(good, hl.max(value, zero), other) for value, other in pairs], filtered]
    albedos = [_read_finite(grid, name) for name in ("diffuse", "specular") if grid.has(name)]
    if albedos:
        planes.append([hl.clamp(value, zero, hl.f32(1.0)) for value in reduce(add_colors, albedos)])
    if grid.has("normal"):
        planes.append(_read_finite(grid, "normal"))
    if grid.has("depth"):
        planes.append(_read_finite(grid, "depth"))
    widths = [_read_finite(grid, name)[0] for name in ("alpha_u", "alpha_v") if grid.has(name)]
    if widths:
        planes.append(widths if len(widths) == 1 else [hl.sqrt(hl.max(widths[0] * widths[1], zero))])
    if len(albedos) == 2:
        first, second = (compute_expression_luminance([hl.max(value, zero) for value in albedo]) for albedo in albedos)
        planes.append([second / hl.max(first + second, hl.f32(least))])
    if grid.has("half_a", "half_b"):
        pairs = zip(grid.read("half_a"), grid.read("half_b"), strict=True)
        planes.append(_blacken([hl.abs(hl.f32(0.5) * (a - b)) for a, b in pairs]))
    return planes


def define_known_lobes(grid: Grid, least: float) -> list[Vector]:
    """Return axis and base-2 logarithm of the sharpness of lobes, 0 where there is none; see `compute_lobes`."""
    sharpness = grid.read_one("sharpness")
    known = (grid.read_one("valid") != 0) & is_finite(sharpness)
    # Without a logarithm of a number that is not finite.
    safe = hl.select(known, hl.max(sharpness, hl.f32(least)), hl.f32(1.0))
    axis = [hl.select(known, value, hl.f32(0.0)) for value in grid.read_channels("axis")]
    return [axis, [hl.log(safe) * hl.f32(1.0 / math.log(2.0))]]


def define_refined(grid: Grid, most: float) -> list[Vector]:
    """Return the parts of a frame and its other light, scaled as the network has refined their sum.

    Light up to ``most`` counts as black and stays so. Pixels outside of the mask ``refined`` are not changed.
    """
    changed = grid.read_one("refined") != 0
    factors = []
    for after, before in zip(grid.read("image"), grid.read("filtered"), strict=True):
        lit = before > hl.f32(most)
        factor = hl.select(lit, after / hl.select(lit, before, hl.f32(1.0)), hl.f32(0.0))
        factors.append(hl.select(changed, factor, hl.f32(1.0)))
    refined: list[Vector] = [
        [value * factor for value, factor in zip(part, factors, strict=True)] for part in read_parts(grid, "part")
    ]
    if grid.has("rest"):
        refined.append([value * factor for value, factor in zip(grid.read("rest"), factors, strict=True)])
    return refined


def define_shining(grid: Grid) -> list[Vector]:
    """Return which pixels have more light that no surface scatters than other light."""
    red, green, blue = grid.read("rest")
    scattered = _sum_good(read_parts(grid, "part"))
    return [[hl.u8(red + green + blue > scattered[0] + scattered[1] + scattered[2])]]


def define_any(grid: Grid) -> list[Vector]:
    """Return where any mask is set, and the mask ``without`` is not."""
    there = reduce(or_, (grid.read_one(name) != 0 for name in grid.images if name != "without"))
    if grid.has("without"):
        there = there & (grid.read_one("without") == 0)
    return [[hl.u8(there)]]


def define_widened(grid: Grid, pixels: int) -> list[Vector]:
    """Return a mask that is so many pixels wider in all eight directions."""
    steps, (width, height) = range(-pixels, pixels + 1), grid.size
    read = grid.keep(grid.read("mask", *grid.inside))
    # A pixel beyond the border is the nearest one inside, which is in the square anyway.
    row = [read(hl.clamp(grid.x + step, 0, width - 1), grid.y)[0] for step in steps]
    along = grid.keep([reduce(or_, row)])
    return [[reduce(or_, [along(grid.x, hl.clamp(grid.y + step, 0, height - 1))[0] for step in steps])]]
