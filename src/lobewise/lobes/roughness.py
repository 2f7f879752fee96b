"""Roughness parameters of materials. ``alpha`` is the microfacet width, never perceptual roughness."""

from __future__ import annotations

from typing import Any

from lobewise.lobes.numbers import Namespace

MIN_ALPHA = 1e-3
"""Smallest alpha of common implementations of the "principled" BSDF."""


def compute_principled_alphas(xp: Namespace, roughness: Any, anisotropy: Any) -> tuple[Any, Any]:
    """Return (alpha_u, alpha_v) of a perceptual ``roughness`` and an ``anisotropy``, both in [0, 1].

    Source: Burley 2012, "Physically Based Shading at Disney", section 5.4: ``aspect = sqrt(1 - 0.9 anisotropy)``,
    ``alpha_u = r^2 / aspect``, ``alpha_v = r^2 aspect``; neither below `MIN_ALPHA`. ``alpha_u`` may exceed 1.
    """
    aspect = xp.sqrt(1.0 - xp.number(0.9) * anisotropy)
    square = roughness * roughness
    return xp.maximum(xp.number(MIN_ALPHA), square / aspect), xp.maximum(xp.number(MIN_ALPHA), square * aspect)
