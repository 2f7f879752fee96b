"""The values that "auto" stands for on a frame, and the estimate of its noise that they follow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.devices import choose_device
from lobewise.backend.prebuilt import has_kernels
from lobewise.engine.numbers import choose_larger, choose_smaller, raise_to, take_root
from lobewise.errors import InputError, require_choice
from lobewise.guides.lobe_fields import default_tau
from lobewise.peers import explain_no_oidn, has_oidn
from lobewise.records.frame import Frame
from lobewise.records.sparse_frame import AnyFrame
from lobewise.settings import OIDN_QUALITY, DenoiseSettings, QualityName, ResolvedSettings, SimilarityName
from lobewise.settings.choices import DEFAULT_SIMILARITY, GUIDED_SIMILARITY, get_quality, get_similarity

DEFAULT_QUALITY: QualityName = "high"
"""Quality of "auto" for the full form without Open Image Denoise. It has the least mean error on every set of scenes
(docs/developers/quality.md, docs/developers/quality_results.md, docs/developers/renderers_results.md)."""
FEATURES_QUALITY: QualityName = "balanced"
"""Quality of "auto" for the full form where the caller has features of its own: the network of "high" does not read
them, and softens edges that only they tell (tests/test_examples.py)."""
BETA_DIFFUSE, BETA_SPECULAR = 2.0, 1.0
"""Exponents of the lobe similarity that "auto" stands for where the passes are guided by the noise."""
GUIDED_TAU = 0.01
"""Band-limit of the lobes, radians, that "auto" stands for where the passes are guided by the noise: lobes need not be
widened for it."""
AUTO_SIGMA = 30.0
"""Screen sigma, pixels, that "auto" stands for at radius 8. The sigmas of guided passes are in proportion to it."""
NOISE_AT_4_SPP, NOISE_EXPONENT = 0.0825, 0.56
"""Relative variance that `expect_noise` gives for 4 samples per pixel, and the power of the sample count by which it
falls."""


def change_settings(settings: DenoiseSettings, changes: Mapping[str, Any]) -> DenoiseSettings:
    """Return settings with single parameters replaced.

    Raises
    ------
    InputError
        If a parameter is unknown or out of range.
    """
    known = [item.name for item in fields(DenoiseSettings)]
    for name in changes:
        if name not in known:
            require_choice("setting", name, known)
    return replace(settings, **changes) if changes else settings


def ask(
    settings: DenoiseSettings | None, changes: Mapping[str, Any], *, whole: bool = True, with_features: bool = False
) -> DenoiseSettings:
    """Return the settings that `denoise` runs with: parameters replaced, quality and ``with_oidn`` chosen.

    Parameters
    ----------
    settings, changes
        As of `denoise`.
    whole : bool
        Whether the image is denoised as a whole; Open Image Denoise needs whole images.
    with_features : bool
        Whether the caller compares pixels by features of its own, which neither Open Image Denoise nor the network of
        "high" reads.

    Raises
    ------
    InputError
        If a parameter is unknown or out of range.
    """
    changed = change_settings(settings or DenoiseSettings(), changes)
    with_oidn = changed.asks_for_oidn or (whole and not with_features and leaves_oidn_open(changed) and has_oidn())
    quality = choose_quality(changed)
    if changed.quality == "auto" and changed.form == "full":
        quality = OIDN_QUALITY if with_oidn else FEATURES_QUALITY if with_features else quality
    return replace(changed, quality=quality, with_oidn=with_oidn)


def explain_ours(settings: DenoiseSettings, *, whole: bool = True, with_features: bool = False) -> str:
    """Return why `denoise` leaves Open Image Denoise out on its own; empty where it does not.

    Parameters
    ----------
    settings : DenoiseSettings
        Settings of the user, with every "auto".
    whole, with_features : bool
        As of `ask`.
    """
    if not leaves_oidn_open(settings):
        return ""
    if with_features:
        return "neither Open Image Denoise nor the network of 'high' knows features of your own"
    return explain_no_oidn() if whole else "Open Image Denoise takes whole images, and this one is denoised in bands"


def choose_quality(settings: DenoiseSettings) -> QualityName:
    """Return the quality, with "auto" replaced by the quality that `denoise` takes for it."""
    if settings.quality != "auto":
        return settings.quality
    if settings.asks_for_oidn:
        return OIDN_QUALITY
    return DEFAULT_QUALITY if settings.form == "full" else "fast"


def leaves_oidn_open(settings: DenoiseSettings) -> bool:
    """Return whether `denoise` may choose Open Image Denoise: no setting asks for it or rules it out."""
    return settings.with_oidn == "auto" and settings.quality == "auto" and settings.form == "full"


def needs_peer_alone(settings: DenoiseSettings, *, with_features: bool = False) -> bool:
    """Return whether `denoise` leaves everything to Open Image Denoise: it may choose it, and our filters cannot run.

    ``settings`` are those of the user, with every "auto"; for ``with_features`` see `ask`.
    """
    return leaves_oidn_open(settings) and not with_features and not has_kernels() and has_oidn()


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


def choose_similarity(
    frame: AnyFrame, settings: DenoiseSettings, of_lobes: SimilarityName = DEFAULT_SIMILARITY
) -> SimilarityName:
    """Return the similarity, with "auto" replaced by ``of_lobes`` where the frame has lobes, else by "normal"."""
    if settings.similarity != "auto":
        return settings.similarity
    guides = frame.gbuffer
    needs = get_similarity(of_lobes).needs
    has_lobes = all(getattr(guides, name) is not None for name in needs) and frame.is_placed
    return of_lobes if has_lobes else "normal"


def choose_beta(spp: float) -> float:
    """Return the exponent of the lobe similarity for a sample count: narrower kernels as the noise falls.

    The bias of a kernel grows with the square of its area, and its variance falls with its area. So the best exponent
    is proportional to the cube root of the sample count. The factor is fitted (benchmarks/results/similarities.json,
    "tuned beta").
    """
    return choose_smaller(choose_larger(2.5 * raise_to(spp, 1.0 / 3.0), 1.0), 64.0)


def choose_screen_sigma(spp: float, radius: int) -> float:
    """Return the standard deviation of the screen distance, pixels, for a sample count.

    Lobes do not tell how fast the reflected light changes. The screen distance bounds the error of this.
    """
    share = choose_smaller(1.0, 0.6 * raise_to(8.0 / choose_larger(spp, 1.0), 0.25))
    return choose_larger(radius * share, 0.5)


def choose_tau(spp: float, pixel_tau: float) -> float:
    """Return the band-limit of the lobes, radians, for a sample count; never below that of a pixel.

    A sharp lobe shows the noise of the light that it reflects. So few samples need wider lobes than the pixel asks for,
    and mirrors become sharp as their noise falls. The factor was fitted on the built-in scenes.
    """
    return choose_larger(0.03 * take_root(4.0 / choose_larger(spp, 0.25)), pixel_tau)


def needs_spp(settings: DenoiseSettings) -> bool:
    """Return whether an "auto" of these settings depends on the noise, for the quality "fast"."""
    return "auto" in (settings.screen_sigma, settings.tau, settings.beta, settings.diffuse_beta)


def resolve_all(frame: Frame, settings: DenoiseSettings, spp: float | None = None) -> ResolvedSettings:
    """Return settings with every "auto" replaced, for their own quality; for ``spp`` see `resolve_settings`."""
    guided = get_quality(choose_quality(settings)).reads_halves
    return resolve_guided(frame, settings) if guided else resolve_settings(frame, settings, spp=spp)


def resolve_guided(frame: Frame, settings: DenoiseSettings) -> ResolvedSettings:
    """Return ``settings`` with every "auto" replaced, for a quality whose passes are guided by the noise."""
    pixel_tau = default_tau(frame.camera, frame.height) if frame.camera is not None else 0.0
    sigma = AUTO_SIGMA * max(settings.radius, 1) / 8.0
    guided = replace(
        settings,
        similarity=choose_similarity(frame, settings, GUIDED_SIMILARITY),
        beta=BETA_SPECULAR if settings.beta == "auto" else settings.beta,
        diffuse_beta=BETA_DIFFUSE if settings.diffuse_beta == "auto" else settings.diffuse_beta,
        tau=max(GUIDED_TAU, pixel_tau) if settings.tau == "auto" else settings.tau,
        screen_sigma=sigma if settings.screen_sigma == "auto" else settings.screen_sigma,
    )
    return replace(resolve_settings(frame, guided), quality=choose_quality(settings), with_oidn=settings.asks_for_oidn)


def resolve_settings(
    frame: AnyFrame, settings: DenoiseSettings, scale: int = 1, *, spp: float | None = None
) -> ResolvedSettings:
    """Return ``settings`` with every "auto" replaced by its value for this frame, for the quality "fast".

    Where one of ``scale`` times ``scale`` pixels is shaded, an area has fewer samples. So screen sigma and band-limit
    are those of fewer samples per pixel. The lobe similarity gets stricter instead, because samples of another
    material are as near as samples of the same material (fitted on the built-in scenes at scale 4).

    Parameters
    ----------
    frame : Frame or SparseFrame
    settings : DenoiseSettings
    scale : int
        Pixels from one shaded pixel to the next.
    spp : float, optional
        Result of `estimate_spp` for the whole image, where the frame is a part of it.
    """
    sigma, tau = settings.screen_sigma, settings.tau
    if spp is None:
        # It looks at every pixel, so only where it is asked for.
        spp = estimate_spp(frame) if needs_spp(settings) else 1.0
    density = 1.0 / scale**2
    beta = choose_beta(spp) * math.pow(density, -0.15)
    pixel_tau = default_tau(frame.camera, frame.height) if frame.camera is not None else 0.0
    if tau == "auto":
        # Take the mean of measured noise and sample count: wider lobes do not remove the noise of small lights that a
        # mirror shows.
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
        with_oidn=False,
    )


def estimate_spp(frame: AnyFrame) -> float:
    """Return the samples per pixel at which a well-lit scene has the noise of this frame, > 0; see `judge_noise`."""
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
    """Return the samples per pixel at which a well-lit scene has this noise, > 0.

    Where the frame has a variance, its median relative variance is compared with `expect_noise` at the same sample
    count. A dim, indirectly lit room then counts as fewer samples than it took. Without a variance the result is the
    sample count of the frame, and without a sample count 4.

    Parameters
    ----------
    variances : (count,)
        Result of `list_relative_variances`.
    spp : int or None
        Samples per pixel of the frame.
    """
    if not variances.size:
        return float(spp or 4.0)
    noise = max(float(np.median(variances)), 1e-9)
    if spp is None:
        return float(np.clip(expect_spp(noise), 0.25, 4096.0))
    return spp / float(np.clip(noise / expect_noise(spp), 0.25, 16.0))


def expect_noise(spp: float) -> float:
    """Return the median relative variance of the pixels of the built-in ``showroom`` at a sample count.

    It falls more slowly than 1/spp, because few samples miss the tail of the noise.
    """
    return NOISE_AT_4_SPP * raise_to(4.0 / spp, NOISE_EXPONENT)


def expect_spp(noise: float) -> float:
    """Return the samples per pixel at which `expect_noise` gives ``noise``."""
    return 4.0 * math.pow(NOISE_AT_4_SPP / noise, 1.0 / NOISE_EXPONENT)
