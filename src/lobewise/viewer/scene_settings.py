"""The settings of the sides of the wipe, and their names on the page of a scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

from lobewise.interactive.settings import InteractiveSettings, Unfiltered
from lobewise.settings import SIMILARITY_NAMES, DenoiseSettings, list_knobs

SCENE_SIMILARITIES = (*reversed(SIMILARITY_NAMES), *get_args(Unfiltered))
SCENE_CONTROLS = ["method", "scale", "spp", "similarity", "radius", "beta", "temporal", "adaptive", "filter_direct"]
"""Fields of `InteractiveSettings` that have a control on the page, in the order of the controls."""


KNOBS = {**list_knobs(DenoiseSettings), **list_knobs(InteractiveSettings)}
"""Declarations of all settings."""
KNOBS["similarity"] = replace(
    KNOBS["similarity"],
    text=f'{KNOBS["similarity"].text} "none" filters nothing.',
    choices=("auto", *SCENE_SIMILARITIES),
)


def name_sides(left: InteractiveSettings, right: InteractiveSettings) -> tuple[str, str]:
    """Return labels for the two sides of the wipe, which name the settings that differ.

    >>> name_sides(InteractiveSettings(radius=2), InteractiveSettings(radius=4))
    ('A: radius 2', 'B: radius 4')
    """
    differing = [name for name in SCENE_CONTROLS if getattr(left, name) != getattr(right, name)]
    # With another method or similarity the other settings are details, or mean nothing for one of the sides.
    names = [name for name in ("method", "similarity") if name in differing] or differing[:2]

    def name(letter: str, settings: InteractiveSettings) -> str:
        words = [_name_value(one, getattr(settings, one)) for one in names]
        return f"{letter}: {', '.join(words)}" if words else letter

    return name("A", left), name("B", right)


def _name_value(name: str, value: Any) -> str:
    """Return a setting in words."""
    plain = name.replace("_", " ")
    if isinstance(value, bool):
        return plain if value else f"no {plain}"
    if name in ("method", "similarity"):
        return "no filter" if value == "none" else str(value).replace("_", " ")
    return f"{plain} {value:.3g}" if isinstance(value, float) else f"{plain} {value}"
