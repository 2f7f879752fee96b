"""Fitted lobes at hits: reads the rows of a `Fit` for the view and the place of each hit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lobewise.lobes.vectors import LUMINANCE
from lobewise.render.bridge import DRJIT, dr, mi
from lobewise.render.materials.fitted import ALPHA, MIN_COSINE, SPECULAR, SPREAD, TINT, Fit
from lobewise.render.materials.probe import make_context
from lobewise.render.materials.texture_nodes import STEPS, Spot, TextureNodes, locate

_ALPHAS = range(ALPHA.start, ALPHA.stop)


class FittedLobes:
    """A `Fit` on the device, where hits look it up."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        fits = fit.nodes or (fit,)
        self._rows = mi.Float(np.concatenate([single.rows.ravel() for single in fits]))
        self._turns = mi.Float([single.turn for single in fits])
        self._numbers = mi.UInt32([0] if fit.numbers is None else fit.numbers.ravel())
        dr.eval(self._rows, self._turns, self._numbers)

    def look_up_spot(self, bsdf: Any, si: Any, active: Any) -> Spot | None:
        """Return the places of hits by the BSDF's answers there; None if the lobes have one shape everywhere."""
        places = self.fit.places
        if places is None:
            return None
        signature, level = _ask_bsdf(bsdf, make_context(self.fit.parts.glossy_lobes), places, si, active)
        spot = locate(DRJIT, signature, places.signature, places.edges)
        edge, first, second = (mi.UInt32(number) for number in spot[:3])
        return Spot(edge, first, second, spot.share, spot.gap, level)

    def look_up(self, si: Any, active: Any, spot: Spot | None = None) -> list[Any]:
        """Return the columns of `Fit.rows` for views ``si.wi`` at the places ``spot``.

        They are linear in the square root of n.v and in the azimuth. Between nodes of the texture, logarithms of alphas
        are linear in the share, and so are the other columns.
        """
        if spot is None:
            return self._read_node(si, active, mi.UInt32(0), self.fit.turn)
        rows = [
            self._read_node(si, active, node, dr.gather(mi.Float, self._turns, node, active))
            for node in (spot.first, spot.second)
        ]
        return [
            one * dr.power(two / one, spot.share) if column in _ALPHAS else dr.lerp(one, two, spot.share)
            for column, (one, two) in enumerate(zip(*rows, strict=True))
        ]

    def _read_node(self, si: Any, active: Any, node: Any, turn: Any) -> list[Any]:
        views, azimuths, columns = self.fit.rows.shape
        first = math.sqrt(MIN_COSINE)
        place = (dr.sqrt(dr.abs(si.wi.z)) - first) * ((views - 1) / (1.0 - first))
        place = dr.clip(place, 0.0, views - 1.0)
        row = dr.minimum(mi.UInt32(place), views - 2)
        share = place - mi.Float(row)

        def read(column: Any) -> list[Any]:
            start = ((node * views + row) * azimuths + column) * columns
            step = azimuths * columns
            below = [dr.gather(mi.Float, self._rows, start + k, active) for k in range(columns)]
            above = [dr.gather(mi.Float, self._rows, start + step + k, active) for k in range(columns)]
            return [dr.lerp(low, high, share) for low, high in zip(below, above, strict=True)]

        if azimuths == 1:
            return read(mi.UInt32(0))
        turns = (dr.atan2(si.wi.y, si.wi.x) - turn) / (2.0 * math.pi)
        turns = dr.select(dr.square(si.wi.x) + dr.square(si.wi.y) > 0, turns, 0.0)
        place = (turns - dr.floor(turns)) * azimuths
        left = dr.minimum(mi.UInt32(place), azimuths - 1)
        right = dr.select(left + 1 < azimuths, left + 1, 0)
        part = place - mi.Float(left)
        return [dr.lerp(low, high, part) for low, high in zip(read(left), read(right), strict=True)]

    def compute_tangent(self, si: Any, active: Any, spot: Spot | None = None) -> Any:
        """Return the local direction of the first alpha, which is also azimuth 0 of the table."""
        if not self.fit.is_isotropic:
            if spot is None:
                return mi.Vector3f(math.cos(self.fit.turn), math.sin(self.fit.turn), 0.0)
            # An axis has no sign: interpolate on the circle of doubled angles.
            one, two = (2.0 * dr.gather(mi.Float, self._turns, node, active) for node in (spot.first, spot.second))
            x, y = (dr.lerp(turn(one), turn(two), spot.share) for turn in (dr.cos, dr.sin))
            turn = 0.5 * dr.atan2(y, x)
            return mi.Vector3f(dr.cos(turn), dr.sin(turn), 0.0)
        length = dr.sqrt(dr.square(si.wi.x) + dr.square(si.wi.y))
        scale = dr.select(length > 1e-6, dr.rcp(length), 0.0)
        return mi.Vector3f(dr.select(length > 1e-6, si.wi.x * scale, 1.0), si.wi.y * scale, 0.0)

    def look_up_number(self, first: int, active: Any, spot: Spot | None = None) -> Any:
        """Return the numbers of the hits' lobe tables. ``first`` is that of the first table; 0 if there are none."""
        if spot is None:
            return mi.Float(first)
        place = spot.edge * (STEPS + 1) + mi.UInt32(dr.floor(spot.share * STEPS + 0.5))
        return mi.Float(first + dr.gather(mi.UInt32, self._numbers, place, active))

    def compute_albedos(
        self, bsdf: Any, si: Any, row: list[Any], active: Any, spot: Spot | None = None
    ) -> tuple[Any, Any]:
        """Return (diffuse, specular) albedo from the columns of `look_up` and the BSDF's textures at the hits."""
        parts = self.fit.parts
        upward = mi.Vector3f(0.0, 0.0, dr.select(si.wi.z < 0, -1.0, 1.0))
        diffuse, specular = mi.Color3f(0), mi.Color3f(*row[SPECULAR])
        if parts.diffuse:
            value = bsdf.eval(make_context(parts.diffuse_lobes), si, upward, active)
            diffuse = mi.Color3f(*row[SPREAD]) * mi.Color3f(value)
        if spot is not None:
            specular *= spot.level
        elif parts.textured and parts.glossy:
            mirrored = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)
            context = make_context(parts.glossy_lobes)
            values = [mi.Color3f(bsdf.eval(context, si, light, active)) for light in (upward, mirrored)]
            specular = sum(value * factor for value, factor in zip(values, row[TINT], strict=True))
        return dr.clip(diffuse, 0.0, 1.0), dr.clip(specular, 0.0, 1.0)


def _ask_bsdf(bsdf: Any, context: Any, places: TextureNodes, si: Any, active: Any) -> tuple[list[Any], Any]:
    """Return the signatures and the levels at hits; 0 where the BSDF is black."""
    values, level = [], mi.Color3f(0)
    for view, light, weight in zip(places.view.tolist(), places.light.tolist(), places.weight.tolist(), strict=True):
        seen = mi.SurfaceInteraction3f(si)
        seen.wi = mi.Vector3f(*view)
        color = mi.Color3f(bsdf.eval(context, seen, mi.Vector3f(*light), active))
        color = dr.select(color > 0, color, 0.0)
        level += weight * color
        values.append(sum(part * float(share) for part, share in zip(color, LUMINANCE, strict=True)))
    total = sum(values)
    scale = dr.select(total > 0, dr.rcp(total), 0.0)
    return [dr.sqrt(value * scale) for value in values], level
