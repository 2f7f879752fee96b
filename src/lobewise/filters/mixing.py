"""Mix several filtered images pixel by pixel, in shares that a small network predicts.

The filtered images are called candidates. The difference of a candidate's two halves shows its noise; the differences
between candidates show that some are biased; the guides show the surface. From these features the network predicts how
far to trust each candidate. The shares are a softmax, so the mixture is a convex average. Source of the idea:
Kalantari, Bako and Sen 2015, "A Machine Learning Approach for Filtering Monte Carlo Noise". Departs: the network
predicts shares of candidates, not the parameters of one filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import halide as hl
import numpy as np

from lobewise.backend.buffers import Image, returns_host_images, take_image
from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.errors import InputError
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.mixing_pass import MixingKey, make_mixing
from lobewise.filters.schedules.mixing import schedule_mixing
from lobewise.frame import FloatArray

LAYERS = 3
"""Layers of a network: two hidden ones and the output."""
MIN_LIGHT_SHARE = 0.05
"""Squared differences are divided by the squared local mean plus the square of this share of the image's mean."""


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


def _require_whole(candidates: int, middle: int, extras: FloatArray) -> None:
    """Raise InputError unless ``middle`` is a candidate and there is at least one extra."""
    if not 0 <= middle < candidates:
        raise InputError(
            "middle",
            expected="the index of a candidate",
            got=f"{middle} of {candidates}",
            action="count from 0, and give at least one candidate",
        )
    if extras.ndim != 3 or extras.shape[2] < 1:
        raise InputError(
            "extras",
            expected="shape (height, width, count) with a count of at least 1",
            got=f"shape {extras.shape}",
            action="give zeros where nothing else is known",
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
    units = () if network is None else tuple(len(bias) for bias in network.biases[:-1])
    key = MixingKey(len(candidates), middle, extras.shape[2], units)
    shape = (*extras.shape[:2], COLORS)
    images = {
        f"candidate{k}_{name}": take_image("candidate", half, shape)
        for k, pair in enumerate(candidates)
        for name, half in zip("ab", pair, strict=True)
    }
    images["extras"] = take_image("extras", extras, extras.shape)
    if network is not None:
        network.require_fit(key.features, key.candidates)
        images |= {name: np.ascontiguousarray(each, dtype=np.float32) for name, each in network.name_arrays().items()}
    level = max(level, 1e-30)
    kernel = get_kernel(device, key, partial(_make_scheduled, key))
    return run_kernel(kernel, device, images, floor=max((MIN_LIGHT_SHARE * level) ** 2, 1e-37), level=level)["mixed"]


def _make_scheduled(key: MixingKey, target: hl.Target) -> Scheduled:
    """Return a mixing, ready to be compiled."""
    funcs = make_mixing(key, together=target.has_gpu_feature())
    schedule_mixing(funcs, target)
    return Scheduled([funcs.out], funcs.signature)


def find_features(
    candidates: Sequence[tuple[Image, Image]],
    middle: int,
    extras: FloatArray,
    level: float,
    device: str = "cpu",
) -> Image:
    """Return the inputs of a network at every pixel, shape (height, width, `count_features`).

    In this order, all base-2 logarithms but the extras: the variance of each candidate, a quarter of the squared
    difference of its halves; the squared difference of each other candidate to the middle one; the squared slope of the
    middle one, all three averaged over `BLUR` and relative to the squared local mean of the middle one; the local mean
    over ``level``; then all of these again from averages that are averaged once more, over taps further apart
    (`STEPS`); last the extras, unchanged.

    Parameters
    ----------
    candidates : sequence of pairs of arrays, shape (height, width, 3)
        Both halves of each candidate, radiance over albedo, finite, >= 0.
    middle : int
        Index of the candidate that the others are compared with.
    extras : array, shape (height, width, count)
        Further inputs of the network, at least one.
    level : float
        About the mean luminance of a candidate over the whole image, of which the candidates may be a part.
    device : str
        A name from `list_devices`.

    Raises
    ------
    InputError
        If an array has another shape, or ``middle`` is no candidate's index.
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
    """Return the mixture of the candidates, shape (height, width, 3), in shares that the network predicts.

    Parameters
    ----------
    candidates, middle, extras, level, device
        As in `find_features`.
    network : Network
        With one input for each feature and one output for each candidate.

    Raises
    ------
    InputError
        If an array has another shape, ``middle`` is no candidate's index, or the network does not fit.
    """
    return _run(candidates, middle, extras, level, network, device)
