"""Frames of Blender Cycles from scenes made in code. Runs where `bpy` is, without lobewise.

    python render_blender.py FOLDER [--scenes a,b] [--spp 8,32,128] [--seeds 1,2] [--reference 4096] [--size 256x192]
                                    [--passes every|artist|page] [--multipart] [--denoise] [--codec ZIP] [--frames 6]
                                    [--threads 1]

Filters and settings are Blender's defaults, but for adaptive sampling and denoising, which are off: a frame shall have
the samples that its name says. ``--denoise`` switches Blender's own denoiser on, as it is by default: the pass Combined
is then its result, and Noisy Image is what was rendered. ``--passes artist`` has the passes of Blender's menus alone
and no shader AOV of the roughness, which only a material's author can make; ``--passes page`` has those that
`docs/blender.md` asks for, without roughness and volumes.

Files are named ``SCENE_SPP_SEED.exr``; the reference comes in two halves of different seeds,
``SCENE_reference_1.exr`` and ``SCENE_reference_2.exr``, so that its own noise is known, and never denoised.
``--frames N`` renders frames 1 to N of a scene that moves, ``SCENE_SPP_SEED.0001.exr`` and on, each with a seed of its
own, and the reference of each. All passes lie in one part, as Blender writes them up to 4.5; from 5.0 on its default is
a part for each, which ``--multipart`` keeps.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import bpy
from blender_crowds import CROWDS
from blender_films import FILMS
from blender_parts import clear
from blender_scenes import SCENES
from blender_shots import SHOTS

LIGHT = (
    "combined", "diffuse_direct", "diffuse_indirect", "diffuse_color", "glossy_direct", "glossy_indirect",
    "glossy_color", "transmission_direct", "transmission_indirect", "transmission_color", "emit", "environment",
)  # fmt: skip
PASSES = {
    "every": (
        *LIGHT, "z", "position", "normal", "vector", "object_index", "subsurface_direct", "subsurface_indirect",
        "subsurface_color", "cryptomatte_object",
    ),
    "artist": (
        *LIGHT, "z", "mist", "position", "normal", "vector", "ambient_occlusion", "cryptomatte_object",
        "cryptomatte_material",
    ),
    "page": (*LIGHT, "z", "position", "normal", "cryptomatte_object"),
}  # fmt: skip
EVERY = "every"
KINDS = {**SCENES, **SHOTS, **CROWDS, **FILMS}


def set_up(width: int, height: int, passes: str) -> None:
    """Choose Cycles and the passes; the samples that are asked for are all taken."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    layer = bpy.context.view_layer
    for name in PASSES[passes]:
        setattr(layer, f"use_pass_{name}", True)
    layer.cycles.denoising_store_passes = True
    if passes == EVERY:
        add_volume_passes()
        add_roughness_pass()


def add_volume_passes() -> None:
    """Ask for the passes of the light of smoke and fog."""
    cycles = bpy.context.view_layer.cycles
    cycles.use_pass_volume_direct = cycles.use_pass_volume_indirect = True


def add_roughness_pass() -> None:
    """Ask for the roughness that the materials write."""
    aov = bpy.context.view_layer.aovs.add()
    aov.name, aov.type = "Roughness", "VALUE"


def set_output(codec: str, *, multipart: bool) -> None:
    """Choose a multilayer EXR file."""
    output = bpy.context.scene.render.image_settings
    if hasattr(output, "media_type"):
        output.media_type = "MULTI_LAYER_IMAGE"
        output.use_exr_interleave = not multipart
    elif multipart:
        sys.exit(f"Blender {bpy.app.version_string} writes one part only: use 5.0 or later, or leave out --multipart")
    output.file_format = "OPEN_EXR_MULTILAYER"
    output.exr_codec = codec


def render(path: Path, spp: int, seed: int, *, depth: str = "16", denoise: bool = False) -> None:
    """Render the scene into a file, unless it is there."""
    if path.exists():
        return
    start = time.process_time()
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.seed, scene.cycles.use_denoising = spp, seed, denoise
    scene.render.image_settings.color_depth = depth
    temporary = path.with_name(f".{path.name}")
    scene.render.filepath = str(temporary)
    bpy.ops.render.render(write_still=True)
    temporary.rename(path)
    print(f"wrote {path}, {time.process_time() - start:.1f} s of CPU", flush=True)


def render_frames(path: Path, spp: int, seed: int, count: int, *, depth: str = "16", denoise: bool = False) -> None:
    """Render frames 1 to ``count`` beside a path, with seeds of their own; leave the scene where it was."""
    scene = bpy.context.scene
    before = scene.frame_current
    for frame in range(1, count + 1):
        scene.frame_set(frame)
        number = f"{path.stem}.{frame:04d}.exr"
        render(path.with_name(number), spp, 100 * seed + frame, depth=depth, denoise=denoise)
    scene.frame_set(before)


def main() -> None:
    """Render what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", default=",".join(SCENES), help=f"of {', '.join(KINDS)}")
    parser.add_argument("--spp", default="8,32,128")
    parser.add_argument("--seeds", default="1,2")
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--size", default="256x192")
    parser.add_argument("--passes", choices=PASSES, default=EVERY)
    parser.add_argument("--multipart", action="store_true", help="a part for each pass")
    parser.add_argument("--denoise", action="store_true", help="with Blender's own denoiser; not the reference")
    parser.add_argument("--codec", default="ZIP", help="compression of the files, such as ZIP, DWAA, PIZ")
    parser.add_argument("--frames", type=int, default=0, help="a sequence of so many frames instead of one")
    parser.add_argument("--threads", type=int, default=0, help="0 for all")
    asked = parser.parse_args(sys.argv[1:])
    asked.folder.mkdir(parents=True, exist_ok=True)
    width, height = map(int, asked.size.split("x"))
    for name in asked.scenes.split(","):
        clear()
        KINDS[name]()
        set_up(width, height, asked.passes)
        set_output(asked.codec, multipart=asked.multipart)
        if asked.threads:
            bpy.context.scene.render.threads_mode, bpy.context.scene.render.threads = "FIXED", asked.threads
        for spp in filter(None, asked.spp.split(",")):
            for seed in asked.seeds.split(","):
                path = asked.folder / f"{name}_{spp}_{seed}.exr"
                if asked.frames:
                    render_frames(path, int(spp), int(seed), asked.frames, denoise=asked.denoise)
                else:
                    render(path, int(spp), int(seed), denoise=asked.denoise)
        if asked.reference:
            for half in (1, 2):
                path, spp, seed = asked.folder / f"{name}_reference_{half}.exr", asked.reference // 2, 7776 + half
                if asked.frames:
                    render_frames(path, spp, seed, asked.frames, depth="32")
                else:
                    render(path, spp, seed, depth="32")


if __name__ == "__main__":
    main()
