"""Repair normals and tangents of guides, which may be interpolated, normal-mapped or missing."""

from __future__ import annotations

from typing import Any

from lobewise.lobes.numbers import Namespace
from lobewise.lobes.vectors import Vector, combine, dot, scale

MIN_COSINE = 0.01
"""Approximate smallest n.v. Normals that face farther away are bent towards the viewer."""


def face_viewer(xp: Namespace, normal: Vector, view: Vector) -> tuple[list[Any], Any]:
    """Return unit normals bent towards the viewer until n.v is at least about `MIN_COSINE`, and n.v.

    Both are unit vectors. With ``lift = max(MIN_COSINE - n.v, 0)`` the bent normal is ``n + lift v``.
    """
    cosine = dot(normal, view)
    lift = xp.maximum(xp.number(MIN_COSINE) - cosine, 0.0)
    bent = [n + lift * v for n, v in zip(normal, view, strict=True)]
    inverse = xp.where(lift > 0.0, 1.0 / xp.sqrt(dot(bent, bent)), 1.0)
    return scale(bent, inverse), (cosine + lift) * inverse


def compute_tangent(xp: Namespace, raw: Vector, normal: Vector) -> tuple[list[Any], Any]:
    """Return the tangent made perpendicular to the unit normal, of unit length, and whether the raw one was usable.

    If the raw tangent is 0 or along the normal, the result is an arbitrary vector perpendicular to the normal.
    """
    along = dot(raw, normal)
    tangent = [t - along * n for t, n in zip(raw, normal, strict=True)]
    square = dot(tangent, tangent)
    known = (square > xp.number(1e-8)) & (square < xp.number(1e8))
    x, y, z = normal
    flat = xp.abs(z) < xp.number(0.7)
    other = [xp.where(flat, -y, 0.0), xp.where(flat, x, -z), xp.where(flat, 0.0, y)]
    tangent = [xp.where(known, t, o) for t, o in zip(tangent, other, strict=True)]
    return scale(tangent, 1.0 / xp.sqrt(dot(tangent, tangent))), known


def reflect(normal: Vector, view: Vector, cosine: Any) -> list[Any]:
    """Return the mirror direction ``2 (n.v) n - v``; ``cosine`` is n.v."""
    return combine((cosine + cosine, normal), (-1.0, view))
