"""Our image and that of a neural denoiser, mixed pixel by pixel.

A network that was trained on pictures is good where light is smooth or looks like other pictures; lobes and halves are
good where a surface reflects in a way that only its guides tell. Which of the two to trust is read off the same numbers
as in `lobewise.denoising.high`, by a network that was trained on the same random scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lobewise.backend.buffers import download
from lobewise.denoising.bad_pixels import find_good
from lobewise.denoising.high import load_networks
from lobewise.filters.mixing import mix_candidates
from lobewise.frame import FloatArray, Frame
from lobewise.lobes.vectors import LUMINANCE
from lobewise.peers import denoise_oidn
from lobewise.settings import DenoiseSettings

LAYERS = 2
DARKEST = 1e-30
"""Radiance up to which there is no share of it."""


def choose_between(
    frame: Frame, ours: FloatArray, peer: FloatArray, extras: Sequence[FloatArray], device: str
) -> FloatArray:
    """Return of every pixel how much of our image and of the peer's there is in the result, mixed, (height, width, 3).

    Of a frame whose light is not told apart it is the peer's image: the network was trained on none.

    Parameters
    ----------
    frame : Frame
        The noisy one.
    ours, peer : (height, width, 3)
        Finite, >= 0; the peer's is that of `denoise_with_peer`.
    extras : sequence of arrays
        What `find_candidates` tells of the diffuse and of the specular layer, or of the only one.
    device : str
        A name from `list_devices`.
    """
    if not can_mix(frame):
        return peer
    pairs, seen = list_pairs(ours, peer), join_extras(extras)
    return download(mix_candidates(pairs, 0, seen, find_level(ours), load_networks()["peer"], device))


def can_mix(frame: Frame) -> bool:
    """Return whether `choose_between` mixes our image into the peer's."""
    return frame.radiance.parts is not None


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
    compared = "what surfaces reflect"
    if settings.similarity == "normal":
        compared = "which way surfaces face" if "normal" in guides else "the picture alone"
    ours = "lobewise's own filters" + (f", comparing {compared}" if settings.similarity != "auto" else "")
    if not settings.asks_for_oidn:
        return f"{ours}, quality {settings.quality}" + (f" ({why_ours})" if why_ours else "")
    told = f"Open Image Denoise with {' and '.join(guides)}" if guides else "Open Image Denoise without guides"
    if mixes:
        return f"{told}, mixed pixel by pixel with {ours}"
    return f"{told}, alone, because diffuse and specular light are not told apart"


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


def list_pairs(image: FloatArray, peer: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return both images as candidates whose halves are the same."""
    return [(image, image), (peer, peer)]


def join_extras(extras: Sequence[FloatArray]) -> FloatArray:
    """Return what is known of all layers side by side, (height, width, 2 EXTRAS); one layer stands for both."""
    return np.concatenate([*extras, *extras][:LAYERS] if len(extras) < LAYERS else list(extras), axis=-1)


def find_level(image: FloatArray) -> float:
    """Return the mean luminance."""
    return float(np.mean(image @ np.array(LUMINANCE, dtype=np.float32), dtype=np.float64))
