"""What happens inside the interactive chain, as images."""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise.frame import FloatArray
from lobewise.lobes.field import build_lobe_field, default_tau
from lobewise.sparse_frame import SparseFrame

VIEWS = (
    "image",
    "noisy",
    "direct",
    "indirect",
    "sharpness",
    "weight_sum",
    "history",
    "recomputed",
    "hit_distance",
    "normal",
    "albedo",
)
"""Names of the views: radiance (image, noisy, direct, indirect), colours (normal, albedo), and numbers in [0, 1]."""

SHARPEST = 1e6
"""Sharpness that is shown as 1, on a logarithmic scale from 1."""
LONGEST_HISTORY = 40.0
"""Frames that are shown as 1."""


def make_view(name: str, image: FloatArray, parts: dict[str, Any]) -> FloatArray:
    """Return a view of a frame; see `lobewise.interactive.InteractiveFrame.get_view`."""
    if name == "image":
        return image
    view = _MAKERS[name](parts)
    return np.asarray(view, dtype=np.float32)


def _make_noisy(parts: dict[str, Any]) -> FloatArray:
    """Return what goes into the filters: direct light, and each sample of indirect light over its whole block."""
    direct = parts["noisy_direct"]
    sparse: SparseFrame = parts["sparse"]
    height, width = sparse.shape
    rows = np.minimum(np.arange(height) // sparse.scale, sparse.radiance.color.shape[0] - 1)
    columns = np.minimum(np.arange(width) // sparse.scale, sparse.radiance.color.shape[1] - 1)
    indirect = sparse.radiance.color[rows[:, None], columns[None, :]]
    return np.asarray(direct.emitted + direct.diffuse + direct.specular + indirect)


def _make_direct(parts: dict[str, Any]) -> FloatArray:
    direct = parts["direct"]
    return np.asarray(direct.emitted + direct.diffuse + direct.specular)


def _make_indirect(parts: dict[str, Any]) -> FloatArray:
    return np.asarray(parts["indirect"])


def _make_sharpness(parts: dict[str, Any]) -> FloatArray:
    hits = parts["hits"]
    height = hits.gbuffer.shape[0]
    lobes = build_lobe_field(
        hits.gbuffer, hits.camera, tau=default_tau(hits.camera, height), representation="sg", diffuse_fallback=True
    )
    assert lobes.sharpness is not None
    shown = np.log(np.maximum(lobes.sharpness, 1.0)) / np.log(SHARPEST)
    return np.where(lobes.valid, np.clip(shown, 0.0, 1.0), 0.0)


def _make_weight_sum(parts: dict[str, Any]) -> FloatArray:
    """Return ``W / (1 + W)``: half is the support of one sample that matches fully."""
    weight = parts["before"].weight_sum
    return np.asarray(weight / (1.0 + weight))


def _make_history(parts: dict[str, Any]) -> FloatArray:
    length = parts["history"]
    if length is None:
        return np.zeros(parts["hits"].gbuffer.shape, np.float32)
    return np.asarray(np.clip(length / LONGEST_HISTORY, 0.0, 1.0))


def _make_recomputed(parts: dict[str, Any]) -> FloatArray:
    """Return 1 where a pixel was shaded again."""
    return np.asarray(parts["result"].weight_sum != parts["before"].weight_sum, dtype=np.float32)


def _make_hit_distance(parts: dict[str, Any]) -> FloatArray:
    """Return ``t / (t + d)``, d the distance from the camera: where reflections lie on surface 0, at infinity 1."""
    gbuffer = parts["hits"].gbuffer
    with np.errstate(invalid="ignore"):
        share = gbuffer.hit_distance / (gbuffer.hit_distance + gbuffer.depth)
    return np.where(np.isinf(gbuffer.hit_distance), 1.0, np.nan_to_num(share))


def _make_normal(parts: dict[str, Any]) -> FloatArray:
    gbuffer = parts["hits"].gbuffer
    return np.where((gbuffer.depth > 0.0)[..., None], 0.5 + 0.5 * gbuffer.normal, 0.0)


def _make_albedo(parts: dict[str, Any]) -> FloatArray:
    gbuffer = parts["hits"].gbuffer
    return np.asarray(np.clip(gbuffer.diffuse_albedo + gbuffer.specular_albedo, 0.0, 1.0))


_MAKERS = {
    "noisy": _make_noisy,
    "direct": _make_direct,
    "indirect": _make_indirect,
    "sharpness": _make_sharpness,
    "weight_sum": _make_weight_sum,
    "history": _make_history,
    "recomputed": _make_recomputed,
    "hit_distance": _make_hit_distance,
    "normal": _make_normal,
    "albedo": _make_albedo,
}
