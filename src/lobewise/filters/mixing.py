"""Several filtered images mixed pixel by pixel, in proportions that a small network reads off them.

Each candidate is a local average of its own; how noisy it is (its two halves differ), how far it is from the others
(one of them is biased) and what surface it shows tells which of them to trust. The proportions are a softmax, so the
mixture is a convex average again. Source of the idea: Kalantari, Bako and Sen 2015, "A Machine Learning Approach for
Filtering Monte Carlo Noise". Departs: what is predicted are shares of candidates, not parameters of one filter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend import expressions
from lobewise.backend.buffers import Image, lend, make_output, returns_host_images, take_image
from lobewise.backend.jit import get_kernel
from lobewise.errors import InputError, describe_problem
from lobewise.filters.cross_pass import find_luminance
from lobewise.filters.planes import begin_at_zero
from lobewise.filters.schedules.blocks import keep_planes, spread_channels
from lobewise.frame import FloatArray

COLORS = 3
BLUR = (1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0)
"""Binomial weights over which squares are averaged, in rows and in columns."""
STEPS = (1, 3)
"""Pixels from weight to weight of the averages, and of the averages of these: one is local, the other steady."""
REACH = len(BLUR) // 2 * sum(STEPS) + 1
"""Pixels to each side from which a pixel's proportions are read: the averages of averages of a slope."""
DARKEST = 0.05
"""Squares are relative to that of the local mean, and to this share of the whole mean."""
LEAST_SQUARE = 1e-8
LEAST_LIGHT = 1e-3
LEAK = 0.01
"""Slope of the network's units below 0."""
LAYERS = 3


class Network(NamedTuple):
    """A perceptron with two hidden layers, its inputs centred and scaled.

    Parameters
    ----------
    mean, scale : (inputs,)
        What is subtracted from the inputs, and what they are multiplied by then.
    weights : three arrays, (inputs, units), (units, units), (units, candidates)
    biases : three arrays, (units,), (units,), (candidates,)
    """

    mean: FloatArray
    scale: FloatArray
    weights: tuple[FloatArray, FloatArray, FloatArray]
    biases: tuple[FloatArray, FloatArray, FloatArray]


def count_features(candidates: int, extras: int) -> int:
    """Return how many inputs a network has for so many candidates and extras."""
    return len(STEPS) * (2 * candidates + 1) + extras


class _Funcs:
    """The scheduled functions: features alone, or what the network makes of them."""

    def __init__(self, target: hl.Target, candidates: int, middle: int, extras: int, units: tuple[int, ...]) -> None:
        x, y, c = hl.Var("x"), hl.Var("y"), hl.Var("c")
        lanes = target.natural_vector_size(hl.Float(32))
        images = [hl.ImageParam(hl.Float(32), 3, f"image{k}") for k in range(2 * candidates)]
        more = hl.ImageParam(hl.Float(32), 3, "more")
        for image, count in [*((image, COLORS) for image in images), (more, extras)]:
            image.dim(1).set_stride(count)
            begin_at_zero(image)
        floor, mean = hl.Param(hl.Float(32), "floor"), hl.Param(hl.Float(32), "mean")
        width, height = more.dim(1).extent(), more.dim(2).extent()
        at = hl.clamp(x, 0, width - 1), hl.clamp(y, 0, height - 1)

        # Luminance of every candidate's mean, and the squared difference of its halves, a quarter: its variance.
        light, spread = hl.Func("light"), hl.Func("spread")

        def read_pairs(column: hl.Expr, row: hl.Expr) -> list[list[list[hl.Expr]]]:
            found = [[image[i, column, row] for i in range(COLORS)] for image in images]
            return [found[2 * k : 2 * k + 2] for k in range(candidates)]

        pairs = read_pairs(*at)
        copies: list[hl.Func] = []
        if target.has_gpu_feature():
            # More images than a graphics card lets one kernel read: the halves of each candidate are put together.
            copies = [hl.Func(f"pair{k}") for k in range(candidates)]
            for k, copied in enumerate(copies):
                copied[x, c, y] = hl.mux(c, [*pairs[k][0], *pairs[k][1]])
                pairs[k] = [[copied[x, half * COLORS + i, y] for i in range(COLORS)] for half in range(2)]
        light[x, c, y] = hl.mux(
            c, [hl.f32(0.5) * find_luminance([p + q for p, q in zip(a, b, strict=True)]) for a, b in pairs]
        )
        spread[x, c, y] = hl.mux(
            c, [hl.f32(0.25) * find_luminance([(p - q) * (p - q) for p, q in zip(a, b, strict=True)]) for a, b in pairs]
        )
        others = [k for k in range(candidates) if k != middle]
        half = hl.f32(0.5)
        steps = [light[x, k, y] - light[x, middle, y] for k in others]
        slopes = (
            half * (light[x + 1, middle, y] - light[x - 1, middle, y]),
            half * (light[x, middle, y + 1] - light[x, middle, y - 1]),
        )
        squares = [spread[x, k, y] for k in range(candidates)]
        squares += [step * step for step in steps]
        squares += [slopes[0] * slopes[0] + slopes[1] * slopes[1], light[x, middle, y]]
        sharp = hl.Func("sharp")
        sharp[x, c, y] = hl.mux(c, squares)
        blurs: list[tuple[hl.Func, hl.Func]] = []
        source = sharp
        for step in STEPS:
            taps = [(step * k, hl.f32(weight)) for k, weight in enumerate(BLUR, start=-(len(BLUR) // 2))]
            rows, soft = hl.Func(f"rows{step}"), hl.Func(f"soft{step}")
            rows[x, c, y] = sum((weight * source[x + k, c, y] for k, weight in taps), hl.f32(0.0))
            soft[x, c, y] = sum((weight * rows[x, c, y + k] for k, weight in taps), hl.f32(0.0))
            blurs.append((rows, soft))
            source = soft
        values: list[hl.Expr] = []
        for _, soft in blurs:
            level = soft[x, len(squares) - 1, y]
            unit = hl.f32(1.0) / (level * level + floor)
            relative = [soft[x, k, y] * unit for k in range(len(squares) - 1)]
            values += [expressions.log2(hl.max(each, hl.f32(LEAST_SQUARE))) for each in relative]
            values.append(expressions.log2(hl.max(level / mean, hl.f32(LEAST_LIGHT))))
        values += [more[k, x, y] for k in range(extras)]
        features = hl.Func("features")
        features[x, c, y] = hl.mux(c, values)

        self.arguments: list[Any] = [*images, more, floor, mean]
        out = hl.Func("out")
        deep: list[tuple[hl.Func, int, hl.RDom | None]] = []
        if units:
            layer, width_before = features, len(values)
            vectors = [hl.ImageParam(hl.Float(32), 1, name) for name in ("centre", "scale")]
            self.arguments += vectors
            scaled = hl.Func("scaled")
            scaled[x, c, y] = (features[x, c, y] - vectors[0][c]) * vectors[1][c]
            layer = scaled
            deep.append((scaled, width_before, None))
            for number, count in enumerate((*units, candidates)):
                weights, bias = (
                    hl.ImageParam(hl.Float(32), 2, f"w{number}"),
                    hl.ImageParam(hl.Float(32), 1, f"b{number}"),
                )
                weights.dim(0).set_stride(1)
                self.arguments += [weights, bias]
                inputs = hl.RDom([(0, width_before)], f"r{number}")
                total, active = hl.Func(f"total{number}"), hl.Func(f"active{number}")
                total[x, c, y] = bias[c]
                total[x, c, y] = total[x, c, y] + weights[c, inputs.x] * layer[x, inputs.x, y]
                last = number == len(units)
                value = total[x, c, y]
                active[x, c, y] = value if last else hl.max(value, hl.f32(LEAK) * value)
                deep += [(total, count, inputs), (active, count, None)]
                layer, width_before = active, count
            scores = [layer[x, k, y] for k in range(candidates)]
            highest = scores[0]
            for score in scores[1:]:
                highest = hl.max(highest, score)
            share = hl.Func("share")
            share[x, c, y] = expressions.exp2(hl.f32(math.log2(math.e)) * (layer[x, c, y] - highest))
            deep.append((share, candidates, None))
            total_share = sum((share[x, k, y] for k in range(candidates)), hl.f32(0.0))
            mixed = []
            for i in range(COLORS):
                doubled = [a[i] + b[i] for a, b in (pairs if copies else read_pairs(x, y))]
                weighted = sum((share[x, k, y] * value for k, value in enumerate(doubled)), hl.f32(0.0))
                mixed.append(half * weighted / total_share)
            out[c, x, y] = hl.mux(c, mixed)
            channels = COLORS
        else:
            out[c, x, y] = features[x, c, y]
            channels = len(values)

        self.out = out
        if target.has_gpu_feature():
            thread = spread_channels(out, channels, (x, y, c))
            counts = [*((copied, 2 * COLORS) for copied in copies), (light, candidates), (spread, candidates)]
            counts.append((sharp, len(squares)))
            for func, count in (*counts, *((each, len(squares)) for pair in blurs for each in pair)):
                keep_planes(func, count, (x, y, c))
            keep_planes(features, len(values), (x, y, c))
            for func, count, _ in deep[1:]:
                func.compute_at(out, thread).bound(c, 0, count)
            return
        ys, yi, xo, xi, tail = hl.Var("ys"), hl.Var("yi"), hl.Var("xo"), hl.Var("xi"), hl.TailStrategy.GuardWithIf
        out.bound(c, 0, channels).reorder(c, x, y).unroll(c).split(y, ys, yi, 16, tail)
        out.split(x, xo, xi, lanes, tail).reorder(c, xi, xo, yi, ys).vectorize(xi).parallel(ys).never_partition_all()
        for func, count in ((light, candidates), (spread, candidates)):
            func.compute_at(out, ys).bound(c, 0, count).reorder_storage(x, c, y).reorder(c, x, y)
            func.vectorize(x, lanes).unroll(c).never_partition_all()
        for number, (rows, soft) in enumerate(blurs):
            rows.compute_at(out, ys).reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
            # What is averaged again is needed some rows away.
            soft.compute_at(out, yi if number == len(blurs) - 1 else ys)
            soft.reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
        sharp.compute_at(blurs[0][0], y).bound(c, 0, len(squares)).reorder_storage(x, c, y).reorder(c, x, y)
        sharp.vectorize(x, lanes).unroll(c)
        features.compute_at(out, xo).bound(c, 0, len(values)).reorder_storage(x, c, y).reorder(c, x, y)
        features.vectorize(x, lanes).unroll(c)
        for func, count, inputs in deep:
            func.compute_at(out, xo).bound(c, 0, count).reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
            if inputs is not None:
                func.update().reorder(x, inputs.x, c, y).vectorize(x, lanes)


def _require_whole(candidates: int, middle: int, extras: FloatArray) -> None:
    """Raise InputError unless there is a middle candidate and something else is known of every pixel."""
    if not 0 <= middle < candidates:
        raise InputError(
            describe_problem(
                "middle",
                expected="the index of a candidate",
                got=f"{middle} of {candidates}",
                action="count from 0, and give at least one candidate",
            )
        )
    if extras.ndim != 3 or extras.shape[2] < 1:
        raise InputError(
            describe_problem(
                "extras",
                expected="shape (height, width, count) with a count of at least 1",
                got=f"shape {extras.shape}",
                action="give zeros where nothing else is known",
            )
        )


def _require_fit(network: Network, inputs: int, candidates: int) -> None:
    """Raise InputError unless a network's arrays fit each other: the kernels read and write where shapes tell them."""
    sizes = [inputs, *(bias.size for bias in network.biases[:-1]), candidates]
    expected = [(inputs,), (inputs,), *pairwise(sizes), *((size,) for size in sizes[1:])]
    arrays = (network.mean, network.scale, *network.weights, *network.biases)
    if len(sizes) != LAYERS + 1 or 0 in sizes or [array.shape for array in arrays] != expected:
        raise InputError(
            describe_problem(
                "network",
                expected=f"{LAYERS} layers from {inputs} inputs to {candidates} outputs",
                got="arrays of shapes " + ", ".join(str(array.shape) for array in arrays),
                action="use one that was trained for these candidates and extras",
            )
        )


@returns_host_images
def _run(
    candidates: Sequence[tuple[Image, Image]],
    middle: int,
    extras: FloatArray,
    level: float,
    network: Network | None,
    device: str,
) -> Image:
    _require_whole(len(candidates), middle, extras)
    height, width, count = extras.shape
    channels = count_features(len(candidates), count)
    if network is not None:
        _require_fit(network, channels, len(candidates))
        channels = COLORS
    images = [take_image("candidate", half, (height, width, COLORS)) for pair in candidates for half in pair]
    units = tuple(len(bias) for bias in network.biases[:-1]) if network is not None else ()
    key = ("mixing", len(candidates), middle, count, units)
    kernel = get_kernel(device, key, lambda target: _Funcs(target, len(candidates), middle, count, units))
    held: list[Image] = [*images, take_image("extras", extras, extras.shape)]
    tail: list[NDArray[Any]] = []
    if network is not None:
        tail += [network.mean, network.scale]
        for weights, bias in zip(network.weights, network.biases, strict=True):
            tail += [weights, bias]
        tail = [np.ascontiguousarray(each, dtype=np.float32) for each in tail]
    level = max(level, 1e-30)
    buffer, mixed = make_output((height, width, channels), device)
    buffers = [lend(image, device) for image in held]
    numbers = [lend(each, device) for each in tail]
    kernel(*buffers, max((DARKEST * level) ** 2, 1e-37), level, *numbers, buffer)
    return mixed


def find_features(
    candidates: Sequence[tuple[Image, Image]],
    middle: int,
    extras: FloatArray,
    level: float,
    device: str = "cpu",
) -> Image:
    """Return what a network sees of every pixel, shape (height, width, `count_features`).

    In this order, all base-2 logarithms: variance of each candidate (a quarter of the squared difference of its
    halves), squared difference of each other candidate to the middle one, squared slope of the middle one, all
    averaged over `BLUR` and relative to the squared local mean; that mean over ``level``; the same of all that averaged
    once more, over weights further apart (`STEPS`); the extras as they are.

    Parameters
    ----------
    candidates : sequence of pairs of arrays, shape (height, width, 3)
        Both halves of each, over their albedo, finite, >= 0.
    middle : int
        Which candidate the others are compared with.
    extras : array, shape (height, width, count)
        What else is known, at least one number.
    level : float
        How bright the whole image is, of which this may be a part: about the mean luminance of a candidate.
    device : str
        A name from `list_devices`.

    Raises
    ------
    InputError
        If an array has none of these shapes, or ``middle`` is no candidate.
    """
    return _run(candidates, middle, extras, level, None, device)


def mix_candidates(
    candidates: Sequence[tuple[Image, Image]],
    middle: int,
    extras: FloatArray,
    level: float,
    network: Network,
    device: str = "cpu",
) -> Image:
    """Return the mixture of the candidates, shape (height, width, 3), its shares the network's softmax.

    Parameters
    ----------
    candidates, middle, extras, level, device
        As in `find_features`.
    network : Network
        With one input for each feature and one output for each candidate.

    Raises
    ------
    InputError
        If an array has none of these shapes, or ``middle`` is no candidate.
    """
    return _run(candidates, middle, extras, level, network, device)
