"""Non-local means of an albedo that holds the noise of samples, beside normals without noise.

Renderers that sample the lens, the shutter and the pixel's area write albedos as noisy as their samples. Pixels are
averaged whose patches are no farther apart than their noise, and whose surfaces face the same way.

Source: Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means Filtering", equation 2: squared
differences of patches minus the part that noise explains, over the noise. Departs: there are no halves, so the variance
of a pixel follows from second differences, the smallest of four directions, along which edges do not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lobewise.backend import expressions
from lobewise.backend.buffers import take_image
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.engine.here import HERE
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y
from lobewise.filters.scheduling import STRIP_ROWS, keep_rows
from lobewise.filters.weigh import U, V
from lobewise.records.frame import FloatArray

RADIUS = 4
"""Radius of the square of neighbours, pixels."""
VARIANCE_FLOOR = 1e-4
"""Added to the variances that squared differences are divided by."""
MAX_RATIO_TO_MEDIAN = 4.0
"""Largest variance of a pixel over the median of its 3x3 pixels: a detail of one pixel is not noise."""
NORMAL_SHARPNESS = 4.0
"""Factor of the squared distance of two normals in the exponent of a weight."""
DIFFERENCE_DIRECTIONS = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Columns and rows to the next pixel of a second difference."""
_NEAR = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
_SORTED_PAIRS = (
    *((0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (0, 3)),
    *((5, 8), (4, 7), (3, 6), (1, 4), (2, 5), (4, 7), (4, 2), (6, 4), (4, 2)),
)
"""Comparisons that bring the median of nine values to place 4: J. Smith 1996, "Implementing Median Filters in XC4000E
FPGAs"."""


def clean_albedo(albedo: FloatArray, normal: FloatArray) -> FloatArray:
    """Return an albedo without the noise of samples, (height, width, 3).

    Parameters
    ----------
    albedo : (height, width, 3)
        Finite.
    normal : (height, width, 3)
        Finite; without noise.

    Raises
    ------
    InputError
        If the images differ in size.
    """
    size = (*albedo.shape[:2], COLORS)
    images = {"albedo": take_image("albedo", albedo, size), "normal": take_image("normal", normal, size)}
    return np.asarray(HERE.kernel(("albedo noise",), make_cleaning, images, {})["clean"])


class _Noise(NamedTuple):
    """The stages of the variance of each pixel's noise."""

    seconds: hl.Func
    """Squared second differences along `DIFFERENCE_DIRECTIONS`."""
    rough: hl.Func
    bounded: hl.Func
    variance: hl.Func


def make_cleaning(target: hl.Target) -> Scheduled:
    """Return the kernel of `clean_albedo`."""
    # Signature
    signature, size = Signature("albedo noise"), ("height", "width", COLORS)
    images = [signature.image(name, *size) for name in ("albedo", "normal")]
    signature.output("clean", *size)

    # Algorithm
    width, height = images[0].dim(1).extent(), images[0].dim(2).extent()
    at = hl.clamp(X, 0, width - 1), hl.clamp(Y, 0, height - 1)
    planes = hl.Func("planes")
    # The last plane is 1: its sum is the sum of weights.
    planes[X, C, Y] = hl.mux(C, [*(image[k, at[0], at[1]] for image in images for k in range(COLORS)), hl.f32(1.0)])
    noise = _define_noise(planes)

    distance, columns, weight, sums, out = (hl.Func(name) for name in ("distance", "columns", "weight", "sums", "out"))
    there = X + U, Y + V
    own, other = noise.variance[X, Y], noise.variance[there]
    apart = _square_distance(planes, there, 0) - (own + hl.min(own, other))
    distance[X, Y, U, V] = apart / (hl.f32(VARIANCE_FLOOR) + own + other)
    columns[X, Y, U, V] = distance[X, Y - 1, U, V] + distance[X, Y, U, V] + distance[X, Y + 1, U, V]
    patch = (columns[X - 1, Y, U, V] + columns[X, Y, U, V] + columns[X + 1, Y, U, V]) * hl.f32(1.0 / 9.0)
    exponent = hl.max(patch, hl.f32(0.0)) + hl.f32(NORMAL_SHARPNESS) * _square_distance(planes, there, COLORS)
    weight[X, Y, U, V] = expressions.exp2(hl.f32(-LOG2_E) * exponent)
    taps = hl.RDom([(-RADIUS, 2 * RADIUS + 1), (-RADIUS, 2 * RADIUS + 1)], "taps")
    summed = hl.mux(C, [planes[X + taps.x, k, Y + taps.y] for k in (*range(COLORS), 2 * COLORS)])
    sums[X, C, Y] = hl.f32(0.0)
    sums[X, C, Y] += weight[X, Y, taps.x, taps.y] * summed
    out[C, X, Y] = hl.mux(C, [sums[X, k, Y] / sums[X, COLORS, Y] for k in range(COLORS)])

    # Schedule
    # Tiles run in parallel, and their planes and sums stay in the second-level cache. The weights of a row of taps stay
    # in the first.
    lanes, tail = target.natural_vector_size(hl.Float(32)), hl.TailStrategy.GuardWithIf
    outer, strip, column, row = (hl.Var(name) for name in ("outer", "strip", "column", "row"))
    out.bound(C, 0, COLORS).tile(X, Y, outer, strip, column, row, 4 * lanes, STRIP_ROWS, tail)
    out.reorder(C, column, row, outer, strip).unroll(C).vectorize(column, lanes).parallel(strip).never_partition_all()
    out.output_buffer().dim(1).set_stride(COLORS)
    keep_rows(planes.compute_at(out, outer), 2 * COLORS + 1, lanes)
    keep_rows(noise.seconds.compute_at(out, outer), len(DIFFERENCE_DIRECTIONS), lanes)
    for func in noise[1:]:
        func.compute_at(out, outer).vectorize(X, lanes).never_partition_all()
    keep_rows(sums.compute_at(out, outer), COLORS + 1, lanes)
    sums.update().reorder(C, taps.x, X, Y, taps.y).vectorize(X, lanes).unroll(C).unroll(taps.x)
    for func in (distance, columns, weight):
        func.compute_at(sums, taps.y).reorder(X, Y, U, V).vectorize(X, lanes).never_partition_all()
    return Scheduled([out], signature)


def _square_distance(planes: hl.Func, there: tuple[hl.Expr, hl.Expr], first: int) -> hl.Expr:
    """Return the squared distance of three planes of a pixel from those of another one."""
    changes = [planes[X, k, Y] - planes[there[0], k, there[1]] for k in range(first, first + COLORS)]
    return sum((change * change for change in changes), hl.f32(0.0))


def _define_noise(planes: hl.Func) -> _Noise:
    noise = _Noise(*(hl.Func(name) for name in _Noise._fields))
    values = []
    for dx, dy in DIFFERENCE_DIRECTIONS:
        twice = [
            hl.f32(2.0) * planes[X, k, Y] - planes[X + dx, k, Y + dy] - planes[X - dx, k, Y - dy] for k in range(COLORS)
        ]
        values.append(sum((each * each for each in twice), hl.f32(0.0)))
    noise.seconds[X, C, Y] = hl.mux(C, values)
    # A second difference of independent noise has six times its variance.
    means = [
        sum((noise.seconds[X + dx, k, Y + dy] for dx, dy in _NEAR), hl.f32(0.0)) * hl.f32(1.0 / 54.0)
        for k in range(len(DIFFERENCE_DIRECTIONS))
    ]
    noise.rough[X, Y] = hl.min(*means)
    nine = [noise.rough[X + dx, Y + dy] for dx, dy in _NEAR]
    for low, high in _SORTED_PAIRS:
        nine[low], nine[high] = hl.min(nine[low], nine[high]), hl.max(nine[low], nine[high])
    noise.bounded[X, Y] = hl.min(noise.rough[X, Y], hl.f32(MAX_RATIO_TO_MEDIAN) * nine[4])
    mean = sum((noise.bounded[X + dx, Y + dy] for dx, dy in _NEAR), hl.f32(0.0)) * hl.f32(1.0 / 9.0)
    noise.variance[X, Y] = mean
    return noise
