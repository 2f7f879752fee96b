"""Sequences of an artist for `render_blender.py`: a camera that moves, things that move, light that changes.

Nothing is blurred, so that Cycles writes the pass Vector: it has none with motion blur. No filter is tuned or trained
on these scenes.
"""

from __future__ import annotations

import math

import bpy
from blender_parts import add, add_area, add_camera, make_material, put_texture, set_world

LENGTH = 16
"""Frames of a sequence."""


def animate(thing, path, values, length=LENGTH):
    """Move a property through values that are spread evenly over so many frames, along straight lines."""
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    for number, value in enumerate(values):
        setattr(thing, path, value)
        thing.keyframe_insert(path, frame=1 + number * (length - 1) / (len(values) - 1))


def make_hall():
    """The camera walks and turns through a hall: a polished floor, pictures, pillars, a bust, a mirror, a skylight."""
    stone = make_material("stone", Roughness=0.12, Coat_Weight=0.4, Coat_Roughness=0.05)
    put_texture(stone, "Checker", "Base Color", scale=1.4, colors=((0.7, 0.66, 0.6), (0.12, 0.1, 0.1)))
    add("plane", stone, size=16)
    wall = make_material("wall", (0.72, 0.68, 0.6), Roughness=0.85)
    add("plane", wall, size=16, location=(0.0, 6.0, 4.0), rotation=(math.pi / 2, 0.0, 0.0))
    add("plane", wall, size=16, location=(-4.0, 0.0, 4.0), rotation=(0.0, math.pi / 2, 0.0))
    pictures = (
        (6.0, ((0.9, 0.5, 0.1), (0.05, 0.1, 0.4))),
        (14.0, ((0.1, 0.4, 0.2), (0.9, 0.85, 0.6))),
        (3.0, ((0.6, 0.1, 0.1), (0.9, 0.8, 0.7))),
    )
    for number, (scale, colors) in enumerate(pictures):
        paint = make_material(f"paint{number}", Roughness=0.45)
        put_texture(paint, "Noise", "Base Color", scale=scale, colors=colors)
        picture = add("cube", paint, size=1.0, location=(-2.4 + 2.3 * number, 5.95, 1.9))
        picture.scale = (1.5, 0.08, 1.2)
    marble = make_material("marble", Roughness=0.25)
    put_texture(marble, "Wave", "Base Color", scale=1.2, colors=((0.8, 0.78, 0.75), (0.45, 0.43, 0.42)))
    for number in range(3):
        add("cylinder", marble, radius=0.22, depth=4.0, location=(-2.2 + 2.4 * number, 3.4, 2.0), vertices=64)
    bronze = make_material("bronze", (0.75, 0.5, 0.25), Roughness=0.22, Metallic=1.0)
    plinth = make_material("plinth", (0.15, 0.15, 0.17), Roughness=0.3)
    add("cube", plinth, size=0.8, location=(0.9, 1.6, 0.4))
    add("monkey", bronze, size=0.7, location=(0.9, 1.6, 1.2), rotation=(-0.4, 0.0, 0.2))
    chrome = make_material("chrome", (0.93, 0.93, 0.95), Roughness=0.03, Metallic=1.0)
    add("uv_sphere", chrome, radius=0.45, location=(-1.2, 1.2, 0.45), segments=64, ring_count=32)
    mirror = add("plane", chrome, size=1.0, location=(-3.95, 3.0, 1.6), rotation=(0.0, math.pi / 2, 0.0))
    mirror.scale = (2.2, 1.6, 1.0)
    add_area((0.0, 2.0, 4.5), (0.0, 0.0, 0.0), 1.6, 260.0, (1.0, 0.95, 0.85))
    add_area((2.5, 4.6, 3.2), (0.8, 0.3, 0.0), 0.4, 60.0, (1.0, 0.8, 0.55))
    set_world((0.55, 0.7, 1.0), 0.25)
    add_camera((1.4, -4.2, 1.6), (-0.2, 3.0, 1.3), 52.0)
    camera = bpy.context.object
    animate(camera, "location", ((1.4, -4.2, 1.6), (0.9, -3.6, 1.55), (0.2, -3.1, 1.6)))
    turn = tuple(camera.rotation_euler)
    animate(camera, "rotation_euler", (turn, (turn[0], turn[1], turn[2] - 0.12)))


def make_juggler():
    """Balls fly past each other and a ring spins over a glossy table; the camera rests."""
    table = make_material("table", Roughness=0.18)
    put_texture(table, "Wave", "Base Color", scale=2.0, colors=((0.35, 0.2, 0.1), (0.2, 0.1, 0.05)))
    add("plane", table, size=12)
    cloth = make_material("cloth", Roughness=0.9)
    put_texture(cloth, "Voronoi", "Base Color", scale=4.0, colors=((0.55, 0.1, 0.15), (0.8, 0.7, 0.5)))
    add("plane", cloth, size=12, location=(0.0, 3.5, 3.0), rotation=(math.pi / 2, 0.0, 0.0))
    gold = make_material("gold", (0.95, 0.72, 0.35), Roughness=0.15, Metallic=1.0)
    rubber = make_material("rubber", (0.1, 0.35, 0.7), Roughness=0.55)
    lacquer = make_material("lacquer", (0.05, 0.45, 0.2), Roughness=0.35, Coat_Weight=1.0, Coat_Roughness=0.04)
    paths = (
        (gold, 0.42, ((-1.9, 0.2, 0.9), (-0.9, 0.2, 1.9), (0.2, 0.2, 2.1))),
        (rubber, 0.38, ((1.8, -0.3, 1.9), (1.0, -0.3, 1.2), (0.1, -0.3, 0.6))),
        (lacquer, 0.4, ((-0.3, 1.2, 0.5), (0.2, 1.2, 1.0), (0.6, 1.2, 1.7))),
    )
    for number, (material, radius, path) in enumerate(paths):
        ball = add("uv_sphere", material, radius=radius, location=path[0], segments=64, ring_count=32)
        ball.name = f"ball{number}"
        animate(ball, "location", path)
    steel = make_material("steel", (0.75, 0.77, 0.8), Roughness=0.28, Metallic=1.0)
    ring = add(
        "torus", steel, major_radius=0.55, minor_radius=0.14, location=(1.5, 0.9, 0.75), major_segments=96,
        minor_segments=32,
    )  # fmt: skip
    animate(ring, "rotation_euler", ((0.5, 0.0, 0.0), (1.6, 0.3, 0.9)))
    clay = make_material("clay", (0.7, 0.45, 0.3), Roughness=0.75)
    add("monkey", clay, size=0.8, location=(-1.7, 1.6, 0.5), rotation=(-0.5, 0.0, 0.4))
    add_area((-2.5, -2.5, 4.0), (0.6, -0.5, 0.0), 1.2, 320.0)
    add_area((3.0, 0.0, 2.2), (0.0, 1.1, 0.0), 0.3, 60.0, (1.0, 0.75, 0.5))
    set_world((0.6, 0.7, 0.9), 0.25)
    add_camera((0.0, -5.6, 2.0), (0.0, 0.4, 0.95), 42.0)


def make_lamps():
    """A still life below lamps: one goes out, one changes its colour, one flies by; the camera drifts."""
    plaster = make_material("plaster", (0.7, 0.7, 0.72), Roughness=0.8)
    add("plane", plaster, size=10, location=(0.0, 2.6, 2.0), rotation=(math.pi / 2, 0.0, 0.0))
    slate = make_material("slate", Roughness=0.22)
    put_texture(slate, "Noise", "Base Color", scale=5.0, colors=((0.1, 0.12, 0.15), (0.4, 0.38, 0.35)))
    add("plane", slate, size=10)
    copper = make_material("copper", (0.9, 0.55, 0.4), Roughness=0.2, Metallic=1.0)
    add("uv_sphere", copper, radius=0.5, location=(-0.9, 0.5, 0.5), segments=64, ring_count=32)
    china = make_material("china", (0.85, 0.86, 0.9), Roughness=0.3, Coat_Weight=1.0, Coat_Roughness=0.03)
    add("torus", china, major_radius=0.45, minor_radius=0.2, location=(0.5, 0.0, 0.2), major_segments=96,
        minor_segments=48)  # fmt: skip
    glass = make_material("glass", (0.95, 1.0, 0.98), Roughness=0.0, Transmission_Weight=1.0, IOR=1.5)
    add("cylinder", glass, radius=0.25, depth=0.9, location=(1.5, 0.9, 0.455), vertices=96)
    wood = make_material("wood", Roughness=0.4)
    put_texture(wood, "Wave", "Base Color", scale=3.0, colors=((0.5, 0.32, 0.18), (0.3, 0.17, 0.08)))
    add("cube", wood, size=0.8, location=(0.4, 1.5, 0.4), rotation=(0.0, 0.0, 0.5))
    add_area((-2.2, -0.5, 2.6), (0.3, -0.6, 0.0), 0.5, 130.0, (1.0, 0.85, 0.65))
    animate(bpy.context.object.data, "energy", (130.0, 90.0, 4.0))
    add_area((2.4, -0.8, 2.4), (0.3, 0.7, 0.0), 0.8, 60.0)
    animate(bpy.context.object.data, "color", ((0.5, 0.7, 1.0), (1.0, 0.5, 0.3)))
    glow = make_material("glow", (0.0, 0.0, 0.0), Emission_Color=(1.0, 0.9, 0.7, 1.0), Emission_Strength=60.0)
    lamp = add("uv_sphere", glow, radius=0.07, location=(-1.8, -0.3, 1.2), segments=24, ring_count=12)
    animate(lamp, "location", ((-1.6, 0.0, 1.3), (0.0, -0.4, 1.0), (1.5, 0.2, 1.4)))
    set_world((0.5, 0.6, 0.8), 0.08)
    add_camera((0.1, -4.4, 1.7), (0.1, 0.6, 0.6), 38.0)
    camera = bpy.context.object
    animate(camera, "location", (tuple(camera.location), (0.35, -4.3, 1.75)))


FILMS = {"hall": make_hall, "juggler": make_juggler, "lamps": make_lamps}
