"""What a pixel brings along from the frame before: its sums, found, judged and gathered.

``out_i = sum_k b_k v(i, k) past_k`` (``v^2`` for squared weights) over the four pixels k of the frame before around the
place that pixel i came from: b the bilinear weights, v the product of the features' similarities between i as it is and
k as it was. The features are those of the filter; only the two pixels of a pair belong to two frames.

Channels of the sums, in and out: see `lobewise.filters.history.sums`. Out has one more, ``a = sum_k b_k v(i, k)``: how
much of the place agrees, 0 to 1 (and what `exp2` errs).

Where a pixel may have come from two places, its surface's and its reflection's, what agrees better counts more: both
are mixed by ``a^2``. Then all weights are scaled by the memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend import expressions
from lobewise.backend.buffers import HostImage, device_scope, download, take_image, take_mask
from lobewise.backend.jit import Scheduled, get_kernel
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars, give_features, give_scalars
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import describe_structure
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums, run_planes, widen
from lobewise.filters.planes import C, GuidePlanes, X, Y, count_inputs, make_guide_planes, neutralize, prepare_planes
from lobewise.filters.schedules.reprojection import schedule_reprojection
from lobewise.frame import FloatArray

AGREEMENT = HISTORY_CHANNELS
"""Channel behind the sums."""
REPROJECTED = (*Sums._fields, "agreement")
"""The planes that a reprojection writes."""

SNAP = 2e-3
"""Places within this many pixels of a pixel's centre are that pixel: rounding in a projection must not blur."""


@dataclass(frozen=True)
class Gathered:
    """What is read at four pixels."""

    func: hl.Func
    channels: int
    shared: bool
    """Whether it is read at the first place alone."""


@dataclass
class ReprojectionFuncs:
    """The Halide functions of a reprojection, for the schedules."""

    out: hl.Func
    signature: Signature
    sums: hl.Func
    taps: hl.RDom
    now: GuidePlanes
    """Guides and planes of this frame."""
    past: PastPixels


@dataclass
class PastPixels:
    """The four pixels of the frame before around each place, and what is computed of them.

    Images of that frame have one axis for all pixels, row after row, so that one index serves all of them.
    """

    width: hl.Param
    height: hl.Param
    way_count: int
    way: hl.Var = field(default_factory=lambda: hl.Var("w"))
    """The place that a sum is gathered at."""
    u: hl.Var = field(default_factory=lambda: hl.Var("u"))
    v: hl.Var = field(default_factory=lambda: hl.Var("v"))
    spots: hl.Func = field(default_factory=lambda: hl.Func("spots"))
    near: hl.Func = field(default_factory=lambda: hl.Func("near"))
    stages: list[hl.Func] = field(default_factory=list)
    """What is computed for each of the four pixels, in the order in which it is needed."""
    surface_stages: list[hl.Func] = field(default_factory=list)
    """As ``stages``, of what counts at the first place alone."""
    gathered: list[Gathered] = field(default_factory=list)
    """What is read at each of them."""

    def find(self, places: Sequence[hl.ImageParam]) -> tuple[hl.Expr, hl.Expr]:
        """Define the pixels around places, the column and row where each pixel was; return the part of a step beyond.

        A place far outside, or none at all (NaN), must not become an index.
        """

        def place(axis: int, length: hl.Expr) -> tuple[hl.Expr, hl.Expr]:
            raw = places[0][axis, X, Y]
            if len(places) > 1:
                raw = hl.select(self.way == 0, raw, places[1][axis, X, Y])
            near = (raw > hl.f32(-1.0)) & (raw < hl.f32(length))
            value = hl.select(near, raw, hl.f32(-2.0))
            whole = hl.floor(value + hl.f32(0.5))
            value = hl.select(hl.abs(value - whole) < hl.f32(SNAP), whole, value)
            first = hl.floor(value)
            return hl.i32(first), value - first

        width, height = self.width, self.height
        self.spots[X, Y, self.way] = hl.Tuple([*place(0, width), *place(1, height)])
        column, right, row, down = (self.spots[X, Y, self.way][k] for k in range(4))
        at_x, at_y = column + self.u, row + self.v
        inside = (at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height)
        index = hl.clamp(at_x, 0, width - 1) + hl.clamp(at_y, 0, height - 1) * width
        self.near[X, Y, self.way, self.u, self.v] = hl.Tuple([hl.select(inside, hl.i32(1), hl.i32(0)), index])
        return right, down

    def stage(self, *values: hl.Expr) -> Any:
        """Compute values of a pixel in a loop of their own."""
        return self._keep("stage", self.stages, (X, Y, self.way, self.u, self.v), values)

    def surface_stage(self, *values: hl.Expr) -> Any:
        """As `stage`, of what counts at the first place alone."""
        return self._keep("surface", self.surface_stages, (X, Y, self.u, self.v), values)

    def _keep(self, name: str, stages: list[hl.Func], axes: Sequence[hl.Var], values: Sequence[hl.Expr]) -> Any:
        func = hl.Func(f"{name}{len(stages)}")
        func[tuple(axes)] = hl.Tuple(list(values)) if len(values) > 1 else values[0]
        stages.append(func)
        return func[tuple(axes)]

    def is_inside(self, first_only: bool) -> hl.Expr:
        """Return whether there is such a pixel."""
        return self.near[X, Y, self._get_way(first_only), self.u, self.v][0] != 0

    def read(self, image: hl.ImageParam, count: int, first_only: bool = False) -> list[hl.Expr]:
        """Return the channels of an image at a pixel, which are copied at once: they lie together."""
        func = hl.Func(f"gathered{len(self.gathered)}")
        axes = [X, Y, self.u, self.v] if first_only else [X, Y, self.way, self.u, self.v]
        index = self.near[X, Y, self._get_way(first_only), self.u, self.v][1]
        index = hl.unsafe_promise_clamped(index, 0, self.width * self.height - 1)
        func[(C, *axes)] = image[C, index] if image.dimensions() == 2 else image[index]
        self.gathered.append(Gathered(func, count, first_only))
        return [func[(k, *axes)] for k in range(count)]

    def _get_way(self, first_only: bool) -> hl.Expr:
        return hl.i32(0) if first_only else self.way


def make_reprojection(features: Sequence[Feature], virtual_from: int | None = None) -> ReprojectionFuncs:
    """Return the algorithm; ``virtual_from`` is the first feature that counts at a second place, if there is one.

    Places are columns and rows where each pixel was, pixel centres at whole numbers; ``width`` and ``height`` those of
    the frame before. Images of this frame are at least as wide as a vector.
    """
    signature = Signature("reprojection")
    # Sums lie channel by channel.
    past_sums = signature.image("past", "pixels", HISTORY_CHANNELS, strides=(1, None))
    names = ("places",) if virtual_from is None else ("places", "virtual_places")
    places = [signature.image(name, "height", "width", 2) for name in names]
    mask_before = signature.image("mask_before", "pixels", type=hl.UInt(8))
    mask_now = signature.image("mask", "height", "width", type=hl.UInt(8))
    arrays_before = declare_features(signature, "before", features, "pixels")
    arrays_now = declare_features(signature, "own", features, "height", "width")
    scalars = declare_scalars(signature, features)
    memory = signature.number("memory")
    width, height = (signature.count(name, 1) for name in ("width_before", "height_before"))
    for name in REPROJECTED:
        signature.output(name, "height", "width")

    past = PastPixels(width, height, len(places))
    now = make_guide_planes("own", mask_now, features, scalars, inside=True, arrays=arrays_now)
    beyond = past.find(places)
    similarity, known = _compare(past, features, scalars, now, (mask_before, arrays_before), virtual_from)
    held = past.read(past_sums, HISTORY_CHANNELS)
    # What is no number is no history; it would spread by a pixel with every frame. 0 times it would be none either.
    usable = known & (mask_now[X, Y] != 0) & ~expressions.is_bad(sum(held[1:], held[0]))
    past.stage(*(hl.select(usable, value, hl.f32(0.0)) for value in (similarity, *held)))
    sums, taps = _gather(past, beyond)
    found, agreement = _mix(past, sums)
    out = hl.Func("out")
    out[X, Y] = hl.Tuple([*found.fade(memory), agreement])
    return ReprojectionFuncs(out, signature, sums, taps, now, past)


def _compare(
    past: PastPixels,
    features: Sequence[Feature],
    scalars: Sequence[Sequence[hl.Expr]],
    now: GuidePlanes,
    before: tuple[hl.ImageParam, Sequence[hl.ImageParam]],
    virtual_from: int | None,
) -> tuple[hl.Expr, hl.Expr]:
    """Return how similar a pixel is to one of the four, and whether there is one."""
    mask, arrays = before
    counts = count_inputs(features)
    here = [now.read(layout, X, Y) for layout in now.layouts]
    zero = hl.f32(0.0)

    def compare(part: slice, first_only: bool, keep: Callable[..., Any]) -> tuple[hl.Expr, hl.Expr]:
        """Return the log-similarity of some features, and whether there is anything."""
        chosen, own = features[part], scalars[part]
        known = past.is_inside(first_only) & (past.read(mask, 1, first_only)[0] != 0)
        first = len(count_inputs(features[: part.start]))
        inputs = slice(first, first + len(count_inputs(chosen)))
        pairs = zip(arrays[inputs], counts[inputs], strict=True)
        channels = [value for array, count in pairs for value in past.read(array, count, first_only)]
        values, layouts = prepare_planes(chosen, own, neutralize(chosen, channels, known))
        if values:
            seen = keep(*values)
            values = [seen[k] for k in range(len(values))] if len(values) > 1 else [seen]
        exponent: hl.Expr = zero
        for feature, i, layout, parameters in zip(chosen, here[part], layouts, own, strict=True):
            exponent = exponent + feature.log2_similarity(
                i, layout.read(values.__getitem__), parameters, (zero, zero), keep
            )
        return exponent, known

    exponent, known = compare(slice(virtual_from or 0, len(features)), False, past.stage)
    if virtual_from:
        # What counts at the surface's place alone is read there alone.
        surface = past.surface_stage(compare(slice(0, virtual_from), True, past.surface_stage)[0])
        exponent = exponent + hl.select(past.way == 0, surface, zero)
    return expressions.exp2(exponent), known


def _gather(past: PastPixels, beyond: tuple[hl.Expr, hl.Expr]) -> tuple[hl.Func, hl.RDom]:
    """Return the bilinear sums of the four pixels of each place, and how much of it agrees."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    taps = hl.RDom([(0, 2), (0, 2)], "taps")
    at = X, Y, past.way
    told = past.stages[-1][(*at, taps.x, taps.y)]
    agrees, held = told[0], Sums(*(told[1 + k] for k in range(HISTORY_CHANNELS)))
    right, down = beyond
    bilinear = hl.select(taps.x == 0, one - right, right) * hl.select(taps.y == 0, one - down, down)
    weight = bilinear * agrees
    taken = Sums(*(weight * value for value in held))
    taken = taken._replace(squared_weight=weight * agrees * held.squared_weight)
    sums = hl.Func("sums")
    sums[at] = hl.Tuple([zero] * len(REPROJECTED))
    sums[at] = hl.Tuple([sums[at][k] + value for k, value in enumerate([*taken, weight * one])])
    return sums, taps


def _mix(past: PastPixels, sums: hl.Func) -> tuple[Sums, hl.Expr]:
    """Return what was found, of two places by how well they agree, and how much of it agrees."""
    found = [sums[X, Y, 0][k] for k in range(len(REPROJECTED))]
    if past.way_count > 1:
        other = [sums[X, Y, 1][k] for k in range(len(REPROJECTED))]
        square, other_square = (each[AGREEMENT] * each[AGREEMENT] for each in (found, other))
        share = other_square / hl.max(square + other_square, hl.f32(1e-12))
        found = [value + share * (second - value) for value, second in zip(found, other, strict=True)]
    return Sums(*found[:AGREEMENT]), found[AGREEMENT]


@device_scope()
def run_reprojection(
    past: FloatArray,
    places: FloatArray,
    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    features: tuple[Sequence[Feature], Sequence[Feature]],
    *,
    virtual: tuple[FloatArray, int] | None = None,
    memory: float = 1.0,
    device: str = "cpu",
) -> FloatArray:
    """Gather the history of every pixel from where it was in the frame before.

    Parameters
    ----------
    past : array, shape (height, width, 7)
        Sums of the frame before; see `lobewise.filters.history.sums`.
    places : array, shape (height, width, 2)
        Column and row where each pixel was, pixel centres at whole numbers; NaN or outside where it was nowhere.
    masks : pair of bool arrays, shape (height, width)
        Where a pixel has meaning, before and now.
    features : pair of sequences of Feature
        Of the frame before and of this one, of one structure; a pixel's history counts by their similarities.
    virtual : (array, int), optional
        Second places, where each pixel's reflection was, and the first of the features that are compared there.
    memory : float
        What the weights found are scaled by, 0 to 1.
    device : str
        A name from `list_devices`.

    Returns
    -------
    array, shape (height, width, 8)
        The sums here, and how much of each place agrees, 0 to 1 (and what `exp2` errs).
    """
    height, width = size = (masks[1].shape[0], masks[1].shape[1])
    virtual_from = None if virtual is None else virtual[1]
    before: dict[str, HostImage] = {"mask_before": take_mask(masks[0]), **_take("before", features[0], size)}
    ways = {"places": places} if virtual is None else {"places": places, "virtual_places": virtual[0]}
    now: dict[str, HostImage] = {name: take_image(name, way, (*size, 2)) for name, way in ways.items()}
    now |= {"mask": take_mask(masks[1]), **_take("own", features[1], size)}
    images = {name: image.reshape(height * width, *image.shape[2:]) for name, image in before.items()}
    images |= {"past": _flatten_history(past, size), **{name: widen(image) for name, image in now.items()}}
    numbers = {"memory": memory, "width_before": width, "height_before": height, **give_scalars(features[1])}
    key = "reprojection", virtual_from, *map(describe_structure, features[1])
    kernel = get_kernel(device, key, partial(_make_scheduled, features[1], virtual_from))
    return run_planes(kernel, device, images, numbers, size)


def _make_scheduled(features: Sequence[Feature], virtual_from: int | None, target: hl.Target) -> Scheduled:
    """Return a reprojection, ready to be compiled."""
    funcs = make_reprojection(features, virtual_from)
    schedule_reprojection(funcs, target)
    return Scheduled([funcs.out], funcs.signature)


def _take(prefix: str, features: Sequence[Feature], size: tuple[int, int]) -> dict[str, FloatArray]:
    return {name: download(image) for name, image in give_features(prefix, features, size).items()}


def _flatten_history(past: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return sums (height * width, 7) whose channels lie one after the other; copied only where they do not yet."""
    planes = np.moveaxis(past, -1, 0)
    if past.shape != (*size, HISTORY_CHANNELS) or past.dtype != np.float32 or not planes[0].flags.c_contiguous:
        planes = np.ascontiguousarray(np.moveaxis(take_image("past", past, (*size, HISTORY_CHANNELS)), -1, 0))
    return np.moveaxis(planes.reshape(HISTORY_CHANNELS, size[0] * size[1]), 0, -1)
