"""Things behind glass or out of focus: rooms with windows, print below glass, small things. Validation alone."""

import math

import numpy as np
from blender_parts import add, add_camera, add_glow, make_image, make_material, make_sky, set_focus, set_world
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
    put_image,
    spread,
    warm,
)
from rooms import add_seat, add_table, add_wall

from pictures import draw_picture

PAGE_ROWS, PAGE_COLUMNS = 192, 144


def make_clear(random, name, rough=0.0, tint=(1.0, 1.0, 1.0)):
    """Return glass."""
    return make_material(name, tint, Roughness=rough, Transmission_Weight=1.0, IOR=random.uniform(1.45, 1.55))


def make_pane(random, is_clear):
    """Return glass of windows; ``is_clear`` lets shadow rays pass, as is usual for houses, so that the sun comes in."""
    pane = make_clear(random, "pane", tint=pick(random, ((1.0, 1.0, 1.0), (0.9, 0.98, 0.94))))
    if is_clear:
        tree = pane.node_tree
        path, mix = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMixShader")
        tree.links.new(path.outputs["Is Shadow Ray"], mix.inputs["Fac"])
        tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[1])
        tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return pane


def glaze(random, wide, y, tall, frame, pane):
    """Put up a wall with windows along x at a depth, with frames, bars, panes and portals."""
    count, low, high = int(random.integers(1, 4)), pick(random, (0.05, 0.7)), tall - random.uniform(0.2, 0.5)
    middles = wide * (np.arange(count) + 0.5) / count
    half = random.uniform(0.34, 0.44) * wide / count
    holes = [(middle - half, middle + half, low, high) for middle in middles]
    add_wall(make_surface(random, ("paint", "tiles")), (-0.5 * wide, y), (0.5 * wide, y), tall, holes)
    for middle in middles - 0.5 * wide:
        add_block(pane, (2.0 * half, 0.008, high - low), (middle, y, 0.5 * (low + high)))
        for along in np.linspace(-half, half, int(random.integers(2, 5))):
            add_block(frame, (0.06, 0.09, high - low), (middle + along, y, 0.5 * (low + high)))
        for height in np.linspace(low, high, int(random.integers(2, 5))):
            add_block(frame, (2.0 * half, 0.08, 0.05), (middle, y, height))
        light = add_light((middle, y + 0.02, 0.5 * (low + high)), (middle, -y, 0.5 * (low + high)), 1.0, 2.0 * half)
        light.shape, light.size_y, light.cycles.is_portal = "RECTANGLE", high - low, True


def make_windows(random):
    """A room with a polished floor, seen against the panes of its windows, through which all of its light comes."""
    wide, deep, tall = random.uniform((3.8, 4.2, 2.5), (5.5, 6.0, 3.2))
    floor = make_surface(random, ("wood", "tiles", "stone", "check"))
    for socket in floor.node_tree.nodes["Principled BSDF"].inputs:
        if socket.name == "Coat Weight":
            socket.default_value = 1.0
        elif socket.name == "Coat Roughness":
            socket.default_value = random.uniform(0.02, 0.15)
    add_block(floor, (wide, deep, 0.1), (0.0, 0.0, -0.05))
    white = make_material("white", (0.8, 0.79, 0.76), Roughness=0.9)
    add_block(white, (wide + 0.3, deep + 0.3, 0.1), (0.0, 0.0, tall + 0.05))
    for side in (-1.0, 1.0):
        start, end = (side * 0.5 * wide, -0.5 * deep), (side * 0.5 * wide, 0.5 * deep)
        add_wall(make_surface(random, ("paint", "paint", "wood")), start, end, tall)
    add_wall(white, (-0.5 * wide, -0.5 * deep), (0.5 * wide, -0.5 * deep), tall)
    is_clear = bool(random.random() < 0.6)
    frame = make_material("frame", pick(random, ((0.8, 0.8, 0.8), (0.03, 0.03, 0.03), (0.3, 0.18, 0.1))), Roughness=0.4)
    glaze(random, wide, 0.5 * deep, tall, frame, make_pane(random, is_clear))
    add_table(
        random, (random.uniform(-0.6, 0.6), 0.1 * deep), (random.uniform(0.8, 1.3), 0.7), pick(random, (0.42, 0.74))
    )
    for side in (-1.0, 1.0):
        add_seat(random, (side * 0.3 * wide, random.uniform(-0.1, 0.3) * deep), side * 1.3, random.uniform(0.45, 1.4))
    for place in spread(random, 5, (-0.4 * wide, -0.25 * deep), (0.4 * wide, 0.4 * deep), 0.7):
        material = make_clear(random, "vase") if random.random() < 0.3 else make_surface(random)
        add_thing(random, material, (*place, 0.001), random.uniform(0.2, 0.45))
    add("plane", make_surface(random, ("stone", "paint")), size=80, location=(0.0, 0.0, -0.5))
    make_sky(
        10.0 ** random.uniform(3.0, 4.0) if is_clear else 0.0, random.uniform(2.0, 5.0),
        seed=int(random.integers(1000)), height_deg=random.uniform(15.0, 40.0),
        around_deg=random.uniform(-130.0, -50.0), clear=random.uniform(0.0, 1.5),
    )  # fmt: skip
    start = (random.uniform(-0.3, 0.3) * wide, -0.5 * deep + 0.3, random.uniform(1.1, 1.6))
    add_camera(start, (-0.2 * start[0], 0.3 * deep, random.uniform(0.7, 1.1)), random.uniform(55.0, 72.0))


def refine(profile):
    """Return a profile with many points on each line, so that smooth shading rounds nothing but its corners."""
    corners = np.array(profile)
    along = np.linspace(0.0, len(corners) - 1.0, 32 * (len(corners) - 1) + 1)
    return np.stack([np.interp(along, np.arange(len(corners)), each) for each in corners.T], -1)


def make_page(random):
    """Return paper with columns of what looks like small print, headings, a picture or a table of lines."""
    page = np.full((PAGE_ROWS, PAGE_COLUMNS, 3), 0.8) * np.array(pick(random, ((1.0, 1.0, 1.0), (1.0, 0.95, 0.82))))
    step, columns = int(random.integers(4, 8)), int(random.integers(1, 4))
    wide = (PAGE_COLUMNS - 12) // columns
    for column in range(columns):
        left = 8 + column * wide
        for row in range(8, PAGE_ROWS - 10, step):
            letters = (random.random(wide - 6) < 0.65) & np.repeat(random.random(wide) < 0.85, 4)[: wide - 6]
            tall, end = (
                max(2, step // 2),
                int((wide - 6) * (1.0 if random.random() < 0.8 else random.uniform(0.2, 1.0))),
            )
            page[row : row + tall, left : left + end][:, letters[:end]] = random.uniform(0.02, 0.1)
    if random.random() < 0.8:
        top, left = int(random.integers(8, 90)), int(random.integers(4, 40))
        picture = draw_picture(random)[: PAGE_ROWS - top, : PAGE_COLUMNS - left - 6]
        page[top : top + len(picture), left : left + picture.shape[1]] = picture
    head = int(random.integers(3, 9))
    page[-head - 8 : -8, 8 : 8 + int(random.integers(40, 130))] = draw_color(random, (0.2, 1.0), (0.02, 0.4))
    return put_image(make_material("page", Roughness=random.uniform(0.25, 0.8)), make_image("page", page))


def add_pages(random, count):
    """Lay pages over each other."""
    for number in range(count):
        place = (*random.uniform((-0.5, -0.4), (0.5, 0.5)), 0.004 * (number + 1))
        page = add("plane", make_page(random), size=1.0, location=place, rotation=(0.0, 0.0, random.normal(0.0, 0.5)))
        page.scale = (0.9, 1.2, 1.0)


def make_print(random):
    """Printed pages that a ball, blocks, a tumbler and slabs of glass, clear and frosted, stand on; labels."""
    add("plane", make_surface(random, ("wood", "stone", "cloth")), size=12)
    add("plane", make_surface(random, ("paint", "wood", "tiles")), size=12, location=(0.0, 2.2, 3.0),
        rotation=(math.pi / 2, 0.0, 0.0))  # fmt: skip
    count = int(random.integers(4, 8))
    add_pages(random, count)
    floor = 0.004 * (count + 1)
    things = ["ball", "frosted", "tumbler", *random.choice(["ball", "frosted", "tumbler", "label", "thing"], 4)]
    for kind, (x, y) in zip(things, spread(random, len(things), (-0.75, -0.65), (0.75, 0.7), 0.42), strict=False):
        size = random.uniform(0.26, 0.42)
        if kind == "ball":
            tint = (1.0, 1.0, 1.0) if random.random() < 0.7 else draw_color(random, (0.1, 0.5), (0.8, 1.0))
            add("uv_sphere", make_clear(random, "ball", tint=tint), radius=0.5 * size,
                location=(x, y, floor + 0.5 * size), segments=96, ring_count=48)  # fmt: skip
        elif kind == "frosted":
            sides = size * random.uniform((0.7, 0.7, 0.2), (1.3, 1.3, 0.7))
            frosted = make_clear(random, "frosted", random.uniform(0.1, 0.4))
            add_block(frosted, sides, (x, y, floor + 0.5 * sides[2]), random.uniform(0.0, 3.0), bevel=0.01)
        elif kind == "tumbler":
            wall = size * refine([(0.0, 0.0), (0.38, 0.0), (0.45, 1.2), (0.42, 1.2), (0.36, 0.12), (0.0, 0.1)])
            add_turned("tumbler", make_clear(random, "tumbler"), wall, (x, y, floor), 96)
        elif kind == "label":
            can = size * refine([(0.0, 0.0), (0.35, 0.0), (0.35, 1.1), (0.0, 1.1)])
            add_turned("can", make_surface(random, ("metal", "plastic")), can, (x, y, floor), 64)
            ring = size * np.array([(0.353, 0.1), (0.353, 1.0)])
            add_turned("label", make_page(random), ring, (x, y, floor), 64).rotation_euler = (
                0,
                0,
                random.uniform(0, 6),
            )
        else:
            add_thing(random, make_surface(random, ("metal", "ceramic")), (x, y, floor), 0.7 * size)
    target = np.array([0.0, 0.0, 0.1])
    add_lights(random, target, 2.4, int(random.integers(1, 4)), 60.0)
    make_sky(0.0, random.uniform(0.2, 0.7), seed=int(random.integers(1000)))
    add_camera((random.uniform(-0.5, 0.5), -random.uniform(1.2, 1.8), random.uniform(1.0, 1.7)), target, 40.0)


def make_depth(random):
    """Very many small glossy things from near to far, lamps as small among them, and a lens wide open."""
    add("plane", make_surface(random, ("wood", "stone", "tiles", "cloth")), size=30)
    palette = [
        make_material("bead", draw_color(random, (0.3, 0.95), (0.1, 0.8)), Roughness=random.uniform(0.05, 0.3))
        for _ in range(6)
    ]
    palette += [make_material("metal", pick(random, METALS), Metallic=1.0, Roughness=random.uniform(0.05, 0.3))
                for _ in range(4)]  # fmt: skip
    palette += [make_clear(random, "marble", tint=draw_color(random, (0.0, 0.5), (0.8, 1.0)))]
    for _ in range(150):
        y = -1.3 + 3.6 * random.uniform() ** 1.3
        place = (random.uniform(-0.5, 0.5) * (y + 2.2), y, 0.0)
        add_thing(random, pick(random, palette), place, random.uniform(0.04, 0.14), ("ball", "ball", "ring", "drum"))
    for number in range(int(random.integers(15, 40))):
        y = random.uniform(-1.1, 4.0)
        place = (random.uniform(-0.55, 0.55) * (y + 2.2), y, random.uniform(0.02, 0.7))
        tint = warm(random) if random.random() < 0.6 else draw_color(random, (0.6, 1.0), (0.8, 1.0))
        add_glow(f"lamp{number}", tint, 10.0 ** random.uniform(1.3, 2.0), random.uniform(0.006, 0.018), place, 12)
    back = make_surface(random, ("paint", "tiles", "stone"))
    add("plane", back, size=20, location=(0.0, 5.0, 3.0), rotation=(math.pi / 2, 0.0, 0.0))
    add_lights(random, np.array([0.0, 0.0, 0.1]), 2.2, int(random.integers(1, 3)), 15.0)
    set_world(warm(random), 10.0 ** random.uniform(-1.6, -0.6))
    start, target = np.array([random.uniform(-0.3, 0.3), -1.9, random.uniform(0.3, 0.7)]), np.array([0.0, 0.1, 0.05])
    add_camera(start, target, random.uniform(36.0, 46.0))
    set_focus(random.uniform(0.5, 1.1) * float(np.linalg.norm(target - start)), 10.0 ** random.uniform(-0.9, -0.3))
