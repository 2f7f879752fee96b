"""The mixture of our image, the image of a neural denoiser and the noisy image, pixel by pixel.

A denoiser that was trained on pictures is good where light is smooth or looks like other pictures. Our filters are good
where only the guides tell how a surface reflects. A small network gives the shares of the three images. It reads how
far the images are apart, how noisy the frame is and which image the samples are nearer to
(`lobewise.filters.noise.agreement`). It was trained on random scenes with guides missing
(``benchmarks/training/shares.py``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.automatic import explain_ours
from lobewise.denoising.bad_pixels import mark_good
from lobewise.denoising.evidence import estimate_share_proved, get_image_halves, load_networks, mix_noisy
from lobewise.engine.here import HERE
from lobewise.filters.glue import define_smooth
from lobewise.filters.mixing import Perceptron, compute_shares
from lobewise.filters.noise.agreement import compute_agreement
from lobewise.filters.noise.detail import compute_detail
from lobewise.guides.squares import count_neighbours, sum_square
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.peers import (
    denoise_oidn,
    has_clean_guides,
    keep_library_memory,
    name_call,
    name_oidn_guides,
    prefilter_guides,
    reduce_guides,
)
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_similarity
from lobewise.work.chunks import cut_rows

CHOOSE = "choose the shares of the images"
"""The stage after the calls of Open Image Denoise."""
PLAIN_CALL_SECONDS = 1.45
"""Time of one call of Open Image Denoise with albedo and normal that are said to be noisy, in the seconds of
`list_peer_costs`: with it "auto" and "best" take as many calls as in ``benchmarks/results/budget.json``."""
MAX_BLACK_RADIANCE = 1e-30
"""Radiance up to which light counts as black, so that no part has a share of it."""
LOBE_ALBEDO_SHARE = 0.25
"""Share of the lobes' albedos in the albedo that the peer gets (see ``benchmarks/results/switched_off.json``). With
0.5, jewels gain more, and glass on a table has more error than without."""
NEAR_RADIUS = 8
"""Pixels around a black pixel whose light tells which parts take light there. Filters reach as far."""
MIN_SHARE_LIT = 0.4
"""Share of the pixels around a pixel, all without a surface, that have light where it lies in fog. At one sample per
pixel fog has more; a transparent background has less beside its objects."""
MAX_NEAR = 1e30
"""Largest sum of light around a pixel that counts: sums of several do not overflow."""
MAX_RATIO_TO_IMAGE = 2.0
"""Largest change of the scattered light over that of the whole image, and the other way round."""
NOISE_RADIUS, MAX_DEVIATIONS = 2, 3.0
"""Pixels around a pixel whose noise is its noise, and largest change of a part by `share_by_noise`, in standard
deviations of its noise."""

PREFILTER_QUALITY, UNGUIDED_QUALITY = "fast", "balanced"
"""Qualities of Open Image Denoise for its filters of guides, and for the image without guides. Higher ones cost 0.4 of
its time at its best, and change the error by less than 1 % (benchmarks/results/peer_ways.json)."""
MIN_SMOOTHED_SPP, NORMAL_DEVIATION = 16.0, 0.8
"""Samples per pixel from which noisy normals are smoothed instead of filtered by the library, and difference of normals
at which `define_smooth` gives a neighbour the weight exp(-1/2), at one sample per pixel: it falls with their root, as
noise does. The mean error is 0.2 % more than with the library's filter at 16 samples, and the same at 64. With 4
samples and 0.2 it is 0.6 % more, and with one half as much again in haze."""
UNGUIDED_QUALITY_CLEAN = "fast"
"""Quality for the image without guides where guides have no noise: it helps less there, and is made in half the
time."""
LAYERS_QUALITY, LAYERS_SHARE = "fast", 1.0 / 3.0
"""Quality of Open Image Denoise for layers, and share of the image that they sum to, where it equals the image with
guides. Quality "high" takes twice as long and makes the mean error 0.5 to 0.9 % less."""
BEST_LAYERS_QUALITY, BEST_LAYERS_SHARE = "high", 0.4
"""The same for our quality "best"."""
MIN_LAYER_SHARE = 0.01
"""Share of the light below which our image of a layer stands for the library's."""
UNGUIDED_SHARE = 0.25
"""Share of the image without guides where it equals the one with guides. With a third, print has up to 3 % more error
at 64 samples, and other shots have as much."""
HALF_SHARE_DIFFERENCE, PEER_DARK_SHARE = 2.0, 0.05
"""Difference of luminance at which a share is halved, at one sample per pixel, over the luminance with guides plus the
second number times its mean over the image. It falls with the root of the samples per pixel, as noise does: what
differs more is detail."""
USUAL_SPP = 16.0
"""Samples per pixel of a frame that does not tell them."""


class Mixture(NamedTuple):
    """An image that several were mixed to, and how much of the noisy one it holds.

    Parameters
    ----------
    image : (height, width, 3)
    noisy_share : (height, width)
        In [0, 1].
    """

    image: FloatArray
    noisy_share: FloatArray


def choose_between(frame: Frame, samples: FloatArray, ours: FloatArray, peer: FloatArray, noisy: FloatArray) -> Mixture:
    """Return the mixture of our image, the peer's image and the noisy image.

    Where the frame has neither albedo nor normal, the result is the peer's image: the network was trained on no such
    frame.

    Parameters
    ----------
    frame : Frame
        The noisy frame.
    samples : (height, width, 3)
        The noisy image, which the peer was given.
    ours, peer : (height, width, 3)
        Our image, and the image of `denoise_with_peer`; finite, >= 0.
    noisy : (height, width, 3)
        The noisy image without fireflies. Our image replaces its bad pixels.
    """
    if not name_oidn_guides(frame):
        return Mixture(peer, np.zeros(frame.shape, np.float32))
    halves = get_image_halves(frame)
    shares = compute_mixture(samples, ours, peer, load_networks()["peer"], shared=frame.noise_is_shared)
    noisy = np.where(mark_good(noisy)[..., None], noisy, ours)
    mixed = peer + shares[..., :1] * (ours - peer) + shares[..., 1:2] * (noisy - peer)
    # Where the images are many orders of magnitude apart, rounding can leave a negative value.
    mixed = np.maximum(mixed, np.float32(0.0))
    share = np.ascontiguousarray(shares[..., 1])
    if halves is not None:
        level = compute_mean_luminance(peer)
        proved = estimate_share_proved(mixed, samples, halves, level=level, shared=frame.noise_is_shared)
        mixed, share = mix_noisy(mixed, noisy, proved), share + proved * (np.float32(1.0) - share)
    return Mixture(mixed, share)


def compute_mixture(
    noisy: FloatArray,
    ours: FloatArray,
    peer: FloatArray,
    network: Perceptron,
    *,
    shared: bool,
) -> FloatArray:
    """Return the shares of our image, the noisy image and the peer's image, (height, width, 3); they sum to 1.

    Parameters
    ----------
    noisy, ours, peer : (height, width, 3)
    network : Perceptron
        It reads the features of `see_mixture` and has three outputs.
    shared
        As in `see_mixture`.
    """
    shares = np.empty((*noisy.shape[:2], 3), np.float32)
    for rows, seen in see_mixture(noisy, ours, peer, shared=shared):
        shares[rows] = compute_shares(seen, network, 3)
    return shares


def see_mixture(
    noisy: FloatArray, ours: FloatArray, peer: FloatArray, *, shared: bool
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield rows and their features: `compute_agreement` of the three images, then `compute_detail` of the peer's
    image.

    The network does not see halves: it would trust our image too much, where textures are in no guide.

    Parameters
    ----------
    noisy, ours, peer : (height, width, 3)
    shared
        As in `lobewise.filters.noise.detail.compute_detail`.
    """
    level = compute_mean_luminance(peer)
    agreement = compute_agreement(peer, ours, noisy, level=level, shared=shared)
    for rows, detail in compute_detail(peer, noisy, halves=None, level=level, shared=shared):
        yield rows, np.concatenate([agreement[rows], detail], axis=-1)


def name_method(
    frame: Frame,
    named: DenoiseSettings,
    chosen: ResolvedSettings,
    *,
    whole: bool = True,
    with_features: bool = False,
) -> str:
    """Return a sentence without a full stop: the filters and networks that make the image of a frame.

    Parameters
    ----------
    frame : Frame
        Prepared as its filters see it.
    named, chosen : DenoiseSettings
        The settings of the user, and what became of them on this frame.
    whole, with_features : bool
        As of `lobewise.denoising.automatic.ask`.
    """
    why_ours = explain_ours(named, whole=whole, with_features=with_features)
    has_layers = frame.radiance.parts is not None
    return describe_method(chosen, name_oidn_guides(frame), why_ours=why_ours, has_layers=has_layers)


def describe_method(
    settings: DenoiseSettings, guides: Sequence[str], *, why_ours: str = "", has_layers: bool = False
) -> str:
    """Return a sentence without a full stop: the filters and networks that make the image.

    Parameters
    ----------
    settings : DenoiseSettings
        Its quality and its ``with_oidn`` are chosen.
    guides : sequence of str
        Result of `lobewise.peers.name_oidn_guides`.
    why_ours : str
        Result of `lobewise.denoising.automatic.explain_ours`.
    has_layers : bool
        Whether the frame holds several layers of light.
    """
    ours = "lobewise's own filters"
    if settings.similarity != "auto":
        similarity = get_similarity(settings.similarity)
        knows = similarity.has_lobes or "normal" in guides
        ours += f", comparing {similarity.compares if knows else 'the picture alone'}"
    if not settings.asks_for_oidn:
        return f"{ours}, quality {settings.quality}" + (f" ({why_ours})" if why_ours else "")
    if guides:
        layers = " and layer by layer" if has_layers else ""
        return f"{_describe_peer(guides)}{layers}, mixed pixel by pixel with {ours}"
    return f"{_describe_peer(())}, alone, because the frame has neither albedo nor normals"


def describe_peer_alone(frame: Frame) -> str:
    """Return `describe_method` where no filter of lobewise can run."""
    return f"{_describe_peer(name_oidn_guides(frame))}, alone, because no filter of lobewise can run here"


def _describe_peer(guides: Sequence[str]) -> str:
    return "Open Image Denoise " + (f"with and without {' and '.join(guides)}" if guides else "without guides")


class Shares(NamedTuple):
    """An image and the light that it is made of.

    Parameters
    ----------
    image : (height, width, 3)
        The sum of the parts, plus the exact light times its gain.
    parts : list of (height, width, 3)
        Light that surfaces scatter.
    gain : (height, width, 3)
        Factor of the exact light, which no surface scatters (emission, background), >= 0; mostly 1.
    """

    image: FloatArray
    parts: list[FloatArray]
    gain: FloatArray


def share_out(
    image: FloatArray, before: FloatArray, parts: Sequence[FloatArray], surface: NDArray[np.bool_] | None = None
) -> Shares:
    """Return the parts of ``before``, scaled so that they and the exact light sum to ``image``.

    The exact light is the light of ``before`` that is in no part. It stays, and each part keeps its share of the rest,
    as long as that changes the parts by at most `MAX_RATIO_TO_IMAGE` times more or less than the image. Beyond, exact
    light is scaled as well: at a lamp a small error of the mixture would otherwise become many times the light that the
    lamp's surface scatters, and out of focus the exact light is noisy.

    Where ``before`` is black, as between the few samples of a volume, the parts take the light of ``image`` as they
    share the light around. Where they have none around, and in a transparent background, the pixel stays
    black.

    Parameters
    ----------
    image, before : (height, width, 3)
        The mixture, and our image that it was mixed from.
    parts : sequence of (height, width, 3)
        Parts of ``before``; bad pixels count as 0.
    surface : (height, width), bool, optional
        Pixels that see a surface; by default all.
    """
    good = [make_finite(part) for part in parts]
    filtered = reduce(np.add, good)
    rest = np.maximum(before - filtered, np.float32(0.0))
    scattered, exact = filtered > MAX_BLACK_RADIANCE, rest > MAX_BLACK_RADIANCE

    # Scale the parts: alone, or together with the exact light.
    alone = _divide(image - rest, filtered, scattered)
    change, most = _divide(image, before, scattered & exact), np.float32(MAX_RATIO_TO_IMAGE)
    bounded = np.minimum(np.clip(alone, change / most, change * most), _divide(image, filtered, scattered))
    factor = np.where(exact, bounded, alone)
    others = image - factor * filtered
    gain = np.divide(
        np.maximum(others, np.float32(0.0)),
        rest,
        out=np.ones_like(rest),
        where=exact & (~scattered | (factor != alone)),
    )
    scaled = [part * factor for part in good]

    # Black pixels: give the light to the parts that have light around.
    black = ~(scattered | exact)
    if (image[black] > 0.0).any():
        shares = compute_shares_near(good)
        may_be_lit = mark_lit_beside(np.any(before > MAX_BLACK_RADIANCE, axis=-1), surface)
        lit = black & (sum_finite(shares) > 0.0) & may_be_lit[..., None]
        image = np.where(black & ~lit, before, image)
        light: FloatArray = np.where(lit, image, np.float32(0.0))
        scaled = [part + light * share for part, share in zip(scaled, shares, strict=True)]
    return Shares(image, scaled, gain)


def mark_lit_beside(lit: NDArray[np.bool_], surface: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Return the pixels that may have light, (height, width): surfaces, and what lies in fog.

    Where no surface is, fog has light in most pixels around. A transparent background has some beside objects alone.

    Parameters
    ----------
    lit : (height, width), bool
        Pixels with light.
    surface : (height, width), bool, optional
        Pixels that see a surface; by default all.
    """
    if surface is None:
        return np.ones_like(lit)
    around, lit_around = (count_neighbours(mask, NEAR_RADIUS) for mask in (~surface, lit & ~surface))
    return np.asarray(surface | (lit_around > MIN_SHARE_LIT * around))


def compute_shares_near(parts: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the shares that parts have of the light within `NEAR_RADIUS` of each pixel; 0 where they have no light."""
    near = [np.minimum(sum_square(part, NEAR_RADIUS), np.float32(MAX_NEAR)) for part in parts]
    total = sum_finite(near)
    return [_divide(light, total, total > MAX_BLACK_RADIANCE) for light in near]


def make_finite(light: FloatArray) -> FloatArray:
    """Return light with 0 where it is not finite."""
    return np.where(np.isfinite(light), light, np.float32(0.0))


def sum_finite(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the sum of parts; what is not finite counts as 0."""
    return reduce(np.add, map(make_finite, parts))


def share_by_noise(image: FloatArray, parts: Sequence[FloatArray], noisy: Sequence[FloatArray]) -> list[FloatArray]:
    """Return parts that sum to an image. Each takes as much of the difference as its samples have of the noise.

    Where the difference is larger than the noise explains, all parts keep their shares of the image. So a dim part
    without noise does not take the errors of a bright one. Where a part is below 0, it takes its share of the whole
    difference, and so it does where no part has light.

    Parameters
    ----------
    image : (height, width, 3)
        Finite.
    parts, noisy : sequences of (height, width, 3)
        The filtered parts and their samples. What is not finite counts as 0.
    """
    good, samples = ([make_finite(each) for each in some] for some in (parts, noisy))
    side, most_noise = np.float32(2 * NOISE_RADIUS + 1), np.float32(math.sqrt(MAX_NEAR))
    variances = [
        sum_square(np.square(np.clip(one - part, -most_noise, most_noise)), NOISE_RADIUS) / (side * side)
        for part, one in zip(good, samples, strict=True)
    ]
    apart, total = image - sum_finite(good), sum_finite(variances)
    shared, added = [], []
    for part, variance in zip(good, variances, strict=True):
        share = np.divide(variance, total, out=np.full_like(total, 1.0 / len(good)), where=total > 0.0)
        most = np.float32(MAX_DEVIATIONS) * np.sqrt(variance)
        shared.append(np.maximum(part + np.clip(apart * share, -most, most), np.float32(0.0)))
        added.append(part + apart * share)
    together = sum_finite(shared)
    ratio = np.divide(image, together, out=np.ones_like(together), where=together > MAX_BLACK_RADIANCE)
    below = (np.minimum(image, np.min(good, axis=0)) < 0.0) | (together <= MAX_BLACK_RADIANCE)
    return [np.where(below, other, one * ratio) for one, other in zip(shared, added, strict=True)]


def _divide(light: Any, by: Any, where: Any) -> FloatArray:
    """Return a quotient, 0 outside of ``where``."""
    return np.asarray(np.divide(light, by, out=np.zeros_like(by), where=where))


def list_peer_costs(frame: Frame, *, is_best: bool = False, has_kernels: bool = True) -> dict[str, float]:
    """Return the stages of the mixture, and the seconds that each takes for a megapixel."""
    guides = name_oidn_guides(frame)
    if not guides:
        return {name_call(["color"]): 1.5}
    if has_clean_guides(frame):
        calls = {("color", "albedo", "normal"): 3.0, ("color",): 0.6}
    else:
        filtered = ("albedo",) if _smooths_normals(frame, is_best, has_kernels) else guides
        calls = {(name,): 1.4 for name in filtered} | {("color", "albedo", "normal"): 3.0, ("color",): 1.3}
    # The library takes normals only beside an albedo.
    known = ("color", *guides, *(("albedo",) if "normal" in guides else ()))
    layers = len(frame.layers) or 2 * (frame.radiance.parts is not None)
    by_layer = (3.0 if has_clean_guides(frame) else 1.2) if is_best else 0.6
    calls["color", "albedo", "normal"] += by_layer * layers + (3.0 if is_best else 0.0)
    given = {tuple(name for name in images if name in known): cost for images, cost in calls.items()}
    return {**{name_call(images): cost for images, cost in given.items() if images}, CHOOSE: 1.0}


def count_plain_calls(frame: Frame, *, is_best: bool) -> float:
    """Return how many times as long as a plain call all calls of Open Image Denoise for a frame take."""
    costs = list_peer_costs(frame, is_best=is_best)
    return (sum(costs.values()) - costs.get(CHOOSE, 0.0)) / PLAIN_CALL_SECONDS


class LayerImage(NamedTuple):
    """A layer of light as the peer gets it.

    Parameters
    ----------
    samples, ours : (height, width, 3)
        Its noisy light, and our image of it.
    albedo : (height, width, 3), optional
        Its own albedo.
    """

    samples: FloatArray
    ours: FloatArray
    albedo: FloatArray | None


class PeerImages(NamedTuple):
    """What Open Image Denoise makes of a frame, of its color alone, and of each layer; finite, >= 0."""

    image: FloatArray
    unguided: FloatArray
    layers: list[FloatArray]


@keep_library_memory()
def denoise_with_peer(
    frame: Frame,
    samples: FloatArray,
    image: FloatArray,
    layers: Sequence[LayerImage] = (),
    *,
    is_best: bool = False,
    has_kernels: bool = True,
) -> PeerImages:
    """Return what Open Image Denoise makes of samples, (height, width, 3), and of layers.

    It is called with the guides of the frame and without, and for each layer with the layer's own albedo. All results
    have errors of their own, so that their mean is better than each. The library filters a noisy albedo, after
    `mix_albedos`. A noisy normal is smoothed if it has `MIN_SMOOTHED_SPP`, else the library filters it too, as it does
    without kernels. Our ``image`` replaces bad pixels of the samples and of the result.

    With ``is_best``, for the quality "best", the library filters the normal, layers are filtered at a higher quality,
    and the image with guides is the mean of two: the library makes other errors in an image that is turned by half a
    turn.

    Raises
    ------
    MissingDependencyError
        If Open Image Denoise is not installed.
    """
    color, is_clean = _replace_bad(samples, image), has_clean_guides(frame)
    guides = reduce_guides(mix_albedos(frame.gbuffer))
    if not is_clean:
        guides = _clean_guides(guides, frame.spp if _smooths_normals(frame, is_best, has_kernels) else None)
    peer = _call_peer(color, guides, image)
    if not name_oidn_guides(frame):
        return PeerImages(peer, peer, [])
    if is_best:
        turned = GBuffer(**{name: getattr(guides, name)[::-1, ::-1] for name in guides.names})
        peer = np.float32(0.5) * (peer + _call_peer(color[::-1, ::-1], turned, image[::-1, ::-1])[::-1, ::-1])
    # Layers: each with its own albedo. Without much light our image stands for the library's.
    quality, share = (BEST_LAYERS_QUALITY, BEST_LAYERS_SHARE) if is_best else (LAYERS_QUALITY, LAYERS_SHARE)
    normal = reduce_guides(frame.gbuffer).denoiser_normal
    by_layers, least = [], MIN_LAYER_SHARE * compute_mean_luminance(image)
    for layer in layers:
        if compute_mean_luminance(layer.ours) < least:
            by_layers.append(layer.ours)
            continue
        # Light in a volume has no surface, and no albedo.
        own = GBuffer() if layer.albedo is None else GBuffer(denoiser_albedo=layer.albedo, denoiser_normal=normal)
        samples = _replace_bad(layer.samples, layer.ours)
        by_layers.append(_call_peer(samples, own, layer.ours, is_noisy=not is_clean, quality=quality))
    if layers:
        changes = [clean - layer.ours for clean, layer in zip(by_layers, layers, strict=True)]
        summed = np.maximum(reduce(np.add, changes, image), np.float32(0.0))
        peer = average_alike(peer, _replace_bad(summed, image), share, frame.spp)
    # Color alone.
    unguided = _call_peer(color, GBuffer(), image, quality=UNGUIDED_QUALITY_CLEAN if is_clean else UNGUIDED_QUALITY)
    return PeerImages(average_alike(peer, unguided, UNGUIDED_SHARE, frame.spp), unguided, by_layers)


def _smooths_normals(frame: Frame, is_best: bool, has_kernels: bool) -> bool:
    return has_kernels and not is_best and frame.spp is not None and frame.spp >= MIN_SMOOTHED_SPP


def _clean_guides(guides: GBuffer, spp: float | None) -> GBuffer:
    """Return the images of `reduce_guides` without most of their noise; with ``spp`` the normal is smoothed."""
    normal = guides.denoiser_normal
    if normal is None or spp is None:
        return prefilter_guides(guides, PREFILTER_QUALITY)
    # The library's filter of normals takes 0.8 of a plain call.
    deviation = np.float32(NORMAL_DEVIATION / math.sqrt(spp))
    (smooth,) = HERE.pixels(define_smooth, {"image": normal}, {"deviation": deviation})
    albedo = prefilter_guides(replace(guides, denoiser_normal=None), PREFILTER_QUALITY).denoiser_albedo
    return GBuffer(denoiser_albedo=albedo, denoiser_normal=smooth)


def _call_peer(
    color: FloatArray, guides: GBuffer, ours: FloatArray, *, is_noisy: bool = False, quality: str = "high"
) -> FloatArray:
    """Return what Open Image Denoise makes of color and guides; our image ``ours`` replaces bad pixels of it."""
    frame = Frame(Radiance(color), guides)
    return _replace_bad(denoise_oidn(frame, quality=quality, guides="noisy" if is_noisy else "mean")[0], ours)


def mix_layers(
    image: FloatArray, parts: Sequence[FloatArray], layers: Sequence[FloatArray]
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the means of our parts and of the peer's, and our ``image`` with these parts in place of its own.

    Each has errors of its own, as in `denoise_with_peer`. Where all parts of ours are black they stay black. Without
    ``layers`` of the peer nothing changes.
    """
    if not layers:
        return image, list(parts)
    total = reduce(np.add, map(make_finite, parts))
    rest = np.maximum(image - total, np.float32(0.0))
    share = np.where(total > MAX_BLACK_RADIANCE, np.float32(0.5), np.float32(0.0))
    mixed = [make_finite(part + share * (clean - part)) for part, clean in zip(parts, layers, strict=True)]
    return _replace_bad(reduce(np.add, mixed, rest), image), mixed


def mix_albedos(guides: GBuffer) -> GBuffer:
    """Return guides whose ``denoiser_albedo`` is mixed with the sum of the lobes' albedos by `LOBE_ALBEDO_SHARE`.

    Blender's Denoising Data look through glass and mirrors, its color passes do not: each is better on some frames.
    """
    own, parts = guides.denoiser_albedo, (guides.mean_diffuse_albedo, guides.mean_specular_albedo)
    if own is None or parts[0] is None or parts[1] is None:
        return guides
    total = np.clip(parts[0] + parts[1], np.float32(0.0), np.float32(1.0))
    return replace(guides, denoiser_albedo=own + np.float32(LOBE_ALBEDO_SHARE) * (total - own))


def _replace_bad(image: FloatArray, other: FloatArray) -> FloatArray:
    good = mark_good(image)
    return image if good.all() else np.where(good[..., None], image, other)


def average_alike(guided: FloatArray, unguided: FloatArray, most: float, spp: float | None) -> FloatArray:
    """Return the image with guides, and a share of the one without where both are about as bright, (height, width, 3).

    Where the images are far apart, the one without guides has lost what only guides tell, and its share falls.

    Parameters
    ----------
    guided, unguided : (height, width, 3)
        Radiance, finite, >= 0.
    most : float
        Share of ``unguided`` where it equals ``guided``.
    spp : float, optional
        Samples per pixel, > 0; `USUAL_SPP` where they are not known.
    """
    half_share = np.float32(HALF_SHARE_DIFFERENCE / math.sqrt(spp or USUAL_SPP))
    floor = np.float32(PEER_DARK_SHARE * compute_mean_luminance(guided))
    mixed = np.empty_like(guided)
    for rows in cut_rows(*guided.shape[:2]):  # a chunk stays in the core's cache
        change = unguided[rows] - guided[rows]
        unit = np.maximum(compute_image_luminance(guided[rows]) + floor, np.float32(MAX_BLACK_RADIANCE))
        apart = compute_image_luminance(change) / (half_share * unit)
        with np.errstate(over="ignore"):  # an infinite difference has no share
            share = np.float32(most) / (np.float32(1.0) + apart * apart)
        mixed[rows] = guided[rows] + share[..., None] * change
    return mixed


def compute_mean_luminance(image: FloatArray) -> float:
    """Return the mean luminance."""
    return float(np.mean(compute_image_luminance(image), dtype=np.float64))
