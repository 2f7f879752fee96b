"""Where in the frame before a pixel looks for its history: at its surface point, and at its virtual image.

What a pixel reflects does not stay on the surface when the camera moves: it moves like the reflected thing's virtual
image, which lies behind a flat mirror as far as the thing lies before it, and nearer behind a convex one.
"""

from __future__ import annotations

import numpy as np

from lobewise.camera import Camera
from lobewise.frame import FloatArray
from lobewise.guides.places import find_curvature, find_image_places

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

    return find_curvature(position, normal, EDGE)


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
    return find_image_places(position, curvature, hit_distance, camera, previous, FAR)
