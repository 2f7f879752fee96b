"""Projection of points by a camera, and the motion of surface points between two cameras, in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.chunks import Chunk, run_chunks
from lobewise.frame import FloatArray


def project_points(camera: Camera, points: NDArray[np.floating[Any]], width: int, height: int) -> FloatArray:
    """Return the pixel coordinates of world points, shape (..., 2): column and row, pixel centres at .5.

    The coordinates of a point behind the camera are not finite.
    """
    half_width, half_height = camera.get_half_extent(width, height)
    # Coordinates of points that are not finite are not finite either.
    with np.errstate(invalid="ignore", over="ignore"):
        offset = points - camera.position
        ahead = offset @ camera.forward
        scale = np.divide(1.0, ahead, out=np.full_like(ahead, np.nan), where=ahead > 0)
        x = ((offset @ camera.right) * scale - camera.shift[0]) / half_width
        y = ((offset @ camera.up) * scale - camera.shift[1]) / half_height
        return np.stack([(x + 1.0) * 0.5 * width, (1.0 - y) * 0.5 * height], axis=-1).astype(np.float32)


def compute_motion(camera: Camera, previous: Camera, position: FloatArray, depth: FloatArray) -> FloatArray:
    """Return where each pixel's surface point was in the previous frame, relative to the pixel.

    A pixel without a surface (depth 0) shows the background, which is infinitely far. A point that lay behind the
    previous camera moves by twice the size of the image, so that it is outside.

    Parameters
    ----------
    position : (height, width, 3)
        World positions of the surface points in the previous frame; ignored where the depth is 0.
    depth : (height, width)
        Distances along the rays; 0, or not finite, for the background.

    Returns
    -------
    (height, width, 2)
        Pixels, previous minus current place, x right and y down.
    """
    height, width = depth.shape
    is_hit = (depth > 0) & np.isfinite(depth)
    rays = None if is_hit.all() else camera.make_ray_directions(width, height)
    outside = np.array([2.0 * width, 2.0 * height])
    motion = np.empty((height, width, 2), np.float32)

    def work(chunk: Chunk) -> None:
        points = position[chunk].astype(np.float64)
        if rays is not None:
            points = np.where(is_hit[chunk][..., None], points, rays[chunk] + previous.position)
        step = project_points(previous, points, width, height).astype(np.float64)
        step[..., 0] -= np.arange(width)[chunk[1]] + 0.5
        step[..., 1] -= np.arange(height)[chunk[0], None] + 0.5
        motion[chunk] = np.where(np.isfinite(step), step, outside)

    run_chunks(work, height, width)
    return motion
