"""Crowds of small things for `render_blender.py`, in focus and out of it: lamps, leaves, grass, bars; and a fog.

Most pixels of these scenes show several objects. In focus their emission and their sky have hardly any noise; out of
focus, in motion and in the fog few samples choose what a pixel shows. No filter is trained on these scenes.
"""

from __future__ import annotations

import math

import bpy
import numpy as np
from blender_parts import add, add_air, add_area, add_camera, make_material, put_texture, set_world
from blender_shots import add_glow, animate, make_sky, set_focus

TINTS = ((1.0, 0.55, 0.2), (1.0, 0.1, 0.08), (0.15, 0.9, 0.25), (0.2, 0.4, 1.0), (1.0, 0.85, 0.6))
"""Colors of the lamps, in turn."""


def add_faces(name, material, corners):
    """Add an object of polygons: ``corners`` (polygons, corners of each, 3)."""
    count, each, _ = corners.shape
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners.reshape(-1, 3).tolist(), [], np.arange(count * each).reshape(count, each).tolist())
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(thing)
    return thing


def add_lamps(places, radius, strength):
    """Add small lamps of several colors, each an object; return them."""
    lamps = []
    for number, place in enumerate(places):
        tint = TINTS[number % len(TINTS)]
        name = f"lamp{number}"
        lamps.append(add_glow(name, tint, strength, radius=radius, location=place, segments=10, ring_count=5))
    return lamps


def hang_strings(rows, columns, width, height, sag):
    """Return the places of lamps (rows, columns, 3) on strings that sag, in the plane y = 0, and add the wires."""
    wire = make_material("wire", (0.02, 0.05, 0.02), Roughness=0.5)
    across = np.linspace(-0.5, 0.5, columns)
    places = np.zeros((rows, columns, 3))
    for row in range(rows):
        places[row, :, 0] = width * across
        places[row, :, 2] = height * (row + 0.5) / rows + sag * (4.0 * across**2 - 1.0) * (1.0 + 0.3 * (row % 3))
        first, second = places[row, :-1], places[row, 1:]
        up = np.array([0.0, 0.0, 0.006])
        add_faces(f"wire{row}", wire, np.stack([first - up, second - up, second + up, first + up], axis=1))
    return places


def make_wall(power):
    """Put up a wall of coarse plaster at y = 0.4 and a floor, and light them with a lamp of some watts."""
    plaster = make_material("plaster", Roughness=0.8)
    put_texture(plaster, "Voronoi", "Base Color", scale=4.0, colors=((0.2, 0.16, 0.12), (0.5, 0.45, 0.4)))
    add("plane", plaster, size=12, location=(0.0, 0.4, 2.0), rotation=(math.pi / 2, 0.0, 0.0))
    boards = make_material("boards", Roughness=0.3)
    put_texture(boards, "Wave", "Base Color", scale=2.0, colors=((0.4, 0.25, 0.15), (0.2, 0.12, 0.07)))
    add("plane", boards, size=12)
    add_area((-2.5, -3.0, 4.0), (0.7, -0.5, 0.0), 1.0, power)
    set_world((0.4, 0.5, 0.8), 0.05)


def make_string():
    """A curtain of small lamps on strings before a lit wall, all of it sharp."""
    make_wall(200.0)
    places = hang_strings(18, 40, 3.6, 2.4, 0.25)
    add_lamps(places.reshape(-1, 3) + np.array([0.0, -0.01, 0.03]), 0.02, 5.0)
    add_camera((0.3, -4.6, 1.4), (0.0, 0.0, 1.2), 42.0)


def make_bokeh():
    """A figure in focus before strings of lamps that are far out of it."""
    make_wall(30.0)
    places = hang_strings(6, 12, 5.0, 2.8, 0.3)
    add_lamps(places.reshape(-1, 3), 0.03, 40.0)
    bronze = make_material("bronze", (0.75, 0.5, 0.25), Roughness=0.25, Metallic=1.0)
    add("monkey", bronze, size=0.5, location=(0.35, -3.3, 0.95), rotation=(-0.2, 0.0, 0.4))
    paper = make_material("paper", Roughness=0.7)
    put_texture(paper, "Checker", "Base Color", scale=12.0, colors=((0.85, 0.83, 0.75), (0.1, 0.25, 0.15)))
    add("cube", paper, size=0.35, location=(-0.4, -3.2, 0.8), rotation=(0.0, 0.0, 0.5))
    add_area((-1.0, -5.0, 2.5), (0.6, -0.2, 0.0), 0.5, 30.0)
    add_camera((0.0, -5.2, 1.1), (0.0, 0.0, 1.15), 44.0)
    set_focus(1.85, 0.25)


def make_passing():
    """Lamps on wheels that turn with the shutter open, before a lit wall at rest."""
    make_wall(100.0)
    for number, (x, z, radius, count) in enumerate(((-0.9, 1.4, 0.8, 18), (0.9, 1.1, 0.6, 12), (1.1, 2.0, 0.25, 5))):
        bpy.ops.object.empty_add(location=(x, -0.1, z))
        hub = bpy.context.object
        turns = 2.0 * math.pi * np.arange(count) / count
        places = radius * np.stack([np.cos(turns), np.zeros(count), np.sin(turns)], axis=-1)
        for lamp in add_lamps(places, 0.035, 20.0):
            lamp.parent = hub
        animate(hub, "rotation_euler", (0.0, 0.0, 0.0), (0.0, (-1.0) ** number * 2.2, 0.0))
    scene = bpy.context.scene
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.6
    scene.frame_set(3)
    add_camera((0.2, -4.6, 1.4), (0.0, 0.0, 1.3), 42.0)


def make_foliage():
    """Leaves and twigs before a bright sky, all of it sharp."""
    random = np.random.default_rng(11)
    leaf = make_material("leaf", (0.12, 0.3, 0.05), Roughness=0.4)
    for bunch in range(60):
        middle = random.uniform((-1.9, -0.4, 0.9), (1.9, 0.8, 3.0))
        count = 70
        root = middle + random.normal(0.0, 0.2, (count, 3))
        along, aside = (random.normal(size=(count, 3)) for _ in range(2))
        along *= 0.13 / np.linalg.norm(along, axis=1, keepdims=True)
        aside *= 0.03 / np.linalg.norm(aside, axis=1, keepdims=True)
        corners = np.stack([root, root + along / 2 + aside, root + along, root + along / 2 - aside], axis=1)
        add_faces(f"bunch{bunch}", leaf, corners)
    bark = make_material("bark", (0.15, 0.1, 0.06), Roughness=0.8)
    add("cylinder", bark, radius=0.09, depth=3.0, location=(0.3, 0.5, 1.2), vertices=24)
    for number in range(14):
        tilt = (random.uniform(-1.2, 1.2), random.uniform(-1.2, 1.2), 0.0)
        place = (random.uniform(-1.2, 1.2), 0.4, random.uniform(1.2, 2.6))
        twig = add("cylinder", bark, radius=0.012, depth=1.6, location=place, rotation=tilt, vertices=8)
        twig.name = f"twig{number}"
    soil = make_material("soil", (0.3, 0.25, 0.15), Roughness=0.9)
    add("plane", soil, size=20)
    make_sky(600.0, 2.5)
    add_camera((0.0, -4.6, 1.2), (0.0, 0.0, 1.7), 42.0)


def make_grass():
    """A meadow against the light, each tuft an object, and a few stones; all of it sharp."""
    random = np.random.default_rng(12)
    blade = make_material("blade", (0.2, 0.4, 0.08), Roughness=0.35)
    for tuft in range(260):
        place = np.array([random.uniform(-2.4, 2.4), random.uniform(-2.2, 4.0), 0.0])
        count = 45
        root = place + np.append(random.normal(0.0, 0.09, (count, 2)), np.zeros((count, 1)), axis=1)
        lean = random.normal(0.0, 0.1, (count, 3)) * (1.0, 1.0, 0.0)
        height = np.array([0.0, 0.0, 1.0]) * random.uniform(0.25, 0.6, (count, 1))
        turn = random.uniform(0.0, math.pi, count)
        aside = 0.008 * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=-1)
        middle, top = root + 0.6 * height + 0.4 * lean, root + height + 1.6 * lean
        corners = np.stack([root - aside, root + aside, middle + aside, top, middle - aside], axis=1)
        add_faces(f"tuft{tuft}", blade, corners)
    soil = make_material("soil", (0.2, 0.15, 0.08), Roughness=0.9)
    add("plane", soil, size=30)
    stone = make_material("stone", (0.5, 0.48, 0.45), Roughness=0.6)
    for number, place in enumerate(((-0.7, -1.2, 0.1), (0.8, -0.6, 0.15), (0.1, 0.9, 0.2))):
        add("uv_sphere", stone, radius=0.22 + 0.05 * number, location=place, segments=32, ring_count=16)
    make_sky(600.0, 2.0)
    add_camera((0.0, -4.2, 0.75), (0.0, 0.0, 0.4), 40.0)


def make_fence():
    """A fence of bars and a wire mesh that recede before a bright sky, all of it sharp."""
    paint = make_material("paint", (0.6, 0.62, 0.65), Roughness=0.3)
    for number in range(90):
        bar = add("cube", paint, size=1.0, location=(-1.6 + 0.09 * number, -1.5 + 0.16 * number, 0.6))
        bar.scale = (0.025, 0.025, 1.2)
    wire = make_material("wire", (0.4, 0.42, 0.45), Roughness=0.25, Metallic=1.0)
    for number in range(44):
        for slope in (-1.0, 1.0):
            place = (-2.6 + 0.07 * number, -0.6, 1.0)
            line = add("cylinder", wire, radius=0.006, depth=2.6, location=place, rotation=(0.0, slope * 0.7, 0.0))
            line.name = f"wire{number} {slope}"
    for height in (0.15, 1.05):
        rail = add("cube", paint, size=1.0, location=(2.4, 5.6, height), rotation=(0.0, 0.0, math.atan2(0.16, 0.09)))
        rail.scale = (16.4, 0.03, 0.05)
    ground = make_material("ground", Roughness=0.8)
    put_texture(ground, "Noise", "Base Color", scale=6.0, colors=((0.35, 0.4, 0.15), (0.2, 0.2, 0.1)))
    add("plane", ground, size=60)
    make_sky(600.0, 2.0)
    add_camera((0.0, -4.0, 1.0), (0.0, 0.0, 0.95), 44.0)


def make_fog():
    """A hall in thin fog: a lamp shines through bars, things stand in it, behind it all is a dim sky."""
    slate = make_material("slate", Roughness=0.4)
    put_texture(slate, "Noise", "Base Color", scale=3.0, colors=((0.3, 0.28, 0.25), (0.15, 0.15, 0.17)))
    add("plane", slate, size=14)
    clay = make_material("clay", (0.7, 0.4, 0.25), Roughness=0.6)
    add("monkey", clay, size=1.4, location=(-1.0, 0.0, 0.7), rotation=(-0.4, 0.0, 0.4))
    gold = make_material("gold", (0.95, 0.7, 0.3), Roughness=0.2, Metallic=1.0)
    add("uv_sphere", gold, radius=0.5, location=(0.9, -0.4, 0.5), segments=64, ring_count=32)
    for number in range(5):
        bar = add("cube", clay, size=1.0, location=(-1.6 + 0.8 * number, 2.4, 1.6))
        bar.scale = (0.35, 0.1, 3.2)
    add_air(0.09, 12.0, (0.0, 0.0, 5.5))
    add_glow("lamp", (1.0, 0.8, 0.5), 60.0, radius=0.15, location=(0.6, 3.4, 2.2), segments=32, ring_count=16)
    add_area((-3.0, -2.0, 4.0), (0.6, -0.6, 0.0), 0.8, 150.0, (0.7, 0.85, 1.0))
    set_world((0.25, 0.35, 0.6), 0.3)
    add_camera((0.0, -5.2, 1.5), (0.0, 0.0, 1.1), 46.0)


CROWDS = {
    "string": make_string,
    "bokeh": make_bokeh,
    "passing": make_passing,
    "foliage": make_foliage,
    "grass": make_grass,
    "fence": make_fence,
    "fog": make_fog,
}
