"""What a page asks for: the settings of one side of the wipe, for a scene that is rendered and for a finished frame."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

METHODS = ("paths", "voxel_cones", "virtual_lights")
SCENE_SIMILARITIES = ("ggx", "sg", "asg", "sg_mixture", "normal", "none")
FRAME_SIMILARITIES = ("auto", "ggx", "sg", "asg", "sg_mixture", "normal", "none")


@dataclass(frozen=True)
class SceneLook:
    """How a scene is rendered and filtered; the fields are those of `lobewise.interactive.InteractiveSettings`.

    Parameters
    ----------
    method : {"paths", "voxel_cones", "virtual_lights"}
        Where indirect light comes from.
    scale : int
        Indirect light is shaded at one pixel of every ``scale`` times ``scale``, 1 to 16.
    spp : int
        Samples of each such pixel.
    similarity : {"ggx", "sg", "asg", "sg_mixture", "normal", "none"}
        What pixel and sample must share; "none" interpolates on the screen alone.
    beta : float or "auto"
        Exponent of the similarity.
    radius : int
        Samples from the centre to the edge of the kernel.
    temporal : bool
        Whether a frame knows the ones before.
    adaptive : float
        Share of the pixels that are shaded again, 0 to 1.
    filter_direct : bool
        Whether direct light, which has one light sample a pixel, is filtered too.
    """

    method: str = "paths"
    scale: int = 4
    spp: int = 1
    similarity: str = "ggx"
    beta: float | str = "auto"
    radius: int = 2
    temporal: bool = True
    adaptive: float = 0.05
    filter_direct: bool = True


@dataclass(frozen=True)
class FrameLook:
    """How a finished frame is filtered; the fields are those of `lobewise.DenoiseSettings`.

    Parameters
    ----------
    similarity : {"auto", "ggx", "sg", "asg", "sg_mixture", "normal", "none"}
        "none" shows the frame as it is.
    quality : {"fast", "balanced", "high"}
        Of a sparsely shaded frame always "fast".
    form : {"full", "separable", "atrous"}
        Other than "full" only with quality "fast"; of a sparsely shaded frame always "full".
    radius : int
        Pixels, or samples of a sparsely shaded frame.
    beta, tau : float or "auto"
        Exponent of the lobe similarity, and band-limit of the lobes in radians.
    normal_exponent : float
        Sharpness with which "normal" compares normals.
    hit_distance : bool
        Compare what lobes hit.
    """

    similarity: str = "auto"
    quality: str = "balanced"
    form: str = "full"
    radius: int = 8
    beta: float | str = "auto"
    tau: float | str = "auto"
    normal_exponent: float = 64.0
    hit_distance: bool = False


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
