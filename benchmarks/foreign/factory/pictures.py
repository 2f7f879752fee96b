"""Pictures for labels, posters and screens, and the materials that show them."""

import colorsys

import numpy as np
from blender_parts import add, make_image, make_material
from parts import add_block, pick, put_image

ROWS, COLUMNS = 96, 128


def draw_waves(random, height, across):
    """Return a field of soft waves from 0 to 1."""
    field = np.zeros_like(height)
    for octave in range(1, 6):
        way = random.normal(0.0, 2.5 * octave, 2)
        field += np.sin(way[0] * height + way[1] * across + random.uniform(0.0, 6.0) + 2.0 * field) / octave
    return 0.5 + 0.5 * np.tanh(field)


def draw_palette(random, count):
    """Return colors of near hues with one that is apart."""
    hue = random.uniform()
    hues = [hue + random.normal(0.0, 0.07) for _ in range(count - 1)] + [hue + 0.5]
    return np.array(
        [colorsys.hsv_to_rgb(each % 1.0, random.uniform(0.1, 0.9), random.uniform(0.05, 0.95)) for each in hues]
    )


def draw_picture(random):
    """Return an image: waves of some colors, discs and bars, lines of what looks like text."""
    height, across = np.mgrid[0.0 : 1.0 : ROWS * 1j, 0.0 : 1.0 : COLUMNS * 1j]
    colors = draw_palette(random, 5)
    waves = 4.0 * draw_waves(random, height, across)
    if random.random() < 0.3:
        waves = np.floor(waves)
    color = np.stack([np.interp(waves, np.arange(5), colors[:, channel]) for channel in range(3)], -1)
    for _ in range(int(random.integers(0, 9))):
        middle, reach = random.uniform(0.0, 1.0, 2), random.uniform(0.03, 0.3, 2)
        apart = np.abs((height - middle[0]) / reach[0]), np.abs((across - middle[1]) / reach[1])
        inside = np.maximum(*apart) < 1.0 if random.random() < 0.4 else np.hypot(*apart) < 1.0
        color[inside] = pick(random, colors) * random.uniform(0.6, 1.0)
    if random.random() < 0.6:
        ink, step = pick(random, (np.zeros(3), np.full(3, 0.9), colors[4])), int(random.integers(4, 9))
        top, left = int(random.integers(10, 60)), int(random.integers(4, 50))
        for row in range(top, top + step * int(random.integers(2, 7)), step):
            words = np.repeat(random.random(COLUMNS // 2) < 0.7, 2)[left : left + int(random.integers(30, 78))]
            line = color[row : row + step // 2, left : left + len(words)]
            line[:, words[: line.shape[1]]] = ink
    return color.clip(0.0, 1.0)


def make_printed(random, name="print", **inputs):
    """Return a material with a picture over its UV map; inputs as those of `make_material`."""
    settings = {"Roughness": random.uniform(0.2, 0.7), "Coat_Weight": float(random.random() < 0.3), **inputs}
    return put_image(make_material(name, **settings), make_image(name, draw_picture(random)))


def make_screen(random, strength, name="screen"):
    """Return a dark smooth material that shows a picture in light of its own."""
    material = make_material(name, (0.01, 0.01, 0.01), Roughness=random.uniform(0.05, 0.4), Emission_Strength=strength)
    return put_image(material, make_image(name, draw_picture(random) ** 1.5), "Emission Color")


def add_panel(material, wide, tall, place, rotation):
    """Add an upright panel with a whole picture; it faces -y before its rotation."""
    panel = add("plane", material, size=1.0, location=place, rotation=rotation)
    panel.scale = (wide, tall, 1.0)
    return panel


def add_framed(material, frame, wide, tall, place, turn):
    """Add a picture in a frame; ``turn`` about the vertical, 0 faces -y."""
    x, y, z = place
    back = np.array([-np.sin(turn), np.cos(turn)])
    add_panel(material, wide, tall, place, (np.pi / 2, 0.0, turn))
    add_block(frame, (wide + 0.1, 0.04, tall + 0.1), (x + 0.025 * back[0], y + 0.025 * back[1], z), turn, bevel=0.01)
