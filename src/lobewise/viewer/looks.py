"""Looks: the settings of one side of the wipe, of a scene that is rendered or of a finished frame."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, get_args

from lobewise.interactive.settings import InteractiveSettings, Unfiltered
from lobewise.settings import SIMILARITY_NAMES, Auto, DenoiseSettings, SimilarityName, list_knobs

SCENE_SIMILARITIES = (*reversed(SIMILARITY_NAMES), *get_args(Unfiltered))
FRAME_SIMILARITIES = ("auto", *SCENE_SIMILARITIES)
SCENE_CONTROLS = ["method", "scale", "spp", "similarity", "radius", "beta", "temporal", "adaptive", "filter_direct"]
"""Fields of `InteractiveSettings` that have a control on the page, in the order of the controls."""


@dataclass(frozen=True)
class FrameLook:
    """How a finished frame is filtered; the fields are those of `lobewise.DenoiseSettings`.

    The similarity "none" shows the frame as it is. A sparsely shaded frame has the quality "fast" and the form "full".
    """

    similarity: SimilarityName | Auto | Unfiltered = "auto"
    quality: str = "balanced"
    form: str = DenoiseSettings.form
    radius: int = DenoiseSettings.radius
    beta: float | Auto = "auto"
    normal_exponent: float = DenoiseSettings.normal_exponent
    tau: float | Auto = "auto"
    hit_distance: bool = False


KNOBS = {**list_knobs(DenoiseSettings), **list_knobs(InteractiveSettings)}
"""Declarations of all fields of looks."""
_similarity = KNOBS["similarity"]
KNOBS["similarity"] = replace(
    _similarity, text=f'{_similarity.text} "none" filters nothing.', choices=FRAME_SIMILARITIES
)
Look = InteractiveSettings | FrameLook


def list_controls(look: Look) -> list[str]:
    """Return the fields of a look that have a control on the page, in the order of the controls."""
    return SCENE_CONTROLS if isinstance(look, InteractiveSettings) else [item.name for item in fields(look)]


def name_sides(left: Look, right: Look) -> tuple[str, str]:
    """Return labels for the two sides of the wipe, which name the settings that differ.

    >>> name_sides(InteractiveSettings(radius=2), InteractiveSettings(radius=4))
    ('A: radius 2', 'B: radius 4')
    """
    differing = [name for name in list_controls(left) if getattr(left, name) != getattr(right, name)]
    # With another method or similarity the other settings are details, or mean nothing for one of the sides.
    names = [name for name in ("method", "similarity") if name in differing] or differing[:2]

    def name(letter: str, look: Look) -> str:
        words = [_name_value(one, getattr(look, one)) for one in names]
        return f"{letter}: {', '.join(words)}" if words else letter

    return name("A", left), name("B", right)


def _name_value(name: str, value: Any) -> str:
    """Return a setting in words."""
    plain = name.replace("_", " ")
    if isinstance(value, bool):
        return plain if value else f"no {plain}"
    if name in ("method", "similarity", "quality", "form"):
        return "no filter" if value == "none" else str(value).replace("_", " ")
    return f"{plain} {value:.3g}" if isinstance(value, float) else f"{plain} {value}"
