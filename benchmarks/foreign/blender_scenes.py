"""The scenes of gloss, textures, glass and a room for `render_blender.py`: still, sharp everywhere, plain materials."""

from __future__ import annotations

import math

from blender_parts import add, add_area, add_camera, make_material, put_texture, set_world


def make_gloss():
    """Balls and a block of metals and plastics, from mirror to rough, on a chequered floor of varnish."""
    floor = make_material("floor", Roughness=0.25)
    put_texture(floor, "Checker", "Base Color", scale=1.5, colors=((0.6, 0.55, 0.5), (0.12, 0.1, 0.1)))
    add("plane", floor, size=20)
    for number, rough in enumerate((0.02, 0.15, 0.35, 0.6)):
        metal = make_material(f"metal{number}", (0.9, 0.75 - 0.1 * number, 0.45), Roughness=rough, Metallic=1.0)
        add("uv_sphere", metal, radius=0.7, location=(-2.4 + 1.6 * number, 1.2, 0.7), segments=48, ring_count=24)
        plastic = make_material(f"plastic{number}", (0.1 + 0.2 * number, 0.3, 0.7 - 0.2 * number), Roughness=rough)
        add("uv_sphere", plastic, radius=0.45, location=(-2.0 + 1.35 * number, -0.7, 0.45), segments=48, ring_count=24)
    brushed = make_material("brushed", (0.8, 0.8, 0.85), Roughness=0.3, Metallic=1.0)
    block = add("cube", brushed, size=1.6, location=(0.4, 3.4, 0.8))
    block.rotation_euler[2] = 0.5
    add_area((-4.0, -3.0, 5.0), (0.6, -0.6, 0.0), 1.5, 500.0)
    add_area((4.0, 2.0, 4.0), (0.0, 0.9, 0.3), 0.6, 200.0, (1.0, 0.7, 0.4))
    set_world((0.5, 0.6, 0.8), 0.3)
    add_camera((0.0, -7.5, 3.2), (0.0, 0.8, 0.5), 42.0)


def make_textured():
    """Textured albedo, roughness and bumps."""
    floor = make_material("tiles", Roughness=0.3)
    put_texture(floor, "Noise", "Base Color", scale=6.0, colors=((0.7, 0.5, 0.3), (0.2, 0.1, 0.05)))
    put_texture(floor, "Checker", "Roughness", scale=3.0, low=0.1, high=0.5)
    add("plane", floor, size=20)
    wall = make_material("wall", Roughness=0.6)
    put_texture(wall, "Voronoi", "Base Color", scale=5.0, colors=((0.1, 0.3, 0.4), (0.8, 0.8, 0.7)))
    back = add("plane", wall, size=12, location=(0.0, 3.5, 3.0))
    back.rotation_euler[0] = math.pi / 2
    bumped = make_material("bumped", (0.7, 0.2, 0.15), Roughness=0.25)
    put_texture(bumped, "Noise", "Normal", scale=12.0, bump=0.4)
    add("uv_sphere", bumped, radius=0.9, location=(-1.6, 0.3, 0.9), segments=64, ring_count=32)
    worn = make_material("worn", (0.85, 0.8, 0.7), Metallic=1.0)
    put_texture(worn, "Noise", "Roughness", scale=5.0, low=0.0, high=0.7)
    add("monkey", worn, size=2.0, location=(1.2, 0.2, 1.0))
    paint = make_material("paint", Roughness=0.15, Coat_Weight=1.0)
    put_texture(paint, "Wave", "Base Color", scale=2.0, colors=((0.8, 0.1, 0.1), (0.9, 0.9, 0.9)))
    add("cube", paint, size=0.9, location=(-0.1, -1.3, 0.45))
    add_area((-3.0, -4.0, 5.0), (0.7, -0.4, 0.0), 2.0, 600.0)
    set_world((0.8, 0.85, 1.0), 0.25)
    add_camera((0.0, -6.5, 2.6), (0.0, 0.5, 0.9), 45.0)


def make_glass():
    """Smooth and rough glass, liquid colors, before stripes."""
    floor = make_material("floor", Roughness=0.5)
    put_texture(floor, "Wave", "Base Color", scale=1.0, colors=((0.75, 0.7, 0.6), (0.25, 0.3, 0.35)))
    add("plane", floor, size=20)
    for number, rough in enumerate((0.0, 0.1, 0.3)):
        glass = make_material(
            f"glass{number}", (1.0 - 0.1 * number, 0.98, 0.9), Roughness=rough, Transmission_Weight=1.0, IOR=1.45
        )
        add("uv_sphere", glass, radius=0.7, location=(-1.8 + 1.8 * number, 0.0, 0.7), segments=64, ring_count=32)
    cup = make_material("cup", (0.6, 0.9, 0.7), Roughness=0.05, Transmission_Weight=1.0, IOR=1.33)
    add("cylinder", cup, radius=0.4, depth=0.9, location=(0.9, -1.4, 0.46), vertices=64)
    ring = make_material("ring", (0.95, 0.7, 0.3), Roughness=0.2, Metallic=1.0)
    add("torus", ring, major_radius=0.55, minor_radius=0.15, location=(-1.0, -1.5, 0.16))
    wax = make_material("wax", (0.9, 0.6, 0.4), Roughness=0.4, Subsurface_Weight=1.0)
    add("cube", wax, size=1.0, location=(2.9, 1.5, 0.5))
    add_area((3.0, 3.0, 5.0), (-0.6, 0.6, 0.0), 1.0, 500.0)
    set_world((0.7, 0.8, 1.0), 0.5)
    add_camera((0.0, -6.5, 2.8), (0.2, 0.0, 0.5), 42.0)


def make_room():
    """A closed room with a lamp that glows, a window to the sky, a varnished table and a mirror."""
    wall = make_material("wall", (0.75, 0.72, 0.68), Roughness=0.9)
    wood = make_material("wood", Roughness=0.25)
    put_texture(wood, "Wave", "Base Color", scale=1.2, colors=((0.45, 0.25, 0.12), (0.2, 0.1, 0.05)))

    def panel(material, size, location, turn=(0.0, 0.0, 0.0)):
        thing = add("plane", material, size=1.0, location=location, rotation=turn)
        thing.scale = (*size, 1.0)
        return thing

    right = math.pi / 2
    panel(wood, (6.0, 6.0), (0.0, 0.0, 0.0))
    panel(wall, (6.0, 6.0), (0.0, 0.0, 3.0))
    panel(wall, (6.0, 3.0), (0.0, 3.0, 1.5), (right, 0.0, 0.0))
    panel(wall, (6.0, 3.0), (0.0, -3.0, 1.5), (right, 0.0, 0.0))
    red = make_material("red", (0.6, 0.15, 0.1), Roughness=0.8)
    panel(red, (3.0, 6.0), (3.0, 0.0, 1.5), (0.0, right, 0.0))
    # The left wall leaves a window of 1.6 x 1.4.
    panel(wall, (0.9, 6.0), (-3.0, 0.0, 0.45), (0.0, right, 0.0))
    panel(wall, (0.7, 6.0), (-3.0, 0.0, 2.65), (0.0, right, 0.0))
    panel(wall, (1.4, 2.6), (-3.0, -1.7, 1.6), (0.0, right, 0.0))
    panel(wall, (1.4, 1.4), (-3.0, 2.3, 1.6), (0.0, right, 0.0))
    table = make_material("table", (0.5, 0.5, 0.55), Roughness=0.12)
    top = add("cube", table, size=1.0, location=(0.2, 0.9, 0.75))
    top.scale = (1.8, 1.0, 0.06)
    for x in (-0.6, 1.0):
        leg = add("cube", wood, size=1.0, location=(x, 0.9, 0.36))
        leg.scale = (0.08, 0.8, 0.72)
    pot = make_material("pot", (0.9, 0.85, 0.8), Roughness=0.1, Metallic=1.0)
    add("uv_sphere", pot, radius=0.28, location=(-0.2, 0.8, 1.06), segments=48, ring_count=24)
    vase = make_material("vase", (0.2, 0.4, 0.6), Roughness=0.3)
    add("cylinder", vase, radius=0.15, depth=0.5, location=(0.7, 1.0, 1.03), vertices=48)
    mirror = make_material("mirror", (0.95, 0.95, 0.95), Roughness=0.0, Metallic=1.0)
    panel(mirror, (1.4, 1.1), (1.2, 2.98, 1.7), (right, 0.0, 0.0))
    glow = make_material("glow", (0.0, 0.0, 0.0), Emission_Color=(1.0, 0.85, 0.6, 1.0), Emission_Strength=12.0)
    panel(glow, (0.9, 0.5), (0.5, 0.5, 2.98), (math.pi, 0.0, 0.0))
    set_world((0.6, 0.75, 1.0), 3.0)
    add_camera((0.2, -2.8, 1.5), (-0.1, 1.4, 1.5), 80.0)


SCENES = {"gloss": make_gloss, "textured": make_textured, "glass": make_glass, "room": make_room}
