"""Normals for a frame that has none: of the surfaces through its positions, else all alike.

Lamps are found in the image where it is not split, because no guide tells them from surfaces.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from lobewise.camera import Camera
from lobewise.frame import FloatArray, Frame, GBuffer
from lobewise.guides.lamps import describe_lamps, keep_lamps
from lobewise.sparse_frame import AnyFrame

FROM_PLACES = "There are no normals; those of the surfaces through the positions stand for them."
IMAGE_ALONE = "Nothing tells surfaces apart but the image itself: there are no normals, and no places of surfaces."
ALIKE = "There are no normals, and no places of surfaces that would give them."

FrameT = TypeVar("FrameT", bound=AnyFrame)


def stand_in_normals(frame: FrameT) -> tuple[FrameT, tuple[str, ...]]:
    """Return a frame that has normals, and sentences for the user; a frame with normals is returned as it is.

    Without a camera, or without depth and position, all normals are (0, 0, 1): they take no part in any comparison.
    """
    guides, camera = frame.gbuffer, frame.camera
    if guides.normal is not None:
        return frame, ()
    if camera is not None and guides.is_placed:
        normal, told = compute_surface_normals(_find_positions(guides, camera, frame.shape), camera), FROM_PLACES
    else:
        normal = np.zeros((*frame.shape, 3), np.float32)
        normal[..., 2] = 1.0
        albedos = (guides.diffuse_albedo, guides.specular_albedo)
        told = IMAGE_ALONE if frame.radiance.parts is None and not any(a is not None for a in albedos) else ALIKE
    filled = replace(frame, gbuffer=replace(guides, normal=normal))
    if not isinstance(filled, Frame):
        return filled, (told,)
    kept, count = keep_lamps(filled)
    return replace(filled, gbuffer=kept.gbuffer), (told, *describe_lamps(count))


def _find_positions(guides: GBuffer, camera: Camera, shape: tuple[int, int]) -> FloatArray:
    if guides.position is not None:
        return guides.position
    assert guides.depth is not None
    # In float64, unlike `Camera.make_positions`: rounded positions would give rougher normals.
    rays = camera.make_ray_directions(shape[1], shape[0])
    return np.asarray(camera.position + guides.depth[..., None] * rays, dtype=np.float32)


def compute_normals(
    across: FloatArray, along: FloatArray, to_camera: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the unit normals (..., 3) of planes that two steps span, and the lengths (..., 1) of the cross products.

    Parallel steps span no plane: their length is 0 and their normal NaN. With ``to_camera`` (..., 3), vectors of any
    length from the surface to the camera, normals are on the camera's side.
    """
    normal = np.cross(across, along)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    if to_camera is not None:
        normal = np.where((normal * to_camera).sum(axis=-1, keepdims=True) < 0.0, -normal, normal)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(normal / length), np.asarray(length)


def compute_surface_normals(position: FloatArray, camera: Camera) -> FloatArray:
    """Return the unit normals, (height, width, 3), of the surface through positions, on the camera's side.

    Where neighbours give no plane, the normal is the direction to the camera.
    """
    across, down = (_choose_step(position, axis) for axis in (1, 0))
    view = position - camera.position.astype(np.float32)
    normal, length = compute_normals(across, down, -view)
    with np.errstate(invalid="ignore", divide="ignore"):
        to_camera = -view / np.linalg.norm(view, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 0.0, normal, to_camera), dtype=np.float32)


def _choose_step(position: FloatArray, axis: int) -> FloatArray:
    """Return the shorter of the steps to both neighbours along an axis: the longer may lead to another object."""
    ahead = np.diff(position, axis=axis, append=np.take(position, [-1], axis=axis) * np.float32(np.nan))
    behind = np.diff(position, axis=axis, prepend=np.take(position, [0], axis=axis) * np.float32(np.nan))
    lengths = [np.nan_to_num(np.linalg.norm(step, axis=-1, keepdims=True), nan=np.inf) for step in (ahead, behind)]
    return np.asarray(np.nan_to_num(np.where(lengths[0] <= lengths[1], ahead, behind)))
