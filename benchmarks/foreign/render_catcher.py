"""Render a shadow catcher with Blender's Cycles: a noisy frame and two references, for ``benchmarks.foreign.catcher``.

``python render_catcher.py FOLDER``, with the Python that has bpy.
"""

import sys

import bpy

RENDERS = {"noisy": (16, 1), "reference_1": (512, 2), "reference_2": (512, 3)}
"""Samples and seed of each file."""
PASSES = ("z", "normal", "position", "diffuse_direct", "diffuse_indirect", "diffuse_color", "glossy_direct")
MORE_PASSES = ("glossy_indirect", "glossy_color", "emit", "environment")


def give_material(name: str, color: tuple[float, float, float], roughness: float, metallic: float) -> None:
    """Give the object that was made last a material."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    values = {"Base Color": (*color, 1.0), "Roughness": roughness, "Metallic": metallic}
    for key, value in values.items():
        material.node_tree.nodes["Principled BSDF"].inputs[key].default_value = value
    bpy.context.object.data.materials.append(material)


def make_scene() -> bpy.types.Scene:
    """Return a scene of a ball and a box on a floor that shows its shadows alone."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    scene.render.resolution_x, scene.render.resolution_y = 192, 144
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.context.object.is_shadow_catcher = True
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(-0.9, 0.0, 0.8), segments=48, ring_count=24)
    bpy.ops.object.shade_smooth()
    give_material("paint", (0.8, 0.2, 0.1), 0.2, 0.0)
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=(1.1, 0.4, 0.6), rotation=(0.0, 0.0, 0.6))
    give_material("metal", (0.7, 0.7, 0.75), 0.15, 1.0)
    bpy.ops.object.light_add(type="AREA", location=(3.0, -2.0, 4.0), rotation=(0.6, 0.5, 0.3))
    bpy.context.object.data.energy = 400.0
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[1].default_value = 0.4
    bpy.ops.object.camera_add(location=(0.0, -6.0, 3.2), rotation=(1.15, 0.0, 0.0))
    scene.camera = bpy.context.object
    layer = scene.view_layers[0]
    layer.cycles.denoising_store_passes = True
    for name in (*PASSES, *MORE_PASSES):
        setattr(layer, f"use_pass_{name}", True)
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    return scene


if __name__ == "__main__":
    scene = make_scene()
    # With a pass of its own, the shadow is not in alpha.
    for start, has_pass in (("", False), ("pass_", True)):
        scene.view_layers[0].cycles.use_pass_shadow_catcher = has_pass
        for name, (samples, seed) in RENDERS.items():
            scene.cycles.samples, scene.cycles.seed = samples, seed
            scene.render.filepath = f"{sys.argv[-1]}/{start}{name}.exr"
            bpy.ops.render.render(write_still=True)
