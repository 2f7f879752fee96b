"""The plans of one layer of each quality."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.denoising.planning.steps import (
    HISTORY,
    SAMPLES,
    AccumulateStep,
    FilterStep,
    FinishStep,
    GuideStep,
    LayerPlan,
    MixStep,
    PassStep,
    Step,
    UpsampleStep,
)
from lobewise.filters.dual_buffer_pass import Exponents
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

    @property
    def network(self) -> str:
        """Name of the network that mixes the images of such a layer."""
        return "diffuse" if self.is_diffuse else "specular"


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
"""Tuned on the scenes that ``benchmarks/quality/measure.py`` calls train (docs/quality.md). Diffuse light varies
slowly: a second, sparse pass over the image of the first reaches as far as a dense kernel of three times the cost. Of
reflections only the rough ones take part in the sparse pass: 4 pixels apart, the axes of sharp lobes are too different
for so high a power."""
AUTO_SIGMA = 30.0
"""Screen sigma, pixels, that "auto" stands for at radius 8. The sigmas of the passes are in proportion to it."""

PILOT_RADIUS, PILOT_SIGMA, PILOT_NOISE = 5, 6.0, 40.0
PILOT_VARIANTS = (Exponents(1.0, 4.0, 1.0),)
"""The first pass of the quality "high", at radius 8."""
DENSE_NOISE = {"diffuse": 12.0, "specular": 6.0}
"""Variances of the guide by which the dense passes divide squared differences, for each network."""
DENSE_SIGMA = 30.0
"""Standard deviation of the distance, pixels and footprints, at radius 8, of a variant whose exponent of place is 1."""
DENSE = (
    (Exponents(25.0, 2.0, 1.0, 2.0), Exponents(6.0, 1.0, 1.0), Exponents(1.0, 1.0, 1.0)),
    (Exponents(225.0, 4.0, 1.0, 2.0), Exponents(64.0, 2.0, 1.0, 2.0), Exponents(25.0, 4.0, 0.3, 2.0)),
    (Exponents(6.0, 4.0, 1.0, 2.0), Exponents(1.0, 0.25, 1.0, 2.0), Exponents(1.0, 2.0, 0.3)),
)
"""Variants that the pilot guides. They run in three passes because the sums of more variants do not fit the registers.
Their sigmas are 6, 12 and 30 pixels in the first pass and 2, 4 and 6 in the second. The third pass has variants that
trust the lobes or the guide more, or less."""
SPARSE = (Exponents(1.0, 1.0, 1.0), Exponents(1.0, 0.25, 0.3))
"""Variants of the sparse passes. A sparse pass is guided by the image that it averages: the wide variant of the first
dense pass, then the first variant of the sparse pass before."""
SPARSE_RADIUS_TAPS, SPARSE_NOISE = 3, 6.0
SPARSE_STEPS_PIXELS = (4, 10)
"""Pixels from tap to tap of the sparse passes, at radius 8."""
NARROW, MIDDLE, WIDE = range(3)
"""Candidates of the first dense pass: two whose effective samples the network reads, the middle one of which the others
are compared with, and the one that the sparse passes average."""
CANDIDATE_COUNT = sum(map(len, DENSE)) + len(SPARSE_STEPS_PIXELS) * len(SPARSE)


def plan_layer(traits: LayerTraits, settings: ResolvedSettings) -> LayerPlan:
    """Return the plan of a layer for the quality of the settings."""
    quality = get_quality(settings.quality)
    if not quality.reads_halves:
        return plan_fast(settings)
    return plan_high(traits, settings) if quality.mixes else plan_balanced(traits, settings)


def plan_fast(settings: ResolvedSettings) -> LayerPlan:
    """Return the plan of the quality "fast": the paper's filter, once."""
    return LayerPlan((FilterStep(reads=(SAMPLES,), writes=("image",), form=settings.form, radius=settings.radius),))


def plan_upsampling(radius: int, scale: int) -> LayerPlan:
    """Return the plan of upsampling; the radius counts samples, which are ``scale`` pixels apart."""
    return LayerPlan((UpsampleStep(reads=(SAMPLES,), writes=("image",), radius=radius, scale=scale),))


def plan_history(settings: ResolvedSettings, *, growth: float, own: float) -> LayerPlan:
    """Return the plan of a frame that is joined with its history; parameters as of `AccumulateStep`."""
    return LayerPlan(
        (
            AccumulateStep(
                reads=(SAMPLES, HISTORY),
                writes=("image",),
                form=settings.form,
                radius=settings.radius,
                growth=growth,
                own=own,
            ),
        )
    )


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
            variants=(Exponents(1.0, lobes, 1.0),),
            radius=radius,
            step=step,
            sigma=each.sigma,
            noise=each.noise,
            is_pilot=not follows,
            reads_seen=reads_seen,
            # No step reads the noise of the last image.
            joined=number == len(passes) - 1,
            # Sparse passes average averages, so the weights that they gather do not count samples.
            supports=(light,) if each.step == 1 else (),
        )
        steps += [GuideStep(reads=(source,), writes=(guide,)), one]
        source, support = light, light if each.step == 1 else support
    return LayerPlan((*steps, FinishStep(reads=(source, support), writes=("image",), support=support)))


def plan_high(traits: LayerTraits, settings: ResolvedSettings) -> LayerPlan:
    """Return the plan of the quality "high": thirteen images from narrow to wide, and their mixture."""
    steps: list[Step] = [GuideStep(reads=(SAMPLES,), writes=("guide 1",)), plan_pilot(settings)]
    steps.append(GuideStep(reads=("pilot",), writes=("guide 2",)))
    names: list[str] = []
    for variants in DENSE:
        writes = tuple(f"dense {len(names) + number + 1}" for number in range(len(variants)))
        dense = PassStep(
            reads=(SAMPLES, "guide 2"),
            writes=writes,
            variants=variants,
            radius=settings.radius,
            sigma=DENSE_SIGMA,
            noise=DENSE_NOISE[traits.network],
            reads_seen=traits.has_seen,
            supports=() if names else (writes[NARROW], writes[MIDDLE]),
        )
        steps.append(dense)
        names += writes
    narrow, middle, source = (names[number] for number in (NARROW, MIDDLE, WIDE))
    for number, each in enumerate(SPARSE_STEPS_PIXELS):
        guide, writes = f"guide {number + 3}", tuple(f"sparse {number + 1}.{k + 1}" for k in range(len(SPARSE)))
        taps, step = scale_kernel(SPARSE_RADIUS_TAPS, each, settings.radius, follows=True)
        sparse = PassStep(
            reads=(source, guide),
            writes=writes,
            variants=SPARSE,
            radius=taps,
            step=step,
            sigma=DENSE_SIGMA,
            noise=SPARSE_NOISE,
            reads_seen=traits.has_seen,
        )
        steps += [GuideStep(reads=(source,), writes=(guide,)), sparse]
        names += writes
        source = writes[0]
    mix = MixStep(
        reads=(*names, "guide 2", "guide 3"),
        writes=("light",),
        candidates=tuple(names),
        counted=(narrow, middle),
        guides=("guide 2", "guide 3"),
        network=traits.network,
    )
    return LayerPlan((*steps, mix, FinishStep(reads=("light", middle), writes=("image",), support=middle)))


def plan_pilot(settings: ResolvedSettings) -> PassStep:
    """Return the first pass of the quality "high"."""
    radius, _ = scale_kernel(PILOT_RADIUS, 1, settings.radius, follows=False)
    return PassStep(
        reads=(SAMPLES, "guide 1"),
        writes=("pilot",),
        variants=PILOT_VARIANTS,
        radius=radius,
        sigma=PILOT_SIGMA,
        noise=PILOT_NOISE,
        is_pilot=True,
    )


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
