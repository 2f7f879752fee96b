"""``brushed``: brushed metals with long, narrow lobes over a rippled glossy floor with varying normals.

The brushing runs around the lathe-turned shapes and along the panels, so that alpha_u and the tangent matter.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector


def make_floor_normals(resolution: int = 1024) -> NDArray[np.float64]:
    """Return a tangent-space normal map, (rows, columns, 3) in [0, 1]: square tiles with individual ripples."""
    tiles = 10
    x, y = np.meshgrid(*2 * [(np.arange(resolution) + 0.5) / resolution * tiles])
    column, row = x.astype(int), y.astype(int)
    generator = np.random.default_rng(7)
    turn = generator.uniform(0.0, np.pi, (tiles, tiles))[row, column]
    waves = generator.uniform(1.5, 4.0, (tiles, tiles))[row, column]
    steepness = generator.choice([0.0, 0.04, 0.09], (tiles, tiles))[row, column]
    u, v = x - column - 0.5, y - row - 0.5
    phase = 2.0 * np.pi * waves * (np.cos(turn) * u + np.sin(turn) * v)
    slope_x = steepness * np.cos(turn) * np.cos(phase)
    slope_y = steepness * np.sin(turn) * np.cos(phase)
    # Bevel the edges of each tile down to the joint.
    slope_x += 0.3 * np.sign(u) * (np.abs(u) > 0.47)
    slope_y += 0.3 * np.sign(v) * (np.abs(v) > 0.47)
    return parts.encode_normals(slope_x, slope_y)


def make_cylinder(bottom: Vector, height: float, radius: float, bsdf: Item) -> Item:
    """Return an upright open cylinder."""
    top = [bottom[0], bottom[1] + height, bottom[2]]
    return {"type": "cylinder", "p0": list(bottom), "p1": top, "radius": radius, "bsdf": bsdf}


def make_disk(center: Vector, radius: float, bsdf: Item) -> Item:
    """Return a disc that faces upwards."""
    transform = ("translate", list(center)), ("rotate", [1, 0, 0], -90), ("scale", radius)
    return {"type": "disk", "to_world": transform, "bsdf": bsdf}


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description."""
    lacquer = parts.principled((0.06, 0.10, 0.16), roughness=0.24, specular=1.0)
    floor = parts.normal_map(make_floor_normals(), lacquer)
    steel = parts.metal("aluminium", 0.35, 0.06)
    checks = parts.checkerboard((0.90, 0.88, 0.82), (0.75, 0.10, 0.06), (6, 3))
    return {
        **parts.scene((0.0, 2.9, 7.3), (0.0, 0.85, 0.0), 42.0, width, height),
        "floor": parts.rectangle((0, 0, 1), (0, 1, 1), (5, 5), floor),
        "back": parts.rectangle((0, 2.5, -4), (0, 2.5, 0), (5, 2.5), parts.diffuse((0.34, 0.38, 0.46))),
        "front": parts.rectangle((0, 2.5, 8), (0, 2.5, 0), (5, 2.5), parts.diffuse((0.40, 0.40, 0.42))),
        "left": parts.rectangle((-5, 2.5, 2), (0, 2.5, 2), (6, 2.5), parts.diffuse((0.62, 0.38, 0.12))),
        "right": parts.rectangle((5, 2.5, 2), (0, 2.5, 2), (6, 2.5), parts.diffuse((0.16, 0.22, 0.55))),
        "ceiling": parts.rectangle((0, 5, 2), (0, 0, 2), (5, 6), parts.diffuse((0.55, 0.55, 0.55))),
        "lamp": parts.light((-1.6, 4.95, 1.2), (-1.6, 0, 1.2), (0.5, 1.6), (30.0, 27.5, 24.0)),
        "strip": parts.light((2.4, 4.95, -0.6), (2.4, 0, -0.6), (1.4, 0.18), (34.0, 37.0, 44.0)),
        "panel": parts.rectangle((0, 1.7, -3.7), (0, 1.7, 0), (3.6, 1.5), steel),
        "drum": make_cylinder((-1.7, 0.0, -0.4), 1.5, 0.8, parts.metal("copper", 0.05, 0.30)),
        "drum_lid": make_disk((-1.7, 1.5, -0.4), 0.8, parts.metal("copper", 0.30, 0.05)),
        "globe": parts.sphere((0.35, 1.0, -1.2), 1.0, parts.metal("silver", 0.06, 0.40)),
        "ball": parts.sphere((2.0, 0.75, 0.2), 0.75, parts.metal("gold", 0.45, 0.08)),
        "tin": make_cylinder((-0.35, 0.0, 1.5), 0.62, 0.36, parts.metal("aluminium", 0.04, 0.22)),
        "tin_lid": make_disk((-0.35, 0.62, 1.5), 0.36, parts.metal("aluminium", 0.22, 0.04)),
        "block": parts.box((3.3, 0.6, -1.7), (0.5, 0.6, 0.5), parts.diffuse(checks), 28),
        "apple": parts.sphere((0.75, 0.27, 1.9), 0.27, parts.diffuse((0.25, 0.62, 0.12))),
        "post": parts.box((-3.4, 0.8, -1.8), (0.35, 0.8, 0.35), parts.diffuse((0.85, 0.55, 0.06)), 15),
    }
