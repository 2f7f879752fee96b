"""What guides say little about: thin things, thin air, lamps out of focus."""

import math

import numpy as np
from blender_parts import add, add_air, add_camera, add_faces, add_glow, make_material, set_focus, set_world
from parts import add_block, add_light, add_lights, add_thing, draw_color, make_surface, pick, spread, warm
from tables import light_and_shoot, set_table


def add_ribbons(random, material, starts, ways, lengths, width, curl):
    """Add ribbons that leave places (count, 3) along ways (count, 3) and curl; each is six quadrangles."""
    ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    bend = np.cross(ways, random.normal(size=ways.shape))
    aside = width * bend / np.linalg.norm(bend, axis=1, keepdims=True)
    far = np.linspace(0.0, 1.0, 7)[:, None, None]
    turn = np.cross(ways, aside / width) * curl * random.uniform(0.2, 1.0, (len(ways), 1))
    spine = starts + lengths.reshape(-1, 1) * far * (ways + far * turn)
    thin = aside * (1.0 - 0.85 * far)
    corners = np.stack(
        [spine[:-1] - thin[:-1], spine[:-1] + thin[:-1], spine[1:] + thin[1:], spine[1:] - thin[1:]], axis=2
    )
    return add_faces("ribbons", material, corners.reshape(-1, 4, 3))


def add_brush(random, place, size):
    """Add a round brush that stands on its handle, or a broom's head on its bristles."""
    handle = make_surface(random, ("wood", "plastic", "metal"))
    tall = size * random.uniform(0.6, 1.0)
    add("cylinder", handle, radius=0.09 * size, depth=tall, location=(*place, 0.5 * tall), vertices=32)
    bristle, count = make_surface(random, ("plastic", "cloth", "metal")), int(random.integers(500, 1500))
    starts = np.array([*place, tall]) + random.normal(0.0, 0.05 * size, (count, 3)) * (1.0, 1.0, 0.2)
    ways = random.normal((0.0, 0.0, 1.0), random.uniform(0.15, 0.5), (count, 3))
    add_ribbons(random, bristle, starts, ways, size * random.uniform(0.4, 0.7, count), 0.004 * size, 0.3)


def add_frond(random, place, size):
    """Add a pot with long narrow strips that arch out of it, of paper, cloth or metal foil."""
    pot = make_surface(random, ("ceramic", "stone", "metal"))
    high = 0.35 * size
    add("cylinder", pot, radius=0.28 * size, depth=high, location=(*place, 0.5 * high), vertices=64)
    strip = make_material(
        "strip", draw_color(random), Roughness=random.uniform(0.15, 0.7), Metallic=pick(random, (0.0, 0.0, 1.0))
    )
    count = int(random.integers(60, 300))
    around = random.uniform(0.0, 2.0 * math.pi, count)
    ways = np.stack([np.cos(around), np.sin(around), random.uniform(0.8, 3.0, count)], -1)
    starts = np.array([*place, high]) + 0.15 * size * random.normal(size=(count, 3)) * (1.0, 1.0, 0.0)
    add_ribbons(random, strip, starts, ways, size * random.uniform(0.6, 1.2, count), 0.012 * size, 0.8)


def add_net(random, place, size):
    """Add a standing frame with a net of wires."""
    wire, turn = make_surface(random, ("metal", "plastic")), random.uniform(-0.9, 0.9)
    count, thick = int(random.integers(9, 26)), size * 10.0 ** random.uniform(-2.6, -1.9)
    along = np.array([math.cos(turn), math.sin(turn)])
    for step in np.linspace(-0.5, 0.5, count):
        add_block(wire, (thick, thick, size), (*(place + step * size * along), 0.5 * size), turn)
        add_block(wire, (size, thick, thick), (*place, (step + 0.5) * size), turn)


def make_bristles(random):
    """Brushes, strips in pots and nets before a wall, often out of focus."""
    set_table(random)
    for place in spread(random, 7, (-1.0, -0.8), (1.0, 1.0), 0.42):
        pick(random, (add_brush, add_frond, add_frond, add_net))(random, place, random.uniform(0.35, 0.7))
    for place in spread(random, 3, (-1.0, -0.9), (1.0, 0.6), 0.5):
        add_thing(random, make_surface(random), (*place, 0.0), random.uniform(0.2, 0.35))
    light_and_shoot(random, 0.35, blur=0.5)


def make_steam(random):
    """A table under a cloud of steam or smoke, with lamps in it or a beam through it."""
    set_table(random)
    for place in spread(random, 6, (-1.1, -0.9), (1.1, 1.1), 0.5):
        add_thing(random, make_surface(random), (*place, 0.0), random.uniform(0.3, 0.7))
    for _ in range(int(random.integers(1, 4))):
        size = random.uniform(1.2, 5.0)
        middle = random.uniform((-0.8, -0.4, 0.3 * size), (0.8, 0.9, 0.5 * size))
        add_air(10.0 ** random.uniform(-1.5, -0.2), size, middle, random.uniform(-0.2, 0.7))
    for number, spot in enumerate(spread(random, int(random.integers(0, 4)), (-1.2, -0.2), (1.2, 1.3), 0.6)):
        tint, strength = warm(random), 10.0 ** random.uniform(1.0, 1.8)
        add_glow(f"lamp{number}", tint, strength, random.uniform(0.02, 0.06), (*spot, random.uniform(0.2, 1.0)), 24)
    if random.random() < 0.6:
        start = random.uniform((-2.5, -0.5, 1.5), (2.5, 1.4, 3.0))
        add_light(start, (0.0, 0.2, 0.3), random.uniform(100.0, 600.0), 0.05, warm(random), kind="SPOT")
    light_and_shoot(random, 0.4, far=(2.2, 3.2), blur=0.2, power=30.0)


def make_party(random):
    """Things on a table, and behind and before them many small lamps, which an open lens blurs."""
    add("plane", make_surface(random, ("wood", "stone", "tiles", "cloth")), size=16)
    for place in spread(random, 5, (-0.9, -0.6), (0.9, 0.6), 0.5):
        add_thing(random, make_surface(random), (*place, 0.0), random.uniform(0.3, 0.6))
    tints = [warm(random) if random.random() < 0.6 else draw_color(random, (0.6, 1.0), (0.8, 1.0)) for _ in range(4)]
    count, strength = int(random.integers(12, 60)), 10.0 ** random.uniform(1.0, 2.3)
    for number, place in enumerate(random.uniform((-4.0, 1.5, 0.1), (4.0, 7.0, 3.2), (count, 3))):
        add_glow(f"lamp{number}", pick(random, tints), strength, 0.01 + 0.03 * random.uniform() ** 2, place, 12)
    for number, place in enumerate(random.uniform((-1.2, -1.6, 0.05), (1.2, -0.9, 0.9), (int(random.integers(6)), 3))):
        add_glow(f"near{number}", pick(random, tints), 0.3 * strength, 0.008, place, 12)
    back = make_surface(random, ("paint", "tiles", "stone"))
    add("plane", back, size=20, location=(0.0, 8.0, 3.0), rotation=(math.pi / 2, 0.0, 0.0))
    add_lights(random, np.array([0.0, 0.0, 0.3]), 2.6, int(random.integers(0, 3)), 15.0)
    set_world(warm(random), 10.0 ** random.uniform(-2.2, -0.8))
    far = random.uniform(2.0, 3.0)
    add_camera(
        (random.uniform(-0.6, 0.6), -far, random.uniform(0.4, 1.1)), (0.0, 0.0, 0.35), random.uniform(32.0, 48.0)
    )
    if random.random() < 0.8:
        set_focus(far * random.uniform(0.9, 1.3), 10.0 ** random.uniform(-1.6, -0.4))
