"""The pyramid of filters whose weights the refining network predicts.

A pixel of a level becomes a weighted mean of its noisy 5x5 neighbours, its filtered 3x3 neighbours and the 3x3 pixels
of the level above around its parent. A learned weight is multiplied by the similarity of place, normal and lobe. Every
pixel of the finest level has a source weight, by which it counts for others; a pixel of a higher level is the weighted
mean of four. Light is divided by the albedo before, and multiplied by it after, as far as the network trusts the albedo
of a pixel. Sources: Bako et al. 2017, "Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings";
Vogels et al. 2018, "Denoising with Kernel Prediction and Asymmetric Loss Functions"; Balint et al. 2023, "Neural
Partitioning Pyramids for Denoising Monte Carlo Renderings".
"""

from __future__ import annotations

import math

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.pointwise import LARGEST_FLOAT
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y, clamp_likely
from lobewise.filters.refinement.convolutions import Size, keep_copy, surround
from lobewise.filters.refinement.shape import (
    BLOCK_OUTPUTS,
    COARSE_SIDE,
    FILTERED_SIDE,
    GROUPS,
    HEAD,
    LAYERS,
    NOISY_SIDE,
    UNITS,
    VECTORS,
    WEIGHT_ROWS,
)
from lobewise.filters.scheduling import count_lanes, spread_channels, spread_pixels

MAX_LOGIT = 20.0
"""Bound of the natural logarithm of a learned weight, on both sides."""
MAX_LOG_EXPONENT = 3.0
"""Largest natural logarithm of the exponent of a similarity."""
MIN_SOURCE = 1e-3
"""Smallest source weight."""
SOURCE_BIAS, TRUST_BIAS = 2.0, 4.0
"""Added before the logistic functions, so that an untrained source weight, or trust in the albedo, is near 1."""
SUMS_OF_IMAGE = COLORS + 1
"""Weighted light and weight of the noisy image; the filtered image has as many."""
FILTER_STRIP_ROWS, LOGITS_TOGETHER = 8, 8
"""Rows that a thread of a processor takes at a time, and logits of one vector whose sums it keeps in registers."""


def make_sums(target: hl.Target) -> Scheduled:
    """Return the kernel of the finest level's sums: weighted light and weight of the noisy image, then the filtered."""
    # Signature
    signature = Signature("sums of the refining network")
    features = signature.image("features", "height", UNITS[0], "columns")
    light = signature.image("light", "height", 2 * COLORS, "width")
    tint = signature.image("tint", "height", "width", COLORS)
    weights = signature.image("weights", WEIGHT_ROWS, BLOCK_OUTPUTS)
    brightness = signature.number("brightness")
    signature.output("sums", "height", 2 * SUMS_OF_IMAGE, "columns")

    # Algorithm
    logits = _define_logits(features, weights, hl.i32(LAYERS["heads.0"].start))
    light_near, tinted, sums = hl.Func("light_near"), hl.Func("tint_near"), hl.Func("sums")
    x = clamp_likely(X, light.dim(0).extent())
    light_near[X, C, Y], tinted[X, C, Y] = light[x, C, Y], tint[C, x, Y]
    values: list[hl.Expr] = []
    for number in range(2):
        logit = logits[X, HEAD.sources + number, Y] + hl.f32(SOURCE_BIAS)
        weight = hl.f32(MIN_SOURCE) + _compute_logistic(logit)
        for k in range(COLORS):
            change = tinted[X, k, Y] / _compute_trusted_tint(tinted[X, k, Y], brightness, logits)
            values.append(weight * change * light_near[X, COLORS * number + k, Y])
        values.append(weight)
    sums[X, C, Y] = hl.mux(C, values)

    # Schedule
    if target.has_gpu_feature():
        _spread_logits(logits, sums, spread_channels(sums, 2 * SUMS_OF_IMAGE))
    else:
        lanes = count_lanes(target)
        strip, vector = _spread_vectors(sums, 2 * SUMS_OF_IMAGE, lanes, hl.TailStrategy.RoundUp)
        logits.compute_at(sums, vector).reorder_storage(X, C, Y).reorder(X, C, Y).vectorize(X, lanes).unroll(C)
        logits.update().reorder(X, C, *logits.rvars(), Y).vectorize(X, lanes).unroll(C)
        for func, channels in ((light_near, 2 * COLORS), (tinted, COLORS)):
            keep_copy(func, channels, (sums, strip), lanes)
    return Scheduled([sums], signature)


def make_averages(target: hl.Target) -> Scheduled:
    """Return the kernel of the next level's sums or vectors: means of four pixels; pixels outside count 0."""
    # Signature
    signature = Signature("averages of the refining network")
    source = signature.image("source", "source_height", "channels", "source_columns")
    source_width = signature.count("source_width", 1)
    signature.output("averages", "height", "channels", "columns")

    # Algorithm
    averages, total, height = hl.Func("averages"), hl.f32(0.0), source.dim(2).extent()
    for down in range(2):
        for across in range(2):
            x, y = 2 * X + across, 2 * Y + down
            value = source[hl.min(hl.likely(x), source_width - 1), C, hl.min(y, height - 1)]
            total = total + hl.select((x < source_width) & (y < height), value, hl.f32(0.0))
    averages[X, C, Y] = hl.f32(0.25) * total

    # Schedule
    if target.has_gpu_feature():
        spread_pixels(averages.reorder(X, Y, C), X, Y)
        averages.gpu_blocks(C)
    else:
        averages.reorder(X, C, Y).vectorize(X, count_lanes(target), hl.TailStrategy.RoundUp).parallel(Y)
        averages.never_partition([Y, C])
    return Scheduled([averages], signature)


def make_filter(target: hl.Target) -> Scheduled:
    """Return the kernel that filters a level. ``has_above`` is 1 if there is a level above, else 0."""
    # Signature
    signature = Signature("filter of the refining network")
    features = signature.image("features", "height", "units", "columns")
    sums = signature.image("sums", "height", 2 * SUMS_OF_IMAGE, "sums_columns")
    vectors = signature.image("vectors", "height", VECTORS, "vectors_columns")
    above = signature.image("above", "above_height", "above_width", COLORS)
    tint = signature.image("tint", "tint_height", "tint_width", COLORS)
    weights = signature.image("weights", WEIGHT_ROWS, BLOCK_OUTPUTS)
    start, width = signature.count("start", 0, WEIGHT_ROWS - 1), signature.count("width", 1)
    has_above, brightness = signature.count("has_above", 0, 1), signature.number("brightness")
    signature.output("filtered", "height", "width", COLORS)

    # Algorithm
    size = Size(features.dim(2).extent(), width)
    logits = _define_logits(features, weights, start)
    light, compared = surround(sums, size, "sums_near"), surround(vectors, size, "vectors_near")
    larger, tinted, out = _enlarge_above(above, has_above), hl.Func("tint_near"), hl.Func("filtered")
    tinted[X, C, Y] = tint[C, clamp_likely(X, tint.dim(1).extent()), hl.min(Y, tint.dim(2).extent() - 1)]
    exponents = _define_exponents(logits)
    total = _define_total(logits, exponents, light, compared, larger)
    mean = hl.mux(C, [total[X, Y][k] / total[X, Y][COLORS] for k in range(COLORS)])
    out[C, X, Y] = hl.min(mean * _compute_trusted_tint(tinted[X, C, Y], brightness, logits), hl.f32(LARGEST_FLOAT))

    # Schedule
    exponents.bound(C, 0, len(GROUPS))
    if target.has_gpu_feature():
        thread = spread_channels(out, COLORS)
        _spread_logits(logits, out, thread)
        exponents.compute_at(out, thread).unroll(C)
        total.compute_at(out, thread)
        return Scheduled([out], signature)
    lanes = count_lanes(target)
    strip, vector = _spread_vectors(out, COLORS, lanes, hl.TailStrategy.GuardWithIf)
    co, ci = hl.Var("co"), hl.Var("ci")
    for stage in (logits.compute_at(out, vector).reorder_storage(X, C, Y), logits.update()):
        stage.split(C, co, ci, LOGITS_TOGETHER).vectorize(X, lanes).unroll(ci)
    logits.reorder(X, ci, co, Y)
    logits.update().reorder(X, ci, *logits.rvars(), co, Y)
    exponents.compute_at(out, vector).reorder_storage(X, C, Y).reorder(C, X, Y).vectorize(X, lanes).unroll(C)
    total.compute_at(out, vector).vectorize(X, lanes)
    for number in range(total.num_update_definitions()):
        total.update(number).reorder(X, *total.rvars(number), Y).vectorize(X, lanes)
    for func, channels in ((light, 2 * SUMS_OF_IMAGE), (compared, VECTORS), (larger, SUMS_OF_IMAGE), (tinted, COLORS)):
        keep_copy(func, channels, (out, strip), lanes)
    return Scheduled([out], signature)


def _spread_vectors(out: hl.Func, channels: int, lanes: int, tail: hl.TailStrategy) -> tuple[hl.Var, hl.Var]:
    """Run strips of rows in parallel, and all channels of a vector together. Return both loops."""
    ys, yi, xo, xi = (hl.Var(name) for name in ("ys", "yi", "xo", "xi"))
    out.bound(C, 0, channels).split(Y, ys, yi, FILTER_STRIP_ROWS, hl.TailStrategy.GuardWithIf)
    out.split(X, xo, xi, lanes, tail).reorder(C, xi, xo, yi, ys)
    out.vectorize(xi).unroll(C).parallel(ys).never_partition_all()
    return ys, xo


def _spread_logits(logits: hl.Func, out: hl.Func, thread: hl.Var) -> None:
    """On graphics cards compute the logits of a pixel in its thread."""
    logits.compute_at(out, thread).update().reorder(C, *logits.rvars(), X, Y)


def _define_logits(features: hl.ImageParam, weights: hl.ImageParam, start: hl.Expr) -> hl.Func:
    """Return the convolution that gives the logits of a pixel; ``start`` is the first row of its weights."""
    channels, sums = features.dim(1).extent(), hl.Func("logits")
    row = start + C // BLOCK_OUTPUTS * (1 + channels)
    taps = hl.RDom([(0, channels)], "units")
    sums[X, C, Y] = weights[C % BLOCK_OUTPUTS, row]
    sums[X, C, Y] = sums[X, C, Y] + weights[C % BLOCK_OUTPUTS, row + 1 + taps.x] * features[X, taps.x, Y]
    return sums


def _compute_logistic(value: hl.Expr) -> hl.Expr:
    """Return ``1 / (1 + exp(-value))``."""
    small = expressions.exp2(hl.f32(-expressions.LOG2_E) * hl.abs(value))
    high = hl.f32(1.0) / (hl.f32(1.0) + small)
    return hl.select(value >= hl.f32(0.0), high, small * high)


def _compute_trusted_tint(tint: hl.Expr, brightness: hl.Expr, logits: hl.Func) -> hl.Expr:
    """Return the tint, times the brightness of the image, as far as the network trusts it at a pixel."""
    trust = _compute_logistic(logits[X, HEAD.trust, Y] + hl.f32(TRUST_BIAS))
    return brightness + trust * (tint - brightness)


def _define_total(logits: hl.Func, exponents: hl.Func, light: hl.Func, compared: hl.Func, larger: hl.Func) -> hl.Func:
    """Return the sums of weighted light and weight over all taps."""
    total = hl.Func("total")
    total[X, Y] = hl.Tuple([hl.f32(0.0)] * SUMS_OF_IMAGE)
    for number, (side, first) in enumerate(((NOISY_SIDE, HEAD.noisy), (FILTERED_SIDE, HEAD.filtered))):
        taps = hl.RDom([(0, side), (0, side)], f"taps{number}")
        x, y = X + taps.x - side // 2, Y + taps.y - side // 2
        distance = _compute_distance(exponents, compared, (x, y))
        weight = _compute_weight(logits[X, first + taps.y * side + taps.x, Y], distance)
        _add(total, [weight * light[x, SUMS_OF_IMAGE * number + k, y] for k in range(SUMS_OF_IMAGE)])
    taps = hl.RDom([(0, COARSE_SIDE), (0, COARSE_SIDE)], "taps_above")
    # The pixels around a pixel's parent are two columns or rows apart in the enlarged level.
    x, y = X + 2 * (taps.x - 1), Y + 2 * (taps.y - 1)
    weight = _compute_weight(logits[X, HEAD.coarse + taps.y * COARSE_SIDE + taps.x, Y], hl.f32(0.0))
    _add(total, [weight * larger[x, k, y] for k in range(SUMS_OF_IMAGE)])
    return total


def _add(total: hl.Func, terms: list[hl.Expr]) -> None:
    total[X, Y] = hl.Tuple([total[X, Y][k] + term for k, term in enumerate(terms)])


def _compute_weight(logit: hl.Expr, distance: hl.Expr) -> hl.Expr:
    """Return ``exp(logit - distance)``, all divided by ``exp(MAX_LOGIT)``: only the ratios of weights count."""
    bounded = hl.clamp(logit, hl.f32(-MAX_LOGIT), hl.f32(MAX_LOGIT))
    return expressions.exp2(hl.f32(expressions.LOG2_E) * (bounded - distance - hl.f32(MAX_LOGIT)))


def _define_exponents(logits: hl.Func) -> hl.Func:
    exponents = hl.Func("exponents")
    bounded = hl.min(hl.f32(2.0) * logits[X, HEAD.exponents + C, Y] - hl.f32(1.0), hl.f32(MAX_LOG_EXPONENT))
    shifted = expressions.exp2(hl.f32(expressions.LOG2_E) * (bounded - hl.f32(MAX_LOG_EXPONENT)))
    exponents[X, C, Y] = hl.f32(math.exp(MAX_LOG_EXPONENT)) * shifted
    return exponents


def _compute_distance(exponents: hl.Func, vectors: hl.Func, at: tuple[hl.Expr, hl.Expr]) -> hl.Expr:
    """Return the sum of squared distances of the vectors of two pixels, each group times its exponent."""
    total, first = hl.f32(0.0), 0
    for number, count in enumerate(GROUPS):
        steps = [vectors[X, k, Y] - vectors[at[0], k, at[1]] for k in range(first, first + count)]
        total = total + exponents[X, number, Y] * sum((step * step for step in steps), hl.f32(0.0))
        first += count
    return total


def _enlarge_above(above: hl.ImageParam, has_above: hl.Expr) -> hl.Func:
    """Return the light of the level above at every pixel, and 1 as its weight; 0 outside that level."""
    near, width, height = hl.Func("above_near"), above.dim(1).extent(), above.dim(2).extent()
    # Halide's division rounds down, so that columns left of the image have a parent left of the level above.
    x, y = X // 2, Y // 2
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (has_above > 0)
    values = [above[k, clamp_likely(x, width), hl.clamp(y, 0, height - 1)] for k in range(COLORS)]
    near[X, C, Y] = hl.select(inside, hl.mux(C, [*values, hl.f32(1.0)]), hl.f32(0.0))
    return near
