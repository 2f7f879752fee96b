"""The executor of frame plans: what each stage does with the layers of a frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import device_scope
from lobewise.denoising.also import Passed, filter_also
from lobewise.denoising.bad_pixels import blacken_bad, fill_holes, find_bad_pixels, find_good
from lobewise.denoising.combining import choose_between, denoise_with_peer, share_out
from lobewise.denoising.evidence import find_image_halves, find_share_lost, mix_noisy
from lobewise.denoising.layers import Layer, Support, find_support
from lobewise.denoising.light_loss import find_gain, find_share_missing, find_takers, share_light, sum_missing
from lobewise.denoising.noisy import join_halves, make_noisy_layers
from lobewise.denoising.plain import filter_by_guides
from lobewise.denoising.planning.frame_plans import (
    FILL_HOLES,
    FILTER_ALSO,
    FILTER_LAYERS,
    KEEP_LIGHT,
    MIX_PEER,
    MIX_UNGUIDED,
    REFINE,
    TAKE_BACK_NOISY,
    FramePlan,
    Stage,
    describe_frame,
    plan_frame,
)
from lobewise.denoising.refining.inputs import sum_light as sum_parts
from lobewise.denoising.refining.lamps import find_edges, find_refined, find_shining, find_small
from lobewise.denoising.refining.network import find_factor
from lobewise.denoising.refining.totals import compose, find_averaged_rest, find_rest
from lobewise.denoising.refining.unguided import MIN_SHARE, find_share_filtered, find_unguided_share, forget_guides
from lobewise.denoising.refining.whole_image import WholeImage, measure_whole
from lobewise.denoising.running import run_guided
from lobewise.features import Feature
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.fireflies import cut_samples
from lobewise.filters.specks import Sharing, find_sharing
from lobewise.frame import FloatArray, Frame, GBuffer
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality


@dataclass(frozen=True, kw_only=True)
class Filtered:
    """The filtered layers of a frame.

    Parameters
    ----------
    layers, parts, supports : sequences
        The layers, their filtered radiance, and how much each filter gathered; one support where it was joined.
    image : (height, width, 3)
        Sum of all parts and of the light that is in none of them; see `compose`.
    holes : (height, width), bool, optional
        Pixels without a value, where they are known.
    tallies : sequence of arrays
        Light that was taken from the fireflies of every layer, row by row; empty with the quality "fast".
    rest : (height, width, 3), optional
        Light that is in no part, emission and background; None where light is not told apart.
    noisy_rest : (height, width, 3), optional
        The same before the network refined it.
    sharing : Sharing, optional
        How pixels shared this light with their neighbours; None where no lens blurs it.
    noisy : sequence of (height, width, 3)
        Samples of every layer without fireflies, radiance; empty with the quality "fast", which bounds none.
    levels : sequence of float
        Mean light of the samples of every layer, over the albedo; empty with the quality "fast".
    is_refined : bool
        Whether the network refined the image.
    uncounted : (height, width), bool, optional
        Pixels that do not tell how much light the layers lost: there the network moved light between them and the rest.
    taken_from : Filtered, optional
        The layers before the noisy image was taken back.
    share_taken : (height, width), optional
        The share of the noisy image that was taken back.
    """

    layers: Sequence[Layer]
    parts: Sequence[FloatArray]
    supports: Sequence[Support]
    image: FloatArray
    tallies: Sequence[NDArray[np.float64]] = ()
    rest: FloatArray | None = None
    noisy_rest: FloatArray | None = None
    sharing: Sharing | None = None
    noisy: Sequence[FloatArray] = ()
    levels: Sequence[float] = ()
    is_refined: bool = False
    uncounted: NDArray[np.bool_] | None = None
    taken_from: Filtered | None = None
    share_taken: FloatArray | None = None
    holes: NDArray[np.bool_] | None = None

    def find_support(self) -> tuple[FloatArray, FloatArray]:
        """Return weight sum and effective samples of the least supported layer that reflects anything at a pixel."""
        if len(self.supports) == 1:
            return self.supports[0].weight_sum, self.supports[0].effective_samples
        return find_support(self.layers, self.supports)

    def find_takers(self) -> list[FloatArray]:
        """Return the share of each pixel's light that takes part in sharing, for every layer; see `find_takers`."""
        layers = zip(self.layers, self.parts, self.levels, strict=False)
        return [find_takers(*each) for each in layers]

    def sum_missing(self, takers: Sequence[FloatArray], rows: slice = slice(None)) -> list[NDArray[np.float64]]:
        """Return the sums of `lobewise.denoising.light_loss.sum_missing` for every layer in some rows."""
        layers = zip((layer.radiance for layer in self.layers), self.parts, takers, strict=False)
        return [sum_missing(*each, rows, uncounted=self.uncounted) for each in layers]

    def find_gains(self) -> tuple[FloatArray, ...]:
        """Return the factors, (height, width, 1 or 3), by which the light outside of the layers was multiplied."""
        if self.rest is None or self.noisy_rest is None or self.rest is self.noisy_rest:
            return ()
        lit = self.noisy_rest > 0.0
        return (np.divide(self.rest, self.noisy_rest, out=np.ones_like(self.rest), where=lit),)

    def find_holes(self, bad: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return where the image has no value, (height, width): not finite, or bad and reached by no layer."""
        if self.holes is not None:
            return self.holes
        holes: NDArray[np.bool_] = ~find_good(self.image)
        if bad.any():
            holes |= bad & np.logical_and.reduce([support.weight_sum <= 0.0 for support in self.supports])
        return holes


@dataclass(frozen=True, kw_only=True)
class FrameRun:
    """A frame on its way through the stages of its plan.

    Parameters
    ----------
    frame, settings, features, plan
        What is run.
    bad : (height, width), bool
        Pixels that are NaN, infinite or negative.
    whole : WholeImage, optional
        What was measured of the whole image, where the frame is a part of it.
    seen : GBuffer, optional
        The guides of the frame before any stood in for missing ones; by default all are the frame's own.
    found : Filtered, optional
        The layers, once they are filtered.
    image : (height, width, 3), optional
        The result so far.
    energy_lost : float
        Share of the light that is missing.
    gains : tuple of arrays
        Factors of the light that no surface scatters.
    unscattered : dict of str to (height, width, 3)
        Emission and background where the lens blurs them, shared out; empty where nothing is blurred.
    also : dict of str to (height, width, 3)
        The filtered light passes.
    """

    frame: Frame
    settings: ResolvedSettings
    features: Sequence[Feature]
    plan: FramePlan
    bad: NDArray[np.bool_]
    whole: WholeImage | None = None
    seen: GBuffer | None = None
    found: Filtered | None = None
    image: FloatArray | None = None
    energy_lost: float = 0.0
    gains: tuple[FloatArray, ...] = ()
    unscattered: Mapping[str, FloatArray] = field(default_factory=dict)
    also: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def filtered(self) -> Filtered:
        """The layers, which the first stage filters."""
        assert self.found is not None, "the first stage filters the layers"
        return self.found

    @property
    def total(self) -> FloatArray:
        """The result so far."""
        return self.filtered.image if self.image is None else self.image

    def run(self, stages: Sequence[Stage]) -> FrameRun:
        """Return the frame after some stages."""
        state = self
        for stage in stages:
            state = RUNNERS[stage](state)
        return state


def start_run(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature] = (),
    whole: WholeImage | None = None,
    seen: GBuffer | None = None,
) -> FrameRun:
    """Return a frame before its first stage."""
    plan, bad = plan_frame(describe_frame(frame), settings), find_bad_pixels(frame)
    return FrameRun(frame=frame, settings=settings, features=features, plan=plan, bad=bad, whole=whole, seen=seen)


def filter_frame(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature] = (), whole: WholeImage | None = None
) -> Filtered:
    """Return the layers of a frame, or of a band of it, after the stages that bands run one by one."""
    state = start_run(frame, settings, features, whole)
    with engine.on(settings.device):
        return state.run(state.plan.local_stages).filtered


def filter_layers(state: FrameRun) -> FrameRun:
    """Filter every layer by its plan."""
    if not get_quality(state.settings.quality).reads_halves:
        return replace(state, found=filter_plain(state))
    found = filter_halves(state)
    if found.sharing is None:
        return replace(state, found=found)
    unscattered = state.frame.unscattered.items()
    shared = {name: found.sharing.apply(blacken_bad(light)) for name, light in unscattered}
    return replace(state, found=found, unscattered=shared)


@device_scope()
def filter_plain(state: FrameRun) -> Filtered:
    """Return the layers after one pass by their guides alone."""
    frame, settings = state.frame, state.settings
    found = filter_by_guides(frame, settings, state.features, state.bad)
    support = FilterOutput(found.image, found.weight_sum, found.effective_samples)
    return Filtered(layers=found.layers, parts=found.parts, supports=[support], image=found.image, holes=found.holes)


@device_scope()
def filter_halves(state: FrameRun) -> Filtered:
    """Return the layers after both halves of their samples were filtered by their plans."""
    frame, settings = state.frame, state.settings
    noisy = make_noisy_layers(frame, settings, state.features, None if state.whole is None else state.whole.levels)
    clean = [run_guided(frame, each, settings, state.plan.layers[each.name]) for each in noisy]
    parts = [each.image for each in clean]
    rest, blur, sharing = find_averaged_rest(frame), frame.gbuffer.blur_radius, None
    if rest is not None and blur is not None:
        sharing = find_sharing(rest, blur, frame.spp)
        rest = sharing.apply(rest)
    return Filtered(
        layers=[each.layer for each in noisy],
        parts=parts,
        supports=clean,
        image=compose(parts, rest),
        tallies=[each.bounded.tally for each in noisy],
        rest=rest,
        noisy_rest=rest,
        sharing=sharing,
        noisy=[join_halves(each) for each in noisy],
        levels=[each.level for each in noisy],
    )


def refine(state: FrameRun) -> FrameRun:
    """Refine the image by the network, and scale the layers and the other light so that they still sum to it."""
    found, frame = state.filtered, state.frame
    whole = measure_whole(frame, found.levels) if state.whole is None else state.whole
    surface, rest = np.logical_or.reduce([layer.mask for layer in found.layers]), found.rest
    seen = edges = None
    others: list[FloatArray] = []
    if rest is not None:
        shining = find_shining(rest, found.parts)
        surface, seen, edges = surface & ~shining, ~find_small(shining)[..., None], find_edges(shining)
        others = [np.where(seen, rest, np.float32(0.0))]
    factor = find_factor(frame, [*found.noisy, *others], [*found.parts, *others], whole)
    factor[~find_refined(surface)] = 1.0
    with np.errstate(invalid="ignore", over="ignore"):  # bad pixels of a part stay bad
        parts = [part * factor for part in found.parts]
    if rest is not None and seen is not None:
        rest = np.where(seen, rest * factor, rest)
    image = compose(parts, rest)
    return replace(state, found=replace(found, parts=parts, rest=rest, image=image, is_refined=True, uncounted=edges))


def take_back(state: FrameRun) -> FrameRun:
    """Take the noisy image back where it has less error than the filtered one."""
    found = state.filtered
    level, refined = max(found.levels), found.is_refined
    noisy, parts = found.noisy, found.parts
    if found.rest is not None and found.noisy_rest is not None:
        noisy, parts = [*noisy, found.noisy_rest], [*parts, found.rest]
    halves, shared = find_image_halves(state.frame), state.frame.noise_is_shared
    samples = bound_samples(state)
    share = find_share_lost(samples, found.image, level, halves=halves, shared=shared, refined=refined)
    mixed = [mix_noisy(*each, share) for each in zip(parts, noisy, strict=True)]
    rest = mixed.pop() if len(mixed) > len(found.parts) else None
    image = compose(mixed, rest)
    after = replace(found, parts=mixed, rest=rest, image=image, taken_from=found, share_taken=share)
    return replace(state, found=after)


def bound_samples(state: FrameRun) -> FloatArray:
    """Return the samples of a frame without those that are too bright for any network; see `cut_samples`."""
    bounded = compose(state.filtered.noisy, find_rest(state.frame))
    return cut_samples(state.frame.radiance.color, bounded)


def keep_light(state: FrameRun) -> FrameRun:
    """Share the light that bounding took out over each layer, so that the layer sums to the light of its samples."""
    found = state.filtered
    takers = found.find_takers()
    rows = found.sum_missing(takers)
    gains = [find_gain(each, refined=found.is_refined) for each in rows]
    lost = find_share_missing(rows, gains)
    if not any(map(any, gains)):
        return replace(state, energy_lost=lost)
    image, parts = share_light(found.image, found.parts, takers, gains)
    return replace(state, found=replace(found, image=image, parts=parts), energy_lost=lost)


def fill(state: FrameRun) -> FrameRun:
    """Fill the pixels without a value."""
    found = state.filtered
    image = fill_holes(found.image, found.find_holes(state.bad), state.frame)
    return replace(state, image=image, gains=found.find_gains())


def mix_unguided(state: FrameRun) -> FrameRun:
    """Mix in the image of the color alone where guides are noise, and scale the parts so that they sum to the image."""
    if state.features:  # only the user's own features tell what they compare
        return state
    share, found = find_unguided_share(state.frame.radiance.color, state.seen or state.frame.gbuffer), state.filtered
    if found.rest is not None:
        share *= find_share_filtered(found.rest, state.total, state.frame.gbuffer.blur_radius)
    if float(share.max()) < MIN_SHARE:
        return state
    settings = replace(state.settings, similarity="normal", hit_distance=False)
    alone = start_run(forget_guides(state.frame), settings)
    alone = alone.run([stage for stage in alone.plan.stages if stage not in (MIX_UNGUIDED, MIX_PEER)])
    mixed = mix_noisy(state.total, alone.total, share)
    image, parts, gain = share_out(mixed, state.total, found.parts)
    return replace(state, found=replace(found, parts=parts), image=image, gains=(*state.gains, gain))


def mix_peer(state: FrameRun) -> FrameRun:
    """Mix in the image of Open Image Denoise and the noisy one, and scale the parts so that they sum to the image."""
    frame, found, image = state.frame, state.filtered, state.total
    samples = bound_samples(state)
    peer = denoise_with_peer(frame, samples, image, state.seen)
    noisy = compose(found.noisy, found.noisy_rest)
    mixed, share = choose_between(frame, samples, image, peer, noisy)
    if found.share_taken is None:  # detail of one part is not spread over all
        parts = [mix_noisy(*each, share) for each in zip(found.parts, found.noisy, strict=True)]
        image = mix_noisy(image, noisy, share)
        found = replace(found, parts=parts, taken_from=found, share_taken=share)
    image, parts, gain = share_out(mixed, image, found.parts)
    return replace(state, found=replace(found, parts=parts), image=image, gains=(*state.gains, gain))


def filter_passes(state: FrameRun) -> FrameRun:
    """Filter the images that belong to a layer or to the total."""
    found, clean = state.filtered, name_layers(state)
    before, share = found.taken_from, found.share_taken
    refined = before if before is not None and before.is_refined else None
    parts = (
        {} if refined is None else {layer.name: part for layer, part in zip(refined.layers, refined.parts, strict=True)}
    )
    layers = {name: Passed(clean=image, before=parts.get(name), share=share) for name, image in clean.items()}
    # What is not in the layers had no filter. Where there is none, all of a filled hole counts as scattered.
    rest = find_rest(state.frame)
    rest = np.zeros_like(state.total) if rest is None else rest
    scattered = sum_parts(found.parts)
    rest_after = np.where(rest > 0.0, np.maximum(state.total - scattered, np.float32(0.0)), np.float32(0.0))
    whole = Passed(
        clean=state.total - rest_after, before=None if refined is None else sum_parts(refined.parts), share=share
    )
    also = filter_also(state.frame, state.settings, state.features, layers, whole, (rest, rest_after))
    return replace(state, also=also)


def name_layers(state: FrameRun) -> dict[str, FloatArray]:
    """Return the filtered layers that the frame names itself, finite."""
    if not state.frame.layers:
        return {}
    found = state.filtered
    return {layer.name: blacken_bad(part) for layer, part in zip(found.layers, found.parts, strict=True)}


RUNNERS: Mapping[Stage, Callable[[FrameRun], FrameRun]] = {
    FILTER_LAYERS: filter_layers,
    REFINE: refine,
    TAKE_BACK_NOISY: take_back,
    KEEP_LIGHT: keep_light,
    FILL_HOLES: fill,
    MIX_UNGUIDED: mix_unguided,
    MIX_PEER: mix_peer,
    FILTER_ALSO: filter_passes,
}
"""What runs each stage."""
