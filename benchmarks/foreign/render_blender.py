"""How Blender Cycles renders the scenes of the factory. Runs where `bpy` is, without lobewise.

Filters and settings are Blender's defaults, but for adaptive sampling and denoising, which are off: a frame shall have
the samples that its name says. The passes are those that `docs/blender.md` asks for, in one part, half floats.
"""

from __future__ import annotations

import time
from pathlib import Path

import bpy

PASSES = (
    "combined", "diffuse_direct", "diffuse_indirect", "diffuse_color", "glossy_direct", "glossy_indirect",
    "glossy_color", "transmission_direct", "transmission_indirect", "transmission_color", "emit", "environment",
    "z", "position", "normal", "cryptomatte_object",
)  # fmt: skip


def set_up(width: int, height: int) -> None:
    """Choose Cycles and the passes; the samples that are asked for are all taken."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    layer = bpy.context.view_layer
    for name in PASSES:
        setattr(layer, f"use_pass_{name}", True)
    layer.cycles.denoising_store_passes = True


def add_volume_passes() -> None:
    """Ask for the passes of the light of smoke and fog."""
    cycles = bpy.context.view_layer.cycles
    cycles.use_pass_volume_direct = cycles.use_pass_volume_indirect = True


def add_roughness_pass() -> None:
    """Ask for the roughness that the materials write."""
    aov = bpy.context.view_layer.aovs.add()
    aov.name, aov.type = "Roughness", "VALUE"


def set_output() -> None:
    """Choose a multilayer EXR file of one part."""
    output = bpy.context.scene.render.image_settings
    if hasattr(output, "media_type"):
        output.media_type = "MULTI_LAYER_IMAGE"
        output.use_exr_interleave = True
    output.file_format = "OPEN_EXR_MULTILAYER"
    output.exr_codec = "ZIP"


def render(path: Path, spp: int, seed: int, *, depth: str = "16") -> None:
    """Render the scene into a file, unless it is there."""
    if path.exists():
        return
    start = time.process_time()
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.seed = spp, seed
    scene.render.image_settings.color_depth = depth
    temporary = path.with_name(f".{path.name}")
    scene.render.filepath = str(temporary)
    bpy.ops.render.render(write_still=True)
    temporary.rename(path)
    print(f"wrote {path}, {time.process_time() - start:.1f} s of CPU", flush=True)


def render_frames(path: Path, spp: int, seed: int, count: int, *, depth: str = "16") -> None:
    """Render frames 1 to ``count`` beside a path, with seeds of their own; leave the scene where it was."""
    scene = bpy.context.scene
    before = scene.frame_current
    for frame in range(1, count + 1):
        scene.frame_set(frame)
        render(path.with_name(f"{path.stem}.{frame:04d}.exr"), spp, 100 * seed + frame, depth=depth)
    scene.frame_set(before)
