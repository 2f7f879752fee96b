"""Renders a shot of a kind and a seed: its scene, its exposure, its files."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from blender_parts import clear
from halves import halve_file
from kinds import KINDS, Plan
from render_blender import add_roughness_pass, add_volume_passes, render, set_output, set_up

PROBE_SPP = 12
PROBE_PERCENT = 25
"""Size of the render that tells the exposure."""


def make_scene(plan: Plan, random: np.random.Generator) -> None:
    """Make the scene of a shot, of what its generator draws after its plan."""
    clear()
    getattr(import_module(KINDS[plan.kind].module), f"make_{plan.kind}")(random)
    set_up(*plan.size)
    if KINDS[plan.kind].volume:
        add_volume_passes()
    if plan.roughness:
        add_roughness_pass()
    set_output()
    bpy.context.scene.render.use_persistent_data = True


def put_into_light_groups() -> None:
    """Put every second lamp of the scene, the other lamps, what glows, and the sky each into a light group."""
    scene = bpy.context.scene
    for name in ("even", "odd", "glow", "sky"):
        scene.view_layers[0].lightgroups.add(name=name)
    lamps = 0
    for one in scene.objects:
        one.lightgroup = "glow" if one.type != "LIGHT" else ("even", "odd")[lamps % 2]
        lamps += one.type == "LIGHT"
    if scene.world:
        scene.world.lightgroup = "sky"


def probe_luminance() -> np.ndarray:
    """Return the luminance of the pixels of a small render without exposure; not of those that show the film alone."""
    scene = bpy.context.scene
    before, scene.render.resolution_percentage = scene.render.resolution_percentage, PROBE_PERCENT
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "probe.exr"
        scene.render.image_settings.file_format = "OPEN_EXR"
        render(path, PROBE_SPP, 0, depth="32")
        image = bpy.data.images.load(str(path))
        pixels = np.array(image.pixels[:]).reshape(-1, 4)
        bpy.data.images.remove(image)
    scene.render.resolution_percentage = before
    set_output()
    return pixels[pixels[:, 3] > 0.5, :3] @ (0.2126, 0.7152, 0.0722)


def choose_exposure(luminance: np.ndarray, brightness: float) -> float:
    """Return the factor of light with which L / (1 + L) has this mean: bright dots count no more than white does."""
    low, high = -8.0, 8.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        scaled = 10.0**middle * luminance
        low, high = (middle, high) if np.mean(scaled / (1.0 + scaled)) < brightness else (low, middle)
    return 10.0**low


def describe_shot(path: Path, plan: Plan) -> dict[str, Any]:
    """Return what the file of a shot says, which it says before the first render: a stopped shot keeps its exposure."""
    if not path.exists():
        exposure = choose_exposure(probe_luminance(), plan.brightness)
        row = {**dataclasses.asdict(plan), "exposure": exposure, "blender": bpy.app.version_string}
        temporary = path.with_name(f".{path.name}")
        temporary.write_text(json.dumps(row, indent=1) + "\n")
        temporary.rename(path)
    return json.loads(path.read_text())


def set_threads(threads: int) -> None:
    """Render with so many threads; 0 for all cores."""
    if threads:
        bpy.context.scene.render.threads_mode, bpy.context.scene.render.threads = "FIXED", threads


def render_shot(
    folder: Path, plan: Plan, random: np.random.Generator, threads: int = 0, *, groups: bool = False
) -> None:
    """Render all files of a shot that are not there, with light groups if asked."""
    target = folder / f"{plan.kind}_{plan.seed}"
    references = [target / f"reference_{part}.exr" for part in range(1, len(plan.reference_spp) + 1)]
    if all(path.exists() for path in (*(target / f"{spp}.exr" for spp in plan.spp), references[-1])):
        return
    start = time.process_time()
    target.mkdir(parents=True, exist_ok=True)
    make_scene(plan, random)
    if groups:
        put_into_light_groups()
    set_threads(threads)
    scene = bpy.context.scene
    scene.cycles.film_exposure = describe_shot(target / "shot.json", plan)["exposure"]
    for spp in plan.spp:
        path = target / f"{spp}.exr"
        if not path.exists():
            render(path, spp, 1000 * plan.seed + spp)
            if KINDS[plan.kind].halves:
                halve_file(path)
    for part, (path, spp) in enumerate(zip(references, plan.reference_spp, strict=True), 1):
        if not path.exists():
            render(path, spp, 7776 + part, depth="32")
    print(f"wrote {target}, {time.process_time() - start:.0f} s of CPU", flush=True)
