"""Frames of Blender Cycles for `make.py` of which `benchmarks/foreign` has none. Runs where `bpy` is, without lobewise.

    python render_cycles.py FOLDER

``groups_16_1.exr``: every light pass and three light groups. ``lens_16_1.exr``: lamps out of focus. ``film_4_1.exr``: a
transparent film. ``stereo_4_1.exr``: two views. ``grass_1_1.exr``: one sample per pixel, as large as the grass of
``benchmarks/foreign``. References: ``groups_reference_1.exr`` and so on.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "foreign"))

import bpy
from blender_parts import clear
from render_blender import EVERY, KINDS, render, set_output, set_up

REFERENCE_SPP = 512
SIZE = 48, 40


def add_groups() -> None:
    """Give every lamp and the sky a light group of its own."""
    layer = bpy.context.view_layer
    for name in ("key", "fill", "world"):
        layer.lightgroups.add(name=name)
    lamps = [thing for thing in bpy.context.scene.objects if thing.type == "LIGHT"]
    for lamp, name in zip(lamps, ("key", "fill"), strict=True):
        lamp.lightgroup = name
    bpy.context.scene.world.lightgroup = "world"


def open_film() -> None:
    """Leave the background out of the image."""
    bpy.context.scene.render.film_transparent = True


def add_views() -> None:
    """Render for two eyes, both in one file."""
    bpy.context.scene.render.use_multiview = True
    bpy.context.scene.render.image_settings.views_format = "MULTIVIEW"


def open_lens() -> None:
    """Blur most pixels by more than one."""
    bpy.context.scene.camera.data.dof.aperture_fstop /= 1.6


def keep_all() -> None:
    """Change nothing."""


FRAMES = (
    ("groups", "gloss", add_groups, 16, SIZE, True),
    ("lens", "bokeh", open_lens, 16, SIZE, True),
    ("film", "product", open_film, 4, SIZE, True),
    ("stereo", "room", add_views, 4, (40, 32), True),
    ("grass", "grass", keep_all, 1, (192, 144), False),
)
"""Name, scene, what is changed, samples per pixel, width and height, whether it needs a reference of its own."""


def main() -> None:
    """Render what is not there."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, scene, change, spp, size, has_reference in FRAMES:
        clear()
        KINDS[scene]()
        set_up(*size, EVERY)
        set_output("ZIP", multipart=False)
        change()
        bpy.context.scene.render.threads_mode, bpy.context.scene.render.threads = "FIXED", 1
        render(folder / f"{name}_{spp}_1.exr", spp, 1)
        if has_reference:
            render(folder / f"{name}_reference_1.exr", REFERENCE_SPP, 7777)


if __name__ == "__main__":
    main()
