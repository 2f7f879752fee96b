"""The specular albedo of a textured BSDF, as a weighted sum of two of its values at the hit.

A texture scales lobes, and both the albedo and the values of the BSDF are linear in this scale. So for each view a fit
over some places on the texture finds two weights: of the value for light along the normal, and of the value for light
in the mirror direction. At a hit the BSDF is evaluated for these two lights.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import numpy as np

from lobewise.fitting.arrays import Array
from lobewise.fitting.nodes import make_upper_nodes
from lobewise.render.materials.probe import Parts, evaluate_bsdf, sample_bsdf, spread_points

# Number of places on the texture, and of samples per place.
_PLACE_COUNT = 24
_SAMPLE_COUNT = 128


def compute_tints(bsdf: Any, parts: Parts, views: Array) -> Array:
    """Return the two weights of each view (V, 3), shape (V, 2), both >= 0.

    They multiply the values, times the cosine, for light along the normal and in the mirror direction. The sum is the
    albedo of the glossy lobes, of transmission, and of mirrors.
    """
    uv = spread_points(_PLACE_COUNT, 2)
    return np.stack([_compute_tint(bsdf, parts, view, uv) for view in views])


def _compute_tint(bsdf: Any, parts: Parts, view: Array, uv: Array) -> Array:
    nodes = make_upper_nodes(float(view[2]), math.atan2(view[1], view[0]))
    light = np.concatenate([[[0.0, 0.0, 1.0], view * [-1.0, -1.0, 1.0]], nodes.light])
    places = np.repeat(uv, len(light), axis=0)
    values = evaluate_bsdf(bsdf, np.tile(view, (len(places), 1)), np.tile(light, (len(uv), 1)), parts.glossy_lobes,
                           place=places).reshape(len(uv), -1, 3) * light[:, 2:]  # fmt: skip
    values = np.where(np.isfinite(values), values, 0.0)
    albedo = nodes.weight @ values[:, 2:]
    if not parts.diffuse:
        samples = sample_bsdf(bsdf, np.tile(view, (len(uv), 1)), _SAMPLE_COUNT, place=uv)
        beyond = (samples.delta | (samples.light[..., 2] < 0.0)) & ~samples.null
        albedo = albedo + np.where(beyond[..., None], samples.weight, 0.0).mean(axis=1)
    return solve_nonnegative(np.moveaxis(values[:, :2], 1, -1).reshape(-1, 2), albedo.ravel())


def solve_nonnegative(columns: Array, target: Array) -> Array:
    """Return weights >= 0 of a few columns (n, k) whose weighted sum is nearest to the target (n,)."""
    count = columns.shape[1]
    best, least = np.zeros(count), float(target @ target)
    # If all weights of the best sum are above 0, it is the best sum of these columns without the condition.
    for size in range(count, 0, -1):
        for chosen in map(list, combinations(range(count), size)):
            weights = np.linalg.lstsq(columns[:, chosen], target, rcond=1e-6)[0]
            miss = float(np.sum((columns[:, chosen] @ weights - target) ** 2))
            if np.all(weights >= 0.0) and miss < least:
                best, least = np.zeros(count), miss
                best[chosen] = weights
    return best
