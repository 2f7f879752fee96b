"""More scenes of `kinds.py`: rooms full of one thing, and stages under a sky.

``light`` multiplies the radiance of every light. Lengths are metres, y is up.
"""

from __future__ import annotations

import numpy as np

from benchmarks.training.clutter import make_cables, make_coil, make_lattice, make_plant, make_rod, make_table
from benchmarks.training.interiors import (
    add_cables_across,
    add_lamps,
    add_pictures,
    add_rack,
    draw_floor_surface,
    draw_room,
    furnish,
)
from benchmarks.training.materials import Generator, draw_log
from benchmarks.training.meshes import Box, make_boxes, make_mesh
from benchmarks.training.pictures import draw_surroundings
from benchmarks.training.placing import (
    add_shell,
    add_small_things,
    add_surfaces,
    aim_around,
    choose_spot,
    start,
)
from benchmarks.training.settings import Stage, draw_light_color, make_sky, scale_color
from benchmarks.training.surfaces import EVERYDAY, draw_plain, draw_surface
from lobewise.scenes import parts

POLISHED = {"polished": 3.0, "smudged": 2.0, "mirror": 1.0, "coated": 1.0, "printed": 1.0, "painted": 1.0}
METALS = {"brushed": 4.0, "grained": 2.0, "smudged": 1.0, "coated": 1.0, "worn": 1.0, "painted": 1.0}
LAYERED = {"coated": 3.0, "worn": 4.0, "satin": 2.0, "printed": 1.0, "old": 1.0}
EMBOSSED = {"embossed": 5.0, "painted": 1.0, "coated": 1.0}


def add_ceiling_panels(stage: Stage, half: tuple[float, float], height: float, light: float) -> None:
    """Light a room by a few panels in its ceiling."""
    generator = stage.generator
    color, size = draw_light_color(generator), (draw_log(generator, 0.1, 0.5), draw_log(generator, 0.1, 0.6))
    for x in np.linspace(-0.5, 0.5, int(generator.integers(1, 4))) * half[0]:
        for z in np.linspace(-0.6, 0.5, int(generator.integers(1, 4))) * half[1]:
            own = scale_color(color, light * generator.uniform(0.5, 1.5))
            stage.add("panel", parts.light((float(x), height - 0.01, float(z)), (float(x), 0.0, float(z)), size, own))


def make_library(generator: Generator, light: float) -> Stage:
    """Return a room of racks full of thin volumes and small things."""
    stage, half, height = draw_room(generator)
    add_shell(stage, half, height, draw_floor_surface(generator), {})
    add_ceiling_panels(stage, half, height, 4.0 * light)
    for _ in range(int(generator.integers(3, 7))):
        add_rack(stage, EVERYDAY)
    furnish(stage, 1, EVERYDAY)
    add_pictures(stage, half, height, int(generator.integers(0, 3)))
    add_small_things(stage, int(generator.integers(10, 24)), (0.04, 0.16), EVERYDAY, tops=0.8)
    return stage


def make_gallery(generator: Generator, light: float) -> Stage:
    """Return a room of pictures and screens, whose floor reflects them; the screens may be all the light."""
    stage, half, height = draw_room(generator)
    floor = draw_surface(generator, {"polished": 1.0, "coated": 1.0, "satin": 1.0, "smudged": 0.5}, 4.0)
    add_shell(stage, half, height, floor, {})
    add_pictures(stage, half, height, 6)
    add_pictures(stage, half, height, int(generator.integers(2, 7)), lit=3.0 * light)
    if generator.random() < 0.6:
        add_ceiling_panels(stage, half, height, 2.0 * light)
    else:
        add_lamps(stage, half, height, 3, 2.0 * light)
    add_small_things(stage, int(generator.integers(6, 18)), (0.08, 0.35), {**POLISHED, "printed": 4.0}, tops=0.3)
    return stage


def make_mirror_room(generator: Generator, light: float) -> Stage:
    """Return a room with sheets of mirror on its walls and near-mirrors on its floor."""
    stage, half, height = draw_room(generator)
    add_shell(stage, half, height, draw_floor_surface(generator), {})
    for side in (-1.0, 0.0, 1.0):
        if generator.random() < 0.7:
            size = (draw_log(generator, 0.3, 0.9), draw_log(generator, 0.4, 0.9))
            along, y = float(generator.uniform(-0.6, 0.2)), float(generator.uniform(0.4, 0.55) * height)
            at = (side * (half[0] - 0.02), y, along * half[1]) if side else (along * half[0], y, 0.02 - half[1])
            sheet = draw_surface(generator, {"mirror": 2.0, "polished": 2.0, "smudged": 1.0, "embossed": 0.5}, 2.0)
            stage.add("sheet", parts.rectangle(at, (0.0, y, at[2]) if side else (at[0], y, 0.0), size, sheet))
    if generator.random() < 0.5:
        add_ceiling_panels(stage, half, height, 3.0 * light)
    else:
        add_lamps(stage, half, height, 4, 3.0 * light)
    furnish(stage, 1, {**EVERYDAY, "polished": 3.0})
    add_pictures(stage, half, height, 2)
    add_small_things(stage, int(generator.integers(8, 20)), (0.08, 0.35), POLISHED, tops=0.4)
    return stage


def make_workshop(generator: Generator, light: float) -> Stage:
    """Return a room of thin things: racks, cables, lattices, coils, rods, lit by tubes and panels."""
    stage, half, height = draw_room(generator)
    add_shell(stage, half, height, draw_floor_surface(generator), {})
    add_ceiling_panels(stage, half, height, 3.0 * light)
    add_cables_across(stage, half, height)
    shares = {**EVERYDAY, "brushed": 2.0, "worn": 2.0}
    for _ in range(int(generator.integers(2, 5))):
        place = choose_spot(stage, 0.5, 1.4)
        if place is not None:
            lattice = make_lattice(generator, (0.6, float(generator.uniform(0.4, 0.9))))
            turn = float(generator.uniform(-70.0, 70.0))
            add_surfaces(stage, "lattice", lattice, place, turn, draw_surface(generator, shares, 2.0))
    for _ in range(2):
        add_rack(stage, shares)
    furnish(stage, 2, shares)
    for _ in range(int(generator.integers(2, 9))):
        place = choose_spot(stage, 0.12, 1.5)
        if place is not None:
            top = (
                *(float(each) for each in generator.uniform(-0.25, 0.25, 1)),
                1.6,
                float(generator.uniform(-0.25, 0.25)),
            )
            rod = [make_rod((0.0, 0.0, 0.0), top, draw_log(generator, 0.005, 0.03))]
            add_surfaces(stage, "rod", rod, place, 0.0, draw_surface(generator, shares, 2.0))
    add_small_things(stage, int(generator.integers(6, 16)), (0.05, 0.2), shares)
    return stage


def _add_sky(stage: Stage, light: float, *, blocks: float) -> None:
    generator = stage.generator
    sky = make_sky(generator)
    around = draw_surroundings(generator, sky) if generator.random() < blocks else sky
    stage.add("sky", {"type": "envmap", "bitmap": (light * around).astype(np.float32)})


def _add_ground(stage: Stage, reach: float, shares: dict[str, float]) -> None:
    generator = stage.generator
    ground = draw_surface(generator, shares, draw_log(generator, 3.0, 15.0))
    stage.add("ground", parts.rectangle((0, 0, 0), (0, 1, 0), (reach, reach), ground))
    if generator.random() < 0.4:
        back = draw_plain(generator)
        stage.add("back", parts.rectangle((0, 0.8, -0.45 * reach), (0, 0.8, 0), (0.6 * reach, 0.8), back))


def make_stand(generator: Generator, light: float, shares: dict[str, float], *, glass: float, count: int) -> Stage:
    """Return things of some materials on the ground and on low tables, near the camera, under a sky."""
    reach = float(generator.uniform(0.7, 1.4))
    stage = start(generator, (-reach, 0.0, -reach), (reach, 1.5, 0.7 * reach))
    aim_around(stage, (0.0, 0.22, -0.1), float(generator.uniform(1.7, 2.8)), float(generator.uniform(32.0, 55.0)))
    _add_sky(stage, light, blocks=0.6)
    _add_ground(stage, 6.0, {**FLOOR_OF_STAND, **shares})
    if generator.random() < 0.5:
        at, size = (0.0, 0.0, -0.35 * reach), (0.5 * reach, 0.3 * reach)
        height = float(generator.uniform(0.12, 0.4))
        table = make_table(generator, size, height)
        add_surfaces(
            stage, "table", table, at, float(generator.uniform(-15.0, 15.0)), draw_surface(generator, shares, 2.0)
        )
        stage.tops.append(((at[0], height, at[2]), 0.85 * size[1]))
        stage.places.append((at, 0.4 * reach))
    add_small_things(stage, count, (0.06, 0.3), shares, glass=glass, tops=0.35)
    return stage


FLOOR_OF_STAND = {"painted": 2.0, "satin": 2.0, "printed": 0.5}


def make_garden(generator: Generator, light: float) -> Stage:
    """Return plants, fences and lines before a horizon, under a sky."""
    reach = float(generator.uniform(1.4, 2.6))
    stage = start(generator, (-reach, 0.0, -reach), (reach, 3.0, 0.7 * reach))
    aim_around(stage, (0.0, 0.5, -0.3), float(generator.uniform(3.2, 4.6)), float(generator.uniform(35.0, 60.0)))
    _add_sky(stage, light, blocks=0.8)
    _add_ground(stage, 12.0, {"painted": 3.0, "embossed": 2.0, "worn": 1.0})
    leaves = [draw_surface(generator, {"painted": 2.0, "satin": 1.0, "old": 1.0}, 1.0) for _ in range(3)]
    for _ in range(int(generator.integers(4, 11))):
        height = draw_log(generator, 0.25, 1.1)
        place = choose_spot(stage, 0.3 * height, height)
        if place is not None:
            plant = make_plant(generator, height)
            add_surfaces(stage, "plant", plant, place, 0.0, leaves[int(generator.integers(3))])
    for _ in range(int(generator.integers(1, 4))):
        place = choose_spot(stage, 0.6, 1.0)
        if place is not None:
            fence = make_lattice(generator, (float(generator.uniform(0.5, 1.2)), float(generator.uniform(0.25, 0.6))))
            turn = float(generator.uniform(-60.0, 60.0))
            add_surfaces(stage, "fence", fence, place, turn, draw_surface(generator, EVERYDAY, 2.0))
    if generator.random() < 0.5:
        ends = (-2.0 * reach, 1.6, -reach), (2.0 * reach, 1.9, -0.6 * reach)
        stage.add("lines", make_mesh(make_cables(generator, *ends), draw_plain(generator, 0.03, 0.3)))
    add_small_things(stage, int(generator.integers(6, 16)), (0.06, 0.3), {**EVERYDAY, **LAYERED}, tops=0.0)
    return stage


def make_desk(generator: Generator, light: float) -> Stage:
    """Return a table top seen from near by, under small lamps and one panel, before walls."""
    stage = start(generator, (-0.55, 0.0, -0.5), (0.55, 1.0, 0.35))
    aim_around(stage, (0.0, 0.1, -0.05), float(generator.uniform(0.9, 1.3)), float(generator.uniform(35.0, 60.0)))
    top = draw_surface(generator, {**EVERYDAY, "polished": 1.5}, draw_log(generator, 1.0, 6.0))
    add_surfaces(stage, "top", make_boxes([Box((0.0, -0.03, 0.0), (0.9, 0.03, 0.7))]), (0.0, 0.0, 0.0), 0.0, top)
    walls = draw_plain(generator), draw_plain(generator)
    stage.add("back", parts.rectangle((0, 0.6, -1.0), (0, 0.6, 0), (2.6, 2.0), walls[0]))
    stage.add("front", parts.rectangle((0, 0.6, 2.5), (0, 0.6, 0), (2.6, 2.0), walls[1]))
    for side in (-1.0, 1.0):
        stage.add("side", parts.rectangle((2.5 * side, 0.6, 0.7), (0, 0.6, 0.7), (2.0, 2.0), walls[1]))
    over = (float(generator.uniform(-0.8, 0.8)), 2.4, float(generator.uniform(-0.5, 1.0)))
    size = (draw_log(generator, 0.1, 0.5), draw_log(generator, 0.1, 0.5))
    stage.add("panel", parts.light(over, (0.0, 0.0, 0.0), size, scale_color(draw_light_color(generator), 6.0 * light)))
    stage.add("ceiling", parts.rectangle((0, 2.6, 0.7), (0, 0, 0.7), (2.6, 2.0), draw_plain(generator, 0.3, 0.9)))
    for _ in range(int(generator.integers(0, 3))):
        color = scale_color(draw_light_color(generator, 0.8), 8.0 * light)
        place = choose_spot(stage, 0.05, 0.3)
        if place is not None:
            lift, radius = float(generator.uniform(0.1, 0.35)), draw_log(generator, 0.012, 0.03)
            stage.add("lamp", parts.bulb((place[0], lift, place[2]), radius, color))
            pole = [make_rod((0.0, 0.0, 0.0), (0.0, lift - radius, 0.0), 0.004)]
            add_surfaces(stage, "pole", pole, place, 0.0, draw_plain(generator, 0.03, 0.4))
    add_small_things(
        stage, int(generator.integers(10, 26)), (0.02, 0.11), {**EVERYDAY, **LAYERED}, glass=0.12, tops=0.0
    )
    coil = draw_surface(generator, {"polished": 1.0, "brushed": 1.0, "painted": 1.0}, 2.0)
    place = choose_spot(stage, 0.08, 0.05)
    if place is not None:
        add_surfaces(stage, "coil", make_coil(generator, 0.07), place, 0.0, coil)
    return stage
