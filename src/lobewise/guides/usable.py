"""Impossible values of guides: counted and named for the user, and bounded if they would do harm.

Most of them do no harm: a pixel whose normal, depth or position is NaN counts as a pixel without a surface, and is not
filtered. Albedos are different. Light is divided by them before it is filtered and multiplied by them afterwards, so a
pixel with an albedo of 50 among albedos of 0.5 would become a hundred times too bright.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.prebuilt import has_kernels
from lobewise.guides.squares import count_neighbours
from lobewise.guides.stand_ins import stand_in_normals, stand_in_surfaces
from lobewise.guides.surfaces import mark_surface_pixels
from lobewise.guides.survey import GuideSurvey
from lobewise.records.frame import FloatArray, Frame, GBuffer
from lobewise.records.images import crop_columns
from lobewise.records.sparse_frame import AnyFrame

MAX_ALBEDO = 1.1
"""Largest possible albedo. Noise of samples and 16-bit floats let albedos exceed 1 by a few per cent."""
MIN_ALBEDO = -1e-3
"""Smallest possible albedo. Rounding and pixel filters with negative lobes go a little below 0."""
CHECKED_ALBEDOS = ("diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo")
ALPHAS = ("alpha_u", "alpha_v")
MAX_NORMAL_LENGTH = 1.5
"""Longest normal that is taken as it is. Longer ones would give cosines far above 1; means are shorter than 1."""
MAX_NEIGHBOURS_WITHOUT_NORMAL = 1
"""Neighbours within `NEIGHBOURS_RADIUS`. With more, a pixel without a normal belongs to a region without normals, such
as a lamp: also where the region is a line, or ends in one."""
NEIGHBOURS_RADIUS = 2
"""Pixels to the furthest neighbour, in each direction."""

FrameT = TypeVar("FrameT", bound=AnyFrame)


@dataclass(frozen=True)
class Unusable:
    """Impossible values of one image."""

    name: str
    """Name of the image."""
    what: str
    """Description of the values, such as "above 1"."""
    count: int
    """Number of pixels with such values."""
    fate: str
    """Sentence on how these pixels are treated."""

    def __str__(self) -> str:
        return f"{self.name} is {self.what} at {self.count} pixel{'s' if self.count > 1 else ''}: {self.fate}."


@dataclass(frozen=True)
class CheckedGuides(Generic[FrameT]):
    """A frame whose guides were checked as a whole.

    Parameters
    ----------
    frame : Frame or SparseFrame
        With normals, and without empty guides and impossible values that would do harm.
    notes : tuple of str
        One sentence for each thing that was found, for the user.
    idle : tuple of str
        Those of the notes that name a guide that is given and not used.
    seen : GBuffer, optional
        The guides before any stood in for missing ones; by default all are the frame's own.
    """

    frame: FrameT
    notes: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    seen: GBuffer | None = None


def check_guides(frame: FrameT) -> CheckedGuides[FrameT]:
    """Return a frame that filters can take, and notes for the user.

    Empty guides are left out, and normals in [0, 1] decoded (`GuideSurvey`). Impossible values are bounded
    (`bound_guides`); most frames have none, which one pass over the guides tells. Missing normals are filled in
    (`stand_in_normals`), and surfaces of pixels that have scattered light but no surface (`stand_in_surfaces`).
    """
    checked = _check_guides(frame)
    if not isinstance(frame, Frame) or not frame.wraps:
        return checked
    # Notes count the pixels of the image; what stands in is found among all neighbours.
    around = _check_guides(frame.surround())
    changed, seen = (crop_columns(each, frame.width) for each in (around.frame.gbuffer, around.seen))
    return replace(checked, frame=replace(checked.frame, gbuffer=changed), seen=seen)


def _check_guides(frame: FrameT) -> CheckedGuides[FrameT]:
    survey = GuideSurvey()
    survey.look_at(frame)
    frame = survey.apply(frame)
    if not has_kernels():
        # What follows is for filters, which cannot run either.
        return CheckedGuides(
            bound_guides(frame), (*survey.list_idle(), *survey.list_notes()), tuple(survey.list_idle())
        )
    unusable: tuple[str, ...] = ()
    if has_unusable(frame):
        unusable = tuple(map(str, list_unusable(frame)))
        frame = bound_guides(frame)
    seen = frame.gbuffer
    frame, normal_notes = stand_in_normals(frame)
    frame, surface_notes = stand_in_surfaces(frame)
    idle = tuple(survey.list_idle())
    return CheckedGuides(frame, (*idle, *survey.list_notes(), *unusable, *normal_notes, *surface_notes), idle, seen)


def has_unusable(frame: AnyFrame) -> bool:
    """Return whether any guide of a frame has an impossible value."""
    guides = frame.gbuffer
    layers = frame.layers if isinstance(frame, Frame) else ()
    albedos = [*(getattr(guides, name) for name in CHECKED_ALBEDOS), *(layer.albedo for layer in layers)]
    ranges: list[tuple[FloatArray | None, float, float]] = [(albedo, MIN_ALBEDO, MAX_ALBEDO) for albedo in albedos]
    ranges += [(getattr(guides, name), 0.0, 1.0) for name in ALPHAS]
    ranges.append((guides.normal, -MAX_NORMAL_LENGTH, MAX_NORMAL_LENGTH))
    if any(_has_odd(image, least, most) for image, least, most in ranges if image is not None):
        return True
    if guides.depth is None:
        return False
    return _has_odd(guides.depth, 0.0, np.inf) or bool(_mark_lost(frame, guides.depth).any())


def _has_odd(image: FloatArray, least: float, most: float) -> bool:
    """Return whether any value is out of range or NaN."""
    # With a NaN both reductions return NaN, whose comparisons are False.
    return not (float(image.min()) >= least and float(image.max()) <= most)


def _mark_lost(frame: AnyFrame, depth: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels have a depth of a surface, but no normal or no place."""
    with np.errstate(invalid="ignore"):
        there = (depth > 0.0) & (depth < np.inf)
    return np.asarray(there & ~mark_surface_pixels(frame.gbuffer, frame.shape), np.bool_)


def list_unusable(frame: AnyFrame, rows: slice = slice(None)) -> list[Unusable]:
    """Return the impossible values in the guides of a frame, counted in some of its rows."""
    return [each for each in _list_unusable(frame, rows) if each.count]


def join_unusable(parts: Sequence[Unusable]) -> list[Unusable]:
    """Return findings from several bands of an image with the counts of equal findings summed up."""
    sums: dict[tuple[str, str], Unusable] = {}
    for part in parts:
        key = part.name, part.what
        sums[key] = replace(part, count=part.count + (sums[key].count if key in sums else 0))
    return list(sums.values())


def bound_guides(frame: FrameT) -> FrameT:
    """Return a frame whose impossible albedos are clamped to [0, 1].

    Impossible albedos lie outside [`MIN_ALBEDO`, `MAX_ALBEDO`]. Normals longer than `MAX_NORMAL_LENGTH` become unit
    vectors.
    """
    guides: dict[str, Any] = {
        name: _bound(getattr(frame.gbuffer, name)) for name in CHECKED_ALBEDOS if _is_out(getattr(frame.gbuffer, name))
    }
    if _is_long(frame.gbuffer.normal):
        guides["normal"] = _normalise(frame.gbuffer.require("normal", "a frame"))
    changes: dict[str, Any] = {"gbuffer": replace(frame.gbuffer, **guides)} if guides else {}
    if isinstance(frame, Frame) and any(_is_out(layer.albedo) for layer in frame.layers):
        changes["layers"] = tuple(replace(each, albedo=_bound(each.albedo)) for each in frame.layers)
    return replace(frame, **changes) if changes else frame


def _bound(albedo: FloatArray | None) -> FloatArray | None:
    """Return an albedo with values out of range clamped to [0, 1]; NaN stays."""
    if albedo is None:
        return None
    with np.errstate(invalid="ignore"):
        out = (albedo > MAX_ALBEDO) | (albedo < MIN_ALBEDO)
        return np.where(out, np.clip(albedo, np.float32(0.0), np.float32(1.0)), albedo)


def _is_out(albedo: FloatArray | None) -> bool:
    return albedo is not None and _has_odd(albedo, MIN_ALBEDO, MAX_ALBEDO)


def _list_unusable(frame: AnyFrame, rows: slice) -> Iterator[Unusable]:
    guides = frame.gbuffer
    albedos = [(name, getattr(guides, name)) for name in CHECKED_ALBEDOS]
    if isinstance(frame, Frame):
        albedos += [(f"the albedo of the layer {layer.name!r}", layer.albedo) for layer in frame.layers]
    for name, albedo in albedos:
        if _is_out(albedo):
            part = albedo[rows]
            with np.errstate(invalid="ignore"):
                above, below = (part > MAX_ALBEDO).any(axis=-1), (part < MIN_ALBEDO).any(axis=-1)
            yield Unusable(name, "above 1", _count(above), "it counts as 1 there")
            yield Unusable(name, "below 0", _count(below), "it counts as 0 there")
            yield Unusable(name, "NaN", _count(np.isnan(part).any(axis=-1)), "they are not compared with others")
    for name in ALPHAS:
        alpha = getattr(guides, name)
        if alpha is not None and _has_odd(alpha, 0.0, 1.0):
            part = alpha[rows]
            fate = "it is clamped there"
            yield Unusable(name, "out of [0, 1]", _count((part < 0.0) | (part > 1.0)), fate)
            yield Unusable(name, "NaN", _count(np.isnan(part)), "they are not compared with others")
    if guides.depth is not None and _has_odd(guides.depth, 0.0, np.inf):
        part = guides.depth[rows]
        yield Unusable("depth", "below 0", _count(part < 0.0), "they are not filtered")
        yield Unusable("depth", "NaN", _count(np.isnan(part)), "they are not filtered")
    yield from _list_odd_normals(frame, rows)


def _list_odd_normals(frame: AnyFrame, rows: slice) -> Iterator[Unusable]:
    """Count normals that are too long, and single pixels that have a depth but no normal.

    Regions without normals are not reported: skies have none, and readers remove the normals of lamps.
    """
    guides = frame.gbuffer
    if guides.normal is None:
        return
    if _is_long(guides.normal):
        with np.errstate(invalid="ignore", over="ignore"):
            long = _measure_length(guides.normal[rows]) > MAX_NORMAL_LENGTH
        yield Unusable("normal", f"longer than {MAX_NORMAL_LENGTH:g}", _count(long), "it is normalised there")
    if guides.depth is None:
        return
    lost = _mark_lost(frame, guides.depth)
    if lost.any():
        alone = (lost & (count_neighbours(lost, NEIGHBOURS_RADIUS) <= MAX_NEIGHBOURS_WITHOUT_NORMAL))[rows]
        length = np.abs(guides.normal[rows]).max(axis=-1)
        yield Unusable("normal", "of length 0 on a surface", _count(alone & (length == 0.0)), "they are not filtered")
        yield Unusable("normal", "not finite", _count(lost[rows] & ~np.isfinite(length)), "they are not filtered")


def _is_long(normal: FloatArray | None) -> bool:
    return normal is not None and not float(np.abs(normal).max()) <= MAX_NORMAL_LENGTH


def _measure_length(normal: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((normal.astype(np.float64) ** 2).sum(axis=-1)), np.float64)


def _normalise(normal: FloatArray) -> FloatArray:
    """Return normals with the too long ones scaled to unit length."""
    with np.errstate(invalid="ignore", over="ignore"):
        length = _measure_length(normal)[..., None]
        return np.where(length > MAX_NORMAL_LENGTH, normal / length, normal).astype(np.float32)


def _count(mask: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(mask))
