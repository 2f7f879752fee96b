"""Where the pixels of a frame are in another frame of its window."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lobewise.filters.windows.following import follow_back, follow_on
from lobewise.guides.places import compute_surface_places, compute_virtual_places, make_grid
from lobewise.recipes.windows.shots import Shot
from lobewise.records.frame import FloatArray


def compute_places(shots: Mapping[int, Shot], index: int, other: int) -> FloatArray | None:
    """Return column and row of each pixel's surface point in another frame, (height, width, 2).

    Still surfaces are projected by the camera of the other frame. Surfaces that move are followed frame by frame.

    Parameters
    ----------
    shots : mapping of int to Shot
        The frames by number; all frames from ``index`` to ``other`` are there.
    index, other : int
        Number of the frame, and of the other frame.

    Returns
    -------
    array, shape (height, width, 2), or None
        None if neither cameras nor motion tell.
    """
    shot = shots[index]
    first, second = shot.guides.camera, shots[other].guides.camera
    still = None
    if first is not None and second is not None and shot.is_placed:
        still, _ = compute_surface_places(first, second, shot.guides.places, None)
        if not shot.moves.any():
            return still
    moved = _follow(shots, index, other)
    if still is None or moved is None:
        return still if moved is None else moved
    return np.where(shot.moves[..., None], moved, still)


def compute_reflections(shot: Shot, other: Shot) -> FloatArray | None:
    """Return column and row of each pixel's reflection in another frame, (height, width, 2); NaN where it is unknown.

    None without cameras.
    """
    first, second = shot.guides.camera, other.guides.camera
    if first is None or second is None or not shot.is_placed:
        return None
    return compute_virtual_places(shot.guides.places[0], shot.curvature, shot.hits, first, second)


def _follow(shots: Mapping[int, Shot], index: int, other: int) -> FloatArray | None:
    """Return the places in another frame, by the motion of every frame between; None where a frame lacks its motion."""
    guess = shots[index].frame.gbuffer.motion
    places = make_grid(shots[index].frame.shape)
    steps = range(index, other, -1) if other < index else range(index + 1, other + 1)
    for number in steps:
        motion = shots[number].frame.gbuffer.motion
        if motion is None:
            return None
        if other < index:
            places = follow_back(places, motion)
        else:
            places = follow_on(places, motion if guess is None else guess, motion)
    return places
