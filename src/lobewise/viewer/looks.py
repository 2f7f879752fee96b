"""What a page asks for: the settings of one side of the wipe, for a scene that is rendered and for a finished frame."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal, get_args

from lobewise.settings import SIMILARITIES, Auto, Declared, DenoiseSettings, Knob, Similarity, document, list_knobs

Method = Literal["paths", "voxel_cones", "virtual_lights"]
Unfiltered = Literal["none"]

METHODS: tuple[Method, ...] = get_args(Method)
SCENE_SIMILARITIES = (*reversed(SIMILARITIES), *get_args(Unfiltered))
FRAME_SIMILARITIES = ("auto", *SCENE_SIMILARITIES)


@dataclass(frozen=True)
class SceneLook(Declared):
    """How a scene is rendered and filtered; the fields are those of `lobewise.interactive`.

    Those of the filter are as in `lobewise.DenoiseSettings`; "none" interpolates on the screen alone.
    """

    method: Annotated[Method, Knob("How indirect light is computed.", label="Method")] = "paths"
    scale: Annotated[
        int,
        Knob(
            "Indirect light is shaded at one pixel of every n x n and upsampled.",
            low=1,
            high=16,
            usual="4 is usual",
            label="Every nth pixel",
        ),
    ] = 4
    spp: Annotated[int, Knob("Samples of each shaded pixel.", low=1, high=1 << 16, label="Samples")] = 1
    similarity: Similarity | Unfiltered = "ggx"
    radius: int = 2
    beta: float | Auto = "auto"
    temporal: Annotated[bool, Knob("A frame knows the ones before.", label="Temporal")] = True
    adaptive: Annotated[
        float,
        Knob("Share of the pixels that is shaded again because nothing supports them.", high=1.0, label="Adaptive, %"),
    ] = 0.05
    filter_direct: Annotated[
        bool, Knob("Direct light has one light sample a pixel; filter it too.", label="Filter direct light")
    ] = True


@dataclass(frozen=True)
class FrameLook:
    """How a finished frame is filtered; the fields are as in `lobewise.DenoiseSettings`.

    The similarity "none" shows the frame as it is. A sparsely shaded frame has the quality "fast" and the form "full".
    """

    similarity: Similarity | Auto | Unfiltered = "auto"
    quality: str = "balanced"
    form: str = "full"
    radius: int = 8
    beta: float | Auto = "auto"
    normal_exponent: float = 64.0
    tau: float | Auto = "auto"
    hit_distance: bool = False


document(SceneLook)
KNOBS = {**list_knobs(DenoiseSettings), **list_knobs(SceneLook)}
"""What each field means."""
_similarity = KNOBS["similarity"]
KNOBS["similarity"] = replace(
    _similarity, text=f'{_similarity.text} "none" filters nothing.', choices=FRAME_SIMILARITIES
)
Look = SceneLook | FrameLook


def name_sides(left: Look, right: Look) -> tuple[str, str]:
    """Return labels for the two sides of the wipe: what tells their settings apart.

    >>> name_sides(SceneLook(radius=2), SceneLook(radius=4))
    ('A: radius 2', 'B: radius 4')
    """
    differing = [item.name for item in fields(left) if getattr(left, item.name) != getattr(right, item.name)]
    # Where methods or similarities differ the rest is detail, or means nothing for one of them.
    names = [name for name in ("method", "similarity") if name in differing] or differing[:2]

    def name(letter: str, look: Look) -> str:
        words = [_name_value(one, getattr(look, one)) for one in names]
        return f"{letter}: {', '.join(words)}" if words else letter

    return name("A", left), name("B", right)


def _name_value(name: str, value: Any) -> str:
    """Return a setting as words."""
    plain = name.replace("_", " ")
    if isinstance(value, bool):
        return plain if value else f"no {plain}"
    if name in ("method", "similarity", "quality", "form"):
        return "no filter" if value == "none" else str(value).replace("_", " ")
    return f"{plain} {value:.3g}" if isinstance(value, float) else f"{plain} {value}"
