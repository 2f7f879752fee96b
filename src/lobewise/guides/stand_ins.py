"""Guides that stand in for missing ones: normals for a frame without any, and surfaces for pixels without one.

A frame without normals gets those of the surfaces through its positions, else all are alike. Lamps are found in the
image where it is not split, because no guide tells them from surfaces.

A pixel without a surface has scattered light where its samples ended in fog. Renderers write no depth there. Such a
pixel is not a background without noise: nothing is known of it. The nearest surface stands for its own, and where there
is none a wall far behind the scene.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.lamps import describe_lamps, keep_lamps
from lobewise.guides.squares import count_neighbours
from lobewise.guides.surfaces import mark_surface_pixels, put_backdrop
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer
from lobewise.records.sparse_frame import AnyFrame

FROM_PLACES = "There are no normals; those of the surfaces through the positions stand for them."
IMAGE_ALONE = "Nothing tells surfaces apart but the image itself: there are no normals, and no places of surfaces."
ALIKE = "There are no normals, and no places of surfaces that would give them."

SURFACE_GUIDES = ("depth", "position", "normal", "tangent", "alpha_u", "alpha_v", "lobe_kind")
"""Guides that a pixel without a surface takes from the nearest one; albedos are those of its own samples."""
MAX_DISTANCE_PIXELS = 3
"""Largest distance of a surface that stands for that of another pixel, rows or columns."""
BACKDROP_DISTANCE = 1e6
"""Distance of the wall behind the scene, world units. Places are compared in footprints, so that any will do."""
MIN_LIT_NEIGHBOURS, MIN_UNKNOWN_NEIGHBOURS = 6, 4
"""Of the eight neighbours of a black pixel without a surface, those with light and those without a surface: with more
the pixel belongs to the fog, and its samples are black by chance. Sky between leaves has other neighbours. A pixel with
an albedo is no sky, whatever its neighbours without a surface are."""
MIN_SHARE_NAMED = 0.01
"""Share of the pixels above which the user is told."""
STAND_IN_REACH = MAX_DISTANCE_PIXELS
"""Distance of the farthest pixel that decides on the guides of a pixel, rows or columns."""

FrameT = TypeVar("FrameT", bound=AnyFrame)


def stand_in_normals(frame: FrameT) -> tuple[FrameT, tuple[str, ...]]:
    """Return a frame that has normals, and sentences for the user; a frame with normals is returned as it is.

    Without a camera, or without depth and position, all normals are (0, 0, 1): they take no part in any comparison.
    """
    guides, camera = frame.gbuffer, frame.camera
    if guides.normal is not None:
        return frame, ()
    if camera is not None and guides.is_placed:
        normal, note = compute_surface_normals(_compute_positions(guides, camera, frame.shape), camera), FROM_PLACES
    else:
        normal = np.zeros((*frame.shape, 3), np.float32)
        normal[..., 2] = 1.0
        albedos = (guides.diffuse_albedo, guides.specular_albedo)
        note = IMAGE_ALONE if frame.radiance.parts is None and not any(a is not None for a in albedos) else ALIKE
    filled = replace(frame, gbuffer=replace(guides, normal=normal))
    if not isinstance(filled, Frame):
        return filled, (note,)
    with_lamps, count = keep_lamps(filled)
    return replace(filled, gbuffer=with_lamps.gbuffer), (note, *describe_lamps(count))


def stand_in_surfaces(frame: FrameT) -> tuple[FrameT, tuple[str, ...]]:
    """Return a frame with guides where its light is scattered but no surface is known, and sentences for the user.

    Only frames that hold light by the lobe that scattered it tell such pixels from lamps and skies; others are returned
    as they are.
    """
    if not isinstance(frame, Frame) or frame.radiance.parts is None:
        return frame, ()
    known = mark_surface_pixels(frame.gbuffer, frame.shape)
    unknown = None if known.all() else _mark_unknown(frame, known)
    if unknown is None:
        return frame, ()
    guides = {name: getattr(frame.gbuffer, name) for name in SURFACE_GUIDES}
    guides = {name: image.copy() for name, image in guides.items() if image is not None}
    left = unknown.copy()
    steps = range(-MAX_DISTANCE_PIXELS, MAX_DISTANCE_PIXELS + 1)
    for y, x in sorted(((y, x) for y in steps for x in steps), key=lambda step: step[0] ** 2 + step[1] ** 2):
        here, there = (_cut_shifted(frame.shape, sign * y, sign * x) for sign in (1, -1))
        taken = left[here] & known[there]
        for name, image in guides.items():
            image[here][taken] = getattr(frame.gbuffer, name)[there][taken]
        left[here] &= ~taken
    if left.any():
        far = np.float32(BACKDROP_DISTANCE)
        camera = None if frame.wraps else frame.camera
        wall = put_backdrop(~left, guides["normal"], guides.get("position"), camera, BACKDROP_DISTANCE)
        guides["normal"] = wall.facing
        if wall.position is not None:
            guides["position"] = wall.position
        if "depth" in guides:
            guides["depth"] = np.where(left, far, guides["depth"])
    share = float(np.mean(unknown))
    note = f"{100.0 * share:.2g} % of the pixels have scattered light but no surface, as in fog: near ones stand in."
    filled = replace(frame, gbuffer=replace(frame.gbuffer, **guides))
    return filled, (note,) if share >= MIN_SHARE_NAMED else ()


def _mark_unknown(frame: Frame, known: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return which pixels have scattered light but no surface, and black ones among them; None where there is none."""
    parts = [layer.radiance for layer in frame.layers] or list(frame.radiance.parts or ())
    lit = np.logical_or.reduce([_has_any(part > 0.0) for part in parts])
    unknown = ~known & lit
    if not unknown.any():
        return None
    dark = ~known & ~_has_any(frame.radiance.color != 0.0) & (count_neighbours(lit, 1) >= MIN_LIT_NEIGHBOURS)
    # Samples that saw a surface behind the fog left its albedo.
    albedos = [layer.albedo for layer in frame.layers] or [frame.gbuffer.diffuse_albedo, frame.gbuffer.specular_albedo]
    seen = [_has_any(albedo > 0.0) for albedo in albedos if albedo is not None]
    foggy = count_neighbours(unknown, 1) >= MIN_UNKNOWN_NEIGHBOURS
    return np.asarray(unknown | (dark & np.logical_or.reduce([foggy, *seen])))


def _has_any(truth: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether any of three channels is true. NumPy's reductions over an axis of three are far slower."""
    return np.asarray(truth[..., 0] | truth[..., 1] | truth[..., 2])


def _cut_shifted(shape: tuple[int, int], down: int, right: int) -> tuple[slice, slice]:
    """Return the pixels of an image that have a neighbour so far up and left."""
    rows, columns = (slice(max(step, 0), size + min(step, 0)) for step, size in zip((down, right), shape, strict=True))
    return rows, columns


def _compute_positions(guides: GBuffer, camera: Camera, shape: tuple[int, int]) -> FloatArray:
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
