"""What "auto" stands for on a frame, and how noisy that is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.devices import choose_device
from lobewise.denoising.planning.layer_plans import AUTO_SIGMA
from lobewise.errors import InputError, require_choice
from lobewise.frame import Frame
from lobewise.lobes.band_limit import default_tau
from lobewise.peers import explain_no_oidn, has_oidn
from lobewise.settings import DenoiseSettings, Quality, ResolvedSettings, Similarity
from lobewise.settings.choices import get_quality
from lobewise.sparse_frame import AnyFrame

DEFAULT_SIMILARITY: Similarity = "ggx"
"""What "auto" takes where the frame has lobes: the winner of benchmarks/results/similarities.json."""
DEFAULT_QUALITY: Quality = "high"
"""What "auto" takes for the full form: the best of ours in the mean of every set of scenes that was measured
(docs/quality.md, docs/quality_results.md, docs/renderers_results.md)."""
BETA_DIFFUSE, BETA_SPECULAR = 2.0, 1.0
"""Exponents of the lobe similarity that "auto" stands for where the passes are guided by the noise."""
GUIDED_TAU = 0.01
"""Band-limit of the lobes, radians, that "auto" stands for where the passes are guided by the noise: lobes need not be
widened for it."""
NOISE, FALL = 0.0825, 0.56
"""Of `expect_noise`: what it is at 4 samples, and with which power of their count it falls."""


def change_settings(settings: DenoiseSettings, changes: Mapping[str, Any]) -> DenoiseSettings:
    """Return settings with single parameters replaced.

    Raises
    ------
    InputError
        If a parameter is unknown or out of range.
    """
    for name in changes:
        require_choice("setting", name, [item.name for item in fields(DenoiseSettings)])
    return replace(settings, **changes)


def ask(
    settings: DenoiseSettings | None, changes: Mapping[str, Any], *, whole: bool = True, with_features: bool = False
) -> DenoiseSettings:
    """Return what `denoise` is asked for: settings with single parameters replaced, quality and ``with_oidn`` chosen.

    Parameters
    ----------
    settings, changes
        As of `denoise`.
    whole : bool
        Whether the image is denoised as a whole, which Open Image Denoise needs.
    with_features : bool
        Whether pixels are compared by features of the caller, of which Open Image Denoise would know nothing.

    Raises
    ------
    InputError
        If a parameter is unknown or out of range.
    """
    asked = change_settings(settings or DenoiseSettings(), changes)
    with_oidn = asked.asks_for_oidn or (whole and not with_features and leaves_oidn_open(asked) and has_oidn())
    return replace(asked, quality=choose_quality(asked), with_oidn=with_oidn)


def explain_ours(settings: DenoiseSettings, *, whole: bool = True, with_features: bool = False) -> str:
    """Return why Open Image Denoise is left out although that is left to `denoise`; empty where it is not left out.

    Parameters
    ----------
    settings : DenoiseSettings
        Before anything is chosen.
    whole, with_features : bool
        As of `ask`.
    """
    if not leaves_oidn_open(settings):
        return ""
    if with_features:
        return "Open Image Denoise knows no features of your own"
    return explain_no_oidn() if whole else "Open Image Denoise takes whole images, and this one is denoised in bands"


def choose_quality(settings: DenoiseSettings) -> Quality:
    """Return the quality that "auto" stands for in `denoise`; others are returned as they are."""
    if settings.quality != "auto":
        return settings.quality
    if settings.asks_for_oidn:
        return "high"
    return DEFAULT_QUALITY if settings.form == "full" else "fast"


def leaves_oidn_open(settings: DenoiseSettings) -> bool:
    """Return whether it is left to `denoise` to use Open Image Denoise: nothing is named that excludes it."""
    return settings.with_oidn == "auto" and settings.quality == "auto" and settings.form == "full"


def require_plain(settings: DenoiseSettings, what: str) -> None:
    """Raise InputError if ``settings`` ask for a quality that ``what`` does not have."""
    guided = settings.quality != "auto" and get_quality(settings.quality).reads_halves
    if guided or settings.asks_for_oidn:
        raise InputError(
            "quality",
            expected=f"'fast' for {what}",
            got="with_oidn" if settings.asks_for_oidn else repr(settings.quality),
            action="leave it out, or denoise frame by frame",
        )


def require_full(settings: DenoiseSettings) -> None:
    """Raise InputError if ``settings`` ask for a form that upsampling does not have."""
    if settings.form != "full":
        raise InputError("form", expected="'full'", got=repr(settings.form), action="upsampling has no other form")


def choose_similarity(frame: AnyFrame, settings: DenoiseSettings) -> Similarity:
    """Return the similarity that "auto" stands for on this frame; others are returned as they are."""
    if settings.similarity != "auto":
        return settings.similarity
    guides = frame.gbuffer
    has_lobes = guides.normal is not None and guides.alpha_u is not None and frame.is_placed
    return DEFAULT_SIMILARITY if has_lobes else "normal"


def choose_beta(spp: float) -> float:
    """Return the exponent of the lobe similarity for a sample count: narrower kernels as the noise falls.

    The bias of a kernel grows with the square of its area and the variance falls with it, so the best exponent goes
    with the cube root of the sample count; the factor is fitted (benchmarks/results/similarities.json, "tuned beta").
    """
    return min(max(2.5 * math.pow(spp, 1.0 / 3.0), 1.0), 64.0)


def choose_screen_sigma(spp: float, radius: int) -> float:
    """Return the standard deviation of the screen distance, pixels, for a sample count.

    It bounds what lobes cannot see: how fast the reflected light itself changes.
    """
    return max(radius * min(1.0, 0.6 * math.pow(8.0 / max(spp, 1.0), 0.25)), 0.5)


def choose_tau(spp: float, pixel_tau: float) -> float:
    """Return the band-limit of the lobes, radians, for a sample count; never below that of a pixel.

    A sharp lobe passes the noise of what it reflects, so few samples ask for more smoothing than the pixel does, and
    mirrors become sharp as their noise goes. The factor was fitted on the built-in scenes.
    """
    return max(0.03 * math.sqrt(4.0 / max(spp, 0.25)), pixel_tau)


def can_use_hits(frame: AnyFrame) -> bool:
    """Return whether the frame tells where its surfaces are and how far away is what they reflect."""
    return frame.gbuffer.hit_distance is not None and frame.is_placed


def needs_spp(settings: DenoiseSettings) -> bool:
    """Return whether what "auto" stands for depends on the noise, for the quality "fast"."""
    return "auto" in (settings.screen_sigma, settings.tau, settings.beta, settings.diffuse_beta)


def resolve_all(frame: Frame, asked: DenoiseSettings, spp: float | None = None) -> ResolvedSettings:
    """Return settings with every "auto" replaced, for their own quality; for ``spp`` see `resolve_settings`."""
    guided = get_quality(choose_quality(asked)).reads_halves
    return resolve_guided(frame, asked) if guided else resolve_settings(frame, asked, spp=spp)


def resolve_guided(frame: Frame, settings: DenoiseSettings) -> ResolvedSettings:
    """Return ``settings`` with every "auto" replaced, for a quality whose passes are guided by the noise."""
    pixel_tau = default_tau(frame.camera, frame.height) if frame.camera is not None else 0.0
    sigma = AUTO_SIGMA * max(settings.radius, 1) / 8.0
    told = replace(
        settings,
        beta=BETA_SPECULAR if settings.beta == "auto" else settings.beta,
        diffuse_beta=BETA_DIFFUSE if settings.diffuse_beta == "auto" else settings.diffuse_beta,
        tau=max(GUIDED_TAU, pixel_tau) if settings.tau == "auto" else settings.tau,
        screen_sigma=sigma if settings.screen_sigma == "auto" else settings.screen_sigma,
    )
    return replace(resolve_settings(frame, told), quality=choose_quality(settings), with_oidn=settings.asks_for_oidn)


def resolve_settings(
    frame: AnyFrame, settings: DenoiseSettings, scale: int = 1, *, spp: float | None = None
) -> ResolvedSettings:
    """Return ``settings`` with every "auto" replaced by what it stands for on this frame, for the quality "fast".

    With one of ``scale`` times ``scale`` pixels shaded there are fewer samples for the same area, so the screen sigma
    and the band-limit are those of fewer samples per pixel. The lobe similarity gets stricter instead, because
    samples of another material are as near as those of the own one (fitted on the built-in scenes at scale 4).
    What lobes hit is compared only where that is asked for: it costs time and gains nothing in the mean.
    ``spp`` is what `estimate_spp` says of the whole image, where the frame is a part of it.
    """
    sigma, tau = settings.screen_sigma, settings.tau
    if spp is None:
        # It looks at every pixel, so only where it is asked for.
        spp = estimate_spp(frame) if needs_spp(settings) else 1.0
    density = 1.0 / scale**2
    beta = choose_beta(spp) * math.pow(density, -0.15)
    pixel_tau = default_tau(frame.camera, frame.height) if frame.camera is not None else 0.0
    if tau == "auto":
        # Half way between noise and count: noise that is not the lobe's own (small lights seen in a mirror) stays.
        tau = max(scale * choose_tau(math.sqrt(spp * (frame.spp or spp)), 0.0), pixel_tau)
    return ResolvedSettings(
        quality="fast",
        similarity=choose_similarity(frame, settings),
        form=settings.form,
        radius=settings.radius,
        beta=beta if settings.beta == "auto" else float(settings.beta),
        diffuse_beta=beta if settings.diffuse_beta == "auto" else float(settings.diffuse_beta),
        device=choose_device(settings.device),
        screen_sigma=choose_screen_sigma(density * spp, settings.radius * scale) if sigma == "auto" else float(sigma),
        position_sigma=settings.position_sigma,
        tau=float(tau),
        normal_exponent=settings.normal_exponent,
        band_limit=settings.band_limit,
        lobes=settings.lobes,
        hit_distance=settings.hit_distance not in ("auto", False),
        with_oidn=False,
    )


def estimate_spp(frame: AnyFrame) -> float:
    """Return how many samples per pixel of a well-lit scene the noise is worth, > 0; see `judge_noise`."""
    return judge_noise(list_relative_variances(frame), frame.spp)


def list_relative_variances(frame: AnyFrame) -> NDArray[np.float64]:
    """Return the variance of the mean over its square at every lit pixel, (count,); none without variance."""
    if frame.variance is None:
        return np.empty(0)
    # The square of a very dim mean underflows in float32.
    mean, variance = (
        (image[..., 0].astype(np.float64) + image[..., 1] + image[..., 2]) / 3.0
        for image in (frame.radiance.color, frame.variance.color)
    )
    lit = np.isfinite(mean) & np.isfinite(variance) & (mean > 0.0) & (variance >= 0.0)
    return np.asarray(variance[lit] / mean[lit] ** 2)


def judge_noise(variances: NDArray[np.float64], spp: int | None) -> float:
    """Return how many samples per pixel of a well-lit scene the noise is worth, > 0.

    Where the frame has its variance, the median relative variance of the mean is compared with what a well-lit scene
    has at the same sample count, `expect_noise`. A dim, indirectly lit room is then worth fewer samples than it took.
    Without variance it is the sample count itself, and without that 4.

    Parameters
    ----------
    variances : (count,)
        What `list_relative_variances` gives.
    spp : int or None
        Samples that the frame took.
    """
    if not variances.size:
        return float(spp or 4.0)
    noise = max(float(np.median(variances)), 1e-9)
    if spp is None:
        return float(np.clip(expect_spp(noise), 0.25, 4096.0))
    return spp / float(np.clip(noise / expect_noise(spp), 0.25, 16.0))


def expect_noise(spp: float) -> float:
    """Return the relative variance that the built-in ``showroom`` has at a sample count, its median over the pixels.

    It falls more slowly than 1/spp because few samples hide the tail.
    """
    return NOISE * math.pow(4.0 / spp, FALL)


def expect_spp(noise: float) -> float:
    """Return at how many samples a pixel `expect_noise` is ``noise``."""
    return 4.0 * math.pow(NOISE / noise, 1.0 / FALL)
