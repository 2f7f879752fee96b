"""Items that the built-in scenes share, as descriptions for `lobewise.render.loading.build_scene`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Item = dict[str, Any]

IOR_OF_METALS = {
    # Complex index of refraction at 630, 532 and 465 nm, rounded from Johnson and Christy 1972 (Cu, Ag, Au) and
    # Rakic 1995 (Al).
    "gold": ((0.19, 0.54, 1.33), (3.09, 2.23, 1.88)),
    "copper": ((0.27, 1.12, 1.16), (3.41, 2.59, 2.40)),
    "silver": ((0.06, 0.06, 0.04), (4.13, 3.37, 2.66)),
    "aluminium": ((1.39, 0.92, 0.65), (7.65, 6.48, 5.63)),
}


def compute_swing(time: float, frames: float) -> float:
    """Return a time that runs from 0 to ``frames`` and back again, repeatedly."""
    return frames - abs(time % (2.0 * frames) - frames)


def rgb(value: Vector) -> Item:
    """Return a colour in linear sRGB."""
    return {"type": "rgb", "value": list(value)}


def color(value: Vector | Item) -> Item:
    """Return a colour in linear sRGB; a texture is returned unchanged."""
    return value if isinstance(value, dict) else rgb(value)


def scene(origin: Vector, target: Vector, fov_x: float, width: int, height: int) -> Item:
    """Return a scene with only its camera, and an integrator for Mitsuba's own programs."""
    return {
        "type": "scene",
        "sensor": camera(origin, target, fov_x, width, height),
        "integrator": {"type": "path", "max_depth": 8},
    }


def camera(origin: Vector, target: Vector, fov_x: float, width: int, height: int) -> Item:
    """Return a perspective sensor with a box filter, ``fov_x`` degrees wide on a square image."""
    return {
        "type": "perspective",
        "fov": fov_x,
        "fov_axis": "smaller",
        "near_clip": 0.01,
        "far_clip": 1000.0,
        "to_world": (("look_at", list(origin), list(target), [0, 1, 0]),),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }


def box(center: Vector, half_size: Vector, bsdf: Item, turn: float = 0.0) -> Item:
    """Return a box of half size ``half_size``, turned by ``turn`` degrees about the vertical."""
    transform = ("translate", list(center)), ("rotate", [0, 1, 0], turn), ("scale", list(half_size))
    return {"type": "cube", "to_world": transform, "bsdf": bsdf}


def sphere(center: Vector, radius: float, bsdf: Item) -> Item:
    """Return a sphere with poles at top and bottom, so that textures and brushing run around the vertical."""
    transform = ("translate", list(center)), ("rotate", [1, 0, 0], -90), ("scale", radius)
    return {"type": "sphere", "to_world": transform, "bsdf": bsdf}


def rectangle(
    center: Vector, toward: Vector, half_size: tuple[float, float], bsdf: Item, up: Vector | None = None
) -> Item:
    """Return a rectangle at ``center`` that faces the point ``toward``, upright unless it faces up or down."""
    level = (center[0], center[2]) == (toward[0], toward[2])
    return {**_face(center, toward, half_size, up or ((0, 0, -1) if level else (0, 1, 0))), "bsdf": bsdf}


def walls(**sides: tuple[Vector, Vector, tuple[float, float], Vector]) -> dict[str, Item]:
    """Return diffuse rectangles by name, from centre, point that the rectangle faces, half sizes and colour."""
    return {
        name: rectangle(center, toward, half_size, diffuse(paint))
        for name, (center, toward, half_size, paint) in sides.items()
    }


def light(
    center: Vector, toward: Vector, half_size: tuple[float, float], radiance: Vector | Item, up: Vector = (0, 0, 1)
) -> Item:
    """Return a rectangular area light that shines toward a point, in one colour or a texture."""
    emitter = {"type": "area", "radiance": color(radiance)}
    return {**_face(center, toward, half_size, up), "emitter": emitter}


def bulb(center: Vector, radius: float, radiance: Vector) -> Item:
    """Return a spherical light."""
    emitter = {"type": "area", "radiance": rgb(radiance)}
    return {"type": "sphere", "center": list(center), "radius": radius, "emitter": emitter}


def _face(center: Vector, toward: Vector, half_size: tuple[float, float], up: Vector) -> Item:
    transform = ("look_at", list(center), list(toward), list(up)), ("scale", [half_size[0], half_size[1], 1.0])
    return {"type": "rectangle", "to_world": transform}


def diffuse(reflectance: Vector | Item) -> Item:
    """Return a two-sided diffuse material, of one colour or a texture."""
    return {"type": "twosided", "inner": {"type": "diffuse", "reflectance": color(reflectance)}}


def metal(name: str, alpha: float | Item, alpha_v: float | Item | None = None) -> Item:
    """Return a GGX metal of `IOR_OF_METALS`, two-sided, isotropic unless ``alpha_v`` is given."""
    eta, k = IOR_OF_METALS[name]
    inner: Item = {"type": "roughconductor", "distribution": "ggx", "eta": rgb(eta), "k": rgb(k)}
    inner.update({"alpha": alpha} if alpha_v is None else {"alpha_u": alpha, "alpha_v": alpha_v})
    return {"type": "twosided", "inner": inner}


def plastic(reflectance: Vector | Item, alpha: float, *, ior: float = 1.5) -> Item:
    """Return a GGX rough plastic, two-sided."""
    inner = {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": alpha,
        "int_ior": ior,
        "diffuse_reflectance": color(reflectance),
        "nonlinear": True,
    }
    return {"type": "twosided", "inner": inner}


def checkerboard(first: Vector, second: Vector, repeats: tuple[float, float]) -> Item:
    """Return a checkerboard of two colours."""
    return {
        "type": "checkerboard",
        "color0": rgb(first),
        "color1": rgb(second),
        "to_uv": (("scale", [repeats[0], repeats[1], 1.0]),),
    }


def texture(values: NDArray[np.floating[Any]], *, filter_type: str = "bilinear", raw: bool = True) -> Item:
    """Return a texture of an array (rows, columns) or (rows, columns, channels), row 0 at v = 1."""
    data = np.ascontiguousarray(values, dtype=np.float32)
    if data.ndim == 2:
        data = data[..., None]
    return {"type": "bitmap", "bitmap": data, "raw": raw, "filter_type": filter_type, "wrap_mode": "clamp"}


def principled(base: Vector | Item, **parameters: float | Item) -> Item:
    """Return a two-sided principled material with the plugin's ``parameters`` (``roughness`` squared is alpha)."""
    return {"type": "twosided", "inner": {"type": "principled", "base_color": color(base), **parameters}}


def mirror(reflectance: Vector) -> Item:
    """Return a perfectly smooth mirror, two-sided."""
    inner = {"type": "conductor", "material": "none", "specular_reflectance": rgb(reflectance)}
    return {"type": "twosided", "inner": inner}


def lathe(profile: NDArray[np.floating[Any]], center: Vector, bsdf: Item, segments: int = 96) -> Item:
    """Return a smooth upright body of revolution as a mesh.

    Parameters
    ----------
    profile : (points, 2)
        Radius and height above ``center`` of the outline, with the outside on its right. For a closed body of glass the
        outline ends where it begins, or on the axis.
    segments : int
        Facets around the axis.

    Notes
    -----
    ``u`` runs once around, ``v`` along the length of the outline. Normals are those of a smooth curve. A repeated point
    makes a sharp edge. On the axis the normal is vertical.
    """
    radius, height = np.asarray(profile, dtype=np.float64).T
    rows = len(radius)
    step = np.stack([np.diff(radius), np.diff(height)], axis=-1)
    length = np.linalg.norm(step, axis=-1)
    step = np.divide(step, length[:, None], out=np.zeros_like(step), where=length[:, None] > 0)
    slope = np.zeros((rows, 2))
    slope[:-1] += step
    slope[1:] += step
    slope[radius == 0, 1] = 0.0  # the outline is level where it crosses the axis
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(length)]) / length.sum()
    angle = np.linspace(0.0, 2.0 * np.pi, segments + 1)
    around = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], axis=-1)
    up = np.array([0.0, 1.0, 0.0])
    position = radius[:, None, None] * around + height[:, None, None] * up + np.array(center)
    normal = slope[:, 1, None, None] * around - slope[:, 0, None, None] * up
    uv = np.stack(np.broadcast_arrays(np.linspace(0.0, 1.0, segments + 1), along[:, None]), axis=-1)
    corner = np.arange(rows - 1)[:, None] * (segments + 1) + np.arange(segments)
    right, above = corner + 1, corner + segments + 1
    # Make two facets per cell, counterclockwise from outside, except those without area on the axis and at edges.
    first = np.stack([corner, right, above], axis=-1)[(length > 0) & (radius[:-1] > 0)]
    second = np.stack([right, above + 1, above], axis=-1)[(length > 0) & (radius[1:] > 0)]
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    return {
        "type": "mesh",
        "vertices": position.astype(np.float32).reshape(-1, 3),
        "normals": normal.astype(np.float32).reshape(-1, 3),
        "uv": uv.astype(np.float32).reshape(-1, 2),
        "faces": faces.astype(np.uint32),
        "bsdf": bsdf,
    }


def curve(points: tuple[tuple[float, float], ...], steps: int = 8) -> NDArray[np.float64]:
    """Return a smooth curve through points of the plane, with ``steps`` pieces between two points.

    Source: Catmull and Rom 1974, "A class of local interpolating splines".
    """
    knots = np.array(points, dtype=np.float64)
    padded = np.concatenate([2.0 * knots[:1] - knots[1:2], knots, 2.0 * knots[-1:] - knots[-2:-1]])
    t = np.arange(steps)[:, None] / steps
    pieces = []
    for a, b, c, d in zip(padded[:-3], padded[1:-2], padded[2:-1], padded[3:], strict=True):
        pieces.append(b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))))
    curve: NDArray[np.float64] = np.concatenate([*pieces, knots[-1:]])
    curve[:, 0] = np.maximum(curve[:, 0], 0.0)  # a spline may swing across the axis
    return curve


def blend(first: Item, second: Item, weight: float | Item) -> Item:
    """Return a blend of two two-sided materials. ``weight`` (a number or a texture) is the share of the second."""
    blend = {"type": "blendbsdf", "weight": weight, "first": first["inner"], "second": second["inner"]}
    return {"type": "twosided", "inner": blend}


def normal_map(normals: NDArray[np.floating[Any]], bsdf: Item) -> Item:
    """Return a two-sided material under a normal map, (rows, columns, 3) in [0, 1]."""
    inner = {"type": "normalmap", "normalmap": texture(normals), "inner": bsdf["inner"]}
    return {"type": "twosided", "inner": inner}


def bump_map(heights: NDArray[np.floating[Any]], scale: float, bsdf: Item) -> Item:
    """Return a two-sided material under a bump map of heights (rows, columns), in units of ``scale``."""
    inner = {"type": "bumpmap", "heights": texture(heights), "scale": scale, "inner": bsdf["inner"]}
    return {"type": "twosided", "inner": inner}


def encode_normals(slope_x: NDArray[np.floating[Any]], slope_y: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the normal map, (rows, columns, 3) in [0, 1], of normals (slope_x, slope_y, 1)."""
    normal = np.stack([slope_x, slope_y, np.ones_like(slope_x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(0.5 * normal + 0.5, dtype=np.float64)
