"""A small network that gives the shares of images in a mixture, pixel by pixel.

The shares are a softmax, so the mixture is a convex average. Source of the idea: Kalantari, Bako and Sen 2015, "A
Machine Learning Approach for Filtering Monte Carlo Noise". Departs: the network predicts shares of images, not the
parameters of one filter.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from lobewise.errors import InputError
from lobewise.frame import FloatArray

LAYERS = 3
"""Layers of a network: two hidden ones and the output."""


class Network(NamedTuple):
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
        if len(sizes) != LAYERS + 1 or 0 in sizes or [array.shape for array in arrays] != expected:
            raise InputError(
                "network",
                expected=f"{LAYERS} layers from {inputs} inputs to {candidates} outputs",
                got="arrays of shapes " + ", ".join(str(array.shape) for array in arrays),
                action="use one that was trained for these candidates and extras",
            )
