"""The settings of an interactive frame; importing them costs nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from lobewise.errors import require_choice
from lobewise.settings import SIMILARITY_NAMES, Auto, Declared, DenoiseSettings, Knob, SimilarityName, document
from lobewise.settings.choices import MAX_SCALE_PIXELS

Method = Literal["paths", "voxel_cones", "virtual_lights"]
Unfiltered = Literal["none"]

METHODS: tuple[Method, ...] = get_args(Method)
"""Ways of computing indirect light."""
UNFILTERED: Unfiltered = "none"
"""The similarity that switches the filter off."""
MAX_SHOWN_SHARPNESS = 1e6
"""Sharpness that the views show brightest, inverse square radians."""
MAX_SHOWN_FRAMES = 40.0
"""History length that the views show brightest, frames."""
MAX_SHOWN_SAMPLES = 256.0
"""Number of effective samples that the views show brightest."""
VIEWS = {
    "image": "image",
    "noisy": "noisy input",
    "direct": "direct light",
    "indirect": "indirect light",
    "sharpness": "lobe sharpness",
    "weight_sum": "weight sum",
    "history": "history length",
    "recomputed": "re-computed pixels",
    "hit_distance": "hit distance",
    "normal": "normals",
    "albedo": "albedo",
}
"""Views of a frame by their names, with their titles. "image", "noisy", "direct" and "indirect" are radiance, "normal"
and "albedo" are colours, and the others are numbers in [0, 1]."""
_OF_THE_FILTER = ("beta", "radius", "screen_sigma", "tau", "normal_exponent")


@dataclass(frozen=True)
class InteractiveSettings(Declared):
    """Parameters of a frame of `Session`.

    ``beta``, ``radius``, ``screen_sigma``, ``tau`` and ``normal_exponent`` are those of `lobewise.DenoiseSettings`; the
    radius counts shaded pixels. So is ``similarity``, which may also be "none": samples are then interpolated on the
    screen, without filter and history.
    """

    method: Annotated[Method, Knob("How indirect light is computed.", label="Method")] = "paths"
    scale: Annotated[
        int,
        Knob(
            "Indirect light is shaded at one pixel of every n x n and upsampled.",
            low=1,
            high=MAX_SCALE_PIXELS,
            usual="4 is usual",
            label="Every nth pixel",
        ),
    ] = 4
    spp: Annotated[int, Knob("Samples of each shaded pixel.", low=1, high=1 << 16, label="Samples")] = 1
    similarity: SimilarityName | Auto | Unfiltered = "ggx"
    beta: float | Auto = "auto"
    radius: int = 5
    screen_sigma: float | Auto = "auto"
    tau: float | Auto = "auto"
    normal_exponent: float = DenoiseSettings.normal_exponent
    temporal: Annotated[bool, Knob("A frame knows the ones before.", label="Temporal")] = True
    adaptive: Annotated[
        float,
        Knob(
            "Share of the pixels that is shaded again because nothing supports them, over adaptive_parts.",
            high=1.0,
            usual="0.05 is usual",
            label="Adaptive, %",
        ),
    ] = 0.05
    adaptive_parts: Annotated[
        int | Auto,
        Knob(
            "How often each of these pixels is shaded; the differences tell the noise. Time is that of adaptive alone. "
            '"auto" is 4 for noisy methods, else 1.',
            low=1,
            high=64,
        ),
    ] = "auto"
    limit_lobes: Annotated[
        bool,
        Knob(
            'Where tau is "auto", widen lobes to what light that is not sampled by the BRDF can show: virtual lights '
            'on a sharp lobe are spikes, which a narrow kernel would keep (Tokuyoshi 2015, "Limitations (2)").'
        ),
    ] = True
    filter_direct: Annotated[
        bool, Knob("Direct light has one light sample a pixel; filter it too.", label="Filter direct light")
    ] = True
    accumulate: Annotated[
        bool, Knob("Average frames for as long as neither camera nor settings change.", label="Accumulate when still")
    ] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("similarity", self.similarity, ("auto", *SIMILARITY_NAMES, UNFILTERED))
        self.make_filter_settings()

    def make_filter_settings(self) -> DenoiseSettings:
        """Return the settings of the filter; its similarity is "auto" where this one is "none"."""
        similarity = "auto" if self.similarity == "none" else self.similarity
        same: dict[str, Any] = {name: getattr(self, name) for name in _OF_THE_FILTER}
        return DenoiseSettings(similarity=similarity, **same)


document(InteractiveSettings)
