"""The kernel that mixes candidates: the features of every pixel, the network, the mixture.

`lobewise.filters.mixing` describes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import COLORS, find_luminance
from lobewise.filters.planes import C, X, Y

BLUR = (1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0)
"""Binomial weights of five taps, applied along rows and then along columns."""
STEPS = (1, 3)
"""Pixels between the taps of the first average, and of the second, which averages the first: less local, less noisy."""
REACH = len(BLUR) // 2 * sum(STEPS) + 1
"""Distance of the farthest pixel that affects a pixel: both averages, and the difference that a slope takes."""
MIN_RELATIVE_SQUARE = 1e-8
"""Smallest squared difference over the squared local mean that a logarithm distinguishes."""
MIN_RELATIVE_LIGHT = 1e-3
"""Smallest local mean over the image's mean that a logarithm distinguishes."""
LEAK = 0.01
"""Slope of the activation of hidden units below 0 (leaky ReLU)."""


def count_features(candidates: int, extras: int) -> int:
    """Return the number of a network's inputs."""
    return len(STEPS) * (2 * candidates + 1) + extras


@dataclass(frozen=True)
class MixingKey:
    """Everything that changes the kernel's code."""

    candidates: int
    middle: int
    extras: int
    units: tuple[int, ...]
    """Sizes of the hidden layers; empty if the kernel writes the features themselves."""

    @property
    def squares(self) -> int:
        """Channels that are averaged: squared differences, and last the luminance of the middle candidate."""
        return 2 * self.candidates + 1

    @property
    def features(self) -> int:
        """Number of the network's inputs."""
        return count_features(self.candidates, self.extras)

    @property
    def channels(self) -> int:
        """Channels of the output."""
        return COLORS if self.units else self.features


Pair = tuple[Sequence[hl.Expr], Sequence[hl.Expr]]
"""The colours of both halves of a candidate."""


class Blur(NamedTuple):
    """An average along rows, and its average along columns."""

    rows: hl.Func
    soft: hl.Func


class Stage(NamedTuple):
    """A step of the network."""

    func: hl.Func
    channels: int
    inputs: hl.RDom | None = None
    """Domain of the step's sum, if it sums."""


@dataclass(frozen=True, kw_only=True)
class MixingFuncs:
    """The functions of the kernel."""

    key: MixingKey
    signature: Signature
    copies: list[hl.Func]
    """Both halves of each candidate in one function, on graphics cards."""
    light: hl.Func
    spread: hl.Func
    sharp: hl.Func
    blurs: list[Blur]
    features: hl.Func
    network: list[Stage]
    out: hl.Func


def make_mixing(key: MixingKey, *, together: bool) -> MixingFuncs:
    """Return the kernel that writes the features, or the mixture that the network predicts from them.

    ``together`` puts both halves of a candidate into one function: a graphics card lets a kernel read few images.
    """
    signature = Signature("mixing")
    size = "height", "width"
    images = [[signature.image(f"candidate{k}_{half}", *size, COLORS) for half in "ab"] for k in range(key.candidates)]
    signature.output("mixed", *size, key.channels)
    extras = signature.image("extras", *size, key.extras)
    floor, level = signature.number("floor"), signature.number("level")
    width, height = extras.dim(1).extent(), extras.dim(2).extent()

    def read_pairs(x: hl.Expr, y: hl.Expr) -> list[Pair]:
        return [([a[i, x, y] for i in range(COLORS)], [b[i, x, y] for i in range(COLORS)]) for a, b in images]

    pairs = read_pairs(hl.clamp(X, 0, width - 1), hl.clamp(Y, 0, height - 1))
    copies: list[hl.Func] = []
    if together:
        copies = [hl.Func(f"pair{k}") for k in range(key.candidates)]
        for copied, (a, b) in zip(copies, pairs, strict=True):
            copied[X, C, Y] = hl.mux(C, [*a, *b])
        pairs = [_read_copy(copied) for copied in copies]
    light, spread = _define_light(pairs)
    sharp = _define_squares(key, light, spread)
    blurs = _define_blurs(sharp)
    features = _define_features(key, extras, (floor, level), [soft for _, soft in blurs])
    out = hl.Func("out")
    network: list[Stage] = []
    if key.units:
        network = define_network(signature, features, (key.features, *key.units, key.candidates))
        mixed = _mix(network[-1].func, pairs if together else read_pairs(X, Y))
        out[C, X, Y] = hl.mux(C, mixed)
    else:
        out[C, X, Y] = features[X, C, Y]
    return MixingFuncs(
        key=key,
        signature=signature,
        copies=copies,
        light=light,
        spread=spread,
        sharp=sharp,
        blurs=blurs,
        features=features,
        network=network,
        out=out,
    )


def _read_copy(copied: hl.Func) -> Pair:
    colors = [copied[X, i, Y] for i in range(2 * COLORS)]
    return colors[:COLORS], colors[COLORS:]


def _define_light(pairs: Sequence[Pair]) -> tuple[hl.Func, hl.Func]:
    """Return the luminance of each candidate's mean, and a quarter of the squared difference of its halves."""
    light, spread = hl.Func("light"), hl.Func("spread")
    sums = [[p + q for p, q in zip(a, b, strict=True)] for a, b in pairs]
    squares = [[(p - q) * (p - q) for p, q in zip(a, b, strict=True)] for a, b in pairs]
    light[X, C, Y] = hl.mux(C, [hl.f32(0.5) * find_luminance(each) for each in sums])
    spread[X, C, Y] = hl.mux(C, [hl.f32(0.25) * find_luminance(each) for each in squares])
    return light, spread


def _define_squares(key: MixingKey, light: hl.Func, spread: hl.Func) -> hl.Func:
    """Return the channels to average: variances, squared differences and slope, luminance of the middle candidate."""
    middle, half = key.middle, hl.f32(0.5)
    steps = [light[X, k, Y] - light[X, middle, Y] for k in range(key.candidates) if k != middle]
    across = half * (light[X + 1, middle, Y] - light[X - 1, middle, Y])
    down = half * (light[X, middle, Y + 1] - light[X, middle, Y - 1])
    squares = [spread[X, k, Y] for k in range(key.candidates)]
    squares += [step * step for step in steps]
    squares += [across * across + down * down, light[X, middle, Y]]
    sharp = hl.Func("sharp")
    sharp[X, C, Y] = hl.mux(C, squares)
    return sharp


def _define_blurs(source: hl.Func) -> list[Blur]:
    """Return the averages of the source, and their averages."""
    blurs: list[Blur] = []
    for step in STEPS:
        taps = [(step * k, hl.f32(weight)) for k, weight in enumerate(BLUR, start=-(len(BLUR) // 2))]
        rows, soft = hl.Func(f"rows{step}"), hl.Func(f"soft{step}")
        rows[X, C, Y] = sum((weight * source[X + k, C, Y] for k, weight in taps), hl.f32(0.0))
        soft[X, C, Y] = sum((weight * rows[X, C, Y + k] for k, weight in taps), hl.f32(0.0))
        blurs.append(Blur(rows, soft))
        source = soft
    return blurs


def _define_features(
    key: MixingKey, extras: hl.ImageParam, light: tuple[hl.Expr, hl.Expr], averages: Sequence[hl.Func]
) -> hl.Func:
    """Return the features (see `mixing.find_features`); ``light`` is the smallest squared mean, and the level."""
    floor, level = light
    values: list[hl.Expr] = []
    for soft in averages:
        mean = soft[X, key.squares - 1, Y]
        unit = hl.f32(1.0) / (mean * mean + floor)
        relative = [soft[X, k, Y] * unit for k in range(key.squares - 1)]
        values += [expressions.log2(hl.max(each, hl.f32(MIN_RELATIVE_SQUARE))) for each in relative]
        values.append(expressions.log2(hl.max(mean / level, hl.f32(MIN_RELATIVE_LIGHT))))
    # The last vector of a row is moved inwards. In a row narrower than a vector it begins left of the image.
    values += [extras[k, hl.max(X, 0), Y] for k in range(key.extras)]
    features = hl.Func("features")
    features[X, C, Y] = hl.mux(C, values)
    return features


def define_network(signature: Signature, features: hl.Func, sizes: Sequence[int]) -> list[Stage]:
    """Return the steps of a network. The last one gives shares, not yet divided by their sum.

    Parameters
    ----------
    signature : Signature
        Of the kernel; declares the arrays of `Network.name_arrays`.
    features : halide.Func
        Inputs, a function of (x, c, y).
    sizes : sequence of int
        Number of inputs, of units of each hidden layer, of outputs.
    """
    inputs, *units, outputs = sizes
    centre, scale = (signature.image(name, inputs) for name in ("centre", "scale"))
    layer = hl.Func("scaled")
    layer[X, C, Y] = (features[X, C, Y] - centre[C]) * scale[C]
    stages, before = [Stage(layer, inputs)], inputs
    for number, count in enumerate((*units, outputs)):
        weights, bias = signature.image(f"weights{number}", before, count), signature.image(f"biases{number}", count)
        over = hl.RDom([(0, before)], f"r{number}")
        total, active = hl.Func(f"total{number}"), hl.Func(f"active{number}")
        total[X, C, Y] = bias[C]
        total[X, C, Y] = total[X, C, Y] + weights[C, over.x] * layer[X, over.x, Y]
        value = total[X, C, Y]
        active[X, C, Y] = value if number == len(units) else hl.max(value, hl.f32(LEAK) * value)
        stages += [Stage(total, count, over), Stage(active, count)]
        layer, before = active, count
    scores = [layer[X, k, Y] for k in range(outputs)]
    highest = scores[0]
    for score in scores[1:]:
        highest = hl.max(highest, score)
    share = hl.Func("share")
    share[X, C, Y] = expressions.exp2(hl.f32(math.log2(math.e)) * (layer[X, C, Y] - highest))
    return [*stages, Stage(share, outputs)]


def _mix(share: hl.Func, pairs: Sequence[Pair]) -> list[hl.Expr]:
    """Return the colour of the mixture: the candidates' means in their shares."""
    total = sum((share[X, k, Y] for k in range(len(pairs))), hl.f32(0.0))
    mixed = []
    for i in range(COLORS):
        doubled = [a[i] + b[i] for a, b in pairs]
        weighted = sum((share[X, k, Y] * value for k, value in enumerate(doubled)), hl.f32(0.0))
        mixed.append(hl.f32(0.5) * weighted / total)
    return mixed
