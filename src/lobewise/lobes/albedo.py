"""The directional albedo of GGX: the share of light that a glossy surface reflects."""

from __future__ import annotations

from typing import Any


def ggx_directional_albedo_terms(cos_view: Any, alpha: Any) -> tuple[Any, Any]:
    """Return (bias, scale): the directional albedo of single-scatter GGX is ``bias + scale f0``. Approximate.

    The formula uses only operators, so numbers of any kind work.

    Parameters
    ----------
    cos_view : array
        n.v in [0, 1].
    alpha : array
        Roughness alpha, not perceptual, in [0, 1].

    Notes
    -----
    Source: two rational functions fitted to quadrature of `lobewise.fitting.ggx.ggx_brdf` over alpha 0 to 1 and n.v
    0.01 to 1: the albedo of a white lobe, ``1 - alpha^2 P / Q``, and the part of Schlick's fifth power in it. Measured
    there: white albedo to 0.011 (RMSE 0.005), albedo at ``f0 = 0.04`` to 4 % of itself (RMSE 1.4 %). The usual
    rational fit ("Ray Tracing Gems", chapter 32) is off by up to 0.33 and 52 % there (RMSE 0.08 and 15 %), mostly for
    n.v below 0.2.
    """
    c, m = cos_view, alpha
    m2 = m * m
    lost = (
        (750.13 + c * (34132.6 - 49483.5 * c))
        + m * (-3057.56 + c * (20437.5 + 213205.0 * c))
        + m2 * (2917.8 + c * (34755.2 - 136745.0 * c))
    ) / (
        (1.0 + c * (45.3593 + 5890.38 * c))
        + m * (-193.091 + c * (-18782.1 + 72489.1 * c))
        + m2 * (25555.7 + c * (159573.0 - 77630.6 * c))
    )
    grazing = (1.0 - c) * (1.0 - c) * (0.939874 + 0.747717 * c + 35.9474 * m)
    bias = grazing / (
        (1.0 + c * (-0.351064 + c * (61.8334 + c * (-229.101 + 375.428 * c))))
        + m * (59.2881 + c * (-160.106 + c * (648.751 + 1092.78 * c)))
        + m2 * ((435.514 + c * (632.141 - 3843.42 * c)) + m * (585.274 + 4687.08 * c - 284.054 * m))
    )
    return bias, 1.0 - m2 * lost - bias


def ggx_directional_albedo(cos_view: Any, alpha: Any, f0: Any) -> Any:
    """Return the albedo of single-scatter GGX towards a viewer at ``cos_view``, ``bias + scale f0``.

    Parameters
    ----------
    cos_view, alpha : array
        See `ggx_directional_albedo_terms`.
    f0 : array or colour
        Reflectance at normal incidence, in [0, 1].

    Returns
    -------
    array
        In [0, 1.003].
    """
    bias, scale = ggx_directional_albedo_terms(cos_view, alpha)
    return f0 * scale + bias
