"""Variance-aware filtering: how noisy an image is, is seen in two halves of its samples.

A lobe says which pixels reflect alike, not how fast what they reflect changes. That is seen in the image itself, once
it has been filtered a little: a narrow pass over both halves gives a pilot and, by how far the halves are apart, its
noise; the wide pass that follows averages what is alike in lobes *and* no further apart in the pilot than its noise.
Sources: Rousselle, Knaus and Zwicker 2012 (dual buffers); Schied et al. 2017, "Spatiotemporal Variance-Guided
Filtering" (colour weights that follow the filtered variance); Tokuyoshi 2015 (the lobe weights).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lobewise.backend.buffers import Image, download
from lobewise.denoising.automatic import choose_quality, resolve_settings
from lobewise.denoising.noisy import WIDEST, NoisyLayer, make_pass_features
from lobewise.denoising.plans import DIFFUSE, SPECULAR, Plan
from lobewise.filters.compositing import REACH as COVERAGE_REACH
from lobewise.filters.compositing import composite_light
from lobewise.filters.dual_buffer import DualBufferOutput, filter_dual_buffer
from lobewise.filters.dual_buffer_pass import Exponents
from lobewise.filters.fireflies import REACH as FIREFLY_REACH
from lobewise.filters.highlights import REACH as HIGHLIGHT_REACH
from lobewise.filters.noise.residuals import REACH as RESIDUAL_REACH
from lobewise.filters.noise.residuals import split_by_noise, split_samples
from lobewise.filters.noise_guides import BLUR_RADIUS as GUIDE_REACH
from lobewise.filters.noise_guides import (
    LONE_FLOOR,
    VARIANCE_FLOOR,
    find_dark,
    make_noise_guide,
)
from lobewise.frame import FloatArray, Frame
from lobewise.guides.lobe_fields import SPREAD_REACH
from lobewise.lobes.band_limit import default_tau
from lobewise.settings import DenoiseSettings, ResolvedSettings

TAU = 0.01
"""Band-limit of the lobes, radians, where settings say "auto": the guides see the noise, so lobes need not be widened
for it."""


def resolve_guided(frame: Frame, settings: DenoiseSettings) -> ResolvedSettings:
    """Return ``settings`` with what "auto" stands for where the noise is known."""
    pixel_tau = default_tau(frame.camera, frame.height) if frame.camera is not None else 0.0
    widest = WIDEST * max(settings.radius, 1) / 8.0
    told = replace(
        settings,
        beta=SPECULAR.beta if settings.beta == "auto" else settings.beta,
        diffuse_beta=DIFFUSE.beta if settings.diffuse_beta == "auto" else settings.diffuse_beta,
        tau=max(TAU, pixel_tau) if settings.tau == "auto" else settings.tau,
        screen_sigma=widest if settings.screen_sigma == "auto" else settings.screen_sigma,
    )
    return replace(resolve_settings(frame, told), quality=choose_quality(settings), with_oidn=settings.asks_for_oidn)


@dataclass(frozen=True)
class CleanLayer:
    """What became of a layer.

    Parameters
    ----------
    image : (height, width, 3)
        Filtered radiance, albedo included; the noisy one where nothing was gathered.
    weight_sum, effective_samples : (height, width)
        See `lobewise.filters.dual_buffer.DualBufferOutput`.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray


def filter_samples(noisy: NoisyLayer, *groups: Any, joined: bool = False, **options: Any) -> list[DualBufferOutput]:
    """Run a dense pass over the samples of a layer: `filter_dual_buffer`, whose other parameters these are.

    Of an image without halves, the two that come out are as far apart as its noise says.
    """
    if noisy.is_whole:
        return filter_dual_buffer(noisy.samples, noisy.layer.mask, *groups, joined=joined, **options)
    found = filter_dual_buffer(noisy.samples, noisy.layer.mask, *groups, **options)
    return [_split(each, noisy.level, joined=joined) for each in found]


def _split(found: DualBufferOutput, level: float, *, joined: bool) -> DualBufferOutput:
    """Return what a pass made of an image and its squared residual as two halves of it."""
    mean = download(found.a)
    # Of two halves by the same weights the mean is worth twice as much as each, which this is not.
    worth = np.float32(0.5) * download(found.effective_samples)
    halves = (mean, mean) if joined else split_by_noise(mean, download(found.b), worth, find_dark(level))
    return DualBufferOutput(halves[0], halves[1], found.weight_sum, worth)


def make_pass_guide(noisy: NoisyLayer, before: DualBufferOutput | None, device: str) -> Image:
    """Return the guide of a pass: what the one ``before`` gave, or else the samples."""
    if before is not None:
        halves = before.a, before.b
    elif noisy.is_whole:
        itself = [Exponents(0.0, 0.0)]
        (found,) = filter_samples(noisy, (), (), itself, radius=0, albedo=noisy.layer.albedo, device=device)
        halves = found.a, found.b
    else:
        image, layer = download(noisy.samples[0]), noisy.layer
        halves = split_samples(image, layer.albedo, layer.mask, find_dark(noisy.level), shared=noisy.noise_is_shared)
    return compare_halves(noisy, *halves, device)


def compare_halves(noisy: NoisyLayer, a: Image, b: Image, device: str) -> Image:
    """Return the guide of a pass from two images that are as far apart as their noise says."""
    floor = VARIANCE_FLOOR if noisy.is_whole else LONE_FLOOR
    return make_noise_guide(a, b, noisy.level, device, floor=floor)


def run_pass(
    frame: Frame,
    noisy: NoisyLayer,
    number: int,
    before: DualBufferOutput | None,
    settings: ResolvedSettings,
    guide: Image | None = None,
    *,
    joined: bool = True,
) -> DualBufferOutput:
    """Run one pass of a layer's plan.

    ``before`` is what the one before it gave, which a sparse pass averages; ``guide`` is by default made of it. Unless
    ``joined``, the last pass gives both halves as well: all others do.
    """
    chosen = noisy.plan.passes[number]
    follows = number > 0
    radius, step = chosen.get_kernel(settings.radius, follows=follows)
    seen = noisy.seen if follows else ()
    groups = (
        make_pass_features(frame, settings, chosen.sigma),
        noisy.layer.features if follows else noisy.pilot_features,
        [Exponents(1.0, chosen.lobes_with_seen if seen else chosen.lobes, 1.0)],
    )
    options: dict[str, Any] = {
        "radius": radius,
        "seen": seen,
        "step": step,
        "guide": make_pass_guide(noisy, before, settings.device) if guide is None else guide,
        "noise": chosen.noise,
        # Nothing follows that asks for the noise that is left.
        "joined": joined and number == len(noisy.plan.passes) - 1,
        "device": settings.device,
    }
    if before is not None and chosen.step > 1:
        (found,) = filter_dual_buffer((before.a, before.b), noisy.layer.mask, *groups, **options)
    else:
        (found,) = filter_samples(noisy, *groups, albedo=noisy.layer.albedo, **options)
    return found


def find_balanced_reach(settings: ResolvedSettings) -> int:
    """Return from how many pixels away `filter_balanced` and `finish_layer` can be told anything."""
    return max(_find_plan_reach(plan, settings.radius) for plan in (DIFFUSE, SPECULAR)) + COVERAGE_REACH


def _find_plan_reach(plan: Plan, radius: int) -> int:
    reach = FIREFLY_REACH + HIGHLIGHT_REACH + RESIDUAL_REACH + SPREAD_REACH
    for number, chosen in enumerate(plan.passes):
        taps, step = chosen.get_kernel(radius, follows=number > 0)
        # A tap reads what the pass before gave, through the blurred variance of its guide. What reflections see comes
        # from nearer by.
        reach += taps * step + GUIDE_REACH
    return reach


def filter_balanced(frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings) -> CleanLayer:
    """Filter a layer by its plan."""
    found = support = run_pass(frame, noisy, 0, None, settings)
    for number, chosen in enumerate(noisy.plan.passes[1:], 1):
        found = run_pass(frame, noisy, number, found, settings)
        # Sparse passes average averages: what they gather is no count of samples.
        if chosen.step == 1:
            support = found
    return finish_layer(frame, noisy, (found.a,), support)


def finish_layer(frame: Frame, noisy: NoisyLayer, light: Sequence[Image], support: DualBufferOutput) -> CleanLayer:
    """Return the radiance of a layer from the light at pixel centres, over the pixels' area where it is known.

    ``light`` is one image or two halves.
    """
    guides, albedo = frame.gbuffer, noisy.layer.albedo
    means = {"diffuse": guides.mean_diffuse_albedo, "specular": guides.mean_specular_albedo}
    # A layer of its own knows no other albedo than that over the pixel's area.
    mean, coverage = means.get(noisy.name, albedo if frame.layers else None), guides.coverage
    if coverage is None or mean is None or albedo is None:
        mean, coverage = albedo, None
    weight_sum, effective_samples = download(support.weight_sum), download(support.effective_samples)
    lit = noisy.layer.mask & (weight_sum > 0.0)
    image = composite_light(list(map(download, light)), lit, noisy.layer.radiance, mean, coverage)
    if noisy.kept is not None:
        image = np.add(image, noisy.kept, out=image, where=lit[..., None])
    return CleanLayer(image, weight_sum, effective_samples)
