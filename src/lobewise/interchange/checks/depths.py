"""Checks of the meaning of a depth, by positions or normals: along the ray or the axis, stretched or inverted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.geometry import MIN_PIXELS, choose_centers
from lobewise.interchange.values import mark_placed
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

MAX_ERROR_OF_RIGHT_DEPTH, MIN_ERROR_OF_WRONG_DEPTH = 0.005, 0.02
"""Median differences between depth and positions, as shares of the distance: up to the first the depth is right, from
the second on it is wrong. Some renderers measure from the near plane, and a camera's place may be an estimate."""
MAX_ERROR_RATIO = 0.25
"""Largest error of another meaning, as a share of the error of the assumed meaning."""
MAX_SLOPE_SINE = 0.02
"""Median sine of the angle between normals and surfaces up to which the assumed meaning is right."""
MAX_SLOPE_SINE_OF_OTHER = 0.05
"""Median sine of the angle between normals and surfaces up to which another meaning is right."""
MIN_COSINE_ON_SURFACE = 0.999
"""Cosine between the normals of neighbours above which they lie on one flat surface."""
ROUNDS = 4
"""Rounds of a fit; each leaves out the samples that the round before fitted badly."""

Numbers = NDArray[np.float64]


class CheckedDepth(NamedTuple):
    """Distances along the rays, findings, and whether the positions gave the distances because the depth was wrong."""

    distance: FloatArray
    findings: Sequence[Finding] = ()
    is_replaced: bool = False


@dataclass(frozen=True)
class Meaning:
    """A meaning of a depth ``d``: the distance ``a + b d`` or ``1 / (a + b d)``, along the ray or the camera's axis.

    Parameters
    ----------
    planar : bool
        Whether the distance is measured along the axis.
    inverted : bool
        Whether the depth is a reciprocal.
    offset, scale : float
        a and b.
    """

    planar: bool
    inverted: bool = False
    offset: float = 0.0
    scale: float = 1.0

    def apply(self, depth: FloatArray, cosine: FloatArray) -> FloatArray:
        """Return distances along the rays; ``cosine`` is the cosine of the angle between ray and axis."""
        with np.errstate(all="ignore"):
            distance = self.offset + self.scale * depth
            distance = 1.0 / distance if self.inverted else distance
            distance = np.asarray(distance / cosine if self.planar else distance, dtype=np.float32)
        return np.where(np.isfinite(distance) & (distance > 0.0), distance, np.float32(0.0))

    def tell(self) -> str:
        """Return the meaning in words."""
        along = "distance along the camera's axis" if self.planar else "distance along the ray"
        if self.inverted:
            return f"stretched reciprocal of the {along}"
        if self.offset != 0.0:
            return f"{along}, stretched and shifted"
        return along if self.scale == 1.0 else f"{along} in another unit (times {self.scale:.4g})"


def list_meanings(assumed: bool) -> list[tuple[bool, bool, bool, bool]]:
    """Return the flags planar, inverted, scaled and shifted of every meaning, the simplest meaning first."""
    kinds = ((False, False, False), (False, True, False), (False, True, True), (True, True, True))
    return [(planar, *kind) for kind in kinds for planar in (assumed, not assumed)]


def check_depth_by_position(
    depth: FloatArray, position: FloatArray, camera: Camera, label: str, *, planar: bool
) -> CheckedDepth:
    """Return distances along the rays, 0 where there is no surface, and findings.

    Parameters
    ----------
    depth : (height, width)
        Distances along the rays, if the assumed meaning is right.
    position : (height, width, 3)
        World positions, 0 where there is no surface.
    camera : Camera
        The camera of the frame.
    label : str
        Channel of the depth.
    planar : bool
        Whether the assumed meaning is a distance along the camera's axis.
    """
    rows, columns = choose_centers((depth.shape[0], depth.shape[1]), 0)
    points = position[rows, columns].astype(np.float64)
    taken = depth[rows, columns].astype(np.float64)
    there = (points != 0.0).any(axis=-1) & np.isfinite(points).all(axis=-1) & (taken > 0.0)
    if there.sum() < MIN_PIXELS:
        return CheckedDepth(depth)
    steps = points[there] - camera.position
    away = np.linalg.norm(steps, axis=-1)
    cosine = steps @ camera.forward / away
    raw = taken[there] * (cosine if planar else 1.0)
    kinds = list_meanings(planar)
    first = _fit_by_position(raw, away, cosine, kinds[0])[1]
    if first < MAX_ERROR_OF_RIGHT_DEPTH:
        return CheckedDepth(depth)
    fits = [_fit_by_position(raw, away, cosine, kind) for kind in kinds[1:]]
    good = [
        meaning
        for meaning, error in fits
        if error < max(MAX_ERROR_OF_RIGHT_DEPTH, MAX_ERROR_RATIO * min(first, MIN_ERROR_OF_WRONG_DEPTH))
    ]
    if first < MIN_ERROR_OF_WRONG_DEPTH and not (good and good[0].scale == 1.0):
        return CheckedDepth(depth)
    surface = mark_placed(position)
    if not good:
        note = (
            f"{label} is no distance to the surfaces that the positions show; the positions' distances from the camera "
            "replace it."
        )
        distance = np.linalg.norm(position - camera.position.astype(np.float32), axis=-1)
        findings = [Finding("depth of something else", note, mended=True)]
        return CheckedDepth(np.where(surface, distance, np.float32(0.0)), findings, is_replaced=True)
    height, width = depth.shape
    ray_cosine = camera.make_ray_directions(width, height) @ camera.forward.astype(np.float32)
    converted = good[0].apply(depth * ray_cosine if planar else depth, ray_cosine)
    note = f"{label} is the {good[0].tell()}, as the positions show; it was converted."
    findings = [Finding("depth of another meaning", note, mended=True)]
    return CheckedDepth(np.where(surface, converted, np.float32(0.0)), findings)


def _fit_by_position(
    raw: Numbers, away: Numbers, cosine: Numbers, kind: tuple[bool, bool, bool, bool]
) -> tuple[Meaning, float]:
    """Return the best fitting meaning of a kind, and its median relative error."""
    planar, inverted, scaled, shifted = kind
    measured = away * cosine if planar else away
    target = 1.0 / measured if inverted else measured
    offset, scale = 0.0, 1.0
    is_near = np.ones(len(raw), dtype=bool)
    for _ in range(ROUNDS if scaled else 0):
        if shifted:
            columns = np.stack([np.ones(is_near.sum()), raw[is_near]], axis=1)
            offset, scale = np.linalg.lstsq(columns / target[is_near, None], np.ones(is_near.sum()), rcond=None)[0]
        else:
            scale = float(np.median(target[is_near] / raw[is_near]))
        error = np.abs(offset + scale * raw - target) / target
        is_near = error <= 3.0 * np.median(error) + 1e-12
    meaning = Meaning(planar, inverted, float(offset), float(scale))
    distance = meaning.apply(raw.astype(np.float32), cosine.astype(np.float32))
    return meaning, float(np.median(np.abs(distance / away - 1.0)))


def check_depth_by_normal(
    depth: FloatArray, normal: FloatArray, camera: Camera, label: str, *, planar: bool
) -> CheckedDepth:
    """Return distances along the rays, and findings; parameters as in `check_depth_by_position`.

    The step between neighbours on one surface is perpendicular to its normal. With depths ``d`` and ``e`` and rays
    ``r`` and ``s`` this says ``n . (t(e) s - t(d) r) = 0``. The equation is linear in the scale and the offset of a
    depth, and of its reciprocal. It does not tell the unit of length, which does not matter.
    """
    height, width = depth.shape
    rays = camera.make_ray_directions(width, height)
    cosine = rays @ camera.forward.astype(np.float32)
    reach = 1 if height * width < 250_000 else 2
    rows, columns = choose_centers((height, width), reach)
    pairs = [_take_pairs(depth, normal, rays, (rows, columns), step) for step in ((0, reach), (reach, 0))]
    n, r, s, d, e = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    if len(n) < MIN_PIXELS:
        return CheckedDepth(depth)
    axis = camera.forward
    if planar:
        d, e = d * (r @ axis), e * (s @ axis)
    fits = [
        _fit_by_normal(n, r, s, d, e, axis, kind) for kind in list_meanings(planar) if not (kind[2] and not kind[3])
    ]
    first = fits[0][1]
    least = min(error for _, error in fits)
    if first < MAX_SLOPE_SINE or least > min(MAX_SLOPE_SINE_OF_OTHER, MAX_ERROR_RATIO * first):
        return CheckedDepth(depth)
    meaning = next(meaning for meaning, error in fits if error < max(2.0 * least, MAX_SLOPE_SINE))
    distance = meaning.apply(depth * cosine if planar else depth, cosine)
    unit = ", in an unknown unit" if meaning.offset != 0.0 else ""
    note = f"{label} is the {meaning.tell()}, as the normals show{unit}; it was converted."
    findings = [Finding("depth of another meaning", note, mended=True)]
    return CheckedDepth(np.where(depth > 0.0, distance, np.float32(0.0)), findings)


def _take_pairs(
    depth: FloatArray,
    normal: FloatArray,
    rays: FloatArray,
    centers: tuple[NDArray[np.intp], NDArray[np.intp]],
    step: tuple[int, int],
) -> Sequence[Numbers]:
    """Return normals, two rays and two depths of each pair of neighbours on one flat surface."""
    rows, columns = centers
    other = rows + step[0], columns + step[1]
    n, m = normal[rows, columns].astype(np.float64), normal[other].astype(np.float64)
    d, e = depth[rows, columns].astype(np.float64), depth[other].astype(np.float64)
    flat = ((n * m).sum(axis=-1) > MIN_COSINE_ON_SURFACE) & (d > 0.0) & (e > 0.0)
    r, s = rays[rows, columns].astype(np.float64), rays[other].astype(np.float64)
    return tuple(values[flat] for values in (n, r, s, d, e))


def _fit_by_normal(
    n: Numbers, r: Numbers, s: Numbers, d: Numbers, e: Numbers, axis: Numbers, kind: tuple[bool, bool, bool, bool]
) -> tuple[Meaning, float]:
    """Return the best fitting meaning of a kind, and the median sine between surface and normal."""
    planar, inverted, scaled, _ = kind
    if planar:
        r, s = r / (r @ axis)[:, None], s / (s @ axis)[:, None]
    first, second = (d, e) if inverted else (e, d)
    steps = s - r, first[:, None] * s - second[:, None] * r
    shifts, stretches = ((n * step).sum(axis=-1) for step in steps)
    offset, scale = 0.0, 1.0
    weight = 1.0 / (np.linalg.norm(steps[1], axis=-1) + 1e-12)
    is_near = np.ones(len(n), dtype=bool)
    size = float(np.median(d))
    for _ in range(ROUNDS if scaled else 0):
        system = np.stack([size * shifts, stretches], axis=1)[is_near] * weight[is_near, None]
        offset, scale = np.linalg.svd(system, full_matrices=False)[2][-1]
        sign = 1.0 if np.median(offset * size + scale * d) > 0.0 else -1.0
        offset, scale = sign * offset * size, sign * scale
        whole = np.linalg.norm(offset * steps[0] + scale * steps[1], axis=-1)
        error = np.abs(offset * shifts + scale * stretches) / (whole + 1e-30)
        weight = 1.0 / (whole + 1e-12 * size)
        is_near = error <= 3.0 * np.median(error) + 1e-12
    whole = np.linalg.norm(offset * steps[0] + scale * steps[1], axis=-1)
    error = np.abs(offset * shifts + scale * stretches) / (whole + 1e-30)
    if scaled and not inverted and scale > 0.0:
        offset, scale = offset / scale, 1.0
    return Meaning(planar, inverted, float(offset), float(scale)), float(np.median(error))
