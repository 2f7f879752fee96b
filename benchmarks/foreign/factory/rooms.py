"""Rooms and houses: through windows, textured, a gallery with mirrors, screens."""

import math

import numpy as np
from blender_parts import add, add_camera, add_faces, add_glow, make_material, make_sky, set_focus, set_world
from parts import add_block, add_light, add_lights, add_thing, add_turned, draw_color, make_surface, pick, spread, warm

from pictures import add_framed, add_panel, make_printed, make_screen


def add_wall(material, start, end, tall, holes=(), thick=0.15):
    """Put up a wall between two places; ``holes`` are (from, to, low, high), metres along it and above the floor."""
    start, way = np.array(start), np.array(end) - start
    length, turn = float(np.hypot(*way)), math.atan2(way[1], way[0])

    def fill(first, last, low, high):
        if last - first > 1e-3 and high - low > 1e-3:
            middle = start + way * (0.5 * (first + last) / length)
            add_block(material, (last - first, thick, high - low), (*middle, 0.5 * (low + high)), turn)

    before = 0.0
    for first, last, low, high in sorted(holes):
        fill(before, first, 0.0, tall)
        fill(first, last, 0.0, low)
        fill(first, last, high, tall)
        before = last
    fill(before, length, 0.0, tall)


def add_window(random, start, end, hole, portal):
    """Add bars, often a pane, to a hole of a wall; a portal tells Cycles where the sky's light comes in."""
    start, way = np.array(start), np.array(end) - start
    turn, length = math.atan2(way[1], way[0]), float(np.hypot(*way))
    first, last, low, high = hole
    frame = make_material("frame", pick(random, ((0.8, 0.8, 0.8), (0.03, 0.03, 0.03), (0.3, 0.18, 0.1))), Roughness=0.4)
    for along in np.linspace(first, last, int(random.integers(2, 5))):
        add_block(frame, (0.06, 0.07, high - low), (*(start + way * along / length), 0.5 * (low + high)), turn)
    middle = start + way * 0.5 * (first + last) / length
    for height in np.linspace(low, high, int(random.integers(2, 4))):
        add_block(frame, (last - first, 0.07, 0.05), (*middle, height), turn)
    if random.random() < 0.4:
        # Light passes straight through, as in most scenes of houses: no sun reaches a floor through real glass.
        pane = make_material("pane", Roughness=0.0, Alpha=0.15)
        add_block(pane, (last - first, 0.01, high - low), (*middle, 0.5 * (low + high)), turn)
    if portal:
        place = np.array([*middle, 0.5 * (low + high)])
        light = add_light(place, place + np.array([way[1], -way[0], 0.0]), 1.0, last - first)
        light.shape, light.size_y, light.cycles.is_portal = "RECTANGLE", high - low, True


def add_shell(random, wide, deep, tall, floor=("wood", "tiles", "stone"), wall=("paint", "paint", "tiles"), windows=()):
    """Put up a closed room about the origin; ``windows`` names walls that have some: 0 left, 1 back, 2 right."""
    corners = [
        (-0.5 * wide, -0.5 * deep),
        (-0.5 * wide, 0.5 * deep),
        (0.5 * wide, 0.5 * deep),
        (0.5 * wide, -0.5 * deep),
    ]
    add_block(make_surface(random, floor), (wide + 0.3, deep + 0.3, 0.1), (0.0, 0.0, -0.05))
    add_block(
        make_material("ceiling", (0.8, 0.8, 0.78), Roughness=0.9),
        (wide + 0.3, deep + 0.3, 0.1),
        (0.0, 0.0, tall + 0.05),
    )
    surface, portals = make_surface(random, wall), random.random() < 0.6
    for number in range(4):
        start, end = corners[number], corners[(number + 1) % 4]
        length, holes = float(np.hypot(*np.subtract(end, start))), []
        if number in windows:
            count = int(random.integers(1, 3))
            for middle in length * (np.arange(count) + 0.5) / count:
                half = random.uniform(0.3, 0.45) * length / count
                holes.append((middle - half, middle + half, random.uniform(0.05, 1.0), tall - random.uniform(0.2, 0.7)))
        add_wall(surface if random.random() < 0.7 else make_surface(random, wall), start, end, tall, holes)
        for hole in holes:
            add_window(random, start, end, hole, portals)


def add_table(random, place, size, tall=0.74):
    """Add a table with four legs and things on it."""
    surface, (x, y) = make_surface(random, ("wood", "stone", "plastic", "ceramic")), place
    add_block(surface, (*size, 0.05), (x, y, tall), bevel=0.01)
    leg = make_surface(random, ("wood", "metal"))
    for side, end in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        spot = (x + side * (0.5 * size[0] - 0.06), y + end * (0.5 * size[1] - 0.06), 0.5 * tall)
        add_block(leg, (0.06, 0.06, tall), spot)
    half = 0.5 * np.array(size) - 0.12
    for spot in spread(random, 4, np.array(place) - half, np.array(place) + half, 0.25):
        add_thing(random, make_surface(random), (*spot, tall + 0.025), random.uniform(0.12, 0.3))


def add_seat(random, place, turn, wide):
    """Add a chair or a sofa: seat, back, cushions or legs."""
    surface = make_surface(random, ("cloth", "cloth", "wood", "plastic"))
    ahead, aside = np.array([math.sin(turn), -math.cos(turn)]), np.array([math.cos(turn), math.sin(turn)])
    place = np.array(place)
    bevel = 0.05 if wide > 0.8 else 0.015
    add_block(surface, (wide, 0.55, 0.2 if wide > 0.8 else 0.06), (*place, 0.4), turn, bevel)
    add_block(surface, (wide, 0.14, 0.55), (*(place - 0.3 * ahead), 0.65), turn, bevel)
    leg = make_surface(random, ("wood", "metal"))
    for side, end in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        add_block(
            leg, (0.05, 0.05, 0.36), (*(place + side * (0.5 * wide - 0.05) * aside + 0.2 * end * ahead), 0.18), turn
        )
    for number in range(int(wide / 0.6) if wide > 0.8 else 0):
        spot = place + ((number + 0.5) * 0.6 - 0.5 * wide) * aside - 0.12 * ahead
        add_block(make_surface(random, ("cloth",)), (0.42, 0.16, 0.38), (*spot, 0.66), turn + 0.2, bevel=0.07)


def add_shelf(random, place, turn, wide, tall):
    """Add boards with books and a few things."""
    wood, aside = make_surface(random, ("wood", "paint")), np.array([math.cos(turn), math.sin(turn)])
    place = np.array(place)
    for side in (-0.5, 0.5):
        add_block(wood, (0.03, 0.3, tall), (*(place + side * wide * aside), 0.5 * tall), turn)
    covers = [
        make_material("cover", draw_color(random, (0.2, 0.9), (0.1, 0.8)), Roughness=random.uniform(0.3, 0.8))
        for _ in range(6)
    ]
    for height in np.arange(0.1, tall, 0.38):
        add_block(wood, (wide, 0.3, 0.025), (*place, height), turn)
        along = -0.45 * wide
        while along < 0.42 * wide:
            thick, high = random.uniform(0.02, 0.06), random.uniform(0.18, 0.3)
            if random.random() < 0.85:
                add_block(
                    pick(random, covers), (thick, 0.2, high), (*(place + along * aside), height + 0.5 * high), turn
                )
                along += thick + 0.004
            else:
                add_thing(random, make_surface(random), (*(place + (along + 0.1) * aside), height + 0.012), 0.2)
                along += 0.28


def add_lamp(random, place, tall):
    """Add a lamp on a pole with a shade."""
    add_block(make_surface(random, ("metal",)), (0.025, 0.025, tall), (*place, 0.5 * tall))
    shade = make_material("shade", (0.85, 0.78, 0.6), Roughness=0.8, Transmission_Weight=0.35)
    add_turned("shade", shade, [(0.2, tall - 0.15), (0.13, tall + 0.12)], (*place, 0.0))
    add_glow("bulb", warm(random), 60.0, 0.045, (*place, tall), 16)


def add_curtain(material, x, first, last, tall):
    """Hang a curtain with folds before a window of a side wall."""
    along = np.linspace(first, last, 90)
    plan = np.stack([x + 0.05 * np.sin(along * 38.0), along], -1)
    low, high = (np.insert(plan, 2, height, axis=1) for height in (0.05, tall - 0.1))
    add_faces("curtain", material, np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)).data.shade_smooth()


def draw_sky(random, sun, strength):
    """Put up a sky with a sun that may shine in; bounds of the exponent of its radiance, and of the sky's strength."""
    make_sky(
        10.0 ** random.uniform(*sun), random.uniform(*strength), seed=int(random.integers(1000)),
        height_deg=random.uniform(12.0, 50.0), around_deg=random.uniform(-180.0, 180.0), clear=random.uniform(0.0, 1.5),
    )  # fmt: skip


def look_into(random, wide, deep, tall):
    """Look into a room from a corner or the middle of its front wall."""
    start = (random.uniform(-0.35, 0.35) * wide, -0.5 * deep + 0.3, random.uniform(0.45, 0.65) * tall)
    add_camera(start, (-0.25 * start[0], 0.25 * deep, random.uniform(0.3, 0.5) * tall), random.uniform(52.0, 72.0))


def furnish(random, wide, deep, tall, windows):
    """Put seats, tables, shelves, lamps, pictures and a rug into a room; nothing hangs before windows of its back."""
    rug = make_surface(random, ("cloth", "check"))
    add_block(rug, (0.6 * wide, 0.45 * deep, 0.02), (0.0, 0.1 * deep, 0.01))
    add_table(
        random,
        (random.uniform(-0.1, 0.1) * wide, 0.08 * deep),
        (random.uniform(0.9, 1.4), 0.7),
        pick(random, (0.42, 0.74)),
    )
    add_seat(random, (random.uniform(-0.1, 0.1) * wide, 0.34 * deep), random.normal(0.0, 0.1), random.uniform(1.5, 2.2))
    for side in (-1.0, 1.0):
        add_seat(random, (0.3 * side * wide, random.uniform(-0.15, 0.15) * deep), side * 1.3, random.uniform(0.45, 0.9))
        if random.random() < 0.7 and 1 not in windows:
            add_shelf(random, (side * 0.38 * wide, 0.5 * deep - 0.25), 0.0, random.uniform(0.8, 1.2), 0.75 * tall)
        if random.random() < 0.4:
            cloth = make_material(
                "curtain", draw_color(random, (0.05, 0.5), (0.4, 0.9)), Roughness=0.9, Transmission_Weight=0.2
            )
            add_curtain(cloth, side * (0.5 * wide - 0.2), random.uniform(-0.1, 0.1) * deep, 0.35 * deep, tall)
    for number in range(0 if 1 in windows else 2):
        place = (random.uniform(-0.15, 0.15) * wide + 0.6 * (number - 0.5), 0.5 * deep - 0.09, 0.62 * tall)
        add_framed(
            make_printed(random), make_surface(random, ("wood", "metal")), 0.5, random.uniform(0.4, 0.7), place, 0.0
        )
    if random.random() < 0.5:
        add_light(
            (0.0, 0.0, tall - 0.05),
            (0.0, 0.0, 0.0),
            random.uniform(20.0, 120.0),
            random.uniform(0.2, 0.8),
            warm(random),
        )
    if random.random() < 0.6:
        add_lamp(random, (pick(random, (-0.3, 0.3)) * wide, 0.3 * deep), random.uniform(1.2, 1.6))


def make_room(random):
    """A furnished room that sun and sky light through windows, sometimes with a lamp."""
    wide, deep, tall = random.uniform((4.0, 4.5, 2.5), (6.0, 7.0, 3.2))
    windows = pick(random, ((0,), (1,), (2,), (0, 2), (0, 1), (1, 2)))
    add_shell(random, wide, deep, tall, windows=windows)
    furnish(random, wide, deep, tall, windows)
    draw_sky(random, (3.3, 4.3), (2.0, 6.0))
    look_into(random, wide, deep, tall)


def make_archviz(random):
    """A house outside with a terrace and a pool, or a bright textured loft."""
    if random.random() < 0.25:
        wide, deep, tall = random.uniform((6.0, 6.0, 3.0), (8.0, 8.0, 3.8))
        rough = ("tiles", "stone", "wood", "check")
        windows = pick(random, ((0, 1), (1, 2), (0, 1, 2)))
        add_shell(random, wide, deep, tall, rough, rough, windows)
        furnish(random, wide, deep, tall, windows)
        draw_sky(random, (3.0, 4.0), (3.0, 6.0))
        look_into(random, wide, deep, tall)
        return
    add("plane", make_surface(random, ("stone", "tiles", "wood")), size=60)
    for number, (x, y) in enumerate(spread(random, 5, (-5.0, 2.5), (5.0, 6.0), 2.4)):
        size = random.uniform((2.2, 1.5, 1.6), (4.0, 3.0, 4.2))
        add_block(
            make_surface(random, ("tiles", "wood", "stone", "paint")), size, (x, y, 0.5 * size[2]), 0.0, bevel=0.01
        )
        pane = make_material("pane", (0.1, 0.12, 0.13), Roughness=0.02, Metallic=0.4)
        for along in np.linspace(-0.5, 0.5, 2 + number % 3 + 2)[1:-1]:
            add_block(pane, (0.5, 0.06, 0.5 * size[2]), (x + along * size[0], y - 0.5 * size[1], 0.5 * size[2]))
        add_block(
            make_surface(random, ("wood", "stone")), (size[0] + 0.5, size[1] + 0.6, 0.12), (x, y - 0.2, size[2] + 0.06)
        )
    water = make_material("water", (0.05, 0.3, 0.35), Roughness=0.02)
    add_block(water, (random.uniform(2.0, 5.0), 1.6, 0.04), (random.uniform(-1.5, 1.5), 0.6, 0.02))
    for place in spread(random, 7, (-2.4, -1.6), (2.4, 1.8), 0.8):
        if random.random() < 0.4:
            add_seat(random, place, random.uniform(-2.0, 2.0), random.uniform(0.5, 1.6))
        else:
            add_thing(
                random, make_surface(random), (*place, 0.0), random.uniform(0.3, 0.9), ("vase", "block", "ball", "drum")
            )
    draw_sky(random, (3.0, 3.9), (1.0, 1.5))
    add_camera((random.uniform(-2.0, 2.0), -4.2, random.uniform(1.0, 1.8)), (0.0, 2.5, 1.1), random.uniform(48.0, 64.0))


def make_gallery(random):
    """A hall with pictures, mirrors and sculptures on a polished floor, below spots and lamps."""
    wide, deep, tall = random.uniform((4.5, 5.0, 2.8), (7.0, 7.0, 4.0))
    add_shell(random, wide, deep, tall, ("stone", "wood", "check", "tiles"), ("paint",))
    mirror = make_material("mirror", (0.95, 0.95, 0.95), Roughness=random.choice((0.0, 0.02)), Metallic=1.0)
    frame = make_surface(random, ("metal", "wood"))
    spots = [((along * wide, 0.5 * deep - 0.12), 0.0) for along in (-0.33, 0.0, 0.33)]
    for side in (-1.0, 1.0):
        spots += [((side * (0.5 * wide - 0.12), along * deep), -side * math.pi / 2) for along in (-0.15, 0.1, 0.33)]
    for number, (place, turn) in enumerate(spots):
        picture = mirror if number == 1 or random.random() < 0.2 else make_printed(random)
        size = random.uniform((0.7, 0.6), (1.2, 1.3))
        add_framed(picture, frame, *size, (*place, 0.5 * tall), turn)
        ahead = np.array([math.sin(turn), -math.cos(turn)])
        if random.random() < 0.8:
            add_light(
                (*(np.array(place) + 1.1 * ahead), tall - 0.15),
                (*place, 0.45 * tall),
                60.0,
                0.03,
                warm(random),
                kind="SPOT",
            )
    for place in spread(random, 5, (-0.33 * wide, -0.25 * deep), (0.33 * wide, 0.3 * deep), 0.9):
        high = random.uniform(0.4, 1.0)
        add_block(make_surface(random, ("paint", "stone")), (0.45, 0.45, high), (*place, 0.5 * high), bevel=0.01)
        add_thing(
            random,
            make_surface(random, ("metal", "ceramic", "stone", "metal")),
            (*place, high),
            random.uniform(0.4, 0.6),
        )
    add_light(
        (0.0, 0.0, tall - 0.1), (0.0, 0.0, 0.0), random.uniform(30.0, 200.0), random.uniform(0.3, 1.5), warm(random)
    )
    look_into(random, wide, deep, tall)


def add_screens(random, back):
    """Add screens on stands before a wall at y = ``back``, posters and tubes of neon on it, and keys that glow."""
    case = make_material("case", (0.03, 0.03, 0.035), Roughness=0.35)
    for place in spread(random, int(random.integers(3, 7)), (-1.3, -0.2), (1.3, back - 0.3), 0.6):
        wide, turn = random.uniform(0.5, 1.1), random.normal(0.0, 0.35)
        tall, base = wide * random.uniform(0.5, 1.3), random.uniform(0.05, 0.3)
        add_framed(
            make_screen(random, 10.0 ** random.uniform(0.0, 0.9)), case, wide, tall, (*place, base + 0.5 * tall), turn
        )
        add_block(case, (0.08, 0.2, base), (place[0], place[1] + 0.12, 0.5 * base))
    for number in range(int(random.integers(1, 4))):
        poster = make_screen(random, random.uniform(0.5, 3.0), "poster")
        add_panel(
            poster,
            random.uniform(0.6, 1.2),
            random.uniform(0.5, 1.0),
            (1.3 * number - 1.3, back - 0.02, random.uniform(1.1, 1.6)),
            (math.pi / 2, 0.0, 0.0),
        )
    for _ in range(int(random.integers(0, 4))):
        tube = make_material(
            "neon",
            (0.0, 0.0, 0.0),
            Emission_Color=(*draw_color(random, (0.6, 1.0), (0.9, 1.0)), 1.0),
            Emission_Strength=random.uniform(4.0, 15.0),
        )
        spot = (random.uniform(-1.4, 1.4), back - 0.08, random.uniform(0.5, 1.8))
        if random.random() < 0.5:
            add(
                "torus",
                tube,
                major_radius=random.uniform(0.1, 0.3),
                minor_radius=0.015,
                location=spot,
                rotation=(math.pi / 2, 0.0, 0.0),
            )
        else:
            add_block(tube, (random.uniform(0.5, 1.5), 0.03, 0.03), spot)
    keys = [case, make_screen(random, 2.0, "key")]
    x, y = random.uniform(-0.5, 0.3), -0.75
    for number in range(48):
        add_block(
            keys[int(random.random() < 0.3)],
            (0.04, 0.04, 0.02),
            (x + 0.05 * (number % 12), y + 0.05 * (number // 12), 0.02),
            bevel=0.005,
        )


def make_screens(random):
    """A desk or a shop in the dark: screens, posters that glow, tubes of neon, keys, among things that reflect them."""
    add("plane", make_surface(random, ("stone", "wood", "tiles")), size=14)
    back = random.uniform(1.2, 2.2)
    add(
        "plane",
        make_surface(random, ("paint", "tiles", "wood")),
        size=14,
        location=(0.0, back, 3.0),
        rotation=(math.pi / 2, 0.0, 0.0),
    )
    add_screens(random, back)
    for place in spread(random, 6, (-1.1, -0.6), (1.1, 0.6), 0.4):
        add_thing(random, make_surface(random), (*place, 0.0), random.uniform(0.15, 0.35))
    if random.random() < 0.5:
        add_lights(random, np.array([0.0, 0.0, 0.4]), 2.5, 1, 3.0)
    set_world((0.3, 0.4, 0.6), 10.0 ** random.uniform(-2.5, -0.7))
    far = random.uniform(2.2, 3.0)
    add_camera(
        (random.uniform(-0.7, 0.7), -far, random.uniform(0.6, 1.3)), (0.0, 0.3, 0.45), random.uniform(42.0, 54.0)
    )
    if random.random() < 0.25:
        set_focus(far, 10.0 ** random.uniform(-0.6, 0.2))
