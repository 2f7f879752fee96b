"""Convert the values of passes to the conventions of a frame: spaces, units and signs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

MIN_EMPTY_DISTANCE = 1e9
"""Smallest distance that means that a pixel shows no surface, scene units. Renderers write 1e10, 1e30 or infinity."""
MIN_SPECULAR_SHARE = 0.02
"""Share of the total albedo. Below this specular share, Cycles' mean roughness does not give the specular one."""


def clip_share(values: FloatArray) -> FloatArray:
    """Return values clipped to [0, 1], with 0 for NaN."""
    return np.asarray(np.fmin(np.fmax(values, np.float32(0.0)), np.float32(1.0)))


def mark_placed(position: FloatArray) -> NDArray[np.bool_]:
    """Return which positions, (height, width, 3), are not 0: where a surface is."""
    x, y, z = np.moveaxis(position, -1, 0)
    return np.asarray((x != 0.0) | (y != 0.0) | (z != 0.0))


def convert_plain(values: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Return the values after the conversions that need no camera, applied in the order of ``names``."""
    for name in names:
        if name == "encoded":
            values = np.float32(2.0) * values - np.float32(1.0)
        elif name == "square":
            values = np.square(np.clip(values, 0.0, 1.0))
        elif name == "invert":
            values = np.float32(1.0) - values
        elif name == "hundredth":
            values = np.float32(0.01) * values
        elif name == "negate":
            values = -values
        elif name == "y_up":
            values = values * np.array([1.0, -1.0], np.float32)
    return values


def convert_space(values: FloatArray, names: tuple[str, ...], camera: Camera | None) -> FloatArray:
    """Return vectors in world space. Without a camera they stay in camera space, with the same angles."""
    sign = 1.0 if "camera_space" in names else -1.0 if "camera_space_back" in names else 0.0
    if camera is None or sign == 0.0:
        return values
    axes = np.stack([camera.right, camera.up, sign * camera.forward]).astype(np.float32)
    return values @ axes


def convert_depth(values: FloatArray, names: tuple[str, ...], camera: Camera | None) -> FloatArray | None:
    """Return distances along the rays, 0 for no surface. Return None if planar depth has no camera to convert it."""
    distance = np.where(np.isfinite(values) & (values > 0.0) & (values < MIN_EMPTY_DISTANCE), values, np.float32(0.0))
    if "planar" not in names:
        return distance
    if camera is None:
        return None
    height, width = values.shape
    return np.asarray(distance / (camera.make_ray_directions(width, height) @ camera.forward.astype(np.float32)))


def undo_mean_roughness(
    mean: FloatArray, diffuse: FloatArray | None, specular: FloatArray | None
) -> tuple[FloatArray, NDArray[np.bool_]] | None:
    """Return the perceptual roughness of the specular lobes, and a mask of the pixels where it is known.

    Cycles' pass is the mean roughness of all closures, weighted by albedo. Diffuse closures have roughness 1. With the
    diffuse albedo D and the specular albedo S, ``mean = (D + r S) / (D + S)``. Source: Cycles'
    src/kernel/film/denoising_passes.h. The inverse is ill-conditioned for small S: there the surface counts as diffuse.

    Parameters
    ----------
    mean : (height, width)
        The pass, perceptual roughness.
    diffuse, specular : (height, width, 3), optional
        The albedos; None if unknown.
    """
    if diffuse is None or specular is None:
        return None
    d, s = diffuse.mean(axis=-1), specular.mean(axis=-1)
    known = s > MIN_SPECULAR_SHARE * np.maximum(d + s, np.float32(1e-6))
    specular_roughness = (mean * (d + s) - d) / np.where(known, s, np.float32(1.0))
    return np.clip(np.where(known, specular_roughness, np.float32(1.0)), 0.0, 1.0), known
