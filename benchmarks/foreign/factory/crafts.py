"""Cloth, candles and helmets: validation alone."""

import math

import bmesh
import bpy
import numpy as np
from blender_parts import add, add_camera, make_image, make_material, make_sky, put_texture, set_focus, set_world
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
)

from pictures import draw_waves

THREADS, THREAD_PIXELS = 40, 6
"""Threads across the image of a cloth, which repeats, and pixels across a thread."""


def put_maps(material, color, height, steep, roughness=None, metallic=None):
    """Drive a material by images (rows, columns[, 3]) over its UV map; the normal map is that of a height in pixels."""
    tree = material.node_tree
    put_image(material, make_image("color", color))
    for name, values in (("Roughness", roughness), ("Metallic", metallic)):
        if values is not None:
            put_image(material, make_image(name, np.repeat(values[..., None], 3, -1)), name)
    if roughness is not None:
        aov = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputAOV")
        source = tree.nodes["Principled BSDF"].inputs["Roughness"].links[0].from_socket
        tree.links.new(source, aov.inputs["Value"])
    slopes = [steep * 0.5 * (np.roll(height, 1, axis) - np.roll(height, -1, axis)) for axis in (1, 0)]
    normal = np.stack([*slopes, np.ones_like(height)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = make_image("normal", 0.5 + 0.5 * normal)
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    tree.links.new(node.outputs["Normal"], tree.nodes["Principled BSDF"].inputs["Normal"])
    return material


def make_weave(random):
    """Return a woven cloth: plain, twill or with stripes, with a normal map of its threads and with sheen."""
    place = np.arange(THREADS * THREAD_PIXELS) / THREAD_PIXELS
    across, along = np.meshgrid(place, place)
    cycle, over = pick(random, ((2, 1), (4, 2), (4, 1), (8, 3)))
    is_warp = (np.floor(across) + np.floor(along) * pick(random, (1, -1))) % cycle < over
    round_across, round_along = np.sin(math.pi * (across % 1.0)), np.sin(math.pi * (along % 1.0))
    height = np.where(is_warp, round_across * (0.7 + 0.3 * round_along), round_along * (0.7 + 0.3 * round_across))
    warp, weft = (np.array([draw_color(random, value=(0.1, 0.8)) for _ in range(2)]) for _ in range(2))
    stripes = [random.random(THREADS) < random.uniform(0.0, 0.5) for _ in range(2)]
    warp, weft = warp[stripes[0].astype(int)], weft[stripes[1].astype(int)]
    color = np.where(is_warp[..., None], warp[across.astype(int)], weft[along.astype(int)])
    sheen = {"Sheen_Weight": random.uniform(0.2, 1.0), "Sheen_Roughness": random.uniform(0.2, 0.6)}
    material = make_material("weave", Roughness=random.uniform(0.45, 0.9), **sheen)
    return put_maps(material, color * (0.35 + 0.65 * height[..., None]), height, 0.35 * THREAD_PIXELS)


def make_satin(random):
    """Return satin or silk: its threads stretch the highlights along one way."""
    grain = {"Anisotropic": random.uniform(0.6, 0.95), "Anisotropic_Rotation": pick(random, (0.0, 0.25))}
    gloss = {"Specular_IOR_Level": random.uniform(0.6, 1.0), "Sheen_Weight": random.uniform(0.0, 0.5)}
    color, rough = draw_color(random, (0.3, 0.9), (0.1, 0.6)), random.uniform(0.22, 0.4)
    material = make_material("satin", color, Roughness=rough, Metallic=pick(random, (0.0, 0.4)), **grain, **gloss)
    tangent = material.node_tree.nodes.new("ShaderNodeTangent")
    tangent.direction_type = "UV_MAP"
    material.node_tree.links.new(tangent.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Tangent"])
    return material


def add_sheet(material, points, repeats):
    """Add a cloth through a grid of points (rows, columns, 3); the images on it repeat so often along each side."""
    rows, columns, _ = points.shape
    row, column = (each.ravel() for each in np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij"))
    corners = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
    mesh = bpy.data.meshes.new("sheet")
    faces = np.stack([down * columns + right for down, right in corners], -1)
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], faces.tolist())
    places = np.stack([np.stack([repeats * right / columns, repeats * down / rows], -1) for down, right in corners], 1)
    mesh.uv_layers.new().uv.foreach_set("vector", places.astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [True] * len(faces))
    mesh.materials.append(material)
    thing = bpy.data.objects.new("sheet", mesh)
    bpy.context.collection.objects.link(thing)
    return thing


def make_fabric(random):
    """Woven cloths and satin: laid in folds over a table and over balls, hung behind it, on cushions and rolls."""

    def draw_cloth():
        return make_satin(random) if random.random() < 0.35 else make_weave(random)

    across, along = np.meshgrid(np.linspace(-2.4, 2.4, 160), np.linspace(-1.9, 1.6, 120))
    height = 0.05 * (draw_waves(random, 0.3 * along, 0.3 * across) - 0.5)
    for spot in spread(random, int(random.integers(1, 4)), (-0.9, -0.6), (0.9, 0.9), 0.6):
        tall, apart = random.uniform(0.15, 0.45), np.hypot(across - spot[0], along - spot[1])
        folds = 1.0 + 0.25 * np.sin(9.0 * np.arctan2(along - spot[1], across - spot[0])) * (apart / 0.4).clip(0.0, 1.0)
        height += tall * np.exp(-((apart / (0.32 * folds)) ** 4))
    add_sheet(draw_cloth(), np.stack([across, along, height], -1), random.uniform(3.0, 7.0))
    across, up = np.meshgrid(np.linspace(-3.0, 3.0, 240), np.linspace(-0.2, 3.0, 30))
    fold = 0.12 * np.sin(7.0 * across + 1.3 * np.sin(2.1 * across)) * (1.0 - 0.15 * up)
    add_sheet(draw_cloth(), np.stack([across, 1.55 + fold, up], -1), random.uniform(3.0, 7.0))
    for spot in spread(random, 6, (-1.1, -0.9), (1.1, 1.1), 0.5):
        size, turn = random.uniform(0.3, 0.5), random.uniform(0.0, 3.0)
        if random.random() < 0.5:
            cushion = add("uv_sphere", draw_cloth(), radius=size, location=(*spot, 0.2), segments=64, ring_count=32)
            cushion.scale, cushion.rotation_euler = (1.0, 0.75, 0.4), (random.uniform(0.0, 0.8), 0.0, turn)
        elif random.random() < 0.6:
            roll = [(0.0, 0.0), (0.25 * size, 0.0), (0.25 * size, 1.6 * size), (0.0, 1.6 * size)]
            thing = add_turned("roll", draw_cloth(), roll, (*spot, 0.12 + 0.25 * size))
            thing.rotation_euler = (math.pi / 2, 0.0, turn)
        else:
            add_thing(random, make_surface(random, ("metal", "ceramic", "wood")), (*spot, 0.02), 0.6 * size)
    target = np.array([0.0, 0.0, 0.25])
    add_lights(random, target, 2.6, int(random.integers(1, 4)), 60.0)
    make_sky(0.0, random.uniform(0.1, 0.6), seed=int(random.integers(1000)))
    add_camera((random.uniform(-0.7, 0.7), -random.uniform(1.6, 2.3), random.uniform(0.8, 1.4)), target, 42.0)


def add_flame(random, place, size):
    """Add a wick and a flame shaped as a drop."""
    x, y, z = place
    wick = make_material("wick", (0.02, 0.015, 0.01), Roughness=0.9)
    add("cylinder", wick, radius=0.025 * size, depth=0.5 * size, location=(x, y, z + 0.2 * size), vertices=8)
    glow = {"Emission_Color": (1.0, random.uniform(0.5, 0.65), 0.2, 1.0), "Emission_Strength": random.uniform(30, 90)}
    drop = [(0.0, 0.0), (0.1, 0.12), (0.15, 0.3), (0.11, 0.6), (0.05, 0.9), (0.0, 1.1)]
    flame = add_turned("flame", make_material("flame", (0.0, 0.0, 0.0), **glow), size * np.array(drop),
                       (x, y, z + 0.25 * size), 16)  # fmt: skip
    flame.rotation_euler = (*random.normal(0.0, 0.06, 2), 0.0)


def add_candle(random, place, tall, wide):
    """Add a candle with a hollow of molten wax: round, ribbed or twisted, as a ball or in a cup, or a thin taper."""
    color = np.array(
        pick(random, ((0.9, 0.82, 0.65), (0.85, 0.85, 0.8), (0.75, 0.12, 0.08), draw_color(random, value=(0.4, 0.9))))
    )
    depth = {"Subsurface_Weight": 1.0, "Subsurface_Scale": wide * 10.0 ** random.uniform(-1.0, -0.1)}
    wax = make_material("wax", color, Roughness=random.uniform(0.25, 0.5), **depth)
    wax.node_tree.nodes["Principled BSDF"].inputs["Subsurface Radius"].default_value = (1.0, 0.5, 0.25)
    shape, x, y = pick(random, ("pillar", "ribbed", "ribbed", "ball", "cup", "taper")), *place
    if shape == "taper":
        tall, wide = 1.5 * tall, 0.3 * wide
        holder = make_surface(random, ("metal", "ceramic"))
        foot = [(0.0, 0.0), (3.5, 0.0), (3.3, 0.4), (0.8, 0.8), (0.7, 2.0), (1.3, 2.3), (1.3, 3.0), (0.9, 3.0)]
        add_turned("holder", holder, wide * np.array(foot), (x, y, 0.0))
    elif shape == "cup":
        tall = 0.5 * wide
        cup = make_material("cup", METALS[1], Metallic=1.0, Roughness=0.2)
        add_turned("cup", cup, [(0.0, -0.001), (1.06 * wide, -0.001), (1.1 * wide, 1.15 * tall)], (x, y, 0.0))
    top = random.uniform(0.6, 0.85)
    heights = np.linspace(0.0, 1.0, 40)
    radii = np.sqrt(1.0 - (1.5 * heights - 0.75) ** 2) * 1.4 if shape == "ball" else 1.0 - 0.1 * heights
    side = np.stack([wide * radii, (1.6 * wide if shape == "ball" else tall) * heights], -1)
    end = side[-1]
    hollow = end * [(0.97, 1.0), (0.9, 1.0), (0.88 * top, 1.0), (0.0, 1.0)]
    hollow[:, 1] += 0.12 * wide * np.array([0.3, 0.3, -1.0, -1.2])
    body = add_turned("candle", wax, [(0.0, 0.0), *side, *hollow], (x, y, 0.0), 96)
    if shape == "ribbed":
        ribs, twist = int(random.integers(4, 9)), random.uniform(-1.0, 1.0) * 3.0 / tall
        for corner in body.data.vertices:
            around = math.atan2(corner.co.y, corner.co.x) + twist * corner.co.z
            corner.co.xy *= 1.0 + 0.14 * abs(math.sin(0.5 * ribs * around))
    elif shape in ("pillar", "taper"):
        for around in random.uniform(0.0, 6.3, int(random.integers(2, 9))):
            far = wide * (0.91 if shape == "pillar" else 0.95)
            spot = (x + far * math.cos(around), y + far * math.sin(around), tall * random.uniform(0.7, 0.95))
            drip = add("uv_sphere", wax, radius=0.13 * wide, location=spot, segments=24, ring_count=12)
            drip.scale = (1.0, 1.0, random.uniform(1.5, 5.0))
    if random.random() < 0.85:
        add_flame(random, (x, y, end[1] - 0.12 * wide), max(0.075, 0.5 * wide))


def make_candle(random):
    """Candles from near, most of them lit, on a tray or a table in a dark room; a cold lamp from one side."""
    add("plane", make_surface(random, ("wood", "stone", "cloth", "tiles")), size=6)
    add("plane", make_surface(random, ("paint", "wood", "tiles")), size=6, location=(0.0, 0.9, 1.5),
        rotation=(math.pi / 2, 0.0, 0.0))  # fmt: skip
    if random.random() < 0.5:
        tray = [(0.0, 0.0), (0.62, 0.0), (0.66, 0.04), (0.64, 0.04), (0.6, 0.004), (0.0, 0.004)]
        add_turned("tray", make_surface(random, ("metal", "ceramic")), tray, (0.0, 0.0, 0.001), 96)
    for place in spread(random, int(random.integers(4, 8)), (-0.45, -0.35), (0.45, 0.4), 0.24):
        add_candle(random, place, random.uniform(0.14, 0.42), random.uniform(0.06, 0.1))
    for place in spread(random, 4, (-0.7, -0.4), (0.7, 0.6), 0.3):
        add_thing(random, make_surface(random, ("ceramic", "metal", "wood")), (*place, 0.0), random.uniform(0.06, 0.14))
    side = random.choice((-1.0, 1.0))
    add_light((1.4 * side, 0.3, 0.9), (0.0, 0.0, 0.15), random.uniform(1.0, 8.0), 0.6, (0.55, 0.75, 1.0))
    set_world((0.4, 0.5, 0.8), random.uniform(0.005, 0.05))
    far = random.uniform(0.85, 1.2)
    add_camera((random.uniform(-0.3, 0.3), -far, random.uniform(0.25, 0.5)), (0.0, 0.0, 0.16), 42.0)
    if random.random() < 0.5:
        set_focus(far, 10.0 ** random.uniform(0.2, 0.7))


def keep_faces(thing, is_kept):
    """Delete the faces of a thing whose middle does not pass."""
    mesh = bmesh.new()
    mesh.from_mesh(thing.data)
    bmesh.ops.delete(
        mesh, geom=[face for face in mesh.faces if not is_kept(face.calc_center_median())], context="FACES"
    )
    mesh.to_mesh(thing.data)
    mesh.free()
    return thing


def make_worn(random):
    """Return painted metal from images: stripes, seams, and scratches down to the metal."""
    height, across = np.mgrid[0.0:1.0:128j, 0.0:1.0:256j]
    paint, second = np.array([draw_color(random, (0.3, 0.95), (0.08, 0.8)) for _ in range(2)])
    is_striped = np.abs(across - 0.5 + random.uniform(-0.1, 0.1)) < random.uniform(0.03, 0.12)
    is_striped |= np.abs(height - random.uniform(0.2, 0.9)) < 0.04
    seam = (np.abs(across * 8.0 % 1.0 - 0.5) < 0.04) | (np.abs(height * 4.0 % 1.0 - 0.5) < 0.03)
    dirt, wear = (draw_waves(random, 3.0 * height, 4.0 * across) for _ in range(2))
    worn = (wear + random.normal(0.0, 0.12, wear.shape) > random.uniform(0.75, 0.95)).astype(float)
    for _ in range(int(random.integers(10, 50))):
        start, way = random.uniform((0, 0), (128, 256)), random.normal(0.0, 1.0, 2)
        steps = start + way * np.arange(int(random.integers(10, 40)))[:, None]
        worn[steps[:, 0].astype(int) % 128, steps[:, 1].astype(int) % 256] = 1.0
    color = np.where(is_striped[..., None], second, paint) * (0.6 + 0.4 * dirt[..., None])
    color = np.where(worn[..., None] > 0.5, pick(random, METALS[1:4]), np.where(seam[..., None], 0.3 * color, color))
    rough = (random.uniform(0.08, 0.4) + 0.35 * dirt + 0.1 * worn).clip(0.05, 1.0)
    material = make_material("worn", Coat_Weight=pick(random, (0.0, 0.6)), Coat_Roughness=0.05)
    bumps = 0.4 * dirt - 0.6 * worn - 1.5 * seam + random.normal(0.0, 0.03, dirt.shape)
    return put_maps(material, color, bumps, random.uniform(0.3, 0.8), rough, worn)


def add_helmet(random, place, size, turn):
    """Add a shell with an opening, a visor of glass before it, a dark head inside, a rim and two knobs."""
    bend = np.linspace(-0.95, math.pi / 2, 48)
    profile = 0.5 * size * np.stack([np.cos(bend), np.sin(bend) * random.uniform(1.0, 1.3)], -1)
    low, high, side = -0.24 * size, random.uniform(0.1, 0.2) * size, random.uniform(0.15, 0.3)
    middle = (place[0], place[1], place[2] + 0.52 * size)

    def is_open(spot):
        return low < spot.z < high and spot.x > side * size

    shell = keep_faces(add_turned("shell", make_worn(random), profile, middle, 128), lambda spot: not is_open(spot))
    tint = pick(random, ((1.0, 1.0, 1.0), (0.9, 0.7, 0.3), (0.5, 0.6, 0.7)))
    glass = make_material("visor", tint, Transmission_Weight=1.0, Roughness=pick(random, (0.0, 0.0, 0.08)), IOR=1.5)
    visor = keep_faces(add_turned("visor", glass, 1.015 * profile, middle, 128), is_open)
    for thing, thick in ((shell, 0.02), (visor, 0.008)):
        thing.modifiers.new("thick", "SOLIDIFY").thickness = thick * size
        thing.rotation_euler = (0.0, 0.0, turn)
    skin = make_material("skin", (0.25, 0.15, 0.1), Roughness=0.5)
    add("uv_sphere", skin, radius=0.36 * size, location=middle, segments=48, ring_count=24)
    rim = make_surface(random, ("metal", "plastic"))
    neck = (*middle[:2], middle[2] + profile[0, 1])
    add("torus", rim, major_radius=profile[0, 0], minor_radius=0.03 * size, location=neck, major_segments=64)
    for way in (-1.0, 1.0):
        around = turn + way * 1.45
        spot = (middle[0] + 0.49 * size * math.cos(around), middle[1] + 0.49 * size * math.sin(around), middle[2])
        add("cylinder", rim, radius=0.07 * size, depth=0.06 * size, location=spot, vertices=48,
            rotation=(0.0, math.pi / 2, around))  # fmt: skip


def make_helmet(random):
    """Helmets whose paint, wear and bumps lie in images, below a sky, on stone, wood or crates that images cover."""
    ground = make_surface(random, ("stone", "wood", "tiles"))
    add("plane", ground, size=30)
    make_sky(
        10.0 ** random.uniform(1.5, 3.2), 1.0, seed=int(random.integers(1000)), height_deg=random.uniform(20.0, 60.0),
        around_deg=random.uniform(-180.0, 180.0), clear=random.uniform(0.0, 1.2),
    )  # fmt: skip
    for place in spread(random, int(random.integers(2, 4)), (-0.45, -0.3), (0.45, 0.5), 0.62):
        high = 0.0 if random.random() < 0.4 else random.uniform(0.08, 0.3)
        if high:
            add_block(make_worn(random), (0.62, 0.62, high), (*place, 0.5 * high), random.uniform(0.0, 3.0), bevel=0.02)
        add_helmet(random, (*place, high), random.uniform(0.5, 0.65), -math.pi / 2 + random.uniform(-0.9, 0.9))
    for place in spread(random, 4, (-1.1, -0.8), (1.1, 1.2), 0.7):
        stone = make_material("pebble", Roughness=0.8)
        put_texture(stone, "Noise", "Base Color", scale=9.0, colors=((0.4, 0.38, 0.35), (0.12, 0.11, 0.1)), Detail=6.0)
        add_thing(random, stone, (*place, 0.0), random.uniform(0.1, 0.25), ("stone",))
    far = random.uniform(1.7, 2.3)
    add_camera((random.uniform(-0.5, 0.5), -far, random.uniform(0.5, 1.0)), (0.0, 0.05, 0.35), random.uniform(32, 40))
    if random.random() < 0.25:
        set_focus(far, 10.0 ** random.uniform(0.0, 0.5))
