"""Things on a table or in a studio: products, glass, brushed metal, toys, wax, and things on a transparent film."""

import math

import bpy
import numpy as np
from blender_parts import (
    add,
    add_camera,
    add_faces,
    add_flakes,
    add_glow,
    make_material,
    make_sky,
    put_texture,
    set_focus,
    set_world,
)
from parts import (
    METALS,
    add_block,
    add_light,
    add_lights,
    add_thing,
    add_turned,
    draw_color,
    draw_profile,
    make_surface,
    pick,
    spread,
    warm,
)

from pictures import make_printed

TABLES = ("wood", "stone", "tiles", "cloth", "check", "paint")


def set_table(random, table=TABLES, wall=TABLES):
    """Put up a table and a wall behind it, or a studio's sheet of paper that bends upwards."""
    if random.random() < 0.3:
        paper = make_surface(random, ("paint",))
        bend = np.linspace(0.0, math.pi / 2, 9)
        along = np.array(
            [(-6.0, 0.0), *zip(1.4 + 0.8 * np.sin(bend), 0.8 - 0.8 * np.cos(bend), strict=True), (2.2, 6.0)]
        )
        low, high = along[:-1], along[1:]
        corners = [np.insert(each, 0, x, axis=1) for each, x in ((low, -8.0), (low, 8.0), (high, 8.0), (high, -8.0))]
        add_faces("sheet", paper, np.stack(corners, axis=1)).data.shade_smooth()
    else:
        add("plane", make_surface(random, table), size=12)
        back = random.uniform(1.6, 3.5)
        add("plane", make_surface(random, wall), size=14, location=(0.0, back, 3.0), rotation=(math.pi / 2, 0.0, 0.0))


def light_and_shoot(random, height=0.3, *, far=(2.0, 2.8), blur=0.3, power=60.0):
    """Light the table by lamps and a sky or a plain world, and look at it from a place above."""
    target, far = np.array([random.normal(0.0, 0.06), 0.0, height]), random.uniform(*far)
    add_lights(random, target, 2.6, int(random.integers(1, 4)), power)
    if random.random() < 0.5:
        make_sky(
            0.0 if random.random() < 0.5 else 10.0 ** random.uniform(2.5, 3.5), random.uniform(0.1, 0.6),
            seed=int(random.integers(1000)), height_deg=random.uniform(20.0, 60.0),
            around_deg=random.uniform(-180.0, 180.0),
        )  # fmt: skip
    else:
        set_world(warm(random), 10.0 ** random.uniform(-1.7, -0.3))
    around, up = random.normal(0.0, 0.3), random.uniform(0.12, 0.65)
    way = np.array([math.sin(around) * math.cos(up), -math.cos(around) * math.cos(up), math.sin(up)])
    add_camera(target + far * way, target, random.uniform(32.0, 44.0))
    if random.random() < blur:
        set_focus(far * random.uniform(0.9, 1.05), 10.0 ** random.uniform(-0.6, 0.4))


def make_lacquer(random, flakes):
    """Return paint below a clear coat, with flakes or without."""
    coat = {"Roughness": random.uniform(0.25, 0.5), "Coat_Weight": 1.0, "Coat_Roughness": random.uniform(0.0, 0.08)}
    material = make_material("lacquer", draw_color(random, (0.4, 0.95), (0.1, 0.8)), Metallic=float(flakes), **coat)
    if flakes:
        add_flakes(material, 10.0 ** random.uniform(1.3, 2.0), random.uniform(0.15, 0.5))
    return material


def add_bottle(random, place, size, material=None):
    """Add a bottle or jar with a label and a cap."""
    wide, tall = 0.5 * size * random.uniform(0.5, 0.9), size * random.uniform(0.9, 1.6)
    neck = wide * random.uniform(0.3, 0.9)
    body = material or (
        make_lacquer(random, False) if random.random() < 0.5 else make_surface(random, ("ceramic", "plastic"))
    )
    bend = np.linspace(0.0, 1.0, 9)
    shoulder = [(wide + (neck - wide) * (3 * s**2 - 2 * s**3), tall * (0.7 + 0.15 * s)) for s in bend]
    add_turned(
        "bottle", body, [(0.0, 0.0), (0.93 * wide, 0.0), (wide, 0.05 * tall), *shoulder, (neck, 0.9 * tall)], place
    )
    ring = [(wide + 0.002, 0.2 * tall), (wide + 0.002, 0.55 * tall)]
    add_turned("label", make_printed(random, "label"), ring, place).rotation_euler = (
        0.0,
        0.0,
        random.uniform(0.0, 6.0),
    )
    cap = make_surface(random, ("metal", "plastic"))
    high = 0.88 * tall
    add_turned("cap", cap, [(1.15 * neck, high), (1.15 * neck, high + 0.1 * tall), (0.0, high + 0.1 * tall)], place)


def make_product(random):
    """Bottles, boxes and things of lacquer, flakes, metal on podiums; lamps like those of a studio."""
    set_table(random)
    for place in spread(random, int(random.integers(2, 5)), (-0.8, -0.4), (0.8, 0.9), 0.5):
        high = random.uniform(0.04, 0.3)
        podium = make_lacquer(random, False) if random.random() < 0.3 else make_surface(random)
        add("cylinder", podium, radius=0.3, depth=high, location=(*place, 0.5 * high), vertices=96)
        add_product(random, (*place, high))
    for place in spread(random, 5, (-1.1, -0.9), (1.1, 0.2), 0.42):
        add_product(random, (*place, 0.0))
    light_and_shoot(random, 0.35)


def add_product(random, place):
    """Add a bottle, a printed box, or a thing of lacquer or another surface."""
    size, choice = random.uniform(0.3, 0.55), random.random()
    if choice < 0.35:
        add_bottle(random, place, size)
    elif choice < 0.5:
        sides = size * random.uniform(0.5, 1.0, 3)
        middle = (*place[:2], place[2] + 0.5 * sides[2])
        add_block(make_printed(random, "box"), sides, middle, random.uniform(0.0, 3.0), bevel=0.004)
    else:
        surface = make_lacquer(random, random.random() < 0.5) if random.random() < 0.7 else make_surface(random)
        add_thing(random, surface, place, size)


def add_vessel(random, place, size):
    """Add a glass, a bowl or a carafe with a wall of some thickness, often with a liquid in it."""
    tint = (1.0, 1.0, 1.0) if random.random() < 0.7 else draw_color(random, (0.1, 0.6), (0.8, 1.0))
    rough = 0.0 if random.random() < 0.75 else random.uniform(0.05, 0.3)
    glass = make_material("glass", tint, Roughness=rough, Transmission_Weight=1.0, IOR=random.uniform(1.45, 1.55))
    outer = np.array(draw_profile(random, size * random.uniform(0.9, 1.5), 0.5 * size))
    outer[1:, 0] = np.maximum(outer[1:, 0], 0.15 * size)
    thick = 0.035 * size
    inner = outer[1:] - np.array([thick, 0.0])
    inner = np.array([(0.0, 2.5 * thick), *inner[inner[:, 1] > 2.5 * thick]])
    add_turned("vessel", glass, [*outer, *inner[::-1]], place)
    if random.random() < 0.65:
        level = outer[-1, 1] * random.uniform(0.35, 0.85)
        wet = inner[inner[:, 1] < level]
        # The liquid reaches into the glass, as Cycles wants it.
        wet[1:, 0] += 0.3 * thick
        wet[0, 1] -= 0.3 * thick
        drink = make_material(
            "drink", draw_color(random, (0.0, 0.95), (0.7, 1.0)), Roughness=0.0, Transmission_Weight=1.0, IOR=1.33
        )
        add_turned("drink", drink, [*wet, (0.0, wet[-1, 1])], place)


def make_glass(random):
    """Glasses, bowls and carafes with liquids, solid glass and ice, before patterns that they bend."""
    set_table(random, ("wood", "check", "tiles", "cloth"), ("check", "tiles", "wood", "stone"))
    for number, place in enumerate(spread(random, 9, (-1.0, -0.8), (1.0, 0.9), 0.42)):
        size = random.uniform(0.3, 0.55)
        if number < 5:
            add_vessel(random, (*place, 0.001), size)
        elif number < 7:
            ice = make_material("ice", draw_color(random, (0.0, 0.4), (0.85, 1.0)), Transmission_Weight=1.0, IOR=1.4,
                                Roughness=random.uniform(0.0, 0.15))  # fmt: skip
            add_thing(random, ice, (*place, 0.001), 0.8 * size, ("ball", "block", "monkey", "stone"))
        else:
            add_thing(random, make_surface(random, ("metal", "ceramic", "cloth")), (*place, 0.0), size)
    light_and_shoot(random, 0.3)


def make_brushed_metal(random):
    """Return an anisotropic metal, turned on a lathe or brushed along an axis, with fine grooves."""
    grain = {"Anisotropic": random.uniform(0.4, 0.95), "Anisotropic_Rotation": pick(random, (0.0, 0.25))}
    color, rough = pick(random, METALS), random.uniform(0.15, 0.45)
    material = make_material("brushed", color, Metallic=1.0, Roughness=rough, **grain)
    tree = material.node_tree
    shader, tangent = tree.nodes["Principled BSDF"], tree.nodes.new("ShaderNodeTangent")
    tangent.direction_type, tangent.axis = "RADIAL", pick(random, ("X", "Y", "Z", "Z"))
    tree.links.new(tangent.outputs[0], shader.inputs["Tangent"])
    if random.random() < 0.6:
        put_texture(material, "Noise", "Normal", scale=40.0, bump=random.uniform(0.02, 0.15))
        noise = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeTexNoise")
        stretch = tree.nodes.new("ShaderNodeVectorMath")
        stretch.operation, stretch.inputs[1].default_value = (
            "MULTIPLY",
            pick(random, ((0.03, 1.0, 1.0), (1.0, 1.0, 0.03), (0.03, 0.03, 1.0))),
        )
        tree.links.new(noise.inputs["Vector"].links[0].from_socket, stretch.inputs[0])
        tree.links.new(stretch.outputs[0], noise.inputs["Vector"])
    return material


def make_brushed(random):
    """Pots, discs, knobs and blocks of brushed and turned metals among other things."""
    set_table(random)
    for number, place in enumerate(spread(random, 11, (-1.1, -0.9), (1.1, 1.0), 0.4)):
        size, metal = random.uniform(0.3, 0.7), make_brushed_metal(random)
        if number > 7:
            add_thing(random, make_surface(random), (*place, 0.0), 0.7 * size)
        elif random.random() < 0.4:
            lid = (
                0.5
                * size
                * np.array([(0, 0), (1, 0), (1, 0.08), (0.9, 0.1), (0.85, 0.06), (0.3, 0.1), (0.28, 0.4), (0, 0.42)])
            )
            add_turned("knob", metal, lid, (*place, 0.0), 96)
        else:
            add_thing(random, metal, (*place, 0.0), size, ("drum", "vase", "block", "ring", "ball"))
    light_and_shoot(random, 0.25, power=80.0)


def add_toy(random, place):
    """Add a picture cube, a brick with studs, a tower of rings, a pawn, or a plain or printed thing."""
    x, y = place
    size, turn, choice = random.uniform(0.18, 0.42), random.uniform(0.0, 3.0), int(random.integers(5))
    plastic = [
        make_material("toy", draw_color(random, (0.5, 0.95), (0.3, 0.9)), Roughness=random.uniform(0.15, 0.5))
        for _ in range(4)
    ]
    if choice == 0:
        for level in range(int(random.integers(1, 4))):
            add_block(
                make_printed(random, "cube"), (size,) * 3, (x, y, size * (level + 0.5)), turn + 0.3 * level, bevel=0.02
            )
    elif choice == 1:
        add_block(plastic[0], (size, 0.5 * size, 0.3 * size), (x, y, 0.15 * size), turn, bevel=0.006)
        for stud in range(8):
            along, aside = (stud % 4 - 1.5) * 0.25 * size, (stud // 4 - 0.5) * 0.25 * size
            spot = (
                x + along * math.cos(turn) - aside * math.sin(turn),
                y + along * math.sin(turn) + aside * math.cos(turn),
            )
            add(
                "cylinder", plastic[0], radius=0.08 * size, depth=0.1 * size, location=(*spot, 0.34 * size), vertices=24
            )
    elif choice == 2:
        for level in range(4):
            wide, high = 0.5 * size * (1.0 - 0.17 * level), 0.22 * size
            add("torus", plastic[level], major_radius=wide - 0.5 * high, minor_radius=0.5 * high,
                location=(x, y, high * (level + 0.5)), major_segments=48, minor_segments=16)  # fmt: skip
    elif choice == 3:
        pawn = size * np.array([(0, 0), (0.4, 0), (0.4, 0.1), (0.2, 0.3), (0.13, 0.7), (0.25, 0.75), (0.13, 0.8)])
        add_turned("pawn", pick(random, (plastic[0], make_surface(random, ("wood", "stone")))), pawn, (x, y, 0.0))
        add("uv_sphere", plastic[1], radius=0.24 * size, location=(x, y, size), segments=32, ring_count=16)
    else:
        surface = (
            make_printed(random)
            if random.random() < 0.5
            else make_surface(random, ("check", "cloth", "plastic", "wood"))
        )
        add_thing(random, surface, (x, y, 0.0), size, ("ball", "monkey", "block", "drum"))


def make_toys(random):
    """Many toys with prints and bright colors on a carpet or boards."""
    set_table(random, ("cloth", "wood", "check", "tiles"))
    for place in spread(random, 26, (-1.3, -1.1), (1.3, 1.4), 0.3):
        add_toy(random, place)
    light_and_shoot(random, 0.15)


def make_wax_material(random, name):
    """Return wax, skin, soap, marble or jelly: light enters and leaves elsewhere."""
    color = draw_color(random, (0.05, 0.7), (0.4, 0.95))
    if random.random() < 0.4:
        color = np.array((0.8, 0.5, 0.38)) * random.uniform(0.35, 1.1)
    depth = {"Subsurface_Weight": random.uniform(0.5, 1.0), "Subsurface_Scale": 10.0 ** random.uniform(-1.7, -0.7)}
    material = make_material(name, color, Roughness=random.uniform(0.2, 0.6), **depth)
    material.node_tree.nodes["Principled BSDF"].inputs["Subsurface Radius"].default_value = random.uniform(
        (0.6, 0.2, 0.1), (1.0, 0.6, 0.4)
    )
    if random.random() < 0.4:
        put_texture(
            material,
            "Noise",
            "Base Color",
            scale=random.uniform(2.0, 9.0),
            colors=(color, 0.6 * np.array(color)),
            Detail=5.0,
        )
    if random.random() < 0.4:
        put_texture(material, "Noise", "Normal", scale=random.uniform(15.0, 60.0), bump=random.uniform(0.05, 0.25))
    return material


def make_wax(random):
    """Candles that burn, figures of wax and skin, fruit, soap, marble; often lit from behind."""
    set_table(random)
    for number, place in enumerate(spread(random, 9, (-0.9, -0.8), (0.9, 0.8), 0.42)):
        wax, size = make_wax_material(random, "wax"), random.uniform(0.3, 0.6)
        if number < 3:
            tall, wide = size * random.uniform(0.8, 1.7), 0.3 * size
            candle = [
                (0.0, 0.0),
                (wide, 0.0),
                (wide, tall),
                (0.93 * wide, tall + 0.02),
                (0.8 * wide, tall - 0.02),
                (0.0, tall - 0.04),
            ]
            add_turned("candle", wax, candle, (*place, 0.0))
            if random.random() < 0.6:
                flame = add_glow("flame", (1.0, 0.55, 0.2), 60.0, 0.02, (*place, tall + 0.06), 16)
                flame.scale = (1.0, 1.0, 2.5)
        elif number < 8:
            add_thing(random, wax, (*place, 0.0), size, ("monkey", "monkey", "ball", "stone", "block", "vase"))
        else:
            add_thing(random, make_surface(random), (*place, 0.0), size)
    if random.random() < 0.6:
        add_light((random.uniform(-1.5, 1.5), 1.4, random.uniform(0.8, 1.8)), (0.0, 0.0, 0.3), 60.0, 0.3, warm(random))
    light_and_shoot(random, 0.3, power=40.0)


def make_film(random):
    """Things that stand on a shadow catcher before a transparent film, some of them of glass."""
    scene = bpy.context.scene
    scene.render.film_transparent = True
    scene.cycles.film_transparent_glass = bool(random.random() < 0.5)
    ground = add("plane", make_surface(random, ("stone", "paint")), size=12)
    ground.is_shadow_catcher = bool(random.random() < 0.8)
    ground.hide_render = not ground.is_shadow_catcher and bool(random.random() < 0.5)
    for place in spread(random, 8, (-0.9, -0.8), (0.9, 0.9), 0.45):
        choice = random.random()
        if choice < 0.2:
            add_vessel(random, (*place, 0.001), random.uniform(0.3, 0.5))
        elif choice < 0.5:
            add_toy(random, place)
        else:
            add_product(random, (*place, 0.0))
    light_and_shoot(random, 0.25)
