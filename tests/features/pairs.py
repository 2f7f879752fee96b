"""The similarity of pairs of pixels as a tap computes it, in a kernel of its own that compiles at once."""

from collections.abc import Hashable, Sequence
from functools import partial
from typing import NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.expressions import exp2
from lobewise.features import Feature
from lobewise.features.base import describe_structure
from lobewise.filters.planes import neutralize, prepare_planes
from lobewise.records.frame import FloatArray
from tests.features.oracles import Pixels

Pairs = tuple[Pixels, Pixels]
MARGIN = 8
"""Rows and columns by which two pixels of a pair differ, at most."""


def draw_pairs(rng: np.random.Generator, shape: tuple[int, int], count: int) -> Pairs:
    """Return pairs of pixels that are near each other; some of a pixel with itself."""
    size = np.array(shape)[:, None]
    first = rng.integers(0, size, (2, count))
    second = np.clip(first + rng.integers(-MARGIN, MARGIN + 1, (2, count)), 0, size - 1)
    second[:, : count // 20] = first[:, : count // 20]
    return (first[0], first[1]), (second[0], second[1])


class _Kernel(NamedTuple):
    """A compiled similarity and its inputs: channels of both pixels, whether they have meaning, offsets, scalars."""

    result: hl.Func
    channels: list[hl.ImageParam]
    known: list[hl.ImageParam]
    offset: hl.ImageParam
    scalars: hl.ImageParam


_kernels: dict[Hashable, _Kernel] = {}


def weigh(feature: Feature, pairs: Pairs, known: Sequence[NDArray[np.bool_]] | None = None) -> FloatArray:
    """Return the weight of every pair; where a pixel is not ``known`` its channels are neutral."""
    return compare(feature, pairs, known)[0]


def compare(
    feature: Feature, pairs: Pairs, known: Sequence[NDArray[np.bool_]] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the weight of every pair and its base-2 logarithm, which no clamp has seen."""
    structure = describe_structure(feature)
    if structure not in _kernels:
        _kernels[structure] = _compile(feature)
    kernel = _kernels[structure]
    count = pairs[0][0].size
    channels = [[array[p].reshape(count, -1).T for array in feature.get_arrays()] for p in pairs]
    flags = [np.ones(count, np.uint8)] * 2 if known is None else [each.astype(np.uint8) for each in known]
    # Every argument is held in a local name until the call has returned: Halide keeps no reference.
    held = [np.ascontiguousarray(np.concatenate(each), np.float32) if each else None for each in channels]
    steps = np.array([pairs[1][axis] - pairs[0][axis] for axis in (1, 0)], np.float32)
    numbers = np.array([*feature.get_parameters(), 0.0], np.float32)
    given = [*zip(kernel.channels, held, strict=True), *zip(kernel.known, flags, strict=True)]
    for param, array in (*given, (kernel.offset, steps), (kernel.scalars, numbers)):
        if array is not None:
            param.set(hl.Buffer(array))
    weights, logs = np.empty(count, np.float32), np.empty(count, np.float32)
    kernel.result.realize([hl.Buffer(weights), hl.Buffer(logs)])
    return weights, logs


def _compile(feature: Feature) -> _Kernel:
    """Return the kernel of a feature, for arrays and parameters of any values."""
    x = hl.Var("x")
    inputs = [hl.ImageParam(hl.Float(32), 2, f"channels{number}") for number in range(2)]
    known = [hl.ImageParam(hl.UInt(8), 1, f"known{number}") for number in range(2)]
    offset, scalars = hl.ImageParam(hl.Float(32), 2, "offset"), hl.ImageParam(hl.Float(32), 1, "scalars")
    parameters = [scalars[k] for k in range(len(feature.get_parameters()))]
    sides = []
    for channels, usable in zip(inputs, known, strict=True):
        values = neutralize([feature], [channels[x, k] for k in range(len(feature.neutral))], usable[x] != 0)
        planes, (layout,) = prepare_planes([feature], [parameters], values)
        side = hl.Func("side")
        side[x] = hl.Tuple(planes) if len(planes) > 1 else planes[0] if planes else hl.f32(0.0)
        side.compute_root()
        sides.append(layout.read(partial(_read, side, len(planes), x)))
    result = hl.Func("weight")
    log = feature.log2_similarity(*sides, parameters, (offset[x, 0], offset[x, 1]), lambda value: value)
    result[x] = hl.Tuple([exp2(log), log])
    return _Kernel(result, inputs, known, offset, scalars)


def _read(side: hl.Func, count: int, x: hl.Var, k: int) -> hl.Expr:
    """Return the k-th of some planes."""
    return side[x][k] if count > 1 else side[x]
