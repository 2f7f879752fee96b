"""The feature that weighs the rays of a sparse frame, from the frame's guides."""

from __future__ import annotations

from functools import reduce
from operator import and_

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import LARGEST_FLOAT, Grid, Vector, is_finite
from lobewise.features.ray import RayFeature
from lobewise.guides.surfaces import make_ray
from lobewise.lobes.vectors import dot
from lobewise.records.frame import FloatArray
from lobewise.records.sparse_frame import SparseFrame

MIN_DIFFUSE_ALBEDO = 1e-3
"""Diffuse albedo from which a surface counts as having a diffuse lobe."""


def compute_ray_weights(frame: SparseFrame) -> FloatArray | None:
    """Return the weights by which the samples of a frame count, (rows, columns); None if the frame has no rays.

    They are the weights of the rays where a surface also has a diffuse lobe, as far as the frame tells, and 1
    elsewhere. Without a diffuse lobe no choice of a lobe makes noise. The weights then vary little, and dividing by
    them would make bright samples brighter.
    """
    if frame.rays is None:
        return None
    albedo = frame.gbuffer.diffuse_albedo
    if albedo is None:
        return frame.rays.weight
    images = {"albedo": engine.pick(albedo, frame.scale, frame.place), "weight": frame.rays.weight}
    (weights,) = engine.pixels(
        _define_weights, images, {}, MIN_DIFFUSE_ALBEDO, names=["ray_weights"], text="weights of rays"
    )
    return weights


def _define_weights(grid: Grid, least: float) -> list[Vector]:
    """Return the weights of rays where a surface is diffuse as well, and 1 elsewhere."""
    albedo = grid.read("albedo")
    known = reduce(and_, (is_finite(value) | (hl.abs(value) > hl.f32(LARGEST_FLOAT)) for value in albedo))
    both = known & (hl.max(*albedo) > hl.f32(least))
    return [[hl.select(both, grid.read_one("weight"), hl.f32(1.0))]]


def make_ray_feature(frame: SparseFrame, direction: FloatArray) -> RayFeature:
    """Return the feature that weighs the rays of a frame's samples by the lobes of the pixels.

    ``direction``, (rows, columns, 3), is that of `lobewise.records.sparse_frame.Rays`. Without tangents, both
    alphas are replaced by their root mean square.

    Raises
    ------
    MissingChannelError
        If the frame has no camera, no normals or no roughness.
    """
    guides, what = frame.gbuffer, "a frame with rays"
    camera = frame.require_camera(what)
    u, v = guides.require("alpha_u", what), guides.alpha_v
    tangent = guides.tangent
    if tangent is None:
        u = v = u if v is None else np.sqrt(0.5 * (u * u + v * v))
        tangent = np.zeros((*frame.shape, 3), np.float32)
    view, normal = engine.pixels(
        _define_axes, {"normal": guides.require("normal", what)}, camera.get_ray_numbers(frame.shape)
    )
    whole = np.zeros((*frame.shape, 3), np.float32)
    whole[frame.shaded] = direction
    return RayFeature(view, normal, tangent, u, u if v is None else v, whole)


def _define_axes(grid: Grid) -> list[Vector]:
    """Return the unit vector towards the camera, and the normal of length 1."""
    ray, normal = make_ray(grid, hl.Float(64)), grid.read("normal")
    towards, length = hl.f64(-1.0) / hl.sqrt(dot(ray, ray)), hl.sqrt(dot(normal, normal))
    inverse = hl.f32(1.0) / hl.max(length, hl.f32(1e-12))
    return [[hl.f32(component * towards) for component in ray], [component * inverse for component in normal]]
