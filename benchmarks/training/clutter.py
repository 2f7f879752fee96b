"""Things that stand about in the scenes of `kinds.py`: furniture on thin legs, shelves, plants, vessels, cables.

Each function returns surfaces around the origin, on the floor y = 0, in metres; `benchmarks.training.meshes.move` puts
them into place and `make_mesh` gives them a material.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.training.materials import Array, Generator, draw_log
from benchmarks.training.meshes import Box, Surface, hang_line, make_blade, make_blob, make_boxes, make_tube
from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector


def make_rod(first: Vector, last: Vector, radius: float, sides: int = 8) -> Surface:
    """Return a straight rod between two points."""
    return make_tube(np.linspace(first, last, 3), radius, sides)


def make_chair(generator: Generator, size: float) -> list[Surface]:
    """Return a chair of seat height about ``size``: thin splayed legs, a back of slats or rods."""
    half, thin = 0.45 * size * generator.uniform(0.85, 1.15), draw_log(generator, 0.008, 0.022)
    height, splay, rise = size, generator.uniform(1.0, 1.25), size * generator.uniform(0.9, 1.3)
    surfaces = make_boxes([Box((0.0, height, 0.0), (half, generator.uniform(0.012, 0.04), half))])
    for x in (-1.0, 1.0):
        for z in (-1.0, 1.0):
            foot, top = (x * splay * half, 0.0, z * splay * half), (0.9 * x * half, height, 0.9 * z * half)
            surfaces.append(make_rod(foot, top, thin))
        surfaces.append(
            make_rod((0.9 * x * half, height, -0.9 * half), (0.9 * x * half, height + rise, -1.1 * half), thin)
        )
    count, upright = int(generator.integers(2, 8)), generator.random() < 0.5
    for k in range(count):
        share = (k + 0.5) / count
        if upright:
            x = (1.8 * share - 0.9) * half
            bottom, top = (x, height, -0.9 * half), (x, height + rise, -1.1 * half)
            surfaces.append(make_rod(bottom, top, 0.6 * thin))
        else:
            lift = height + rise * (0.3 + 0.7 * share)
            surfaces += make_boxes([Box((0.0, lift, -1.05 * half), (0.92 * half, 0.25 * rise / count, 0.6 * thin))])
    return surfaces


def make_table(generator: Generator, half: tuple[float, float], height: float) -> list[Surface]:
    """Return a table: a thin top on rods, on trestles or on one foot."""
    thick, thin = generator.uniform(0.01, 0.035), draw_log(generator, 0.01, 0.035)
    surfaces = make_boxes([Box((0.0, height - thick, 0.0), (half[0], thick, half[1]))])
    kind = generator.random()
    if kind < 0.5:
        for x in (-0.9, 0.9):
            for z in (-0.9, 0.9):
                surfaces.append(
                    make_rod((x * half[0], 0.0, z * half[1]), (0.95 * x * half[0], height, 0.95 * z * half[1]), thin)
                )
    elif kind < 0.8:
        for x in (-0.75, 0.75):
            for z in (-0.9, 0.9):
                surfaces.append(
                    make_rod((x * half[0], 0.0, z * half[1]), (x * half[0], height, -0.6 * z * half[1]), thin)
                )
            surfaces.append(
                make_rod((x * half[0], 0.3 * height, -0.5 * half[1]), (x * half[0], 0.3 * height, 0.5 * half[1]), thin)
            )
    else:
        surfaces.append(make_rod((0.0, 0.0, 0.0), (0.0, height, 0.0), 2.0 * thin, 20))
        surfaces += make_boxes([Box((0.0, 0.015, 0.0), (0.5 * min(half), 0.015, 0.5 * min(half)), 45.0)])
    return surfaces


def make_rack(generator: Generator, half: tuple[float, float], height: float, boards: int) -> list[Surface]:
    """Return an open shelf: boards between sides or on rods."""
    thin = draw_log(generator, 0.008, 0.025)
    levels = [height * (k + 0.2) / boards for k in range(boards)]
    surfaces = make_boxes([Box((0.0, y, 0.0), (half[0], thin, half[1])) for y in levels])
    if generator.random() < 0.5:
        sides = [Box((x * half[0], 0.5 * height, 0.0), (thin, 0.5 * height, half[1])) for x in (-1.0, 1.0)]
        back = [Box((0.0, 0.5 * height, -half[1]), (half[0], 0.5 * height, 0.5 * thin))]
        return surfaces + make_boxes(sides + back)
    for x in (-1.0, 1.0):
        for z in (-0.9, 0.9):
            surfaces.append(make_rod((x * half[0], 0.0, z * half[1]), (x * half[0], height, z * half[1]), thin))
    return surfaces


def make_row(generator: Generator, width: float, depth: float, height: float, cells: int) -> list[Surface]:
    """Return upright thin volumes side by side, some gone, some leaning: what fills a shelf of ``width``."""
    boxes, x = [], -0.5 * width
    while x < 0.5 * width - 0.03:
        thick = draw_log(generator, 0.008, 0.035)
        tall = height * generator.uniform(0.55, 0.95)
        if generator.random() < 0.8:
            boxes.append(
                Box(
                    (x + thick, 0.5 * tall, generator.uniform(-0.1, 0.1) * depth),
                    (0.95 * thick, 0.5 * tall, 0.42 * depth),
                )
            )
        else:
            x += draw_log(generator, 0.02, 0.15)
        x += 2.0 * thick
    shift = int(generator.integers(cells))
    order = make_boxes([Box((0.0, -9.0, 0.0), (1e-4, 1e-4, 1e-4))] * shift + boxes, cells)
    return order[6 * shift :]


def make_stack(generator: Generator, size: float, cells: int) -> list[Surface]:
    """Return boxes piled up, each turned a little."""
    boxes, lift, turn = [], 0.0, generator.uniform(0.0, 360.0)
    for _ in range(int(generator.integers(2, 7))):
        half = (
            size * generator.uniform(0.5, 1.0),
            size * draw_log(generator, 0.08, 0.5),
            size * generator.uniform(0.4, 0.9),
        )
        turn += generator.uniform(-25.0, 25.0)
        boxes.append(
            Box((generator.uniform(-0.1, 0.1) * size, lift + half[1], generator.uniform(-0.1, 0.1) * size), half, turn)
        )
        lift += 2.0 * half[1]
    return make_boxes(boxes, cells)


def make_plant(generator: Generator, height: float) -> list[Surface]:
    """Return long leaves from one root, or small ones along stems."""
    surfaces, wide = [], height * draw_log(generator, 0.008, 0.04)
    grassy = generator.random() < 0.5
    for _ in range(int(generator.integers(14, 45)) if grassy else int(generator.integers(4, 9))):
        angle, lean = generator.uniform(0.0, 2.0 * np.pi), generator.uniform(0.1, 0.7)
        toward = height * generator.uniform(0.6, 1.1) * np.array([lean * np.cos(angle), 1.0, lean * np.sin(angle)])
        if grassy:
            surfaces.append(make_blade((0.0, 0.0, 0.0), tuple(toward), height * generator.uniform(0.0, 0.7), wide))
            continue
        stem = np.linspace(0.0, 1.0, 10)[:, None] * toward
        surfaces.append(make_tube(stem, 0.004, 6))
        for at in stem[3:]:
            way = generator.normal(size=3) * [1.0, 0.4, 1.0]
            leaf = height * generator.uniform(0.12, 0.25) * way / np.linalg.norm(way)
            surfaces.append(make_blade(tuple(at), tuple(leaf), 0.05 * height, 2.0 * wide))
    return surfaces


def make_coil(generator: Generator, size: float) -> list[Surface]:
    """Return a ring or a spring of wire, standing or lying."""
    turns = 1.0 if generator.random() < 0.4 else float(generator.uniform(2.0, 7.0))
    angle = np.linspace(0.0, 2.0 * np.pi * turns, int(48 * turns) + 1)
    wire = size * draw_log(generator, 0.02, 0.25 if turns == 1.0 else 0.1)
    pitch = 0.0 if turns == 1.0 else 2.6 * wire * draw_log(generator, 1.0, 3.0)
    points = np.stack([size * np.cos(angle), wire + pitch * angle / (2.0 * np.pi), size * np.sin(angle)], axis=-1)
    if turns == 1.0 and generator.random() < 0.5:
        points = points[:, [0, 2, 1]] + np.array([0.0, size + wire - 0.0, 0.0])
    return [make_tube(points, wire, 14)]


def make_lattice(generator: Generator, half: tuple[float, float]) -> list[Surface]:
    """Return an upright grid, fence or slatted screen, (half width, half height), in the plane z = 0."""
    x, y = half
    kind, thin = generator.choice(["slats", "bars", "grid", "levels"]), draw_log(generator, 0.004, 0.02)
    pitch = draw_log(generator, 0.05, 0.2)
    columns, rows = (np.arange(-each, each + 0.5 * pitch, pitch) for each in (x, y))
    frame = [make_rod((-x, lift, 0.0), (x, lift, 0.0), 1.2 * thin) for lift in (0.02, 2.0 * y)]
    if kind == "slats":
        tilt = generator.uniform(10.0, 70.0)
        return frame + make_boxes([Box((0.0, y + row, 0.0), (x, 0.35 * pitch, 0.002), 0.0, tilt) for row in rows])
    if kind == "levels":
        return frame + [make_rod((-x, y + row, 0.0), (x, y + row, 0.0), thin) for row in rows]
    bars = [make_rod((column, 0.0, 0.0), (column, 2.0 * y, 0.0), thin) for column in columns]
    if kind == "grid":
        bars += [make_rod((-x, y + row, 0.0), (x, y + row, 0.0), thin) for row in rows]
    return frame + bars


def make_cables(generator: Generator, first: Vector, last: Vector) -> list[Surface]:
    """Return a few lines that hang between two places."""
    surfaces = []
    for _ in range(int(generator.integers(1, 6))):
        shift = generator.uniform(-0.2, 0.2, (2, 3)) * [1.0, 0.3, 1.0]
        ends = tuple(np.array(first) + shift[0]), tuple(np.array(last) + shift[1])
        surfaces.append(make_tube(hang_line(*ends, generator.uniform(0.02, 0.35)), draw_log(generator, 0.003, 0.02), 8))
    return surfaces


def draw_profile(generator: Generator, size: float) -> Array:
    """Return the outline of a vessel, radius and height, (points, 2): bottle, bowl, cup or vase, with a thin wall."""
    tall = size * draw_log(generator, 0.6, 3.0)
    middle = size * generator.uniform(0.35, 1.0, 4)
    levels = (0.0, 0.3, 0.65, 1.0)
    outside = parts.curve(tuple((float(r), float(h * tall)) for r, h in zip(middle, levels, strict=True)))
    outside[:, 0] = np.clip(outside[:, 0], 0.2 * size, 1.3 * size)
    wall = size * generator.uniform(0.04, 0.12)
    inside = outside[::-1] * [1.0, 1.0]
    inside[:, 0] = np.maximum(inside[:, 0] - wall, 0.08 * size)
    inside = inside[inside[:, 1] > 1.5 * wall]
    base, floor = np.array([[0.0, 0.0], outside[0], outside[0]]), np.array([inside[-1], [0.0, inside[-1][1]]])
    return np.concatenate([base, outside[1:], outside[-1:], inside[:1], inside, floor])


def make_vessel(generator: Generator, at: Vector, size: float, bsdf: Item) -> Item:
    """Return a vessel that stands at a place; its outside is closed, so that it may be of glass."""
    return parts.lathe(draw_profile(generator, size), at, bsdf, 64)


def make_lump(generator: Generator, size: float) -> list[Surface]:
    """Return a smooth body: a pebble, a rounded box, a gourd."""
    half = size * generator.uniform(0.6, 1.2, 3)
    count = int(generator.integers(0, 5))
    bumps = np.stack(
        [
            generator.uniform(-0.16, 0.16, count),
            generator.integers(0, 7, count),
            generator.integers(0, 7, count),
            generator.uniform(0.0, 6.0, count),
        ],
        axis=-1,
    )
    roundness = float(generator.choice([1.0, 1.0, generator.uniform(0.35, 0.8), generator.uniform(1.2, 1.8)]))
    body = make_blob((0.0, 0.0, 0.0), tuple(half), bumps, roundness)
    lift = -float(body.position[..., 1].min())
    return [body._replace(position=body.position + np.array([0.0, lift, 0.0]))]


def make_heap(generator: Generator, size: float) -> list[Surface]:
    """Return a few small bodies beside one another."""
    surfaces: list[Surface] = []
    for _ in range(int(generator.integers(3, 9))):
        angle, away = generator.uniform(0.0, 2.0 * np.pi), size * np.sqrt(generator.random())
        radius = size * generator.uniform(0.2, 0.4)
        at = (away * np.cos(angle), radius, away * np.sin(angle))
        surfaces.append(make_blob(at, (radius, radius, radius), np.zeros((0, 4)), 1.0, 20))
    return surfaces


SMALL: dict[str, Callable[[Generator, float], list[Surface]]] = {
    "lump": make_lump,
    "heap": make_heap,
    "coil": make_coil,
    "plant": lambda generator, size: make_plant(generator, 2.0 * size),
    "stack": lambda generator, size: make_stack(generator, size, 4),
}
"""What stands on tables and floors, of about half width ``size``."""
