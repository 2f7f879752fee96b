"""The kinds of shots, which are for validation alone, and what a seed draws before its scene. Needs no Blender."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_FIRST = ("fog", "hair", "street", "jewels", "bokeh", "foliage")
_LATER = ("windows", "print", "fabric", "candle", "helmet", "depth")
_FOR_FILMS = ("tiles",)
VALIDATION = (*_FIRST, *_LATER, *_FOR_FILMS)
"""Nothing may ever be tuned or trained on frames of these kinds."""
TRAINING = (
    "product", "room", "glass", "brushed", "toys", "wax", "archviz", "gallery", "screens", "film",
    "bristles", "steam", "party",
)  # fmt: skip
ORDER = (*_FIRST, *TRAINING, *_LATER, *_FOR_FILMS)
"""A kind's place is part of its seeds: a new kind comes last."""
VALIDATION_SPP = (4, 16, 64)
REFERENCE_PARTS = 3
SIZES = ((160, 160), (176, 160), (192, 144), (208, 160), (224, 168), (256, 192))


@dataclass(frozen=True)
class Kind:
    """Where a kind is made and what it needs.

    Parameters
    ----------
    module : str
        Of this folder; its function is ``make_KIND``.
    reference_spp : int
        Of all parts together. Those to train on have half as many: what noise is left is cleaned, and more shots help
        more.
    brightness : tuple of float
        Bounds of the mean of L / (1 + L), L the luminance, to which the shot is exposed.
    sizes : int
        How many of `SIZES`, from the smallest, a shot may have.
    volume : bool
        Whether the shot has the passes of volumes.
    halves : bool
        Whether all passes of the noisy frames are half floats, but Cryptomatte; Blender writes depths, normals and
        positions as floats.
    """

    module: str
    reference_spp: int
    brightness: tuple[float, float] = (0.22, 0.38)
    sizes: int = len(SIZES)
    volume: bool = False
    halves: bool = False


KINDS = {
    "fog": Kind("nature", 300, (0.15, 0.3), sizes=3, volume=True),
    "hair": Kind("nature", 300, sizes=3),
    "street": Kind("lamps", 360, (0.1, 0.2), sizes=3),
    "jewels": Kind("precious", 450, (0.15, 0.3), sizes=3),
    "bokeh": Kind("lamps", 360, (0.12, 0.25), sizes=3),
    "foliage": Kind("nature", 300, sizes=4),
    "product": Kind("tables", 150),
    "room": Kind("rooms", 225, (0.3, 0.45), sizes=3),
    "glass": Kind("tables", 225, sizes=3),
    "brushed": Kind("tables", 150),
    "toys": Kind("tables", 150),
    "wax": Kind("tables", 150, sizes=4),
    "archviz": Kind("rooms", 150, (0.25, 0.38)),
    "gallery": Kind("rooms", 180, (0.25, 0.4), sizes=4),
    "screens": Kind("rooms", 150, (0.12, 0.28)),
    "film": Kind("tables", 150, (0.15, 0.3)),
    "bristles": Kind("trouble", 150),
    "steam": Kind("trouble", 150, (0.15, 0.35), sizes=4, volume=True),
    "party": Kind("trouble", 180, (0.1, 0.28), sizes=4),
    "windows": Kind("panes", 330, (0.22, 0.36), sizes=3),
    "print": Kind("panes", 390, (0.2, 0.32), sizes=3),
    "fabric": Kind("crafts", 300, sizes=3),
    "candle": Kind("crafts", 330, (0.15, 0.3), sizes=3),
    "helmet": Kind("crafts", 360, sizes=3),
    "tiles": Kind("textured", 300, sizes=3),
    "depth": Kind("panes", 450, (0.15, 0.3), sizes=3, halves=True),
}


@dataclass(frozen=True)
class Plan:
    """What a shot is rendered with; ``brightness`` as in `Kind`, the reference's samples of each part."""

    kind: str
    seed: int
    size: tuple[int, int]
    spp: tuple[int, ...]
    reference_spp: tuple[int, ...]
    roughness: bool
    brightness: float


def list_shots(kinds: list[str], seeds: range) -> list[tuple[str, int]]:
    """Return kinds and seeds in the order of rendering: one shot of each kind first."""
    return [(kind, seed) for seed in seeds for kind in ORDER if kind in kinds]


def plan_shot(kind: str, seed: int) -> tuple[Plan, np.random.Generator]:
    """Return what a shot is rendered with, and the generator that goes on to draw its scene."""
    random = np.random.default_rng([ORDER.index(kind), seed])
    drawn = KINDS[kind]
    size = SIZES[int(random.integers(drawn.sizes))]
    # Each octave up to 256 is as likely as another.
    spp = tuple(sorted({round(2.0**exponent) for exponent in random.uniform(0.0, 8.0, 2)}))
    roughness, brightness = bool(random.random() < 0.5), float(random.uniform(*drawn.brightness))
    reference = (drawn.reference_spp // REFERENCE_PARTS,) * REFERENCE_PARTS
    return Plan(
        kind, seed, size, VALIDATION_SPP if kind in VALIDATION else spp, reference, roughness, brightness
    ), random
