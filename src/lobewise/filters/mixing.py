"""A small network that gives the shares of images in a mixture, pixel by pixel.

The shares are a softmax, so the mixture is a convex average. Source of the idea: Kalantari, Bako and Sen 2015, "A
Machine Learning Approach for Filtering Monte Carlo Noise". Departs: the network predicts shares of images, not the
parameters of one filter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial, reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.engine.here import HERE
from lobewise.errors import InputError
from lobewise.filters.planes import C, X, Y
from lobewise.records.frame import FloatArray

LAYER_COUNT = 3
"""Layers of a network: two hidden ones and the output."""
PIXELS_AT_ONCE = 4
"""Pixels whose units are summed at once."""
PERCEPTRON_LEAK = 0.01
"""Slope of the activation of hidden units below 0 (leaky ReLU)."""


class Perceptron(NamedTuple):
    """A perceptron with two hidden layers, its inputs centred and scaled.

    Parameters
    ----------
    mean, scale : (inputs,)
        Inputs become ``(input - mean) * scale``.
    weights : three arrays, (inputs, units), (units, units), (units, candidates)
    biases : three arrays, (units,), (units,), (candidates,)
    """

    mean: FloatArray
    scale: FloatArray
    weights: tuple[FloatArray, FloatArray, FloatArray]
    biases: tuple[FloatArray, FloatArray, FloatArray]

    def name_arrays(self) -> dict[str, FloatArray]:
        """Return the arrays by their names in the kernel's signature."""
        named = {"centre": self.mean, "scale": self.scale}
        named |= {f"weights{number}": each for number, each in enumerate(self.weights)}
        return named | {f"biases{number}": each for number, each in enumerate(self.biases)}

    def require_fit(self, inputs: int, candidates: int) -> None:
        """Raise InputError unless the shapes of all arrays fit each other: kernels do not check them."""
        sizes = [inputs, *(bias.size for bias in self.biases[:-1]), candidates]
        expected = [(inputs,), (inputs,), *pairwise(sizes), *((size,) for size in sizes[1:])]
        arrays = self.name_arrays().values()
        if len(sizes) != LAYER_COUNT + 1 or 0 in sizes or [array.shape for array in arrays] != expected:
            raise InputError(
                "network",
                expected=f"{LAYER_COUNT} layers from {inputs} inputs to {candidates} outputs",
                got="arrays of shapes " + ", ".join(str(array.shape) for array in arrays),
                action="use one that was trained for these candidates and extras",
            )


def compute_shares(seen: FloatArray, network: Perceptron, count: int) -> FloatArray:
    """Return the softmax of a network's outputs at every pixel, shape (height, width, count), in [0, 1].

    Parameters
    ----------
    seen : array, shape (height, width, features)
    network : Perceptron
    count : int
        Outputs of the network, at least 2.

    Raises
    ------
    InputError
        If the network has another number of inputs or outputs.
    """
    network.require_fit(seen.shape[-1], count)
    sizes = seen.shape[-1], *(len(bias) for bias in network.biases)
    arrays = {name: np.ascontiguousarray(each, np.float32) for name, each in network.name_arrays().items()}
    images = {"seen": np.ascontiguousarray(seen, np.float32), **arrays}
    return np.asarray(HERE.kernel(("shares", sizes), partial(make_shares, sizes), images, {})["shares"])


def make_shares(sizes: Sequence[int], target: hl.Target) -> Scheduled:
    """Return the kernel, for processors; ``sizes`` count the inputs, the units of each hidden layer and the outputs."""
    # Signature
    signature, (inputs, *_, outputs) = Signature("shares"), sizes
    seen = signature.image("seen", "height", "width", inputs)
    signature.output("shares", "height", "width", outputs)
    centre, scale = (signature.image(name, inputs) for name in ("centre", "scale"))

    # Algorithm
    features, layer = hl.Func("features"), hl.Func("scaled")
    features[X, C, Y] = seen[C, hl.clamp(X, 0, seen.dim(1).extent() - 1), Y]
    layer[X, C, Y] = (features[X, C, Y] - centre[C]) * scale[C]
    stages = [(layer, inputs)]
    for number, (before, count) in enumerate(pairwise(sizes)):
        weights, bias = signature.image(f"weights{number}", before, count), signature.image(f"biases{number}", count)
        over = hl.RDom([(0, before)], f"r{number}")
        summed, active = hl.Func(f"total{number}"), hl.Func(f"active{number}")
        summed[X, C, Y] = bias[C]
        summed[X, C, Y] = summed[X, C, Y] + weights[C, over.x] * layer[X, over.x, Y]
        value = summed[X, C, Y]
        active[X, C, Y] = value if number == LAYER_COUNT - 1 else hl.max(value, hl.f32(PERCEPTRON_LEAK) * value)
        stages += [(summed, count), (active, count)]
        layer = active
    highest = reduce(hl.max, (layer[X, k, Y] for k in range(outputs)))
    share, out = hl.Func("share"), hl.Func("out")
    share[X, C, Y] = expressions.exp2(hl.f32(math.log2(math.e)) * (layer[X, C, Y] - highest))
    total = sum((share[X, k, Y] for k in range(1, outputs)), share[X, 0, Y])
    out[C, X, Y] = hl.mux(C, [share[X, k, Y] / total for k in range(outputs)])

    # Schedule: rows in parallel; all stages of a few pixels one after the other. Units lie side by side, as their
    # weights do, so that their sums over the inputs stay in registers; outputs are too few for a vector.
    lanes, column, lane = target.natural_vector_size(hl.Float(32)), hl.Var("column"), hl.Var("lane")
    out.bound(C, 0, outputs).reorder(C, X, Y).unroll(C)
    out.split(X, column, lane, PIXELS_AT_ONCE, hl.TailStrategy.GuardWithIf)
    out.reorder(C, lane, column, Y).vectorize(lane).parallel(Y).never_partition_all()
    for func, channels in [*stages, (share, outputs)]:
        func.compute_at(out, column).bound(C, 0, channels).bound_extent(X, PIXELS_AT_ONCE)
        if channels > outputs:
            # A vector beyond the last unit would read what lies behind the weights, and write into the next pixel.
            vector = math.gcd(channels, lanes)
            func.reorder_storage(C, X, Y).reorder(C, X, Y).vectorize(C, vector).unroll(X)
            if func.has_update_definition():
                func.update().reorder(C, X, func.rvars()[0], Y).vectorize(C, vector).unroll(C).unroll(X)
        else:
            func.reorder_storage(X, C, Y).reorder(X, C, Y).vectorize(X)
            if func.has_update_definition():
                func.update().reorder(X, C, func.rvars()[0], Y).vectorize(X).unroll(C)
    return Scheduled([out], signature)
