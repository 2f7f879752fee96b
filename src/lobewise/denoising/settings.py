"""Parameters of the recipe, and what "auto" stands for on a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.devices import choose_device
from lobewise.errors import InputError, describe_problem, require_choice
from lobewise.filters.forms import FORMS
from lobewise.lobe_table import MAX_LOBES
from lobewise.lobes.field import default_tau
from lobewise.sparse_frame import AnyFrame

SIMILARITIES = ("auto", "normal", "sg", "sg_mixture", "asg", "ggx")
DEFAULT_SIMILARITY = "ggx"
"""What "auto" takes where the frame has lobes: the winner of benchmarks/results/similarities.json."""
USE_HITS = False
"""Whether "auto" compares what lobes hit."""
LARGEST_RADIUS = 64
QUALITIES = ("auto", "fast", "balanced", "high")
DEFAULT_QUALITY = "balanced"
"""What "auto" takes for the full form."""


@dataclass(frozen=True)
class DenoiseSettings:
    """Parameters of `denoise`.

    Parameters
    ----------
    quality : {"auto", "fast", "balanced", "high"}
        How the noise enters. "fast" weighs by guides alone, in one pass, as the paper does. "balanced" and "high"
        filter two halves of the samples narrowly, and then widely by what that tells of light and noise; "high" does so
        in several ways and mixes what comes out pixel by pixel. "auto" takes "balanced" for the full form and "fast"
        for the others, which have nothing else; so have upsampling and histories.
    similarity : {"auto", "normal", "sg", "sg_mixture", "asg", "ggx"}
        What is compared on specular pixels: shading normals, one spherical Gaussian per lobe, a sum of them, one
        anisotropic spherical Gaussian, or the GGX covariance of the lobe. "auto" takes "ggx" where the frame has
        roughness and camera, else "normal".
    form : {"full", "separable", "atrous"}
        All (2r+1)^2 taps; a row and a column pass; five 5x5 levels of doubling step (radius 62).
    radius : int
        Kernel radius, pixels, 0 to 64; "atrous" does not use it.
    beta : float or "auto"
        Exponent of the lobe similarity, > 0: larger keeps more detail and more noise. "auto" follows the noise.
    diffuse_beta : float or "auto"
        The same for the overlap of diffuse lobes.
    device : {"auto", "cpu"}
        Where the kernels run.
    screen_sigma : float or "auto"
        Standard deviation of the screen distance, pixels, > 0; not used by "atrous". "auto" follows radius and noise.
    position_sigma : float
        Standard deviation of the distance in the scene, in pixel footprints, > 0.
    tau : float or "auto"
        Band-limit of the lobes, radians, 1e-5 to 1 (see `lobewise.lobes.field`): what makes a mirror's lobe finite.
        "auto" follows the noise, down to the angle of a pixel.
    normal_exponent : float
        Sharpness with which "normal" compares normals, > 0.
    band_limit : float or None
        With "normal": scale of the screen-space band-limit by BRDF parameter, > 0; None for none.
    lobes : int
        With "sg_mixture": spherical Gaussians that stand for a GGX lobe, 1 to 4; where diffuse and specular radiance
        are not apart 1 to 3, and one more is the diffuse lobe.
    hit_distance : bool or "auto"
        With "sg", "asg" and "ggx": compare footprints on what the lobes hit (see `lobewise.lobes.hits`).
    with_oidn : bool
        With the quality "high", which it implies: mix the result pixel by pixel with that of Intel Open Image Denoise
        (needs ``lobewise[compare]``).
    """

    quality: str = "auto"
    similarity: str = "auto"
    form: str = "full"
    radius: int = 8
    beta: float | str = "auto"
    diffuse_beta: float | str = "auto"
    device: str = "auto"
    screen_sigma: float | str = "auto"
    position_sigma: float = 16.0
    tau: float | str = "auto"
    normal_exponent: float = 64.0
    band_limit: float | None = None
    lobes: int = 3
    hit_distance: bool | str = "auto"
    with_oidn: bool = False

    def __post_init__(self) -> None:
        require_choice("quality", self.quality, QUALITIES)
        require_choice("similarity", self.similarity, SIMILARITIES)
        require_choice("form", self.form, FORMS)
        quality = "high" if self.with_oidn else self.quality
        if quality in ("balanced", "high") and self.form != "full":
            raise InputError(
                describe_problem(
                    "form",
                    expected=f"'full' with quality {quality!r}",
                    got=repr(self.form),
                    action="use quality 'fast' for the other forms",
                )
            )
        if isinstance(self.radius, bool) or not isinstance(self.radius, int) or not 0 <= self.radius <= LARGEST_RADIUS:
            raise InputError(
                describe_problem(
                    "radius",
                    expected=f"an integer from 0 to {LARGEST_RADIUS}",
                    got=repr(self.radius),
                    action="8 is usual; form='atrous' reaches further",
                )
            )
        if self.with_oidn and self.quality not in ("auto", "high"):
            raise InputError(
                describe_problem(
                    "quality",
                    expected="'high' with Open Image Denoise",
                    got=repr(self.quality),
                    action="leave the quality out",
                )
            )
        for name in ("beta", "diffuse_beta", "screen_sigma", "tau"):
            value = getattr(self, name)
            if value != "auto":
                _require_positive(name, value, '"auto" or a finite number above 0')
        for name in ("position_sigma", "normal_exponent"):
            _require_positive(name, getattr(self, name), "a finite number above 0")
        if self.band_limit is not None:
            _require_positive("band_limit", self.band_limit, "a finite number above 0")
        if isinstance(self.lobes, bool) or not isinstance(self.lobes, int) or not 1 <= self.lobes <= MAX_LOBES:
            raise InputError(
                describe_problem(
                    "lobes", expected=f"an integer from 1 to {MAX_LOBES}", got=repr(self.lobes), action="3 is usual"
                )
            )
        if self.hit_distance not in (True, False, "auto"):
            raise InputError(
                describe_problem(
                    "hit_distance", expected='True, False or "auto"', got=repr(self.hit_distance), action="leave it out"
                )
            )


def _require_positive(name: str, value: Any, expected: str) -> None:
    if isinstance(value, str) or not (math.isfinite(value) and value > 0.0):
        raise InputError(describe_problem(name, expected=expected, got=repr(value), action="leave it out if unsure"))


def choose_quality(settings: DenoiseSettings) -> str:
    """Return the quality that "auto" stands for in `denoise`; others are returned as they are."""
    if settings.quality != "auto":
        return settings.quality
    if settings.with_oidn:
        return "high"
    return DEFAULT_QUALITY if settings.form == "full" else "fast"


def require_plain(settings: DenoiseSettings, what: str) -> None:
    """Raise InputError if ``settings`` ask for a quality that ``what`` does not have."""
    if settings.quality not in ("auto", "fast") or settings.with_oidn:
        raise InputError(
            describe_problem(
                "quality",
                expected=f"'fast' for {what}",
                got="with_oidn" if settings.with_oidn else repr(settings.quality),
                action="leave it out, or denoise frame by frame",
            )
        )


def choose_similarity(frame: AnyFrame, similarity: str) -> str:
    """Return the similarity that "auto" stands for on this frame; others are returned as they are."""
    if similarity != "auto":
        return similarity
    guides = frame.gbuffer
    placed = guides.position is not None or guides.depth is not None
    has_lobes = guides.normal is not None and guides.alpha_u is not None and frame.camera is not None and placed
    return DEFAULT_SIMILARITY if has_lobes else "normal"


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

    Where the frame has its variance, the median relative variance of the mean is compared with what the built-in
    ``showroom`` has at the same sample count, ``0.0825 (4/spp)^0.56`` (it falls more slowly than 1/spp because few
    samples hide the tail). A dim, indirectly lit room is then worth fewer samples than it took. Without variance it is
    the sample count itself, and without that 4.

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
        return float(np.clip(4.0 * math.pow(0.0825 / noise, 1.0 / 0.56), 0.25, 4096.0))
    excess = noise / (0.0825 * math.pow(4.0 / spp, 0.56))
    return spp / float(np.clip(excess, 0.25, 16.0))


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
    guides = frame.gbuffer
    placed = guides.position is not None or guides.depth is not None
    return guides.hit_distance is not None and placed and frame.camera is not None


def needs_spp(settings: DenoiseSettings) -> bool:
    """Return whether what "auto" stands for depends on the noise, for the quality "fast"."""
    return "auto" in (settings.screen_sigma, settings.tau, settings.beta, settings.diffuse_beta)


def resolve_settings(
    frame: AnyFrame, settings: DenoiseSettings, scale: int = 1, *, spp: float | None = None
) -> DenoiseSettings:
    """Return ``settings`` with every "auto" replaced by what it stands for on this frame, for the quality "fast".

    With one of ``scale`` times ``scale`` pixels shaded there are fewer samples for the same area, so the screen sigma
    and the band-limit are those of fewer samples per pixel. The lobe similarity gets stricter instead, because
    samples of another material are as near as those of the own one (fitted on the built-in scenes at scale 4).
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
    return replace(
        settings,
        quality="fast",
        with_oidn=False,
        tau=float(tau),
        screen_sigma=choose_screen_sigma(density * spp, settings.radius * scale) if sigma == "auto" else float(sigma),
        similarity=choose_similarity(frame, settings.similarity),
        hit_distance=USE_HITS and can_use_hits(frame) if settings.hit_distance == "auto" else settings.hit_distance,
        beta=beta if settings.beta == "auto" else float(settings.beta),
        diffuse_beta=beta if settings.diffuse_beta == "auto" else float(settings.diffuse_beta),
        device=choose_device(settings.device),
    )
