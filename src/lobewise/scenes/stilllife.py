"""``stilllife``: car paint, glass and satin metal on a lacquered table, lit by an environment map of a studio.

Soft boxes, a window and a sun of moderate size are reflected in every curved surface, and seen through the glass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector

SUN_DEGREES = 7.0
"""Angular diameter of the sun, degrees: wide enough that samples of smooth paint hit it."""

_SOFT_BOXES = (
    # Azimuth (0 is straight ahead of the camera, 90 its right) and elevation of the middle, half sizes, radiance.
    (-68.0, 42.0, 17.0, 20.0, (9.0, 8.6, 8.0)),
    (152.0, 36.0, 24.0, 12.0, (4.2, 4.6, 5.4)),
    (18.0, 74.0, 60.0, 7.0, (6.5, 6.5, 6.4)),
    (-128.0, 14.0, 5.0, 26.0, (5.0, 1.1, 2.2)),
    (118.0, 12.0, 4.0, 22.0, (0.5, 2.4, 3.6)),
)


def make_studio(rows: int = 256) -> NDArray[np.float64]:
    """Return the environment's radiance, (rows, 2 rows, 3). Row 0 is up; the first column is straight ahead."""
    u, v = np.meshgrid((np.arange(2 * rows) + 0.5) / (2 * rows), (np.arange(rows) + 0.5) / rows)
    azimuth, elevation = 360.0 * u, 90.0 - 180.0 * v

    def compute_inside(distance: NDArray[np.float64], softness: float = 1.5) -> NDArray[np.float64]:
        """Return 1 inside an outline and 0 outside, softened, from the distance to the outline in degrees."""
        t = np.clip(0.5 - distance / softness, 0.0, 1.0)
        return t * t * (3.0 - 2.0 * t)

    def compute_rectangle(middle: float, height: float, half_width: float, half_height: float) -> NDArray[np.float64]:
        across = np.abs((azimuth - middle + 180.0) % 360.0 - 180.0) - half_width
        return compute_inside(np.maximum(across, np.abs(elevation - height) - half_height))

    up = np.clip(elevation / 90.0, 0.0, 1.0)[..., None] ** 0.6
    sky = (1.0 - up) * np.array([0.62, 0.50, 0.38]) + up * np.array([0.16, 0.24, 0.42])
    ground = np.array([0.10, 0.085, 0.07]) * (1.0 + 0.4 * np.cos(np.deg2rad(azimuth)))[..., None]
    radiance = np.where(elevation[..., None] > 0, sky, ground)
    # A row of bright and dark panels on the horizon is reflected in the sides of the objects.
    panel = (azimuth // 12.0).astype(int)
    hues = np.array([[0.9, 0.3, 0.12], [0.12, 0.3, 0.6], [0.95, 0.8, 0.4], [0.06, 0.06, 0.07], [0.2, 0.5, 0.3]])
    hue = hues[panel % 5]
    row = (compute_inside(np.abs(elevation + 2.0) - 9.0) * compute_inside(np.abs(azimuth % 12.0 - 6.0) - 4.6))[
        ..., None
    ]
    radiance = radiance + row * (hue - radiance)
    for middle, height, half_width, half_height, color in _SOFT_BOXES:
        inside = compute_rectangle(middle, height, half_width, half_height)[..., None]
        radiance = radiance + inside * (np.array(color) - radiance)
    # A window of three by two panes.
    for column in range(3):
        for line in range(2):
            pane = compute_rectangle(52.0 + 13.0 * column, 28.0 + 17.0 * line, 5.4, 7.2)[..., None]
            radiance = radiance + pane * (np.array([10.0, 10.8, 12.0]) - radiance)
    angle = np.deg2rad(elevation), np.deg2rad(azimuth - 215.0)
    toward, lifted = np.deg2rad(52.0), np.sin(angle[0])
    cosine = np.sin(toward) * lifted + np.cos(toward) * np.cos(angle[0]) * np.cos(angle[1])
    sun = compute_inside(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))) - 0.5 * SUN_DEGREES)[..., None]
    return np.asarray(radiance + sun * np.array([130.0, 112.0, 84.0]), dtype=np.float64)


def make_walnut(size: int = 768) -> NDArray[np.float64]:
    """Return the table's colour, (rows, columns, 3): lozenges of veneer, grained two ways, with light joints."""
    x, y = np.meshgrid(*2 * [(np.arange(size) + 0.5) / size * 6.0])
    a, b = x + y, x - y
    cell_a, cell_b = np.floor(a).astype(int), np.floor(b).astype(int)
    turned = (cell_a + cell_b) % 2 == 0
    across, along = np.where(turned, a, b), np.where(turned, b, a)
    ring = across * 9.0 + 0.8 * np.sin(1.7 * along + cell_a) + 0.35 * np.sin(5.1 * along + 2.0 * cell_b)
    shade = 0.75 + 0.22 * np.sin(2.0 * np.pi * ring) + 0.10 * np.sin(0.9 * cell_a + 2.3 * cell_b)
    wood = np.where(turned[..., None], [0.36, 0.17, 0.075], [0.20, 0.085, 0.04]) * shade[..., None]
    joint = np.minimum(np.abs(a - np.round(a)), np.abs(b - np.round(b))) < 0.018
    return np.asarray(np.where(joint[..., None], [0.70, 0.58, 0.34], wood), dtype=np.float64)


def make_car_paint(color: Vector, flake_roughness: float) -> Item:
    """Return car paint: metal flakes with a broad coloured lobe, blended with lacquer with a sharp lobe."""
    flakes = parts.principled(color, metallic=0.8, roughness=flake_roughness, clearcoat=1.0, clearcoat_gloss=0.96)
    lacquer = parts.plastic(color, 0.02, ior=1.8)
    blend = {"type": "blendbsdf", "weight": 0.35, "lacquer": lacquer["inner"], "flakes": flakes["inner"]}
    return {"type": "twosided", "inner": blend}


def make_bowl(center: Vector, radius: float, bsdf: Item) -> Item:
    """Return a thick bowl on a foot, as a closed surface that can be glass."""
    points = (
        ((0.0, 0.0), (0.38, 0.0), (0.42, 0.05), (0.36, 0.10)),
        ((0.36, 0.10), (0.70, 0.24), (0.93, 0.50), (1.0, 0.78), (0.965, 0.81), (0.93, 0.78)),
        ((0.93, 0.78), (0.84, 0.54), (0.60, 0.32), (0.30, 0.22), (0.0, 0.20)),
    )
    return parts.lathe(radius * np.concatenate([parts.curve(part) for part in points]), center, bsdf)


def make_vase(center: Vector, height: float, bsdf: Item) -> Item:
    """Return a slender vase with an opening."""
    foot = ((0.0, 0.0), (0.17, 0.0), (0.2, 0.03))
    outline = (*foot, (0.30, 0.30), (0.24, 0.58), (0.10, 0.80), (0.11, 0.92), (0.17, 1.0))
    inside = ((0.17, 1.0), (0.09, 0.92), (0.07, 0.80), (0.0, 0.60))
    profile = np.concatenate([parts.curve(outline), parts.curve(inside)])
    return parts.lathe(height * profile, center, bsdf)


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    green_glass = {**glass, "specular_transmittance": parts.rgb((0.72, 0.93, 0.82))}
    frosted = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.12, "int_ior": 1.5, "ext_ior": 1.0}
    checks = parts.checkerboard((0.85, 0.82, 0.74), (0.12, 0.20, 0.42), (8, 5))
    stripes = np.array([[0.80, 0.76, 0.66], [0.60, 0.10, 0.07], [0.80, 0.76, 0.66], [0.08, 0.16, 0.36]])
    cloth = parts.texture(np.tile(np.repeat(stripes, 8, axis=0), (5, 1))[None], filter_type="nearest")
    return {
        **parts.scene((0.2, 2.5, 6.4), (0.1, 0.55, -0.2), 38.0, width, height),
        "studio": {"type": "envmap", "bitmap": make_studio().astype(np.float32)},
        "table": parts.rectangle((0, 0, 0), (0, 1, 0), (3.6, 3.4), parts.plastic(parts.texture(make_walnut()), 0.07)),
        "edge": parts.box((0, -0.121, 0), (3.6, 0.12, 3.4), parts.plastic((0.20, 0.085, 0.04), 0.1)),
        "screen": parts.box((-1.6, 1.15, -2.6), (1.75, 1.15, 0.05), parts.diffuse(checks), 14),
        "screen_right": parts.box((1.95, 0.98, -2.75), (1.5, 0.98, 0.05), parts.diffuse((0.58, 0.30, 0.10)), -16),
        "cloth": parts.rectangle(
            (0.35, 0.006, 0.75), (0.35, 1, 0.75), (1.5, 0.95), parts.diffuse(cloth), up=(0.3, 0, -1)
        ),
        "red": parts.sphere((-1.35, 0.85, -0.7), 0.85, make_car_paint((0.55, 0.02, 0.02), 0.45)),
        "blue": parts.sphere((-0.55, 0.4, 1.35), 0.4, parts.plastic((0.02, 0.10, 0.42), 0.02, ior=1.8)),
        "lime": parts.sphere((2.2, 0.5, -1.3), 0.5, make_car_paint((0.32, 0.46, 0.04), 0.5)),
        "glass": parts.sphere((1.35, 0.5, 0.75), 0.5, glass),
        "bowl": make_bowl((0.2, 0.008, 0.35), 0.72, green_glass),
        "orange": parts.sphere((0.22, 0.42, 0.3), 0.26, parts.plastic((0.80, 0.28, 0.03), 0.16)),
        "frosted": parts.sphere((0.35, 0.55, -1.35), 0.55, frosted),
        "vase": make_vase((1.45, 0.0, -0.75), 1.9, parts.metal("silver", 0.16)),
        "pebble": parts.sphere((-1.08, 0.24, 0.72), 0.24, parts.metal("gold", 0.22)),
        "marble": parts.sphere((0.45, 0.2, 1.75), 0.2, frosted),
        "chalk": parts.sphere((-1.5, 0.27, 1.25), 0.27, parts.diffuse((0.80, 0.76, 0.68))),
        "dice": parts.box((2.08, 0.27, 0.1), (0.27, 0.27, 0.27), parts.plastic((0.07, 0.36, 0.34), 0.05), 25),
    }
