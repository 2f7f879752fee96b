"""The shots of an artist for `render_blender.py`: depth of field, coats, flakes, glass, a sky, motion, motion blur."""

from __future__ import annotations

import math

import bpy
import numpy as np
from blender_parts import add, add_area, add_camera, make_image, make_material, put_texture, set_world

COAT_ROUGHNESS = 0.03
"""Perceptual roughness of the clear coats; the lacquer below has 0.38, so that no single lobe explains their light."""
SKY_SIZE = (256, 512)
FRAMES = 6
"""Frames of the shot that moves."""


def make_sky(sun, strength, *, seed=3, height_deg=38.0, around_deg=40.0, clear=0.4):
    """Put a sky all around, as a photographer's panorama: clouds, a skyline, a sun whose radiance is ``sun``."""
    rows, columns = SKY_SIZE
    height, around = np.meshgrid(
        np.linspace(-0.5 * math.pi, 0.5 * math.pi, rows), np.linspace(-math.pi, math.pi, columns), indexing="ij"
    )
    above = np.clip(np.sin(height), 0.0, 1.0)[..., None]
    color = (1.0 - above**0.5) * np.array([1.0, 0.95, 0.85]) + above**0.5 * np.array([0.15, 0.3, 0.75])
    random = np.random.default_rng(seed)
    clouds = np.zeros(SKY_SIZE)
    for octave in range(1, 6):
        # Whole turns around the vertical: no seam.
        turns, waves = random.integers(1, 3 * octave + 1), random.uniform(2.0, 5.0) * octave
        phase = random.uniform(0.0, 2.0 * math.pi, 2)
        clouds += np.sin(turns * around + phase[0] + 0.8 * np.sin(waves * height + phase[1])) / octave**0.5
    cover = 1.0 / (1.0 + np.exp(-4.0 * (clouds - clear)))[..., None]
    color = color * (1.0 - 0.7 * cover) + 0.7 * 1.3 * cover
    roofs = 0.04 + 0.1 * random.random(64)[(32.0 * (1.0 + around / math.pi)).astype(int) % 64]
    color[height < roofs] = (0.06, 0.07, 0.09)
    color[height < 0.0] = (0.25, 0.22, 0.18)
    middle = (math.radians(height_deg), math.radians(around_deg))
    apart = np.hypot(height - middle[0], (around - middle[1]) * np.cos(height))
    color += sun * np.clip(2.0 - apart / math.radians(1.2), 0.0, 1.0)[..., None] * np.array([1.0, 0.9, 0.7])
    set_world((1.0, 1.0, 1.0), strength)
    tree = bpy.context.scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = make_image("sky", color)
    tree.links.new(texture.outputs["Color"], tree.nodes["Background"].inputs["Color"])


def add_flakes(material, scale, amount):
    """Tilt the base's normal in every cell of a Voronoi texture, as metal flakes below a coat lie."""
    tree = material.node_tree
    place, cells = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexVoronoi")
    cells.inputs["Scale"].default_value = scale
    tree.links.new(place.outputs["Object"], cells.inputs["Vector"])
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    steps = {}
    for name, operation in (("center", "SUBTRACT"), ("scale", "SCALE"), ("add", "ADD"), ("unit", "NORMALIZE")):
        steps[name] = tree.nodes.new("ShaderNodeVectorMath")
        steps[name].operation = operation
    steps["center"].inputs[1].default_value = (0.5, 0.5, 0.5)
    steps["scale"].inputs["Scale"].default_value = amount
    tree.links.new(cells.outputs["Color"], steps["center"].inputs[0])
    tree.links.new(steps["center"].outputs[0], steps["scale"].inputs[0])
    tree.links.new(steps["scale"].outputs[0], steps["add"].inputs[0])
    tree.links.new(geometry.outputs["Normal"], steps["add"].inputs[1])
    tree.links.new(steps["add"].outputs[0], steps["unit"].inputs[0])
    tree.links.new(steps["unit"].outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])


def add_glow(name, color, strength, **options):
    """Add a ball that glows."""
    glow = make_material(name, (0.0, 0.0, 0.0), Emission_Color=(*color, 1.0), Emission_Strength=strength)
    return add("uv_sphere", glow, **options)


def set_focus(distance, stop):
    """Open the lens: sharp at a distance from the camera, six blades."""
    lens = bpy.context.scene.camera.data.dof
    lens.use_dof, lens.focus_distance, lens.aperture_fstop, lens.aperture_blades = True, distance, stop, 6


def make_product():
    """A shot of products: lacquer below a clear coat, flakes, a mirror, glass, a label, lamps out of focus, a sky."""
    wood = make_material("wood", Roughness=0.38, Coat_Weight=1.0, Coat_Roughness=COAT_ROUGHNESS)
    put_texture(wood, "Wave", "Base Color", scale=2.5, colors=((0.4, 0.22, 0.1), (0.22, 0.11, 0.05)))
    top = add("cube", wood, size=1.0, location=(0.0, 0.4, -0.05))
    top.scale = (3.6, 2.6, 0.1)
    coat = {"Roughness": 0.38, "Coat_Weight": 1.0, "Coat_Roughness": COAT_ROUGHNESS}
    lacquer = make_material("lacquer", (0.65, 0.03, 0.03), **coat)
    add("uv_sphere", lacquer, radius=0.3, location=(-0.75, 0.0, 0.3), segments=96, ring_count=48)
    flakes = make_material("flakes", (0.15, 0.3, 0.6), Metallic=1.0, **coat)
    add_flakes(flakes, 45.0, 0.35)
    add("torus", flakes, major_radius=0.25, minor_radius=0.1, location=(-0.05, -0.45, 0.1), major_segments=96,
        minor_segments=48)  # fmt: skip
    glass = make_material("glass", (0.95, 1.0, 0.97), Roughness=0.0, Transmission_Weight=1.0, IOR=1.5)
    add("cylinder", glass, radius=0.18, depth=0.62, location=(0.55, 0.1, 0.312), vertices=96)
    paper = make_material("paper", Roughness=0.7)
    put_texture(paper, "Checker", "Base Color", scale=16.0, colors=((0.85, 0.83, 0.75), (0.1, 0.25, 0.15)))
    label = add(
        "cylinder", paper, radius=0.183, depth=0.25, location=(0.55, 0.1, 0.3), vertices=96, end_fill_type="NOTHING"
    )
    label.rotation_euler[2] = 0.4
    chrome = make_material("chrome", (0.95, 0.95, 0.95), Roughness=0.0, Metallic=1.0)
    add("uv_sphere", chrome, radius=0.13, location=(0.25, -0.65, 0.13), segments=64, ring_count=32)
    mirror = add("plane", chrome, size=1.0, location=(-0.2, 1.2, 0.45), rotation=(math.radians(82.0), 0.0, 0.3))
    mirror.scale = (1.1, 0.9, 1.0)
    gold = make_material("gold", (0.95, 0.7, 0.3), Roughness=0.2, Metallic=1.0)
    add("monkey", gold, size=0.5, location=(1.15, 0.75, 0.28), rotation=(-0.3, 0.0, 0.5))
    for number in range(9):
        place = (-2.6 + 0.75 * number, 5.0 + 0.6 * (number % 3), 0.4 + 0.45 * (number * 5 % 4))
        tint = ((1.0, 0.6, 0.25), (1.0, 0.9, 0.7), (0.4, 0.7, 1.0))[number % 3]
        add_glow(f"bulb{number}", tint, 60.0, radius=0.04, location=place, segments=16, ring_count=8)
    add_area((-1.6, -1.4, 1.8), (0.75, -0.7, 0.0), 0.12, 30.0)
    add_area((1.4, -0.6, 2.2), (0.2, 0.6, 0.0), 0.5, 30.0, (1.0, 0.85, 0.7))
    make_sky(400.0, 0.6)
    add_camera((0.1, -3.0, 0.62), (0.05, 0.0, 0.45), 40.0)
    set_focus(2.9, 0.5)


def make_closeup():
    """The products through a lens that is wide open: a third of the pixels see several things."""
    make_product()
    add_camera((0.15, -1.9, 0.5), (0.02, 0.0, 0.32), 44.0)
    set_focus(1.55, 0.16)


def make_interior():
    """A room that the sun lights through a window with a pane: varnished boards, a table, a vase, a mirror, a lamp."""
    wall = make_material("wall", (0.78, 0.75, 0.7), Roughness=0.9)
    boards = make_material("boards", Roughness=0.38, Coat_Weight=1.0, Coat_Roughness=COAT_ROUGHNESS)
    put_texture(boards, "Wave", "Base Color", scale=1.5, colors=((0.45, 0.27, 0.14), (0.25, 0.13, 0.06)))
    cloth = make_material("cloth", (0.2, 0.3, 0.45), Roughness=0.95, Sheen_Weight=0.5)
    put_texture(cloth, "Noise", "Normal", scale=60.0, bump=0.3)
    black = make_material("black", (0.03, 0.03, 0.03), Roughness=0.3)
    chrome = make_material("chrome", (0.95, 0.95, 0.95), Roughness=0.02, Metallic=1.0)
    glass = make_material("glass", Roughness=0.0, Transmission_Weight=1.0, IOR=1.5)

    def block(material, size, location, turn=0.0):
        thing = add("cube", material, size=1.0, location=location)
        thing.scale, thing.rotation_euler[2] = size, turn
        return thing

    block(boards, (5.0, 6.0, 0.2), (0.0, 0.0, -0.1))
    block(wall, (5.0, 6.0, 0.2), (0.0, 0.0, 2.8))
    block(wall, (5.0, 0.2, 2.7), (0.0, -3.1, 1.35))
    block(wall, (5.0, 0.2, 2.7), (0.0, 3.1, 1.35))
    block(wall, (0.2, 6.4, 2.7), (-2.6, 0.0, 1.35))
    # The right wall has a window of 1.8 x 1.5 with a cross of bars.
    block(wall, (0.2, 6.4, 0.8), (2.6, 0.0, 0.4))
    block(wall, (0.2, 6.4, 0.4), (2.6, 0.0, 2.5))
    block(wall, (0.2, 3.2, 1.5), (2.6, -1.6, 1.55))
    block(wall, (0.2, 1.4, 1.5), (2.6, 2.5, 1.55))
    block(black, (0.06, 0.05, 1.5), (2.55, 0.9, 1.55))
    block(black, (0.06, 1.8, 0.05), (2.55, 0.9, 1.55))
    block(boards, (1.5, 0.8, 0.05), (-0.1, 1.0, 0.72), 0.15)
    for x, y in ((-0.75, 0.65), (0.55, 0.85), (-0.75, 1.15), (0.5, 1.35)):
        block(black, (0.05, 0.05, 0.7), (x, y, 0.35), 0.15)
    block(cloth, (1.9, 0.8, 0.42), (-1.5, 2.4, 0.21))
    block(cloth, (1.9, 0.25, 0.85), (-1.5, 2.8, 0.42))
    vase = make_material("vase", (0.15, 0.35, 0.3), Roughness=0.38, Coat_Weight=1.0, Coat_Roughness=COAT_ROUGHNESS)
    add("uv_sphere", vase, radius=0.16, location=(-0.35, 1.0, 0.9), segments=64, ring_count=32)
    add("cylinder", glass, radius=0.07, depth=0.22, location=(0.2, 0.9, 0.857), vertices=64)
    mirror = add("plane", chrome, size=1.0, location=(0.6, 2.99, 1.5), rotation=(math.pi / 2, 0.0, 0.0))
    mirror.scale = (0.9, 1.3, 1.0)
    shade = make_material("shade", (0.9, 0.8, 0.6), Roughness=0.8, Transmission_Weight=0.4)
    add("cylinder", shade, radius=0.2, depth=0.3, location=(-2.0, 1.1, 1.45), vertices=48, end_fill_type="NOTHING")
    block(black, (0.03, 0.03, 1.4), (-2.0, 1.1, 0.7))
    add_glow("bulb", (1.0, 0.75, 0.45), 80.0, radius=0.05, location=(-2.0, 1.1, 1.42), segments=16, ring_count=8)
    make_sky(3000.0, 4.0)
    add_camera((-0.6, -2.7, 1.45), (0.25, 1.2, 1.1), 72.0)


def animate(thing, path, first, last):
    """Move a property of a thing evenly from the first frame to the last."""
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    for frame, value in ((1, first), (FRAMES, last)):
        setattr(thing, path, value)
        thing.keyframe_insert(path, frame=frame)


def make_moving():
    """A ball that flies, a cube that turns, a sliding disc, before things at rest; the camera follows slowly.

    Nothing is blurred, so that Cycles writes the pass Vector: it has none with motion blur.
    """
    floor = make_material("floor", Roughness=0.35)
    put_texture(floor, "Checker", "Base Color", scale=1.2, colors=((0.65, 0.6, 0.5), (0.15, 0.2, 0.25)))
    add("plane", floor, size=20)
    wall = make_material("wall", Roughness=0.7)
    put_texture(wall, "Voronoi", "Base Color", scale=3.0, colors=((0.15, 0.3, 0.35), (0.75, 0.7, 0.6)))
    add("plane", wall, size=14, location=(0.0, 4.0, 3.0), rotation=(math.pi / 2, 0.0, 0.0))
    lacquer = make_material("lacquer", (0.7, 0.1, 0.05), Roughness=0.38, Coat_Weight=1.0, Coat_Roughness=COAT_ROUGHNESS)
    ball = add("uv_sphere", lacquer, radius=0.6, location=(-2.2, 0.0, 1.3), segments=64, ring_count=32)
    animate(ball, "location", (-2.2, 0.0, 1.0), (0.6, 0.0, 1.6))
    steel = make_material("steel", (0.8, 0.8, 0.82), Roughness=0.2, Metallic=1.0)
    cube = add("cube", steel, size=1.1, location=(1.9, 1.0, 0.8))
    animate(cube, "rotation_euler", (0.0, 0.0, 0.0), (0.4, 0.0, 1.6))
    rubber = make_material("rubber", (0.1, 0.5, 0.2), Roughness=0.6)
    disc = add("cylinder", rubber, radius=0.4, depth=0.15, location=(1.5, -1.6, 0.08), vertices=64)
    animate(disc, "location", (1.8, -1.6, 0.08), (-0.6, -1.4, 0.08))
    rest = make_material("rest", (0.8, 0.7, 0.5), Roughness=0.15)
    add("cylinder", rest, radius=0.4, depth=1.6, location=(-0.6, 2.4, 0.8), vertices=64)
    add_area((-3.0, -4.0, 5.0), (0.7, -0.4, 0.0), 1.5, 500.0)
    add_area((4.0, 0.0, 3.0), (0.0, 1.0, 0.0), 0.4, 120.0, (1.0, 0.8, 0.6))
    set_world((0.6, 0.7, 0.9), 0.3)
    add_camera((0.0, -7.0, 2.4), (0.0, 0.5, 0.9), 42.0)
    camera = bpy.context.object
    animate(camera, "location", (-0.15, -7.0, 2.4), (0.15, -6.9, 2.4))
    bpy.context.scene.frame_set(FRAMES)


def make_blurred():
    """The shot that moves with its shutter open for most of a frame, half way."""
    make_moving()
    scene = bpy.context.scene
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.8
    scene.frame_set(FRAMES // 2)


SHOTS = {
    "product": make_product,
    "closeup": make_closeup,
    "interior": make_interior,
    "moving": make_moving,
    "blurred": make_blurred,
}
