"""The random scenes that networks learn from: seventeen kinds, made in code from a seed.

Four kinds are those of `settings.py`, with other numbers. The others have what those lack: windows and lamps in view,
rooms lit from outside, textured interiors, glass, near-mirrors, normal maps, anisotropic metal, layered materials,
surroundings, thin things. No scene that results are judged on shares an object, a texture or a light with them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.training.interiors import make_daylit, make_evening
from benchmarks.training.materials import Generator
from benchmarks.training.places import (
    EMBOSSED,
    LAYERED,
    METALS,
    POLISHED,
    make_desk,
    make_gallery,
    make_garden,
    make_library,
    make_mirror_room,
    make_stand,
    make_workshop,
)
from benchmarks.training.settings import Stage, make_corridor, make_open_stage, make_room
from benchmarks.training.surfaces import EVERYDAY
from lobewise.scenes import parts

SALT = 20261124
"""Sets these random numbers apart from those of every other program that counts seeds from 1."""

MOST_BOUNCES = 8
"""Longest path, as Mitsuba's ``max_depth`` counts it."""

KINDS: dict[str, Callable[[Generator, float], Stage]] = {
    "sky room": partial(make_daylit, sky=True),
    "evening": make_evening,
    "metals": partial(make_stand, shares=METALS, glass=0.02, count=16),
    "library": make_library,
    "garden": make_garden,
    "window room": partial(make_daylit, sky=False),
    "glassware": partial(make_stand, shares=EVERYDAY, glass=0.4, count=14),
    "mirrors": make_mirror_room,
    "embossed": partial(make_stand, shares=EMBOSSED, glass=0.02, count=14),
    "workshop": make_workshop,
    "desk": make_desk,
    "gallery": make_gallery,
    "layered": partial(make_stand, shares={**LAYERED, **POLISHED}, glass=0.05, count=18),
    "room": make_room,
    "stage": make_open_stage,
    "dark room": partial(make_room, dark=True),
    "corridor": make_corridor,
}
"""What makes a scene, by kind. Seeds go through them in turn; their number must not be a multiple of 5, or the seeds
for validation would not go through all."""


def choose_kind(seed: int) -> str:
    """Return the kind of the scene of a seed, from 1."""
    return list(KINDS)[(seed - 1) % len(KINDS)]


def make_kind(seed: int, width: int, height: int, kind: str | None = None) -> dict[str, Any]:
    """Return the scene of a seed, from 1, as a description for `build_scene`; the same seed, the same scene.

    ``kind`` asks for another kind than the seed's own.
    """
    stage = KINDS[kind or choose_kind(seed)](np.random.default_rng([SALT, seed]), 1.0)
    return {
        "type": "scene",
        "sensor": parts.camera(stage.origin, stage.target, stage.fov, width, height),
        "integrator": {"type": "path", "max_depth": MOST_BOUNCES},
        **stage.items,
    }
