"""Frames of drawn textures under noise whose size is known: what random scenes hardly have.

    python -m benchmarks.training.textures --cache FOLDER --count 160

A picture is cut into a few regions. Each has one texture (stripes, checks, tiles, dots, grain, or none), fine enough
that two to twelve pixels make a period, at some contrast, seen straight or at a slant. Noise has any size from 0.3 % to
100 %, and is normal or heavy-tailed. The guides know the texture, or only that there is a surface, or there are none.
The truth is exact.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.training.candidates import (
    DRAWN,
    Candidates,
    denoise_all,
    make_empty_guides,
    name_file,
    write_candidates,
)
from benchmarks.training.frames import make_parser, open_cache
from lobewise.records.frame import Frame, GBuffer, Radiance

PERIODS_PIXELS = (2.0, 12.0)
CONTRASTS = (0.05, 1.0)
NOISE_LEVELS = (0.003, 1.0)
"""Standard deviation of the noise of a pixel over its radiance, where the radiance is that of the mean pixel."""
MAX_REGIONS = 5
SAMPLES_A_SIDE, SHARE_OF_SOFT_EDGES = 3, 0.6
"""Of a pixel whose texture is averaged, and how many pictures have such pixels; in others a pixel is one sample."""
SHARE_WITHOUT_GUIDES = 0.3
"""Of the frames, which have their light alone."""
GRAIN_EXPONENTS = (0.6, 2.5)
"""Of how the amplitude of grain falls with frequency. At 0 grain would be white, as noise is."""
FIRST_SEED = 100_001
"""Sets these frames apart from those of rendered scenes."""

Array = NDArray[np.float32]
Generator = np.random.Generator


@dataclass(frozen=True)
class Coordinates:
    """Where pixels lie in a texture, in periods, each of shape (rows, columns)."""

    u: NDArray[np.float64]
    v: NDArray[np.float64]


def draw_between(rng: Generator, bounds: tuple[float, float]) -> float:
    """Return a random number between two positive ones, evenly by its logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def draw_coordinates(rng: Generator, size: int, factor: int) -> Coordinates:
    """Return the coordinates of a texture: often along the pixels, else turned, and sometimes at a slant.

    The texture has ``size`` samples a side, of which a pixel has ``factor`` a side.
    """
    rows, columns = np.mgrid[:size, :size].astype(np.float64)
    angle = rng.choice([0.0, 0.25 * np.pi, rng.uniform(0.0, np.pi)], p=[0.3, 0.1, 0.6])
    period = draw_between(rng, PERIODS_PIXELS)
    if rng.random() < 0.3:
        period = float(round(period))
    period *= factor
    x = np.cos(angle) * columns + np.sin(angle) * rows
    y = np.cos(angle) * rows - np.sin(angle) * columns
    if rng.random() < 0.4:
        nearness = 1.0 + rng.uniform(0.2, 2.0) * rows / size
        x, y = x / nearness, y / nearness
    stretch = draw_between(rng, (1.0, 3.0))
    return Coordinates(x / period + rng.random(), y / (period * stretch) + rng.random())


def draw_stripes(rng: Generator, at: Coordinates) -> Array:
    """Return stripes, hard or soft, in [0, 1]."""
    if rng.random() < 0.3:
        return np.asarray(0.5 + 0.5 * np.sin(2.0 * np.pi * at.u), np.float32)
    return np.asarray(at.u % 1.0 < rng.uniform(0.2, 0.8), np.float32)


def draw_checks(rng: Generator, at: Coordinates) -> Array:
    """Return a board of two colours, 0 and 1."""
    return np.asarray((np.floor(2.0 * at.u) + np.floor(2.0 * at.v)) % 2.0, np.float32)


def draw_tiles(rng: Generator, at: Coordinates) -> Array:
    """Return tiles with joints, each a little different, in [0, 1]."""
    row = np.floor(at.v)
    shifted = at.u + 0.5 * row
    joint = rng.uniform(0.1, 0.35)
    inside = (shifted % 1.0 > joint) & (at.v % 1.0 > joint)
    mixed = np.sin(12.9898 * np.floor(shifted) + 78.233 * row) * 43758.5453
    return np.asarray(inside * (1.0 - rng.uniform(0.0, 0.3) * (mixed % 1.0)), np.float32)


def draw_dots(rng: Generator, at: Coordinates) -> Array:
    """Return dots at random places, 0 and 1."""
    size = len(at.u)
    image = np.zeros((size, size), np.float32)
    count = int(size * size * draw_between(rng, (0.005, 0.2)))
    rows, columns = rng.integers(0, size, (2, count))
    image[rows, columns] = 1.0
    if rng.random() < 0.5:
        image = np.maximum(image, np.roll(image, 1, rng.integers(0, 2)))
    return image


def draw_grain(rng: Generator, at: Coordinates) -> Array:
    """Return random grain whose amplitude falls with frequency, in [0, 1]."""
    size = len(at.u)
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * frequency ** -rng.uniform(*GRAIN_EXPONENTS)
    spectrum[0, 0] = 0.0
    grain = np.fft.irfft2(spectrum, s=(size, size))
    return np.asarray(np.clip(0.5 + grain / (4.0 * grain.std()), 0.0, 1.0), np.float32)


def draw_nothing(rng: Generator, at: Coordinates) -> Array:
    """Return 1 everywhere."""
    return np.ones_like(at.u, np.float32)


NOISES = ("grey", "coloured", "heavy")
TEXTURES = (draw_stripes, draw_checks, draw_tiles, draw_dots, draw_grain, draw_nothing)


def draw_regions(rng: Generator, size: int) -> NDArray[np.int64]:
    """Return the number of the region of every pixel, from 0: that of the nearest of some random places."""
    places = rng.uniform(0.0, size, (rng.integers(1, MAX_REGIONS + 1), 2))
    at = np.stack(np.mgrid[:size, :size], axis=-1)[..., None, :]
    return np.asarray(np.argmin(np.sum((at - places) ** 2, axis=-1), axis=-1))


def average_samples(image: Array, factor: int) -> Array:
    """Return the mean of all samples of each pixel."""
    rows, columns, channels = image.shape
    blocks = image.reshape(rows // factor, factor, columns // factor, factor, channels)
    return np.asarray(blocks.mean(axis=(1, 3)), np.float32)


def draw_scene(rng: Generator, pixels: int) -> tuple[Array, Array, Array]:
    """Return albedo, radiance and normals of a picture, each of shape (pixels, pixels, 3), its edges soft or hard."""
    factor = SAMPLES_A_SIDE if rng.random() < SHARE_OF_SOFT_EDGES else 1
    size = pixels * factor
    albedo, light = np.empty((size, size, 3), np.float32), np.empty((size, size, 3), np.float32)
    normal, regions = np.empty((size, size, 3), np.float32), draw_regions(rng, size)
    for number in range(int(regions.max()) + 1):
        inside = regions == number
        contrast = draw_between(rng, CONTRASTS)
        texture = TEXTURES[rng.integers(len(TEXTURES))](rng, draw_coordinates(rng, size, factor))[..., None]
        bright = rng.uniform(0.2, 0.9, 3)
        dark = bright * (1.0 - contrast) * (rng.uniform(0.7, 1.0, 3) if rng.random() < 0.3 else 1.0)
        albedo[inside] = (dark + (bright - dark) * texture)[inside]
        slope = rng.uniform(-0.7, 0.7, 2) * rng.integers(0, 2)
        rows, columns = np.mgrid[:size, :size] / size - 0.5
        shade = draw_between(rng, (0.1, 4.0)) * (1.0 + slope[0] * rows + slope[1] * columns)
        light[inside] = shade[inside][:, None]
        way = rng.standard_normal(3) + np.array([0.0, 0.0, 3.0])
        normal[inside] = way / np.linalg.norm(way)
    albedo, radiance, normal = (average_samples(image, factor) for image in (albedo, albedo * light, normal))
    return albedo, radiance, normal


def draw_noise(rng: Generator, image: Array, level: float, kind: str) -> Array:
    """Return an image of noisy samples.

    Parameters
    ----------
    rng : numpy.random.Generator
    image : array, shape (rows, columns, 3)
        The truth.
    level : float
        Standard deviation over the radiance, where this is that of the mean pixel. It falls with the root of radiance.
    kind : str
        One of `NOISES`: "grey" is normal and the same in all channels, "coloured" is normal, and "heavy" has a gamma
        distribution, as the light has that few samples carry.
    """
    mean = max(float(image.mean()), 1e-6)
    if kind == "heavy":
        shape = np.maximum(image / mean, 1e-3) / level**2
        return np.asarray(image * rng.gamma(shape) / shape, np.float32)
    noise = rng.standard_normal(image[..., :1].shape if kind == "grey" else image.shape)
    return np.asarray(np.maximum(image + level * np.sqrt(image * mean) * noise, 0.0), np.float32)


def draw_frame(seed: int, size: int) -> tuple[Frame, Array]:
    """Return the noisy frame of a seed and its truth, shape (size, size, 3). The same seed gives the same frame."""
    rng = np.random.default_rng(seed)
    albedo, truth, normal = draw_scene(rng, size)
    level = draw_between(rng, NOISE_LEVELS)
    kind = NOISES[rng.integers(len(NOISES))]
    guides = GBuffer(normal=normal, diffuse_albedo=albedo if rng.random() < 0.4 else None)
    first, second = (draw_noise(rng, truth, level * 2.0**0.5, kind) for _ in range(2))
    frame = Frame(Radiance(np.float32(0.5) * (first + second)), guides)
    if rng.random() < 0.5:
        frame = frame.with_changes(half_a=Radiance(first), half_b=Radiance(second))
    if rng.random() < SHARE_WITHOUT_GUIDES:
        frame = frame.with_changes(gbuffer=make_empty_guides(frame.shape))
    return frame, truth


def make_candidates(seed: int, size: int) -> Candidates:
    """Return the frame of a seed as all methods see it. Samples per pixel are 0: there are none."""
    frame, truth = draw_frame(seed, size)
    images = {"clean": truth, "reference_a": truth, "reference_b": truth}
    return Candidates(seed=seed, spp=0, kind=DRAWN, **denoise_all(frame), **images)


def main(words: list[str] | None = None) -> None:
    """Make what is missing, and say how long it took."""
    from benchmarks.training.rendering import limit_threads

    parser = make_parser(__doc__, count=160, size=128)
    arguments = parser.parse_args(words)
    folder = open_cache(parser, arguments.cache)
    limit_threads(1)
    start, written = time.perf_counter(), 0
    for seed in range(FIRST_SEED, FIRST_SEED + arguments.count):
        if not (folder / name_file(seed, 0, DRAWN)).exists():
            write_candidates(folder, make_candidates(seed, arguments.size))
            written += 1
    print(f"{written} frames written, {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
