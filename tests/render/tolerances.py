"""Every tolerance of the rendering tests, with its reason."""

EXACT = 1e-5
"""Single-precision arithmetic of a handful of operations."""

NOISE = 0.01
"""Directional albedo of a 64-pixel furnace picture at 512 samples: about five standard errors of the noisiest lobe."""

ALBEDO_FIT = 0.03
"""The rational fit of the GGX albedo against the furnace for alpha up to 0.35 and n.v from 0.4: its stated error."""

PRINCIPLED_DIFFUSE = 0.06
"""Base colour instead of the true albedo of Burley's diffuse lobe, which is 0.94 to 1.02 of it at these angles."""

PEAK_SHAPE = 0.05
"""Shape of a lobe near its peak, where Fresnel and masking vary by some per cent."""
