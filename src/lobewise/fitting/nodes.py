"""Quadrature over the sphere for reflection: dense where lobes are, split at the horizon, where they have an edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lobewise.fitting.arrays import Array, make_turn

# Angle of the half vector up to which nodes are evenly spaced, radians: about the sharpest alpha that is resolved.
_CORE_ANGLE = 0.005
# Number of nodes along a radius above and below the horizon.
_NODES_ABOVE, _NODES_BELOW = 48, 16


@dataclass(frozen=True)
class Nodes:
    """Nodes of a quadrature over the whole sphere for one view.

    ``light`` holds unit vectors (n, 3) in the frame with the normal z and the view in the plane y = 0, x >= 0.
    ``weight`` holds solid angles (n,) in steradians, whose sum is 4 pi.
    """

    light: Array
    weight: Array


def make_nodes(cosine: float, angular: int = 64) -> Nodes:
    """Return nodes of a quadrature over the sphere for a view at n.v = ``cosine``.

    The nodes are half vectors in polar coordinates about the normal, at which the view is mirrored. A solid angle of
    half vectors becomes ``4 v.h`` times as large a solid angle of lights. The half vectors of all lights fill the half
    of the sphere about the view, up to the angle ``atan2(v.z, -v.x cos(azimuth))`` from the normal. Half vectors of
    lights on the horizon lie at half that angle. Reflection has an edge at the horizon, so the radius has two
    Gauss-Legendre rules that meet there: 48 nodes above, spaced evenly on a logarithmic scale from 0.005 radians
    outwards, and 16 below. The azimuth has the trapezoid rule with ``angular`` nodes, and with at least 128 where
    n.v < 0.2, because the edge turns sharply there.
    """
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    angular = max(angular, 128) if cosine < 0.2 else angular
    azimuth = 2.0 * math.pi * (np.arange(angular) + 0.5) / angular
    edge = np.arctan2(cosine, -sine * np.cos(azimuth))[:, None]
    abscissa, share = np.polynomial.legendre.leggauss(_NODES_ABOVE)
    stretch = np.arcsinh(0.5 * edge / _CORE_ANGLE)
    u = 0.5 * (abscissa + 1.0) * stretch
    above, above_share = _CORE_ANGLE * np.sinh(u), 0.5 * share * stretch * _CORE_ANGLE * np.cosh(u)
    abscissa, share = np.polynomial.legendre.leggauss(_NODES_BELOW)
    below, below_share = 0.25 * edge * (abscissa + 3.0), 0.25 * edge * share
    theta = np.concatenate([above, below], axis=1)
    measure = np.concatenate([above_share, below_share], axis=1) * np.sin(theta) * (2.0 * math.pi / angular)
    half = np.stack(
        [np.sin(theta) * np.cos(azimuth)[:, None], np.sin(theta) * np.sin(azimuth)[:, None], np.cos(theta)], axis=-1
    )
    across = half[..., 0] * sine + half[..., 2] * cosine
    light = 2.0 * across[..., None] * half - np.asarray([sine, 0.0, cosine])
    return Nodes(light.reshape(-1, 3), (4.0 * across * measure).ravel())


def make_upper_nodes(cosine: float, azimuth: float = 0.0, angular: int = 32) -> Nodes:
    """Return the nodes of `make_nodes` above the horizon, for a view at an azimuth, radians."""
    nodes = make_nodes(cosine, angular)
    above = nodes.light[:, 2] > 0.0
    return Nodes(nodes.light[above] @ make_turn(azimuth), nodes.weight[above])
