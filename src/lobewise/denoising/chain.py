"""What happens to a frame, from top to bottom: filter its layers, refine, take back, keep light, fill, mix, pass on.

`filter_rows` holds the steps that need only the surroundings of a pixel, so that bands of rows run them one by one.
`filter_whole` adds those that need the whole image. `clean_frame` adds what other programs and further runs give.
Exported pipelines are made of `filter_whole` (`lobewise.exporting.pipeline`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import device_scope, download
from lobewise.denoising.also import (
    Passed,
    bound_parts,
    filter_also,
    filter_plain_layer,
    finish_layer_parts,
    has_passes,
    list_layer_parts,
)
from lobewise.denoising.bad_pixels import blacken_bad, fill_holes, mark_bad_pixels
from lobewise.denoising.combining import (
    CHOOSE,
    NEAR_RADIUS,
    LayerImage,
    choose_between,
    denoise_with_peer,
    list_peer_costs,
    mix_layers,
    share_out,
)
from lobewise.denoising.evidence import estimate_share_lost, get_image_halves, mix_noisy, takes_back
from lobewise.denoising.layers import Layer, make_layers
from lobewise.denoising.light_loss import (
    Loss,
    measure_gain,
    measure_gain_outside,
    share_light,
    sum_missing,
)
from lobewise.denoising.noisy import join_halves, make_noisy_layers
from lobewise.denoising.passes import FilteredOther, filter_layer_halves
from lobewise.denoising.plain import add_up
from lobewise.denoising.refining.inputs import sum_parts
from lobewise.denoising.refining.totals import compose, compute_averaged_rest, compute_rest
from lobewise.denoising.refining.unguided import (
    MIN_SHARE,
    compute_salt_share,
    compute_unguided_share,
    forget_guides,
    limit_to_noise,
)
from lobewise.denoising.refining.whole_image import WholeImage, measure_whole
from lobewise.engine.numbers import choose_larger
from lobewise.engine.rows import compute_rows
from lobewise.features import Feature
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.fireflies import count_light, cut_samples
from lobewise.filters.forms import describe_form
from lobewise.filters.glue import define_checked, define_support
from lobewise.filters.specks import Sharing, choose_sharing
from lobewise.guides.squares import compute_square_maximum
from lobewise.guides.surfaces import mark_surface_pixels
from lobewise.records.frame import FloatArray, Frame, GBuffer
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality
from lobewise.work.progress import enter_stage, plan_stages, raise_cost
from lobewise.work.progress.stages import (
    FILL,
    FILTER_HALVES,
    FILTER_ONCE,
    FILTER_OTHERS,
    MIX_PEER,
    MIX_UNGUIDED,
    REFINE,
    SECONDS_PER_MEGAPIXEL,
    SHARE_OUT,
    TAKE_BACK,
)


@dataclass(frozen=True, kw_only=True)
class Filtered:
    """The filtered layers of a frame.

    Parameters
    ----------
    layers : sequence of Layer
    parts : sequence of (height, width, 3)
        The filtered radiance of every layer.
    supports : sequence of (height, width, 2)
        Weight sum and effective samples of each layer's filter; one image where they were joined.
    image : (height, width, 3)
        Sum of all parts and of the light that is in none of them; see `compose`.
    bad : (height, width), bool
        Pixels whose radiance is NaN, infinite or negative.
    holes : (height, width), bool, optional
        Pixels without a value, where they are known.
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
    sums : sequence
        Light of every layer's rows before its fireflies were bounded, and light taken away; see `BoundedHalves`.
    others : mapping of str to sequence of FilteredOther
        Images that belong to a layer, filtered in its passes, by the layer's name.
    is_refined : bool
        Whether the network refined the image.
    uncounted : (height, width), bool, optional
        Pixels that do not tell how much light the layers lost: copies of others, beyond the seam of a panorama.
    taken_from : Filtered, optional
        The layers before the noisy image was taken back.
    share_taken : (height, width), optional
        The share of the noisy image that was taken back.
    losses : sequence of Loss
        The light of every layer, and how much of it was shared out; empty before.
    """

    layers: Sequence[Layer]
    parts: Sequence[FloatArray]
    supports: Sequence[FloatArray]
    image: FloatArray
    bad: NDArray[np.bool_]
    holes: NDArray[np.bool_] | None = None
    rest: FloatArray | None = None
    noisy_rest: FloatArray | None = None
    sharing: Sharing | None = None
    noisy: Sequence[FloatArray] = ()
    levels: Sequence[float] = ()
    sums: Sequence[tuple[FloatArray, ...]] = ()
    others: Mapping[str, Sequence[FilteredOther]] = field(default_factory=dict)
    is_refined: bool = False
    uncounted: NDArray[np.bool_] | None = None
    taken_from: Filtered | None = None
    share_taken: FloatArray | None = None
    losses: Sequence[Loss] = ()

    @property
    def tallies(self) -> list[NDArray[np.float64]]:
        """Light that was taken from the fireflies of every layer, row by row; empty with the quality "fast"."""
        return [count_light(each) for each in self.sums]

    def compute_support(self) -> tuple[FloatArray, FloatArray]:
        """Return weight sum and effective samples of the least supported layer that reflects anything at a pixel."""
        if len(self.supports) == 1:
            return self.supports[0][..., 0], self.supports[0][..., 1]
        images: dict[str, Any] = {}
        for number, (layer, support) in enumerate(zip(self.layers, self.supports, strict=True)):
            images |= {
                f"support{number}": support,
                f"mask{number}": layer.mask,
                f"albedo{number}": layer.albedo,
            }
        weight_sum, effective = engine.pixels(define_support, images, {}, len(self.layers))
        return weight_sum, effective

    def look_up_passed(self, name: str) -> Passed:
        """Return what happened to a layer, for further images that take the same steps."""
        number = [layer.name for layer in self.layers].index(name)
        before = self.taken_from
        refined = before.parts[number] if before is not None and before.is_refined else None
        return Passed(clean=blacken_bad(self.parts[number]), before=refined, share=self.share_taken)

    @property
    def shared_masks(self) -> list[NDArray[np.bool_]]:
        """The masks of the layers whose lost light is shared out: of all; with the quality "fast" of none."""
        return [layer.mask for layer in self.layers] if self.levels else []

    def sum_missing(self, rows: slice) -> list[NDArray[np.float64]]:
        """Return the sums of `lobewise.denoising.light_loss.sum_missing` for every layer in some rows."""
        layers = zip((layer.radiance for layer in self.layers), self.parts, self.shared_masks, strict=False)
        return [sum_missing(*each, rows, uncounted=self.uncounted) for each in layers]

    def mark_holes(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the image and its holes: pixels whose light is not finite, and bad ones that no layer reached."""
        if self.holes is not None:
            return self.image, self.holes
        images: dict[str, Any] = {f"support{number}": each for number, each in enumerate(self.supports)}
        into = [engine.take("image", "height", "width", 3, text="the denoised frame", unit="any")]
        images, text = {**images, "image": self.image, "bad": self.bad}, "the result, and its holes"
        image, holes = engine.pixels(define_checked, images, {}, names=["", "holes"], into=into, text=text)
        return image, holes


def filter_rows(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    bad: NDArray[np.bool_],
    *,
    whole: WholeImage | None = None,
    exact: FloatArray | None = None,
) -> Filtered:
    """Return the layers of a frame, or of a band of it, after the steps that need only the surroundings of a pixel.

    Parameters
    ----------
    frame, settings
    features : sequence of Feature
        More features of every layer.
    bad : (height, width), bool
        Result of `mark_bad_pixels`.
    whole : WholeImage, optional
        What was measured of the whole image, where the frame is a part of it.
    exact : (height, width, 3), optional
        The light in no layer, without noise; by default what the layers leave of all light.
    """
    quality = get_quality(settings.quality)
    if not quality.reads_halves:
        return filter_plain(frame, settings, features, bad, exact)
    filtered = filter_halves(frame, settings, features, bad, whole, exact)
    # A radius of 0 asks for no filter.
    if quality.refines and settings.radius > 0:
        filtered = refine(frame, filtered, whole)
    if takes_back(frame, settings):
        filtered = take_back(frame, filtered)
    return filtered


def filter_whole(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    bad: NDArray[np.bool_],
    *,
    exact: FloatArray | None = None,
    outside: NDArray[np.bool_] | None = None,
) -> tuple[Filtered, Filtered]:
    """Return the filtered layers of a whole frame; first as `filter_rows` has left them. Parameters as there.

    ``outside``, (height, width), marks the columns that `Frame.surround` has added.
    """
    before = filtered = filter_rows(frame, settings, features, bad, exact=exact)
    if filtered.levels and outside is not None:
        filtered = replace(filtered, uncounted=outside)
    if filtered.levels:
        filtered = keep_light(filtered)
    enter_stage(FILL)
    with engine.part("fill holes"):
        filtered = replace(filtered, image=fill_holes(*filtered.mark_holes(), frame))
    return before, filtered


@dataclass(frozen=True, kw_only=True)
class Clean:
    """A frame after everything that happens to it.

    Parameters
    ----------
    before, filtered : Filtered
        The layers before light was shared out, and at the end.
    gains : sequence of arrays
        Factors of the light that no surface scatters.
    also : dict of str to (height, width, 3)
        The filtered light passes.
    """

    before: Filtered
    filtered: Filtered
    gains: Sequence[FloatArray]
    also: Mapping[str, FloatArray]


def clean_frame(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    bad: NDArray[np.bool_],
    seen: GBuffer | None = None,
    outside: NDArray[np.bool_] | None = None,
) -> Clean:
    """Return a frame after everything that happens to it.

    Parameters
    ----------
    frame, settings, features, bad
        As of `filter_rows`.
    seen : GBuffer, optional
        The guides of the frame before any stood in for missing ones; by default all are the frame's own.
    outside : (height, width), bool, optional
        As of `filter_whole`.
    """
    unguided = None
    # Only the features of the user tell what they compare.
    if get_quality(settings.quality).refines and settings.radius > 0 and not features:
        unguided = compute_unguided_share(frame.radiance.color, seen or frame.gbuffer)
        if float(unguided.max()) >= MIN_SHARE or frame.gbuffer.blur_radius is not None:
            raise_cost(MIX_UNGUIDED, sum(SECONDS_PER_MEGAPIXEL[each] for each in (FILTER_HALVES, REFINE, TAKE_BACK)))
    before, filtered = filter_whole(frame, settings, features, bad, outside=outside)
    gains = compute_gains(filtered)
    surface = mark_surface_pixels(seen or frame.gbuffer, frame.shape)
    if unguided is not None:
        filtered, further_gains = mix_unguided(frame, settings, filtered, unguided, surface, outside)
        gains += further_gains
    if settings.with_oidn:
        filtered, further_gains = mix_peer(frame, filtered, surface, is_best=settings.needs_oidn)
        gains += further_gains
    also = filter_passes(frame, settings, features, filtered) if has_passes(frame) else {}
    return Clean(before=before, filtered=filtered, gains=gains, also=also)


@device_scope()
def filter_plain(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    bad: NDArray[np.bool_],
    exact: FloatArray | None,
) -> Filtered:
    """Return the layers after one pass by their guides alone.

    Source: Tokuyoshi 2015, "Specular Lobe-Aware Filtering and Upsampling for Interactive Indirect Illumination".
    """
    enter_stage(FILTER_ONCE)
    # Each layer is one light: its albedo divides it, and its features compare its pixels.
    layers, parts = make_layers(frame, settings, features, finest=True), list_layer_parts(frame)
    outputs: list[FilterOutput] = []
    others: dict[str, Sequence[FilteredOther]] = {}
    for layer in layers:
        with engine.part(f"{layer.name}: {describe_form(settings.form, settings.radius)}"):
            output, others[layer.name] = filter_plain_layer(layer, settings, parts.get(layer.name, ()))
        outputs.append(output)
    with engine.part("sum of the light"):
        total = add_up(frame, layers, outputs, bad, exact)
    return Filtered(
        layers=layers,
        parts=total.parts,
        supports=[np.stack([total.weight_sum, total.effective_samples], axis=-1)],
        image=total.image,
        bad=bad,
        holes=total.holes,
        others=others,
    )


@device_scope()
def filter_halves(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    bad: NDArray[np.bool_],
    whole: WholeImage | None,
    exact: FloatArray | None,
) -> Filtered:
    """Return the layers after their passes over both halves of the samples."""
    # The layers follow one another, after their samples.
    step = 1.0 / (1.0 + len(frame.layers or (frame.radiance.parts or (None,))))
    enter_stage(FILTER_HALVES, (0.0, step))
    # Samples: bound fireflies, and split off highlights.
    halves = make_noisy_layers(frame, settings, features, None if whole is None else whole.levels)
    noisy = [join_halves(layer) for layer in halves]
    layers, levels, parts_of = [each.layer for each in halves], [each.level for each in halves], list_layer_parts(frame)
    # On a device these images end with their scope.
    sums = [tuple(map(download, layer.bounded.sums)) for layer in halves]
    # Passes: filter each layer, and its parts by the same weights. The samples of a layer go with it.
    clean_layers = []
    for number, joined in enumerate(noisy, 1):
        enter_stage(FILTER_HALVES, (number * step, (number + 1) * step))
        layer = halves.pop(0)
        others = bound_parts(layer, joined, parts_of.get(layer.name, ()))
        clean_layers.append(filter_layer_halves(frame, layer, settings, others))
        del layer, others
    with engine.part("sum of the light"):
        # Other light: emission and background have noise only where a lens blurs them, and are averaged there.
        rest, blur, sharing = compute_averaged_rest(frame, exact), frame.gbuffer.blur_radius, None
        if rest is not None and blur is not None:
            sharing = choose_sharing(rest, blur, frame.spp)
            rest = sharing.apply(rest)
        parts = [layer.image for layer in clean_layers]
        return Filtered(
            layers=layers,
            parts=parts,
            supports=[layer.support for layer in clean_layers],
            image=compose(parts, rest),
            bad=bad,
            rest=rest,
            noisy_rest=rest,
            sharing=sharing,
            noisy=noisy,
            levels=levels,
            sums=sums,
            others={layer.name: clean_layer.others for layer, clean_layer in zip(layers, clean_layers, strict=True)},
        )


def refine(frame: Frame, filtered: Filtered, whole: WholeImage | None) -> Filtered:
    """Refine the image by the network, and scale the layers and the other light so that they still sum to it."""
    from lobewise.denoising.refining.network import refine_light

    enter_stage(REFINE)
    with engine.part("refine by the network"):
        whole = measure_whole(frame, filtered.levels) if whole is None else whole
        parts, rest = refine_light(frame, filtered.layers, filtered.noisy, filtered.parts, filtered.rest, whole)
        image = compose(parts, rest)
    return replace(filtered, parts=parts, rest=rest, image=image, is_refined=True)


def take_back(frame: Frame, filtered: Filtered) -> Filtered:
    """Take the noisy image back where it has less error than the filtered one."""
    enter_stage(TAKE_BACK)
    with engine.part("take the noisy image back"):
        level, samples = reduce(choose_larger, filtered.levels), bound_samples(frame, filtered)
        halves, shared = get_image_halves(frame), frame.noise_is_shared
        share = estimate_share_lost(
            samples, filtered.image, level, halves=halves, shared=shared, refined=filtered.is_refined, spp=frame.spp
        )
        parts = [mix_noisy(*each, share) for each in zip(filtered.parts, filtered.noisy, strict=True)]
        rest = filtered.rest
        if rest is not None and filtered.noisy_rest is not None:
            rest = mix_noisy(rest, filtered.noisy_rest, share)
        image = compose(parts, rest)
    return replace(filtered, parts=parts, rest=rest, image=image, taken_from=filtered, share_taken=share)


def bound_samples(frame: Frame, filtered: Filtered) -> FloatArray:
    """Return the samples of a frame without those that are too bright for any network; see `cut_samples`."""
    return cut_samples(frame.radiance.color, compose(filtered.noisy, compute_rest(frame)))


def keep_light(filtered: Filtered) -> Filtered:
    """Share the light that bounding took out over each layer, so that the layer sums to the light of its samples."""
    enter_stage(SHARE_OUT)
    with engine.part("share out the light of fireflies"):
        losses = []
        for layer, part in zip(filtered.layers, filtered.parts, strict=True):
            images, name = [layer.radiance, part, layer.mask], f"gain_{layer.name}"
            if filtered.uncounted is None:
                loss = engine.total(measure_gain, images, name=name, count=3)
            else:
                loss = engine.total(measure_gain_outside, [*images, filtered.uncounted], name=name, count=3)
            losses.append(Loss(*loss))
        gains = [loss.gain for loss in losses]
        image, parts = share_light(filtered.image, filtered.parts, filtered.shared_masks, gains)
    return replace(filtered, image=image, parts=parts, losses=losses)


def compute_gains(filtered: Filtered) -> list[FloatArray]:
    """Return the factors, (height, width, 1 or 3), by which the light outside of the layers was multiplied."""
    if filtered.rest is None or filtered.noisy_rest is None or filtered.rest is filtered.noisy_rest:
        return []

    def divide(rest: FloatArray, noisy_rest: FloatArray) -> FloatArray:
        return np.divide(rest, noisy_rest, out=np.ones_like(rest), where=noisy_rest > 0.0)

    return [compute_rows(divide, filtered.rest, filtered.noisy_rest)]


def mix_unguided(
    frame: Frame,
    settings: ResolvedSettings,
    filtered: Filtered,
    share: FloatArray,
    surface: NDArray[np.bool_],
    outside: NDArray[np.bool_] | None,
) -> tuple[Filtered, list[FloatArray]]:
    """Mix in the image of the color alone, and scale the parts so that they sum to the image.

    ``share`` tells how far the guides are noise, see `compute_unguided_share` and `limit_to_noise`.
    """
    enter_stage(MIX_UNGUIDED)
    if filtered.rest is not None:
        share = limit_to_noise(share, filtered.rest, filtered.image, frame.gbuffer.blur_radius)
    if float(share.max()) < MIN_SHARE:
        return filtered, []
    # Image: filter the color alone, by the same steps.
    bare, by_color = forget_guides(frame), replace(settings, similarity="normal")
    with plan_stages({step: SECONDS_PER_MEGAPIXEL[step] for step in (FILTER_HALVES, REFINE, TAKE_BACK)}):
        _, alone = filter_whole(bare, by_color, (), mark_bad_pixels(bare), outside=outside)
    mixed = mix_noisy(filtered.image, alone.image, share)
    return scale_parts(frame, replace(filtered, image=mixed), filtered.image, filtered.parts, surface)


def mix_peer(
    frame: Frame, filtered: Filtered, surface: NDArray[np.bool_], *, is_best: bool
) -> tuple[Filtered, list[FloatArray]]:
    """Mix in the image of Open Image Denoise and the noisy one, and scale the parts so that they sum to the image.

    For ``is_best`` see `denoise_with_peer`.
    """
    enter_stage(MIX_PEER)
    samples = bound_samples(frame, filtered)
    noisy = compose(filtered.noisy, filtered.noisy_rest)
    with plan_stages(list_peer_costs(frame, is_best=is_best)):
        layers = list_peer_layers(frame, filtered)
        peer = denoise_with_peer(frame, samples, filtered.image, layers, is_best=is_best)
        enter_stage(CHOOSE)
        mixed, share = choose_between(frame, samples, filtered.image, peer.image, noisy)
        if filtered.rest is not None and (blur := frame.gbuffer.blur_radius) is not None:
            mixed = mix_noisy(mixed, peer.unguided, compute_salt_share(filtered.rest, filtered.image, blur))
    # Give each part its own noisy light first: else the detail of one part is spread over all.
    if filtered.share_taken is None:
        parts = [mix_noisy(*each, share) for each in zip(filtered.parts, filtered.noisy, strict=True)]
        filtered = replace(
            filtered, image=mix_noisy(filtered.image, noisy, share), parts=parts, taken_from=filtered, share_taken=share
        )
    before, parts = mix_layers(filtered.image, filtered.parts, peer.layers)
    return scale_parts(frame, replace(filtered, image=mixed), before, parts, surface)


def scale_parts(
    frame: Frame,
    filtered: Filtered,
    before: FloatArray,
    parts: Sequence[FloatArray],
    surface: NDArray[np.bool_],
) -> tuple[Filtered, list[FloatArray]]:
    """Bring ``parts`` of an image ``before`` to the image of ``filtered``; return the factors of the other light.

    Where a lens blurs lamps, their light is what the layers leave of the image, up to the brightest sample of a lamp
    within `NEAR_RADIUS` pixels.
    """
    image, scaled, gain = share_out(filtered.image, before, parts, surface)
    if filtered.sharing is None or not frame.unscattered:
        return replace(filtered, image=image, parts=scaled), [gain]
    lamps = reduce(np.add, map(blacken_bad, frame.unscattered.values()))
    scattered = sum_parts(parts)
    rest = np.clip(image - scattered, np.float32(0.0), compute_square_maximum(lamps, NEAR_RADIUS))
    shares = share_out(image - rest, scattered, parts, surface)
    return replace(filtered, image=shares.image + rest, parts=shares.parts, rest=rest), []


def list_peer_layers(frame: Frame, filtered: Filtered) -> list[LayerImage]:
    """Return the layers that Open Image Denoise filters one by one; none where light is not told apart.

    The albedo of a layer is that of its own pass, as a mean over the pixel's area where the frame has one.
    """
    if len(filtered.layers) < 2:
        return []
    guides, layers = frame.gbuffer, zip(filtered.layers, filtered.noisy, filtered.parts, strict=True)
    means = {"diffuse": guides.mean_diffuse_albedo, "specular": guides.mean_specular_albedo} if not frame.layers else {}
    return [
        LayerImage(cut_samples(layer.radiance, noisy), part, layer.albedo if mean is None else mean)
        for layer, noisy, part in layers
        for mean in (means.get(layer.name),)
    ]


def filter_passes(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature], filtered: Filtered
) -> dict[str, FloatArray]:
    """Return the images that belong to a layer or to the total, filtered by the same weights."""
    enter_stage(FILTER_OTHERS)
    # Passes take the steps of their layer: filter, network, noisy image taken back, light shared out.
    layers = {layer.name: filtered.look_up_passed(layer.name) for layer in frame.layers}
    clean = finish_layer_parts(frame, filtered.others, layers)
    if not frame.also:
        return clean
    before, share = filtered.taken_from, filtered.share_taken
    refined = before if before is not None and before.is_refined else None
    # What is not in the layers had no filter. Where there is none, all of a filled hole counts as scattered.
    rest = compute_rest(frame)
    rest = np.zeros_like(filtered.image) if rest is None else rest
    scattered = sum_parts(filtered.parts)
    rest_after = np.where(rest > 0.0, np.maximum(filtered.image - scattered, np.float32(0.0)), np.float32(0.0))
    whole = Passed(
        clean=filtered.image - rest_after, before=None if refined is None else sum_parts(refined.parts), share=share
    )
    return clean | filter_also(frame, settings, features, whole, (rest, rest_after))


def name_layers(frame: Frame, filtered: Filtered) -> dict[str, FloatArray]:
    """Return the filtered layers that the frame names itself, finite."""
    if not frame.layers:
        return {}
    return {layer.name: blacken_bad(part) for layer, part in zip(filtered.layers, filtered.parts, strict=True)}
