"""The steps that filter one layer, as data: which images a step reads and writes, and by which numbers.

A step names its images. `SAMPLES` are the samples of the layer; every other name is that of an image which an earlier
step wrote. `lobewise.denoising.running` runs the steps. The reach of a step is the number of pixels from its pixel to
the furthest pixel that it reads.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

from lobewise.filters.compositing import REACH as COVERAGE_REACH
from lobewise.filters.fireflies import REACH as FIREFLY_REACH
from lobewise.filters.forms import ATROUS_REACH
from lobewise.filters.highlights import REACH as HIGHLIGHT_REACH
from lobewise.filters.noise.residuals import REACH as RESIDUAL_REACH
from lobewise.filters.noise_guides import BLUR_RADIUS as GUIDE_REACH
from lobewise.guides.lobe_fields import SPREAD_REACH

SAMPLES = "samples"
"""Name of the samples of a layer, the first image of every plan."""
SAMPLES_REACH = FIREFLY_REACH + HIGHLIGHT_REACH + RESIDUAL_REACH + SPREAD_REACH
"""Reach of everything that happens to the samples and to the lobes before the first pass, pixels."""


@dataclass(frozen=True, kw_only=True)
class Step(ABC):
    """One step: its inputs and outputs by name."""

    reads: tuple[str, ...]
    writes: tuple[str, ...]

    @property
    def reach(self) -> int:
        """Pixels from the pixel of the step to the furthest pixel that it reads."""
        return 0

    @property
    def taps(self) -> int:
        """Neighbours that the kernel reads for a pixel."""
        return 0

    @abstractmethod
    def describe(self) -> str:
        """Return what the step does, in a few words."""


@dataclass(frozen=True, kw_only=True)
class KernelStep(Step):
    """A step whose kernel has a form, "full", "separable" or "atrous", and a radius in pixels."""

    form: str
    radius: int

    @property
    def reach(self) -> int:
        """The radius; five levels of doubling step reach further."""
        return ATROUS_REACH if self.form == "atrous" else self.radius


@dataclass(frozen=True, kw_only=True)
class FilterStep(KernelStep):
    """Average the neighbours of every pixel once, weighted by the guides alone: the filter of the paper."""

    def describe(self) -> str:
        """Return the form and the size of the kernel."""
        size = 2 * self.reach + 1
        return f"{self.form} kernel, {size}x{size} pixels"

    @property
    def taps(self) -> int:
        """A row and a column, five levels of 5x5, or the whole square."""
        size = 2 * self.radius + 1
        return {"separable": 2 * size, "atrous": 5 * 5 * 5}.get(self.form, size * size)


@dataclass(frozen=True, kw_only=True)
class GuideStep(Step):
    """Make the guide of a pass: logarithms of both halves' mean, and their variance."""

    @property
    def reach(self) -> int:
        """The variance is blurred."""
        return GUIDE_REACH

    def describe(self) -> str:
        """Return the name of the kernel."""
        return "noise guide"


@dataclass(frozen=True, kw_only=True)
class PassStep(Step):
    """Run one dual-buffer pass.

    Parameters
    ----------
    guide : str
        Name of the guide. It is the last of ``reads``; the first is the image that the pass averages.
    exponent : float
        Exponent of the similarity of the lobes.
    radius : int
        Taps from the centre to the edge of the kernel.
    step : int
        Pixels from tap to tap.
    sigma : float
        Standard deviation of the distance on the screen, pixels, and in the scene, pixel footprints, at radius 8.
    noise : float
        Number of variances by which a squared difference of the guide is divided. The first pass is guided by the
        samples themselves. Its number is so large that noise is no difference, but a lamp in a mirror, which is far
        brighter in both halves, stays where it is.
    is_pilot : bool
        Whether the pass compares single lobes instead of covariances: so narrow a kernel needs no more.
    reads_seen : bool
        Whether the pass compares the surfaces that reflections show.
    supports : tuple of str
        Images that it writes whose weight sums a later step reads.
    """

    exponent: float
    radius: int
    step: int = 1
    sigma: float
    noise: float
    is_pilot: bool = False
    reads_seen: bool = False
    supports: tuple[str, ...] = ()

    @property
    def source(self) -> str:
        """Name of the image that the pass averages."""
        return self.reads[0]

    @property
    def guide(self) -> str:
        """Name of the guide."""
        return self.reads[1]

    @property
    def reach(self) -> int:
        """Pixels to the last tap."""
        return self.radius * self.step

    @property
    def taps(self) -> int:
        """The whole square."""
        return (2 * self.radius + 1) ** 2

    def describe(self) -> str:
        """Return kernel, exponents and noise."""
        size = 2 * self.radius + 1
        apart = f", taps {self.step} pixels apart" if self.step > 1 else ""
        power = f"exponent of lobes {self.exponent:g}"
        return f"dual-buffer pass, {size}x{size} taps{apart}, {power}, {self.noise:g} variances"


@dataclass(frozen=True, kw_only=True)
class FinishStep(Step):
    """Multiply by the albedo, and composite over the pixel's area where coverage is known.

    Parameters
    ----------
    support : str
        Image whose weight sums and effective samples are those of the result.
    """

    support: str

    @property
    def reach(self) -> int:
        """Coverage tells about the neighbours."""
        return COVERAGE_REACH

    def describe(self) -> str:
        """Return what is done."""
        return "albedo and coverage"


@dataclass(frozen=True)
class LayerPlan:
    """The steps of one layer."""

    steps: tuple[Step, ...]

    @property
    def reach(self) -> int:
        """Pixels from a pixel of the result to the furthest sample that it depends on."""
        first = SAMPLES_REACH if any(isinstance(step, GuideStep) for step in self.steps) else 0
        reaches = {SAMPLES: first}
        for step in self.steps:
            reach = max(reaches[name] for name in step.reads) + step.reach
            reaches |= dict.fromkeys(step.writes, reach)
        return max(reaches.values())

    def list_unused(self, number: int) -> set[str]:
        """Return the images of a step that no later step reads, but for the result."""
        later = {name for step in self.steps[number + 1 :] for name in step.reads}
        step = self.steps[number]
        return {*step.reads, *step.writes} - later - {SAMPLES, *self.steps[-1].writes}

    def split_guides(self) -> tuple[LayerPlan, LayerPlan]:
        """Return a plan that makes all guides, and the passes for images that belong to the layer.

        A dense pass averages samples, so of the passes before the last dense one only the guides count. No guide is
        made of the last image, so the first plan ends with the last guide.
        """
        last_guide = max(number for number, step in enumerate(self.steps) if isinstance(step, GuideStep))
        passes = [step for step in self.steps if isinstance(step, PassStep)]
        first = max(number for number, step in enumerate(passes) if step.source == SAMPLES)
        linear = (replace(step, supports=step.writes) for step in passes[first:])
        return LayerPlan(self.steps[: last_guide + 1]), LayerPlan(tuple(linear))

    @property
    def guides(self) -> tuple[str, ...]:
        """Names of all guides."""
        return tuple(name for step in self.steps if isinstance(step, GuideStep) for name in step.writes)
