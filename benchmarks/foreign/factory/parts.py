"""What the scenes of the factory are drawn from: colors, surfaces, pictures, things, lamps, places."""

import colorsys
import math

import bpy
import numpy as np
from blender_parts import add, aim, make_material, put_texture
from mathutils import Matrix

WOOD = np.array((0.45, 0.27, 0.14))
METALS = ((0.95, 0.7, 0.3), (0.9, 0.9, 0.92), (0.9, 0.55, 0.4), (0.6, 0.6, 0.63), (0.75, 0.5, 0.25))
"""Gold, silver, copper, steel, bronze."""
SURFACES = {
    "wood": ("Wave", (1.2, 4.0), {"Distortion": 4.0, "Detail": 3.0}, {"Roughness": (0.2, 0.55), "Coat_Weight": (0, 1)}),
    "stone": ("Noise", (1.5, 8.0), {"Detail": 8.0}, {"Roughness": (0.1, 0.8)}),
    "tiles": ("Brick", (1.5, 4.0), {}, {"Roughness": (0.08, 0.45)}),
    "check": ("Checker", (1.5, 6.0), {}, {"Roughness": (0.1, 0.5)}),
    "cloth": ("Voronoi", (8.0, 30.0), {}, {"Roughness": (0.8, 1.0), "Sheen_Weight": (0.2, 1.0)}),
    "paint": ("Noise", (0.5, 2.0), {}, {"Roughness": (0.25, 0.75)}),
    "plastic": (None, (1.0, 1.0), {}, {"Roughness": (0.1, 0.6)}),
    "ceramic": (None, (1.0, 1.0), {}, {"Roughness": (0.3, 0.6), "Coat_Weight": (1, 1), "Coat_Roughness": (0.0, 0.1)}),
    "metal": (None, (1.0, 1.0), {}, {"Roughness": (0.02, 0.5), "Metallic": (1, 1)}),
}
"""By name: a texture of Blender, its scale per metre, its other inputs, and bounds of the material's inputs."""
SHAPES = ("ball", "ring", "block", "monkey", "vase", "drum", "stone")


def pick(random, choices):
    """Return one of them."""
    return choices[int(random.integers(len(choices)))]


def draw_color(random, saturation=(0.1, 0.75), value=(0.15, 0.8)):
    """Return a color of any hue."""
    return colorsys.hsv_to_rgb(random.uniform(), random.uniform(*saturation), random.uniform(*value))


def draw_pair(random):
    """Return a bright and a dark color for a texture; mostly of near hues."""
    hue, apart = random.uniform(), random.normal(0.0, 0.08)
    bright = colorsys.hsv_to_rgb(hue, random.uniform(0.05, 0.6), random.uniform(0.4, 0.85))
    return bright, colorsys.hsv_to_rgb((hue + apart) % 1.0, random.uniform(0.1, 0.8), random.uniform(0.04, 0.35))


def warm(random):
    """Return the color of a lamp, between candles and a blue sky."""
    place = random.uniform()
    return (1.0, 0.6 + 0.35 * place, 0.25 + 0.7 * place) if random.random() < 0.7 else (0.65, 0.8, 1.0)


def make_surface(random, families=tuple(SURFACES)):
    """Return a material of one of some families: colors, scale of its texture, roughness, bumps are drawn."""
    family = pick(random, families)
    kind, scales, more, bounds = SURFACES[family]
    inputs = {name: float(random.uniform(*each)) for name, each in bounds.items()}
    colors = draw_pair(random)
    if family == "wood":
        shade = random.uniform(0.4, 1.5)
        colors = tuple(WOOD * shade), tuple(WOOD * shade * random.uniform(0.25, 0.6))
    material = make_material(family, pick(random, METALS) if family == "metal" else colors[0], **inputs)
    if kind:
        put_texture(material, kind, "Base Color", scale=random.uniform(*scales), colors=colors, **more)
    if random.random() < 0.35:
        low = inputs["Roughness"]
        put_texture(material, "Noise", "Roughness", scale=random.uniform(2.0, 9.0), low=0.6 * low, high=1.5 * low)
    if random.random() < (0.9 if family == "cloth" else 0.3):
        put_texture(material, "Noise", "Normal", scale=random.uniform(6.0, 60.0), bump=random.uniform(0.05, 0.3))
    return material


def put_image(material, image, to="Base Color"):
    """Drive a color of a material by an image over the UV map."""
    tree = material.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    tree.links.new(texture.outputs["Color"], tree.nodes["Principled BSDF"].inputs[to])
    return material


def add_block(material, size, place, turn=0.0, bevel=0.0):
    """Add a box of this size; ``bevel`` in metres."""
    thing = add("cube", material, size=1.0, location=place, rotation=(0.0, 0.0, turn))
    thing.data.transform(Matrix.Diagonal((*size, 1.0)))
    if bevel:
        rounded = thing.modifiers.new("bevel", "BEVEL")
        rounded.width, rounded.segments = bevel, 3
    return thing


def add_turned(name, material, profile, place, segments=48, smooth=True):
    """Add what a lathe makes of a profile (points, radius and height); its UV map has the turn and the profile."""
    profile = np.asarray(profile, dtype=float)
    turns = 2.0 * math.pi * np.arange(segments) / segments
    ring = np.stack([np.cos(turns), np.sin(turns)], -1)
    points = np.concatenate([profile[:, None, :1] * ring, np.repeat(profile[:, None, 1:], segments, 1)], -1)
    row, turn = (each.ravel() for each in np.meshgrid(np.arange(len(profile) - 1), np.arange(segments), indexing="ij"))
    corners = [(row, turn), (row, turn + 1), (row + 1, turn + 1), (row + 1, turn)]
    mesh = bpy.data.meshes.new(name)
    faces = np.stack([each * segments + around % segments for each, around in corners], -1)
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], faces.tolist())
    places = np.stack([np.stack([around / segments, each / (len(profile) - 1)], -1) for each, around in corners], 1)
    mesh.uv_layers.new().uv.foreach_set("vector", places.astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(faces))
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    thing.location = place
    bpy.context.collection.objects.link(thing)
    return thing


def draw_profile(random, height, radius, count=40):
    """Return the profile of a vase: closed below, open above."""
    knots = radius * random.uniform(0.35, 1.0, 5)
    heights = np.linspace(0.0, 1.0, count)
    radii = sum(knot * math.comb(4, i) * heights**i * (1 - heights) ** (4 - i) for i, knot in enumerate(knots))
    return [(0.0, 0.0), *np.stack([radii, height * heights], -1)]


def add_thing(random, material, place, size, shapes=SHAPES):
    """Add one of some shapes, about as large as ``size``, that stands on a place."""
    x, y, z = place
    shape, half, turn = pick(random, shapes), 0.5 * size, random.uniform(0.0, 2.0 * math.pi)
    if shape == "ball":
        return add("uv_sphere", material, radius=half, location=(x, y, z + half), segments=64, ring_count=32)
    if shape == "ring":
        thin = half * random.uniform(0.15, 0.35)
        return add("torus", material, major_radius=half - thin, minor_radius=thin, location=(x, y, z + thin),
                   major_segments=72, minor_segments=24)  # fmt: skip
    if shape == "block":
        sides = size * random.uniform(0.5, 1.1, 3)
        return add_block(material, sides, (x, y, z + 0.5 * sides[2]), turn, bevel=0.04 * size)
    if shape == "monkey":
        return add(
            "monkey", material, size=size, location=(x, y, z + 0.45 * size), rotation=(-0.4, 0.0, 0.6 * turn - 1.9)
        )
    if shape == "vase":
        return add_turned("vase", material, draw_profile(random, size * random.uniform(0.8, 1.5), 0.6 * size), place)
    if shape == "drum":
        tall = size * random.uniform(0.3, 1.2)
        thing = add("cylinder", material, radius=half, depth=tall, location=(x, y, z + 0.5 * tall), vertices=64)
        thing.modifiers.new("bevel", "BEVEL").width = 0.05 * size
        return thing
    thing = add("ico_sphere", material, subdivisions=5, radius=half, location=(x, y, z + 0.4 * size))
    spots = np.empty(3 * len(thing.data.vertices), np.float32)
    thing.data.vertices.foreach_get("co", spots)
    spots = spots.reshape(-1, 3)
    spots *= (
        1.0 + 0.08 * np.sin(spots @ random.normal(0.0, 3.0 / half, (3, 4)) + random.uniform(0, 6, 4)).sum(-1)[:, None]
    )
    thing.data.vertices.foreach_set("co", spots.ravel())
    thing.data.shade_smooth()
    return thing


def spread(random, count, low, high, gap):
    """Return up to ``count`` places (count, 2) within a rectangle, no two nearer than ``gap``."""
    found = []
    for _ in range(30 * count):
        place = random.uniform(low, high)
        if len(found) < count and all(np.hypot(*(place - other)) > gap for other in found):
            found.append(place)
    return np.array(found)


def add_light(location, target, power, size, color=(1.0, 1.0, 1.0), kind="AREA"):
    """Add a lamp that shines at a point: an area or a spot, ``size`` in metres; or a sun, in degrees."""
    bpy.ops.object.light_add(type=kind, location=location, rotation=aim(location, target))
    light = bpy.context.object.data
    light.energy, light.color = power, color
    if kind == "AREA":
        light.size = size
    elif kind == "SUN":
        light.angle = math.radians(size)
    else:
        light.shadow_soft_size, light.spot_size, light.spot_blend = size, math.radians(50.0), 0.3
    return light


def add_lights(random, target, distance, count, power=100.0):
    """Light a place by some area lamps around and above it, which stand behind the camera or beside it."""
    for _ in range(count):
        around, up = random.uniform(-2.6, 0.4), random.uniform(0.5, 1.2)
        way = np.array([math.cos(around) * math.cos(up), math.sin(around) * math.cos(up), math.sin(up)])
        size = distance * 10.0 ** random.uniform(-1.5, -0.3)
        add_light(target + distance * way, target, power * distance**2 * random.uniform(0.3, 1.0), size, warm(random))
