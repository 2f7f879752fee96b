"""What happens inside the interactive chain, as images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lobewise.frame import FloatArray, Result
from lobewise.guides.lobe_fields import make_sg_field
from lobewise.lobes.band_limit import default_tau
from lobewise.sparse_frame import SparseFrame

if TYPE_CHECKING:
    # A finished frame is shown without Mitsuba.
    from lobewise.render.stages import DirectLight, FirstHits

SHARPEST = 1e6
"""Sharpness that is shown as 1, on a logarithmic scale from 1."""
LONGEST_HISTORY = 40.0
"""Frames that are shown as 1."""


@dataclass(frozen=True)
class Parts:
    """What was there as a frame was made; arrays that must not be changed.

    Direct light is told before and after its filter; of indirect light the samples (``sparse``), the results before and
    after some pixels were shaded again, and what is shown, (height, width, 3); ``history`` (height, width) tells the
    frames that each pixel knows.
    """

    hits: FirstHits
    noisy_direct: DirectLight
    direct: DirectLight
    sparse: SparseFrame
    before: Result
    result: Result
    indirect: FloatArray
    history: FloatArray | None


def make_view(name: str, image: FloatArray, parts: Parts) -> FloatArray:
    """Return a view of a frame; see `lobewise.interactive.InteractiveFrame.get_view`."""
    return image if name == "image" else np.asarray(_MAKERS[name](parts), dtype=np.float32)


def _make_noisy(parts: Parts) -> FloatArray:
    """Return what goes into the filters: direct light, and each sample of indirect light over its whole block."""
    samples, scale = parts.sparse.radiance.color, parts.sparse.scale
    height, width = parts.sparse.shape
    rows = np.minimum(np.arange(height) // scale, samples.shape[0] - 1)
    columns = np.minimum(np.arange(width) // scale, samples.shape[1] - 1)
    return np.asarray(parts.noisy_direct.total + samples[rows[:, None], columns[None, :]])


def _make_sharpness(parts: Parts) -> FloatArray:
    gbuffer, camera = parts.hits.gbuffer, parts.hits.camera
    tau = default_tau(camera, parts.sparse.height)
    lobes = make_sg_field(gbuffer, camera, tau=tau, diffuse_fallback=True)
    shown = np.log(np.maximum(lobes.sharpness, 1.0)) / np.log(SHARPEST)
    return np.where(lobes.valid, np.clip(shown, 0.0, 1.0), 0.0)


def _make_history(parts: Parts) -> FloatArray:
    if parts.history is None:
        return np.zeros(parts.sparse.shape, np.float32)
    return np.asarray(np.clip(parts.history / LONGEST_HISTORY, 0.0, 1.0))


def _make_hit_distance(parts: Parts) -> FloatArray:
    """Return ``t / (t + d)``, d the distance from the camera: where reflections lie on surface 0, at infinity 1."""
    gbuffer: Any = parts.hits.gbuffer
    with np.errstate(invalid="ignore"):
        share = gbuffer.hit_distance / (gbuffer.hit_distance + gbuffer.depth)
    return np.where(np.isinf(gbuffer.hit_distance), 1.0, np.nan_to_num(share))


def _make_normal(parts: Parts) -> FloatArray:
    gbuffer: Any = parts.hits.gbuffer
    return np.where((gbuffer.depth > 0.0)[..., None], 0.5 + 0.5 * gbuffer.normal, 0.0)


def _make_albedo(parts: Parts) -> FloatArray:
    gbuffer: Any = parts.hits.gbuffer
    return np.asarray(np.clip(gbuffer.diffuse_albedo + gbuffer.specular_albedo, 0.0, 1.0))


_MAKERS: dict[str, Callable[[Parts], FloatArray]] = {
    "noisy": _make_noisy,
    "direct": lambda parts: parts.direct.total,
    "indirect": lambda parts: parts.indirect,
    "sharpness": _make_sharpness,
    # Half is the support of one sample that matches fully.
    "weight_sum": lambda parts: parts.before.weight_sum / (1.0 + parts.before.weight_sum),
    "history": _make_history,
    "recomputed": lambda parts: parts.result.weight_sum != parts.before.weight_sum,
    "hit_distance": _make_hit_distance,
    "normal": _make_normal,
    "albedo": _make_albedo,
}

VIEWS = ("image", *_MAKERS)
"""Names of the views: radiance (image, noisy, direct, indirect), colours (normal, albedo), and numbers in [0, 1]."""
