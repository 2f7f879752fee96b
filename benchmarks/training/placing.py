"""Where the things of `kinds.py` stand: free places on floors and tops that the camera sees, and shells of rooms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.training.clutter import SMALL, make_vessel
from benchmarks.training.materials import Generator, draw_log
from benchmarks.training.meshes import Box, Surface, make_boxes, make_mesh, move
from benchmarks.training.settings import Stage, aim, is_in_view
from benchmarks.training.surfaces import draw_glass, draw_plain, draw_surface
from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector

TRIES = 40
"""Places tried for a thing before it is left out."""

LEAST_DISTANCE, RADII_AWAY = 0.35, 2.8
"""From the camera to a thing: this much beyond its radius, and at least so many radii to its middle."""

UNSEEN = 0.1
"""How often a thing may stand outside of the picture."""

WALL_THICKNESS = 0.12


def start(generator: Generator, low: Vector, high: Vector) -> Stage:
    """Return a stage whose things stand between two corners."""
    return Stage(generator, low, high, {})


def aim_inside(stage: Stage, half: tuple[float, float], height: float) -> None:
    """Place the camera near the front wall of a room, looking in."""
    generator = stage.generator
    side = float(generator.uniform(-0.7, 0.7))
    origin = (side * half[0], float(generator.uniform(0.45, 0.75) * min(height, 2.4)), 0.9 * half[1])
    target = (
        float(generator.uniform(-0.5, 0.5) * half[0]),
        float(generator.uniform(0.3, 0.55) * min(height, 2.6)),
        float(-0.5 * half[1]),
    )
    aim(stage, origin, target, float(generator.uniform(45.0, 80.0)))


def aim_around(stage: Stage, target: Vector, distance: float, fov: float) -> None:
    """Place the camera before a target, somewhat above it."""
    generator = stage.generator
    turn, lift = generator.uniform(-0.7, 0.7), generator.uniform(0.05, 0.55)
    way = np.array([np.sin(turn) * np.cos(lift), np.sin(lift), np.cos(turn) * np.cos(lift)])
    x, y, z = (float(each) for each in np.array(target) + distance * way)
    aim(stage, (x, max(y, 0.12 * distance), z), target, fov)


def choose_spot(stage: Stage, radius: float, height: float) -> Vector | None:
    """Return a free place on the floor for a thing of a radius and a height, or None where no try found one."""
    generator = stage.generator
    for _ in range(TRIES):
        x, z = (float(generator.uniform(stage.low[k] + radius, stage.high[k] - radius)) for k in (0, 2))
        middle = (x, stage.low[1] + 0.5 * height, z)
        away = np.hypot(x - stage.origin[0], z - stage.origin[2])
        if away < max(radius + LEAST_DISTANCE, RADII_AWAY * max(radius, 0.4 * height)):
            continue
        if not is_in_view(stage, middle, 0.5) and generator.random() >= UNSEEN:
            continue
        if all(np.hypot(x - at[0], z - at[2]) > 0.9 * (radius + other) for at, other in stage.places):
            stage.places.append(((x, 0.0, z), radius))
            return (x, stage.low[1], z)
    return None


def choose_top(stage: Stage, radius: float) -> Vector | None:
    """Return a place on a top that something may be put on, or None where none is wide enough."""
    generator = stage.generator
    wide = [(at, half) for at, half in stage.tops if half > 1.05 * radius]
    if not wide:
        return None
    at, half = wide[int(generator.integers(len(wide)))]
    for _ in range(TRIES):
        x, z = generator.uniform(-1.0, 1.0, 2) * (half - radius)
        place = (at[0] + float(x), at[1], at[2] + float(z))
        clear = max(RADII_AWAY * radius, radius + LEAST_DISTANCE)
        if np.linalg.norm(np.subtract(place, stage.origin)) < clear:
            continue
        if all(
            abs(other[1] - place[1]) > 0.01
            or np.hypot(place[0] - other[0], place[2] - other[2]) > 0.9 * (radius + size)
            for other, size in stage.places
        ):
            stage.places.append((place, radius))
            return place
    return None


def add_surfaces(stage: Stage, name: str, surfaces: Sequence[Surface], at: Vector, turn: float, bsdf: Item) -> None:
    """Add surfaces made around the origin as one mesh."""
    stage.add(name, make_mesh(move(surfaces, at, turn), bsdf))


def add_small_things(
    stage: Stage,
    count: int,
    sizes: tuple[float, float],
    shares: dict[str, float],
    *,
    glass: float = 0.08,
    tops: float = 0.6,
) -> None:
    """Place up to ``count`` small things of some half widths, on tops with the probability ``tops``, else on the floor.

    ``shares`` tells of which materials they are, ``glass`` how often of glass.
    """
    generator = stage.generator
    for size in sorted((draw_log(generator, *sizes) for _ in range(count)), reverse=True):
        place = choose_top(stage, size) if generator.random() < tops else None
        place = place or choose_spot(stage, size, 2.0 * size)
        if place is None:
            continue
        periods = draw_log(generator, 1.0, 6.0)
        if generator.random() < glass:
            stage.add("glass", _draw_glass_thing(generator, place, size))
            continue
        bsdf, kind = draw_surface(generator, shares, periods), generator.random()
        if kind < 0.3:
            stage.add("vessel", make_vessel(generator, place, size, bsdf))
        elif kind < 0.42:
            stage.add("ball", parts.sphere((place[0], place[1] + size, place[2]), size, bsdf))
        else:
            name = str(generator.choice(list(SMALL)))
            add_surfaces(stage, name, SMALL[name](generator, size), place, float(generator.uniform(0.0, 360.0)), bsdf)


def _draw_glass_thing(generator: Generator, at: Vector, size: float) -> Item:
    glass = draw_glass(generator)
    kind = generator.random()
    if kind < 0.4:
        return make_vessel(generator, at, size, glass)
    if kind < 0.7:
        return parts.sphere((at[0], at[1] + size + 1e-3, at[2]), size, glass)
    half = (
        size * generator.uniform(0.4, 0.9),
        size * generator.uniform(0.5, 1.5),
        size * draw_log(generator, 0.08, 0.8),
    )
    return parts.box((at[0], at[1] + half[1] + 1e-3, at[2]), half, glass, float(generator.uniform(0.0, 360.0)))


Opening = tuple[float, float, float, float]
"""Left, right, bottom and top of a hole in a wall."""


def make_pierced_wall(half: float, height: float, openings: Sequence[Opening]) -> list[Surface]:
    """Return a wall in the plane z = 0, from -half to half, with holes beside one another, from left to right."""
    boxes, x = [], -half - WALL_THICKNESS
    thick = 0.5 * WALL_THICKNESS

    def add(left: float, right: float, bottom: float, top: float) -> None:
        if right - left > 1e-4 and top - bottom > 1e-4:
            middle = (0.5 * (left + right), 0.5 * (bottom + top), -thick)
            boxes.append(Box(middle, (0.5 * (right - left), 0.5 * (top - bottom), thick)))

    for left, right, bottom, top in openings:
        add(x, left, -WALL_THICKNESS, height + WALL_THICKNESS)
        add(left, right, -WALL_THICKNESS, bottom)
        add(left, right, top, height + WALL_THICKNESS)
        x = right
    add(x, half + WALL_THICKNESS, -WALL_THICKNESS, height + WALL_THICKNESS)
    return make_boxes(boxes)


def draw_openings(generator: Generator, half: float, height: float) -> list[Opening]:
    """Return one to four windows of one size in a row, within a wall of half width ``half``."""
    count = int(generator.integers(1, 5))
    pitch = 1.8 * half / count
    wide = min(pitch * generator.uniform(0.4, 0.85), 2.2)
    bottom = height * generator.choice([generator.uniform(0.25, 0.45), 0.02])
    top = height * generator.uniform(0.75, 0.95)
    shift = generator.uniform(-0.1, 0.1) * half
    middles = shift + pitch * (np.arange(count) - 0.5 * (count - 1))
    return [(float(x - 0.5 * wide), float(x + 0.5 * wide), float(bottom), float(top)) for x in middles]


SIDES: dict[str, float] = {"back": 0.0, "left": 90.0, "right": -90.0, "front": 180.0}
"""Walls by name, with the turn of a wall that is made in the plane z = 0 and faces +z."""


def place_side(side: str, half: tuple[float, float]) -> tuple[Vector, float]:
    """Return where the middle of a wall's foot is, and its half width."""
    x, z = half
    feet = {"back": (0.0, 0.0, -z), "left": (-x, 0.0, 0.0), "right": (x, 0.0, 0.0), "front": (0.0, 0.0, z)}
    return feet[side], x if side in ("back", "front") else z


def add_shell(
    stage: Stage, half: tuple[float, float], height: float, floor: Item, openings: dict[str, list[Opening]]
) -> None:
    """Add floor, ceiling and four walls, of which some have openings; the walls have one or two materials."""
    generator = stage.generator
    wall, other = draw_plain(generator, 0.15, 0.85), draw_plain(generator, 0.15, 0.85)
    reach = half[0] + WALL_THICKNESS, half[1] + WALL_THICKNESS
    ceiling = draw_plain(generator, 0.4, 0.9) if generator.random() < 0.3 else parts.diffuse((0.75, 0.74, 0.72))
    stage.add("floor", parts.rectangle((0, 0, 0), (0, 1, 0), reach, floor))
    stage.add("ceiling", parts.rectangle((0, height, 0), (0, 0, 0), reach, ceiling))
    for side, turn in SIDES.items():
        foot, wide = place_side(side, half)
        bsdf = other if side == "back" or generator.random() < 0.2 else wall
        add_surfaces(stage, "wall", make_pierced_wall(wide, height, openings.get(side, [])), foot, turn, bsdf)
