"""What schedules of processors have in common: strips of rows in parallel, planes of a strip in vectors."""

from __future__ import annotations

import halide as hl

from lobewise.filters.planes import C, GuidePlanes, Rows, X, Y

STRIP_ROWS = 32
"""Rows of an image that a thread of the processor takes at a time."""


def count_lanes(target: hl.Target) -> int:
    """Return the pixels of a processor's vector; 0 for graphics cards, which have none."""
    return 0 if target.has_gpu_feature() else int(target.natural_vector_size(hl.Float(32)))


def fill_planes(planes: GuidePlanes, rows: Rows, strips: tuple[hl.Func, hl.Var]) -> None:
    """Let planes lie row by row beside each other, in memory of every one of ``strips``.

    Channels of a pixel lie together in memory; a vector of them is taken apart once, and not once per plane.
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
    """Let the channels of a function lie row by row beside each other, from whole vectors where there are."""
    func.bound(C, 0, channels).reorder_storage(X, C, Y).align_storage(X, rows.lanes).align_bounds(X, rows.lanes)
    for number, domain in enumerate((*rows.margins, *rows.parts)):
        update = func.update(number).unroll(C)
        if number < len(rows.margins):
            vectors, lane = hl.RVar("vectors"), hl.RVar("lane")
            update.split(domain.x, vectors, lane, rows.lanes).reorder(C, lane, vectors, Y).vectorize(lane)
        elif domain.dimensions() == 2:
            # No two lanes are one column.
            update.reorder(C, domain.x, domain.y, Y).allow_race_conditions().vectorize(domain.x)
        else:
            update.reorder(C, domain.x, Y)


def keep_rows(func: hl.Func, channels: int, lanes: int) -> None:
    """Let the channels of a function lie row by row beside each other, computed vector by vector.

    One loop for all channels: a loop for each would take the compiler several times as long.
    """
    func.bound(C, 0, channels).reorder_storage(X, C, Y).align_storage(X, lanes).reorder(C, X, Y)
    func.vectorize(X, lanes).unroll(C).never_partition([Y])
