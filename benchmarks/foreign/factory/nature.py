"""Foliage, hair and fog: validation alone."""

import math

import bpy
import numpy as np
from blender_parts import (
    add,
    add_air,
    add_camera,
    add_faces,
    add_glow,
    make_material,
    make_sky,
    put_texture,
    set_focus,
    set_world,
)
from parts import add_block, add_light, add_lights, add_thing, make_surface, pick, spread, warm


def make_leaf(random, name, hue):
    """Return a material of leaves, light from behind shines through it."""
    color = np.array(hue) * random.uniform(0.6, 1.5)
    material = make_material(name, tuple(color), Roughness=random.uniform(0.25, 0.6))
    tree = material.node_tree
    through, sum_ = tree.nodes.new("ShaderNodeBsdfTranslucent"), tree.nodes.new("ShaderNodeMixShader")
    through.inputs["Color"].default_value = (*np.minimum(color * (1.6, 1.5, 0.6), 1.0), 1.0)
    sum_.inputs["Fac"].default_value = random.uniform(0.2, 0.5)
    tree.links.new(tree.nodes["Principled BSDF"].outputs[0], sum_.inputs[1])
    tree.links.new(through.outputs[0], sum_.inputs[2])
    tree.links.new(sum_.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return material


def add_leaves(random, material, places, length, width):
    """Add bent leaves of four corners at places (count, 3), in any direction but mostly outwards and up."""
    count = len(places)
    along, aside = random.normal(size=(2, count, 3))
    along[:, 2] += 0.5
    aside = np.cross(along, aside)
    along *= length * random.uniform(0.6, 1.2, (count, 1)) / np.linalg.norm(along, axis=1, keepdims=True)
    aside *= width * random.uniform(0.6, 1.2, (count, 1)) / np.linalg.norm(aside, axis=1, keepdims=True)
    middle, sag = places + 0.45 * along, np.array([0.0, 0.0, -0.25 * length])
    corners = np.stack([places, middle + aside, places + along + sag, middle - aside], axis=1)
    return add_faces("leaves", material, corners)


def add_blades(random, material, roots, height, width):
    """Add blades of grass at roots (count, 3) that bend in the wind."""
    count = len(roots)
    lean = random.normal(0.0, 0.25, (count, 3)) * (height, height, 0.0)
    tall = np.array([0.0, 0.0, height]) * random.uniform(0.4, 1.1, (count, 1))
    turn = random.uniform(0.0, math.pi, count)
    aside = width * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], -1)
    middle, top = roots + 0.6 * tall + 0.35 * lean, roots + tall * (1.0, 1.0, 0.9) + 1.5 * lean
    corners = np.stack([roots - aside, roots + aside, middle + 0.8 * aside, top, middle - 0.8 * aside], axis=1)
    return add_faces("blades", material, corners)


def add_meadow(random, deep, height, tufts=170):
    """Cover the ground before the camera with tufts of grass, denser near it, and with flowers."""
    greens = [make_leaf(random, f"grass{number}", (0.16, 0.34, 0.06)) for number in range(3)]
    for _ in range(tufts):
        far = deep * random.uniform() ** 1.5
        middle = np.array([random.uniform(-0.6, 0.6) * (far + 1.0), far - 1.4, 0.0])
        roots = middle + random.normal(0.0, 0.12 + 0.03 * far, (55, 3)) * (1.0, 1.0, 0.0)
        add_blades(random, pick(random, greens), roots, height * random.uniform(0.5, 1.3), 0.006 + 0.0015 * far)
    petals = [make_leaf(random, f"petal{number}", random.uniform(0.1, 0.7, 3)) for number in range(3)]
    for place in spread(random, int(random.integers(6, 30)), (-1.6, -0.6), (1.6, 3.0), 0.15):
        heart = np.array([*place, height * random.uniform(0.8, 1.4)])
        add_leaves(random, pick(random, petals), np.repeat(heart[None], 12, 0), 0.07, 0.02)


def add_tree(random, place, tall, spreading, bunches):
    """Add a trunk, branches and bunches of leaves around their ends."""
    bark = make_material("bark", Roughness=0.85)
    put_texture(bark, "Noise", "Base Color", scale=14.0, colors=((0.22, 0.16, 0.1), (0.06, 0.045, 0.03)), Detail=6.0)
    put_texture(bark, "Noise", "Normal", scale=25.0, bump=0.5)
    green = pick(random, ((0.12, 0.3, 0.05), (0.2, 0.33, 0.05), (0.4, 0.22, 0.04), (0.35, 0.08, 0.04)))
    leaves = [make_leaf(random, f"leaf{number}", green) for number in range(3)]
    trunk = add("cylinder", bark, radius=0.05 * tall, depth=tall, location=(*place, 0.5 * tall), vertices=24)
    trunk.name = "trunk"
    for _ in range(bunches):
        end = np.array([*place, 0.0]) + random.normal(0.0, 1.0, 3) * (spreading, spreading, 0.22 * tall)
        end[2] = abs(end[2] - 0.3) + 0.75 * tall
        start = np.array([*place, tall * random.uniform(0.5, 0.95)])
        middle, way = 0.5 * (start + end), end - start
        turn = (0.0, math.acos(way[2] / np.linalg.norm(way)), math.atan2(way[1], way[0]))
        add("cylinder", bark, radius=0.012 * tall, depth=float(np.linalg.norm(way)), location=middle, rotation=turn,
            vertices=8)  # fmt: skip
        places = end + random.normal(0.0, 0.16, (70, 3)) * random.uniform(0.7, 1.5)
        add_leaves(random, pick(random, leaves), places, 0.16, 0.035)


def make_foliage(random):
    """A meadow with stones, trees or near twigs below sun and sky."""
    soil = make_material("soil", Roughness=0.95)
    put_texture(soil, "Noise", "Base Color", scale=5.0, colors=((0.2, 0.19, 0.07), (0.06, 0.11, 0.03)), Detail=8.0)
    add("plane", soil, size=120)
    make_sky(
        10.0 ** random.uniform(3.2, 4.2), 1.0, seed=int(random.integers(1000)), height_deg=random.uniform(15.0, 65.0),
        around_deg=random.uniform(-180.0, 180.0), clear=random.uniform(0.0, 1.5),
    )  # fmt: skip
    view = pick(random, ("meadow", "tree", "twigs"))
    eye = 0.5 if view == "meadow" else 1.3
    add_meadow(random, 7.0, random.uniform(0.25, 0.5), 170 if view == "meadow" else 90)
    for place in spread(random, 4, (-1.4, 0.3), (1.4, 2.5), 0.5):
        add_thing(random, make_surface(random, ("stone",)), (*place, -0.05), random.uniform(0.2, 0.6), ("stone",))
    for number in range(1 + int(random.integers(3))):
        far = random.uniform(1.5, 2.5) if view == "tree" and not number else random.uniform(4.0, 9.0)
        add_tree(random, (random.uniform(-0.5, 0.5) * far, far), random.uniform(1.6, 3.0), 0.6, 26)
    if view == "twigs":
        leaf = make_leaf(random, "near", (0.15, 0.32, 0.05))
        for _ in range(9):
            start, end = random.uniform((-1.6, -1.5, 0.8), (1.6, -0.2, 2.2), (2, 3))
            places = start + (end - start) * random.uniform(0.0, 1.0, (26, 1)) * 0.7
            add_leaves(random, leaf, places, 0.26, 0.055)
    add_camera(
        (random.uniform(-0.5, 0.5), -2.4, eye), (0.0, 1.0, eye + random.uniform(-0.1, 0.25)), random.uniform(35.0, 55.0)
    )
    if random.random() < 0.35:
        set_focus(random.uniform(2.0, 4.0), 10.0 ** random.uniform(-1.0, 0.0))


def make_hair_material(random, name):
    """Return a material of hair, from white through red and brown to black, or dyed."""
    material = make_material(name, Roughness=random.uniform(0.2, 0.45))
    tree = material.node_tree
    shader = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    if random.random() < 0.75:
        shader.parametrization = "MELANIN"
        shader.inputs["Melanin"].default_value = random.uniform(0.05, 0.9)
        shader.inputs["Melanin Redness"].default_value = random.uniform(0.1, 1.0)
    else:
        shader.parametrization = "COLOR"
        shader.inputs["Color"].default_value = (*random.uniform(0.05, 0.7, 3), 1.0)
    shader.inputs["Roughness"].default_value = tree.nodes["Principled BSDF"].inputs["Roughness"].default_value
    tree.links.new(shader.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return material


def add_hair(material, roots, ways, lengths, *, droop, frizz, radius, random):
    """Add hairs that grow from roots (count, 3) along ways (count, 3) and hang down."""
    steps = np.linspace(0.0, 1.0, 7)[None, :, None]
    far = steps * np.asarray(lengths).reshape(-1, 1, 1)
    points = (
        roots[:, None]
        + far * ways[:, None] * (1.0 - 0.5 * droop * steps)
        + far * steps * droop * np.array([0.0, 0.0, -1.0])
    )
    bend = random.normal(0.0, 1.0, (len(roots), 2, 1, 3))
    points = points + frizz * far * (bend[:, 0] * np.sin(2.5 * steps) + bend[:, 1] * np.sin(6.0 * steps) * 0.5)
    curves = bpy.data.hair_curves.new("hair")
    curves.add_curves([steps.shape[1]] * len(roots))
    curves.position_data.foreach_set("vector", points.astype(np.float32).ravel())
    thick = np.broadcast_to(radius * (1.0 - 0.8 * steps), (*points.shape[:2], 1))
    curves.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", thick.astype(np.float32).ravel())
    curves.materials.append(material)
    thing = bpy.data.objects.new("hair", curves)
    bpy.context.collection.objects.link(thing)
    return thing


def add_furry(random, hair, middle, radii, count, length, comb):
    """Add an ellipsoid with a coat of hair that is combed along a way."""
    skin = make_material("skin", (0.25, 0.16, 0.12), Roughness=0.6)
    body = add("uv_sphere", skin, radius=1.0, location=middle, segments=48, ring_count=24)
    body.scale = radii
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outwards = normals / radii
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    ways = outwards + comb + random.normal(0.0, 0.15, (count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    lengths = length * random.uniform(0.6, 1.1, count)
    add_hair(
        hair, np.asarray(middle) + normals * radii, ways, lengths, droop=0.25, frizz=0.06, radius=0.0022, random=random
    )


def add_animal(random, place, size):
    """Add a body, a head, ears, eyes and a nose."""
    hair, middle = make_hair_material(random, "fur"), np.array([*place, 0.0])
    comb = random.normal((0.0, 0.0, -0.4), 0.4)
    length = size * random.uniform(0.12, 0.35)
    add_furry(
        random,
        hair,
        middle + size * np.array([0.0, 0.25, 0.42]),
        size * np.array([0.45, 0.55, 0.42]),
        9000,
        length,
        comb,
    )
    head = middle + size * np.array([0.08, -0.35, 0.85])
    add_furry(random, hair, head, size * np.array([0.32, 0.3, 0.3]), 7000, 0.6 * length, comb)
    for side in (-1.0, 1.0):
        ear = head + size * np.array([0.2 * side, 0.05, 0.32])
        add_furry(random, hair, ear, size * np.array([0.09, 0.05, 0.16]), 1500, 0.3 * length, comb)
        eye = make_material("eye", (0.02, 0.015, 0.01), Roughness=0.05, Coat_Weight=1.0)
        add("uv_sphere", eye, radius=0.055 * size, location=head + size * np.array([0.13 * side, -0.29, 0.07]))
    nose = make_material("nose", (0.04, 0.02, 0.02), Roughness=0.3)
    add("uv_sphere", nose, radius=0.06 * size, location=head + size * np.array([0.0, -0.36, -0.06]))


def add_wig(random, place, size):
    """Add a head on a stand with long hair that parts on top."""
    head = np.array([*place, 1.1 * size])
    skin = make_material("skin", (0.45, 0.28, 0.2), Roughness=0.45, Subsurface_Weight=0.3)
    add("uv_sphere", skin, radius=0.34 * size, location=head, segments=64, ring_count=32).scale = (0.85, 1.0, 1.2)
    add("cylinder", skin, radius=0.13 * size, depth=0.9 * size, location=(*place, 0.45 * size), vertices=48)
    normals = random.normal(size=(11000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals[normals[:, 1] > 0.1 - 0.45 * normals[:, 2].clip(0.0)]
    ways = normals * (1.3, 1.0, 0.4) + (0.0, 0.25, 0.15)
    lengths = size * random.uniform(0.5, 1.1) * random.uniform(0.8, 1.1, len(normals))
    add_hair(make_hair_material(random, "hair"), head + 0.345 * size * normals * (0.85, 1.0, 1.2), 0.45 * ways, lengths,
             droop=0.95, frizz=random.uniform(0.02, 0.1), radius=0.0025, random=random)  # fmt: skip


def make_hair(random):
    """Animals with fur, heads with long hair, a carpet of long pile, and a few smooth things among them."""
    if random.random() < 0.5:
        pile, count = make_hair_material(random, "pile"), 16000
        roots = random.uniform((-2.2, -1.6, 0.0), (2.2, 1.8, 0.0), (count, 3))
        ways = random.normal((0.0, 0.0, 1.0), 0.35, (count, 3))
        add_hair(
            pile, roots, ways, random.uniform(0.06, 0.14, count), droop=0.5, frizz=0.1, radius=0.004, random=random
        )
        add("plane", make_material("backing", (0.2, 0.15, 0.1)), size=12)
    else:
        add("plane", make_surface(random, ("wood", "tiles", "stone")), size=12)
    wall = make_surface(random, ("paint", "tiles", "wood", "cloth"))
    add("plane", wall, size=14, location=(0.0, 2.6, 3.0), rotation=(math.pi / 2, 0.0, 0.0))
    for place in spread(random, int(random.integers(2, 4)), (-0.8, -0.4), (0.8, 0.8), 0.85):
        pick(random, (add_animal, add_wig))(random, place, random.uniform(0.7, 1.1))
    for place in spread(random, 4, (-1.6, -1.2), (1.6, 1.6), 0.7):
        add_thing(random, make_surface(random), (*place, 0.0), random.uniform(0.15, 0.35))
    add_lights(random, np.array([0.0, 0.0, 0.6]), 3.0, 2)
    add_light((random.uniform(-2.0, 2.0), 2.3, 2.4), (0.0, 0.0, 0.7), 60.0, 0.4, warm(random))
    set_world(warm(random), random.uniform(0.05, 0.4))
    add_camera(
        (random.uniform(-0.8, 0.8), random.uniform(-3.4, -2.4), random.uniform(0.7, 1.5)),
        (0.0, 0.0, 0.6),
        random.uniform(34.0, 44.0),
    )
    if random.random() < 0.25:
        set_focus(random.uniform(2.2, 2.8), 10.0 ** random.uniform(-0.7, 0.3))


def make_fog(random):
    """A hall, a forest or a yard in fog: beams through gaps, lamps in it, things near and far."""
    ground = make_surface(random, ("stone", "tiles", "wood"))
    add("plane", ground, size=40)
    place = pick(random, ("hall", "forest", "yard"))
    stand = make_surface(random, ("stone", "paint", "wood"))
    for spot in spread(random, 16 if place == "forest" else 7, (-4.5, -1.0), (4.5, 5.0), 0.9):
        if place == "forest":
            tilt = random.normal(0.0, 0.04, 2)
            add(
                "cylinder",
                stand,
                radius=random.uniform(0.1, 0.3),
                depth=9.0,
                location=(*spot, 4.0),
                rotation=(*tilt, 0.0),
            )
        elif place == "hall":
            add_block(stand, (0.4, 0.4, 6.0), (*spot, 3.0), bevel=0.04)
        else:
            add_block(
                stand, random.uniform(0.4, 1.3, 3), (*spot, random.uniform(0.2, 0.5)), random.uniform(0.0, 3.0), 0.03
            )
    for number in range(9):
        add_block(stand, (random.uniform(0.3, 0.7), 0.15, 6.0), (-4.0 + number + random.normal(0.0, 0.1), 5.6, 3.0))
    for spot in spread(random, 5, (-1.7, -2.4), (1.7, 1.5), 0.7):
        add_thing(random, make_surface(random), (*spot, 0.0), random.uniform(0.4, 1.0))
    add_air(10.0 ** random.uniform(-1.5, -0.85), 14.0, (0.0, 0.0, 6.9), random.uniform(0.0, 0.6))
    aside, height = random.uniform(-4.0, 4.0), random.uniform(3.5, 7.0)
    add_light(
        (aside, 10.5, height), (-0.3 * aside, 1.0, 0.5), random.uniform(4000.0, 9000.0), 0.25, warm(random), kind="SPOT"
    )
    for number, spot in enumerate(spread(random, int(random.integers(1, 5)), (-3.0, 0.5), (3.0, 5.0), 1.0)):
        high = random.uniform(0.8, 3.0)
        add_glow(f"lamp{number}", warm(random), 40.0, random.uniform(0.06, 0.15), (*spot, high), 24)
    add_lights(random, np.array([0.0, 0.0, 0.8]), 4.5, 1, 10.0)
    set_world((0.3, 0.4, 0.6), 10.0 ** random.uniform(-1.7, -0.5))
    add_camera((random.uniform(-1.0, 1.0), -5.2, random.uniform(1.0, 2.0)), (0.0, 0.5, 1.3), random.uniform(42.0, 58.0))
