"""The similarity of pairs of pixels as a tap computes it, in a kernel of its own that compiles at once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.expressions import exp2
from lobewise.features import Feature
from lobewise.filters.planes import neutralize, prepare_planes
from lobewise.frame import FloatArray
from tests.features.oracles import Pixels

Pairs = tuple[Pixels, Pixels]
MARGIN = 8
"""Rows and columns by which two pixels of a pair differ, at most."""


def _read(side: hl.Func, count: int, x: hl.Var, k: int) -> hl.Expr:
    """Return the k-th of some planes."""
    return side[x][k] if count > 1 else side[x]


def draw_pairs(rng: np.random.Generator, shape: tuple[int, int], count: int) -> Pairs:
    """Return pairs of pixels that are near each other; some of a pixel with itself."""
    size = np.array(shape)[:, None]
    first = rng.integers(0, size, (2, count))
    second = np.clip(first + rng.integers(-MARGIN, MARGIN + 1, (2, count)), 0, size - 1)
    second[:, : count // 20] = first[:, : count // 20]
    return (first[0], first[1]), (second[0], second[1])


def weigh(feature: Feature, pairs: Pairs, known: Sequence[NDArray[np.bool_]] | None = None) -> FloatArray:
    """Return the weight of every pair; where a pixel is not ``known`` its channels are neutral."""
    x = hl.Var("x")
    count = pairs[0][0].size
    # Every argument is held in a local name until the call has returned: Halide keeps no reference.
    held = [np.concatenate([array[p].reshape(count, -1).T for array in feature.get_arrays()] or [[]]) for p in pairs]
    held = [np.ascontiguousarray(each, np.float32) for each in held]
    flags = [np.ones(count, np.uint8)] * 2 if known is None else [each.astype(np.uint8) for each in known]
    steps = [np.ascontiguousarray(pairs[1][axis] - pairs[0][axis], np.float32) for axis in (1, 0)]
    numbers = np.array([*feature.get_parameters(), 0.0], np.float32)
    buffers = [hl.Buffer(each) for each in held]
    told, offsets, scalars = (
        [hl.Buffer(each) for each in flags],
        [hl.Buffer(each) for each in steps],
        hl.Buffer(numbers),
    )
    parameters = [scalars[k] for k in range(numbers.size - 1)]
    sides = []
    for number, (buffer, usable) in enumerate(zip(buffers, told, strict=True)):
        channels = [buffer[x, k] for k in range(held[number].shape[0])]
        planes, (layout,) = prepare_planes(
            [feature], [parameters], neutralize([feature], channels, usable[x] != 0) if channels else []
        )
        side = hl.Func(f"side{number}")
        side[x] = hl.Tuple(planes) if len(planes) > 1 else planes[0] if planes else hl.f32(0.0)
        side.compute_root()
        sides.append(layout.read(partial(_read, side, len(planes), x)))
    result = hl.Func("weight")
    offset = offsets[0][x], offsets[1][x]
    result[x] = exp2(feature.log2_similarity(*sides, parameters, offset, lambda value: value))
    out = np.empty(count, np.float32)
    result.realize(hl.Buffer(out))
    return out
