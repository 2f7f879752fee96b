"""Films of the factory: the scene of a shot, in which the camera, things or lamps move as the seed draws."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

import bpy
import numpy as np
from blender_parts import animate
from bpy_extras.object_utils import world_to_camera_view
from kinds import Plan
from mathutils import Matrix, Vector
from render_blender import render_frames
from shots import describe_shot, make_scene, set_threads

FRAMES = 12
SPP, REFERENCE_SPP = 16, 96
"""Samples of the noisy frames, and of each of the two references."""
MAX_TURN, MAX_PAN = 0.16, 0.2
"""Largest angles by which the camera goes around what it looks at, and turns about itself, radians over the film."""
MAX_THINGS = 2
MAX_SIZE_OVER_DISTANCE = 0.4
"""Size of the largest thing that moves, over its distance from the camera."""


def render_film(
    folder: Path, plan: Plan, random: np.random.Generator, threads: int = 0, *, reference_spp: int = REFERENCE_SPP
) -> None:
    """Render all files of a film that are not there: 16.0001.exr and on, reference_1.0001.exr, reference_2.0001.exr."""
    target = folder / f"{plan.kind}_{plan.seed}"
    if (target / f"reference_2.{FRAMES:04d}.exr").exists():
        return
    start = time.process_time()
    target.mkdir(parents=True, exist_ok=True)
    make_scene(plan, random)
    set_threads(threads)
    scene = bpy.context.scene
    scene.frame_end = FRAMES
    bpy.context.view_layer.use_pass_vector = True
    scene.cycles.film_exposure = describe_shot(target / "film.json", plan)["exposure"]
    moves = move_scene(plan.seed, random)
    (target / "moves.json").write_text(json.dumps(moves, indent=1) + "\n")
    render_frames(target / f"{SPP}.exr", SPP, plan.seed, FRAMES)
    for part in (1, 2):
        render_frames(target / f"reference_{part}.exr", reference_spp, 7776 + part, FRAMES, depth="32")
    print(f"wrote {target}, {time.process_time() - start:.0f} s of CPU", flush=True)


def move_scene(seed: int, random: np.random.Generator) -> list[str]:
    """Let something move, by the seed; return what: the camera for even seeds, things and a lamp for odd ones.

    Of the films in which the camera moves every other one is a pan. Every fourth film has motion blur, and so no pass
    Vector.
    """
    if seed % 2:
        moves = move_things(random) + move_lamp(random)
    else:
        moves = pan_camera(random) if seed % 4 == 2 else move_camera(random)
    if seed % 4 == 3:
        bpy.context.scene.render.use_motion_blur = True
        moves.append("motion blur")
    return moves


def find_middle() -> Vector:
    """Return the point in the middle of the picture."""
    scene = bpy.context.scene
    camera = scene.camera
    bpy.context.view_layer.update()
    way = camera.matrix_world.to_quaternion() @ Vector((0.0, 0.0, -1.0))
    is_hit, place, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), camera.location, way)
    return place if is_hit else camera.location + 5.0 * way


def move_camera(random: np.random.Generator) -> list[str]:
    """Let the camera go around what it looks at, and a little nearer to it or away from it."""
    camera, middle = bpy.context.scene.camera, find_middle()
    turn = random.uniform(0.5, 1.0) * MAX_TURN * random.choice((-1.0, 1.0))
    nearer = random.uniform(-0.08, 0.08)
    start = camera.matrix_world.copy()
    places, angles = [], []
    for share in np.linspace(-0.5, 0.5, FRAMES):
        around = Matrix.Rotation(turn * share, 4, "Z")
        matrix = Matrix.Translation(middle) @ around @ Matrix.Translation(-middle) @ start
        places.append(tuple(middle + (matrix.translation - middle) * (1.0 - nearer * share)))
        angles.append(tuple(matrix.to_euler()))
    animate(camera, "location", places, FRAMES)
    animate(camera, "rotation_euler", angles, FRAMES)
    return [f"the camera turns by {math.degrees(turn):.1f} degrees"]


def pan_camera(random: np.random.Generator) -> list[str]:
    """Let the camera turn about itself."""
    camera = bpy.context.scene.camera
    pan = random.uniform(0.5, 1.0) * MAX_PAN * random.choice((-1.0, 1.0))
    start = camera.matrix_world.to_3x3()
    turns = [Matrix.Rotation(pan * share, 3, "Z") @ start for share in np.linspace(-0.5, 0.5, FRAMES)]
    animate(camera, "rotation_euler", [tuple(turn.to_euler()) for turn in turns], FRAMES)
    return [f"the camera pans by {math.degrees(pan):.1f} degrees"]


def move_things(random: np.random.Generator) -> list[str]:
    """Let one or two small things in the middle of the picture slide and turn."""
    scene = bpy.context.scene
    camera, chosen = scene.camera, []
    bpy.context.view_layer.update()
    for thing in scene.objects:
        if thing.type != "MESH" or thing.particle_systems or thing.parent or thing.hide_render:
            continue
        middle = sum((thing.matrix_world @ Vector(corner) for corner in thing.bound_box), Vector()) / 8.0
        x, y, distance = world_to_camera_view(scene, camera, middle)
        size = max(thing.dimensions)
        if 0.2 < x < 0.8 and 0.2 < y < 0.8 and 0.0 < size < MAX_SIZE_OVER_DISTANCE * distance:
            chosen.append((thing, size))
    moved = []
    for index in random.permutation(len(chosen))[:MAX_THINGS]:
        thing, size = chosen[index]
        way = camera.matrix_world.to_quaternion() @ Vector((random.choice((-1.0, 1.0)), 0.3 * random.normal(), 0.0))
        step, start = random.uniform(0.5, 1.2) * size * way, thing.location.copy()
        turn, before = random.uniform(-1.0, 1.0), thing.rotation_euler.copy()
        thing.rotation_mode = "XYZ"
        animate(thing, "location", (tuple(start - 0.5 * step), tuple(start + 0.5 * step)), FRAMES)
        animate(thing, "rotation_euler", (tuple(before), (before[0], before[1], before[2] + turn)), FRAMES)
        moved.append(f"{thing.name} slides by {step.length / size:.1f} of its size and turns")
    return moved or move_camera(random)


def move_lamp(random: np.random.Generator) -> list[str]:
    """Let one lamp become dim or bright."""
    lamps = [each for each in bpy.context.scene.objects if each.type == "LIGHT"]
    if not lamps:
        return []
    lamp = lamps[int(random.integers(len(lamps)))]
    factor = 2.0 ** random.uniform(-2.0, 1.0)
    animate(lamp.data, "energy", (lamp.data.energy, factor * lamp.data.energy), FRAMES)
    return [f"{lamp.name} becomes {factor:.2f} times as bright"]
