"""Follow surfaces that move by themselves from frame to frame, and sample images at places between their pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.records.frame import FloatArray

FIXED_POINT_STEPS = 4
"""Steps in which the motion to the next frame is found from the motion that the next frame has to this one."""


def follow_back(places: FloatArray, motion: FloatArray) -> FloatArray:
    """Return where points were one frame earlier, (height, width, 2), column and row.

    Parameters
    ----------
    places : array, shape (height, width, 2)
        Column and row of the points in a frame, pixel centres at whole numbers.
    motion : array, shape (height, width, 2)
        Motion of that frame, see `lobewise.GBuffer`. The pixel nearest to a place tells its motion.
    """
    (followed,) = engine.pixels(_define_back, {"places": places, "motion": motion}, {})
    return np.asarray(followed)


def follow_on(places: FloatArray, guess: FloatArray, motion: FloatArray) -> FloatArray:
    """Return where points are one frame later, (height, width, 2), column and row.

    A point of this frame at p is at q in the next frame if the motion at q leads back to p. q is found by fixed-point
    steps.

    Parameters
    ----------
    places : array, shape (height, width, 2)
        Column and row of the points in a frame, pixel centres at whole numbers.
    guess : array, shape (height, width, 2)
        Motion of the points from the frame before to this frame, pixels; with even motion it is the step to the next.
    motion : array, shape (height, width, 2)
        Motion of the *next* frame, see `lobewise.GBuffer`.
    """
    (followed,) = engine.pixels(_define_on, {"places": places, "guess": guess, "motion": motion}, {})
    return np.asarray(followed)


def _read_near(grid: Grid, place: Vector) -> list[hl.Expr]:
    """Return the motion at the pixel nearest to a place, clamped to the image."""
    spots = []
    for value, extent in zip(place, grid.size, strict=True):
        known = hl.select(is_finite(value), hl.clamp(value, hl.f32(0.0), hl.f32(extent - 1)), hl.f32(0.0))
        spots.append(hl.clamp(hl.i32(hl.floor(known + hl.f32(0.5))), 0, extent - 1))
    return grid.read("motion", *spots)


def _define_back(grid: Grid) -> list[Vector]:
    places = grid.read("places")
    return [[place + step for place, step in zip(places, _read_near(grid, places), strict=True)]]


def _define_on(grid: Grid) -> list[Vector]:
    places, step = grid.read("places"), grid.read("guess")
    for number in range(FIXED_POINT_STEPS):
        there = _read_near(grid, [place + way for place, way in zip(places, step, strict=True)])
        # Half a step after the first: at edges of objects whole steps go to and fro.
        share = hl.f32(1.0 if number == 0 else 0.5)
        known = is_finite(there[0] + there[1])
        step = grid.share(
            [hl.select(known, way + share * (-back - way), way) for way, back in zip(step, there, strict=True)]
        )
    return [[place + way for place, way in zip(places, step, strict=True)]]


SNAP_SAMPLE_PIXELS = 0.01
"""Distance from a pixel's centre below which a place is the pixel itself: rounding must not blur a still image."""


def sample_cubic(image: FloatArray, places: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return an image at places between its pixels, by Catmull-Rom splines, and where the places lie in the image.

    Bilinear weights would blur an image that moves by half a pixel. Source: Catmull and Rom 1974, "A class of local
    interpolating splines".

    Parameters
    ----------
    image : array, shape (height, width) or (height, width, 3)
        Any values. The image goes on beyond its border with the value at the border.
    places : array, shape (height, width, 2)
        Column and row, pixel centres at whole numbers; NaN for no place.

    Returns
    -------
    array, shape as of ``image``
        0 where a place is not in the image or a value that it reads is not finite. Next to strong contrast values may
        lie outside the range of ``image``.
    bool array, shape (height, width)
        True where there is a value.
    """
    values, known = engine.pixels(_define_sample, {"image": image, "places": places}, {})
    return values, known


def _define_sample(grid: Grid) -> list[Vector]:
    width, height = grid.size
    starts = [
        _split_coordinate(value, extent) for value, extent in zip(grid.read("places"), (width, height), strict=True)
    ]
    inside = starts[0][2] & starts[1][2]
    (column, across, _), (row, down, _) = starts
    totals: list[hl.Expr] = []
    for j, vertical in enumerate(_weigh_taps(down)):
        y = hl.clamp(row + (j - 1), 0, height - 1)
        for i, horizontal in enumerate(_weigh_taps(across)):
            near = grid.read("image", hl.clamp(column + (i - 1), 0, width - 1), y)
            share = vertical * horizontal
            values = [share * value for value in near]
            totals = [total + value for total, value in zip(totals, values, strict=True)] if totals else values
    known = inside & is_finite(sum(totals[1:], totals[0]))
    return [[hl.select(known, total, hl.f32(0.0)) for total in totals], [hl.u8(known)]]


def _split_coordinate(raw: hl.Expr, extent: hl.Expr) -> tuple[hl.Expr, hl.Expr, hl.Expr]:
    """Return the pixel at or before a coordinate, the way on to it, and whether it is in the image."""
    inside = (raw > hl.f32(-0.5)) & (raw < hl.f32(extent) - hl.f32(0.5))
    value = hl.select(inside, raw, hl.f32(0.0))
    whole = hl.floor(value + hl.f32(0.5))
    value = hl.select(hl.abs(value - whole) < hl.f32(SNAP_SAMPLE_PIXELS), whole, value)
    first = hl.floor(value)
    return hl.i32(first), value - first, inside


def _weigh_taps(t: hl.Expr) -> list[hl.Expr]:
    """Return the weights of the pixels -1, 0, 1 and 2 from the start, at ``t`` in [0, 1) beyond it."""
    half, one = hl.f32(0.5), hl.f32(1.0)
    squared, cubed = t * t, t * t * t
    return [
        half * (hl.f32(2.0) * squared - cubed - t),
        half * (hl.f32(3.0) * cubed - hl.f32(5.0) * squared) + one,
        half * (hl.f32(4.0) * squared - hl.f32(3.0) * cubed + t),
        half * (cubed - squared),
    ]
