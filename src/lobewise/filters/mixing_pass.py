"""The steps of a network of `lobewise.filters.mixing`, as Halide functions of (x, c, y)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.signature import Signature
from lobewise.filters.planes import C, X, Y

LEAK = 0.01
"""Slope of the activation of hidden units below 0 (leaky ReLU)."""


class Stage(NamedTuple):
    """A step of the network."""

    func: hl.Func
    channels: int
    inputs: hl.RDom | None = None
    """Domain of the step's sum, if it sums."""


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
