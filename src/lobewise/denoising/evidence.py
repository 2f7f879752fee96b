"""The evidence of the samples about a result: where it lost detail."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import numpy as np

from lobewise import engine
from lobewise.engine.numbers import make_single
from lobewise.filters.compositing import UNKNOWN_SPP
from lobewise.filters.glue import define_good, define_mixed, define_share_taken
from lobewise.filters.mixing import Perceptron
from lobewise.filters.noise.detail import predict_shares
from lobewise.filters.noise.evidence import estimate_noisy_share
from lobewise.filters.noise.pooling import DARK_SHARE
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import ResolvedSettings

HALF_TRUST_SPP = 16.0
"""Samples per pixel at which half of the share that the network says is taken, where no halves prove it."""
MAX_RADIANCE = 1e36
"""Radiance above which no share of a pixel is taken back, because sums of it overflow."""
SHARE_WEIGHTS = "weights.npz"
"""File of the trained networks, beside this module: small perceptrons as arrays by name."""
NAMES = ("noisy", "refined", "peer")
""""noisy" says how much of the noisy image a filtered image takes back, "refined" how much an image takes back that the
refining network made. "peer" mixes a result with the image of Open Image Denoise."""


def estimate_share_lost(
    samples: FloatArray,
    image: FloatArray,
    level: float,
    *,
    halves: tuple[FloatArray, FloatArray] | None,
    shared: bool,
    refined: bool = False,
    spp: float | None = None,
) -> FloatArray:
    """Return the share of the noisy image to take back where the filter removed detail, (height, width), in [0, 1].

    A network says at which share it expects the least error of the mixture. It was trained on random scenes, with and
    without guides and halves (``benchmarks/training/shares.py``). Without halves it takes noise for detail on some
    frames, the more the fewer the samples, so that ``spp / (spp + 16)`` of the share is taken.

    Parameters
    ----------
    samples : array, shape (height, width, 3)
        The noisy image; see `lobewise.filters.fireflies.cut_samples`.
    image : array, shape (height, width, 3)
        The filtered image: the sum of the layers and of the light that is in no layer.
    level : float
        Mean light of the samples of the whole image, radiance over albedo, > 0.
    halves : two arrays, shape (height, width, 3), optional
        Means of one half of the samples each.
    shared : bool
        Whether neighbouring pixels share their noise.
    refined : bool
        Whether the refining network made the image.
    spp : float, optional
        Samples per pixel; `UNKNOWN_SPP` where nobody knows.
    """
    text = "the filtered image, finite"
    (filtered,) = engine.pixels(define_good, {"image": image}, {}, names=["good"], text=text)
    network = load_networks()["refined" if refined else "noisy"]
    shares = predict_shares(filtered, samples, network, halves=halves, level=level, shared=shared)
    # The parts are added later, and near the largest float their sum overflows.
    images = {"color": samples, "shares": shares}
    count = UNKNOWN_SPP if spp is None else spp
    trust = make_single(1.0 / (1.0 + HALF_TRUST_SPP / count) if halves is None else 1.0)
    (share,) = engine.pixels(define_share_taken, images, {"trust": trust}, MAX_RADIANCE, names=["share"])
    return share


def estimate_share_proved(
    image: FloatArray, samples: FloatArray, halves: tuple[FloatArray, FloatArray], *, level: float, shared: bool
) -> FloatArray:
    """Return the share of the noisy image that its halves prove to be missing, (height, width), in [0, 1).

    No network is asked, so that the share is right on textures unlike any of the training, too.

    Parameters
    ----------
    image, samples : (height, width, 3)
        The result so far, finite and >= 0, and the noisy image.
    halves : two arrays, (height, width, 3)
        Means of one half of the samples each.
    level : float
        About the mean luminance of the whole image, > 0.
    shared : bool
        Whether neighbouring pixels share their noise.
    """
    floor = (DARK_SHARE * level) ** 2
    return estimate_noisy_share(image, samples, halves=halves, floor=floor, shared=shared)


def get_image_halves(frame: Frame) -> tuple[FloatArray, FloatArray] | None:
    """Return the images of both halves of the samples, None where the frame has no halves."""
    a, b = frame.half_a, frame.half_b
    return None if a is None or b is None else (a.color, b.color)


def takes_back(frame: Frame, settings: ResolvedSettings) -> bool:
    """Return whether the noisy image is taken back before the mixture, which itself takes back what halves prove."""
    return get_image_halves(frame) is None or not settings.with_oidn


def mix_noisy(part: FloatArray, noisy: FloatArray, share: FloatArray) -> FloatArray:
    """Return a filtered part with a share, (height, width), of its samples; where these are not finite, the part."""
    images, text = {"part": part, "noisy": noisy, "share": share}, "take the noisy light back"
    (mixed,) = engine.pixels(define_mixed, images, {}, names=["mixed"], text=text)
    return mixed


@cache
def load_networks() -> Mapping[str, Perceptron]:
    """Return the networks by name, see `NAMES`."""
    with files("lobewise.denoising").joinpath(SHARE_WEIGHTS).open("rb") as file:
        arrays = dict(np.load(file, allow_pickle=False))
    return {kind: unpack_network(arrays, kind) for kind in NAMES}


def unpack_network(arrays: Mapping[str, FloatArray], kind: str) -> Perceptron:
    """Return a network from the arrays that ``benchmarks/training/shares.py`` writes."""
    weights = tuple(arrays[f"{kind}_weights_{number}"] for number in range(3))
    biases = tuple(arrays[f"{kind}_biases_{number}"] for number in range(3))
    return Perceptron(arrays[f"{kind}_mean"], arrays[f"{kind}_scale"], weights, biases)  # type: ignore[arg-type]
