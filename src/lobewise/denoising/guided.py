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
from numpy.typing import NDArray

from lobewise.backend.buffers import Image, download
from lobewise.denoising.automatic import choose_quality, resolve_settings
from lobewise.denoising.layers import Layer, make_lobe_layers, make_position_features, make_specular_features
from lobewise.features import Feature, SeenFeature
from lobewise.filters.compositing import REACH as COVERAGE_REACH
from lobewise.filters.compositing import composite_light
from lobewise.filters.dual_buffer import DualBufferOutput, filter_dual_buffer
from lobewise.filters.dual_buffer_pass import Exponents
from lobewise.filters.fireflies import REACH as FIREFLY_REACH
from lobewise.filters.fireflies import BoundedHalves, bound_fireflies
from lobewise.filters.noise_guides import BLUR_RADIUS as GUIDE_REACH
from lobewise.filters.noise_guides import (
    LONE_FLOOR,
    VARIANCE_FLOOR,
    find_dark,
    find_level,
    make_noise_guide,
    measure_light,
)
from lobewise.filters.residuals import REACH as RESIDUAL_REACH
from lobewise.filters.residuals import find_squared_residual, split_by_noise, split_samples
from lobewise.frame import FloatArray, Frame
from lobewise.guides.halves import find_halves
from lobewise.lobes.band_limit import default_tau
from lobewise.settings import DenoiseSettings, ResolvedSettings


@dataclass(frozen=True)
class Pass:
    """One pass over both halves.

    Parameters
    ----------
    radius : int
        Taps from the centre to the edge of the kernel, at radius 8 of the settings.
    sigma : float
        Standard deviation of the distance on the screen, pixels, and in the scene, pixel footprints, at radius 8.
    noise : float
        Variances that a squared difference of the guide is divided by. The first pass is guided by the samples
        themselves, where every pixel has some in both halves: so weakly that noise is no difference, but that what is
        far brighter on both (a lamp in a mirror) stays where it is.
    lobes : float
        Exponent of the lobe similarity, over that of the settings.
    lobes_with_seen : float
        The same where the frame tells what reflections see, which then says more than the lobes do.
    step : int
        Pixels from tap to tap, at radius 8. Above 1 the pass averages what the one before gave, else the samples.
    """

    radius: int
    sigma: float
    noise: float
    lobes: float = 1.0
    lobes_with_seen: float = 1.0
    step: int = 1

    def get_kernel(self, radius: int, *, follows: bool) -> tuple[int, int]:
        """Return the radius in taps and the step in pixels at ``radius`` of the settings.

        ``follows`` tells whether a pass came before; one that is sparse averages what that gave.
        """
        scale = radius / 8.0
        if self.step == 1:
            return round(self.radius * scale), 1
        return min(self.radius, radius) if follows else round(self.radius * scale), max(round(self.step * scale), 1)


@dataclass(frozen=True)
class Plan:
    """The passes of a layer, each guided by the one before, and what "auto" is as exponent of its lobe similarity."""

    passes: tuple[Pass, ...]
    beta: float


DIFFUSE = Plan(
    (Pass(3, 6.0, 40.0, lobes=4.0), Pass(6, 30.0, 12.0), Pass(3, 30.0, 6.0, step=4)),
    beta=2.0,
)
SPECULAR = Plan(
    (
        Pass(4, 6.0, 40.0, lobes=4.0),
        Pass(5, 22.0, 6.0, lobes_with_seen=0.5),
        Pass(3, 30.0, 6.0, lobes=64.0, lobes_with_seen=64.0, step=4),
    ),
    beta=1.0,
)
"""Tuned on the scenes that ``benchmarks/quality/measure.py`` calls train (docs/quality.md). Diffuse light varies
slowly: a second, sparse pass over what the first gave reaches as far as a dense kernel of three times the cost. Of
reflections only the rough take part in it: the axes of sharp lobes are too far apart, 4 pixels on, for so high a
power."""

SEEN_RADIUS, SEEN_SIGMA = 1, 3.0
"""Kernel over which what reflections see is averaged: radius and sigma in pixels."""
SEEN_ALBEDO, SEEN_NORMAL = 8.0, 2.0
"""Sharpness with which its albedo and its normal are compared."""
WIDEST = 30.0
"""Screen sigma, pixels, that "auto" stands for at radius 8; those of the passes are in proportion."""
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
    return replace(resolve_settings(frame, told), quality=choose_quality(settings), with_oidn=settings.with_oidn)


@dataclass(frozen=True)
class BoundedLayer:
    """One radiance in two halves, fireflies bounded."""

    layer: Layer
    plan: Plan
    bounded: BoundedHalves
    is_whole: bool
    """Whether pixels have samples in both halves, and not in one of a checkerboard's colours."""
    noise_is_shared: bool
    """As of `lobewise.Frame`."""

    @property
    def name(self) -> str:
        """That of the layer."""
        return self.layer.name

    @property
    def halves(self) -> tuple[Image, Image]:
        """Both halves, (height, width, 3) each."""
        return self.bounded.a, self.bounded.b


@dataclass(frozen=True)
class NoisyLayer(BoundedLayer):
    """The same with what it is compared by."""

    pilot_features: tuple[Feature, ...]
    """What the pilot compares: a single lobe instead of a covariance, which tells as much to so narrow a pass."""
    seen: tuple[Feature, ...]
    level: float
    """Mean light of the whole image's samples, radiance over albedo, which says what is dark."""
    samples: tuple[Image, Image]
    """What a dense pass averages: the halves; or of an image without any itself, and the square of its residual."""


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


def make_bounded_layers(frame: Frame, settings: ResolvedSettings) -> list[BoundedLayer]:
    """Return the layers of a frame with both their halves."""
    halves = find_halves(frame)
    found = []
    for layer in make_lobe_layers(frame, settings, finest=True):
        bounded = bound_fireflies(halves.images[layer.name], layer.albedo, layer.mask, device=settings.device)
        plan = DIFFUSE if layer.is_diffuse else SPECULAR
        found.append(BoundedLayer(layer, plan, bounded, halves.origin == "file", frame.noise_is_shared))
    return found


def measure_layer(layer: BoundedLayer, settings: ResolvedSettings) -> NDArray[np.float64]:
    """Return what the rows of a layer add to its level; see `measure_light`."""
    return measure_light(layer.halves, layer.layer.albedo, layer.layer.mask, settings.device)


def make_noisy_layers(
    frame: Frame, settings: ResolvedSettings, extra: Sequence[Feature], levels: Sequence[float] | None = None
) -> list[NoisyLayer]:
    """Return the layers of a frame with what they are compared by; ``extra`` features count like the lobes.

    ``levels`` are those of the layers of the whole image, where the frame is a part of it.
    """
    found = []
    bounded = make_bounded_layers(frame, settings)
    for number, each in enumerate(bounded):
        pilot: Sequence[Feature] = each.layer.features
        is_specular = each.layer.is_reflected and each.name != "color"
        if each.layer.is_reflected and settings.similarity in ("ggx", "asg"):
            simple = replace(settings, similarity="sg")
            pilot, _ = make_specular_features(frame, simple, each.layer.mask, each.name != "color")
        found.append(
            NoisyLayer(
                replace(each.layer, features=(*each.layer.features, *extra)),
                each.plan,
                each.bounded,
                each.is_whole,
                each.noise_is_shared,
                (*pilot, *extra),
                find_seen(frame, each.layer.mask, settings) if is_specular else (),
                levels[number] if levels is not None else find_level(measure_layer(each, settings)),
                each.halves if each.is_whole else _find_samples(each),
            )
        )
    return found


def _find_samples(each: BoundedLayer) -> tuple[Image, Image]:
    """Return a layer without halves, put together from the colours of its checkerboard, and its squared residual."""
    even, odd = map(download, each.halves)
    image = np.where(np.isnan(even), odd, even)
    return image, find_squared_residual(image, each.layer.albedo, each.layer.mask, shared=each.noise_is_shared)


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


def find_seen(frame: Frame, mask: NDArray[np.bool_], settings: ResolvedSettings) -> tuple[Feature, ...]:
    """Return the feature of what lobes see; nothing where the frame does not tell.

    What few samples hit is noise like radiance, so it is first averaged over near pixels.
    """
    albedo, normal = frame.gbuffer.hit_albedo, frame.gbuffer.hit_normal
    if albedo is None or normal is None:
        return ()
    # A pass takes what is not negative: normals are moved there and back.
    images = albedo, np.float32(0.5) + np.float32(0.5) * normal
    place = make_pass_features(frame, settings, SEEN_SIGMA)
    near = [Exponents(1.0, 1.0)]
    (mean,) = filter_dual_buffer(images, mask, place, (), near, radius=SEEN_RADIUS, device=settings.device)
    normal = np.float32(2.0) * download(mean.b) - np.float32(1.0)
    sharpness = {"albedo_sharpness": SEEN_ALBEDO, "normal_sharpness": SEEN_NORMAL}
    return (SeenFeature(mean.a, normal, **sharpness),)


def make_pass_features(frame: Frame, settings: ResolvedSettings, sigma: float) -> list[Feature]:
    """Return the features of place of a pass whose standard deviation, pixels and footprints, is that at radius 8."""
    screen = max(sigma * settings.screen_sigma / WIDEST, 0.5)
    position = screen * settings.position_sigma / DenoiseSettings.position_sigma
    return make_position_features(frame, replace(settings, screen_sigma=screen, position_sigma=position))


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
    reach = FIREFLY_REACH + RESIDUAL_REACH
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
    return CleanLayer(image, weight_sum, effective_samples)
