"""Common parts of schedules for processors: strips of rows in parallel, planes of a strip in vectors."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.filters.planes import C, GuidePlanes, Rows, X, Y

STRIP_ROWS = 32
"""Rows that a thread takes at a time."""


def count_lanes(target: hl.Target) -> int:
    """Return the number of pixels of a target's vector; 0 for graphics cards, which have no vectors."""
    return 0 if target.has_gpu_feature() else int(target.natural_vector_size(hl.Float(32)))


def fill_planes(planes: GuidePlanes, rows: Rows, strips: tuple[hl.Func, hl.Var]) -> None:
    """Compute planes per strip, the planes of a row side by side; ``strips`` is the loop over strips.

    In the input the channels of a pixel lie together: a vector of pixels is deinterleaved once, not once per plane.
    """
    if planes.planes is None:
        return
    fill_rows(planes.planes.compute_at(*strips), planes.plane_count, rows)
    for guides, part in zip(planes.row_guides, rows.parts, strict=False):
        vector = part.dimensions() == 2
        guides.compute_at(planes.planes, part.y if vector else part.x)
        guides.bound(C, 0, planes.guide_count).reorder_storage(X, C, Y).reorder(C, X, Y).unroll(C)
        guides.bound_storage(X, rows.lanes if vector else 1).bound_storage(Y, 1)
        if vector:
            guides.vectorize(X, rows.lanes)


def fill_rows(func: hl.Func, channels: int, rows: Rows) -> None:
    """Compute a function of `Rows`, the channels of a row side by side, in whole vectors as far as possible."""
    func.bound(C, 0, channels).reorder_storage(X, C, Y).align_storage(X, rows.lanes).align_bounds(X, rows.lanes)
    for number, domain in enumerate((*rows.margins, *rows.parts)):
        update = func.update(number).unroll(C)
        if number < len(rows.margins):
            vectors, lane = hl.RVar("vectors"), hl.RVar("lane")
            update.split(domain.x, vectors, lane, rows.lanes).reorder(C, lane, vectors, Y).vectorize(lane)
        elif domain.dimensions() == 2:
            # No two lanes write the same column.
            update.reorder(C, domain.x, domain.y, Y).allow_race_conditions().vectorize(domain.x)
        else:
            update.reorder(C, domain.x, Y)


def keep_rows(func: hl.Func, channels: int, lanes: int) -> None:
    """Compute a function vector by vector, the channels of a row side by side.

    All channels share one loop: with a loop for each, compiling takes several times as long.
    """
    func.bound(C, 0, channels).reorder_storage(X, C, Y).align_storage(X, lanes).reorder(C, X, Y)
    func.vectorize(X, lanes).unroll(C).never_partition([Y])
