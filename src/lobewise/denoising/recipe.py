"""The recipe of `denoise`: a noisy frame in, a clean one out."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial, reduce
from typing import TYPE_CHECKING
from weakref import ref

import numpy as np

from lobewise import engine
from lobewise.denoising.also import bring_parts, keep_sum, list_alone
from lobewise.denoising.automatic import ask, change_settings, needs_peer_alone, resolve_all
from lobewise.denoising.bad_pixels import blacken_bad, describe_bad, mark_bad_pixels, mark_good, require_some_good
from lobewise.denoising.chain import Filtered, clean_frame, name_layers
from lobewise.denoising.combining import (
    denoise_with_peer,
    describe_peer_alone,
    list_peer_costs,
    make_finite,
    name_method,
    sum_finite,
)
from lobewise.denoising.inputs import DEPTH_WITHOUT_CAMERA, describe_lacks, list_unused
from lobewise.denoising.layers import Layer
from lobewise.denoising.light_loss import MIN_SHARE_BOUNDED, compute_share_missing, describe_loss, sum_light
from lobewise.denoising.plan import bound_memory, compute_costs
from lobewise.errors import UnusedGuideWarning, require_kind
from lobewise.features import Feature
from lobewise.filters.fireflies import compute_energy_lost
from lobewise.guides.negative import is_dim, split_negative
from lobewise.guides.squares import compute_square_maximum
from lobewise.guides.survey import ALBEDOS
from lobewise.guides.usable import CheckedGuides, check_guides
from lobewise.peers import require_oidn
from lobewise.records.frame import FloatArray, Frame, Radiance, Result
from lobewise.records.images import crop_columns, pack_planes, unpack_planes, wrap_columns
from lobewise.records.radiance import MAX_EXCESS_SHARE, measure_excess
from lobewise.settings import DenoiseChanges, DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import QUALITIES, get_quality
from lobewise.work.progress import Watcher, enter_stage, plan_stages, watched
from lobewise.work.progress.stages import FILTER_ONCE, SECONDS_PER_MEGAPIXEL, describe_alone

if TYPE_CHECKING:
    from typing_extensions import Unpack

NEGATIVE, OPACITY = "filter the light below 0", "filter the opacity"
"""The stages after those of the light."""
GUIDES_OF_COLOR = (*ALBEDOS, "mean_emission")
"""Guides that tell colors, which opacity and other images that are no light do not have."""
ALPHA_REACH = 2
"""Pixels around a fraction of opacity that are denoised. Surfaces stay opaque, exactly, and the background clear."""
NO_KERNELS = (
    "No filter of lobewise can run here, so Open Image Denoise denoises the image alone; `lobewise doctor` says what "
    "to do."
)
FEATURES_SOFTENED = (
    "The network of the quality 'high' does not read features of your own, and softens edges that only they tell: the "
    "quality 'balanced' keeps these edges."
)


@watched
def denoise(
    frame: Frame,
    settings: DenoiseSettings | None = None,
    *,
    features: Sequence[Feature] = (),
    progress: Watcher | None = None,
    **changes: Unpack[DenoiseChanges],
) -> Result:
    """Denoise a frame by averaging, for every pixel, the neighbours that reflect like it.

    Where Open Image Denoise is installed its image is mixed in, pixel by pixel, unless a quality is named or
    ``with_oidn`` is False.

    Diffuse and specular radiance are filtered apart where the frame has both, each divided by its albedo where the
    frame has that; emission and background pass through. Source: Tokuyoshi 2015, "Specular Lobe-Aware Filtering and
    Upsampling for Interactive Indirect Illumination". Departs: lobes of two radiances are never mixed, and the lobe
    similarity may be the GGX covariance instead of a spherical Gaussian.

    Parameters
    ----------
    frame : Frame
        Noisy radiance, and the guides that there are. Lobes are compared where it has normals, roughness, camera and
        position or depth. Without normals, those of the surfaces through its positions stand for them, else none.
    settings : DenoiseSettings, optional
        Parameters; by default those that won the comparison, and Open Image Denoise where it is installed.
    features : sequence of Feature
        More distributions that two pixels must share, of your own or from `lobewise.features`; their
        similarities multiply the others in every layer. With any, "auto" is "balanced", and Open Image Denoise is
        used only if it is asked for: neither it nor the network of "high" reads them.
    progress : callable, optional
        Called with a `Progress` several times in a second. As with Open Image Denoise, it cancels the call by returning
        False. What it raises, the call raises.
    **changes
        Single parameters, by name, that replace those of ``settings``.

    Returns
    -------
    Result
        Finite radiance and the filter's statistics. Light below 0 (colours outside of the gamut, the ringing of pixel
        filters) stays below 0, filtered.

    Warns
    -----
    UnusedGuideWarning
        For each guide that is given and not used: it is 0 everywhere, or the frame lacks what it needs beside it.

    Raises
    ------
    InputError
        If a parameter is out of range or unknown, or no pixel of the frame is usable.
    MissingChannelError
        If the frame lacks what a similarity compares that was asked for.
    DeviceError
        If the device cannot run here.
    LimitError
        Inside `lobewise.limit_call`.
    CancelledError
        If ``progress`` has returned False.

    Examples
    --------
    >>> import lobewise
    >>> frame = lobewise.read_frame("frame.exr")  # doctest: +SKIP
    >>> clean = lobewise.denoise(frame, radius=12).image  # doctest: +SKIP
    """
    require_kind("frame", frame, Frame)
    named = change_settings(settings or DenoiseSettings(), changes)
    checked = check_frame(frame, named)
    for note in checked.idle:
        warnings.warn(note, UnusedGuideWarning, stacklevel=3)
    return denoise_checked(checked, named, features).convert(frame.radiance.maker)


def denoise_quietly(frame: Frame, named: DenoiseSettings) -> Result:
    """Denoise a frame as `denoise` does, without warnings: the notes of the result say the same."""
    return denoise_checked(check_frame(frame, named), named)


def check_frame(frame: Frame, named: DenoiseSettings) -> CheckedGuides[Frame]:
    """Return a frame that filters can take, and notes on its guides; ``named`` are the settings of the user."""
    checked = check_guides(frame)
    lacking = tuple(describe_lacks(checked.frame, named))
    idle = (*checked.idle, *(note for note in lacking if note != DEPTH_WITHOUT_CAMERA))
    return replace(checked, notes=(*checked.notes, *lacking), idle=idle)


def denoise_checked(checked: CheckedGuides[Frame], named: DenoiseSettings, features: Sequence[Feature] = ()) -> Result:
    """Denoise a frame whose guides were checked; ``named`` are the settings before anything is chosen.

    Planes of a frame are packed for the kernels, and unpacked in the result. What the caller has packed stays packed.
    """
    start, frame = time.perf_counter(), checked.frame
    packed = pack_planes(frame.also)
    images = {name: packed[name] for name in list_alone(packed)}
    planes = {name: image for name, image in packed.items() if name not in images}
    stages = {name: describe_alone(name) for name in images}
    has_alpha = frame.alpha is not None
    # Opacity takes the time of the best quality, and "auto" is the best.
    light, best = (get_quality(each.replace("auto", "high")).seconds_per_megapixel for each in (named.quality, "high"))
    with plan_stages({"": light, **dict.fromkeys(stages.values(), light), OPACITY: best * has_alpha}):
        enter_stage("")
        result = _denoise_light(replace(checked, frame=frame.with_changes(also=planes)), named, features)
        if packed.keys() != frame.also.keys():
            result = replace(result, also=unpack_planes(result.also))
        if images:
            clean = {}
            for name, image in images.items():
                enter_stage(stages[name])
                clean[name] = denoise_further(frame, image, named, features)
            more = keep_sum(clean, images, frame.radiance.color, result.image)
            result = replace(result, also={**result.also, **more})
        if has_alpha:
            enter_stage(OPACITY)
            result = replace(result, alpha=denoise_alpha(frame, named))
    return replace(result, origin=frame.origin, seconds=time.perf_counter() - start)


def denoise_further(frame: Frame, image: FloatArray, named: DenoiseSettings, features: Sequence[Feature]) -> FloatArray:
    """Return an image beside the picture of a frame, (height, width, 3), denoised by itself.

    The weights of the picture do not suit it: the noise of one lamp may be a thousandth of all noise.
    """
    if not mark_good(image).any():
        return image
    if measure_excess(frame.radiance.color, image) > MAX_EXCESS_SHARE:
        # No light, such as the pass of a shadow catcher.
        return _denoise_alone(frame, image, take_best(named), features, GUIDES_OF_COLOR)
    # By guides alone, lamps and background would spread over light that is a thousandth of theirs.
    quality = QUALITIES.get(named.quality)
    by_guides = quality is not None and not quality.reads_halves
    exact = compute_exact_share(frame) * make_finite(image) if by_guides else np.zeros_like(image)
    return _denoise_alone(frame, image - exact, named, features, ("mean_emission",)) + exact


def compute_exact_share(frame: Frame) -> FloatArray:
    """Return the share of each pixel's light that no surface scattered, (height, width, 3), in [0, 1]."""
    color = blacken_bad(frame.radiance.color)
    exact = sum_finite([np.zeros_like(color), *frame.unscattered.values()])
    share = np.divide(exact, color, out=np.zeros_like(color), where=color > 0.0)
    return np.clip(share, np.float32(0.0), np.float32(1.0))


def take_best(named: DenoiseSettings) -> DenoiseSettings:
    """Return the settings for an image whose edges no guide shows: "fast" and "balanced" count as "high"."""
    return named if named.quality == "auto" or named.needs_oidn else replace(named, quality="high")


def denoise_alpha(frame: Frame, named: DenoiseSettings) -> FloatArray:
    """Return the opacity of a frame, denoised as gray light of surfaces without albedos, (height, width), in [0, 1].

    Opacity has edges of its own, those of shadows, which neither guides nor the light of a shadow catcher show. So it
    is not filtered by the weights of the light, nor by guides alone; see `take_best`. Pixels with no fraction of
    opacity near them keep theirs.
    """
    assert frame.alpha is not None
    gray = np.repeat(frame.alpha[..., None], 3, axis=-1)
    image = _denoise_alone(frame, gray, take_best(named), (), GUIDES_OF_COLOR)
    around = frame.surround().alpha
    assert around is not None
    fractions = ((around > 0.0) & (around < 1.0)).astype(np.float32)
    near = crop_columns(compute_square_maximum(fractions, ALPHA_REACH), frame.width)
    alpha = np.where(near > 0.0, image.mean(axis=-1), frame.alpha)
    clipped: FloatArray = np.clip(np.nan_to_num(alpha), np.float32(0.0), np.float32(1.0))
    return clipped


def _denoise_alone(
    frame: Frame, image: FloatArray, named: DenoiseSettings, features: Sequence[Feature], left_out: Sequence[str]
) -> FloatArray:
    """Return an image that has some of the guides of a frame, denoised."""
    alone = Frame(
        Radiance(image),
        replace(frame.gbuffer, **dict.fromkeys(left_out)),
        frame.camera,
        spp=frame.spp,
        lobe_tables=frame.lobe_tables,
        noise_is_shared=frame.noise_is_shared,
        wraps=frame.wraps,
    )
    return _denoise_light(CheckedGuides(alone), named, features).image


def _denoise_light(checked: CheckedGuides[Frame], named: DenoiseSettings, features: Sequence[Feature]) -> Result:
    if needs_peer_alone(named, with_features=bool(features)):
        return leave_to_peer(checked)
    frame = checked.frame
    notes = (*frame.notes, *checked.notes)
    start, noisy, width = time.perf_counter(), ref(frame.radiance.color), frame.width
    chosen = resolve_all(frame, ask(named, {}, with_features=bool(features)))
    if chosen.with_oidn:
        require_oidn()
    frame, below = split_negative(frame.surround())
    bad_pixels = mark_bad_pixels(frame)
    bad = int(np.count_nonzero(bad_pixels))
    require_some_good(bad, bad_pixels.size, "pixel")
    room = bound_memory(frame, chosen.quality, with_oidn=bool(chosen.with_oidn))
    costs = compute_costs(frame, chosen) | ({} if below is None else {NEGATIVE: SECONDS_PER_MEGAPIXEL[FILTER_ONCE]})
    with room, engine.on(chosen.device), plan_stages(costs):
        margin = (frame.width - width) // 2
        seen = wrap_columns(checked.seen, margin)
        outside = np.pad(np.zeros((frame.height, width), np.bool_), [(0, 0), (margin, margin)], constant_values=True)
        clean = clean_frame(frame, chosen, features, bad_pixels, seen, outside if margin else None)
        enter_stage(NEGATIVE)
        # The neighbours across the border stand beside it already.
        negative = None if below is None else filter_below(below.with_changes(wraps=False), frame, named, features)
    filtered = clean.filtered
    diffuse, specular = join_parts(filtered.layers, filtered.parts)
    weight_sum, effective_samples = filtered.compute_support()
    result = Result(
        image=filtered.image,
        diffuse=diffuse,
        specular=specular,
        layers=name_layers(frame, filtered),
        also={**clean.also, **scale_unscattered(frame, filtered, clean.gains)},
        weight_sum=np.ascontiguousarray(weight_sum),
        effective_samples=np.ascontiguousarray(effective_samples),
        bad_pixels=filtered.bad,
        settings=asdict(chosen),
        seconds=0.0,
        energy_lost=compute_share_missing(filtered.losses),
        method=name_method(frame, named, chosen, with_features=bool(features)),
        notes=(
            *notes,
            *describe_bad(bad, filtered.bad.size),
            *describe_filtering(frame, chosen, features, clean.before),
        ),
        unused=list_unused(frame, chosen),
        find_noisy=noisy,
    )
    result = result if negative is None else result.subtract(negative)
    return replace(result.crop_columns(width), seconds=time.perf_counter() - start)


def leave_to_peer(checked: CheckedGuides[Frame]) -> Result:
    """Denoise a frame by Open Image Denoise alone, without any kernel; dim light below 0 stays as it is."""
    start, noisy, width = time.perf_counter(), ref(checked.frame.radiance.color), checked.frame.width
    frame, below = split_negative(checked.frame.surround())
    samples = frame.radiance.color
    bad = ~mark_good(samples)
    count = int(np.count_nonzero(bad))
    require_some_good(count, bad.size, "pixel")
    with bound_memory(frame, "", with_oidn=True), plan_stages(list_peer_costs(frame, has_kernels=False)):
        denoise_alone = partial(denoise_with_peer, has_kernels=False)
        image = denoise_alone(frame, samples, blacken_bad(samples)).image
        if below is not None:
            light = below.radiance.color
            image = image - (light if is_dim(below, frame) else denoise_alone(below, light, light).image)
    unfiltered = np.zeros(frame.shape, np.float32)
    result = Result(
        image=image,
        weight_sum=unfiltered,
        effective_samples=unfiltered.copy(),
        bad_pixels=bad,
        settings={"with_oidn": True},
        seconds=time.perf_counter() - start,
        method=describe_peer_alone(frame),
        notes=(*frame.notes, *checked.notes, *describe_bad(count, bad.size), NO_KERNELS),
        find_noisy=noisy,
    )
    return result.crop_columns(width)


def filter_below(below: Frame, above: Frame, named: DenoiseSettings, features: Sequence[Feature]) -> Result:
    """Return the light below 0 of a frame, see `split_negative`, filtered: by the guides alone where it is dim.

    Layers and further images without light below 0 are left out. ``above`` is the frame without light below 0.
    """
    layers = [layer for layer in below.layers if any(map(np.any, (layer.radiance, *layer.parts.values())))]
    also = {name: image for name, image in below.also.items() if image.any()}
    settings = replace(named, quality="fast", with_oidn=False) if is_dim(below, above) else named
    below = below.with_changes(layers=layers or below.layers, also=also)
    return denoise_checked(CheckedGuides(below), settings, features)


def scale_unscattered(frame: Frame, filtered: Filtered, gains: Sequence[FloatArray]) -> dict[str, FloatArray]:
    """Return emission and background where a lens blurs them, or where they were scaled."""
    sharing, unscattered = filtered.sharing, frame.unscattered
    if sharing is not None and filtered.rest is not None and unscattered:
        averaged = [sharing.apply(blacken_bad(light)) for light in unscattered.values()]
        return bring_parts(unscattered, averaged, filtered.rest)
    if not gains:
        return {}
    scaled = {name: reduce(np.multiply, gains, light) for name, light in unscattered.items()}
    return {name: np.where(np.isfinite(light), light, np.float32(0.0)) for name, light in scaled.items()}


def describe_filtering(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature], before: Filtered
) -> tuple[str, ...]:
    """Return what the filters did that a user should know, one sentence each.

    ``before`` are the layers before the light that bounding took was shared out.
    """
    is_softened = features and settings.radius > 0 and get_quality(settings.quality).refines
    notes: tuple[str, ...] = (FEATURES_SOFTENED,) if is_softened else ()
    share_bounded = compute_energy_lost(before.tallies)
    if share_bounded >= MIN_SHARE_BOUNDED:
        notes += describe_loss(sum_light(frame, before.image, before.bad), share_bounded)
    return notes


def join_parts(layers: Sequence[Layer], parts: Sequence[FloatArray]) -> tuple[FloatArray | None, FloatArray | None]:
    """Return diffuse and specular light from that of all layers, finite; None both where it is not known apart."""
    if layers[0].name == "color":
        return None, None
    sums: dict[bool, FloatArray] = {}
    for layer, part in zip(layers, parts, strict=True):
        good = blacken_bad(part)
        sums[layer.is_diffuse] = sums[layer.is_diffuse] + good if layer.is_diffuse in sums else good
    nothing = np.zeros_like(parts[0])
    return sums.get(True, nothing), sums.get(False, nothing)
