"""``corridor``: mirrors on one wall face satin metal on the other, over a floor with a pattern of roughness.

A mirror often shows another reflection, blurred by satin metal or doubled by the floor. Coloured objects are seen
directly, in the mirrors, and in mirrors within mirrors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item

HALF_WIDTH, HEIGHT = 1.7, 2.9
NEAR, FAR = 6.0, -8.0
"""Ends of the corridor along z; the camera stands at the near one."""

LAP = 0.05
"""Length by which walls overlap, so that no ray passes between them."""

BAYS = (3.6, 1.8, 0.0, -1.8, -3.6, -5.4)
"""Middles of the wall panels along z."""


def make_floor_patterns(tile: int = 64) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the floor's colour, (rows, columns, 3), and its alpha, (rows, columns), with ``tile`` texels per tile.

    Tiles alternate between a polished and a honed stone, with lozenges of a third stone at their corners. The alpha of
    the border along the walls varies in waves.
    """
    rows, columns = 28, 7
    x, y = np.meshgrid((np.arange(columns * tile) + 0.5) / tile, (np.arange(rows * tile) + 0.5) / tile)
    odd = (np.floor(x) + np.floor(y)) % 2 == 1
    lozenge = np.abs(x - np.round(x)) + np.abs(y - np.round(y)) < 0.24
    border = np.minimum(x, columns - x) < 0.5
    vein = 0.5 + 0.5 * np.sin(7.0 * x + 3.0 * np.sin(2.3 * y) + 4.0 * np.sin(1.1 * x + 0.7 * y))
    color = np.where(odd[..., None], [0.62, 0.58, 0.52], [0.10, 0.10, 0.11]) * (0.75 + 0.35 * vein[..., None])
    color = np.where(lozenge[..., None], [0.42, 0.10, 0.06], color)
    color = np.where(border[..., None], [0.07, 0.16, 0.17], color)
    alpha = np.where(odd, 0.16, 0.035)
    alpha = np.where(lozenge, 0.08, alpha)
    alpha = np.where(border, 0.03 * 10.0 ** (0.5 - 0.5 * np.cos(2.0 * np.pi * y / 3.5)), alpha)
    return color, alpha


def make_satin_alpha(size: int = 128) -> NDArray[np.float64]:
    """Return the alpha of a satin panel, (rows, columns): rings of alternately low and high alpha."""
    x, y = np.meshgrid(*2 * [(np.arange(size) + 0.5) / size * 2.0 - 1.0])
    return np.where((np.hypot(x, y) * 4.5).astype(int) % 2 == 0, 0.15, 0.30)


def make_panels() -> dict[str, Item]:
    """Return the panels of both walls, as items by name: mirrors on the left, satin on the right, each in a frame."""
    dim, tinted = parts.mirror((0.88, 0.89, 0.90)), parts.mirror((0.90, 0.80, 0.66))
    soft, softer = parts.metal("silver", 0.012), parts.metal("silver", 0.03)
    rings = parts.metal("aluminium", parts.texture(make_satin_alpha(), filter_type="nearest"))
    left = (dim, soft, tinted, dim, softer, dim)
    right = (
        parts.metal("aluminium", 0.15),
        parts.metal("copper", 0.22),
        rings,
        parts.metal("gold", 0.18),
        parts.metal("aluminium", 0.30),
        parts.metal("copper", 0.15),
    )
    walnut = parts.diffuse((0.20, 0.10, 0.05))
    items: dict[str, Item] = {}
    for i, z in enumerate(BAYS):
        for side, name, bsdf in ((-1.0, "mirror", left[i]), (1.0, "satin", right[i])):
            x = side * (HALF_WIDTH - 0.05)
            items[f"{name}_{i}"] = parts.rectangle((x, 1.4, z), (0, 1.4, z), (0.72, 1.15), bsdf)
            items[f"{name}_frame_{i}"] = parts.box((side * HALF_WIDTH, 1.4, z), (0.04, 1.22, 0.79), walnut)
    return items


def make_things() -> dict[str, Item]:
    """Return the free-standing objects, as items by name."""
    checks = parts.checkerboard((0.90, 0.86, 0.76), (0.05, 0.22, 0.42), (2, 2))
    bands = np.repeat(np.array([[0.85, 0.16, 0.06], [0.92, 0.86, 0.70], [0.05, 0.32, 0.34]]), 16, axis=0)
    banded = parts.diffuse(parts.texture(np.tile(bands, (3, 1))[:, None].repeat(2, axis=1), filter_type="nearest"))
    return {
        "plinth": parts.box((-1.1, 0.35, 2.5), (0.26, 0.35, 0.26), parts.diffuse((0.85, 0.80, 0.70)), 20),
        "globe": parts.sphere((-1.1, 1.0, 2.5), 0.3, banded),
        "chest": parts.box((1.2, 0.32, 1.9), (0.3, 0.32, 0.45), parts.diffuse((0.75, 0.12, 0.06)), 8),
        "ball": parts.sphere((1.15, 0.86, 1.85), 0.22, parts.diffuse((0.93, 0.72, 0.08))),
        "cube": parts.box((0.45, 0.28, -0.5), (0.28, 0.28, 0.28), parts.diffuse(checks), 33),
        "apple": parts.sphere((-0.45, 0.22, 0.9), 0.22, parts.diffuse((0.30, 0.62, 0.10))),
        "post": parts.box((-1.2, 0.7, -1.4), (0.18, 0.7, 0.18), parts.diffuse((0.08, 0.16, 0.62)), 30),
        "lantern": parts.sphere((-1.2, 1.6, -1.4), 0.2, parts.diffuse((0.90, 0.40, 0.05))),
        "bench": parts.box((1.2, 0.22, -3.3), (0.3, 0.22, 0.8), parts.diffuse((0.10, 0.42, 0.28))),
        "far_ball": parts.sphere((-0.9, 0.4, -4.2), 0.4, parts.diffuse((0.75, 0.10, 0.32))),
        "chrome": parts.sphere((0.5, 0.3, 2.75), 0.3, parts.metal("silver", 0.02)),
    }


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description."""
    color, alpha = make_floor_patterns()
    # The plugin squares its roughness.
    floor = parts.principled(parts.texture(color), roughness=parts.texture(np.sqrt(alpha)), eta=1.9)
    middle, half_length = 0.5 * (NEAR + FAR), 0.5 * (NEAR - FAR)
    across, along = (HALF_WIDTH + LAP, 0.5 * HEIGHT + LAP), (half_length + LAP, 0.5 * HEIGHT + LAP)
    painting = np.array([[[0.90, 0.62, 0.10], [0.80, 0.15, 0.08], [0.10, 0.25, 0.60]]] * 3)
    painting[1] = painting[1, [2, 0, 1]]
    painting[2] = painting[2, [1, 2, 0]]
    scene: dict[str, Any] = {
        **parts.scene((0.55, 1.62, 5.6), (-0.38, 1.08, 0.0), 58.0, width, height),
        "floor": parts.rectangle((0, 0, middle), (0, 1, middle), (HALF_WIDTH, half_length), floor),
        **parts.walls(
            ceiling=((0, HEIGHT, middle), (0, 0, middle), (HALF_WIDTH, half_length), (0.78, 0.77, 0.74)),
            end=((0, 0.5 * HEIGHT, FAR), (0, 1, 0), across, (0.52, 0.50, 0.46)),
            entrance=((0, 0.5 * HEIGHT, NEAR), (0, 1, 0), across, (0.42, 0.28, 0.20)),
        ),
        "painting": parts.rectangle(
            (0, 1.5, FAR + 0.03), (0, 1.5, 0), (0.9, 0.9), parts.diffuse(parts.texture(painting, filter_type="nearest"))
        ),
        **parts.walls(
            left=((-HALF_WIDTH, 0.5 * HEIGHT, middle), (0, 0.5 * HEIGHT, middle), along, (0.40, 0.44, 0.40)),
            right=((HALF_WIDTH, 0.5 * HEIGHT, middle), (0, 0.5 * HEIGHT, middle), along, (0.50, 0.40, 0.30)),
        ),
    }
    lamps = (
        (4.5, (20.0, 17.5, 14.0)),
        (1.4, (20.0, 18.2, 15.0)),
        (-1.7, (20.0, 19.0, 17.0)),
        (-4.9, (17.0, 18.5, 21.0)),
    )
    for i, (z, radiance) in enumerate(lamps):
        scene[f"lamp_{i}"] = parts.light((0, HEIGHT - 0.02, z), (0, 0, z), (0.5, 0.28), radiance)
        scene[f"lamp_rim_{i}"] = parts.box((0, HEIGHT, z), (0.58, 0.018, 0.36), parts.metal("copper", 0.1))
    scene.update(make_panels())
    scene.update(make_things())
    return scene
