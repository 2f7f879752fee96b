"""The intermediate results of the interactive chain as images to look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.frame import FloatArray, GBuffer, Result
from lobewise.guides.lobe_fields import default_tau, make_sg_field
from lobewise.interactive.settings import MAX_SHOWN_FRAMES, MAX_SHOWN_SHARPNESS
from lobewise.sparse_frame import SparseFrame

if TYPE_CHECKING:
    # The viewer of finished frames imports this module, and must not need Mitsuba.
    from lobewise.render.stages import DirectLight, FirstHits


@dataclass(frozen=True)
class Parts:
    """The intermediate images of a frame. Their arrays must not be changed."""

    hits: FirstHits
    noisy_direct: DirectLight
    """Direct light before its filter."""
    direct: DirectLight
    """Direct light after its filter."""
    sparse: SparseFrame
    """The samples of indirect light."""
    before: Result
    """Indirect light before pixels were shaded again."""
    result: Result
    """Indirect light with the pixels that were shaded again."""
    indirect: FloatArray
    """Indirect light as it is shown, (height, width, 3)."""
    history: FloatArray | None
    """Length of each pixel's history, frames, (height, width); None for a frame without history."""


def make_view(name: str, image: FloatArray, parts: Parts) -> FloatArray:
    """Return a view of a frame; see `lobewise.interactive.InteractiveFrame.get_view`."""
    return image if name == "image" else np.asarray(_MAKERS[name](parts), dtype=np.float32)


def spread_samples(samples: FloatArray, scale: int, shape: tuple[int, int], start: tuple[int, int]) -> FloatArray:
    """Return sparse samples at the full size, (height, width, 3): each fills ``scale`` x ``scale`` pixels.

    ``start`` is the row and column where the block of the first sample begins.
    """
    rows, columns = (
        np.clip((np.arange(size) - first) // scale, 0, count - 1)
        for size, first, count in zip(shape, start, samples.shape, strict=False)
    )
    return np.asarray(samples[rows[:, None], columns[None, :]])


def show_sharpness(gbuffer: GBuffer, camera: Camera, tau: float) -> FloatArray:
    """Return the band-limited sharpness of every lobe, logarithmic: 0 for 1, 1 for `MAX_SHOWN_SHARPNESS`."""
    lobes = make_sg_field(gbuffer, camera, tau=tau, diffuse_fallback=True)
    shown = np.log(np.maximum(lobes.sharpness, 1.0)) / np.log(MAX_SHOWN_SHARPNESS)
    return np.asarray(np.where(lobes.valid, np.clip(shown, 0.0, 1.0), 0.0), np.float32)


def show_weight_sum(weight_sum: FloatArray) -> FloatArray:
    """Return ``W / (1 + W)``. One sample that matches fully has W = 1, so one half."""
    return np.asarray(weight_sum / (1.0 + weight_sum))


def show_hit_distance(hit_distance: FloatArray, depth: FloatArray) -> FloatArray:
    """Return ``t / (t + depth)`` of the hit distance t: 0 for a hit on the surface itself, 1 at infinity."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share = hit_distance / (hit_distance + depth)
    return np.where(np.isinf(hit_distance), np.float32(1.0), np.nan_to_num(share))


def show_normal(normal: FloatArray, has_surface: NDArray[np.bool_]) -> FloatArray:
    """Return x, y and z from -1 to 1 as red, green and blue from 0 to 1, black where there is no surface."""
    return np.where(has_surface[..., None], 0.5 + 0.5 * normal, np.float32(0.0))


def show_albedo(diffuse: FloatArray, specular: FloatArray) -> FloatArray:
    """Return the sum of both albedos, clipped to [0, 1]."""
    return np.asarray(np.clip(diffuse + specular, 0.0, 1.0))


def _make_noisy(parts: Parts) -> FloatArray:
    sparse = parts.sparse
    samples = spread_samples(sparse.radiance.color, sparse.scale, sparse.shape, (0, 0))
    return np.asarray(parts.noisy_direct.total + samples)


def _make_sharpness(parts: Parts) -> FloatArray:
    hits = parts.hits
    return show_sharpness(hits.gbuffer, hits.camera, default_tau(hits.camera, parts.sparse.height))


def _make_history(parts: Parts) -> FloatArray:
    if parts.history is None:
        return np.zeros(parts.sparse.shape, np.float32)
    return np.asarray(np.clip(parts.history / MAX_SHOWN_FRAMES, 0.0, 1.0))


def _make_hit_distance(parts: Parts) -> FloatArray:
    gbuffer: Any = parts.hits.gbuffer
    return show_hit_distance(gbuffer.hit_distance, gbuffer.depth)


def _make_normal(parts: Parts) -> FloatArray:
    gbuffer: Any = parts.hits.gbuffer
    return show_normal(gbuffer.normal, gbuffer.depth > 0.0)


def _make_albedo(parts: Parts) -> FloatArray:
    gbuffer: Any = parts.hits.gbuffer
    return show_albedo(gbuffer.diffuse_albedo, gbuffer.specular_albedo)


_MAKERS: dict[str, Callable[[Parts], FloatArray]] = {
    "noisy": _make_noisy,
    "direct": lambda parts: parts.direct.total,
    "indirect": lambda parts: parts.indirect,
    "sharpness": _make_sharpness,
    "weight_sum": lambda parts: show_weight_sum(parts.before.weight_sum),
    "history": _make_history,
    "recomputed": lambda parts: parts.result.weight_sum != parts.before.weight_sum,
    "hit_distance": _make_hit_distance,
    "normal": _make_normal,
    "albedo": _make_albedo,
}

VIEWS = ("image", *_MAKERS)
"""Names of the views. "image", "noisy", "direct" and "indirect" are radiance, "normal" and "albedo" are colours, and
the others are numbers in [0, 1]."""
