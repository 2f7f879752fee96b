"""Schedule of the kernel that shares out specks, for processors and graphics cards."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.backend.compiler import hl
from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import ALIGNMENT, spread_pixels
from lobewise.filters.schedules.rows import STRIP_ROWS


@dataclass(frozen=True, kw_only=True)
class SpeckFuncs:
    """The functions of the kernel."""

    bright: hl.Func
    """Luminance; 0 outside the image."""
    mixed: hl.Func
    """Whether a pixel shows several objects, and whether it lies inside the image; each 1 or 0."""
    rows: hl.Func
    """Sums of ``mixed`` along rows of the window."""
    blurred: hl.Func
    near: hl.Func
    """Whether a row of the window has a blurred pixel, 1 or 0."""
    low: hl.Func
    """Luminance up to the bound, luminance above the bound, and the weight with which the pixel takes light."""
    quotient: hl.Func
    """Luminance above the bound over the sum of weights around; luminance that no pixel takes."""
    out: hl.Func


def schedule_specks(funcs: SpeckFuncs, target: hl.Target) -> None:
    """Run strips of rows in parallel, planes in cache; on graphics cards give each pixel a thread, planes in memory."""
    x, y, _ = PIXEL
    planes = (funcs.bright, funcs.mixed, funcs.rows, funcs.blurred, funcs.near, funcs.low, funcs.quotient)
    if target.has_gpu_feature():
        spread_pixels(funcs.out, x, y)
        for func in planes:
            func.compute_root().align_bounds(x, ALIGNMENT)
            spread_pixels(func, x, y)
        return
    lanes = target.natural_vector_size(hl.Float(32))
    ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
    funcs.out.split(y, ys, yi, STRIP_ROWS, tail).vectorize(x, lanes, tail).parallel(ys).never_partition_all()
    for func in planes:
        func.compute_at(funcs.out, ys).vectorize(x, lanes)
