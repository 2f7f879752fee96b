"""The plans of one layer of each quality."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lobewise.denoising.planning.steps import (
    SAMPLES,
    FilterStep,
    FinishStep,
    GuideStep,
    LayerPlan,
    PassStep,
    Step,
)
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality


@dataclass(frozen=True)
class LayerTraits:
    """What the plan of a layer depends on.

    Parameters
    ----------
    is_diffuse : bool
        Whether the layer holds diffuse light.
    has_seen : bool
        Whether the frame tells what surfaces the reflections of this layer show.
    """

    is_diffuse: bool
    has_seen: bool = False


@dataclass(frozen=True)
class BalancedPass:
    """One pass of the quality "balanced", at radius 8; parameters as in `PassStep`.

    ``lobes`` is the exponent of the lobe similarity over that of the settings, and ``lobes_with_seen`` the exponent
    where the frame tells what reflections show, which says more than the lobes do.
    """

    radius: int
    sigma: float
    noise: float
    lobes: float = 1.0
    lobes_with_seen: float = 1.0
    step: int = 1


BALANCED_DIFFUSE = (
    BalancedPass(3, 6.0, 40.0, lobes=4.0, lobes_with_seen=4.0),
    BalancedPass(6, 30.0, 12.0),
    BalancedPass(3, 30.0, 6.0, step=4),
)
BALANCED_SPECULAR = (
    BalancedPass(4, 6.0, 40.0, lobes=4.0, lobes_with_seen=4.0),
    BalancedPass(5, 22.0, 6.0, lobes_with_seen=0.5),
    BalancedPass(3, 30.0, 6.0, lobes=64.0, lobes_with_seen=64.0, step=4),
)
"""Tuned on the scenes that ``benchmarks/quality/measure.py`` calls train (docs/research/quality_trials.md). Diffuse
light varies slowly: a second, sparse pass over the image of the first reaches as far as a dense kernel of three times
the cost. Of reflections only the rough ones take part in the sparse pass: 4 pixels apart, the axes of sharp lobes are
too different for so high a power."""
AUTO_SIGMA = 30.0
"""Screen sigma, pixels, that "auto" stands for at radius 8. The sigmas of the passes are in proportion to it."""


def plan_layers(traits: Mapping[str, LayerTraits], settings: ResolvedSettings) -> dict[str, LayerPlan]:
    """Return the plans of layers for the quality of the settings, by name."""
    if not get_quality(settings.quality).reads_halves:
        return dict.fromkeys(traits, plan_fast(settings))
    return {name: plan_balanced(each, settings) for name, each in traits.items()}


def plan_fast(settings: ResolvedSettings) -> LayerPlan:
    """Return the plan of the quality "fast": the paper's filter, once."""
    return LayerPlan((FilterStep(reads=(SAMPLES,), writes=("image",), form=settings.form, radius=settings.radius),))


def plan_balanced(traits: LayerTraits, settings: ResolvedSettings) -> LayerPlan:
    """Return the plan of the quality "balanced": a pilot, a dense and a sparse pass, each guided by the one before."""
    steps: list[Step] = []
    source, support = SAMPLES, ""
    passes = BALANCED_DIFFUSE if traits.is_diffuse else BALANCED_SPECULAR
    for number, each in enumerate(passes):
        follows, guide, light = number > 0, f"guide {number + 1}", f"light {number + 1}"
        radius, step = scale_kernel(each.radius, each.step, settings.radius, follows=follows)
        reads_seen = traits.has_seen and follows
        lobes = each.lobes_with_seen if reads_seen else each.lobes
        one = PassStep(
            reads=(source if each.step > 1 and follows else SAMPLES, guide),
            writes=(light,),
            exponent=lobes,
            radius=radius,
            step=step,
            sigma=each.sigma,
            noise=each.noise,
            is_pilot=not follows,
            reads_seen=reads_seen,
            # Sparse passes average averages, so the weights that they gather do not count samples.
            supports=(light,) if each.step == 1 else (),
        )
        steps += [GuideStep(reads=(source,), writes=(guide,)), one]
        source, support = light, light if each.step == 1 else support
    return LayerPlan((*steps, FinishStep(reads=(source, support), writes=("image",), support=support)))


def scale_kernel(taps: int, step: int, radius: int, *, follows: bool) -> tuple[int, int]:
    """Return the radius in taps and the step in pixels that a kernel of radius 8 has at another radius.

    Parameters
    ----------
    taps, step : int
        Radius in taps and pixels from tap to tap, at radius 8 of the settings.
    radius : int
        Radius of the settings, pixels.
    follows : bool
        Whether another pass came before. A sparse pass then averages the image of that pass, and keeps its taps.
    """
    scale = radius / 8.0
    if step == 1:
        return round(taps * scale), 1
    return min(taps, radius) if follows else round(taps * scale), max(round(step * scale), 1)
