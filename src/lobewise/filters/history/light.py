"""A short history of light that has little noise: its mean over the frames before, at the places of its surfaces.

Each frame's light is mixed with the mean of the frames before it. The mean is first moved towards the light around the
pixel in this frame, so that it cannot show what is gone (Karis 2014, "High-Quality Temporal Supersampling"; bounds from
the variance: Salvi 2016, "An Excursion in Temporal Supersampling").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.history.reprojection_pass import TAPS
from lobewise.guides.places import compute_surface_places
from lobewise.guides.surfaces import is_surface_depth
from lobewise.lobes.vectors import compute_luminance, dot, subtract
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, GBuffer

MAX_FRAMES = 8.0
"""Frames in the longest mean."""
MAX_TURN_PER_ALPHA = 0.1
"""Angle by which the view of a point may turn over the frames of a mean of specular light, radians, over alpha."""
RADIUS_PIXELS = 2
"""Pixels to the edge of the square that bounds the mean: with 2 it covers a block of samples."""
DIFFUSE_SPREAD, SPECULAR_SPREAD = 2.0, 1.0
"""Standard deviations within the square by which the mean may differ from the mean of the square."""
MAX_DEPTH_CHANGE = 0.02
"""Relative difference of distances from the camera within which a pixel of the frame before shows the same surface."""
MAX_BRIGHTENING = 100.0
"""Largest factor by which light is made brighter."""
LIGHTS = ("diffuse", "specular")
DIFFUSE, SPECULAR, DIFFUSE_FRAMES, SPECULAR_FRAMES, DISTANCE = range(5)
"""Channels of a past: mean luminances of light over albedo, their numbers of frames, distance from the camera (0 if
none)."""


@dataclass(frozen=True)
class LightPast:
    """The light of the frame before, (height, width, 5), by the channels above, and the camera of that frame."""

    means: FloatArray
    camera: Camera


def blend_light(
    diffuse: FloatArray, specular: FloatArray, gbuffer: GBuffer, camera: Camera, past: LightPast | None, samples: int
) -> tuple[FloatArray, FloatArray, LightPast]:
    """Return diffuse and specular light, mixed with their means over the frames before, and the new past.

    Only luminances are mixed; light keeps its hue of this frame. Light is divided by its albedo meanwhile. Specular
    light of narrow lobes moves over a surface when the camera moves, so its mean has the fewer frames the narrower the
    lobe is and the faster the view turns.

    Parameters
    ----------
    diffuse, specular : array, shape (height, width, 3)
        Light of this frame, >= 0, albedo included.
    gbuffer : GBuffer
        Depth, position, alpha and albedos of all pixels, which do not move by themselves.
    camera : Camera
    past : LightPast, optional
        What the frame before returned. It is not used if it has another size.
    samples : int
        How many of the earlier frames the light of this frame is worth, >= 1.
    """
    images = {name: getattr(gbuffer, f"{name}_albedo") for name in ("diffuse", "specular")}
    images = {"diffuse": diffuse, "specular": specular, **{f"{name}_albedo": image for name, image in images.items()}}
    eye = np.asarray(camera.position, np.float32)
    place: dict[str, Any] = {"depth": gbuffer.depth, "position": gbuffer.position}
    (means,) = engine.pixels(_define_light, {**images, **place}, {"eye": eye})
    if past is None or past.means.shape != means.shape:
        return diffuse, specular, LightPast(means, camera)
    places, _ = compute_surface_places(camera, past.camera, (place["position"], place["depth"]), None)
    images = {"diffuse": diffuse, "specular": specular, "position": place["position"], "now": means, "places": places}
    images |= {"means": past.means, "alpha_u": gbuffer.alpha_u, "alpha_v": gbuffer.alpha_v}
    numbers = {"eye": eye, "old_eye": np.asarray(past.camera.position, np.float32), "samples": np.float32(samples)}
    means, *light = engine.pixels(_define_light_history, images, numbers)
    return light[0], light[1], LightPast(means, camera)


def _define_light(grid: Grid) -> list[Vector]:
    """Return a past of one frame; light that is not finite counts as 0."""
    luminances = []
    for name in ("diffuse", "specular"):
        both = [compute_luminance(HALIDE, grid.read(each)) for each in (name, f"{name}_albedo")]
        ratio = both[0] / hl.max(both[1], hl.f32(ALBEDO_FLOOR))
        luminances.append(hl.select(is_finite(ratio), ratio, hl.f32(0.0)))
    view = subtract(grid.read("position"), grid.get("eye"))
    distance = hl.select(is_surface_depth(grid.read_one("depth")), hl.sqrt(dot(view, view)), hl.f32(0.0))
    return [[*luminances, hl.f32(1.0), hl.f32(1.0), distance]]


def _define_light_history(grid: Grid) -> list[Vector]:
    one, zero = hl.f32(1.0), hl.f32(0.0)
    now = grid.read("now")
    light, distance = now[:DIFFUSE_FRAMES], now[DISTANCE]
    view = subtract(grid.read("position"), grid.get("eye"))
    *old, diffuse, specular, turn = _gather_old(grid, view, distance)
    lengths = _compute_lengths(grid, [diffuse, specular], turn)
    (samples,) = grid.get("samples")
    new, images = [], []
    for name, value, mean, count, (low, high) in zip(LIGHTS, light, old, lengths, _compute_bounds(grid), strict=True):
        bounded = hl.clamp(mean, low, high)
        mixed = bounded + samples / (samples + count - one) * (value - bounded)
        mixed = hl.select(diffuse > zero, mixed, value)
        ratio = hl.select(value > zero, hl.min(mixed / value, hl.f32(MAX_BRIGHTENING)), one)
        new.append(mixed)
        images.append([color * ratio for color in grid.read(name)])
    return [[*new, *lengths, distance], *images]


def _gather_old(grid: Grid, view: Vector, distance: hl.Expr) -> list[hl.Expr]:
    """Return the past at the place of this surface in the frame before: means, and their frames, 0 if there are none.

    The last value is the angle by which the view of the point turned since then, radians, for small angles.
    """
    width, height = grid.size
    place, inside = grid.read("places"), distance > hl.f32(0.0)
    for value, extent in zip(place, (width, height), strict=True):
        inside = inside & (value > hl.f32(-0.5)) & (value < hl.f32(extent) - hl.f32(0.5))
    place = [hl.select(inside, value, hl.f32(0.0)) for value in place]
    first = [hl.floor(value) for value in place]
    old_view = subtract(grid.read("position"), grid.get("old_eye"))
    expected = hl.sqrt(dot(old_view, old_view))
    total, sums = hl.f32(0.0), [hl.f32(0.0)] * DISTANCE
    for across, down in TAPS:
        weight = hl.f32(1.0)
        for value, corner, step in zip(place, first, (across, down), strict=True):
            weight = weight * (value - corner if step else hl.f32(1.0) - (value - corner))
        at = hl.clamp(hl.i32(first[0]) + across, 0, width - 1), hl.clamp(hl.i32(first[1]) + down, 0, height - 1)
        *means, old_distance = grid.read("means", *at)
        same = inside & (hl.abs(old_distance - expected) < hl.f32(MAX_DEPTH_CHANGE) * expected)
        weight = hl.select(same, weight, hl.f32(0.0))
        total = total + weight
        sums = [value + weight * old for value, old in zip(sums, means, strict=True)]
    known = total > hl.f32(1e-3)
    old = [value / hl.max(total, hl.f32(1e-3)) for value in sums]
    old[DIFFUSE_FRAMES:] = [hl.select(known, value, hl.f32(0.0)) for value in old[DIFFUSE_FRAMES:]]
    moved = subtract([value / distance for value in view], [value / expected for value in old_view])
    return grid.share([*old, hl.sqrt(dot(moved, moved))])


def _compute_lengths(grid: Grid, old: Vector, turn: hl.Expr) -> list[hl.Expr]:
    """Return the frames of the new means of diffuse and of specular light, from those of the ``old`` means."""
    one, alpha = hl.f32(1.0), hl.sqrt(grid.read_one("alpha_u") * grid.read_one("alpha_v"))
    diffuse, specular = (hl.min(length, hl.f32(MAX_FRAMES - 1.0)) + one for length in old)
    allowed = one + hl.f32(MAX_TURN_PER_ALPHA) * alpha / hl.max(turn, hl.f32(1e-9))
    return [diffuse, hl.min(specular, hl.select(is_finite(allowed), allowed, one))]


def _compute_bounds(grid: Grid) -> list[tuple[hl.Expr, hl.Expr]]:
    """Return the least and the largest mean of each light that this frame's light around the pixel allows."""
    values = grid.read("now", *grid.inside)[:DIFFUSE_FRAMES]
    sums = grid.average([*values, *(value * value for value in values)], RADIUS_PIXELS)
    bounds = []
    for mean, square, most in zip(sums[:2], sums[2:], (DIFFUSE_SPREAD, SPECULAR_SPREAD), strict=True):
        spread = hl.f32(most) * hl.sqrt(hl.max(square - mean * mean, hl.f32(0.0)))
        bounds.append((mean - spread, mean + spread))
    return bounds
