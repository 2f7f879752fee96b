"""What the scenes of `render_blender.py` are built of: materials, textures, things, lamps, a world, a camera."""

from __future__ import annotations

import math

import bpy
import numpy as np


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


def add_area(location, rotation, size, power, color=(1.0, 1.0, 1.0)):
    """Add a rectangular lamp."""
    bpy.ops.object.light_add(type="AREA", location=location, rotation=rotation)
    light = bpy.context.object.data
    light.size, light.energy, light.color = size, power, color


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
