"""Adaptive re-computation: pixels that few neighbours support are shaded again."""

from lobewise.recipes.adaptive.choosing import choose_spp, find_unsupported
from lobewise.recipes.adaptive.recipe import Shade, recompute
from lobewise.recipes.adaptive.shading import Shading

__all__ = ["Shade", "Shading", "choose_spp", "find_unsupported", "recompute"]
