"""The recipe: a noisy frame in, a clean one out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import device_scope
from lobewise.denoising.also import filter_also
from lobewise.denoising.automatic import ask, change_settings, choose_quality, explain_ours, resolve_settings
from lobewise.denoising.bad_pixels import blacken_bad, fill_holes, find_bad_pixels, find_good, require_some_good
from lobewise.denoising.combining import (
    can_mix,
    choose_between,
    denoise_with_peer,
    describe_method,
    share_out,
)
from lobewise.denoising.evidence import count_blurred, describe_blurred, take_back_noisy
from lobewise.denoising.guided import (
    filter_balanced,
    find_balanced_reach,
    resolve_guided,
)
from lobewise.denoising.high import find_high_reach, mix_layer
from lobewise.denoising.inputs import list_unused
from lobewise.denoising.layers import Layer, Support, filter_layer, find_support, make_layers
from lobewise.denoising.light_loss import (
    MIN_SHARE_BOUNDED,
    brighten,
    describe_loss,
    find_gain,
    find_share_missing,
    find_takers,
    sum_light,
    sum_missing,
)
from lobewise.denoising.noisy import join_halves, make_noisy_layers
from lobewise.errors import require_kind
from lobewise.features import Feature
from lobewise.filters.compositing import average_emission
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.fireflies import find_energy_lost
from lobewise.filters.forms import ATROUS_REACH
from lobewise.filters.noise.detail import REACH as DETAIL_REACH
from lobewise.filters.specks import share_out_specks
from lobewise.frame import FloatArray, Frame, Result
from lobewise.guides.usable import bound_guides, find_unusable
from lobewise.peers import name_oidn_guides, require_oidn
from lobewise.settings import DenoiseChanges, DenoiseSettings, ResolvedSettings

if TYPE_CHECKING:
    from typing_extensions import Unpack


def denoise(
    frame: Frame,
    settings: DenoiseSettings | None = None,
    *,
    features: Sequence[Feature] = (),
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
        Noisy radiance with its G-buffer; normals at least, for lobes also roughness, camera and position or depth.
    settings : DenoiseSettings, optional
        Parameters; by default those that won the comparison, and Open Image Denoise where it is installed.
    features : sequence of Feature
        More distributions that two pixels must share, of your own or from `lobewise.features`; their
        similarities multiply the others in every layer. With any, Open Image Denoise is used only if it is asked for.
    **changes
        Single parameters, by name, that replace those of ``settings``.

    Returns
    -------
    Result
        Finite, non-negative radiance and the filter's statistics.

    Raises
    ------
    InputError
        If a parameter is out of range or unknown, or no pixel of the frame is usable.
    MissingChannelError
        If the frame lacks what the similarity compares.
    DeviceError
        If the device cannot run here.

    Examples
    --------
    >>> import lobewise
    >>> frame = lobewise.read_frame("frame.exr")  # doctest: +SKIP
    >>> clean = lobewise.denoise(frame, radius=12).image  # doctest: +SKIP
    """
    require_kind("frame", frame, Frame)
    return run_recipe(frame, change_settings(settings or DenoiseSettings(), changes), features)


def run_recipe(frame: Frame, named: DenoiseSettings, features: Sequence[Feature]) -> Result:
    """Denoise a frame; ``named`` are the settings before anything is chosen."""
    start = time.perf_counter()
    notes = tuple(map(str, find_unusable(frame)))
    frame = bound_guides(frame)
    chosen = resolve_all(frame, ask(named, {}, with_features=bool(features)))
    if chosen.with_oidn:
        require_oidn()
    bad = find_bad_pixels(frame)
    require_some_good(int(np.count_nonzero(bad)), bad.size, "pixel")
    filtered = filter_frame(frame, chosen, features)
    found, missing = keep_light(filtered)
    image = fill_holes(found.image, found.find_holes(bad), frame, chosen.device)
    parts = found.parts
    gains = [] if found.gain is None else [found.gain[..., None]]
    if chosen.with_oidn:
        peer = denoise_with_peer(frame, image)
        with np.errstate(over="ignore"):  # an infinite sum counts as bad, and nothing is taken of it
            noisy = compose(frame, found.noisy, found.rest)
        mixed = choose_between(frame, image, peer, noisy)
        image, parts, gain = share_out(mixed, image, parts)
        gains.append(gain)
    diffuse, specular = join_parts(found.layers, parts)
    layers: dict[str, FloatArray] = {}
    if frame.layers:
        layers = {layer.name: blacken_bad(part) for layer, part in zip(found.layers, parts, strict=True)}
    more = frame.also or any(layer.parts for layer in frame.layers)
    also = filter_also(frame, chosen, features, layers, image) if more else {}
    if gains:
        also |= {name: blacken_bad(reduce(np.multiply, gains, light)) for name, light in frame.unscattered.items()}
    weight_sum, effective_samples = find_support(found.layers, found.supports)
    share_bounded = find_energy_lost(found.tallies)
    if share_bounded >= MIN_SHARE_BOUNDED:
        notes += describe_loss(sum_light(frame, filtered.image, bad), share_bounded)
    if chosen.quality == "fast":
        notes += describe_blurred(count_blurred(frame, filtered.image))
    return Result(
        image=image,
        diffuse=diffuse,
        specular=specular,
        layers=layers,
        also=also,
        weight_sum=np.ascontiguousarray(weight_sum),
        effective_samples=np.ascontiguousarray(effective_samples),
        bad_pixels=bad,
        settings=asdict(chosen),
        seconds=time.perf_counter() - start,
        energy_lost=missing,
        method=describe_method(
            chosen,
            name_oidn_guides(frame),
            mixes=can_mix(frame),
            why_ours=explain_ours(named, with_features=bool(features)),
        ),
        notes=notes,
        unused=list_unused(frame, chosen),
    )


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


def resolve_all(frame: Frame, asked: DenoiseSettings, spp: float | None = None) -> ResolvedSettings:
    """Return settings with every "auto" replaced, for their own quality; for ``spp`` see `resolve_settings`."""
    fast = choose_quality(asked) == "fast"
    return resolve_settings(frame, asked, spp=spp) if fast else resolve_guided(frame, asked)


@dataclass(frozen=True)
class Filtered:
    """The layers of a frame, what became of their radiance, and by how much support."""

    layers: Sequence[Layer]
    parts: Sequence[FloatArray]
    supports: Sequence[Support]
    image: FloatArray
    """All parts and what is in none of them, (height, width, 3); see `compose`."""
    tallies: Sequence[NDArray[np.float64]] = ()
    """What fireflies took of every layer, row by row."""
    gain: FloatArray | None = None
    """What light of no layer was multiplied by, (height, width); None for 1."""
    rest: FloatArray | None = None
    """What is in no part: emission and background; None where light is not told apart."""
    noisy: Sequence[FloatArray] = ()
    """The samples of every layer without fireflies, radiance; none with the quality "fast", which bounds none."""
    levels: Sequence[float] = ()
    """Mean light of the samples of every layer, over albedo; none with the quality "fast", which shares nothing out."""

    def find_holes(self, bad: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return where the image is none, (height, width): not finite, or bad and reached by no layer."""
        untouched = np.logical_and.reduce([support.weight_sum <= 0.0 for support in self.supports])
        holes: NDArray[np.bool_] = ~find_good(self.image) | (bad & untouched)
        return holes


def keep_light(found: Filtered) -> tuple[Filtered, float]:
    """Return layers whose light sums to that of their samples, and which share of it is missing still."""
    layers = list(zip(found.layers, found.parts, found.levels, strict=False))
    takers = [find_takers(layer, part, level) for layer, part, level in layers]
    rows = [sum_missing(layer, part, taker) for (layer, part, _), taker in zip(layers, takers, strict=True)]
    gains = [find_gain(each) for each in rows]
    if not any(map(any, gains)):
        return found, find_share_missing(rows, gains)
    image, parts = found.image, []
    for part, taker, gain in zip(found.parts, takers, gains, strict=True):
        image = brighten(image, part, taker, gain)
        parts.append(brighten(part, part, taker, gain))
    return replace(found, image=image, parts=parts), find_share_missing(rows, gains)


def filter_frame(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature] = (), levels: Sequence[float] | None = None
) -> Filtered:
    """Filter a frame; ``levels`` as in `make_noisy_layers`."""
    if settings.quality == "fast":
        return filter_plain(frame, settings, features)
    return filter_guided(frame, settings, features, levels)


def find_reach(settings: ResolvedSettings) -> int:
    """Return from how many pixels away anything can tell on a pixel that `filter_frame` gives.

    Of frames without halves of their samples the pilot has no guide, so they are told of less.
    """
    if settings.quality == "high":
        return find_high_reach(settings) + DETAIL_REACH
    if settings.quality == "balanced":
        return find_balanced_reach(settings) + DETAIL_REACH
    return ATROUS_REACH if settings.form == "atrous" else settings.radius


@device_scope()
def filter_plain(frame: Frame, settings: ResolvedSettings, features: Sequence[Feature]) -> Filtered:
    """Filter every layer in one pass, by its guides alone."""
    layers = make_layers(frame, settings, features, finest=True)
    outputs = [filter_layer(layer, settings, layer.radiance) for layer in layers]
    parts = [keep_unfiltered(layer, output) for layer, output in zip(layers, outputs, strict=True)]
    return Filtered(layers, parts, outputs, compose(frame, parts, find_rest(frame)))


def filter_guided(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature], levels: Sequence[float] | None = None
) -> Filtered:
    """Filter every layer, and take the noisy image back where it has less error; ``levels`` as in `filter_frame`."""
    found = filter_halves(frame, settings, features, levels)
    parts = take_back_noisy(frame, found.image, found.noisy, found.parts, max(found.levels))
    return replace(found, parts=parts, image=compose(frame, parts, found.rest))


@device_scope()
def filter_halves(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature], levels: Sequence[float] | None = None
) -> Filtered:
    """Filter both halves of every layer by their guides and by what they tell of light and noise."""
    noisy = make_noisy_layers(frame, settings, features, levels)
    run = mix_layer if settings.quality == "high" else filter_balanced
    clean = [run(frame, each, settings) for each in noisy]
    parts = [each.image for each in clean]
    tallies = [each.bounded.tally for each in noisy]
    rest, share = find_rest(frame), frame.gbuffer.object_share
    if rest is not None and frame.gbuffer.mean_emission is not None:
        rest = average_emission(rest, frame.gbuffer.mean_emission, frame.spp)
    gain = None
    if rest is not None and share is not None:
        gain = share_out_specks(rest, share, device=settings.device)
        rest = rest * gain[..., None]
    layers, levels = [each.layer for each in noisy], [each.level for each in noisy]
    samples = [join_halves(each) for each in noisy]
    return Filtered(layers, parts, clean, compose(frame, parts, rest), tallies, gain, rest, samples, levels)


def keep_unfiltered(layer: Layer, output: FilterOutput) -> FloatArray:
    """Return the filtered radiance, and the input where no tap had weight; NaN where that is bad too."""
    lost = output.weight_sum <= 0.0
    if not lost.any():
        return output.image
    kept = np.where(find_good(layer.radiance)[..., None], layer.radiance, np.float32(np.nan))
    return np.where(lost[..., None], kept, output.image)


def find_rest(frame: Frame) -> FloatArray | None:
    """Return what is in none of the parts of a frame (emission, background), finite and >= 0; None without parts."""
    if frame.radiance.parts is None:
        return None
    noisy = [layer.radiance for layer in frame.layers] or frame.radiance.parts
    with np.errstate(invalid="ignore", over="ignore"):  # bad pixels are infinite or NaN here; the next line drops them
        # A negative part is no light: subtracting it would add light that is not in the total.
        rest = frame.radiance.color - np.maximum(noisy[0], np.float32(0.0))
        for part in noisy[1:]:
            rest = rest - np.maximum(part, np.float32(0.0))
    return np.where((rest > 0.0) & (rest <= np.finfo(np.float32).max), rest, np.float32(0.0))


def compose(frame: Frame, parts: Sequence[FloatArray], rest: FloatArray | None) -> FloatArray:
    """Return the total: the filtered parts, and what was in none of them."""
    if rest is None:
        return parts[0]
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return np.asarray(total + rest, dtype=np.float32)
