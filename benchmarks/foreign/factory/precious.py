"""Things on a table: jewels (validation alone)."""

import math

import numpy as np
from blender_parts import add, add_camera, make_material, make_sky, put_texture, set_focus, set_world
from parts import (
    METALS,
    add_block,
    add_light,
    add_lights,
    add_thing,
    add_turned,
    draw_color,
    make_surface,
    pick,
    spread,
    warm,
)

GEM = ((0.0, 0.0), (0.5, 0.43), (0.5, 0.46), (0.28, 0.62), (0.0, 0.62))
"""Profile of a brilliant of diameter 1: point, girdle, table."""


def make_velvet(random, name="velvet"):
    """Return a cloth with sheen and fine bumps."""
    color = draw_color(random, (0.5, 0.95), (0.03, 0.35))
    material = make_material(
        name, color, Roughness=0.95, Sheen_Weight=random.uniform(0.6, 1.0), Sheen_Roughness=random.uniform(0.2, 0.5)
    )
    material.node_tree.nodes["Principled BSDF"].inputs["Sheen Tint"].default_value = (
        *draw_color(random, (0.1, 0.7), (0.6, 1.0)),
        1.0,
    )
    put_texture(material, "Noise", "Normal", scale=random.uniform(40.0, 120.0), bump=random.uniform(0.2, 0.6))
    return material


def add_gem(random, place, size, turn=(0.0, 0.0, 0.0)):
    """Add a cut gem, clear or colored."""
    color = (1.0, 1.0, 1.0) if random.random() < 0.4 else draw_color(random, (0.5, 0.95), (0.7, 1.0))
    gem = make_material("gem", color, Roughness=0.0, Transmission_Weight=1.0, IOR=random.uniform(1.6, 2.4))
    thing = add_turned("gem", gem, size * np.array(GEM), place, segments=pick(random, (6, 8, 8, 12, 16)), smooth=False)
    thing.rotation_euler = turn
    return thing


def add_finger_ring(random, place, size):
    """Add a ring that lies or stands, with a gem and small ones beside it."""
    gold = make_material("gold", pick(random, METALS), Roughness=random.uniform(0.03, 0.25), Metallic=1.0)
    x, y, z = place
    around = random.uniform(0.0, 3.0)
    thin = 0.09 * size
    turn = (math.pi / 2, 0.0, around)
    add("torus", gold, major_radius=0.5 * size, minor_radius=thin, location=(x, y, z + 0.5 * size), rotation=turn,
        major_segments=96, minor_segments=24)  # fmt: skip
    top = z + size + 0.5 * thin
    add("cylinder", gold, radius=0.22 * size, depth=0.12 * size, location=(x, y, top), vertices=48)
    add_gem(random, (x, y, top - 0.05 * size), 0.6 * size)
    for number in range(-2, 3):
        if number:
            lean = 0.45 * number
            at = (
                x + 0.6 * size * math.sin(lean) * math.cos(around),
                y + 0.6 * size * math.sin(lean) * math.sin(around),
            )
            add_gem(random, (*at, z + 0.5 * size + 0.52 * size * math.cos(lean)), 0.16 * size)


def add_necklace(random, kind):
    """Lay a string of pearls or a chain of links along a closed curve."""
    count = 44 if kind == "pearls" else 60
    turns = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    reach = (
        0.8 + 0.15 * np.sin(turns * 3 + random.uniform(0.0, 6.0)) + 0.1 * np.sin(2 * turns + random.uniform(0.0, 6.0))
    )
    places = np.stack([reach * np.cos(turns), 0.75 * reach * np.sin(turns)], -1) + random.normal(0.0, 0.15, 2)
    if kind == "pearls":
        coat = {"Coat_Weight": 1.0, "Coat_Roughness": 0.08, "Thin_Film_Thickness": random.uniform(250.0, 500.0)}
        pearl = make_material("pearl", random.uniform(0.6, 0.95, 3), Roughness=0.25, Subsurface_Weight=0.3, **coat)
    else:
        pearl = make_material("link", pick(random, METALS), Roughness=0.12, Metallic=1.0)
    gaps = np.linalg.norm(np.roll(places, -1, 0) - places, axis=1)
    for number, (place, gap) in enumerate(zip(places, gaps, strict=True)):
        if kind == "pearls":
            size = 0.48 * min(gap, gaps[number - 1])
            add("uv_sphere", pearl, radius=size, location=(*place, size), segments=32, ring_count=16)
        else:
            ahead = places[(number + 1) % count] - place
            turn = (math.pi / 2 * (number % 2), 0.0, math.atan2(ahead[1], ahead[0]))
            add("torus", pearl, major_radius=0.5 * gap, minor_radius=0.14 * gap, location=(*place, 0.35 * gap),
                rotation=turn, major_segments=24, minor_segments=10)  # fmt: skip


def make_jewels(random):
    """Gems, rings, pearls and chains on velvet, below small strong lamps; a box, a mirror or marble beside them."""
    add("plane", make_velvet(random) if random.random() < 0.7 else make_surface(random, ("stone", "wood")), size=12)
    add(
        "plane",
        make_surface(random, ("paint", "cloth", "wood")),
        size=12,
        location=(0.0, 3.0, 3.0),
        rotation=(math.pi / 2, 0.0, 0.0),
    )
    box = make_velvet(random, "cushion")
    for place in spread(random, 3, (-1.3, 0.3), (1.3, 1.7), 0.8):
        add_block(box, (0.7, 0.6, random.uniform(0.15, 0.6)), (*place, 0.1), random.uniform(0.0, 3.0), bevel=0.08)
    for kind in pick(random, (("pearls",), ("pearls",), ("chain",), ("pearls", "chain"))):
        add_necklace(random, kind)
    for place in spread(random, 14, (-1.0, -1.1), (1.0, 0.9), 0.3):
        size = random.uniform(0.18, 0.4)
        if random.random() < 0.4:
            add_finger_ring(random, (*place, 0.0), size)
        else:
            add_gem(
                random,
                (*place, 0.12 * size),
                size,
                (0.55 if random.random() < 0.7 else 3.14, 0.0, random.uniform(0.0, 6.0)),
            )
    for place in spread(random, 3, (-1.2, 0.2), (1.2, 1.4), 0.6):
        add_thing(
            random,
            make_surface(random, ("metal", "ceramic", "stone")),
            (*place, 0.0),
            random.uniform(0.3, 0.6),
            ("vase", "ball", "ring", "drum"),
        )
    target = np.array([0.0, 0.0, 0.2])
    add_lights(random, target, 2.5, 1, 30.0)
    for _ in range(int(random.integers(2, 5))):
        add_light(
            random.uniform((-1.8, -1.5, 1.4), (1.8, 1.5, 2.6)), target, 40.0, random.uniform(0.03, 0.15), warm(random)
        )
    if random.random() < 0.5:
        make_sky(0.0, random.uniform(0.1, 0.5), seed=int(random.integers(1000)))
    else:
        set_world((0.5, 0.55, 0.7), random.uniform(0.02, 0.2))
    far = random.uniform(1.7, 2.5)
    add_camera((random.uniform(-0.5, 0.5), -far, random.uniform(0.8, 1.3)), target, random.uniform(36.0, 46.0))
    if random.random() < 0.4:
        set_focus(far, 10.0 ** random.uniform(-0.6, 0.4))
