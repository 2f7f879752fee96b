"""The small network that tells in which proportions filtered images are mixed."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from lobewise.errors import InputError, describe_problem
from lobewise.frame import FloatArray

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

    def name_arrays(self) -> dict[str, FloatArray]:
        """Return its arrays by the names that the kernel knows them by."""
        named = {"centre": self.mean, "scale": self.scale}
        named |= {f"weights{number}": each for number, each in enumerate(self.weights)}
        return named | {f"biases{number}": each for number, each in enumerate(self.biases)}

    def require_fit(self, inputs: int, candidates: int) -> None:
        """Raise InputError unless the arrays fit each other: kernels read and write where shapes tell them."""
        sizes = [inputs, *(bias.size for bias in self.biases[:-1]), candidates]
        expected = [(inputs,), (inputs,), *pairwise(sizes), *((size,) for size in sizes[1:])]
        arrays = self.name_arrays().values()
        if len(sizes) != LAYERS + 1 or 0 in sizes or [array.shape for array in arrays] != expected:
            raise InputError(
                describe_problem(
                    "network",
                    expected=f"{LAYERS} layers from {inputs} inputs to {candidates} outputs",
                    got="arrays of shapes " + ", ".join(str(array.shape) for array in arrays),
                    action="use one that was trained for these candidates and extras",
                )
            )
