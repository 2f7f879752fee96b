"""The settings of an exported pipeline, and the refusal of what a pipeline cannot contain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from lobewise.errors import InputError
from lobewise.settings import (
    Auto,
    Declared,
    DenoiseSettings,
    FormName,
    Knob,
    SimilarityName,
    document,
    list_knobs,
)
from lobewise.settings.choices import (
    DEFAULT_SIMILARITY,
    GUIDED_SIMILARITY,
    MAX_SCALE_PIXELS,
    Quality,
    Similarity,
    get_quality,
    get_similarity,
)

LAYERS = {"apart": ("diffuse", "specular"), "named": ("diffuse", "glossy", "transmission"), "color": ("color",)}
"""Names of the layers of each kind of light."""
FILTER = (
    *("similarity", "form", "radius", "lobes", "albedo"),
    *("position", "anisotropic", "lobe_kind"),
)
"""Settings of a single filter."""
CONTENTS = (
    "the plan filter, for one light; the plan fast, alone, with a history, with upsampling or both; the plans balanced "
    "and high; not Open Image Denoise, and nothing that is chosen for each frame"
)
"""What a pipeline can contain, for messages."""


_KNOBS = list_knobs(DenoiseSettings)


@dataclass(frozen=True)
class PipelineSettings(Declared):
    """The settings of a pipeline that are fixed when it is compiled."""

    plan: Annotated[
        Literal["filter", "fast", "balanced", "high"],
        Knob('What is exported: a single "filter", or a whole plan: "fast", "balanced" or "high".'),
    ] = "fast"
    similarity: Annotated[
        SimilarityName | Literal["diffuse"] | Auto,
        replace(
            _KNOBS["similarity"],
            text=_KNOBS["similarity"].hint
            + ' The plan "filter" has "diffuse", too. "auto" is "sg" in the plans balanced and high, else "ggx".',
        ),
    ] = "auto"
    form: Annotated[FormName, _KNOBS["form"]] = "full"
    radius: Annotated[int, _KNOBS["radius"]] = 8
    lobes: Annotated[int, replace(_KNOBS["lobes"], low=2, usual="one lobe is similarity 'sg'")] = 3
    albedo: Annotated[
        bool, Knob("With the plan filter, whether the radiance is divided by an albedo before and multiplied after.")
    ] = True
    history: Annotated[bool, Knob("Whether frames are joined with those before them.")] = False
    upsample: Annotated[
        int, Knob("Distance of shaded pixels, pixels: one pixel of a block is shaded.", low=1, high=MAX_SCALE_PIXELS)
    ] = 1
    layers: Annotated[
        Literal["apart", "named", "color"],
        Knob(
            "Whether diffuse and specular light come apart, or diffuse, glossy and transmitted light, or all light in "
            "one image."
        ),
    ] = "apart"
    emission: Annotated[
        bool, Knob("Whether emission and background come in an image of their own, instead of all light in one.")
    ] = False
    motion: Annotated[bool, Knob("With a history, whether motion vectors are given; else only the camera moves.")] = (
        True
    )
    position: Annotated[bool, Knob("Whether positions are given beside depths; else the camera tells them.")] = False
    anisotropic: Annotated[
        bool,
        Knob(
            'With "ggx": lobes from two roughnesses and a tangent instead of one roughness.',
            opposite="isotropic",
        ),
    ] = False
    lobe_kind: Annotated[bool, Knob("Whether an image tells the kind of each pixel's lobe.")] = False
    hit_distance: Annotated[
        bool,
        Knob(
            "With a history, whether the distances that reflected rays went are given: it follows reflections by them."
        ),
    ] = False

    halves: Annotated[
        bool,
        Knob(
            "With the plans balanced and high, whether two halves of the samples are given; else the noise is told by "
            "residuals of one image."
        ),
    ] = True
    coverage: Annotated[
        bool,
        Knob(
            "With upsampling or the plans balanced and high, whether the shares of pixels that near surfaces cover "
            "and mean albedos are given: edges of surfaces are smooth then."
        ),
    ] = False
    rays: Annotated[
        bool,
        Knob("With upsampling, whether the weights of the specular rays of samples are given."),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.similarity == "auto":
            object.__setattr__(self, "similarity", GUIDED_SIMILARITY if self.is_guided else DEFAULT_SIMILARITY)
        if self.is_filter:
            self._check_filter()
        for is_refused, what, got, action in self._list_rules():
            if is_refused:
                raise _refuse(what, got, action)

    def _list_rules(self) -> list[tuple[bool, str, str, str]]:
        """Return what a pipeline cannot contain: whether it is asked for, the setting, what it says, what to do."""
        guided, sparse, over_time = self.is_guided, self.upsample > 1, self.history
        color, named = self.layers == "color", self.layers == "named"
        apart, leave, single = "give diffuse and specular light apart", "leave it out", "choose the plan filter"
        diffuse = self.similarity == "diffuse" and not self.is_filter
        what = "history" if over_time else "upsampling"
        form = self.form not in self.quality.forms or (sparse and self.form != "full")
        return [
            (sparse and color, "layers", "one layer with upsampling", apart),
            (named and (over_time or sparse), "layers", "named layers with a history or upsampling", apart),
            (diffuse, "similarity", f"diffuse in the plan {self.plan}", single),
            (not self.albedo and not self.is_filter, "albedo", f"none in the plan {self.plan}", single),
            (self.record.is_mixture and over_time, "similarity", f"{self.similarity} with history", "choose ggx"),
            (guided and (over_time or sparse), "plan", f"{self.plan} with {what}", f"choose the plan fast for {what}"),
            (form, "form", self.form, leave),
            (self.emission and sparse, "emission", "upsampling, which has it anyway", leave),
            (self.emission and color, "emission", "one layer", apart),
            (self.hit_distance and not over_time, "hit_distance", "without a history", "add a history"),
            (self.hit_distance and color, "hit_distance", "a history with one layer", apart),
            (self.rays and not sparse, "rays", "without upsampling", "add upsampling, or leave it out"),
            (self.coverage and named, "coverage", "with named layers", leave),
            (self.coverage and not sparse and not guided, "coverage", "in one pass", "add upsampling, or leave it out"),
            (not self.halves and not guided, "halves", "in one pass, which reads none", leave),
            (self.anisotropic and not self.record.has_covariance, "anisotropic", self.similarity, "choose ggx"),
        ]

    def _check_filter(self) -> None:
        """Refuse what a single filter does not have."""
        usual = PipelineSettings()
        for name in vars(self).keys() - {"plan", *FILTER}:
            if getattr(self, name) != getattr(usual, name):
                raise _refuse(name, f"{name} with the plan filter", "choose the plan fast, or leave it out")

    @property
    def is_filter(self) -> bool:
        """Whether it is a single filter."""
        return self.plan == "filter"

    @property
    def quality(self) -> Quality:
        """The record of the quality whose recipe is exported; a filter is a step of the quality "fast"."""
        return get_quality("fast" if self.is_filter else self.plan)

    @property
    def record(self) -> Similarity:
        """The record of the similarity; "diffuse" reads what "normal" reads."""
        return get_similarity("normal" if self.similarity == "diffuse" else self.similarity)

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Names of the layers."""
        return ("light",) if self.is_filter else LAYERS[self.layers]

    @property
    def is_guided(self) -> bool:
        """Whether the passes are guided by the noise."""
        return self.quality.reads_halves

    @property
    def reads_halves(self) -> bool:
        """Whether two halves of the samples are given."""
        return self.is_guided and self.halves

    @property
    def left_out(self) -> set[str]:
        """The guides that are not given."""
        given = {
            "position": self.position,
            "alpha_v": self.anisotropic,
            "tangent": self.anisotropic,
            "lobe_kind": self.lobe_kind,
            "hit_distance": self.hit_distance,
            "motion": self.history and self.motion,
            "specular_albedo": not self.is_filter,
            "mean_emission": self.upsample > 1,
            **dict.fromkeys(("coverage", "mean_diffuse_albedo", "mean_specular_albedo"), self.coverage),
        }
        return {name for name, is_given in given.items() if not is_given}

    @property
    def choices(self) -> dict[str, Any]:
        """The settings of the recipe whose plan is exported, but for numbers."""
        return {
            "quality": self.quality.name,
            "similarity": self.record.name,
            **{name: getattr(self, name) for name in ("lobes", "form", "radius")},
            "device": "cpu",
            "with_oidn": False,
        }


def _refuse(what: str, got: str, action: str) -> InputError:
    return InputError(what, expected=f"what a pipeline can contain ({CONTENTS})", got=got, action=action)


document(PipelineSettings)
