"""Rooms full of textures, for films: validation alone."""

import math

import numpy as np
from blender_parts import add, add_camera, make_material, set_world
from parts import add_block, add_lights, add_thing, make_surface, pick, spread

from pictures import add_panel, make_printed


def make_tiles(random):
    """A corner with a tiled floor and printed walls, a mirror, and textured things on the floor."""
    add("plane", make_surface(random, ("check", "tiles", "wood")), size=12)
    back, side = random.uniform(1.4, 2.2), random.uniform(1.6, 2.4)
    wall = make_surface(random, ("tiles", "check", "stone"))
    add("plane", wall, size=12, location=(0.0, back, 3.0), rotation=(math.pi / 2, 0.0, 0.0))
    add("plane", make_printed(random), size=6, location=(-side, -0.5, 2.0), rotation=(math.pi / 2, 0.0, math.pi / 2))
    for along in (-0.9, 0.5):
        size = random.uniform((0.7, 0.5), (1.1, 0.9))
        place = along + random.uniform(-0.2, 0.2), back - 0.03, random.uniform(0.9, 1.3)
        add_panel(make_printed(random), *size, place, (math.pi / 2, 0.0, 0.0))
    mirror = make_material("mirror", (0.95, 0.95, 0.95), Roughness=pick(random, (0.0, 0.03, 0.1)), Metallic=1.0)
    for number, place in enumerate(spread(random, 5, (-1.1, -0.7), (1.1, 0.9), 0.55)):
        size = random.uniform(0.3, 0.55)
        if number == 0:
            add_block(mirror, (size, 0.04, 1.4 * size), (*place, 0.7 * size), random.uniform(-0.7, 0.7), bevel=0.01)
        elif number == 1:
            add_block(make_printed(random), (size,) * 3, (*place, 0.5 * size), random.uniform(0.0, 1.5), bevel=0.01)
        else:
            surface = make_surface(random, ("check", "tiles", "stone", "cloth", "metal"))
            add_thing(random, surface, (*place, 0.0), size, ("ball", "block", "vase", "drum"))
    add_lights(random, np.array([0.0, 0.0, 0.4]), 2.5, int(random.integers(1, 4)), 30.0)
    set_world((0.5, 0.6, 0.8), random.uniform(0.1, 0.6))
    far = random.uniform(2.4, 3.2)
    add_camera((random.uniform(-0.6, 0.8), -far, random.uniform(0.8, 1.5)), (0.0, 0.3, 0.5), random.uniform(40.0, 54.0))
