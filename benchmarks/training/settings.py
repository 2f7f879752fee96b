"""Settings and objects of the random scenes of `kinds.py`: every draw is from the generator passed in.

Lengths are metres, y is up, and ``light`` multiplies the radiance of every light.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.training.materials import (
    Array,
    Generator,
    add_relief,
    draw_albedo,
    draw_color,
    draw_families,
    draw_log,
    draw_material,
)
from lobewise.scenes import parts
from lobewise.scenes.parts import Item, Vector

CLEARANCE, NEAREST = 0.5, 3.0
"""Least distance from the camera to an object's surface, and from it to the middle in radii: none fills the picture."""

LAMP_CLEARANCE = 2.0
"""Least distance from the camera to a lamp that hangs in a dark room."""

UNSEEN = 0.15
"""How often an object may stand outside of the picture, to be seen in others or to cast its shadow."""

TRIES = 30
"""Places tried for an object before it is left out."""


@dataclass
class Stage:
    """A scene in the making: where its objects may stand, what was placed so far, how the camera looks."""

    generator: Generator
    low: Vector
    high: Vector
    families: dict[str, float]
    origin: Vector = (0.0, 1.5, 4.0)
    target: Vector = (0.0, 0.5, 0.0)
    fov: float = 45.0
    items: dict[str, Item] = field(default_factory=dict)
    tops: list[tuple[Vector, float]] = field(default_factory=list)
    """Middle and half width of the flat tops that something may be put on."""
    places: list[tuple[Vector, float]] = field(default_factory=list)
    """Middle and radius of everything placed."""

    def add(self, name: str, item: Item) -> None:
        """Add an item under a name of its own."""
        self.items[f"{name}_{len(self.items)}"] = item


def _make_transform(center: Vector, turn: float, tilt: float, scale: Vector) -> tuple[tuple[Any, ...], ...]:
    """Return what scales, tilts by degrees about x, turns about the vertical and moves, in this order."""
    turned = ("rotate", [0, 1, 0], turn), ("rotate", [1, 0, 0], tilt)
    return ("translate", list(center)), *turned, ("scale", list(scale))


def _draw_shape(stage: Stage, kind: str, size: float) -> tuple[Item, Vector, bool]:
    """Return a shape of about half size ``size`` without its place, its half extents, and whether its top is flat."""
    generator = stage.generator
    if kind == "sphere":
        return {"type": "sphere"}, (size, size, size), False
    if kind == "box":
        x, y, z = (size * draw_log(generator, 0.4, 1.6) for _ in range(3))
        return {"type": "cube"}, (x, y, z), True
    if kind == "pole":
        thin = draw_log(generator, 0.008, 0.04)
        return {"type": str(generator.choice(["cube", "cylinder"]))}, (thin, 2.0 * size, thin), False
    if kind == "slab":
        return {"type": "cube"}, (size, draw_log(generator, 0.01, 0.04), size * generator.uniform(0.5, 1.5)), True
    if kind == "cylinder":
        return {"type": "cylinder"}, (size, size * draw_log(generator, 0.4, 2.0), size), False
    # Sheets stand upright: a screen, a mirror, a disc on its rim.
    return {"type": "disk" if kind == "disc" else "rectangle"}, (size, size * generator.uniform(0.6, 1.4), size), False


SHAPES = {"sphere": 0.34, "box": 0.26, "cylinder": 0.12, "pole": 0.1, "slab": 0.06, "sheet": 0.06, "disc": 0.06}


def _orient(shape: Item, center: Vector, half: Vector, turn: float, tilt: float) -> tuple[tuple[Any, ...], ...]:
    """Return the transform of a shape: upright is its own axis, where Mitsuba's is z."""
    kind = shape["type"]
    if kind == "cube":
        return _make_transform(center, turn, tilt, half)
    if kind in ("rectangle", "disk"):
        return _make_transform(center, turn, tilt, (half[0], half[1], 1.0))
    upright = *_make_transform(center, turn, tilt, (1.0, 1.0, 1.0)), ("rotate", [1, 0, 0], -90)
    if kind == "sphere":
        return *upright, ("scale", half[0])
    # Mitsuba's cylinder has radius 1 and reaches from z = 0 to 1.
    return *upright, ("translate", [0, 0, -half[1]]), ("scale", [half[0], half[2], 2.0 * half[1]])


def is_in_view(stage: Stage, point: Vector, share: float = 0.55) -> bool:
    """Return whether a point lies within a cone about the camera's axis, whose half angle is a share of the view's."""
    toward, axis = np.subtract(point, stage.origin), np.subtract(stage.target, stage.origin)
    cosine = toward @ axis / (np.linalg.norm(toward) * np.linalg.norm(axis))
    return bool(cosine > np.cos(np.deg2rad(share * stage.fov)))


def _choose_place(stage: Stage, half: Vector, kind: str) -> tuple[Vector, bool] | None:
    """Return a middle that is free, and whether it floats; None where no try found one."""
    generator = stage.generator
    radius = float(np.hypot(half[0], half[2]))
    low, high = stage.low, stage.high
    for _ in range(TRIES):
        where = generator.random()
        floats = where < 0.14
        if where > 0.78 and stage.tops and kind != "pole":
            top, width = stage.tops[int(generator.integers(len(stage.tops)))]
            if max(half[0], half[2]) > 1.2 * width:
                continue
            shift = generator.uniform(-0.4, 0.4, 2) * width
            middle = (top[0] + float(shift[0]), top[1] + half[1], top[2] + float(shift[1]))
        else:
            x, z = (float(generator.uniform(low[k] + 0.6 * radius, high[k] - 0.6 * radius)) for k in (0, 2))
            lift = generator.uniform(0.1, 0.6) * (high[1] - low[1]) if floats else 0.0
            middle = (x, low[1] + half[1] + float(lift), z)
        if middle[1] + half[1] > high[1]:
            continue
        reach = float(np.linalg.norm(half))
        if np.linalg.norm(np.subtract(middle, stage.origin)) < max(reach + CLEARANCE, NEAREST * reach):
            continue
        if not is_in_view(stage, middle) and generator.random() >= UNSEEN:
            continue
        # A few cross each other on purpose: contacts without a gap.
        if generator.random() < 0.85 and any(
            np.hypot(middle[0] - other[0], middle[2] - other[2]) < 0.75 * (radius + size)
            and abs(middle[1] - other[1]) < 0.9 * (half[1] + size)
            for other, size in stage.places
        ):
            continue
        return middle, floats
    return None


def add_objects(stage: Stage, count: int, largest: float) -> None:
    """Place up to ``count`` objects: on the floor, on flat tops, a few in the air; large ones first."""
    generator = stage.generator
    sizes = sorted((draw_log(generator, 0.08, largest) for _ in range(count)), reverse=True)
    for size in sizes:
        kind = str(generator.choice(list(SHAPES), p=np.array(list(SHAPES.values()))))
        shape, half, flat = _draw_shape(stage, kind, size)
        found = _choose_place(stage, half, kind)
        if found is None:
            continue
        middle, floats = found
        closed = shape["type"] in ("sphere", "cube") and kind != "pole"
        shape["bsdf"] = draw_material(
            generator,
            stage.families,
            periods=draw_log(generator, 1.0, 8.0),
            size=2.0 * float(np.mean(half)),
            closed=closed,
        )
        turn = float(generator.uniform(0.0, 360.0))
        leans = floats or (kind == "pole" and generator.random() < 0.4)
        tilt = float(generator.uniform(-60.0, 60.0)) if leans else 0.0
        shape["to_world"] = _orient(shape, middle, half, turn, tilt)
        stage.add(kind, shape)
        stage.places.append((middle, max(half[0], half[2])))
        if flat and not floats:
            stage.tops.append(((middle[0], middle[1] + half[1], middle[2]), min(half[0], half[2])))


def draw_floor(stage: Stage, size: float) -> Item:
    """Return a floor's material: glossy and patterned more often than not."""
    generator = stage.generator
    periods = size * draw_log(generator, 0.3, 2.0)
    if generator.random() < 0.3:
        return parts.diffuse(draw_albedo(generator, periods, textured=0.7, low=0.05))
    families = {"principled": 0.5, "plastic": 0.25, "metal": 0.15, "diffuse": 0.05, "smooth plastic": 0.05}
    bsdf = draw_material(generator, families, periods=periods, size=size, closed=False, relief=0.0)
    return add_relief(generator, bsdf, size * draw_log(generator, 0.5, 2.0), size) if generator.random() < 0.3 else bsdf


def draw_wall(stage: Stage, size: float, low: float, high: float) -> Item:
    """Return a wall's material: diffuse as a rule, of an albedo within the bounds."""
    generator = stage.generator
    if generator.random() < 0.15:
        return draw_material(generator, stage.families, periods=size, size=size, closed=False)
    bsdf = parts.diffuse(
        draw_albedo(generator, size * draw_log(generator, 0.3, 2.0), low=low, high=high, saturated=0.4)
    )
    return add_relief(generator, bsdf, 2.0 * size, size) if generator.random() < 0.15 else bsdf


def _add_shell(stage: Stage, half: tuple[float, float], height: float, low: float, high: float) -> None:
    """Add floor, ceiling and four walls around a space of half width and half length ``half``."""
    x, z = half
    middle = 0.5 * height
    # Walls reach through each other a little, so that no ray slips out between them.
    wide, deep, tall = x + 0.05, z + 0.05, middle + 0.05
    floor, ceiling = (
        draw_floor(stage, 2.0 * max(half)),
        parts.diffuse(draw_color(stage.generator, 0.4 * high, high, saturated=0.25)),
    )
    stage.add("floor", parts.rectangle((0, 0, 0), (0, 1, 0), (wide, deep), floor))
    stage.add("ceiling", parts.rectangle((0, height, 0), (0, 0, 0), (wide, deep), ceiling))
    for at, size in (
        ((0.0, middle, -z), (wide, tall)),
        ((0.0, middle, z), (wide, tall)),
        ((-x, middle, 0.0), (deep, tall)),
        ((x, middle, 0.0), (deep, tall)),
    ):
        wall = draw_wall(stage, 2.0 * size[0], low, high)
        stage.add("wall", parts.rectangle(at, (0, middle, 0), size, wall))


def draw_light_color(generator: Generator, saturation: float = 0.35) -> Array:
    """Return the colour of a light of luminance near 1: white, warm or cold, or anything as ``saturation`` grows."""
    color = 1.0 - saturation * generator.random() * generator.random(3)
    return np.asarray(color / color.mean())


def scale_color(color: Array, radiance: float) -> Vector:
    red, green, blue = (float(each) for each in color * radiance)
    return red, green, blue


def _add_ball_lamp(stage: Stage, center: Vector, radius: float, radiance: Vector) -> None:
    stage.add("lamp", parts.bulb(center, radius, radiance))
    stage.places.append((center, radius))


def _add_room_lights(stage: Stage, half: tuple[float, float], height: float, light: float) -> None:
    """Light a room from its ceiling, by some lamps, through a window, or only by uplights along the walls."""
    generator = stage.generator
    x, z = half
    kind = generator.choice(["ceiling", "several", "uplights", "window"], p=[0.3, 0.3, 0.22, 0.18])
    color = draw_light_color(generator)
    if kind == "ceiling":
        size = tuple(float(draw_log(generator, 0.15, 0.6) * each) for each in half)
        at = (float(generator.uniform(-0.4, 0.4) * x), float(generator.uniform(-0.5, 0.4) * z))
        radiance = scale_color(color, light)
        stage.add("lamp", parts.light((at[0], height - 0.02, at[1]), (at[0], 0, at[1]), (size[0], size[1]), radiance))
    elif kind == "window":
        side = float(generator.choice([-1.0, 1.0]))
        at_z, wide, tall = float(generator.uniform(-0.5, 0.3) * z), 0.35 * z, 0.28 * height
        center = (side * (x - 0.03), 0.55 * height, at_z)
        pane = parts.light(center, (0, center[1], at_z), (wide, tall), scale_color(color, light), up=(0, 1, 0))
        stage.add("window", pane)
        frame = parts.diffuse(draw_color(generator, 0.1, 0.8))
        for k in (-1.0, 0.0, 1.0):
            for at, size in (
                ((center[0], center[1], at_z + k * wide), (0.06, tall + 0.04, 0.04)),
                ((center[0], center[1] + k * tall, at_z), (0.06, 0.04, wide + 0.04)),
            ):
                box = {"type": "cube", "to_world": _make_transform(at, 0.0, 0.0, size), "bsdf": frame}
                stage.add("bar", box)
    else:
        for _ in range(int(generator.integers(2, 6 if kind == "several" else 4))):
            own = scale_color(draw_light_color(generator, 0.6) * color, light * draw_log(generator, 0.4, 2.0))
            at_x, at_z = (float(generator.uniform(-0.85, 0.85) * each) for each in half)
            size = (draw_log(generator, 0.15, 0.6), draw_log(generator, 0.15, 0.6))
            if kind == "uplights":
                # It faces up, far enough from the ceiling for a wide spot there: most of what is seen is lit by that.
                at_y = float(generator.uniform(0.5, 0.7) * height)
                at_x = float(np.sign(at_x) * generator.uniform(0.6, 0.85) * x)
                stage.add("uplight", parts.light((at_x, at_y, at_z), (at_x, height, at_z), size, own))
            elif generator.random() < 0.4:
                center = (at_x, float(generator.uniform(0.6, 0.85) * height), min(at_z, stage.origin[2] - 2.0))
                _add_ball_lamp(stage, center, draw_log(generator, 0.1, 0.25), own)
            else:
                stage.add("lamp", parts.light((at_x, height - 0.02, at_z), (at_x, 0, at_z), size, own))


def aim(stage: Stage, origin: Vector, target: Vector, fov: float) -> None:
    stage.origin, stage.target, stage.fov = origin, target, fov


def make_room(generator: Generator, light: float, *, dark: bool = False) -> Stage:
    """Return a closed room; a ``dark`` one has dark walls and a few coloured lamps."""
    half = (float(generator.uniform(1.8, 4.5)), float(generator.uniform(2.0, 5.0)))
    height = float(generator.uniform(2.3, 4.2))
    families = draw_families(generator, with_glass=not dark)
    stage = Stage(generator, (-half[0], 0.0, -half[1]), (half[0], height, 0.75 * half[1]), families)
    origin = (
        float(generator.uniform(-0.6, 0.6) * half[0]),
        float(generator.uniform(0.4, 0.85 * height)),
        float(generator.uniform(0.7, 0.93) * half[1]),
    )
    target = (
        float(generator.uniform(-0.3, 0.3) * half[0]),
        float(generator.uniform(0.2, 0.45) * height),
        float(generator.uniform(-0.6, 0.0) * half[1]),
    )
    aim(stage, origin, target, float(generator.uniform(35.0, 80.0)))
    _add_shell(stage, half, height, *((0.08, 0.5) if dark else (0.2, 0.85)))
    if dark:
        for _ in range(int(generator.integers(3, 8))):
            color = scale_color(draw_light_color(generator, 1.0), light * draw_log(generator, 0.5, 2.0))
            at = [float(generator.uniform(-0.8, 0.8) * each) for each in half]
            center = (at[0], float(generator.uniform(0.15, 0.9) * height), at[1])
            if np.linalg.norm(np.subtract(center, origin)) < LAMP_CLEARANCE:
                center = (center[0], center[1], -0.8 * half[1])
            _add_ball_lamp(stage, center, draw_log(generator, 0.08, 0.22), color)
    else:
        _add_room_lights(stage, half, height, light)
    add_objects(stage, int(generator.integers(8, 26)), min(0.25 * min(half), 0.9))
    return stage


def make_corridor(generator: Generator, light: float) -> Stage:
    """Return a long narrow space with a row of lamps along its ceiling."""
    half = (float(generator.uniform(1.0, 2.2)), float(generator.uniform(5.0, 11.0)))
    height = float(generator.uniform(2.2, 3.6))
    families = draw_families(generator, with_glass=True)
    stage = Stage(generator, (-half[0], 0.0, -half[1]), (half[0], height, half[1] - 2.0), families)
    origin = (
        float(generator.uniform(-0.5, 0.5) * half[0]),
        float(generator.uniform(0.6, 2.0)),
        half[1] - float(generator.uniform(0.4, 1.0)),
    )
    target = (float(generator.uniform(-0.4, 0.4) * half[0]), float(generator.uniform(0.5, 1.3)), half[1] - 6.0)
    aim(stage, origin, target, float(generator.uniform(45.0, 75.0)))
    _add_shell(stage, half, height, 0.15, 0.8)
    for side in (-1.0, 1.0):
        if generator.random() < 0.6:
            bsdf = draw_material(generator, families, periods=3.0, size=1.4, closed=False, relief=0.2)
            for z in np.arange(half[1] - 1.5, -half[1], -float(generator.uniform(1.7, 3.0))):
                at = (side * (half[0] - 0.02), 0.5 * height, float(z))
                panel = parts.rectangle(at, (0, at[1], at[2]), (0.7, 0.38 * height), bsdf)
                stage.add("panel", panel)
    step, color = float(generator.uniform(1.6, 4.0)), draw_light_color(generator)
    size = (draw_log(generator, 0.2, 0.7), draw_log(generator, 0.15, 0.6))
    for z in np.arange(half[1] - 1.0, -half[1], -step):
        own = scale_color(color * draw_light_color(generator, 0.5), light * generator.uniform(0.3, 1.0))
        stage.add("lamp", parts.light((0, height - 0.02, float(z)), (0, 0, float(z)), size, own))
    add_objects(stage, int(generator.integers(8, 26)), 0.4 * half[0])
    return stage


def make_sky(generator: Generator, rows: int = 128) -> Array:
    """Return an environment, (rows, 2 rows, 3): a gradient, clouds, soft boxes and mostly a sun; row 0 is up."""
    azimuth, elevation = np.meshgrid(
        2.0 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows), np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    )
    toward = np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)], axis=-1
    )
    zenith, horizon, ground = (np.array(draw_color(generator, low, 1.0)) for low in (0.1, 0.3, 0.05))
    up = np.clip(toward[..., 1:2], 0.0, 1.0) ** generator.uniform(0.3, 1.0)
    radiance = np.where(toward[..., 1:2] > 0.0, horizon + up * (zenith - horizon), 0.4 * ground)
    clouds = np.zeros(azimuth.shape)
    for k, shift in zip(generator.normal(0.0, 4.0, (16, 3)), generator.uniform(0.0, 2.0 * np.pi, 16), strict=True):
        clouds += np.sin(toward @ k + shift) / 4.0
    radiance = radiance * np.exp(generator.uniform(0.0, 0.7) * clouds)[..., None]
    for _ in range(int(generator.integers(0, 5))):
        middle, wide = generator.normal(size=3), generator.uniform(np.cos(0.6), np.cos(0.15))
        middle[1] = abs(middle[1])
        inside = toward @ (middle / np.linalg.norm(middle)) > wide
        radiance = np.where(inside[..., None], draw_log(generator, 1.5, 10.0) * draw_light_color(generator), radiance)
    if generator.random() < 0.7:
        height, turn = generator.uniform(0.25, 1.3), generator.uniform(0.0, 2.0 * np.pi)
        sun = np.array([np.cos(height) * np.sin(turn), np.sin(height), np.cos(height) * np.cos(turn)])
        # Never as small as the real one, which makes caustics that no sample count resolves.
        radius = np.deg2rad(draw_log(generator, 2.5, 10.0))
        strength = draw_log(generator, 0.5, 4.0) / (np.pi * radius**2)
        radiance = radiance + (toward @ sun > np.cos(radius))[..., None] * strength * draw_light_color(generator)
    return np.asarray(radiance)


def make_open_stage(generator: Generator, light: float) -> Stage:
    """Return an open floor under an environment map, at times with a wall or two."""
    size = float(generator.uniform(4.0, 9.0))
    reach = float(generator.uniform(1.6, 3.0))
    stage = Stage(
        generator, (-reach, 0.0, -reach), (reach, 2.5, 0.8 * reach), draw_families(generator, with_glass=True)
    )
    angle, lift = generator.uniform(-0.6, 0.6), generator.uniform(0.08, 0.75)
    distance = float(generator.uniform(3.5, 6.0))
    origin = (
        float(distance * np.sin(angle) * np.cos(lift)),
        float(0.3 + distance * np.sin(lift)),
        float(distance * np.cos(angle) * np.cos(lift)),
    )
    aim(stage, origin, (0.0, float(generator.uniform(0.2, 0.6)), -0.3), float(generator.uniform(32.0, 60.0)))
    stage.add("sky", {"type": "envmap", "bitmap": (light * make_sky(generator)).astype(np.float32)})
    floor = draw_floor(stage, 2.0 * size)
    stage.add("floor", parts.rectangle((0, 0, 0), (0, 1, 0), (size, size), floor))
    for place in ((0.0, 1.0, -1.15 * reach), (-1.15 * reach, 1.0, -0.3)):
        if generator.random() < 0.35:
            wall = draw_wall(stage, 2.0 * reach, 0.05, 0.85)
            stage.add("wall", parts.rectangle(place, (0, 1, 0), (reach, 1.0), wall))
    add_objects(stage, int(generator.integers(8, 26)), 0.35 * reach)
    return stage
