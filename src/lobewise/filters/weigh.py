"""Weighted sums over the taps of a pixel: what taps read, what they weigh, and how the sums are computed.

``sum_j w(i, j) I_j``, where ``w`` is 2 to the power of a log-weight: a product of similarities and of whatever else a
kernel multiplies. The cross filter (`cross_pass`) and the dual-buffer filter (`dual_buffer`) say what is summed, what
its logarithm is, and what becomes of the sums.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lobewise.backend import expressions
from lobewise.backend.compiler import declare_vars, hl
from lobewise.features.base import Feature, Stage
from lobewise.filters.forms import Taps
from lobewise.filters.planes import C, Columns, GuidePlanes, X, Y, make_guide_planes, make_image
from lobewise.filters.scheduling import STRIP_ROWS, fill_planes, fill_rows, keep_planes, spread_channels
from lobewise.settings import LARGEST_RADIUS

U, V = declare_vars("u", "v")
"""Offset of a tap, in steps to the right and down."""
TILE_ROWS, TILE_VECTORS = 8, 8
"""Size of the tiles whose sums lie on the stack: rows, and vectors of columns."""


def make_stage(stages: list[hl.Func], at: Sequence[hl.Var]) -> Stage:
    """Return a `Stage` that computes a value of pixel and tap in a function of its own and adds it to ``stages``."""

    def stage(value: hl.Expr) -> hl.Expr:
        func = hl.Func(f"stage{len(stages)}")
        func[tuple(at)] = value
        stages.append(func)
        return func[tuple(at)]

    return stage


class TapSums:
    """The weighted sums of a kernel.

    Parameters
    ----------
    mask : halide.ImageParam
        1 where a pixel has meaning, else 0.
    taps : Taps
        What a pixel sums over.
    reach, step : halide.Expr
        Taps from the centre to the edge of the kernel, and pixels from tap to tap.
    lanes : int
        Pixels of a processor's vector; 0 for graphics cards.
    """

    def __init__(self, mask: hl.ImageParam, taps: Taps, reach: hl.Expr, step: hl.Expr, lanes: int) -> None:
        self._mask, self._taps, self._reach, self._step = mask, taps, reach, step
        across = hl.i32(0) if taps is Taps.VERTICAL else step * reach
        self._rows = Columns(mask.width(), across, lanes) if lanes else None
        self._images: list[tuple[hl.Func, int]] = []
        self._planes: list[GuidePlanes] = []
        self._stages: list[hl.Func] = []
        self.stage = make_stage(self._stages, (X, Y, U, V))

    # Algorithm

    def read(self, name: str, channels: int, take: Callable[[tuple[hl.Expr, hl.Expr], hl.Expr], hl.Expr]) -> hl.Func:
        """Return an image of (x, c, y) that taps read; see `make_image`."""
        image = make_image(name, self._mask, self._rows, take)
        self._images.append((image, channels))
        return image

    def compare(
        self,
        name: str,
        features: Sequence[Feature],
        scalars: Sequence[Sequence[hl.Expr]],
        arrays: Sequence[hl.ImageParam],
        start: hl.Expr | None = None,
    ) -> hl.Expr:
        """Return the base-2 logarithm of the similarity of a pixel and a tap, added to ``start``."""
        planes = make_guide_planes(name, self._mask, features, scalars, arrays=arrays, rows=self._rows)
        self._planes.append(planes)
        total: hl.Expr = hl.f32(0.0) if start is None else start
        offset = hl.f32(U * self._step), hl.f32(V * self._step)
        for feature, layout, own in zip(features, planes.layouts, scalars, strict=True):
            i, j = planes.read(layout, X, Y), planes.read(layout, X + U * self._step, Y + V * self._step)
            total = total + feature.log2_similarity(i, j, own, offset, self.stage)
        return total

    def add(
        self,
        log_weight: hl.Expr,
        take: Callable[[hl.Expr, hl.Expr, hl.Expr], list[hl.Expr]],
        *,
        mirrored: bool = False,
    ) -> list[hl.Expr]:
        """Return the sums of a pixel.

        Parameters
        ----------
        log_weight : halide.Expr
            Base-2 logarithm of the weight of the tap (u, v).
        take : callable
            Returns the summands of a tap, of its weight, column and row.
        mirrored : bool
            Compute each weight of two pixels of a row once, for both: only horizontal taps.
        """
        logs = hl.Func("log_weight")
        logs[X, Y, U, V] = log_weight
        self._stages.append(logs)
        span, self._row, self._sums = [(-self._reach, 2 * self._reach + 1)], hl.Func("row"), hl.Func("sums")
        self._weights = hl.Func("weights") if mirrored else None
        # Each row of taps is summed in a function of its own, so that its sums stay in registers. A vertical pass has
        # its whole column of taps there.
        if self._weights is None:
            inner = hl.RDom(span, "inner")
            u, v = (V, inner.x) if self._taps is Taps.VERTICAL else (inner.x, V)
            terms = take(expressions.exp2(logs[X, Y, u, v]), X + u * self._step, Y + v * self._step)
            self._row[X, Y, V] = hl.Tuple([hl.f32(0.0)] * len(terms))
        else:
            # Weights of a pixel with its right-hand neighbours. Each weight serves both pixels of the pair.
            inner, weights = hl.RDom([(1, self._reach)], "inner"), self._weights
            weights[X, Y, U] = expressions.exp2(logs[X, Y, U, 0])
            self._row[X, Y, V] = hl.Tuple(take(weights[X, Y, 0], X, Y))
            after = take(weights[X, Y, inner.x], X + inner.x, Y)
            before = take(weights[X - inner.x, Y, inner.x], X - inner.x, Y)
            terms = [p + q for p, q in zip(after, before, strict=True)]
        row, sums = self._row[X, Y, V], self._sums
        self._row[X, Y, V] = hl.Tuple([row[k] + term for k, term in enumerate(terms)])
        outer = hl.RDom(span if self._taps in (Taps.SQUARE, Taps.ATROUS) else [(0, 1)], "outer")
        sums[X, Y] = hl.Tuple([hl.f32(0.0)] * len(terms))
        sums[X, Y] = hl.Tuple([sums[X, Y][k] + self._row[X, Y, outer.x][k] for k in range(len(terms))])
        return [sums[X, Y][k] for k in range(len(terms))]

    # Schedule

    def schedule(
        self, out: hl.Func, channels: int, numbers: hl.Func | None = None, finish: hl.Func | None = None
    ) -> None:
        """Schedule a kernel whose output ``out`` of (c, x, y) or (x, c, y) has so many channels.

        ``numbers`` of (x, y) are further outputs, and both read ``finish`` then.
        """
        if self._rows is None:
            self._spread(out, channels)
            return
        strip, column = self._schedule_outputs(out, channels, self._rows.lanes, numbers, finish)
        self._schedule_sums(out, strip, column, self._rows.lanes)
        for image, count in self._images:
            fill_rows(image.compute_at(out, strip), count, self._rows)
        for planes in self._planes:
            fill_planes(planes, self._rows, (out, strip))

    def _schedule_outputs(
        self, out: hl.Func, channels: int, lanes: int, numbers: hl.Func | None, finish: hl.Func | None
    ) -> tuple[hl.Var, hl.Var]:
        """Run strips of rows in parallel and columns in vectors; return the loops over strips and columns of tiles.

        Strips of rows are independent: memory is bounded, and the number of threads changes no bit.
        """
        tail = hl.TailStrategy.GuardWithIf
        xo, yo, xi, yi, ys, yt, xv, xw = (hl.Var(name) for name in ("xo", "yo", "xi", "yi", "ys", "yt", "xv", "xw"))
        out.bound(C, 0, channels).reorder(C, X, Y).unroll(C)
        for func in (out, numbers):
            if func is not None:
                func.split(Y, ys, yt, STRIP_ROWS, tail)
                func.tile(X, yt, xo, yo, xi, yi, TILE_VECTORS * lanes, TILE_ROWS, tail)
                func.split(xi, xv, xw, lanes, tail).reorder(xw, xv, yi, xo, yo, ys)
                func.vectorize(xw).parallel(ys).never_partition([xw, yi, xo, yo, ys])
        out.reorder(C, xw)
        if out.args()[0].name() == C.name():
            for buffer in out.output_buffers():
                # A known stride makes whole stores of interleaved vectors.
                buffer.dim(1).set_stride(channels)
        if numbers is not None and finish is not None:
            # Tell the compiler that all outputs have one size; otherwise it emits every loop three times.
            whole, beside = out.output_buffers()[0], numbers.output_buffers()[0]
            for axis in (0, 1):
                beside.dim(axis).set_bounds(whole.dim(axis + 1).min(), whole.dim(axis + 1).extent())
            numbers.compute_with(out, xv)
            # Guard its vectors instead of moving them inwards: in a row narrower than a vector they would read mask and
            # albedo outside the image.
            finish.compute_at(out, xv).vectorize(X, lanes, tail).bound_storage(X, lanes).bound_storage(Y, 1)
        return ys, xo

    def _schedule_sums(self, out: hl.Func, strip: hl.Var, column: hl.Var, lanes: int) -> None:
        """Keep log-similarities of one row of taps in cache, and the sums of a tile on the stack.

        Measured (AMD EPYC with AVX-512, two threads; benchmarks/results/filters.json), 512x512, all taps of radius 8:
        ``normal`` 18 ms, ``sg`` 24 ms, ``ggx`` 44 ms. Alternatives that were tried:
        docs/developers/performance.md. Reasons:

        - Each stage of the log-similarity has its own loop over a row of taps, so that no loop runs out of vector
          registers. Its results stay in the first-level cache.
        - The planes of a row lie side by side, padded to whole vectors. Planes a power of two apart would share cache
          sets.
        - A column of taps goes down vector by vector. The rows of a vector stay in the first-level cache.
        - The sums of a tile have a fixed size. Allocating memory in a loop costs as much as 12 taps.
        """
        xv, xw, is_column = hl.Var("xv"), hl.Var("xw"), self._taps is Taps.VERTICAL
        row, sums, weights = self._row, self._sums, self._weights
        sums.compute_at(out, column).vectorize(X, lanes)
        sums.bound_storage(X, TILE_VECTORS * lanes).bound_storage(Y, TILE_ROWS)
        across, within = ([xw, Y, xv], Y) if is_column else ([xw, xv, Y], xv)
        sums.update().split(X, xv, xw, lanes).reorder(*across, sums.rvars()[0]).vectorize(xw)
        row.compute_at(sums, within).vectorize(X, lanes)
        row.update().reorder(X, row.rvars()[0]).vectorize(X, lanes)
        if weights is not None:
            weights.compute_at(sums, Y).split(X, xv, xw, lanes).reorder(xw, U, xv, Y).vectorize(xw)
            weights.bound_storage(U, LARGEST_RADIUS + 1).bound_storage(Y, 1).hoist_storage(out, strip)
        taps, single = (V, U) if is_column else (U, V)
        for stage in self._stages:
            (stage.compute_at(sums, within) if weights is None else stage.compute_at(weights, xv)).vectorize(X, lanes)
            stage.bound_storage(taps, 2 * LARGEST_RADIUS + 1).bound_storage(single, 1)
            stage.bound_storage(X, lanes).bound_storage(Y, 1)

    def _spread(self, out: hl.Func, channels: int) -> None:
        """On graphics cards give each pixel a thread, which computes all its sums. Keep images and planes in memory."""
        self._sums.compute_at(out, spread_channels(out, channels))
        self._row.compute_at(self._sums, self._sums.rvars()[0])
        for stage in self._stages:
            stage.compute_at(self._row, self._row.rvars()[0])
        for image, count in self._images:
            keep_planes(image, count)
        for planes in self._planes:
            keep_planes(planes.planes, planes.plane_count)
