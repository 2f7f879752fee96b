"""Steps that place the surfaces of a foreign frame: its positions, camera, depths and normals, all in one space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.cameras.fitting import MAX_FIT_ERROR, CameraFit, fit_any_camera, fit_camera, measure_fit
from lobewise.interchange.cameras.header import Located, read_camera_attributes
from lobewise.interchange.cameras.panorama import fit_panorama
from lobewise.interchange.cameras.places import Place
from lobewise.interchange.checks.precision import measure_grain
from lobewise.interchange.importing.blur import estimate_blur_radius
from lobewise.interchange.importing.draft import Draft, Outcome
from lobewise.interchange.values import (
    MIN_EMPTY_DISTANCE,
    convert_depth,
    convert_plain,
    convert_space,
    mark_placed,
)
from lobewise.io.exr.header import read_pixel_aspect
from lobewise.records.camera import Camera, project_points
from lobewise.records.frame import FloatArray
from lobewise.work.chunks import Chunk, run_chunks

NO_CAMERA = (
    "Neither a pinhole camera nor a panorama shows the positions where they are seen, so places are not compared; give "
    "--camera, unless rays are bent."
)
NO_PANORAMA = "The positions are not those of a panorama by latitude and longitude, so places are not compared."
WRAPS_AROUND = (
    "The image wraps around, as {}: pixels at its left and right border are neighbours; --no-wrap filters them apart."
)
"""Note on an image that wraps around; the word that is left out tells how that is known."""

Mask = NDArray[np.bool_]


def take_positions(draft: Draft) -> Outcome:
    """Convert the positions, and set them to 0 where there is no surface."""
    position = convert_plain(draft.images["position"], draft.roles["position"].convert)
    depth, placed = draft.images.get("depth"), np.empty(position.shape, np.float32)

    def place(chunk: Chunk) -> None:
        surface = _mark_surface(position[chunk], None if depth is None else depth[chunk])
        placed[chunk] = np.where(surface[..., None], position[chunk], np.float32(0.0))

    run_chunks(place, *draft.shape)
    return Outcome(replace(draft, world_position=placed))


def _mark_surface(position: FloatArray, depth: FloatArray | None) -> Mask:
    # A comparison with NaN is false.
    there = (np.abs(position) < MIN_EMPTY_DISTANCE).all(axis=-1)
    if depth is not None:
        return np.asarray(there & np.isfinite(depth) & (depth > 0.0) & (depth < MIN_EMPTY_DISTANCE))
    return np.asarray(there & mark_placed(position))


def estimate_blur(draft: Draft) -> Outcome:
    """Find how far the lens blurs every pixel, by the spread of the positions around where a pinhole sees them."""
    position = draft.world_position
    assert position is not None
    mask: Mask = mark_placed(position)
    pixel_aspect = read_pixel_aspect(draft.image_part) or 1.0
    is_coarse = measure_grain(position).is_coarse
    place = Place.of(draft.image_part, draft.shape)
    fit = None if is_coarse or draft.wraps else fit_camera(position, mask, pixel_aspect, place, blurred=True)
    if fit is None:
        return Outcome(draft)
    seen = measure_offsets(fit.camera, _mirror(position) if fit.mirrored else position, draft.shape)
    pinhole = fit if fit.error < MAX_FIT_ERROR and not fit.drawn else None
    return Outcome(replace(draft, blur_radius=estimate_blur_radius(seen), pinhole=pinhole))


def measure_offsets(camera: Camera, position: FloatArray, shape: tuple[int, int], first: int = 0) -> FloatArray:
    """Return where a camera sees the position of each pixel, minus the pixel's centre; NaN where there is no surface.

    ``shape`` is that of the whole image, of which ``position`` has the rows from ``first`` on.
    """
    height, width = shape
    offset = np.empty((*position.shape[:2], 2), np.float32)

    def measure(chunk: Chunk) -> None:
        rows, columns = (np.arange(each.start, each.stop) for each in chunk)
        there = position[chunk]
        seen = project_points(camera, there, width, height)
        seen[..., 0] -= (columns + 0.5).astype(np.float32)
        seen[..., 1] -= (rows[:, None] + (first + 0.5)).astype(np.float32)
        offset[chunk] = np.where(mark_placed(there)[..., None], seen, np.float32(np.nan))

    run_chunks(measure, *position.shape[:2])
    return offset


def choose_camera(draft: Draft) -> Outcome:
    """Choose the camera: the user's, else the header's unless the positions contradict it, else one fitted to them."""
    if draft.wraps and draft.given_camera is None:
        return (
            Outcome(draft)
            if draft.world_position is None
            else _use_panorama(draft) or Outcome(draft, notes=[NO_PANORAMA])
        )
    pixel_aspect, notes = read_pixel_aspect(draft.image_part), []
    if pixel_aspect is None:
        pixel_aspect = 1.0
        notes.append("The header's pixelAspectRatio is none of pixels, so they are taken for square.")
    header = read_camera_attributes(draft.container.parts, draft.image_part)
    chosen = _choose_camera(replace(draft, header_camera=header), header, pixel_aspect)
    notes += chosen.notes
    if chosen.draft.camera is not None and pixel_aspect != 1.0:
        notes.append(f"Pixels are {pixel_aspect:.4g} times as wide as high (pixelAspectRatio), the camera's too.")
    return Outcome(chosen.draft, notes=notes)


def _choose_camera(draft: Draft, header: Located | None, pixel_aspect: float) -> Outcome:
    if draft.given_camera is not None:
        height, width = draft.shape
        return _use_given_camera(draft, draft.given_camera.with_pixel_aspect(width, height, pixel_aspect))
    position = draft.world_position
    if position is None:
        return Outcome(draft) if header is None else _use_header(draft, header, position, ".")
    mask: Mask = mark_placed(position)
    if header is not None:
        moved = _mirror(position) if header.mirrored else position
        if measure_fit(header.camera, moved, mask) < MAX_FIT_ERROR:
            return _use_header(draft, header, moved, "; positions agree with it.")
    place = Place.of(draft.image_part, draft.shape)
    fit = fit_any_camera(position, mask, draft.images.get("depth"), pixel_aspect, place, draft.pinhole)
    if fit is not None:
        return _use_fit(draft, fit, position, header)
    panorama = _use_panorama(draft) if draft.wraps is None else None
    if panorama is not None:
        return panorama
    if header is not None:
        return _use_header(draft, header, None, "; it does not see the positions where they are, so they are not used.")
    return Outcome(draft, notes=[NO_CAMERA])


def _use_panorama(draft: Draft) -> Outcome | None:
    """Place the camera of a panorama by its positions. Return None if they are not those of one."""
    position, part = draft.world_position, draft.image_part
    assert position is not None
    fit = fit_panorama(position, mark_placed(position)) if part.data_window == part.display_window else None
    if fit is None:
        return None
    notes = [] if draft.wraps else [WRAPS_AROUND.format("its positions show all around the camera")]
    notes.append(
        f"The camera was found from the positions, which its panorama shows where they are seen to {fit.error:.2f} "
        "pixels."
    )
    return Outcome(replace(draft, camera=fit.camera, wraps=True), notes=notes)


def _use_given_camera(draft: Draft, camera: Camera) -> Outcome:
    chosen = replace(draft, camera=camera)
    position = draft.world_position
    if position is None or measure_fit(camera, position, mark_placed(position)) < MAX_FIT_ERROR:
        return Outcome(chosen)
    note = "The camera that was given does not see the positions where they are, so they are not used."
    return Outcome(replace(chosen, world_position=None), notes=[note])


def _use_header(draft: Draft, header: Located, position: FloatArray | None, ending: str) -> Outcome:
    chosen = replace(draft, camera=header.camera, is_mirrored=header.mirrored, world_position=position)
    return Outcome(chosen, notes=[f"The camera is that of the header ({header.source}){ending}"])


def _use_fit(draft: Draft, fit: CameraFit, position: FloatArray, header: Located | None) -> Outcome:
    note = (
        f"The camera is orthographic, by the positions, which a pinhole far away shows where they are seen to "
        f"{fit.error:.2f} pixels."
        if fit.orthographic
        else f"The camera was found from the positions, which it shows where they are seen to {fit.error:.2f} pixels."
    )
    if header is not None:
        note += f" The header's ({header.source}) is another: positions are in a space of their own."
    chosen = replace(
        draft,
        camera=fit.camera,
        is_mirrored=fit.mirrored,
        is_orthographic=fit.orthographic,
        world_position=_mirror(position) if fit.mirrored else position,
    )
    return Outcome(chosen, notes=[note])


def _mirror(vectors: FloatArray) -> FloatArray:
    return vectors * np.array([-1.0, 1.0, 1.0], np.float32)


def mirror_positions(draft: Draft) -> Outcome:
    """Mirror positions whose world is mirrored for a camera that is known already."""
    assert draft.world_position is not None
    return Outcome(replace(draft, world_position=_mirror(draft.world_position)) if draft.is_mirrored else draft)


def take_depth(draft: Draft) -> Outcome:
    """Convert the depth to distances along the rays.

    Positions tell the distances of orthographic cameras, whose depth starts at a plane, and of panoramas.
    """
    if draft.is_orthographic or (draft.wraps and draft.camera is not None):
        return Outcome(draft)
    found = draft.roles["depth"]
    distance = convert_depth(convert_plain(draft.images["depth"], found.convert), found.convert, draft.camera)
    if distance is None:
        note = f"{found.label} is measured along the camera's axis, which no camera tells, so it is not used."
        return Outcome(draft, notes=[note])
    return Outcome(replace(draft, distance=distance))


def derive_depth(draft: Draft) -> Outcome:
    """Compute the distances of the positions from the camera where the file has no depth that can be used."""
    position, camera = draft.world_position, draft.camera
    if draft.distance is not None or position is None or camera is None:
        return Outcome(draft)
    away = np.linalg.norm(position - camera.position.astype(np.float32), axis=-1)
    return Outcome(replace(draft, distance=np.where(mark_placed(position), away, np.float32(0.0))))


def take_normals(draft: Draft) -> Outcome:
    """Convert the normals to the space of the positions, 0 where there is no surface."""
    found, notes = draft.roles["normal"], []
    normal = convert_plain(draft.images["normal"], found.convert)
    in_camera_space = any(word.startswith("camera_space") for word in found.convert)
    if in_camera_space and draft.camera is None:
        notes.append(f"{found.label} stays in camera space, as no camera is known: only normals are compared.")
    normal = convert_space(normal, found.convert, draft.camera)
    if draft.is_mirrored and not in_camera_space:
        normal = _mirror(normal)
    unit, mean = (np.empty(normal.shape, np.float32) for _ in range(2))

    def convert(chunk: Chunk) -> None:
        length = np.linalg.norm(normal[chunk], axis=-1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            whole = np.where(length > 1e-6, normal[chunk] / length, np.float32(0.0))
        for out, each in ((unit, whole), (mean, normal[chunk])):
            out[chunk] = np.where(np.isfinite(each), each, np.float32(0.0))

    run_chunks(convert, *draft.shape)
    return Outcome(replace(draft, world_normal=unit, mean_normal=mean), notes=notes)
