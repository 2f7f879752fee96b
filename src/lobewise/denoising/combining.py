"""Our image, that of a neural denoiser and the noisy one, mixed pixel by pixel.

A network that was trained on pictures is good where light is smooth or looks like other pictures; lobes and halves are
good where a surface reflects in a way that only its guides tell. Which of the two to trust is read off how far they are
apart, how noisy the image is and which of them the samples are nearer to (`lobewise.filters.noise.agreement`), by a
small network that was trained on random scenes with guides missing (``benchmarks/training/shares.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from lobewise.denoising.bad_pixels import find_good
from lobewise.denoising.evidence import find_image_halves
from lobewise.denoising.networks import load_networks
from lobewise.filters.mixing import Network
from lobewise.filters.noise.agreement import find_agreement
from lobewise.filters.noise.detail import find_detail
from lobewise.filters.noise.shares import find_shares
from lobewise.frame import FloatArray, Frame
from lobewise.lobes.vectors import LUMINANCE
from lobewise.peers import denoise_oidn, name_oidn_guides
from lobewise.settings import DenoiseSettings
from lobewise.settings.choices import get_similarity

DARKEST = 1e-30
"""Radiance up to which there is no share of it."""
TRUST_WITHOUT_HALVES = 0.75
"""What the network's shares are multiplied by where the frame has no halves, unless pixels share samples (the peer
leaves that noise). The network was trained on frames of our renderer. Most files without halves are of others, where it
trusts our image too much (docs/quality.md)."""


def choose_between(frame: Frame, ours: FloatArray, peer: FloatArray, noisy: FloatArray) -> FloatArray:
    """Return a mixture of our image, the peer's and the noisy one, pixel by pixel, (height, width, 3).

    Where the frame has neither albedo nor normal it is the peer's image: the network was trained on no such frame.

    Parameters
    ----------
    frame : Frame
        The noisy one.
    ours, peer : (height, width, 3)
        Finite, >= 0; the peer's is that of `denoise_with_peer`.
    noisy : (height, width, 3)
        The image of the frame without fireflies. Bad pixels are taken from ours.
    """
    if not can_mix(frame):
        return peer
    halves = find_image_halves(frame)
    shares = find_mixture(
        frame.radiance.color,
        ours,
        peer,
        load_networks()["peer"],
        halves=halves,
        shared=frame.noise_is_shared,
    )
    if halves is None and not frame.noise_is_shared:
        shares = shares * np.float32(TRUST_WITHOUT_HALVES)
    noisy = np.where(find_good(noisy)[..., None], noisy, ours)
    mixed = peer + shares[..., :1] * (ours - peer) + shares[..., 1:2] * (noisy - peer)
    # Of images that are many orders of magnitude apart, rounding leaves less than 0.
    return np.maximum(mixed, np.float32(0.0))


def find_mixture(
    noisy: FloatArray,
    ours: FloatArray,
    peer: FloatArray,
    network: Network,
    *,
    halves: tuple[FloatArray, FloatArray] | None,
    shared: bool,
) -> FloatArray:
    """Return the shares of our image, of the noisy one and of the peer's, shape (height, width, 3), which sum to 1.

    Parameters
    ----------
    noisy, ours, peer : (height, width, 3)
    network : Network
        Which reads `see_mixture` and has three outputs.
    halves, shared
        As in `see_mixture`.
    """
    shares = np.empty((*noisy.shape[:2], 3), np.float32)
    for rows, seen in see_mixture(noisy, ours, peer, halves=halves, shared=shared):
        shares[rows] = find_shares(seen, network, 3)
    return shares


def see_mixture(
    noisy: FloatArray,
    ours: FloatArray,
    peer: FloatArray,
    *,
    halves: tuple[FloatArray, FloatArray] | None,
    shared: bool,
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield some rows and what is known of the three images there: `find_agreement`, then `find_detail` of the peer's.

    Parameters
    ----------
    noisy, ours, peer : (height, width, 3)
    halves, shared
        As in `lobewise.filters.noise.detail.find_detail`.
    """
    level = find_level(peer)
    agreement = find_agreement(peer, ours, noisy, halves=halves, level=level, shared=shared)
    for rows, detail in find_detail(peer, noisy, halves=halves, level=level, shared=shared):
        yield rows, np.concatenate([agreement[rows], detail], axis=-1)


def can_mix(frame: Frame) -> bool:
    """Return whether `choose_between` mixes our image into the peer's."""
    return bool(name_oidn_guides(frame))


def describe_method(settings: DenoiseSettings, guides: Sequence[str], *, mixes: bool, why_ours: str = "") -> str:
    """Return in one sentence, without a stop, what makes the image.

    Parameters
    ----------
    settings : DenoiseSettings
        Of which quality and ``with_oidn`` are chosen.
    guides : sequence of str
        What `lobewise.peers.name_oidn_guides` gives.
    mixes : bool
        What `can_mix` gives.
    why_ours : str
        What `lobewise.denoising.automatic.explain_ours` gives.
    """
    ours = "lobewise's own filters"
    if settings.similarity != "auto":
        similarity = get_similarity(settings.similarity)
        knows = similarity.has_lobes or "normal" in guides
        ours += f", comparing {similarity.compares if knows else 'the picture alone'}"
    if not settings.asks_for_oidn:
        return f"{ours}, quality {settings.quality}" + (f" ({why_ours})" if why_ours else "")
    told = f"Open Image Denoise with {' and '.join(guides)}" if guides else "Open Image Denoise without guides"
    if mixes:
        return f"{told}, mixed pixel by pixel with {ours}"
    return f"{told}, alone, because the frame has neither albedo nor normals"


class Shares(NamedTuple):
    """An image, and what makes it up.

    Parameters
    ----------
    image : (height, width, 3)
        The sum of the parts and of the exact light times its gain.
    parts : list of (height, width, 3)
        Light that surfaces scatter.
    gain : (height, width, 3)
        What light that no surface scatters (emission, background) is multiplied by, >= 0; mostly 1.
    """

    image: FloatArray
    parts: list[FloatArray]
    gain: FloatArray


def share_out(image: FloatArray, before: FloatArray, parts: Sequence[FloatArray]) -> Shares:
    """Return the parts of ``before`` scaled so that with the exact light, which is in none, they make up ``image``.

    Exact light stays as it is, and each part keeps its share of what is left. Where the image is darker than the exact
    light alone, or there is no other light, the exact light is scaled instead: out of focus it is noisy, and the
    mixture is not. Where there is no light of either kind the image stays what it was, 0.

    Parameters
    ----------
    image, before : (height, width, 3)
        The mixture, and what it was mixed from.
    parts : sequence of (height, width, 3)
        Of ``before``; bad pixels count as 0.
    """
    good = [np.where(np.isfinite(part), part, np.float32(0.0)) for part in parts]
    filtered = np.sum(good, axis=0, dtype=np.float32)
    rest = np.maximum(before - filtered, np.float32(0.0))
    scattered, exact = filtered > DARKEST, rest > DARKEST
    image = np.where(scattered | exact, image, before)
    scaled = exact & (~scattered | (image < rest))
    gain = np.divide(image, rest, out=np.ones_like(rest), where=scaled)
    wanted = np.where(scaled, np.float32(0.0), image - rest)
    factor = np.divide(wanted, filtered, out=np.zeros_like(filtered), where=scattered)
    return Shares(image, [part * factor for part in good], gain)


def denoise_with_peer(frame: Frame, image: FloatArray) -> FloatArray:
    """Return what Open Image Denoise makes of the frame, its bad pixels replaced by ours; finite, >= 0.

    Raises
    ------
    MissingDependencyError
        If Open Image Denoise is not installed.
    """
    color = frame.radiance.color
    good = find_good(color)
    if not good.all():
        frame = frame.with_changes(radiance=type(frame.radiance)(np.where(good[..., None], color, image)))
    peer, _ = denoise_oidn(frame)
    fine = find_good(peer)
    return peer if fine.all() else np.where(fine[..., None], peer, image)


def find_level(image: FloatArray) -> float:
    """Return the mean luminance."""
    return float(np.mean(image @ np.array(LUMINANCE, dtype=np.float32), dtype=np.float64))
