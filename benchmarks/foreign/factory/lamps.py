"""Many small lamps: a street at night, lamps out of focus. Validation alone."""

import math

import numpy as np
from blender_parts import (
    TINTS,
    add,
    add_camera,
    add_faces,
    add_glow,
    add_lamps,
    make_image,
    make_material,
    put_texture,
    set_focus,
    set_world,
)
from parts import add_block, add_lights, add_thing, add_turned, draw_color, make_surface, pick, put_image, spread, warm


def add_string(start, end, count, sag, radius, strength):
    """Hang small lamps of several colors on a wire between two places."""
    along = np.linspace(0.0, 1.0, count)[:, None]
    places = (
        np.array(start) * (1.0 - along) + np.array(end) * along - sag * 4.0 * along * (1.0 - along) * (0.0, 0.0, 1.0)
    )
    first, second, up = places[:-1], places[1:], np.array([0.0, 0.0, 0.006])
    wire = make_material("wire", (0.02, 0.03, 0.02), Roughness=0.5)
    add_faces("wire", wire, np.stack([first - up, second - up, second + up, first + up], axis=1))
    return add_lamps(places[1:-1] - (0.0, 0.0, 1.5 * radius), radius, strength)


def make_facade(random, rows, columns):
    """Return two materials' images: a wall with windows, and the light of those that are lit."""
    cell = 12
    wall = np.array(draw_color(random, (0.1, 0.5), (0.1, 0.5)))
    color = np.broadcast_to(wall, (rows * cell, columns * cell, 3)) * random.uniform(
        0.8, 1.0, (rows * cell, columns * cell, 1)
    )
    glow = np.zeros_like(color)
    for row in range(rows):
        for column in range(columns):
            window = np.s_[row * cell + 3 : row * cell + 10, column * cell + 3 : column * cell + 9]
            color[window] = 0.03
            if random.random() < 0.4:
                curtain = random.uniform(0.5, 1.0, (7, 1, 1)) * random.uniform(0.3, 1.0, (1, 6, 1))
                glow[window] = random.uniform(0.4, 3.0) * curtain * np.array(warm(random))
            color[row * cell + 6, column * cell + 3 : column * cell + 9] = wall
    return make_image("facade", color), make_image("windows", glow)


def add_house(random, side, near, wide, tall):
    """Put a house with a facade beside the street; a sign glows above its door."""
    away = 3.6
    rows, columns = max(2, int(tall / 1.6)), max(2, int(wide / 1.4))
    facade, windows = make_facade(random, rows, columns)
    material = put_image(
        put_image(make_material("house", Roughness=0.7, Emission_Strength=1.0), facade), windows, "Emission Color"
    )
    middle = near + 0.5 * wide
    front = add(
        "plane",
        material,
        size=1.0,
        location=(side * away, middle, 0.5 * tall),
        rotation=(math.pi / 2, 0.0, -side * math.pi / 2),
    )
    front.scale = (wide, tall, 1.0)
    add_block(
        make_material("side", (0.15, 0.14, 0.13), Roughness=0.9),
        (3.0, wide, tall),
        (side * (away + 1.52), middle, 0.5 * tall),
    )
    if random.random() < 0.7:
        sign = make_material(
            "sign",
            (0.0, 0.0, 0.0),
            Emission_Color=(*draw_color(random, (0.6, 1.0), (0.8, 1.0)), 1.0),
            Emission_Strength=6.0,
        )
        add_block(
            sign,
            (0.06, random.uniform(0.4, 0.8) * wide, 0.18),
            (side * (away - 0.12), middle, random.uniform(2.2, 3.0)),
        )
    shop = make_material("shop", (0.0, 0.0, 0.0), Emission_Color=(*warm(random), 1.0), Emission_Strength=2.0)
    add_block(shop, (0.04, 0.45 * wide, 1.2), (side * (away - 0.03), middle, 1.1))


def add_car(random, place, turn, size=1.0):
    """Park a car: body, cabin, wheels, lit lamps in front and behind."""
    x, y = place
    paint = make_surface(random, ("ceramic",))
    window = make_material("pane", (0.02, 0.02, 0.03), Roughness=0.05)
    tyre = make_material("tyre", (0.02, 0.02, 0.02), Roughness=0.8)
    add_block(paint, (1.5, 3.4, 0.55), (x, y, 0.5), turn, bevel=0.15)
    add_block(window, (1.3, 1.8, 0.5), (x, y + 0.1, 0.98), turn, bevel=0.18)
    for side in (-1.0, 1.0):
        for along in (-1.1, 1.1):
            add(
                "cylinder",
                tyre,
                radius=0.3,
                depth=0.2,
                location=(x + 0.68 * side, y + along, 0.3),
                rotation=(0.0, math.pi / 2, 0.0),
            )
        add_glow("tail", (1.0, 0.05, 0.03), 25.0, 0.07, (x + 0.55 * side, y - 1.7, 0.6), 12)
        add_glow("head", (1.0, 0.95, 0.8), 40.0, 0.08, (x + 0.55 * side, y + 1.7, 0.55), 12)


def add_walker(random, place):
    """Put a person in a coat on the street."""
    cloth = make_surface(random, ("cloth", "paint"))
    tall = random.uniform(1.5, 1.85)
    profile = tall * np.array(
        [(0.0, 0.0), (0.1, 0.0), (0.12, 0.4), (0.14, 0.6), (0.13, 0.75), (0.04, 0.83), (0.0, 0.84)]
    )
    add_turned("walker", cloth, profile, (*place, 0.0), 24).scale = (1.2, 0.8, 1.0)
    skin = make_material("skin", (0.6, 0.4, 0.3), Roughness=0.5)
    add("uv_sphere", skin, radius=0.075 * tall, location=(*place, 0.92 * tall), segments=24, ring_count=12)


def make_street(random):
    """A street at night: wet ground, lit windows, signs, strings of lamps, cars, people; in focus or not."""
    asphalt = make_material("asphalt", Roughness=0.3)
    put_texture(
        asphalt, "Noise", "Base Color", scale=3.0, colors=((0.08, 0.08, 0.085), (0.02, 0.02, 0.022)), Detail=8.0
    )
    put_texture(
        asphalt,
        "Noise",
        "Roughness",
        scale=random.uniform(0.4, 1.2),
        low=random.uniform(0.0, 0.2),
        high=random.uniform(0.4, 0.8),
    )
    put_texture(asphalt, "Noise", "Normal", scale=30.0, bump=0.12)
    add("plane", asphalt, size=120)
    for side in (-1.0, 1.0):
        near = random.uniform(-1.0, 1.5)
        while near < 24.0:
            wide = random.uniform(3.0, 6.5)
            add_house(random, side, near, wide, random.uniform(4.0, 10.0))
            near += wide + random.uniform(0.0, 0.6)
        add_block(make_surface(random, ("tiles", "stone")), (1.2, 60.0, 0.12), (3.0 * side, 20.0, 0.06))
        pole = make_material("pole", (0.05, 0.06, 0.05), Roughness=0.4)
        for number in range(6):
            y = 1.5 + 3.6 * number + random.uniform(-0.4, 0.4)
            add("cylinder", pole, radius=0.05, depth=3.4, location=(2.5 * side, y, 1.7), vertices=16)
            add_glow("lantern", warm(random), 30.0, 0.13, (2.5 * side, y, 3.5), 20)
    for number in range(int(random.integers(3, 8))):
        y = 2.0 + 2.2 * number + random.uniform(-0.5, 0.5)
        ends = random.uniform((2.6, y - 0.6, 2.8), (3.5, y + 0.6, 4.2), (2, 3))
        add_string(
            ends[0] * (-1.0, 1.0, 1.0),
            ends[1],
            int(random.integers(10, 22)),
            random.uniform(0.3, 0.9),
            0.035,
            random.uniform(8.0, 25.0),
        )
    for place in spread(random, int(random.integers(2, 5)), (-1.4, 2.5), (1.4, 16.0), 3.8):
        add_car(random, place, 0.0)
    for place in spread(random, int(random.integers(3, 9)), (-2.8, 0.0), (2.8, 9.0), 0.6):
        add_walker(random, place)
    near = spread(random, 2, (-0.9, -1.9), (0.9, -1.2), 0.7)
    for place in near:
        crate = make_surface(random, ("wood", "stone", "metal"))
        high = random.uniform(0.5, 1.0)
        add_block(crate, (0.5, 0.5, high), (*place, 0.5 * high), random.uniform(0.0, 3.0), bevel=0.02)
        add_thing(random, make_surface(random), (*place, high), random.uniform(0.25, 0.45))
    set_world((0.1, 0.15, 0.35), random.uniform(0.02, 0.15))
    add_camera(
        (random.uniform(-0.8, 0.8), -4.2, random.uniform(1.2, 1.8)),
        (random.uniform(-0.4, 0.4), 4.0, 1.5),
        random.uniform(45.0, 60.0),
    )
    if random.random() < 0.5:
        set_focus(pick(random, (2.6, 6.0)), 10.0 ** random.uniform(-1.0, -0.3))


def make_bokeh(random):
    """A few things on a table, sharp; behind and before them lamps out of focus, on strings, on a tree, in a town."""
    add("plane", make_surface(random, ("wood", "cloth", "stone", "tiles")), size=3.0, location=(0.0, -0.6, 0.0))
    back = make_surface(random, ("paint", "tiles", "stone"))
    deep = random.uniform(4.0, 9.0)
    add("plane", back, size=40.0, location=(0.0, deep + 1.0, 0.0), rotation=(math.pi / 2, 0.0, 0.0))
    add("plane", make_surface(random, ("stone", "wood")), size=40.0, location=(0.0, 10.0, -1.0))
    place = pick(random, ("strings", "tree", "town"))
    if place == "strings":
        for number in range(int(random.integers(4, 8))):
            y, z = random.uniform(0.5 * deep, deep), -0.5 + 0.55 * number
            add_string(
                (-0.7 * deep, y, z),
                (0.7 * deep, y, z + random.normal(0.0, 0.3)),
                int(random.integers(8, 18)),
                random.uniform(0.1, 0.5),
                0.03,
                80.0,
            )
    elif place == "tree":
        needles = make_material("needles", (0.03, 0.12, 0.04), Roughness=0.6)
        add(
            "cone", needles, radius1=0.3 * deep, depth=0.75 * deep, location=(0.2 * deep, deep, 0.2 * deep), vertices=48
        )
        turns, up = random.uniform(0.0, 2.0 * math.pi, 90), random.uniform(0.0, 1.0, 90) ** 1.5
        reach = 0.31 * deep * (1.0 - up)
        spots = np.stack(
            [0.2 * deep + reach * np.cos(turns), deep - reach * np.abs(np.sin(turns)), deep * (0.75 * up - 0.18)], -1
        )
        add_lamps(spots, 0.035, 60.0)
    else:
        for spot in random.uniform((-0.7 * deep, 0.4 * deep, -0.6), (0.7 * deep, deep, 0.35 * deep), (55, 3)):
            tint = pick(random, (*TINTS, TINTS[0], TINTS[4]))
            add_glow("far", tint, 10.0 ** random.uniform(1.0, 2.2), random.uniform(0.02, 0.06), spot, 10)
    for spot in spread(random, int(random.integers(3, 6)), (-0.75, -0.9), (0.75, 0.1), 0.4):
        add_thing(random, make_surface(random), (*spot, 0.0), random.uniform(0.3, 0.55))
    if random.random() < 0.5:
        add_string((-1.2, -1.5, 0.25), (1.2, -1.3, random.uniform(0.2, 0.7)), 8, 0.1, 0.012, 60.0)
    add_lights(random, np.array([0.0, -0.4, 0.3]), 2.0, int(random.integers(1, 3)), 8.0)
    set_world((0.3, 0.4, 0.7), random.uniform(0.01, 0.08))
    far = random.uniform(1.7, 2.4)
    add_camera(
        (random.uniform(-0.3, 0.3), -0.4 - far, random.uniform(0.35, 0.8)), (0.0, 0.0, 0.35), random.uniform(34.0, 46.0)
    )
    set_focus(far, 10.0 ** random.uniform(-0.9, -0.1))
