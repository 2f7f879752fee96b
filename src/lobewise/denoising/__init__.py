"""The public recipe: a noisy frame in, a clean one out."""

from lobewise.denoising.bad_pixels import find_bad_pixels
from lobewise.denoising.recipe import denoise
from lobewise.denoising.settings import (
    DEFAULT_SIMILARITY,
    LARGEST_RADIUS,
    SIMILARITIES,
    DenoiseSettings,
    choose_beta,
    choose_screen_sigma,
    choose_similarity,
    choose_tau,
    estimate_spp,
    resolve_settings,
)

__all__ = [
    "DEFAULT_SIMILARITY",
    "LARGEST_RADIUS",
    "SIMILARITIES",
    "DenoiseSettings",
    "choose_beta",
    "choose_screen_sigma",
    "choose_similarity",
    "choose_tau",
    "denoise",
    "estimate_spp",
    "find_bad_pixels",
    "resolve_settings",
]
