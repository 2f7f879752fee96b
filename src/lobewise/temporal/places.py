"""Where in the frame before a pixel looks for its history: at its surface point, and at its virtual image.

What a pixel reflects does not stay on the surface when the camera moves: it moves like the reflected thing's virtual
image, which lies behind a flat mirror as far as the thing lies before it, and nearer behind a convex one.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from lobewise.chunks import map_chunks
from lobewise.frame import Camera, FloatArray
from lobewise.motion import project_points

FAR = 1e6
"""Distance, in distances from the camera, at which what a lobe does not hit is taken to be."""
EDGE = 4.0
"""Ratio of the squared steps to the neighbours on both sides of a pixel from which the longer one leads elsewhere."""


def add_grid(motion: FloatArray) -> FloatArray:
    """Return column and row of where each pixel was, pixel centres at whole numbers, (height, width, 2)."""
    height, width = motion.shape[:2]
    places = motion.copy()
    places[..., 0] += np.arange(width, dtype=np.float32)
    places[..., 1] += np.arange(height, dtype=np.float32)[:, None]
    return places


def estimate_curvature(position: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the mean curvature of the surface at each pixel, 1/world unit, > 0 for convex, shape (height, width).

    From how the normals of the neighbours open, ``(dn . dx) / |dx|^2``, along rows and along columns, each time of the
    side that is much nearer or else of the one that is flatter, so that neither the edge of an object counts nor a
    crease. A single row or column counts as flat in the other direction.
    """

    def along(axis: int) -> FloatArray:
        dx, dn = np.diff(position, axis=axis), np.diff(normal, axis=axis)
        square = np.einsum("...k,...k->...", dx, dx)
        slope = np.einsum("...k,...k->...", dn, dx) / np.maximum(square, 1e-20)
        # What is no number is no neighbour.
        square = np.where(np.isfinite(slope), square, np.inf)
        mode: Literal["edge", "constant"] = "edge" if slope.shape[axis] else "constant"
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 1)

        def get_sides(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            padded = np.moveaxis(np.pad(values, pad, mode=mode), axis, 0)
            return np.moveaxis(padded[:-1], 0, axis), np.moveaxis(padded[1:], 0, axis)

        (first, second), (near, far) = get_sides(slope), get_sides(square)
        flatter = np.where(np.abs(first) < np.abs(second), first, second)
        return np.where(near > EDGE * far, second, np.where(far > EDGE * near, first, flatter))

    with np.errstate(invalid="ignore", over="ignore"):
        curvature = 0.5 * (along(0) + along(1))
    return np.asarray(np.nan_to_num(curvature, nan=0.0, posinf=0.0, neginf=0.0), dtype=np.float32)


def find_virtual_places(
    position: FloatArray,
    curvature: FloatArray,
    hit_distance: FloatArray,
    camera: Camera,
    previous: Camera,
) -> FloatArray:
    """Return column and row where each pixel's reflection was in the frame before, shape (height, width, 2).

    The virtual image of what is seen at distance t lies ``t / (1 + 2 c t)`` behind the surface along the view ray, c
    the curvature (thin mirror equation, paraxial); that point is projected by the previous camera. A reflection that
    moved with its object keeps no place of its own: the lobes decide whether what is found fits. Where the hit is
    unknown (0) there is no place: NaN.

    Source: the mirror equation of optics; that reflections have a motion of their own, Zimmer et al. 2015, "Path-space
    motion estimation and decomposition for robust animation filtering".
    """
    height, width = hit_distance.shape
    eye = camera.position.astype(np.float32)
    nowhere = (previous.position - previous.forward).astype(np.float32)

    def find(position: FloatArray, curvature: FloatArray, hit_distance: FloatArray) -> FloatArray:
        view = position - eye
        distance = np.sqrt(np.einsum("...k,...k->...", view, view))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            t = np.where(np.isinf(hit_distance), np.float32(FAR) * distance, hit_distance)
            opening = 1.0 + 2.0 * curvature * t
            # A concave mirror's image turns over at the focus; beyond it nothing is tracked.
            behind = np.where(opening > 0.0, t / np.maximum(opening, np.float32(1e-6)), np.float32(np.nan))
            image = position + view * (behind / distance)[..., None]
        known = (hit_distance > 0.0) & np.isfinite(behind)
        image = np.where(known[..., None], image, nowhere)
        return project_points(previous, image.astype(np.float64), width, height) - np.float32(0.5)

    places: FloatArray = map_chunks(find, position, curvature, hit_distance)
    return places
