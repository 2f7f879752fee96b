"""Finds disoccluded pixels: the previous frame did not show their surface, so no history of it can exist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import MissingChannelError
from lobewise.records.camera import Camera, compute_motion
from lobewise.records.frame import FloatArray, GBuffer
from lobewise.records.images import refuse_size

MOVING_PIXELS = 0.05
"""Smallest difference in pixels between the motion of an object and the motion of a still point. Less is rounding."""

DEPTH_SLACK = 2.0
"""Largest difference of depths on one still surface, in units of the change of depth between neighbouring pixels."""

MOVING_DEPTH = 0.1
"""Largest change of a moving object's depth from frame to frame, relative to the depth."""

NORMAL_COSINE = 0.5
"""Smallest cosine between normals of one surface: an angle of 60 degrees."""

TAP_WEIGHT = 0.125
"""Smallest weight in bilinear interpolation of the pixels, of four, that are compared."""


@dataclass(frozen=True)
class _View:
    """The surfaces of a frame: per pixel the surface point, its distance (0 for background), its normal if known."""

    position: FloatArray
    depth: FloatArray
    normal: FloatArray | None


def find_disoccluded(
    gbuffer: GBuffer, camera: Camera, previous_gbuffer: GBuffer, previous_camera: Camera
) -> NDArray[np.bool_]:
    """Return the pixels whose surface point the previous frame did not show, shape (height, width).

    Each point is followed to its place in the previous frame by ``gbuffer.motion``, or as a still point without motion.
    It was not shown if the place is outside the image, or if none of the four pixels around it showed its surface. The
    background counts as a surface, infinitely far.

    Two pixels show one surface if their normals (if both frames have them) are less than 60 degrees apart, and if the
    previous depth is the expected one. For a still point this is the distance from the previous camera; the depth may
    differ by its change within about two pixels. A point whose motion is not that of the camera moves by itself; its
    depth may have changed by a tenth.

    Parameters
    ----------
    gbuffer, previous_gbuffer : GBuffer
        Each with ``position`` or ``depth``; ``motion`` of the first and ``normal`` of both are used where given.
    camera, previous_camera : Camera
        Cameras of the two frames.

    Raises
    ------
    MissingChannelError
        If a G-buffer has neither position nor depth.
    InputError
        If the G-buffers differ in size.

    Notes
    -----
    Two surfaces with similar normals count as one if their distance is less than about two pixel widths. A moving
    object and a surface in front of it count as one within a tenth of the distance. Reflections are not followed.
    """
    now, before = _look(gbuffer, camera, "gbuffer"), _look(previous_gbuffer, previous_camera, "previous_gbuffer")
    height, width = now.depth.shape
    if before.depth.shape != now.depth.shape:
        raise refuse_size(
            "previous_gbuffer", "the frame", now.depth.shape, before.depth.shape, "compare frames of one size"
        )
    still = compute_motion(camera, previous_camera, now.position, now.depth)
    motion = still if gbuffer.motion is None else gbuffer.motion
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    # Coordinates are 0 at the centre of the first pixel.
    x, y = column + motion[..., 0].astype(np.float64), row + motion[..., 1].astype(np.float64)
    inside = (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)

    moving = np.hypot(*np.moveaxis(motion - still, -1, 0)) > MOVING_PIXELS
    expected = np.where(now.depth > 0, np.linalg.norm(now.position - previous_camera.position, axis=-1), 0.0)
    slack = DEPTH_SLACK * _measure_change(before.depth, previous_camera)
    left, top = np.floor(x), np.floor(y)
    seen = np.zeros((height, width), dtype=np.bool_)
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - (x - left)) * np.abs(1 - down - (y - top))
            tap_x, tap_y = (left + right).astype(np.intp), (top + down).astype(np.intp)
            counts = (weight >= TAP_WEIGHT) & (tap_x >= 0) & (tap_x < width) & (tap_y >= 0) & (tap_y < height)
            tap = np.clip(tap_y, 0, height - 1), np.clip(tap_x, 0, width - 1)
            depth = before.depth[tap]
            same = np.abs(depth - expected) <= np.where(moving, MOVING_DEPTH * expected, slack[tap])
            if now.normal is not None and before.normal is not None:
                same &= (now.normal * before.normal[tap]).sum(axis=-1) >= NORMAL_COSINE
            seen |= counts & np.where(now.depth > 0, same & (depth > 0), depth == 0)
    return np.asarray(~(seen & inside))


def _look(gbuffer: GBuffer, camera: Camera, name: str) -> _View:
    """Return position and depth, computed from each other if one is missing, and 0 for the background."""
    if gbuffer.position is None and gbuffer.depth is None:
        raise MissingChannelError(
            name, expected="position or depth", got="neither", action="render the guides with the frame"
        )
    if gbuffer.depth is not None:
        depth = gbuffer.depth
    else:
        assert gbuffer.position is not None
        # Files without depths store the position 0 for the background.
        surface = gbuffer.position.any(axis=-1)
        depth = np.where(surface, np.linalg.norm(gbuffer.position - camera.position, axis=-1), 0.0).astype(np.float32)
    position = gbuffer.position if gbuffer.position is not None else camera.make_positions(depth)
    # Replace values of the background that are not finite.
    depth = np.where(np.isfinite(depth) & np.isfinite(position).all(axis=-1), depth, np.float32(0))
    return _View(np.where(depth[..., None] > 0, position, np.float32(0)), depth, gbuffer.normal)


def _measure_change(depth: FloatArray, camera: Camera) -> FloatArray:
    """Return the change of depth within a pixel: the width of the pixel plus, along each axis, the step to a neighbour.

    The smaller of the two steps counts, so that edges of objects do not count.
    """
    total = depth * camera.get_pixel_angle(depth.shape[0])
    for axis in (0, 1):
        padded = np.pad(depth, [(int(a == axis), int(a == axis)) for a in (0, 1)], constant_values=0.0)
        steps = np.abs(np.diff(padded, axis=axis))
        ahead, behind = (np.take(steps, np.arange(depth.shape[axis]) + k, axis=axis) for k in (0, 1))
        total = total + np.minimum(ahead, behind)
    return total
