"""Follow surfaces that move by themselves from frame to frame, forwards and backwards."""

from __future__ import annotations

import numpy as np

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
