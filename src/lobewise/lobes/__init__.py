"""The mathematics of reflection lobes: NumPy, no images."""

from __future__ import annotations

from lobewise.lobes.field import LobeField, build_lobe_field
from lobewise.lobes.sg import SphericalGaussian
from lobewise.lobes.tangent import TangentLobe, make_tangent_lobe

__all__ = ["LobeField", "SphericalGaussian", "TangentLobe", "build_lobe_field", "make_tangent_lobe"]
