"""The public recipe: a noisy frame in, a clean one out."""

from lobewise.denoising.automatic import resolve_settings
from lobewise.denoising.bad_pixels import mark_bad_pixels
from lobewise.denoising.recipe import denoise

__all__ = ["denoise", "mark_bad_pixels", "resolve_settings"]
