"""What the scenes of the factory are built of: materials, textures, things, lamps, a world, a sky, a camera."""

from __future__ import annotations

import math

import bpy
import numpy as np

TINTS = ((1.0, 0.55, 0.2), (1.0, 0.1, 0.08), (0.15, 0.9, 0.25), (0.2, 0.4, 1.0), (1.0, 0.85, 0.6))
"""Colors of the lamps, in turn."""
SKY_SIZE = (256, 512)


def clear() -> None:
    """Begin with nothing."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def make_material(name, color=(0.8, 0.8, 0.8), **inputs):
    """Return a Principled material whose roughness goes to the AOV as well; inputs by their names in Blender."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    shader = nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    output = nodes.new("ShaderNodeOutputAOV")
    output.aov_name = "Roughness"
    output.inputs["Value"].default_value = shader.inputs["Roughness"].default_value
    return material


def put_texture(material, kind, to, *, scale, low=0.0, high=1.0, colors=None, bump=0.0, **inputs):
    """Drive an input of a material by a procedural texture; roughness drives the AOV too; inputs of the texture."""
    tree = material.node_tree
    nodes, links = tree.nodes, tree.links
    place = nodes.new("ShaderNodeTexCoord")
    texture = nodes.new(f"ShaderNodeTex{kind}")
    texture.inputs["Scale"].default_value = scale
    for key, setting in inputs.items():
        texture.inputs[key.replace("_", " ")].default_value = setting
    links.new(place.outputs["Object"], texture.inputs["Vector"])
    shader = nodes["Principled BSDF"]
    value = texture.outputs["Fac"] if "Fac" in texture.outputs else texture.outputs["Distance"]
    if colors is not None:
        mix = nodes.new("ShaderNodeMix")
        mix.data_type = "RGBA"
        mix.inputs[6].default_value, mix.inputs[7].default_value = (*colors[0], 1.0), (*colors[1], 1.0)
        links.new(value, mix.inputs[0])
        links.new(mix.outputs[2], shader.inputs[to])
    elif bump:
        node = nodes.new("ShaderNodeBump")
        node.inputs["Strength"].default_value = bump
        links.new(value, node.inputs["Height"])
        links.new(node.outputs["Normal"], shader.inputs["Normal"])
    else:
        ramp = nodes.new("ShaderNodeMapRange")
        ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = low, high
        links.new(value, ramp.inputs["Value"])
        links.new(ramp.outputs["Result"], shader.inputs[to])
        if to == "Roughness":
            aov = next(node for node in nodes if node.bl_idname == "ShaderNodeOutputAOV")
            links.new(ramp.outputs["Result"], aov.inputs["Value"])
    return material


def add(kind, material, **options):
    """Add a primitive with a material, smooth where it is round."""
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
    thing = bpy.context.object
    thing.data.materials.append(material)
    if kind in ("uv_sphere", "torus", "monkey", "cylinder"):
        for polygon in thing.data.polygons:
            polygon.use_smooth = len(polygon.vertices) <= 4
    return thing


def add_air(density, size, location, anisotropy=0.0):
    """Fill a cube with thin fog."""
    air = bpy.data.materials.new("air")
    air.use_nodes = True
    tree = air.node_tree
    tree.nodes.clear()
    scatter, output = tree.nodes.new("ShaderNodeVolumeScatter"), tree.nodes.new("ShaderNodeOutputMaterial")
    scatter.inputs["Density"].default_value = density
    scatter.inputs["Anisotropy"].default_value = anisotropy
    tree.links.new(scatter.outputs["Volume"], output.inputs["Volume"])
    add("cube", air, size=size, location=location)


def make_image(name, pixels):
    """Return a linear image of (rows from below, columns, 3)."""
    rows, columns, _ = pixels.shape
    image = bpy.data.images.new(name, columns, rows, float_buffer=True)
    image.pixels.foreach_set(np.concatenate([pixels, np.ones((rows, columns, 1))], -1).astype(np.float32).ravel())
    image.pack()
    return image


def set_world(color, strength):
    """Put one color all around."""
    world = bpy.data.worlds.new("World")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (*color, 1.0)
    world.node_tree.nodes["Background"].inputs[1].default_value = strength
    bpy.context.scene.world = world


def aim(location, target):
    """Return the rotation of a camera or lamp that looks at a point."""
    from mathutils import Vector

    return (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()


def add_camera(location, target, angle):
    """Add a camera that looks at a point; its angle is the horizontal one, degrees."""
    bpy.ops.object.camera_add(location=location)
    camera = bpy.context.object
    camera.rotation_euler = aim(location, target)
    camera.data.angle = math.radians(angle)
    bpy.context.scene.camera = camera


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
        lamps.append(add_glow(name, tint, strength, radius, place, 10))
    return lamps


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


def add_glow(name, color, strength, radius, location, segments):
    """Add a ball that glows."""
    glow = make_material(name, (0.0, 0.0, 0.0), Emission_Color=(*color, 1.0), Emission_Strength=strength)
    return add("uv_sphere", glow, radius=radius, location=location, segments=segments, ring_count=segments // 2)


def set_focus(distance, stop):
    """Open the lens: sharp at a distance from the camera, six blades."""
    lens = bpy.context.scene.camera.data.dof
    lens.use_dof, lens.focus_distance, lens.aperture_fstop, lens.aperture_blades = True, distance, stop, 6


def animate(thing, path, values, length):
    """Move a property through values that are spread evenly over so many frames, along straight lines."""
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    for number, value in enumerate(values):
        setattr(thing, path, value)
        thing.keyframe_insert(path, frame=1 + number * (length - 1) / (len(values) - 1))
