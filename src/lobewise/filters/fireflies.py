"""Bound fireflies: make no pixel much brighter than its neighbours and its own other half allow.

A path that finds a small light by luck outweighs thousands of others, and a filter spreads it over its whole kernel.
The mean of such skewed samples is best estimated by winsorizing: the largest sample is cut down to the next largest.
Winsorizing needs no scale, so it depends neither on exposure nor on the sample count. Source: L.-P. Rivest 1994,
"Statistical properties of Winsorized means for skewed distributions", Biometrika 81(2). Departs: the bound is a factor
above the other pixels of a window, because pixels of a picture differ by more than noise. A second, independent
estimate of the pixel may raise the bound: what both halves of the samples see is no accident.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import Image, download, returns_host_images, take_image, take_mask
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import is_good
from lobewise.backend.jit import Scheduled
from lobewise.backend.pointwise import LARGEST_FLOAT, Grid, Vector, select_bits, select_or_nan
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, compute_expression_luminance, demodulate
from lobewise.filters.planes import C, X, Y
from lobewise.filters.scheduling import LINE, STRIP, STRIP_ROWS, schedule_stencil, spread_pixels
from lobewise.records.frame import FloatArray

FIREFLY_REACH = 6
"""Pixels from the centre of the window to its edge: about the radius of a filter kernel."""
MAX_RATIO_TO_WINDOW = 2.0
"""Largest luminance of a pixel over that of the second brightest other pixel of its window. The brightest is ignored,
because fireflies may come in pairs."""
MAX_RATIO_TO_HALF = 4.0
"""Largest luminance of a pixel in one half of the samples over that in the other half. The larger bound counts."""
MIN_WINDOW_PIXELS = 8
"""Good pixels that a window needs besides its centre. With fewer, only the other half bounds the pixel."""

MAX_RATIO_TO_BOUNDED = 256.0
"""Largest luminance of a sample that `cut_samples` leaves, over the luminance of the sample after bounding."""
UNCOUNTED = -1.0
"""Luminance that marks a bad or masked pixel."""


def count_light(sums: Sequence[Image]) -> NDArray[np.float64]:
    """Return the luminance of every row before bounding, and luminance taken away, (height, 2)."""
    return np.stack([download(rows).sum(axis=1, dtype=np.float64) for rows in sums], axis=1)


class BoundedHalves(NamedTuple):
    """The result of `bound_fireflies`.

    Parameters
    ----------
    a, b : (height, width, 3)
        The two halves, nowhere brighter than before.
    sums : two images, (height, parts)
        For each row in parts, summed over the good pixels of both halves: luminance before, and luminance taken away.
    """

    a: Image
    b: Image
    sums: tuple[Image, ...]

    @property
    def tally(self) -> NDArray[np.float64]:
        """Luminance of every row before bounding, and luminance taken away, (height, 2)."""
        return count_light(self.sums)

    @property
    def energy_lost(self) -> float:
        """Share of the luminance that was taken away, in [0, 1]."""
        return compute_energy_lost([self.tally])


@returns_host_images
def bound_fireflies(
    halves: tuple[FloatArray, FloatArray],
    albedo: FloatArray | None,
    mask: NDArray[np.bool_],
) -> BoundedHalves:
    """Return the two halves of a layer with their fireflies bounded, and the light that was taken away.

    A pixel's bound is the larger of two numbers: `MAX_RATIO_TO_WINDOW` times the second largest luminance over albedo
    among the other pixels of its window, each the mean of its halves; and `MAX_RATIO_TO_HALF` times the luminance over
    albedo of the pixel's other half. A brighter pixel is scaled down to the bound. A light, caustic or glint of three
    pixels or more therefore keeps its brightness, and so does a single pixel that both halves saw. Light is lost where
    it is so rare that the samples of a window find it once or twice.

    Measured at 512x512 on ``showroom``, ``parlour``, ``brushed``, ``sparks``, with 1, 4, 16 and 64 samples per pixel:
    the relative error after a filter of radius 8 falls to 0.78, 0.87, 0.93 and 0.96 of its former value (geometric
    means) and rises on no scene. ``showroom`` and ``parlour`` lose 1.9 to 2.8 %, 1.3 %, 0.1 to 0.2 % and under 0.1 % of
    their light; ``sparks``, whose small lights are found by luck, loses 12 %, 6 %, 3 % and 0.7 %.

    Parameters
    ----------
    halves : pair of array, shape (height, width, 3)
        Linear radiance from two independent halves of the samples, >= 0. NaN where a half has no sample. NaN, infinite
        and negative pixels neither count nor change.
    albedo : array, shape (height, width, 3) or None
        Divides the radiance before luminances are compared. Pixels whose albedo is almost 0 do not count.
    mask : bool array, shape (height, width)
        False where a pixel does not belong to the layer: it neither counts nor changes.

    Raises
    ------
    InputError
        If an image is not real numbers of the mask's size.
    """
    images, tinted = take_halves(halves, albedo, mask), albedo is not None
    make = partial(make_fireflies, tinted)
    a, b, *sums = engine.kernel(("fireflies", tinted), make, images, text="bound fireflies").values()
    return BoundedHalves(a, b, tuple(sums))


def cut_samples(color: FloatArray, bounded: FloatArray) -> FloatArray:
    """Return the noisy image, nowhere more than `MAX_RATIO_TO_BOUNDED` times as bright as without fireflies.

    What is trained on noisy images (Open Image Denoise, the networks that mix images) knows fireflies, and would take
    an image that is bounded as filters need it for a darker room. But one huge pixel would spoil all that it sees.

    Parameters
    ----------
    color, bounded : array, shape (height, width, 3)
        Linear radiance: the samples, and the sum of the bounded layers and of the light that is in no layer.

    Returns
    -------
    array, shape (height, width, 3)
        NaN where ``bounded`` is not finite or below 0.
    """
    images, text = {"color": color, "bounded": bounded}, "samples that are not too bright"
    (cut,) = engine.pixels(define_cut, images, {}, names=["cut"], text=text)
    return cut


def define_cut(grid: Grid) -> list[Vector]:
    color, bounded = grid.read("color"), grid.read("bounded")
    # Divide before multiplying: products of huge pixels overflow.
    most = (
        compute_expression_luminance(bounded)
        / hl.max(compute_expression_luminance(color), hl.f32(1e-30))
        * hl.f32(MAX_RATIO_TO_BOUNDED)
    )
    cut = [hl.select(most < hl.f32(1.0), value * most, value) for value in color]
    return [[select_or_nan(is_good(bounded), value) for value in cut]]


def take_halves(halves: tuple[Image, Image], albedo: FloatArray | None, mask: NDArray[np.bool_]) -> dict[str, Image]:
    """Return the images that `declare_halves` declares; raise InputError if one has another size than the mask."""
    shape = (*mask.shape, 3)
    images = {name: take_image(f"half {name}", half, shape) for name, half in zip("ab", halves, strict=True)}
    if albedo is not None:
        images["albedo"] = take_image("albedo", albedo, shape)
    return {**images, "mask": take_mask(mask)}


def compute_energy_lost(tallies: Sequence[NDArray[np.float64]]) -> float:
    """Return the share of the light of all layers that was taken away, in [0, 1], from their tallies."""
    before, taken = (sum(float(tally[:, k].sum()) for tally in tallies) for k in range(2))
    return min(taken / before, 1.0) if before > 0.0 else 0.0


class Crowd(NamedTuple):
    """The two largest luminances of a group of pixels, and how many of the pixels count."""

    largest: hl.Expr
    """`UNCOUNTED` if no pixel counts."""
    second: hl.Expr
    """`UNCOUNTED` if fewer than two pixels count."""
    count: hl.Expr

    def join(self, other: Crowd) -> Crowd:
        """Return the crowd of all pixels of two disjoint crowds."""
        second = hl.max(hl.min(self.largest, other.largest), hl.max(self.second, other.second))
        return Crowd(hl.max(self.largest, other.largest), second, self.count + other.count)


def _join_all(crowds: Sequence[Crowd]) -> Crowd:
    """Return the crowd of all pixels of several disjoint crowds."""
    together = crowds[0]
    for crowd in crowds[1:]:
        together = together.join(crowd)
    return together


class Light(NamedTuple):
    """The luminances of both halves of a pixel."""

    first: hl.Expr
    second: hl.Expr
    """Over albedo; `UNCOUNTED` where the half is bad."""
    raw_first: hl.Expr
    raw_second: hl.Expr
    """Of the radiance itself; 0 where the half is bad."""


def make_fireflies(tinted: bool, target: hl.Target) -> Scheduled:
    """Return the kernel. It writes the bounded halves, and for each row partial sums of `BoundedHalves.tally`."""
    # Signature
    signature, lanes = Signature("fireflies"), target.natural_vector_size(hl.Float(32))
    halves, albedo, mask = declare_halves(signature, tinted)
    for name in ("bounded_a", "bounded_b"):
        signature.output(name, "height", "width", 3)
    for name in ("seen", "taken"):
        signature.output(name, "height", lanes)

    # Algorithm
    light = define_light(halves, albedo, mask)
    both = define_both(light)
    crowds = _define_crowds(both)
    row = _define_row(crowds)
    factor = _define_factor(light, row)
    energy, sums, tally = _define_tally(light, factor, mask.width(), lanes)
    out = _define_bounded(halves, factor)

    # Schedule
    # Measured (EPYC with AVX-512), 1920x1080, processor time of one thread: 26 ms, with albedo 32 ms. A kernel compiles
    # in 0.7 s. Loops of their own for the borders save a twentieth of the time and compile in 1.3 s. The crowd of a
    # window's row is computed once and serves all windows that contain the row.
    stored = light, both, row, factor
    schedule_stencil(out, 3, target, strips=[light, row], lines=[factor, energy], stored=stored)
    lane, tail = tally.args()[0], hl.TailStrategy.GuardWithIf
    tally.bound(lane, 0, lanes)
    if target.has_gpu_feature():
        sums.compute_at(tally, spread_pixels(tally, lane, Y))
    else:
        tally.vectorize(lane).split(Y, STRIP, LINE, STRIP_ROWS, tail).parallel(STRIP).never_partition_all()
        tally.compute_with(out, LINE)
        sums.compute_at(out, LINE).vectorize(lane).update().vectorize(lane)
        for crowd in crowds:
            crowd.compute_at(row, Y).vectorize(X, lanes).never_partition_all()
    return Scheduled([out, tally], signature)


def declare_halves(
    signature: Signature, tinted: bool
) -> tuple[list[hl.ImageParam], hl.ImageParam | None, hl.ImageParam]:
    """Declare two halves of the samples, the albedo if ``tinted``, and the mask."""
    size = "height", "width"
    colors = [signature.image(name, *size, 3) for name in ("a", "b", *["albedo"] * tinted)]
    for image in colors:
        image.dim(0).set_bounds(0, 3)
    return colors[:2], colors[2] if tinted else None, signature.image("mask", *size, type=hl.UInt(8))


def define_light(halves: Sequence[hl.ImageParam], albedo: hl.ImageParam | None, mask: hl.ImageParam) -> hl.Func:
    """Return the `Light` of every pixel; pixels outside the image do not count."""
    width, height = mask.width(), mask.height()
    inside = (X >= 0) & (width > X) & (Y >= 0) & (height > Y)
    # "Likely" makes a loop of its own for the middle of a row, where loads need no clamping and are dense.
    at = hl.clamp(hl.likely(X), 0, width - 1), hl.clamp(Y, 0, height - 1)
    lights: list[hl.Expr] = []
    raw: list[hl.Expr] = []
    for half in halves:
        radiance, good = demodulate(half, albedo, at, hl.f32(ALBEDO_FLOOR))
        luminance = compute_expression_luminance(radiance)
        # The luminance of finite channels may overflow to infinity.
        good = good & inside & (mask[at] != 0) & (luminance < hl.f32(LARGEST_FLOAT))
        lights.append(hl.select(good, luminance, hl.f32(UNCOUNTED)))
        raw.append(
            hl.select(good, compute_expression_luminance([half[k, at[0], at[1]] for k in range(3)]), hl.f32(0.0))
        )
    light = hl.Func("light")
    light[X, Y] = hl.Tuple([*lights, *raw])
    return light


def read_light(light: hl.Func, x: hl.Expr, y: hl.Expr) -> Light:
    """Return the light that `define_light` computes for a pixel."""
    there = light[x, y]
    return Light(*(there[k] for k in range(len(Light._fields))))


def define_both(light: hl.Func) -> hl.Func:
    """Return the luminance of every pixel for its neighbours: the mean of its good halves, `UNCOUNTED` if none is."""
    here, zero, half, both = read_light(light, X, Y), hl.f32(0.0), hl.f32(0.5), hl.Func("both")
    both[X, Y] = hl.select(
        (here.first >= zero) & (here.second >= zero),
        half * here.first + half * here.second,
        hl.max(here.first, here.second),
    )
    return both


def _read_crowd(crowd: hl.Func, x: hl.Expr, y: hl.Expr, first: int = 0) -> Crowd:
    there = crowd[x, y]
    return Crowd(*(there[first + k] for k in range(len(Crowd._fields))))


def _define_crowds(both: hl.Func) -> list[hl.Func]:
    """Return the crowds of the 1, 2, 4 ... pixels from (x, y) on to the right; a few of them make up a window's row."""
    crowds = [hl.Func("crowd1")]
    crowds[0][X, Y] = hl.Tuple([both[X, Y], hl.f32(UNCOUNTED), hl.f32(both[X, Y] >= hl.f32(0.0))])
    while 1 << len(crowds) <= 2 * FIREFLY_REACH + 1:
        length = 1 << len(crowds)
        crowds.append(hl.Func(f"crowd{length}"))
        first, second = (_read_crowd(crowds[-2], X + k, Y) for k in (0, length // 2))
        crowds[-1][X, Y] = hl.Tuple(list(first.join(second)))
    return crowds


def _define_row(crowds: Sequence[hl.Func]) -> hl.Func:
    """Return the crowds of a row of the window: of all its pixels, and of all but the one in the middle."""

    def gather(start: int, length: int) -> list[Crowd]:
        """Return disjoint crowds that cover ``length`` pixels of the row from x + ``start`` on."""
        read_crowds: list[Crowd] = []
        for power in range(len(crowds) - 1, -1, -1):
            if length >> power & 1:
                read_crowds.append(_read_crowd(crowds[power], X + start, Y))
                start += 1 << power
        return read_crowds

    row = hl.Func("row")
    whole, beside = (
        gather(-FIREFLY_REACH, 2 * FIREFLY_REACH + 1),
        [*gather(-FIREFLY_REACH, FIREFLY_REACH), *gather(1, FIREFLY_REACH)],
    )
    row[X, Y] = hl.Tuple([*_join_all(whole), *_join_all(beside)])
    return row


def _define_factor(light: hl.Func, row: hl.Func) -> hl.Func:
    """Return the factor of each half, in (0, 1]."""
    window, factor = hl.Func("window"), hl.Func("factor")
    rows = [_read_crowd(row, X, Y + k) for k in range(-FIREFLY_REACH, FIREFLY_REACH + 1) if k != 0]
    others = _join_all([_read_crowd(row, X, Y, len(Crowd._fields)), *rows])
    bound = hl.max(others.second, hl.f32(0.0)) * hl.f32(MAX_RATIO_TO_WINDOW)
    window[X, Y] = hl.select(others.count >= hl.f32(MIN_WINDOW_PIXELS), bound, hl.f32(LARGEST_FLOAT))
    here = read_light(light, X, Y)
    scales = []
    for own, other in ((here.first, here.second), (here.second, here.first)):
        bound = hl.max(window[X, Y], other * hl.f32(MAX_RATIO_TO_HALF))
        scales.append(hl.select(own > bound, bound / own, hl.f32(1.0)))
    factor[X, Y] = hl.Tuple(scales)
    return factor


def _define_tally(light: hl.Func, factor: hl.Func, width: hl.Expr, lanes: int) -> tuple[hl.Func, hl.Func, hl.Func]:
    """Return luminance before and taken away at every pixel, their partial sums along rows, and the output.

    A row has as many partial sums as a vector has lanes.
    """
    here, energy = read_light(light, X, Y), hl.Func("energy")
    parts = [here.raw_first, here.raw_second]
    taken = [part * (hl.f32(1.0) - factor[X, Y][k]) for k, part in enumerate(parts)]
    energy[X, Y] = hl.Tuple([parts[0] + parts[1], taken[0] + taken[1]])
    steps, lane = hl.RDom([(0, (width + lanes - 1) // lanes)], "steps"), hl.Var("lane")
    sums, tally = hl.Func("sums"), hl.Func("tally")
    sums[lane, Y] = hl.Tuple([hl.f32(0.0), hl.f32(0.0)])
    there = steps.x * lanes + lane
    sums[lane, Y] = hl.Tuple([sums[lane, Y][k] + energy[there, Y][k] for k in range(2)])
    tally[lane, Y] = hl.Tuple([sums[lane, Y][k] for k in range(2)])
    return energy, sums, tally


def _define_bounded(halves: Sequence[hl.ImageParam], factor: hl.Func) -> hl.Func:
    """Return both halves times their factors. Pixels with factor 1 keep their bits, NaN included."""
    out = hl.Func("bounded")
    colours = []
    for number, half in enumerate(halves):
        value, scale = half[C, X, Y], factor[X, Y][number]
        colours.append(select_bits(scale < hl.f32(1.0), value * scale, value))
    out[C, X, Y] = hl.Tuple(colours)
    return out
