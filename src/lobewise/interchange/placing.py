"""Where the surfaces of a foreign frame are: its camera, depths, positions and normals, all in one space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.frame import FloatArray
from lobewise.interchange.cameras.fitting import WORST_FIT, CameraFit, find_camera, measure_fit, mirror
from lobewise.interchange.cameras.header import Located
from lobewise.interchange.values import FARTHEST, convert_depth, convert_plain, convert_space

if TYPE_CHECKING:
    from lobewise.interchange.mapping import Found

Mask = NDArray[np.bool_]


@dataclass
class Places:
    """What is known of where surfaces are.

    Parameters
    ----------
    camera : Camera or None
        As far as anything tells.
    depth, position, normal : arrays or None
        As in `lobewise.GBuffer`.
    notes : list of str
        What was converted, found or dropped, a sentence each.
    orthographic : bool
        Whether the camera is a far pinhole that stands for an orthographic one.
    """

    camera: Camera | None = None
    depth: FloatArray | None = None
    position: FloatArray | None = None
    normal: FloatArray | None = None
    mean_normal: FloatArray | None = None
    notes: list[str] = field(default_factory=list)
    orthographic: bool = False


def place_surfaces(
    images: Mapping[str, FloatArray],
    found: Mapping[str, Found],
    given: Camera | None,
    attributes: Located | None,
    pixel_aspect: float | None = 1.0,
) -> Places:
    """Return the camera of a frame and its surfaces.

    Parameters
    ----------
    images : mapping of str to array
        By role, as in the file.
    found : mapping of str to Found
        What becomes of them.
    given : Camera, optional
        From the user; goes before all others.
    attributes : Located, optional
        From the header; goes before one that is found from positions, unless they contradict it.
    pixel_aspect : float, optional
        Width of a pixel over its height, as the header says; None where that makes no sense, which counts as 1.
    """
    places = Places()
    if pixel_aspect is None:
        pixel_aspect = 1.0
        places.notes.append("The header's pixelAspectRatio is none of pixels, so they are taken for square.")
    if given is not None:
        height, width = images["color"].shape[:2]
        given = given.with_pixel_aspect(width, height, pixel_aspect)
    position, depth = images.get("position"), images.get("depth")
    if position is not None:
        position = convert_plain(position, found["position"].convert)
        surface = _find_surface(position, depth)
        places.position = np.where(surface[..., None], position, np.float32(0.0))
    mirrored = _choose_camera(places, given, attributes, depth, pixel_aspect)
    if places.camera is not None and pixel_aspect != 1.0:
        places.notes.append(
            f"Pixels are {pixel_aspect:.4g} times as wide as high (pixelAspectRatio), the camera's too."
        )
    # Of an orthographic camera, depths are measured from a plane.
    if depth is not None and not places.orthographic:
        places.depth = convert_depth(
            convert_plain(depth, found["depth"].convert), found["depth"].convert, places.camera
        )
        if places.depth is None:
            places.notes.append(
                f"{found['depth'].label} is measured along the camera's axis, which no camera tells, so it is not used."
            )
    if places.depth is None and places.position is not None and places.camera is not None:
        away = np.linalg.norm(places.position - places.camera.position.astype(np.float32), axis=-1)
        places.depth = np.where((places.position != 0.0).any(axis=-1), away, np.float32(0.0))
    if "normal" in images:
        places.normal, places.mean_normal = _take_normal(images["normal"], found["normal"], places, mirrored=mirrored)
    return places


def _find_surface(position: FloatArray, depth: FloatArray | None) -> Mask:
    there = np.isfinite(position).all(axis=-1) & (np.abs(position) < FARTHEST).all(axis=-1)
    if depth is not None:
        return np.asarray(there & np.isfinite(depth) & (depth > 0.0) & (depth < FARTHEST))
    return np.asarray(there & (position != 0.0).any(axis=-1))


def _choose_camera(
    places: Places,
    given: Camera | None,
    attributes: Located | None,
    depth: FloatArray | None,
    pixel_aspect: float,
) -> bool:
    """Put the camera into ``places``, say where it comes from, and return whether the world was mirrored for it."""
    if given is not None:
        places.camera = given
        _check_fit(places, given, "The camera that was given")
        return False
    position = places.position
    if position is None:
        if attributes is not None:
            places.camera = attributes.camera
            places.notes.append(f"The camera is that of the header ({attributes.told}).")
        return attributes is not None and attributes.mirrored
    mask: Mask = (position != 0.0).any(axis=-1)
    if attributes is not None:
        places.position = _mirror(position) if attributes.mirrored else position
        error = measure_fit(attributes.camera, places.position, mask)
        if error < WORST_FIT:
            places.camera = attributes.camera
            places.notes.append(f"The camera is that of the header ({attributes.told}); positions agree with it.")
            return attributes.mirrored
        places.position = position
    fit = find_camera(position, mask, depth, pixel_aspect)
    if fit is not None:
        _take_fit(places, fit, attributes)
        return fit.mirrored
    if attributes is not None:
        places.camera, places.position = attributes.camera, None
        places.notes.append(
            f"The camera is that of the header ({attributes.told}); it does not see the positions where they are, so "
            "they are not used."
        )
        return attributes.mirrored
    places.notes.append(
        "No camera shows the positions where they are seen (it may be bent, as for panoramas); give --camera."
    )
    return False


def _take_fit(places: Places, fit: CameraFit, attributes: Located | None) -> None:
    assert places.position is not None, "it was found from them"
    places.camera, places.orthographic = fit.camera, fit.orthographic
    places.position = _mirror(places.position) if fit.mirrored else places.position
    told = (
        f"The camera is orthographic, by the positions, which a pinhole far away shows where they are seen to "
        f"{fit.error:.2f} pixels."
        if fit.orthographic
        else f"The camera was found from the positions, which it shows where they are seen to {fit.error:.2f} pixels."
    )
    if attributes is not None:
        told += f" The header's ({attributes.told}) is another: positions are in a space of their own."
    places.notes.append(told)


def _check_fit(places: Places, camera: Camera, whose: str) -> None:
    if places.position is None:
        return
    mask: Mask = (places.position != 0.0).any(axis=-1)
    for mirrored in (False, True):
        error = measure_fit(mirror(camera) if mirrored else camera, places.position, mask)
        if not mirrored and error < WORST_FIT:
            return
    places.position = None
    places.notes.append(f"{whose} does not see the positions where they are, so they are not used.")


def _mirror(vectors: FloatArray) -> FloatArray:
    return vectors * np.array([-1.0, 1.0, 1.0], np.float32)


def _take_normal(normal: FloatArray, found: Found, places: Places, *, mirrored: bool) -> tuple[FloatArray, FloatArray]:
    """Return normals in the space of the positions, 0 where there is no surface: of length 1, and as they are."""
    normal = convert_plain(normal, found.convert)
    in_camera = [word for word in found.convert if word.startswith("camera_space")]
    if in_camera and places.camera is None:
        places.notes.append(f"{found.label} stays in camera space, as no camera is known: only normals are compared.")
    normal = convert_space(normal, found.convert, places.camera)
    if mirrored and not in_camera:
        normal = _mirror(normal)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(length > 1e-6, normal / length, np.float32(0.0))
    one, other = (np.nan_to_num(each, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32) for each in (unit, normal))
    return one, other


def derive_normal(places: Places, shape: tuple[int, int]) -> FloatArray:
    """Return normals for a frame without any: of the surface through the positions, else all towards the camera."""
    position = places.position
    if position is None and places.depth is not None and places.camera is not None:
        rays = places.camera.make_ray_directions(shape[1], shape[0])
        position = (places.camera.position + places.depth[..., None] * rays).astype(np.float32)
    if position is None or places.camera is None:
        places.notes.append(
            "Nothing tells surfaces apart but the image itself: no normal, position or depth can be used."
        )
        normal = np.zeros((*shape, 3), np.float32)
        normal[..., 2] = 1.0
        return normal
    across, down = (_choose_step(position, axis) for axis in (1, 0))
    found = np.cross(across, down)
    view = position - places.camera.position.astype(np.float32)
    found = np.where((found * view).sum(axis=-1, keepdims=True) > 0.0, -found, found)
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    places.notes.append("The file has no normals; those of the surfaces through the positions stand for them.")
    with np.errstate(invalid="ignore", divide="ignore"):
        facing = -view / np.linalg.norm(view, axis=-1, keepdims=True)
        return np.asarray(np.where(length > 0.0, found / length, facing), dtype=np.float32)


def _choose_step(position: FloatArray, axis: int) -> FloatArray:
    """Return the shorter of the steps to both neighbours along an axis: the other may lead to another object."""
    ahead = np.diff(position, axis=axis, append=np.take(position, [-1], axis=axis) * np.float32(np.nan))
    behind = np.diff(position, axis=axis, prepend=np.take(position, [0], axis=axis) * np.float32(np.nan))
    lengths = [np.nan_to_num(np.linalg.norm(step, axis=-1, keepdims=True), nan=np.inf) for step in (ahead, behind)]
    return np.asarray(np.nan_to_num(np.where(lengths[0] <= lengths[1], ahead, behind)))
