"""Our image and that of a neural denoiser, mixed pixel by pixel.

A network that was trained on pictures is good where light is smooth or looks like other pictures; lobes and halves are
good where a surface reflects in a way that only its guides tell. Which of the two to trust is read off the same numbers
as in `lobewise.denoising.high`, by a network that was trained on the same random scenes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lobewise.backend.buffers import download
from lobewise.denoising.bad_pixels import find_good
from lobewise.denoising.high import load_networks
from lobewise.filters.mixing import mix_candidates
from lobewise.frame import FloatArray, Frame
from lobewise.lobes.vectors import LUMINANCE
from lobewise.peers import denoise_oidn

LAYERS = 2
DARKEST = 1e-30
"""Radiance up to which there is no share of it."""


def combine_with_peer(frame: Frame, image: FloatArray, extras: Sequence[FloatArray], device: str) -> FloatArray:
    """Return a mixture of ``image`` and what Open Image Denoise makes of the frame, (height, width, 3).

    Of a frame whose light is not told apart it is what that makes: the network was trained on none.

    Parameters
    ----------
    frame : Frame
        With normals.
    image : (height, width, 3)
        Ours, finite, >= 0.
    extras : sequence of arrays
        What `find_candidates` tells of the diffuse and of the specular layer, or of the only one.
    device : str
        A name from `list_devices`.

    Raises
    ------
    MissingDependencyError
        If Open Image Denoise is not installed.
    """
    peer = denoise_with_peer(frame, image)
    if frame.radiance.parts is None:
        return peer
    pairs, seen = list_pairs(image, peer), join_extras(extras)
    return download(mix_candidates(pairs, 0, seen, find_level(image), load_networks()["peer"], device))


def share_out(image: FloatArray, before: FloatArray, parts: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the parts of ``before`` scaled so that with the rest, which is in neither, they make up ``image``.

    A part keeps its share of both. Where there was nothing of either, or less is left than the rest alone, the parts
    cannot make it up: they stay 0, or become it.

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
    wanted = np.maximum(image - rest, np.float32(0.0))
    factor = np.divide(wanted, filtered, out=np.zeros_like(filtered), where=filtered > DARKEST)
    return [part * factor for part in good]


def denoise_with_peer(frame: Frame, image: FloatArray) -> FloatArray:
    """Return what Open Image Denoise makes of the frame, its bad pixels replaced by ours; finite, >= 0."""
    color = frame.radiance.color
    good = find_good(color)
    if not good.all():
        frame = frame.with_changes(radiance=type(frame.radiance)(np.where(good[..., None], color, image)))
    peer, _ = denoise_oidn(frame, guides="mean")
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
