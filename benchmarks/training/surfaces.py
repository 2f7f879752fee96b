"""Materials for `kinds.py` beyond those of `materials.py`: painted, polished, coated, worn, brushed, embossed, glass.

Every draw is from the generator that is passed in; ``periods`` is about how often a texture repeats across the shape.
All but glass are two-sided.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.training.materials import (
    FINEST,
    Array,
    Generator,
    draw_albedo,
    draw_alpha,
    draw_color,
    draw_log,
    draw_material,
    draw_waves,
)
from benchmarks.training.pictures import TEXELS, draw_clouds, draw_paint, draw_picture, draw_poster, make_grid
from lobewise.scenes import parts
from lobewise.scenes.parts import IOR_OF_METALS, Item, encode_normals

SMOOTHEST_ALPHA = 0.004
"""Of a near-mirror."""

STEEPEST_SLOPE = 0.35
"""Largest root mean square slope of an embossed surface."""


def _draw_metal_name(generator: Generator) -> str:
    return str(generator.choice(sorted(IOR_OF_METALS)))


def draw_any_paint(generator: Generator, periods: float, *, textured: float = 0.6) -> Item:
    """Return an albedo: one colour, or with the probability ``textured`` a picture."""
    if generator.random() >= textured:
        return parts.rgb(draw_color(generator))
    return parts.texture(
        draw_paint(generator, periods), filter_type="nearest" if generator.random() < 0.1 else "bilinear"
    )


def _draw_alpha_picture(generator: Generator, periods: float, low: float, high: float) -> Item:
    first, second = draw_log(generator, low, high), draw_log(generator, low, high)
    return parts.texture(first * (second / first) ** draw_picture(generator, periods))


def _draw_painted(generator: Generator, periods: float) -> Item:
    return parts.diffuse(draw_any_paint(generator, periods))


def _draw_printed(generator: Generator, periods: float) -> Item:
    poster = parts.texture(draw_poster(generator))
    if generator.random() < 0.5:
        return parts.diffuse(poster)
    return parts.plastic(poster, draw_alpha(generator, 0.02, 0.4))


def _draw_satin(generator: Generator, periods: float) -> Item:
    """Return a principled material whose albedo and roughness are pictures."""
    roughness = parts.texture(
        np.sqrt(np.clip(draw_log(generator, 0.02, 0.5) * (0.3 + 1.4 * draw_picture(generator, periods)), 0.01, 0.8))
    )
    values: dict[str, float | Item] = {"roughness": roughness, "specular": generator.uniform(0.2, 0.9)}
    return parts.principled(draw_any_paint(generator, periods), **values)


def _draw_polished(generator: Generator, periods: float) -> Item:
    """Return a near-mirror: metal or lacquer."""
    alpha = draw_log(generator, SMOOTHEST_ALPHA, 0.03)
    if generator.random() < 0.35:
        return parts.plastic(
            draw_any_paint(generator, periods, textured=0.3), max(alpha, 0.01), ior=generator.uniform(1.4, 2.0)
        )
    metal = parts.metal(_draw_metal_name(generator), alpha)
    if generator.random() < 0.5:
        metal["inner"]["specular_reflectance"] = parts.rgb(draw_color(generator, 0.4, 1.0))
    return metal


def _draw_smudged(generator: Generator, periods: float) -> Item:
    """Return a metal that is polished here and dull there."""
    return parts.metal(_draw_metal_name(generator), _draw_alpha_picture(generator, periods, SMOOTHEST_ALPHA, 0.5))


def _draw_mirror(generator: Generator, periods: float) -> Item:
    return parts.mirror(draw_color(generator, 0.7, 0.96, saturated=0.2))


def _draw_coated(generator: Generator, periods: float) -> Item:
    """Return a principled base, at times metallic, under a clear coat."""
    values = _draw_principled(generator, (0.05, 0.7), [0.0, 0.0])
    coat = {"clearcoat": generator.uniform(0.5, 1.0), "clearcoat_gloss": generator.uniform(0.6, 1.0)}
    return parts.principled(draw_any_paint(generator, periods), **values, **coat)


def _draw_principled(generator: Generator, alphas: tuple[float, float], plain: list[float]) -> dict[str, float]:
    """Return roughness and metallic of a material, which is no metal as often as ``plain`` is long."""
    roughness = float(np.sqrt(draw_alpha(generator, *alphas)))
    return {"roughness": roughness, "metallic": float(generator.choice([*plain, 1.0, generator.random()]))}


def _draw_brushed(generator: Generator, periods: float) -> Item:
    """Return an anisotropic metal; its strokes show in the roughness of some."""
    stretch = draw_log(generator, 2.0, 10.0)
    small = draw_log(generator, 0.015, 0.6 / stretch)
    alphas: list[float | Item] = [small, small * stretch]
    if generator.random() < 0.5:
        strokes = 0.7 + 0.6 * _draw_strokes(generator)
        alphas = [
            parts.texture(np.clip(small * strokes, 0.005, 0.7)),
            parts.texture(np.clip(small * stretch * strokes, 0.005, 0.7)),
        ]
    if generator.random() < 0.5:
        alphas.reverse()
    return parts.metal(_draw_metal_name(generator), alphas[0], alphas[1])


def _draw_strokes(generator: Generator) -> Array:
    lines = draw_clouds(generator, 20.0)[:, np.arange(TEXELS) // 32]
    return np.clip(0.5 + 0.25 * lines, 0.0, 1.0)


def _draw_grained(generator: Generator, periods: float) -> Item:
    """Return an anisotropic principled material."""
    values = _draw_principled(generator, (0.04, 0.5), [0.0])
    values["anisotropic"] = generator.uniform(0.4, 0.95)
    return parts.principled(draw_any_paint(generator, periods), **values)


def _draw_worn(generator: Generator, periods: float) -> Item:
    """Return one material that shows through another: rust on metal, bare metal under paint, wet on dry."""
    pairs = (
        lambda: (_draw_smudged(generator, periods), parts.diffuse(draw_any_paint(generator, 2.0 * periods))),
        lambda: (
            parts.plastic(draw_any_paint(generator, periods), draw_alpha(generator, 0.02, 0.3)),
            _draw_polished(generator, periods),
        ),
        lambda: (
            parts.diffuse(draw_any_paint(generator, periods)),
            parts.plastic(parts.rgb(draw_color(generator)), draw_alpha(generator, 0.01, 0.1)),
        ),
        lambda: (_draw_metal(generator), _draw_metal(generator)),
    )
    first, second = pairs[int(generator.integers(len(pairs)))]()
    weight = draw_picture(generator, periods)
    if generator.random() < 0.5:
        weight = np.clip(3.0 * (weight - 0.5) + 0.5, 0.0, 1.0)
    return parts.blend(
        first, second, parts.texture(weight) if generator.random() < 0.85 else generator.uniform(0.2, 0.8)
    )


def _draw_metal(generator: Generator) -> Item:
    return parts.metal(_draw_metal_name(generator), draw_alpha(generator, 0.01, 0.5))


def draw_glass(generator: Generator, *, clear: float = 0.7) -> Item:
    """Return glass for a closed body: smooth with the probability ``clear``, else rough; at times tinted."""
    tint = draw_color(generator, 0.7, 0.98) if generator.random() < 0.5 else (1.0, 1.0, 1.0)
    rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": draw_log(generator, 0.02, 0.3)}
    kind = {"type": "dielectric"} if generator.random() < clear else rough
    return {**kind, "int_ior": generator.uniform(1.3, 1.75), "ext_ior": 1.0, "specular_transmittance": parts.rgb(tint)}


def emboss(generator: Generator, bsdf: Item, periods: float, size: float) -> Item:
    """Return a two-sided material under a normal or bump map: ribs, dimples, hammered, pyramids, cloth or clouds.

    ``size`` is the length in space of the texture's side.
    """
    texels = 2 * TEXELS
    periods = min(np.ceil(periods), FINEST)
    kind = str(generator.choice(["ribs", "dimples", "hammered", "pyramids", "clouds", "waves"]))
    x, y = (periods * each for each in make_grid(texels))
    if kind == "ribs":
        height = np.abs(np.cos(np.pi * (x if generator.random() < 0.5 else y))) ** generator.uniform(0.6, 2.0)
    elif kind == "dimples":
        away = np.hypot(x % 1.0 - 0.5, y % 1.0 - 0.5)
        height = -np.clip(1.0 - (away / generator.uniform(0.25, 0.48)) ** 2, 0.0, 1.0)
    elif kind == "hammered":
        height = np.abs(draw_clouds(generator, periods, 3.0, texels))
    elif kind == "pyramids":
        height = 1.0 - 2.0 * np.maximum(np.abs(x % 1.0 - 0.5), np.abs(y % 1.0 - 0.5))
    elif kind == "clouds":
        height = draw_clouds(generator, periods, 2.5, texels)
    else:
        height, _, _ = draw_waves(generator, texels, periods)
    slope_y, slope_x = np.gradient(height, 1.0 / texels)
    deviation = float(np.sqrt(0.5 * (slope_x**2 + slope_y**2).mean()))
    steepness = draw_log(generator, 0.03, STEEPEST_SLOPE) / deviation
    if generator.random() < 0.5:
        slopes = (np.clip(steepness * each, -1.5, 1.5) for each in (slope_x, slope_y))
        return parts.normal_map(encode_normals(*slopes), bsdf)
    low, high = float(height.min()), float(height.max())
    return parts.bump_map((height - low) / (high - low), steepness * (high - low) * size, bsdf)


def _draw_embossed(generator: Generator, periods: float) -> Item:
    families = [_draw_painted, _draw_satin, _draw_polished, _draw_coated, _draw_smudged]
    bsdf = families[int(generator.integers(len(families)))](generator, periods)
    return emboss(generator, bsdf, draw_log(generator, 3.0, 16.0), 1.0)


def _draw_old(generator: Generator, periods: float) -> Item:
    families = {"diffuse": 0.3, "metal": 0.2, "plastic": 0.3, "smooth plastic": 0.1, "principled": 0.1}
    return draw_material(generator, families, periods=periods, size=1.0, closed=False, relief=0.0)


SURFACES: dict[str, Callable[[Generator, float], Item]] = {
    "painted": _draw_painted,
    "printed": _draw_printed,
    "satin": _draw_satin,
    "polished": _draw_polished,
    "smudged": _draw_smudged,
    "mirror": _draw_mirror,
    "coated": _draw_coated,
    "brushed": _draw_brushed,
    "grained": _draw_grained,
    "worn": _draw_worn,
    "embossed": _draw_embossed,
    "old": _draw_old,
}
"""What draws a two-sided material, by family."""

EVERYDAY = {
    "painted": 4.0,
    "printed": 1.0,
    "satin": 2.0,
    "polished": 0.6,
    "coated": 1.0,
    "worn": 1.0,
    "embossed": 1.0,
    "old": 2.0,
}
"""How often furniture of a plain room has which."""


def draw_surface(generator: Generator, shares: dict[str, float], periods: float) -> Item:
    """Return a material of one of `SURFACES`, chosen by ``shares``, which need not add up to 1."""
    names, weights = list(shares), np.array(list(shares.values()))
    return SURFACES[str(generator.choice(names, p=weights / weights.sum()))](generator, periods)


def draw_plain(generator: Generator, low: float = 0.05, high: float = 0.85) -> Item:
    """Return a diffuse material as of walls: often one colour of low saturation, else a texture."""
    if generator.random() < 0.5:
        return parts.diffuse(draw_color(generator, low, high, saturated=0.3))
    if generator.random() < 0.5:
        return parts.diffuse(parts.texture(draw_paint(generator, draw_log(generator, 1.0, 10.0), low, high)))
    return parts.diffuse(draw_albedo(generator, draw_log(generator, 1.0, 10.0), textured=0.5, low=low, high=high))
