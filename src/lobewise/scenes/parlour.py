"""``parlour``: lacquered furniture and glossy plastics in a room with three uplights.

Nearly all light is indirect, because the lamps light only the ceiling.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector, compute_swing


def make_parquet(planks: int = 30, length: int = 8, texels: int = 20) -> NDArray[np.float64]:
    """Return the floor's colour, (rows, columns, 3): planks of varied brown, laid in a running bond."""
    generator = np.random.default_rng(11)
    size = planks * texels
    y, x = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    plank = x // texels
    along = y + (plank % 3) * (size // (3 * length))
    board = (along * length) // size
    shade = generator.uniform(0.65, 1.15, (length + 2, planks))[board, plank]
    grain = 1.0 + 0.08 * np.sin(0.9 * x + 3.0 * np.sin(0.05 * along + plank))
    joint = np.where((x % texels == 0) | ((along * length) % size < length), 0.35, 1.0)
    brown = np.array([0.52, 0.29, 0.14])
    return np.asarray((shade * grain * joint)[..., None] * brown, dtype=np.float64)


def make_table(center: Vector, half_size: tuple[float, float], height: float, bsdf: Item) -> dict[str, Item]:
    """Return a table top on four legs, as items by name suffix."""
    x, _, z = center
    half_x, half_z = half_size
    items = {"top": parts.box((x, height - 0.05, z), (half_x, 0.05, half_z), bsdf)}
    for name, side_x, side_z in (("a", -1, -1), ("b", 1, -1), ("c", -1, 1), ("d", 1, 1)):
        leg = (x + side_x * (half_x - 0.09), 0.5 * (height - 0.1), z + side_z * (half_z - 0.09))
        items[f"leg_{name}"] = parts.box(leg, (0.05, 0.5 * (height - 0.1), 0.05), bsdf)
    return items


def make_chair(center: Vector, turn: float, bsdf: Item) -> dict[str, Item]:
    """Return a cube chair with a back, as items by name suffix."""
    x, _, z = center
    angle = np.deg2rad(turn)
    back = (x - 0.36 * float(np.sin(angle)), 0.75, z - 0.36 * float(np.cos(angle)))
    return {
        "seat": parts.box((x, 0.26, z), (0.42, 0.26, 0.42), bsdf, turn),
        "back": parts.box(back, (0.42, 0.36, 0.07), bsdf, turn),
    }


def make_movers(time: float) -> dict[str, Item]:
    """Return the moving shapes: the pearl slides over the lacquered table, behind the fruit; the stool turns."""
    swing = compute_swing(time, 32.0)
    pearl = (0.55 - 0.024 * swing, 0.88, 0.45 - 0.007 * swing)
    stool = (1.7 - 0.012 * swing, 0.2, 1.85)
    return {
        "pearl": parts.sphere(pearl, 0.16, parts.plastic((0.82, 0.80, 0.76), 0.025)),
        "stool": parts.box(stool, (0.30, 0.2, 0.30), parts.plastic((0.78, 0.62, 0.08), 0.05), 20 + 0.5 * swing),
    }


def make_scene(width: int, height: int, time: float = 0.0) -> dict[str, Any]:
    """Return the scene as a description, ``time`` frames after the beginning."""
    movers = make_movers(time)
    cream = parts.diffuse((0.80, 0.74, 0.62))
    scene: dict[str, Any] = {
        **parts.scene((0.35, 1.75, 5.2), (0.05, 0.68, -0.4), 52.0, width, height),
        "floor": parts.rectangle(
            (0, 0, 1.5), (0, 1, 1.5), (3.6, 5.0), parts.plastic(parts.texture(make_parquet()), 0.10)
        ),
        "back": parts.rectangle((0, 1.6, -3.5), (0, 1.6, 0), (3.6, 1.6), cream),
        "front": parts.rectangle((0, 1.6, 6.5), (0, 1.6, 0), (3.6, 1.6), cream),
        "left": parts.rectangle((-3.6, 1.6, 1.5), (0, 1.6, 1.5), (5.0, 1.6), parts.diffuse((0.24, 0.42, 0.38))),
        "right": parts.rectangle((3.6, 1.6, 1.5), (0, 1.6, 1.5), (5.0, 1.6), parts.diffuse((0.66, 0.30, 0.20))),
        "ceiling": parts.rectangle((0, 3.2, 1.5), (0, 0, 1.5), (3.6, 5.0), parts.diffuse((0.88, 0.87, 0.84))),
    }
    for name, x, z in (("uplight_1", -2.9, -2.7), ("uplight_2", 2.9, 1.2), ("uplight_3", -2.4, 4.8)):
        scene[f"{name}_post"] = parts.box((x, 0.95, z), (0.04, 0.95, 0.04), parts.metal("copper", 0.12))
        scene[f"{name}_bowl"] = parts.box((x, 1.95, z), (0.26, 0.06, 0.26), parts.metal("copper", 0.12))
        scene[name] = parts.light((x, 2.02, z), (x, 4.0, z), (0.22, 0.22), (150.0, 131.0, 102.0))
    furniture = {
        "table": make_table((0.05, 0.0, 0.6), (1.05, 0.62), 0.72, parts.plastic((0.16, 0.035, 0.02), 0.04, ior=1.6)),
        "red_chair": make_chair((-1.85, 0.0, 0.75), 60.0, parts.plastic((0.62, 0.05, 0.04), 0.09)),
        "blue_chair": make_chair((2.15, 0.0, -0.4), -55.0, parts.plastic((0.05, 0.14, 0.50), 0.14)),
    }
    for owner, pieces in furniture.items():
        scene.update({f"{owner}_{piece}": item for piece, item in pieces.items()})
    scene.update(
        {
            "sideboard": parts.box(
                (0.5, 0.45, -3.05), (1.5, 0.45, 0.36), parts.plastic((0.08, 0.36, 0.30), 0.06, ior=1.6)
            ),
            "sideboard_top": parts.box((0.5, 0.93, -3.05), (1.56, 0.03, 0.40), parts.plastic((0.55, 0.50, 0.40), 0.05)),
            "picture_1": parts.rectangle(
                (-0.5, 2.05, -3.47), (-0.5, 2.05, 0), (0.5, 0.62), parts.plastic((0.85, 0.45, 0.05), 0.15)
            ),
            "picture_2": parts.rectangle(
                (0.95, 2.05, -3.47), (0.95, 2.05, 0), (0.62, 0.62), parts.plastic((0.10, 0.30, 0.60), 0.10)
            ),
            "vase": parts.sphere((-0.45, 1.22, -3.0), 0.26, parts.plastic((0.75, 0.72, 0.66), 0.03)),
            "bowl": parts.sphere((1.3, 1.15, -3.0), 0.19, parts.plastic((0.70, 0.10, 0.12), 0.05)),
            "orange": parts.sphere((-0.2, 0.85, 0.75), 0.13, parts.plastic((0.85, 0.32, 0.03), 0.18)),
            "lime": parts.sphere((0.1, 0.83, 0.92), 0.11, parts.plastic((0.36, 0.60, 0.05), 0.12)),
            "pearl": movers["pearl"],
            "urn": parts.sphere((-2.4, 0.42, -2.0), 0.42, parts.plastic((0.06, 0.28, 0.30), 0.03, ior=1.6)),
            "stool": movers["stool"],
        }
    )
    return scene
