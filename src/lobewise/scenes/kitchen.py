"""``kitchen``: glazed tiles, lacquered doors, and steel that is brushed in different directions.

Daylight comes from a window and lamplight from above the table. The tiles are individually tilted a little, between
dull joints. The brushing of hob, hood, fridge and pots runs along, across and around them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector, encode_normals

LEFT, RIGHT, BACK, FRONT, HEIGHT = -2.6, 2.6, -2.0, 5.0, 2.7

GROUT = 0.035
"""Half width of the joints between tiles, in widths of a tile."""


def make_grid(columns: int, rows: int, texels: int) -> tuple[NDArray[np.float64], ...]:
    """Return, for every texel of a tiled wall, column and row of its tile, and its place in the tile (-0.5 to 0.5)."""
    x, y = np.meshgrid((np.arange(columns * texels) + 0.5) / texels, (np.arange(rows * texels) + 0.5) / texels)
    return np.floor(x), np.floor(y), x % 1.0 - 0.5, y % 1.0 - 0.5


def make_tiles(
    colors: NDArray[np.float64], choice: NDArray[np.int64], *, askew: float, alpha: float, texels: int, seed: int
) -> Item:
    """Return tiles with rounded edges and dull joints. ``choice``, (rows, columns), indexes ``colors``, (colours, 3).

    ``askew`` is the standard deviation of the tiles' slopes.
    """
    rows, columns = choice.shape
    column, row, u, v = make_grid(columns, rows, texels)
    tile = row.astype(int), column.astype(int)
    generator = np.random.default_rng(seed)
    shade = generator.uniform(0.82, 1.1, (rows, columns))[tile]
    slope_x, slope_y = (generator.normal(0.0, askew, (rows, columns))[tile] for _ in range(2))
    # The glaze bulges and slopes down to the joint.
    slope_x, slope_y = slope_x + 6.0 * np.abs(u) ** 5 * np.sign(u), slope_y + 6.0 * np.abs(v) ** 5 * np.sign(v)
    joint = np.maximum(np.abs(u), np.abs(v)) > 0.5 - GROUT
    glaze = parts.plastic(parts.texture(np.clip(colors[choice][tile] * shade[..., None], 0.0, 1.0)), alpha)
    grout = parts.diffuse((0.42, 0.40, 0.37))
    weight = parts.texture(joint.astype(np.float64), filter_type="nearest")
    return parts.normal_map(encode_normals(slope_x, slope_y), parts.blend(glaze, grout, weight))


def make_pot(center: Vector, radius: float, height: float, bsdf: Item) -> Item:
    """Return a pot with a lid and a knob."""
    wall = ((0.92, 0.0), (0.92, 0.0), (1.0, 0.08), (1.0, 0.08), (1.0, 1.0), (1.0, 1.0), (1.05, 1.01), (1.05, 1.01))
    lid = parts.curve(((1.05, 1.04), (0.7, 1.14), (0.3, 1.19), (0.1, 1.2)))
    knob = parts.curve(((0.1, 1.2), (0.07, 1.26), (0.17, 1.32), (0.12, 1.38), (0.0, 1.39)))
    return parts.lathe(np.concatenate([wall, lid, knob]) * [radius, height], center, bsdf)


def make_bowl(center: Vector, radius: float, bsdf: Item) -> Item:
    """Return an open bowl."""
    outside = parts.curve(((0.0, 0.0), (0.35, 0.0), (0.40, 0.04), (0.78, 0.26), (1.0, 0.62)))
    inside = parts.curve(((1.0, 0.62), (0.95, 0.62), (0.74, 0.30), (0.36, 0.1), (0.0, 0.08)))
    return parts.lathe(radius * np.concatenate([outside, inside]), center, bsdf)


def make_furniture() -> dict[str, Item]:
    """Return cupboards, counter and appliances, as items by name."""
    teal, cream = parts.plastic((0.03, 0.20, 0.22), 0.05, ior=1.6), parts.plastic((0.72, 0.64, 0.48), 0.08)
    along, across = parts.metal("aluminium", 0.30, 0.06), parts.metal("aluminium", 0.06, 0.30)
    bar, black = parts.metal("copper", 0.15), parts.plastic((0.015, 0.015, 0.018), 0.03, ior=1.6)
    stone = parts.plastic((0.30, 0.28, 0.26), 0.10)
    items: dict[str, Item] = {
        "body": parts.box((-0.45, 0.45, -1.69), (2.05, 0.45, 0.27), parts.diffuse((0.05, 0.05, 0.05))),
        "counter": parts.box((-0.45, 0.92, -1.68), (2.12, 0.025, 0.32), stone),
        "hob": parts.box((-0.2, 0.951, -1.66), (0.42, 0.006, 0.25), along),
        "oven": parts.box((-0.2, 0.46, -1.41), (0.36, 0.40, 0.02), across),
        "oven_door": parts.box((-0.2, 0.40, -1.40), (0.29, 0.24, 0.02), black),
        "oven_handle": parts.box((-0.2, 0.70, -1.35), (0.28, 0.014, 0.014), bar),
        "hood": parts.box((-0.2, 1.84, -1.72), (0.46, 0.06, 0.28), along),
        "chimney": parts.box((-0.2, 2.3, -1.84), (0.16, 0.42, 0.15), across),
        "fridge_door": parts.box((2.12, 1.22, -1.62), (0.43, 0.70, 0.37), parts.metal("silver", 0.05, 0.35)),
        "fridge_drawer": parts.box((2.12, 0.26, -1.62), (0.43, 0.245, 0.37), parts.metal("silver", 0.35, 0.05)),
        "fridge_handle": parts.box((1.78, 1.1, -1.22), (0.018, 0.36, 0.02), bar),
        "shelf": parts.box((0.95, 1.55, -1.86), (0.58, 0.02, 0.14), parts.plastic((0.40, 0.20, 0.08), 0.12)),
    }
    for i, x in enumerate((-2.21, -1.61, -1.01)):
        items[f"cupboard_{i}"] = parts.box((x, 1.98, -1.83), (0.29, 0.36, 0.17), cream)
    for i, x in enumerate((-2.15, -1.49, -0.87, 0.47, 1.09, 1.55)):
        half = 0.32 if i < 2 else (0.28 if i < 5 else 0.14)
        items[f"door_{i}"] = parts.box((x, 0.46, -1.41), (half, 0.40, 0.02), teal)
        items[f"handle_{i}"] = parts.box((x, 0.78, -1.37), (0.6 * half, 0.012, 0.012), bar)
    for i, (x, z) in enumerate(((-0.42, -1.55), (0.03, -1.55), (-0.42, -1.78), (0.03, -1.78))):
        items[f"plate_{i}"] = parts.box((x, 0.957, z), (0.1, 0.004, 0.09), black)
    return items


def make_things() -> dict[str, Item]:
    """Return pots, bowls and fruit, as items by name."""
    top, lacquer = 0.78, parts.plastic((0.36, 0.03, 0.025), 0.045, ior=1.6)
    white, yellow = parts.plastic((0.78, 0.76, 0.70), 0.04), parts.plastic((0.85, 0.58, 0.05), 0.06)
    blue, red = parts.plastic((0.04, 0.12, 0.45), 0.03), parts.plastic((0.62, 0.05, 0.03), 0.10)
    return {
        "table": parts.box((0.6, top - 0.03, 0.7), (1.0, 0.03, 0.5), lacquer),
        "table_foot": parts.box((0.6, 0.37, 0.7), (0.4, 0.36, 0.12), lacquer),
        "pot": make_pot((-0.40, 0.961, -1.62), 0.17, 0.22, parts.metal("aluminium", 0.05, 0.25)),
        "pan": make_pot((0.06, 0.961, -1.66), 0.15, 0.13, parts.metal("copper", 0.08, 0.35)),
        "kettle": make_pot((-0.12, top, 0.55), 0.19, 0.26, parts.metal("silver", 0.06, 0.40)),
        "tin": make_pot((-1.95, 0.945, -1.65), 0.13, 0.30, parts.metal("aluminium", 0.25, 0.07)),
        "tin_2": make_pot((-1.62, 0.945, -1.70), 0.11, 0.22, parts.metal("gold", 0.06, 0.22)),
        "bowl": make_bowl((0.62, top, 0.62), 0.3, white),
        "orange": parts.sphere((0.54, top + 0.17, 0.62), 0.115, parts.plastic((0.82, 0.30, 0.03), 0.15)),
        "lemon": parts.sphere((0.70, top + 0.16, 0.70), 0.1, parts.plastic((0.88, 0.70, 0.06), 0.12)),
        "apple": parts.sphere((0.68, top + 0.17, 0.51), 0.105, parts.plastic((0.30, 0.50, 0.05), 0.06)),
        "cup": make_bowl((0.98, top, 0.98), 0.16, blue),
        "plate_red": make_bowl((1.2, top, 0.6), 0.22, yellow),
        "egg": parts.sphere((0.26, top + 0.07, 1.02), 0.07, parts.diffuse((0.80, 0.68, 0.55))),
        "egg_2": parts.sphere((0.41, top + 0.065, 1.08), 0.065, parts.diffuse((0.82, 0.76, 0.68))),
        "board": parts.box((0.1, top + 0.012, 0.93), (0.27, 0.012, 0.17), parts.diffuse((0.52, 0.34, 0.17)), 14),
        "shelf_bowl": make_bowl((0.62, 1.57, -1.85), 0.15, red),
        "shelf_bowl_2": make_bowl((0.97, 1.57, -1.85), 0.13, yellow),
        "shelf_jar": parts.sphere((1.29, 1.67, -1.86), 0.1, blue),
        "melon": parts.sphere((1.2, 1.085, -1.66), 0.14, parts.plastic((0.12, 0.30, 0.06), 0.14)),
        "toaster": parts.box((0.75, 1.055, -1.70), (0.17, 0.11, 0.1), parts.metal("silver", 0.30, 0.08), -14),
    }


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description."""
    generator = np.random.default_rng(23)
    glazes = np.array([[0.74, 0.74, 0.68], [0.32, 0.52, 0.50], [0.72, 0.50, 0.22]])
    wall = make_tiles(
        glazes, generator.choice(3, (18, 34), p=(0.74, 0.18, 0.08)), askew=0.02, alpha=0.04, texels=28, seed=5
    )
    stones = np.array([[0.60, 0.56, 0.50], [0.11, 0.12, 0.14]])
    floor = make_tiles(stones, np.indices((14, 11)).sum(axis=0) % 2, askew=0.004, alpha=0.09, texels=64, seed=6)
    middle = 0.5 * (BACK + FRONT)
    half_width, half_length, half_height = RIGHT + 0.05, 0.5 * (FRONT - BACK) + 0.05, 0.5 * HEIGHT
    inside = (0, half_height, middle)
    scene: dict[str, Any] = {
        **parts.scene((-0.35, 1.66, 3.0), (0.05, 1.1, -1.2), 54.0, width, height),
        "floor": parts.rectangle((0, 0, middle), (0, 1, middle), (half_width, half_length), floor),
        "wall": parts.rectangle((0, half_height, BACK), (0, half_height, 0), (half_width, half_height), wall),
        **parts.walls(
            ceiling=((0, HEIGHT, middle), (0, 0, middle), (half_width, half_length), (0.80, 0.79, 0.76)),
            front=((0, half_height, FRONT), (0, half_height, 0), (half_width, half_height), (0.50, 0.42, 0.36)),
            left=((LEFT, half_height, middle), inside, (half_length, half_height), (0.62, 0.60, 0.52)),
            right=((RIGHT, half_height, middle), inside, (half_length, half_height), (0.66, 0.40, 0.24)),
        ),
        "window": parts.light((LEFT + 0.02, 1.6, 0.3), (0, 1.6, 0.3), (1.2, 0.62), (10.5, 12.0, 14.0), up=(0, 1, 0)),
        "lamp": parts.bulb((0.6, 1.98, 0.5), 0.11, (34.0, 25.0, 15.0)),
        "shade": parts.lathe(
            parts.curve(((0.30, 0.0), (0.24, 0.10), (0.10, 0.20), (0.03, 0.24))),
            (0.6, 2.0, 0.5),
            parts.metal("copper", 0.06, 0.25),
        ),
        "cord": parts.box((0.6, 2.47, 0.5), (0.008, 0.24, 0.008), parts.diffuse((0.04, 0.04, 0.04))),
    }
    for i, z in enumerate((-0.9, -0.1, 0.7, 1.5)):
        scene[f"bar_{i}"] = parts.box((LEFT + 0.04, 1.6, z), (0.03, 0.68, 0.04), parts.plastic((0.75, 0.73, 0.68), 0.1))
    for name, y in (("sill", 0.96), ("transom", 1.7), ("lintel", 2.24)):
        scene[name] = parts.box((LEFT + 0.05, y, 0.3), (0.05, 0.04, 1.26), parts.plastic((0.75, 0.73, 0.68), 0.1))
    scene.update(make_furniture())
    scene.update(make_things())
    return scene
