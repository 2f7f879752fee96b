"""The settings of an exported pipeline, and the refusal of what a pipeline cannot contain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from lobewise.errors import InputError
from lobewise.settings import (
    LARGEST_RADIUS,
    MAX_LOBES,
    Declared,
    FormName,
    Knob,
    ResolvedSettings,
    SimilarityName,
    document,
)
from lobewise.settings.choices import MAX_SCALE_PIXELS, Quality, Similarity, get_quality, get_similarity

LAYERS = {"apart": ("diffuse", "specular"), "named": ("diffuse", "glossy", "transmission"), "color": ("color",)}
"""Names of the layers of each kind of light."""
FILTER = (
    *("similarity", "form", "radius", "lobes", "albedo"),
    *("position", "anisotropic", "lobe_kind", "hit_distance"),
)
"""Settings of a single filter."""
CONTENTS = (
    "the plan filter, for one light; the plan fast, alone, with a history, with upsampling or both; the plans balanced "
    "and high; not Open Image Denoise, and nothing that is chosen for each frame"
)
"""What a pipeline can contain, for messages."""


@dataclass(frozen=True)
class PipelineSettings(Declared):
    """The settings of a pipeline that are fixed when it is compiled."""

    plan: Annotated[
        Literal["filter", "fast", "balanced", "high"],
        Knob('What is exported: a single "filter", or a whole plan: "fast", "balanced" or "high".'),
    ] = "fast"
    similarity: Annotated[
        SimilarityName | Literal["diffuse"],
        Knob('What two pixels must share to be averaged; "diffuse" with the plan filter.'),
    ] = "ggx"
    form: Annotated[FormName, Knob("Which neighbours count.")] = "full"
    radius: Annotated[
        int,
        Knob(
            'Pixels (samples, with upsampling) from the centre to the edge of the kernel; "atrous" does not use it.',
            high=LARGEST_RADIUS,
            usual="8 is usual",
        ),
    ] = 8
    lobes: Annotated[
        int,
        Knob(
            'With "sg_mixture": spherical Gaussians of a pixel.',
            low=2,
            high=MAX_LOBES,
            usual="3 stand for GGX within 1 %, and one is similarity 'sg'",
        ),
    ] = 3
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
            'With "asg" and "ggx": lobes from two roughnesses and a tangent instead of one roughness.',
            opposite="isotropic",
        ),
    ] = False
    lobe_kind: Annotated[bool, Knob("Whether an image tells the kind of each pixel's lobe.")] = False
    hit_distance: Annotated[
        bool,
        Knob(
            "Whether the distances that reflected rays went are given: histories follow reflections by them; without "
            "a history lobes are compared at their hits."
        ),
    ] = False

    halves: Annotated[
        bool,
        Knob(
            "With the plans balanced and high, whether two halves of the samples are given; else the noise is told by "
            "residuals of one image."
        ),
    ] = True
    hit_guides: Annotated[
        bool,
        Knob("With the plans balanced and high, whether albedo and normal of reflected surfaces are given."),
    ] = False
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
        if self.upsample > 1 and self.layers == "color":
            raise _refuse("layers", "one layer with upsampling", "give diffuse and specular light apart")
        if self.layers == "named" and (self.history or self.upsample > 1):
            raise _refuse(
                "layers", "named layers with a history or upsampling", "give diffuse and specular light apart"
            )
        if self.is_filter:
            self._check_filter()
        elif self.similarity == "diffuse" or not self.albedo:
            what, got = ("similarity", "diffuse") if self.similarity == "diffuse" else ("albedo", "light without one")
            raise _refuse(what, f"{got} in the plan {self.plan}", "choose the plan filter")
        if self.record.is_mixture and (self.history or self.hit_distance):
            raise _refuse(
                "similarity", f"{self.similarity} with {'history' if self.history else 'hit distances'}", "choose ggx"
            )
        guided = self.is_guided
        if guided and (self.history or self.upsample > 1):
            what = "history" if self.history else "upsampling"
            raise _refuse("plan", f"{self.plan} with {what}", f"choose the plan fast for {what}")
        if self.form not in self.quality.forms or (self.upsample > 1 and self.form != "full"):
            raise _refuse("form", self.form, "leave it out")
        if self.emission and (self.upsample > 1 or self.layers == "color"):
            raise _refuse(
                "emission",
                "upsampling, which has it anyway" if self.upsample > 1 else "one layer",
                "leave it out" if self.upsample > 1 else "give diffuse and specular light apart",
            )
        if self.hit_distance and self.history and self.layers == "color":
            raise _refuse("hit_distance", "a history with one layer", "give diffuse and specular light apart")
        if self.hit_distance and not self.history and not self.record.has_lobes:
            raise _refuse("hit_distance", f"{self.similarity} without a history", "choose a similarity of lobes")
        if self.rays and self.upsample == 1:
            raise _refuse("rays", "without upsampling", "add upsampling, or leave it out")
        if self.coverage and ((self.upsample == 1 and not guided) or self.layers == "named"):
            raise _refuse(
                "coverage",
                "with named layers" if self.layers == "named" else "in one pass",
                "add upsampling, choose the plan balanced, or leave it out",
            )
        if self.hit_guides and (not guided or self.layers != "apart"):
            raise _refuse("hit_guides", "in one pass" if not guided else f"layers {self.layers!r}", "leave it out")
        if not self.halves and not guided:
            raise _refuse("halves", "in one pass, which reads none", "leave it out")
        if self.anisotropic and not self.record.has_covariance:
            raise _refuse("anisotropic", self.similarity, "choose asg or ggx")

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
    def compares_hits(self) -> bool:
        """Whether lobes are compared at their hits."""
        return self.hit_distance and not self.history

    def resolve(self) -> ResolvedSettings:
        """Return the settings of the recipe whose plan is exported; a pipeline computes their numbers itself."""
        return ResolvedSettings(
            quality=self.quality.name,
            similarity=self.record.name,
            lobes=self.lobes,
            form=self.form,
            radius=self.radius,
            beta=1.0,
            diffuse_beta=1.0,
            screen_sigma=1.0,
            tau=0.01,
            device="cpu",
            hit_distance=self.compares_hits,
            with_oidn=False,
        )


def _refuse(what: str, got: str, action: str) -> InputError:
    return InputError(what, expected=f"what a pipeline can contain ({CONTENTS})", got=got, action=action)


document(PipelineSettings)
