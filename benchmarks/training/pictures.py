"""Pictures for `kinds.py`: clouds, veins, cells, cloth, print; every draw is from the generator passed in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.training.materials import Array, Generator, draw_color, draw_log, draw_pattern

TEXELS = 256


def make_grid(texels: int) -> tuple[Array, Array]:
    """Return x and y of the middles of texels, in [0, 1]."""
    x, y = np.meshgrid(*2 * [(np.arange(texels) + 0.5) / texels])
    return x, y


def draw_clouds(generator: Generator, periods: float, fall: float = 1.6, texels: int = TEXELS) -> Array:
    """Return noise of mean 0 and variance 1 that repeats at its borders.

    Its amplitudes fall with the frequency to the power ``fall`` above ``periods`` over the texture.
    """
    number = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(texels, 1.0 / texels)]))
    amplitude = (1.0 + (number / periods) ** 2) ** (-0.5 * fall - 0.25)
    amplitude[0, 0] = 0.0
    noise = np.fft.ifft2(np.fft.fft2(generator.normal(size=(texels, texels))) * amplitude).real
    return np.asarray(noise / noise.std())


def _draw_veins(generator: Generator, periods: float) -> Array:
    x, y = make_grid(TEXELS)
    warp = draw_clouds(generator, 2.0) * generator.uniform(0.05, 0.25)
    angle = generator.uniform(0.0, np.pi)
    phase = periods * (np.cos(angle) * x + np.sin(angle) * y + warp)
    return np.asarray(np.abs(np.cos(np.pi * phase)) ** draw_log(generator, 0.3, 3.0))


def _draw_wood(generator: Generator, periods: float) -> Array:
    x, y = make_grid(TEXELS)
    stretched = draw_clouds(generator, 3.0)[:, np.arange(TEXELS) // 8]
    bent = 0.04 * draw_clouds(generator, 1.5)
    rings = 0.5 + 0.5 * np.cos(2.0 * np.pi * periods * (np.hypot(0.25 * (x - 0.5), y + 0.4) + bent))
    return np.clip(0.75 * rings**0.6 + 0.08 * stretched, 0.0, 1.0)


def _draw_cells(generator: Generator, periods: float) -> Array:
    """Return one grey for each cell around random points; its borders repeat."""
    x, y = make_grid(TEXELS)
    points = generator.random((int(np.clip(periods**2, 6, 120)), 2))
    nearest, shade = np.full(x.shape, np.inf), np.zeros(x.shape)
    for (column, row), grey in zip(points, generator.random(len(points)), strict=True):
        away = np.abs(x - column), np.abs(y - row)
        distance = sum(np.minimum(each, 1.0 - each) ** 2 for each in away)
        shade = np.where(distance < nearest, grey, shade)
        nearest = np.minimum(distance, nearest)
    return np.asarray(shade)


def _draw_weave(generator: Generator, periods: float) -> Array:
    x, y = (4.0 * np.ceil(periods) * each for each in make_grid(TEXELS))
    over = (np.floor(x) + np.floor(y)) % 2.0
    thread = np.where(over > 0, np.sin(np.pi * (x % 1.0)), np.sin(np.pi * (y % 1.0)))
    return np.asarray(np.clip((0.35 + 0.3 * over) * thread + 0.05 * draw_clouds(generator, 8.0) + 0.2, 0.0, 1.0))


def _draw_print(generator: Generator, periods: float) -> Array:
    """Return rows of random marks like those of a page, dark on light."""
    rows = int(np.clip(3.0 * periods, 6, 24))
    marks = (generator.random((4 * rows, 4 * rows)) < 0.55).astype(np.float64)
    marks[3::4] = 0.0
    words = generator.random((rows, 4 * rows)) < 0.8
    page = marks * np.repeat(words, 4, axis=0)
    index = np.arange(TEXELS) * 4 * rows // TEXELS
    return np.asarray(1.0 - page[index][:, index])


def _draw_specks(generator: Generator, periods: float) -> Array:
    clouds = draw_clouds(generator, 3.0 * periods + 4.0, 3.0)
    return (clouds > generator.uniform(0.6, 1.8)).astype(np.float64)


def _draw_brush(generator: Generator, periods: float) -> Array:
    """Return long strokes along one axis."""
    lines = np.cumsum(generator.normal(size=(TEXELS, TEXELS)), axis=1)
    lines = lines - np.linspace(0.0, 1.0, TEXELS) * lines[:, -1:]
    return np.clip(0.5 + 0.25 * lines / max(lines.std(), 1e-9), 0.0, 1.0)


PICTURES: dict[str, Callable[[Generator, float], Array]] = {
    "clouds": lambda generator, periods: np.clip(0.5 + 0.25 * draw_clouds(generator, periods), 0.0, 1.0),
    "veins": _draw_veins,
    "wood": _draw_wood,
    "cells": _draw_cells,
    "weave": _draw_weave,
    "print": _draw_print,
    "specks": _draw_specks,
    "brush": _draw_brush,
    "pattern": lambda generator, periods: draw_pattern(generator, periods, TEXELS),
}
"""What draws a picture in [0, 1], (256, 256), that repeats about ``periods`` times."""


def draw_picture(generator: Generator, periods: float) -> Array:
    """Return one of `PICTURES`."""
    return PICTURES[str(generator.choice(list(PICTURES)))](generator, periods)


def draw_paint(generator: Generator, periods: float, low: float = 0.03, high: float = 0.9) -> Array:
    """Return an albedo of two or three colours, (256, 256, 3): a picture, and often a finer one on it."""
    first, second, third = (np.array(draw_color(generator, low, high)) for _ in range(3))
    values = first + draw_picture(generator, periods)[..., None] * (second - first)
    if generator.random() < 0.4:
        mask = draw_picture(generator, 2.0 * periods)[..., None]
        values = values + generator.uniform(0.2, 0.9) * mask * (third - values)
    return np.clip(values, low, high)


def draw_poster(generator: Generator, low: float = 0.03, high: float = 0.9) -> Array:
    """Return an image like a poster's or a screen's, (256, 256, 3): discs, bars and print over a gradient."""
    x, y = make_grid(TEXELS)
    colors = [np.array(draw_color(generator, low, high, saturated=0.85)) for _ in range(6)]
    values = colors[0] + y[..., None] * (colors[1] - colors[0])
    for k in range(int(generator.integers(2, 9))):
        middle, size = generator.random(2), generator.uniform(0.05, 0.35, 2)
        if generator.random() < 0.5:
            inside = np.hypot(x - middle[0], y - middle[1]) < size[0]
        else:
            inside = (np.abs(x - middle[0]) < size[0]) & (np.abs(y - middle[1]) < size[1])
        fill = colors[2 + k % 4] * (0.6 + 0.4 * draw_picture(generator, 3.0)[..., None])
        values = np.where(inside[..., None], fill, values)
    if generator.random() < 0.5:
        top = int(generator.integers(0, TEXELS // 2))
        page = _draw_print(generator, 4.0)[: TEXELS // 3, :, None]
        values[top : top + len(page)] = np.where(page < 0.5, colors[5], values[top : top + len(page)])
    return np.clip(values, low, high)


def draw_view(generator: Generator) -> Array:
    """Return what is seen out of a window, radiance near 1, (256, 256, 3): sky, hills or houses, ground."""
    x, y = make_grid(TEXELS)
    up = 1.0 - y
    sky, haze = np.array(draw_color(generator, 0.5, 1.0)), np.array([1.0, 0.95, 0.9])
    values = haze + np.clip(up, 0.0, 1.0)[..., None] * (sky - haze)
    values = values * np.exp(0.25 * draw_clouds(generator, 3.0))[..., None]
    for distance in (0.6, 0.35):
        steps = generator.random(int(generator.integers(4, 14)))
        if generator.random() < 0.5:
            ridge = steps[(x * len(steps)).astype(int)]
        else:
            ridge = (
                0.5 + 0.2 * np.sin(2.0 * np.pi * (x * len(steps) * 0.3 + steps[0])) + 0.02 * draw_clouds(generator, 4.0)
            )
        land = np.array(draw_color(generator, 0.05, 0.5)) * (0.6 + 0.8 * draw_picture(generator, 8.0)[..., None])
        values = np.where((up < distance * (0.4 + 0.8 * ridge))[..., None], distance * land + 0.1, values)
    return np.clip(values, 0.02, 3.0)


def draw_surroundings(generator: Generator, sky: Array) -> Array:
    """Return an environment, (rows, 2 rows, 3), with a horizon of blocks and textured ground added to a sky."""
    rows, columns = sky.shape[:2]
    elevation = 90.0 - 180.0 * (np.arange(rows) + 0.5) / rows
    count = int(generator.integers(6, 40))
    edges = np.sort(generator.integers(0, columns, count))
    block = np.searchsorted(edges, np.arange(columns), side="right") % count
    tops = generator.uniform(-2.0, 1.0, count)[block] + generator.uniform(2.0, 30.0, count)[block]
    paint = np.array([draw_color(generator, 0.03, 0.6) for _ in range(count)])[block]
    lit = np.mean(sky[: rows // 2]) * draw_log(generator, 0.3, 1.0)
    windows = (np.arange(rows)[:, None] // 3 + np.arange(columns) // 3) % 2 * generator.uniform(0.0, 0.5)
    values = np.where(
        (elevation[:, None] < tops)[..., None] & (elevation > -4.0)[:, None, None],
        lit * paint * (1.0 - windows)[..., None],
        sky,
    )
    ground = draw_paint(generator, 6.0)
    index = np.arange(rows) * TEXELS // rows, np.arange(columns) * TEXELS // columns
    below = (elevation <= -4.0)[:, None, None]
    return np.asarray(np.where(below, lit * ground[index[0]][:, index[1] % TEXELS], values))
