"""Rooms of `kinds.py`: with windows, lit from outside or by lamps in view, with shelves, screens and mirrors.

``light`` multiplies the radiance of every light. Lengths are metres, y is up.
"""

from __future__ import annotations

import numpy as np

from benchmarks.training.clutter import (
    make_cables,
    make_chair,
    make_lattice,
    make_rack,
    make_rod,
    make_row,
    make_table,
)
from benchmarks.training.materials import Generator, draw_color, draw_log
from benchmarks.training.meshes import Box, make_boxes, make_mesh, make_rotation, move
from benchmarks.training.pictures import draw_paint, draw_poster, draw_surroundings, draw_view
from benchmarks.training.placing import (
    SIDES,
    WALL_THICKNESS,
    Opening,
    add_shell,
    add_small_things,
    add_surfaces,
    aim_inside,
    choose_spot,
    choose_top,
    draw_openings,
    place_side,
    start,
)
from benchmarks.training.settings import Stage, draw_light_color, make_sky, scale_color
from benchmarks.training.surfaces import EVERYDAY, draw_plain, draw_surface
from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector

FLOORS = {"painted": 2.0, "satin": 3.0, "coated": 1.5, "polished": 0.7, "worn": 1.0, "embossed": 0.8, "old": 1.0}


def draw_room(generator: Generator) -> tuple[Stage, tuple[float, float], float]:
    """Return an empty stage inside a room, with the room's half sizes and height; the camera is aimed."""
    half = (float(generator.uniform(1.6, 3.6)), float(generator.uniform(1.9, 4.2)))
    height = float(generator.uniform(2.3, 3.6))
    stage = start(generator, (0.1 - half[0], 0.0, 0.1 - half[1]), (half[0] - 0.1, height, 0.75 * half[1]))
    aim_inside(stage, half, height)
    return stage, half, height


def draw_floor_surface(generator: Generator) -> Item:
    """Return the material of a room's floor."""
    return draw_surface(generator, FLOORS, draw_log(generator, 2.0, 12.0))


def _look_from(side: str, half: tuple[float, float], point: Vector) -> Vector:
    """Return a point given in a wall's own plane, x along the wall and z into the room, in the world."""
    foot, _ = place_side(side, half)
    x, y, z = (float(each) for each in make_rotation(SIDES[side]) @ np.array(point) + np.array(foot))
    return x, y, z


def add_windows(
    stage: Stage, half: tuple[float, float], side: str, openings: list[Opening], view: float | None
) -> None:
    """Add frames, some blinds, and where ``view`` is a radiance a lit picture behind each hole of a wall."""
    generator = stage.generator
    foot, _ = place_side(side, half)
    frame, thin, boxes = draw_plain(generator, 0.05, 0.85), draw_log(generator, 0.015, 0.05), []
    bars, sashes = int(generator.integers(0, 3)), int(generator.integers(0, 3))
    blinds = generator.random() < 0.25
    for left, right, bottom, top in openings:
        x, y, wide, tall = 0.5 * (left + right), 0.5 * (bottom + top), 0.5 * (right - left), 0.5 * (top - bottom)
        for share in np.linspace(-1.0, 1.0, bars + 2):
            boxes.append(Box((x + share * (wide - thin), y, -0.5 * WALL_THICKNESS), (thin, tall, 0.03)))
        for share in np.linspace(-1.0, 1.0, sashes + 2):
            boxes.append(Box((x, y + share * (tall - thin), -0.5 * WALL_THICKNESS), (wide, thin, 0.03)))
        if blinds:
            lattice = make_lattice(generator, (wide, tall))
            at = _look_from(side, half, (x, bottom, 0.03))
            add_surfaces(stage, "blind", lattice, at, SIDES[side], draw_plain(generator, 0.2, 0.85))
        if view is not None:
            picture = parts.texture(view * draw_view(generator))
            center, toward = (_look_from(side, half, (x, y, z)) for z in (-WALL_THICKNESS - 0.05, 1.0))
            size = (wide + 0.1, tall + 0.1)
            stage.add("view", parts.light(center, toward, size, picture, up=(0, 1, 0)))
    add_surfaces(stage, "frames", make_boxes(boxes), foot, SIDES[side], frame)


def furnish(stage: Stage, count: int, shares: dict[str, float]) -> None:
    """Place tables with chairs, racks with what fills them, and screens of slats: ``count`` tries of each sort."""
    generator = stage.generator
    for _ in range(count):
        half, height = (draw_log(generator, 0.3, 0.8), draw_log(generator, 0.3, 0.7)), generator.uniform(0.35, 0.95)
        turn, radius = float(generator.uniform(-30.0, 30.0)), float(np.hypot(*half))
        place = choose_spot(stage, 0.8 * radius, height)
        if place is not None:
            table = make_table(generator, half, height)
            add_surfaces(stage, "table", table, place, turn, draw_surface(generator, shares, 2.0))
            stage.tops.append(((place[0], place[1] + height, place[2]), 0.8 * min(half)))
    seat, several = draw_surface(generator, shares, 2.0), make_chair(generator, float(generator.uniform(0.38, 0.6)))
    for _ in range(count + 1):
        place = choose_spot(stage, 0.32, 0.9)
        if place is not None:
            add_surfaces(stage, "chair", several, place, float(generator.uniform(0.0, 360.0)), seat)
    if generator.random() < 0.6:
        add_rack(stage, shares)
    if generator.random() < 0.35:
        place = choose_spot(stage, 0.4, 1.2)
        if place is not None:
            lattice = make_lattice(generator, (0.45, float(generator.uniform(0.4, 0.8))))
            turn = float(generator.uniform(-50.0, 50.0))
            add_surfaces(stage, "lattice", lattice, place, turn, draw_surface(generator, shares, 2.0))


def add_rack(stage: Stage, shares: dict[str, float]) -> None:
    """Place a rack with rows of thin volumes and small things on its boards."""
    generator = stage.generator
    half, height, boards = (
        (draw_log(generator, 0.35, 0.8), generator.uniform(0.12, 0.2)),
        generator.uniform(0.8, 2.1),
        4,
    )
    boards = int(generator.integers(2, 6))
    place = choose_spot(stage, half[0], height)
    if place is None:
        return
    turn = float(generator.uniform(-25.0, 25.0))
    rack = make_rack(generator, half, height, boards)
    add_surfaces(stage, "rack", rack, place, turn, draw_surface(generator, shares, 2.0))
    cells, rows = 16, []
    for k in range(boards):
        lift = height * (k + 0.2) / boards + 0.025
        row = make_row(generator, 1.85 * half[0], 2.0 * half[1], 0.8 * height / boards, cells)
        rows += move(row, (0.0, lift, 0.0)) if row else []
    if rows:
        # Each volume shows a strip of a picture that is as many colours wide.
        colors = np.array([draw_color(generator, 0.04, 0.85) for _ in range(cells)])
        picture = np.repeat(colors, 16, axis=0)[None] * (0.5 + 0.5 * draw_paint(generator, 4.0))
        kinds = (
            parts.diffuse(parts.texture(picture)),
            parts.plastic(parts.texture(picture), draw_log(generator, 0.05, 0.4)),
        )
        add_surfaces(stage, "row", rows, place, turn, kinds[int(generator.integers(2))])


def add_pictures(stage: Stage, half: tuple[float, float], height: float, count: int, lit: float | None = None) -> None:
    """Hang posters in frames on walls, ``count`` of them; where ``lit`` is a radiance they are screens."""
    generator = stage.generator
    used: list[tuple[str, float]] = []
    for _ in range(count):
        side = str(generator.choice(["back", "back", "left", "right"]))
        _, wide = place_side(side, half)
        size = (draw_log(generator, 0.2, 0.7), draw_log(generator, 0.2, 0.55))
        x = float(generator.uniform(-0.8, 0.8) * (wide - size[0]))
        if any(side == other and abs(x - at) < size[0] + 0.75 for other, at in used):
            continue
        used.append((side, x))
        y = float(generator.uniform(0.5, 0.65) * height)
        center, toward = (_look_from(side, half, (x, y, z)) for z in (0.03, 1.0))
        picture = parts.texture((lit or 1.0) * draw_poster(generator))
        if lit is None:
            gloss = generator.random() < 0.5
            bsdf = parts.plastic(picture, draw_log(generator, 0.01, 0.3)) if gloss else parts.diffuse(picture)
            stage.add("poster", parts.rectangle(center, toward, size, bsdf))
        else:
            stage.add("screen", parts.light(center, toward, size, picture, up=(0, 1, 0)))
        edge = make_boxes([Box((0.0, 0.0, 0.0), (size[0] + 0.03, size[1] + 0.03, 0.012))])
        add_surfaces(stage, "edge", edge, _look_from(side, half, (x, y, 0.014)), SIDES[side], draw_plain(generator))


def add_lamp(stage: Stage, at: Vector, height: float, radiance: Vector) -> None:
    """Add a lamp on a thin pole: a ball of light in an open shade, in half a shade, or bare."""
    generator = stage.generator
    radius = draw_log(generator, 0.04, 0.11)
    top = at[1] + height
    stage.add("lamp", parts.bulb((at[0], top, at[2]), radius, radiance))
    metal = draw_surface(generator, {"painted": 1.0, "polished": 1.0, "brushed": 1.0}, 2.0)
    pole = [make_rod((0.0, 0.0, 0.0), (0.0, height - radius, 0.0), 0.012)]
    pole += make_boxes([Box((0.0, 0.01, 0.0), (0.1, 0.01, 0.1))])
    add_surfaces(stage, "pole", pole, at, 0.0, metal)
    kind = generator.random()
    if kind < 0.6:
        wide, narrow = radius * generator.uniform(1.6, 3.0), radius * generator.uniform(1.2, 1.6)
        low, high = -radius * generator.uniform(0.3, 1.5), radius * generator.uniform(1.2, 2.5)
        profile = (
            np.array([[wide, low], [narrow, high]])
            if generator.random() < 0.7
            else np.array([[narrow, low], [wide, high]])
        )
        stage.add("shade", parts.lathe(profile, (at[0], top, at[2]), draw_plain(generator, 0.4, 0.9), 48))


def add_pendant(stage: Stage, at: Vector, ceiling: float, radiance: Vector) -> None:
    """Add a lamp that hangs from the ceiling by a wire, under a shade or bare."""
    generator = stage.generator
    radius = draw_log(generator, 0.05, 0.14)
    stage.add("pendant", parts.bulb(at, radius, radiance))
    wire = [make_rod((at[0], at[1] + radius, at[2]), (at[0], ceiling, at[2]), 0.006, 6)]
    stage.add("wire", make_mesh(wire, draw_plain(generator, 0.03, 0.3)))
    if generator.random() < 0.6:
        wide = radius * generator.uniform(1.5, 3.5)
        profile = parts.curve(((wide, -0.5 * radius), (0.8 * wide, 0.9 * radius), (0.1 * radius, 1.6 * radius)), 6)
        shade = draw_surface(generator, {"painted": 2.0, "polished": 1.0, "coated": 1.0}, 1.0)
        stage.add("shade", parts.lathe(profile, at, shade, 48))


def add_lamps(stage: Stage, half: tuple[float, float], height: float, count: int, light: float) -> None:
    """Light a room by standing, hanging and table lamps and by tubes, mostly in view."""
    generator = stage.generator
    for _ in range(count):
        color = scale_color(draw_light_color(generator, 0.7), light * draw_log(generator, 0.5, 2.0))
        kind = generator.random()
        place = choose_top(stage, 0.12) if kind < 0.3 else None
        if place is not None:
            add_lamp(stage, place, float(generator.uniform(0.3, 0.5)), color)
        elif kind < 0.6:
            place = choose_spot(stage, 0.2, 1.5)
            if place is not None:
                add_lamp(stage, place, float(generator.uniform(0.9, 1.7)), color)
        elif kind < 0.85:
            at = (
                float(generator.uniform(-0.7, 0.7) * half[0]),
                0.72 * height,
                float(generator.uniform(-0.8, 0.1) * half[1]),
            )
            add_pendant(stage, at, height, color)
        else:
            side = str(generator.choice(["back", "left", "right"]))
            _, wide = place_side(side, half)
            x, y = float(generator.uniform(-0.6, 0.6) * wide), float(generator.uniform(0.55, 0.9) * height)
            center, toward = (_look_from(side, half, (x, y, z)) for z in (0.02, 1.0))
            size = (0.3 * wide, 0.015) if generator.random() < 0.6 else (0.02, 0.25 * height)
            stage.add("tube", parts.light(center, toward, size, color, up=(0, 1, 0)))
    # However few found a place, there is light.
    over = (0.0, height - 0.02, float(-0.2 * half[1]))
    weak = scale_color(draw_light_color(generator), 0.05 * light)
    stage.add("panel", parts.light(over, (0.0, 0.0, over[2]), (0.3, 0.2), weak))


def add_cables_across(stage: Stage, half: tuple[float, float], height: float) -> None:
    """Hang cables from wall to wall."""
    generator = stage.generator
    for _ in range(int(generator.integers(1, 4))):
        z = generator.uniform(-0.9, 0.0, 2) * half[1]
        ends = (-half[0], 0.85 * height, float(z[0])), (half[0], 0.85 * height, float(z[1]))
        cables = make_mesh(
            make_cables(generator, *ends), draw_surface(generator, {"painted": 1.0, "polished": 1.0}, 1.0)
        )
        stage.add("cables", cables)


def make_daylit(generator: Generator, light: float, *, sky: bool) -> Stage:
    """Return a room with windows, mostly in view, lit by the sky or by bright pictures behind them."""
    stage, half, height = draw_room(generator)
    first = str(generator.choice(["back", "left", "right"], p=[0.5, 0.25, 0.25]))
    sides = {first, str(generator.choice(["back", "left", "right", "front"]))}
    openings = {side: draw_openings(generator, place_side(side, half)[1], height) for side in sorted(sides)}
    add_shell(stage, half, height, draw_floor_surface(generator), openings)
    for side, holes in openings.items():
        add_windows(stage, half, side, holes, None if sky else light * draw_log(generator, 0.5, 1.5))
    if sky:
        around = draw_surroundings(generator, make_sky(generator))
        stage.add("sky", {"type": "envmap", "bitmap": (light * around).astype(np.float32)})
    furnish(stage, int(generator.integers(1, 4)), EVERYDAY)
    if "back" not in sides:
        add_pictures(stage, half, height, int(generator.integers(0, 4)))
    add_small_things(stage, int(generator.integers(8, 24)), (0.05, 0.2), EVERYDAY)
    if generator.random() < 0.3:
        add_lamps(stage, half, height, 2, 2.0 * light)
    return stage


def make_evening(generator: Generator, light: float) -> Stage:
    """Return a room lit by lamps in view; its windows, if any, show a dim evening."""
    stage, half, height = draw_room(generator)
    openings = {}
    if generator.random() < 0.5:
        openings["back"] = draw_openings(generator, half[0], height)
    add_shell(stage, half, height, draw_floor_surface(generator), openings)
    if openings:
        add_windows(stage, half, "back", openings["back"], 0.04 * light)
    furnish(stage, int(generator.integers(1, 4)), EVERYDAY)
    add_lamps(stage, half, height, int(generator.integers(2, 7)), 4.0 * light)
    add_small_things(stage, int(generator.integers(8, 24)), (0.05, 0.22), EVERYDAY)
    return stage
