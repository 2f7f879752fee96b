"""The plan of a frame: the plans of its layers, and the stages that the filtered layers go through."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from lobewise.denoising.planning.layer_plans import LayerTraits, plan_layers
from lobewise.denoising.planning.steps import LayerPlan
from lobewise.denoising.refining.lamps import REACH as LAMPS_REACH
from lobewise.filters.noise.detail import REACH as DETAIL_REACH
from lobewise.filters.refinement.shape import REACH as REFINEMENT_REACH
from lobewise.frame import Frame, GBuffer
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality


@dataclass(frozen=True)
class Stage:
    """One thing that happens to all layers of a frame together.

    Parameters
    ----------
    name : str
    text : str
        What it does, one sentence without a stop.
    reach : int or None
        Pixels from a pixel to the furthest one that the stage reads; None if it reads the whole image, so that bands
        cannot run it one by one.
    """

    name: str
    text: str
    reach: int | None = None


FILTER_LAYERS = Stage("filter", "filter every layer by its plan", 0)
REFINE = Stage("refine", "refine the image by the network that weighs neighbours", REFINEMENT_REACH + LAMPS_REACH)
TAKE_BACK_NOISY = Stage("take back", "take the noisy image back where the filter removed detail", DETAIL_REACH)
KEEP_LIGHT = Stage("keep light", "share out the light that bounding took from fireflies")
FILL_HOLES = Stage("fill holes", "fill bad pixels that no layer reached from their neighbours")
MIX_UNGUIDED = Stage("mix unguided", "mix in an image filtered by its color alone where guides are noise")
MIX_PEER = Stage("mix", "mix in the image of Open Image Denoise, pixel by pixel")
FILTER_ALSO = Stage("filter passes", "filter the light passes that belong to the layers by the same weights")


@dataclass(frozen=True)
class FrameTraits:
    """What the plan of a frame depends on, apart from the settings.

    Parameters
    ----------
    layers : dict of str to LayerTraits
        By the names of the layers.
    has_passes : bool
        Whether the frame has images that are filtered by the weights of a layer or of the total.
    has_halves : bool
        Whether the frame has both halves of its samples.
    """

    layers: Mapping[str, LayerTraits]
    has_passes: bool = False
    has_halves: bool = False


@dataclass(frozen=True)
class FramePlan:
    """What happens to a frame.

    Parameters
    ----------
    layers : dict of str to LayerPlan
        By the names of the layers.
    stages : tuple of Stage
        In order.
    """

    layers: Mapping[str, LayerPlan]
    stages: tuple[Stage, ...]

    @property
    def local_stages(self) -> tuple[Stage, ...]:
        """The stages before the first that reads the whole image: bands run these one by one."""
        count = next((number for number, stage in enumerate(self.stages) if stage.reach is None), len(self.stages))
        return self.stages[:count]

    @property
    def reach(self) -> int:
        """Pixels from a pixel to the furthest one on which the local stages depend."""
        return max(plan.reach for plan in self.layers.values()) + sum(stage.reach or 0 for stage in self.local_stages)

    def describe(self) -> Iterator[str]:
        """Yield the lines of the printed plan."""
        for number, stage in enumerate(self.stages, 1):
            yield f"{number}. {stage.text}"
            if stage is FILTER_LAYERS:
                for name, plan in self.layers.items():
                    yield f"   layer {name}, reach {plan.reach} pixels"
                    for step in plan.steps:
                        yield f"     {step.describe()}: {', '.join(step.reads)} -> {', '.join(step.writes)}"


def plan_frame(traits: FrameTraits, settings: ResolvedSettings) -> FramePlan:
    """Return what happens to a frame with these settings."""
    quality = get_quality(settings.quality)
    guided = quality.reads_halves
    wanted = {
        FILTER_LAYERS: True,
        # A radius of 0 asks for no filter.
        REFINE: quality.refines and settings.radius > 0,
        # With halves the mixture takes back what they prove.
        TAKE_BACK_NOISY: guided and not (settings.with_oidn and traits.has_halves),
        KEEP_LIGHT: guided,
        FILL_HOLES: True,
        MIX_UNGUIDED: quality.refines and settings.radius > 0,
        MIX_PEER: settings.with_oidn,
        FILTER_ALSO: traits.has_passes,
    }
    return FramePlan(
        plan_layers(traits.layers, settings), tuple(stage for stage, is_wanted in wanted.items() if is_wanted)
    )


def describe_frame(frame: Frame) -> FrameTraits:
    """Return what the plan of a frame depends on."""
    seen = has_seen(frame.gbuffer)
    if frame.radiance.parts is None:
        layers = {"color": LayerTraits(is_diffuse=False)}
    elif frame.layers:
        reflected = {each.name: not (each.is_diffuse or each.is_transmitted) for each in frame.layers}
        layers = {each.name: LayerTraits(each.is_diffuse, seen and reflected[each.name]) for each in frame.layers}
    else:
        layers = {"diffuse": LayerTraits(is_diffuse=True), "specular": LayerTraits(False, seen)}
    has_passes = bool(frame.also) or any(layer.parts for layer in frame.layers)
    return FrameTraits(layers, has_passes, has_halves=frame.half_a is not None and frame.half_b is not None)


def has_seen(guides: GBuffer) -> bool:
    """Return whether a frame tells what surfaces its reflections show."""
    return guides.hit_albedo is not None and guides.hit_normal is not None


def find_reach(settings: ResolvedSettings) -> int:
    """Return from how many pixels away a pixel of the local stages depends on anything, for any frame."""
    layers = {str(diffuse): LayerTraits(diffuse) for diffuse in (True, False)}
    return plan_frame(FrameTraits(layers), settings).reach
