"""``sparks``: dozens of small lights over glass, polished metal and a glossy table, whose caustics give fireflies.

Paths hit a light behind glass only by chance, and a small light rarely, so some samples are very bright.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector

_BULBS = ((1.0, 0.62, 0.28), (1.0, 0.85, 0.62), (0.45, 0.65, 1.0), (1.0, 0.30, 0.20), (0.50, 1.0, 0.55))


def make_garland(name: str, first: Vector, last: Vector, sag: float, count: int, power: float) -> dict[str, Item]:
    """Return small spherical lights on a sagging line, as items by name."""
    start, end = np.array(first), np.array(last)
    items: dict[str, Item] = {}
    for i, t in enumerate(np.linspace(0.0, 1.0, count)):
        center = start + t * (end - start) - np.array([0.0, 4.0 * sag * t * (1.0 - t), 0.0])
        color = np.array(_BULBS[i % len(_BULBS)]) * power
        items[f"{name}_{i}"] = parts.bulb(tuple(center.tolist()), 0.035, tuple(color.tolist()))
    return items


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    frosted = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.08, "int_ior": 1.5, "ext_ior": 1.0}
    chrome = parts.mirror((0.85, 0.86, 0.88))
    checks = parts.checkerboard((0.85, 0.82, 0.74), (0.20, 0.05, 0.04), (5, 5))
    scene: dict[str, Any] = {
        **parts.scene((0.0, 2.3, 6.0), (0.0, 0.8, -0.2), 42.0, width, height),
        "table": parts.rectangle((0, 0, 0), (0, 1, 0), (4.0, 4.5), parts.plastic((0.26, 0.11, 0.05), 0.06, ior=1.6)),
        "back": parts.rectangle((0, 2.5, -3.5), (0, 2.5, 0), (5, 2.5), parts.diffuse((0.34, 0.38, 0.50))),
        "front": parts.rectangle((0, 2.5, 7), (0, 2.5, 0), (5, 2.5), parts.diffuse((0.50, 0.40, 0.34))),
        "ceiling": parts.rectangle((0, 4.2, 1.5), (0, 0, 1.5), (4.5, 5.5), parts.diffuse((0.60, 0.58, 0.55))),
        "left": parts.rectangle((-4, 2.5, 1), (0, 2.5, 1), (5, 2.5), parts.diffuse((0.62, 0.26, 0.16))),
        "right": parts.rectangle((4, 2.5, 1), (0, 2.5, 1), (5, 2.5), parts.diffuse((0.16, 0.46, 0.40))),
        "tray": parts.rectangle((0.1, 0.02, 0.1), (0.1, 1, 0.1), (1.5, 1.3), parts.metal("silver", 0.12)),
        "glass": parts.sphere((-1.05, 0.62, 0.1), 0.6, glass),
        "drop": parts.sphere((0.55, 0.35, 1.15), 0.33, glass),
        "frosted": parts.sphere((1.35, 0.62, -0.1), 0.6, frosted),
        "chrome": parts.sphere((0.15, 0.82, -1.1), 0.8, chrome),
        "gold": parts.sphere((-0.35, 0.30, 1.2), 0.28, parts.metal("gold", 0.10)),
        "berry": parts.sphere((2.35, 0.36, 1.0), 0.36, parts.plastic((0.50, 0.03, 0.10), 0.05)),
        "chalk": parts.sphere((-2.4, 0.42, 0.6), 0.42, parts.diffuse((0.80, 0.78, 0.74))),
        "dice": parts.box((-2.3, 0.4, -1.4), (0.4, 0.4, 0.4), parts.diffuse(checks), 32),
        "brick": parts.box((2.5, 0.5, -1.5), (0.45, 0.5, 0.45), parts.plastic((0.10, 0.22, 0.48), 0.12), -22),
    }
    scene.update(make_garland("near", (-3.4, 3.1, 0.2), (3.4, 3.1, 0.2), 0.8, 13, 170.0))
    scene.update(make_garland("far", (-3.4, 2.6, -3.0), (3.4, 2.6, -3.0), 0.7, 14, 150.0))
    scene.update(make_garland("front", (-1.9, 0.09, 1.75), (1.9, 0.09, 1.75), 0.0, 8, 80.0))
    scene.update(make_garland("left_row", (-1.75, 0.09, -0.9), (-1.75, 0.09, 1.4), 0.0, 4, 80.0))
    scene.update(make_garland("right_row", (2.0, 0.09, -0.9), (1.9, 0.09, 1.4), 0.0, 4, 80.0))
    return scene
