"""``showroom``: a metal floor whose roughness changes in inlays and ramps, while its normal and depth are smooth.

A filter that compares normals and depths blurs the reflections in the floor. The objects and walls have stripes, checks
and saturated colours, so that their reflections show it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, compute_swing

SMOOTHEST = 0.03
ROUGHEST = 0.6

TILE_ROWS, TILE_COLUMNS = 11, 8

_STEPS = (0.03, 0.05, 0.08, 0.12, 0.20, 0.30, 0.45, 0.60)
"""Alphas of the floor's tiles."""


def make_floor_alpha(tile: int = 96) -> NDArray[np.float64]:
    """Return the floor's alpha, (rows, columns), with ``tile`` texels per tile.

    Every tile has one of eight alphas; neighbours differ. Every third row is a ramp from wall to wall. Discs and rings
    of another alpha are inlaid in the tiles.
    """
    x, y = np.meshgrid((np.arange(TILE_COLUMNS * tile) + 0.5) / tile, (np.arange(TILE_ROWS * tile) + 0.5) / tile)
    column, row = x.astype(int), y.astype(int)
    alpha = np.array(_STEPS)[(3 * column + 5 * row + (column * row) % 3) % len(_STEPS)]
    fraction = x / TILE_COLUMNS
    ramp = SMOOTHEST * (ROUGHEST / SMOOTHEST) ** np.where(row % 2 == 0, fraction, 1.0 - fraction)
    alpha = np.where(row % 3 == 1, ramp, alpha)
    distance = np.hypot(x - column - 0.5, y - row - 0.5)
    disc = (distance < 0.28) & ((row + column) % 2 == 0)
    ring = (np.abs(distance - 0.33) < 0.06) & ((row + column) % 2 == 1)
    opposite = np.where(alpha > 0.14, 0.04, 0.40)
    return np.where(disc | ring, opposite, alpha)


def make_stripes(colors: tuple[tuple[float, float, float], ...], repeats: int) -> NDArray[np.float64]:
    """Return vertical stripes of the colours in turn, (1 row, columns, 3)."""
    one = np.repeat(np.array(colors, dtype=np.float64), 16, axis=0)
    return np.tile(one, (repeats, 1))[None]


def make_movers(time: float) -> dict[str, Item]:
    """Return the moving shapes: the green ball slides to the left over smooth tiles and back, the cube turns."""
    slid = 0.028 * compute_swing(time, 32.0)
    return {
        "plastic": parts.sphere((-0.5 - slid, 0.45, 0.9), 0.45, parts.plastic((0.10, 0.42, 0.12), 0.06)),
        "cube": parts.box(
            (2.3, 0.32, 1.5), (0.32, 0.32, 0.32), parts.plastic((0.55, 0.06, 0.30), 0.2), 30 + 2.5 * time
        ),
    }


def make_scene(width: int, height: int, time: float = 0.0) -> dict[str, Any]:
    """Return the scene as a description, ``time`` frames after the beginning."""
    movers = make_movers(time)
    column_alpha = SMOOTHEST * (ROUGHEST / SMOOTHEST) ** np.linspace(0.0, 1.0, 256)[:, None].repeat(4, axis=1)
    patch_alpha = np.kron(np.where(np.indices((4, 8)).sum(axis=0) % 2, 0.04, 0.32), np.ones((32, 32)))
    stripes = make_stripes(((0.85, 0.12, 0.06), (0.92, 0.90, 0.82), (0.04, 0.25, 0.62), (0.95, 0.70, 0.08)), 3)
    floor = parts.metal("aluminium", parts.texture(make_floor_alpha()))
    floor["inner"]["specular_reflectance"] = parts.rgb((0.70, 0.69, 0.68))
    walls = {"left": (0.70, 0.14, 0.07), "right": (0.04, 0.36, 0.40)}
    checks = parts.checkerboard((0.90, 0.90, 0.88), (0.05, 0.05, 0.06), (4, 4))
    return {
        **parts.scene((0.0, 3.3, 7.2), (0.0, 0.75, -0.6), 46.0, width, height),
        "floor": parts.rectangle((0, 0, 1.5), (0, 1, 1.5), (4, 5.5), floor),
        "back": parts.rectangle((0, 2.5, -4), (0, 2.5, 0), (4, 2.5), parts.diffuse((0.60, 0.58, 0.54))),
        "front": parts.rectangle((0, 2.5, 8), (0, 2.5, 0), (4, 2.5), parts.diffuse((0.45, 0.44, 0.42))),
        "left": parts.rectangle((-4, 2.5, 2), (0, 2.5, 2), (6, 2.5), parts.diffuse(walls["left"])),
        "right": parts.rectangle((4, 2.5, 2), (0, 2.5, 2), (6, 2.5), parts.diffuse(walls["right"])),
        "ceiling": parts.rectangle((0, 5, 2), (0, 0, 2), (4, 6), parts.diffuse((0.70, 0.70, 0.70))),
        "lamp": parts.light((0, 4.98, 0.2), (0, 0, 0.2), (1.6, 1.0), (10.5, 9.9, 9.0)),
        "stripes": parts.rectangle(
            (0, 1.9, -3.96), (0, 1.9, 0), (3.0, 1.3), parts.diffuse(parts.texture(stripes, filter_type="nearest"))
        ),
        "gold": parts.sphere((-1.85, 0.85, -0.6), 0.85, parts.metal("gold", 0.08)),
        "silver": parts.sphere(
            (0.1, 1.05, -1.9), 1.05, parts.metal("silver", parts.texture(patch_alpha, filter_type="nearest"))
        ),
        "copper": parts.sphere((1.95, 0.9, -0.4), 0.9, parts.metal("copper", parts.texture(column_alpha))),
        "plastic": movers["plastic"],
        "chalk": parts.sphere((0.95, 0.38, 1.3), 0.38, parts.diffuse((0.80, 0.78, 0.72))),
        "checks": parts.box((-3.05, 0.75, -2.3), (0.5, 0.75, 0.5), parts.diffuse(checks), 24),
        "plinth": parts.box((3.05, 0.55, -2.4), (0.5, 0.55, 0.5), parts.diffuse((0.92, 0.62, 0.05)), -18),
        "cube": movers["cube"],
        "post": parts.box((-2.5, 0.4, 1.4), (0.2, 0.4, 0.2), parts.diffuse((0.06, 0.16, 0.60)), 12),
    }
