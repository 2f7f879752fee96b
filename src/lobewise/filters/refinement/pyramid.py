"""The pyramid of filters whose weights the refining network predicts.

A pixel of a level becomes a weighted mean of its noisy 5x5 neighbours, its filtered 3x3 neighbours and the 3x3 pixels
of the level above around its parent. A learned weight is multiplied by the similarity of place, normal and lobe. Every
pixel of the finest level has a source weight, by which it counts for others; a pixel of a higher level is the weighted
mean of four. Sources: Bako et al. 2017, "Kernel-Predicting Convolutional Networks for Denoising Monte Carlo
Renderings"; Vogels et al. 2018, "Denoising with Kernel Prediction and Asymmetric Loss Functions"; Balint et al. 2023,
"Neural Partitioning Pyramids for Denoising Monte Carlo Renderings".
"""

from __future__ import annotations

import math
from typing import NamedTuple

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y
from lobewise.filters.refinement.convolutions import Convolution, Input, Network, Size, define_convolution, surround
from lobewise.filters.refinement.shape import (
    COARSE_SIDE,
    FILTERED_SIDE,
    GROUPS,
    LEVELS,
    NOISY_SIDE,
    UNITS,
    place_logits,
)

MAX_LOGIT = 20.0
"""Bound of the natural logarithm of a learned weight, on both sides."""
MAX_LOG_EXPONENT = 3.0
"""Largest natural logarithm of the exponent of a similarity."""
MIN_SOURCE = 1e-3
"""Smallest source weight."""
SOURCE_BIAS = 2.0
"""Added before the logistic function, so that an untrained source weight is near 1."""
SUMS = COLORS + 1
"""Weighted light and weight of the noisy image; the filtered image has as many."""


class Filter(NamedTuple):
    """The filter of one level.

    Parameters
    ----------
    head : Convolution
        Gives the logits.
    near : tuple of Input
        What taps read, 0 outside the level: sums of light, vectors, and the level above.
    exponents : halide.Func
        Factors of the squared distances of each group of vectors, a function of (x, c, y).
    total : halide.Func
        Tuple of the sums, a function of (x, y).
    domains : list of halide.RDom
        Of the taps of each kind.
    out : halide.Func
        The filtered light of the level, a function of (x, c, y).
    """

    head: Convolution
    near: tuple[Input, ...]
    exponents: hl.Func
    total: hl.Func
    domains: list[hl.RDom]
    out: hl.Func


class Pyramid(NamedTuple):
    """The functions of the pyramid.

    Parameters
    ----------
    light : Input
        Noisy and filtered light, 0 outside the image.
    sources : Convolution
        The head of the finest level, which gives the source weights.
    sums, vectors : list of halide.Func
        Of each level. The vectors of the finest level are a copy of the input, which the level above averages.
    filters : list of Filter
        Of each level.
    """

    light: Input
    sources: Convolution
    sums: list[hl.Func]
    vectors: list[hl.Func]
    filters: list[Filter]


def define_pyramid(network: Network, light: hl.ImageParam, vectors: hl.ImageParam) -> Pyramid:
    """Return the pyramid.

    Parameters
    ----------
    network : Network
    light : halide.ImageParam
        Noisy and filtered light over the tint, a function of (x, c, y).
    vectors : halide.ImageParam
        What similarities compare, a function of (x, c, y).
    """
    weights, sizes = network.weights, network.sizes
    head = define_convolution(
        weights, "heads.0", 0, [Input(network.features[0], UNITS[0], is_copy=False)], active=False
    )
    given = Input(surround(light, sizes[0], "light"), 2 * COLORS)
    sums, compared = [_define_sums(given.func, head.out)], [surround(vectors, sizes[0], "below")]
    for level in range(1, LEVELS):
        sums.append(_average(sums[-1], sizes[level - 1], sizes[level], f"sums{level}"))
        compared.append(_average(compared[-1], sizes[level - 1], sizes[level], f"vectors{level}"))
    filters: list[Filter] = []
    for level in reversed(range(LEVELS)):
        above = filters[0].out if filters else None
        near = surround(compared[level] if level else vectors, sizes[level], f"vectors{level}")
        filters.insert(0, _define_filter(network, level, sums[level], near, above))
    return Pyramid(given, head, sums, compared, filters)


def _define_sums(light: hl.Func, logits: hl.Func) -> hl.Func:
    """Return weighted light and weight of the noisy image, then of the filtered one."""
    sums, place = hl.Func("sums0"), place_logits(0).sources
    values: list[hl.Expr] = []
    for number in range(2):
        logit = logits[X, place + number, Y] + hl.f32(SOURCE_BIAS)
        weight = hl.f32(MIN_SOURCE) + _find_logistic(logit)
        values += [weight * light[X, COLORS * number + k, Y] for k in range(COLORS)] + [weight]
    sums[X, C, Y] = hl.mux(C, values)
    return sums


def _find_logistic(value: hl.Expr) -> hl.Expr:
    """Return ``1 / (1 + exp(-value))``."""
    small = expressions.exp2(hl.f32(-expressions.LOG2_E) * hl.abs(value))
    high = hl.f32(1.0) / (hl.f32(1.0) + small)
    return hl.select(value >= hl.f32(0.0), high, small * high)


def _average(source: hl.Func, before: Size, size: Size, name: str) -> hl.Func:
    """Return the mean of four pixels of the level below; pixels outside count 0."""
    found = hl.Func(name)
    total = hl.f32(0.0)
    for down in range(2):
        for across in range(2):
            x, y = 2 * X + across, 2 * Y + down
            value = source[hl.min(x, before.width - 1), C, hl.min(y, before.height - 1)]
            total = total + hl.select((x < before.width) & (y < before.height), value, hl.f32(0.0))
    found[X, C, Y] = hl.f32(0.25) * total
    return found


def _define_filter(network: Network, level: int, sums: hl.Func, compared: hl.Func, above: hl.Func | None) -> Filter:
    size, places = network.sizes[level], place_logits(level)
    head = define_convolution(
        network.weights,
        f"heads.{level}",
        level,
        [Input(network.features[level], UNITS[level], is_copy=False)],
        active=False,
    )
    light = surround(sums, size, f"light{level}")
    near = [Input(light, 2 * SUMS), Input(compared, sum(GROUPS))]
    total = hl.Func(f"total{level}")
    total[X, Y] = hl.Tuple([hl.f32(0.0)] * SUMS)
    exponents, domains = _define_exponents(head.out, level), []
    for number, (side, first) in enumerate(((NOISY_SIDE, places.noisy), (FILTERED_SIDE, places.filtered))):
        taps = hl.RDom([(0, side), (0, side)], f"taps{level}_{number}")
        x, y = X + taps.x - side // 2, Y + taps.y - side // 2
        distance = _find_distance(exponents, compared, (x, y))
        weight = _find_weight(head.out[X, first + taps.y * side + taps.x, Y], distance)
        _add(total, [weight * light[x, SUMS * number + k, y] for k in range(SUMS)])
        domains.append(taps)
    if above is not None:
        larger = _enlarge_above(above, network.sizes[level + 1], f"above{level}")
        near.append(Input(larger, SUMS))
        taps = hl.RDom([(0, COARSE_SIDE), (0, COARSE_SIDE)], f"taps{level}_above")
        # The pixels around a pixel's parent are two columns or rows apart in the enlarged level.
        x, y = X + 2 * (taps.x - 1), Y + 2 * (taps.y - 1)
        weight = _find_weight(head.out[X, places.coarse + taps.y * COARSE_SIDE + taps.x, Y], hl.f32(0.0))
        _add(total, [weight * larger[x, k, y] for k in range(SUMS)])
        domains.append(taps)
    out = hl.Func(f"filtered{level}")
    out[X, C, Y] = hl.mux(C, [total[X, Y][k] / total[X, Y][COLORS] for k in range(COLORS)])
    return Filter(head, tuple(near), exponents, total, domains, out)


def _add(total: hl.Func, terms: list[hl.Expr]) -> None:
    total[X, Y] = hl.Tuple([total[X, Y][k] + term for k, term in enumerate(terms)])


def _find_weight(logit: hl.Expr, distance: hl.Expr) -> hl.Expr:
    """Return ``exp(logit - distance)``, all divided by ``exp(MAX_LOGIT)``: only the ratios of weights count."""
    bounded = hl.clamp(logit, hl.f32(-MAX_LOGIT), hl.f32(MAX_LOGIT))
    return expressions.exp2(hl.f32(expressions.LOG2_E) * (bounded - distance - hl.f32(MAX_LOGIT)))


def _define_exponents(logits: hl.Func, level: int) -> hl.Func:
    found, first = hl.Func(f"exponents{level}"), place_logits(level).exponents
    bounded = hl.min(hl.f32(2.0) * logits[X, first + C, Y] - hl.f32(1.0), hl.f32(MAX_LOG_EXPONENT))
    shifted = expressions.exp2(hl.f32(expressions.LOG2_E) * (bounded - hl.f32(MAX_LOG_EXPONENT)))
    found[X, C, Y] = hl.f32(math.exp(MAX_LOG_EXPONENT)) * shifted
    return found


def _find_distance(exponents: hl.Func, vectors: hl.Func, at: tuple[hl.Expr, hl.Expr]) -> hl.Expr:
    """Return the sum of squared distances of the vectors of two pixels, each group times its exponent."""
    total, first = hl.f32(0.0), 0
    for number, count in enumerate(GROUPS):
        steps = [vectors[X, k, Y] - vectors[at[0], k, at[1]] for k in range(first, first + count)]
        total = total + exponents[X, number, Y] * sum((step * step for step in steps), hl.f32(0.0))
        first += count
    return total


def _enlarge_above(above: hl.Func, size: Size, name: str) -> hl.Func:
    """Return the light of the level above at every pixel, and 1 as its weight; 0 outside that level."""
    found = hl.Func(name)
    # Halide's division rounds down, so that columns left of the image have a parent left of the level above.
    x, y = X // 2, Y // 2
    inside = (x >= 0) & (x < size.width) & (y >= 0) & (y < size.height)
    column, row = hl.clamp(x, 0, size.width - 1), hl.clamp(y, 0, size.height - 1)
    values = [above[column, k, row] for k in range(COLORS)]
    found[X, C, Y] = hl.select(inside, hl.mux(C, [*values, hl.f32(1.0)]), hl.f32(0.0))
    return found
