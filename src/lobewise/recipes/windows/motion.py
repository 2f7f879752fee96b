"""Whether motion vectors mean what windows take them for, by what the cameras tell of surfaces that stand still."""

from __future__ import annotations

import numpy as np

from lobewise.guides.places import compute_surface_places, make_grid
from lobewise.recipes.temporal.validation import Guides
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

MIN_MOTION_PIXELS = 0.5
"""Median motion of the image, pixels, from which on the cameras tell what the vectors mean."""
MIN_ERROR_OF_WRONG, MAX_ERROR_OF_RIGHT = 0.2, 0.05
"""Median difference between vectors and the motion by the cameras, over the median motion: from the first on the
vectors are wrong, up to the second another meaning is right. In between surfaces move by themselves."""
SIGNS = {
    (-1.0, -1.0): "negated: --map motion=PASS:negate",
    (1.0, -1.0): "with y upwards: --map motion=PASS:y_up",
    (-1.0, 1.0): "negated and with y upwards: --map motion=PASS:negate:y_up",
}
"""Other signs of x and y, and how a user tells them."""


def describe_motion(motion: FloatArray, guides: Guides, previous: Camera) -> tuple[str, ...]:
    """Return a sentence if the motion vectors contradict the cameras and another meaning does not; else nothing.

    Parameters
    ----------
    motion : (height, width, 2)
        Pixels, to the previous frame.
    guides : Guides
        Guides of the frame, which is placed.
    previous : Camera
        Camera of the previous frame.
    """
    height, width = motion.shape[:2]
    assert guides.camera is not None
    still, _ = compute_surface_places(guides.camera, previous, guides.places, None)
    by_cameras = still - make_grid((height, width))
    depth = guides.places[1]
    there = (depth > 0.0) & np.isfinite(depth) & np.isfinite(motion).all(axis=-1) & np.isfinite(by_cameras).all(axis=-1)
    given, expected = motion[there], by_cameras[there]
    length = _measure(expected)
    if not length >= MIN_MOTION_PIXELS or _measure(given - expected) < MIN_ERROR_OF_WRONG * length:
        return ()
    meanings = {f"They are {words}.": np.array(sign) for sign, words in SIGNS.items()}
    for words, unit in (("the image's size", 1.0), ("half the image's size", 0.5)):
        for sign in ((1.0, 1.0), *SIGNS):
            scale = unit * np.array([width, height]) * sign
            meanings[f"They are shares of {words}: multiply x by {scale[0]:g} and y by {scale[1]:g}."] = scale
    for words, scale in meanings.items():
        if _measure(given * scale - expected) < MAX_ERROR_OF_RIGHT * length:
            return (f"The motion vectors contradict the cameras, so that they find nothing. {words}",)
    return ()


def _measure(vectors: FloatArray) -> float:
    """Return the median length of vectors, (count, 2); infinite without any."""
    return float(np.median(np.hypot(vectors[..., 0], vectors[..., 1]))) if len(vectors) else float("inf")
