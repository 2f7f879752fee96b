"""Random patterns and materials for `kinds.py`: every draw is from the generator that is passed in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lobewise.scenes import parts
from lobewise.scenes.parts import IOR_OF_METALS, Item, Vector, encode_normals

Array = NDArray[np.float64]
Generator = np.random.Generator

TEXELS = 256
"""Texels a side of a texture; of a floor's twice as many."""

SMALLEST_ALPHA, LARGEST_ALPHA = 0.005, 0.7
MOST_STRETCH = 8.0
"""Largest ratio of the two alphas of a brushed metal."""

STEEPEST = 0.30
"""Largest root mean square slope of normal and bump maps: 17 degrees."""

FINEST = 20.0
"""Most periods of a relief across its texture: finer ones are below a pixel and only widen the lobe."""


def draw_log(generator: Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(generator.uniform(np.log(low), np.log(high))))


def draw_color(generator: Generator, low: float = 0.03, high: float = 0.9, *, saturated: float = 0.6) -> Vector:
    """Return an albedo whose largest channel lies between the bounds; a share ``saturated`` is not nearly grey."""
    value = low + (high - low) * generator.beta(1.3, 1.2)
    saturation = generator.uniform(0.2, 0.95) if generator.random() < saturated else generator.uniform(0.0, 0.2)
    hue = generator.uniform(0.0, 6.0) + np.array([5.0, 3.0, 1.0])
    shape = np.clip(np.minimum(hue % 6.0, 4.0 - hue % 6.0), 0.0, 1.0)
    red, green, blue = value * (1.0 - saturation * shape)
    return float(red), float(green), float(blue)


def _make_grid(texels: int) -> tuple[Array, Array]:
    x, y = np.meshgrid(*2 * [(np.arange(texels) + 0.5) / texels])
    return x, y


def draw_waves(generator: Generator, texels: int, periods: float, count: int = 24) -> tuple[Array, Array, Array]:
    """Return a sum of plane waves and its slopes over the texture, from half to all of ``periods``; variance 1."""
    along = 2.0 * np.pi * periods * (np.arange(texels) + 0.5) / texels
    angle, number, shift = generator.uniform((0.0, 0.5, 0.0), (2.0 * np.pi, 1.0, 2.0 * np.pi), (count, 3)).T[..., None]
    x, y = number * np.cos(angle) * along + shift, number * np.sin(angle) * along
    # The sine of a sum as two matrix products: each wave is a function of x times one of y.
    height = np.cos(y).T @ np.sin(x) + np.sin(y).T @ np.cos(x)
    k = 2.0 * np.pi * periods * number
    slope_x, slope_y = (
        (k * turn * np.cos(y)).T @ np.cos(x) - (k * turn * np.sin(y)).T @ np.sin(x)
        for turn in (np.cos(angle), np.sin(angle))
    )
    amplitude = np.sqrt(2.0 / count)
    return amplitude * height, amplitude * slope_x, amplitude * slope_y


def _draw_discs(generator: Generator, texels: int, periods: float) -> Array:
    """Return 1 inside discs, one or none in each of ``periods`` squared cells, 0 between."""
    x, y = (periods * each for each in _make_grid(texels))
    column, row = x.astype(int), y.astype(int)
    count = int(np.ceil(periods)) + 1
    radius = generator.uniform(0.1, 0.48, (count, count)) * (generator.random((count, count)) < 0.8)
    return (np.hypot(x - column - 0.5, y - row - 0.5) < radius[row, column]).astype(np.float64)


def draw_pattern(generator: Generator, periods: float, texels: int = TEXELS) -> Array:
    """Return a pattern in [0, 1], (texels, texels): checks, stripes, noise, a gradient, discs, tiles or rings.

    ``periods`` is about how often it repeats across the texture.
    """
    x, y = _make_grid(texels)
    kind = generator.choice(["checks", "stripes", "waves", "noise", "blotches", "gradient", "discs", "tiles", "rings"])
    if kind == "checks":
        return (np.floor(2.0 * periods * x) + np.floor(2.0 * periods * y)) % 2.0
    if kind == "discs":
        return _draw_discs(generator, texels, periods)
    if kind == "tiles":
        count = int(np.ceil(periods)) + 1
        return np.asarray(generator.random((count, count))[(periods * y).astype(int), (periods * x).astype(int)])
    if kind in ("noise", "blotches"):
        noise, _, _ = draw_waves(generator, texels, periods)
        return np.clip(0.5 + (0.3 if kind == "noise" else 4.0) * noise, 0.0, 1.0)
    if kind == "rings":
        phase = 2.0 * periods * np.hypot(x - generator.random(), y - generator.random())
    else:
        angle = generator.choice([0.0, 0.25, 0.5, generator.random()]) * np.pi
        phase = (periods if kind != "gradient" else 0.5) * (np.cos(angle) * x + np.sin(angle) * y)
    if kind == "stripes":
        return (phase % 1.0 < generator.uniform(0.15, 0.85)).astype(np.float64)
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * phase))


def draw_albedo(
    generator: Generator,
    periods: float,
    *,
    textured: float = 0.4,
    low: float = 0.03,
    high: float = 0.9,
    saturated: float = 0.6,
) -> Item:
    """Return a colour, or with the probability ``textured`` a texture between two or among some colours."""
    if generator.random() >= textured:
        return parts.rgb(draw_color(generator, low, high, saturated=saturated))
    texels = 2 * TEXELS if periods > 6.0 else TEXELS
    pattern = draw_pattern(generator, periods, texels)[..., None]
    first, second, third = (np.array(draw_color(generator, low, high, saturated=saturated)) for _ in range(3))
    values = first + pattern * (second - first)
    if generator.random() < 0.3:
        patches = draw_pattern(generator, 0.5 * periods, texels)[..., None] > 0.5
        values = np.where(patches, values, third * (0.6 + 0.4 * pattern))
    return parts.texture(values, filter_type="nearest" if generator.random() < 0.2 else "bilinear")


def draw_alpha(generator: Generator, low: float = SMALLEST_ALPHA, high: float = LARGEST_ALPHA) -> float:
    """Return a GGX alpha, uniform in its logarithm."""
    return draw_log(generator, low, high)


def draw_alpha_map(generator: Generator, periods: float, low: float = SMALLEST_ALPHA) -> Array:
    """Return alphas, (texels, texels), that run between two by a pattern, evenly in their logarithm."""
    first, second = draw_alpha(generator, low), draw_alpha(generator, low)
    return np.asarray(first * (second / first) ** draw_pattern(generator, periods, 2 * TEXELS))


def _draw_diffuse(generator: Generator, periods: float) -> Item:
    return parts.diffuse(draw_albedo(generator, periods, textured=0.5, low=0.02, high=0.92))


def _draw_name(generator: Generator) -> str:
    return str(generator.choice(sorted(IOR_OF_METALS)))


def _draw_metal(generator: Generator, periods: float) -> Item:
    textured = generator.random() < 0.3
    metal = parts.metal(
        _draw_name(generator),
        parts.texture(draw_alpha_map(generator, periods)) if textured else draw_alpha(generator),
    )
    if generator.random() < 0.4:
        metal["inner"]["specular_reflectance"] = draw_albedo(generator, periods, low=0.3, high=1.0)
    return metal


def _draw_brushed(generator: Generator, periods: float) -> Item:
    stretch = draw_log(generator, 1.5, MOST_STRETCH)
    small = draw_log(generator, SMALLEST_ALPHA, LARGEST_ALPHA / stretch)
    alphas = [small, small * stretch]
    if generator.random() < 0.5:
        alphas.reverse()
    return parts.metal(_draw_name(generator), alphas[0], alphas[1])


def _draw_plastic(generator: Generator, periods: float) -> Item:
    return parts.plastic(draw_albedo(generator, periods), draw_alpha(generator, 0.01), ior=generator.uniform(1.3, 1.9))


def _draw_smooth_plastic(generator: Generator, periods: float) -> Item:
    inner = {"type": "plastic", "int_ior": generator.uniform(1.3, 1.9), "nonlinear": True}
    return {"type": "twosided", "inner": {**inner, "diffuse_reflectance": draw_albedo(generator, periods)}}


def _draw_mirror(generator: Generator, periods: float) -> Item:
    return parts.mirror(draw_color(generator, 0.6, 0.95))


def _draw_principled(generator: Generator, periods: float) -> Item:
    # The plugin squares the roughness that it is given.
    textured = generator.random() < 0.35
    roughness = (
        parts.texture(np.sqrt(draw_alpha_map(generator, periods, 0.01)))
        if textured
        else float(np.sqrt(draw_alpha(generator, 0.01)))
    )
    parameters: dict[str, float | Item] = {"roughness": roughness}
    metallic = generator.choice([0.0, 0.0, 0.0, 1.0, generator.random()])
    parameters["metallic"] = float(metallic)
    if generator.random() < 0.5:
        parameters["specular"] = generator.uniform(0.1, 1.0)
    else:
        parameters["eta"] = generator.uniform(1.2, 2.0)
    if generator.random() < 0.4:
        parameters.update(clearcoat=generator.uniform(0.2, 1.0), clearcoat_gloss=generator.uniform(0.3, 1.0))
    if generator.random() < 0.25:
        parameters["anisotropic"] = generator.uniform(0.2, 0.95)
    return parts.principled(draw_albedo(generator, periods), **parameters)


def _draw_glass(generator: Generator, periods: float) -> Item:
    tint = draw_color(generator, 0.75, 0.98) if generator.random() < 0.4 else (1.0, 1.0, 1.0)
    rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": draw_alpha(generator, 0.03, 0.4)}
    kind = rough if generator.random() < 0.5 else {"type": "dielectric"}
    ior = generator.uniform(1.3, 1.8)
    return {**kind, "int_ior": ior, "ext_ior": 1.0, "specular_transmittance": parts.rgb(tint)}


FAMILIES: dict[str, Callable[[Generator, float], Item]] = {
    "diffuse": _draw_diffuse,
    "metal": _draw_metal,
    "brushed": _draw_brushed,
    "plastic": _draw_plastic,
    "smooth plastic": _draw_smooth_plastic,
    "mirror": _draw_mirror,
    "principled": _draw_principled,
    "glass": _draw_glass,
}
"""What draws a material, by family. All but glass, which needs a closed body, are two-sided."""

SHARES = {
    "diffuse": 0.22,
    "metal": 0.20,
    "brushed": 0.08,
    "plastic": 0.14,
    "smooth plastic": 0.07,
    "mirror": 0.07,
    "principled": 0.15,
    "glass": 0.07,
}
"""How often each is drawn, over all scenes."""


def draw_families(generator: Generator, *, with_glass: bool) -> dict[str, float]:
    """Return the families of one scene with their shares: three to five, so that each scene has its own character."""
    names = [name for name in SHARES if with_glass or name != "glass"]
    weights = np.array([SHARES[name] for name in names])
    chosen = generator.choice(names, int(generator.integers(3, 6)), replace=False, p=weights / weights.sum())
    shares = {str(name): SHARES[str(name)] * generator.uniform(0.5, 1.5) for name in chosen}
    if "glass" in shares:
        # Each sheet of glass costs path segments, and most of what it shows no guide tells.
        shares["glass"] = 0.1 * sum(shares.values())
    return shares


def add_relief(generator: Generator, bsdf: Item, periods: float, size: float) -> Item:
    """Return a two-sided material under a band-limited normal or bump map, whose slopes have a random variance.

    ``size`` is the length in space of the texture's side: a bump map's heights are in units of length.
    """
    steepness = draw_log(generator, 0.02, STEEPEST)
    texels = 2 * TEXELS
    height, slope_x, slope_y = draw_waves(generator, texels, min(periods, FINEST))
    deviation = float(np.sqrt(0.5 * (slope_x**2 + slope_y**2).mean()))
    if generator.random() < 0.5:
        return parts.normal_map(encode_normals(*(steepness / deviation * each for each in (slope_x, slope_y))), bsdf)
    low, high = float(height.min()), float(height.max())
    return parts.bump_map((height - low) / (high - low), steepness / deviation * (high - low) * size, bsdf)


def draw_material(
    generator: Generator, families: dict[str, float], *, periods: float, size: float, closed: bool, relief: float = 0.15
) -> Item:
    """Return a material of one of the families; glass only for a ``closed`` body, relief with a probability."""
    names = [name for name in families if closed or name != "glass"]
    weights = np.array([families[name] for name in names])
    name = str(generator.choice(names, p=weights / weights.sum()))
    bsdf = FAMILIES[name](generator, periods)
    if name != "glass" and generator.random() < relief:
        return add_relief(generator, bsdf, draw_log(generator, 2.0, 12.0), size)
    return bsdf
