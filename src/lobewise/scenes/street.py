"""``street``: a wet street at night, with puddles, damp asphalt and bumpy walls under shop windows and street lamps.

The normal map of the asphalt is band-limited, so that an image of a few hundred pixels resolves its waves. In the
puddles the water is smooth and nearly level. Bricks, shutters and bins are bump-mapped.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector, encode_normals

HALF_WIDTH, NEAR, FAR = 4.0, 7.0, -17.0
"""Half width of the street between its walls, and its ends along z behind the camera and far away."""

SHORTEST, LONGEST = 0.3, 1.6
"""Shortest and longest wavelength of the asphalt's waves."""

PUDDLE_ALPHA, DRIEST_ALPHA = 0.02, 0.40


def make_waves(
    x: NDArray[np.float64], y: NDArray[np.float64], count: int, band: tuple[float, float], seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return height and both slopes of ``count`` plane waves in a band of wavelengths. The slopes have variance 1."""
    generator = np.random.default_rng(seed)
    turn = generator.uniform(0.0, 2.0 * np.pi, count)
    number = 2.0 * np.pi / np.exp(generator.uniform(np.log(band[0]), np.log(band[1]), count))
    shift = generator.uniform(0.0, 2.0 * np.pi, count)
    height, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    # A wave of slope a in a random direction adds a^2 / 4 to the variance of either slope.
    slope = 2.0 / np.sqrt(count)
    for angle, k, offset in zip(turn, number, shift, strict=True):
        phase = k * (np.cos(angle) * x + np.sin(angle) * y) + offset
        height += slope / k * np.sin(phase)
        slope_x += slope * np.cos(angle) * np.cos(phase)
        slope_y += slope * np.sin(angle) * np.cos(phase)
    return height, slope_x, slope_y


def make_asphalt(texels: int = 48) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return colour (rows, columns, 3), alpha (rows, columns) and normal map of the street, ``texels`` per unit."""
    columns, rows = int(2 * HALF_WIDTH) * texels, int(NEAR - FAR) * texels
    x, y = np.meshgrid((np.arange(columns) + 0.5) / texels - HALF_WIDTH, (np.arange(rows) + 0.5) / texels + FAR)
    level, _, _ = make_waves(x, y, 14, (2.2, 5.0), 31)
    wet = np.clip(0.5 + (level / level.std() - 0.55) * 3.0, 0.0, 1.0)
    wet = wet * wet * (3.0 - 2.0 * wet)
    patch, _, _ = make_waves(x, y, 12, (0.6, 2.0), 32)
    damp = np.clip(0.5 + 0.35 * patch / patch.std(), 0.0, 1.0)
    alpha = 0.15 * (DRIEST_ALPHA / 0.15) ** damp
    alpha = alpha ** (1.0 - wet) * PUDDLE_ALPHA**wet
    _, slope_x, slope_y = make_waves(x, y, 40, (SHORTEST, LONGEST), 33)
    steepness = 0.07 * (1.0 - wet) + 0.006 * wet
    # Drops make rings in the puddles.
    generator = np.random.default_rng(34)
    ring_x, ring_y = np.zeros_like(x), np.zeros_like(x)
    for drop_x, drop_y, radius in generator.uniform((-3.5, -8.0, 0.2), (3.5, 5.0, 0.6), (46, 3)):
        distance = np.hypot(x - drop_x, y - drop_y) + 1e-9
        ring = np.exp(-(((distance - radius) / 0.16) ** 2)) * np.cos(2.0 * np.pi * (distance - radius) / 0.22)
        ring_x += ring * (x - drop_x) / distance
        ring_y += ring * (y - drop_y) / distance
    slope_x, slope_y = (steepness * a + 0.05 * wet * b for a, b in ((slope_x, ring_x), (slope_y, ring_y)))
    grain = np.kron(generator.uniform(0.7, 1.3, (rows // 4, columns // 4)), np.ones((4, 4)))
    stripe = (np.abs(x + 0.25) < 0.08) & (y % 2.4 < 1.5)
    crossing = (np.abs(y + 3.4) < 1.0) & (x % 0.9 < 0.45) & (np.abs(x) < 2.8)
    paint = (stripe & (np.abs(y + 3.4) > 1.4)) | crossing
    color = np.where(paint[..., None], [0.62, 0.62, 0.56], [0.10, 0.10, 0.11]) * grain[..., None]
    return color * (1.0 - 0.55 * wet[..., None]), alpha, encode_normals(slope_x, slope_y)


def make_bricks(columns: int, rows: int, texels: int = 16) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return colour (rows, columns, 3) and height (rows, columns, 0 to 1) of a wall of bricks."""
    x, y = np.meshgrid((np.arange(2 * columns * texels) + 0.5) / texels, (np.arange(rows * texels) + 0.5) / texels)
    row = np.floor(y).astype(int)
    shifted = 0.5 * x + 0.5 * (row % 2)
    column = np.floor(shifted).astype(int)
    edge = np.minimum(0.5 - np.abs(y % 1.0 - 0.5), 2.0 * (0.5 - np.abs(shifted % 1.0 - 0.5)))
    height = np.clip(edge / 0.2, 0.0, 1.0)
    shade = np.random.default_rng(35).uniform(0.6, 1.2, (rows, columns + 2))[row, column]
    color = np.where(height[..., None] > 0.45, [0.52, 0.22, 0.14], [0.34, 0.33, 0.31]) * shade[..., None]
    return color, height * height * (3.0 - 2.0 * height)


def make_ribs(count: int, texels: int = 16) -> NDArray[np.float64]:
    """Return the height, (2, columns), of ribs side by side."""
    wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count * texels) + 0.5) / texels)
    return np.tile(wave, (2, 1))


def make_facades() -> dict[str, Item]:
    """Return the houses on both sides and at the end, as items by name."""
    color, height = make_bricks(64, 36)
    # The bricks are diffuse: glossy ones under a bump map give NaN here, in Mitsuba's own integrator too.
    brick = parts.bump_map(height, 0.012, parts.diffuse(parts.texture(color)))
    far_color, far_height = make_bricks(22, 32)
    far_brick = parts.bump_map(far_height, 0.012, parts.diffuse(parts.texture(0.8 * far_color)))
    middle, half_length = 0.5 * (NEAR + FAR), 0.5 * (NEAR - FAR)
    items: dict[str, Item] = {
        "end": parts.rectangle((0, 2.5, FAR), (0, 2.5, 0), (HALF_WIDTH, 2.5), far_brick),
        "behind": parts.rectangle((0, 2.5, NEAR), (0, 2.5, 0), (HALF_WIDTH, 2.5), parts.diffuse((0.2, 0.2, 0.22))),
    }
    stone = parts.plastic((0.16, 0.16, 0.17), 0.12)
    shutter = parts.bump_map(make_ribs(26).T, 0.06, parts.metal("aluminium", 0.22))
    for name, side in (("left", -1.0), ("right", 1.0)):
        x = side * HALF_WIDTH
        items[name] = parts.rectangle((x, 2.5, middle), (0, 2.5, middle), (half_length, 2.5), brick)
        items[f"{name}_kerb"] = parts.box((side * 3.5, 0.05, middle), (0.5, 0.05, half_length), stone)
    for i, (side, z) in enumerate(((-1.0, 0.6), (1.0, -6.4), (-1.0, -12.4))):
        x = side * (HALF_WIDTH - 0.04)
        items[f"shutter_{i}"] = parts.rectangle((x, 1.25, z), (0, 1.25, z), (1.0, 1.15), shutter)
    return items


def make_lights() -> dict[str, Item]:
    """Return shop windows with their frames, street lamps and lit windows, as items by name."""
    shops = (
        (-1.0, -2.6, 1.3, (16.0, 8.0, 2.6)),
        (-1.0, -7.8, 1.1, (2.2, 12.0, 11.0)),
        (1.0, -0.4, 1.3, (16.0, 2.5, 7.0)),
        (1.0, -10.4, 1.4, (14.0, 12.0, 7.0)),
        (1.0, -3.9, 0.8, (3.2, 5.4, 20.0)),
    )
    frame = parts.plastic((0.03, 0.06, 0.05), 0.06)
    items: dict[str, Item] = {}
    for i, (side, z, half_width, radiance) in enumerate(shops):
        x = side * (HALF_WIDTH - 0.03)
        items[f"shop_{i}"] = parts.light((x, 1.35, z), (0, 1.35, z), (half_width, 0.75), radiance, up=(0, 1, 0))
        items[f"shop_sill_{i}"] = parts.box((x, 0.52, z), (0.14, 0.07, half_width + 0.12), frame)
        items[f"shop_sign_{i}"] = parts.box((x, 2.22, z), (0.16, 0.10, half_width + 0.12), frame)
        for k in (-1, 0, 1):
            bar = (x - 0.03 * side, 1.35, z + k * (half_width + 0.03))
            items[f"shop_bar_{i}_{k + 1}"] = parts.box(bar, (0.05, 0.8, 0.04), frame)
    iron = parts.metal("aluminium", 0.2)
    for i, (x, z) in enumerate(((3.15, 1.6), (-3.15, -4.9), (3.15, -8.4), (-3.15, 5.2))):
        items[f"post_{i}"] = parts.box((x, 1.5, z), (0.045, 1.5, 0.045), iron)
        items[f"lamp_{i}"] = parts.bulb((x, 3.15, z), 0.2, (140.0, 101.0, 56.0))
    # The upper windows of the far house are one light with a texture.
    lit = np.zeros((7, 13, 3))
    lit[1::2, 1::2] = np.random.default_rng(36).choice([0.0, 0.6, 1.0], (3, 6, 1)) * np.array([6.5, 4.6, 2.1])
    picture = parts.texture(np.kron(lit, np.ones((4, 4, 1))), filter_type="nearest")
    items["windows"] = parts.light((0, 3.2, FAR + 0.03), (0, 3.2, 0), (2.6, 1.4), picture, up=(0, 1, 0))
    return items


def make_car(x: float, z: float, paint: Item) -> dict[str, Item]:
    """Return a parked car seen from behind, as items by name."""
    glass, tyre = parts.plastic((0.01, 0.012, 0.015), 0.02, ior=1.6), parts.diffuse((0.025, 0.025, 0.025))
    items: dict[str, Item] = {
        "body": parts.box((x, 0.56, z), (0.78, 0.26, 1.75), paint),
        "cabin": parts.box((x, 1.02, z - 0.2), (0.66, 0.22, 0.95), glass),
        "roof": parts.box((x, 1.26, z - 0.2), (0.68, 0.025, 0.97), paint),
        "bumper": parts.box((x, 0.38, z + 1.78), (0.74, 0.06, 0.06), parts.metal("silver", 0.04, 0.15)),
    }
    for name, side in (("left", -1.0), ("right", 1.0)):
        items[f"tail_{name}"] = parts.light(
            (x + side * 0.6, 0.66, z + 1.76),
            (x + side * 0.6, 0.66, z + 9),
            (0.13, 0.06),
            (16.0, 0.9, 0.45),
            up=(0, 1, 0),
        )
        for end in (-1.0, 1.0):
            items[f"wheel_{name}_{'front' if end < 0 else 'back'}"] = {
                "type": "cylinder",
                "p0": [x + side * 0.62, 0.3, z + end * 1.1],
                "p1": [x + side * 0.8, 0.3, z + end * 1.1],
                "radius": 0.3,
                "bsdf": tyre,
            }
    return {f"car_{name}": item for name, item in items.items()}


def make_bin(center: Vector, radius: float, height: float, bsdf: Item) -> Item:
    """Return a round bin with a domed lid."""
    wall = ((0.9, 0.0), (0.9, 0.0), (1.0, 0.84), (1.0, 0.84), (1.08, 0.84), (1.08, 0.84), (1.08, 0.88), (1.08, 0.88))
    lid = parts.curve(((1.05, 0.9), (0.7, 0.98), (0.3, 1.02), (0.0, 1.03)))
    return parts.lathe(np.concatenate([wall, lid]) * [radius, height], center, bsdf)


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description."""
    color, alpha, normals = make_asphalt()
    # The plugin squares its roughness.
    asphalt = parts.principled(parts.texture(color), roughness=parts.texture(np.sqrt(alpha)), specular=0.7)
    middle, half_length = 0.5 * (NEAR + FAR), 0.5 * (NEAR - FAR)
    ribbed = parts.bump_map(make_ribs(24), 0.05, parts.metal("aluminium", 0.15))
    return {
        **parts.scene((0.35, 1.75, 6.2), (-0.15, 0.85, -1.0), 54.0, width, height),
        "sky": {"type": "constant", "radiance": parts.rgb((0.08, 0.105, 0.19))},
        "street": parts.rectangle(
            (0, 0, middle), (0, 1, middle), (HALF_WIDTH, half_length), parts.normal_map(normals, asphalt)
        ),
        **make_facades(),
        **make_lights(),
        **make_car(-1.9, -1.2, parts.plastic((0.60, 0.05, 0.05), 0.03, ior=1.7)),
        "bin": make_bin((2.75, 0.1, 0.3), 0.27, 0.8, ribbed),
        "bin_2": make_bin((3.35, 0.1, -0.1), 0.25, 0.72, ribbed),
        "hydrant": parts.lathe(
            parts.curve(
                ((0.16, 0.0), (0.12, 0.06), (0.11, 0.42), (0.15, 0.46), (0.11, 0.5), (0.08, 0.62), (0.0, 0.66))
            ),
            (2.75, 0.1, 2.6),
            parts.plastic((0.70, 0.42, 0.03), 0.06),
        ),
        "ball": parts.sphere((-0.7, 0.2, 2.7), 0.2, parts.plastic((0.10, 0.40, 0.16), 0.05)),
        "crate": parts.box((-3.2, 0.36, 3.1), (0.3, 0.26, 0.3), parts.diffuse((0.42, 0.26, 0.12)), 20),
    }
