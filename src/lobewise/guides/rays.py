"""The weights of the rays of a sparse frame, from the frame's guides."""

from __future__ import annotations

from functools import reduce
from operator import and_

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import LARGEST_FLOAT, Grid, Vector, is_finite
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
