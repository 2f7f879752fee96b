"""The quality "high": several averages of every layer, from narrow to wide, and the best mixture of them per pixel.

How wide to average is a trade of noise for blur that changes from pixel to pixel. Here thirteen filters run, each
guided by what those before it found, and a small network, trained on scenes that are made at random
(``benchmarks/training/train.py``), says in which proportions they count. It sees how noisy each is, how far they are
apart and what kind of surface a pixel shows, all of it relative, so that neither exposure nor sample count matters.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from lobewise.backend.buffers import Image, download
from lobewise.denoising.guided import (
    CleanLayer,
    compare_halves,
    filter_samples,
    finish_layer,
    make_pass_guide,
)
from lobewise.denoising.noisy import NoisyLayer, make_pass_features
from lobewise.denoising.plans import Pass
from lobewise.filters.compositing import REACH as COVERAGE_REACH
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.dual_buffer import DualBufferOutput, filter_dual_buffer
from lobewise.filters.dual_buffer_pass import Exponents
from lobewise.filters.fireflies import REACH as FIREFLY_REACH
from lobewise.filters.highlights import REACH as HIGHLIGHT_REACH
from lobewise.filters.mixing import Network, mix_candidates
from lobewise.filters.mixing_pass import REACH as MIXING_REACH
from lobewise.filters.noise.residuals import REACH as RESIDUAL_REACH
from lobewise.filters.noise_guides import BLUR_RADIUS as GUIDE_REACH
from lobewise.frame import FloatArray, Frame
from lobewise.guides.lobe_fields import SPREAD_REACH
from lobewise.lobes.vectors import LUMINANCE
from lobewise.settings import ResolvedSettings

PILOT = Pass(5, 6.0, 40.0, lobes=4.0)
NOISE = {"diffuse": 12.0, "specular": 6.0}
"""Variances of the guide by which the dense passes divide squared differences."""
SIGMA = 30.0
"""Standard deviation of the distance, pixels and footprints, at radius 8, of a variant whose exponent of place is 1."""
DENSE = (
    (Exponents(25.0, 2.0, 1.0, 2.0), Exponents(6.0, 1.0, 1.0), Exponents(1.0, 1.0, 1.0)),
    (Exponents(225.0, 4.0, 1.0, 2.0), Exponents(64.0, 2.0, 1.0, 2.0), Exponents(25.0, 4.0, 0.3, 2.0)),
    (Exponents(6.0, 4.0, 1.0, 2.0), Exponents(1.0, 0.25, 1.0, 2.0), Exponents(1.0, 2.0, 0.3)),
)
"""Variants guided by the pilot, in three passes because sums of more would not stay in registers: narrow, middle and
wide (sigmas of 6, 12 and 30 pixels); narrower (2 and 4); and such as trust lobes or guide more or less."""
SPARSE = (Exponents(1.0, 1.0, 1.0), Exponents(1.0, 0.25, 0.3))
"""Guided by what they average: the wide one, then the first of these."""
SPARSE_RADIUS, SPARSE_NOISE = 3, 6.0
SPARSE_STEPS = (4, 10)
"""Pixels from tap to tap of the sparse passes, at radius 8; the second averages what the first gave."""
NARROW, MIDDLE, WIDE = range(3)
"""Which candidates, all of the first dense pass, tell how many samples there are, which the others are compared with,
and which the sparse passes begin with."""
COUNT = sum(map(len, DENSE)) + len(SPARSE_STEPS) * len(SPARSE)
EXTRAS = 7
WEIGHTS = "weights.npz"
SMALLEST_ALPHA = 1e-3


class Candidates(NamedTuple):
    """Several averages of one layer, and what else a network sees.

    Parameters
    ----------
    pairs : list of (a, b)
        Both halves of each, `COUNT` of them. Their supports are let go, which would take a third as much memory.
    middle : DualBufferOutput
        One of them, whole: what the others are compared with.
    extras : (height, width, EXTRAS)
        Base-2 logarithms: what the narrow and the middle candidate are worth in samples, the variance of the pilot's
        and of the wide candidate's guide, the albedo's luminance, the geometric mean of the alphas and their ratio (0
        both in a diffuse layer).
    """

    pairs: list[tuple[Image, Image]]
    middle: DualBufferOutput
    extras: FloatArray


def list_sparse(radius: int) -> list[tuple[int, int]]:
    """Return radius in taps and step of each sparse pass at ``radius`` of the settings."""
    return [(min(SPARSE_RADIUS, radius), max(round(step * radius / 8.0), 1)) for step in SPARSE_STEPS]


def find_high_reach(settings: ResolvedSettings) -> int:
    """Return from how many pixels away `mix_layer` can be told anything."""
    kernels = [PILOT.get_kernel(settings.radius, follows=False), (settings.radius, 1), *list_sparse(settings.radius)]
    # Every pass reads the one before through the blurred variance of its guide.
    passes = sum(taps * step + GUIDE_REACH for taps, step in kernels)
    found = FIREFLY_REACH + HIGHLIGHT_REACH + RESIDUAL_REACH + SPREAD_REACH
    return found + passes + MIXING_REACH + COVERAGE_REACH


def find_candidates(frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings) -> Candidates:
    """Run every filter of a layer."""
    layer = noisy.layer
    kind = "diffuse" if noisy.layer.is_diffuse else "specular"
    radius, device = settings.radius, settings.device

    def guide(found: DualBufferOutput) -> Image:
        return compare_halves(noisy, found.a, found.b, device)

    (pilot,) = filter_samples(
        noisy,
        make_pass_features(frame, settings, PILOT.sigma),
        noisy.pilot_features,
        [Exponents(1.0, PILOT.lobes, 1.0)],
        radius=PILOT.get_kernel(radius, follows=False)[0],
        albedo=layer.albedo,
        guide=make_pass_guide(noisy, None, device),
        noise=PILOT.noise,
        device=device,
    )
    place = make_pass_features(frame, settings, SIGMA)
    piloted = guide(pilot)
    del pilot
    pairs: list[tuple[Image, Image]] = []
    first: list[DualBufferOutput] = []
    for variants in DENSE:
        dense = filter_samples(
            noisy,
            place,
            layer.features,
            variants,
            radius=radius,
            seen=noisy.seen,
            albedo=layer.albedo,
            guide=piloted,
            noise=NOISE[kind],
            device=device,
        )
        first = first or dense
        pairs += [(each.a, each.b) for each in dense]
    narrow, middle, source = first[NARROW], first[MIDDLE], first[WIDE]
    guides = [guide(source)]
    for number, (taps, step) in enumerate(list_sparse(radius)):
        if number > 0:
            guides.append(guide(source))
        sparse = filter_dual_buffer(
            (source.a, source.b),
            layer.mask,
            place,
            layer.features,
            SPARSE,
            radius=taps,
            seen=noisy.seen,
            step=step,
            guide=guides[-1],
            noise=SPARSE_NOISE,
            device=device,
        )
        pairs += [(each.a, each.b) for each in sparse]
        source = sparse[0]
    extras = [download(each) for each in (narrow.effective_samples, middle.effective_samples)]
    extras += [download(each)[..., -1] for each in (piloted, guides[0])]
    return Candidates(pairs, middle, _take_logarithms(frame, noisy, extras, kind))


def _take_logarithms(frame: Frame, noisy: NoisyLayer, extras: list[FloatArray], kind: str) -> FloatArray:
    one: FloatArray = np.ones(frame.shape, dtype=np.float32)
    guides, albedo = frame.gbuffer, noisy.layer.albedo
    roughness: FloatArray = one
    ratio: FloatArray = one
    with np.errstate(invalid="ignore"):
        tint: FloatArray = one
        if albedo is not None:
            # No matrix product: its library may add up in another order where rows are few.
            tint = np.sum([np.float32(share) * albedo[..., k] for k, share in enumerate(LUMINANCE)], axis=0)
        if kind == "specular" and guides.alpha_u is not None:
            alpha_u = np.maximum(guides.alpha_u, SMALLEST_ALPHA)
            alpha_v = alpha_u if guides.alpha_v is None else np.maximum(guides.alpha_v, SMALLEST_ALPHA)
            roughness = np.sqrt(alpha_u * alpha_v, dtype=np.float32)
            ratio = np.divide(alpha_u, alpha_v, dtype=np.float32)
        logs = np.empty((*frame.shape, EXTRAS), dtype=np.float32)
        for number, image in enumerate([*extras, np.maximum(tint, ALBEDO_FLOOR), roughness, ratio]):
            found = np.log2(np.maximum(image, np.float32(1e-8)))
            logs[..., number] = np.where(np.isfinite(found), found, np.float32(0.0))
    return logs


@cache
def load_networks() -> Mapping[str, Network]:
    """Return the trained networks of this package by name.

    "diffuse" and "specular" mix the candidates of a layer; "noisy" gives the noisy image back; "peer" mixes with a
    peer.
    """
    with files("lobewise.denoising").joinpath(WEIGHTS).open("rb") as file:
        arrays = dict(np.load(file, allow_pickle=False))
    return {kind: unpack_network(arrays, kind) for kind in ("diffuse", "specular", "noisy", "peer")}


def unpack_network(arrays: Mapping[str, FloatArray], kind: str) -> Network:
    """Return a network from arrays by name, as `pack_network` makes them."""
    weights = tuple(arrays[f"{kind}_weights_{number}"] for number in range(3))
    biases = tuple(arrays[f"{kind}_biases_{number}"] for number in range(3))
    return Network(arrays[f"{kind}_mean"], arrays[f"{kind}_scale"], weights, biases)  # type: ignore[arg-type]


def pack_network(network: Network, kind: str) -> dict[str, FloatArray]:
    """Return a network as arrays by name."""
    arrays = {f"{kind}_mean": network.mean, f"{kind}_scale": network.scale}
    arrays |= {f"{kind}_weights_{number}": each for number, each in enumerate(network.weights)}
    arrays |= {f"{kind}_biases_{number}": each for number, each in enumerate(network.biases)}
    return arrays


def mix_layer(frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings) -> CleanLayer:
    """Filter a layer in every way and mix what comes out."""
    candidates = find_candidates(frame, noisy, settings)
    kind = "diffuse" if noisy.layer.is_diffuse else "specular"
    light = mix_candidates(
        candidates.pairs, MIDDLE, candidates.extras, noisy.level, load_networks()[kind], settings.device
    )
    return finish_layer(frame, noisy, (light,), candidates.middle)
