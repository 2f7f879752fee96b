"""Every tolerance of the rendering tests, with its reason."""

EXACT = 1e-5
"""Single-precision arithmetic of a handful of operations."""

NOISE = 0.01
"""Mean over a 64-pixel furnace picture at 256 samples or more: about four standard errors of a white diffuse square."""

ALBEDO_FIT = 0.03
"""The rational fit of the GGX albedo against the furnace for alpha up to 0.35 and n.v from 0.4: its stated error."""

GLASS_FIT = 0.045
"""The same for rough glass of alpha 0.15, whose masking losses are neglected."""

PRINCIPLED_DIFFUSE = 0.06
"""Base colour instead of the true albedo of Burley's diffuse lobe, which is 0.94 to 1.02 of it at these angles."""

FITTED_ALPHA = 0.1
"""The nearest GGX of a metal of constant alpha: Fresnel and masking skew the lobe; rows between views add some."""

FITTED_ALBEDO = 0.02
"""Linear interpolation over at most 12 views, and the noise of 4096 samples where light is transmitted."""

FITTED_TEXTURE = 0.05
"""Two values stand for an integral; 0.043 was seen for a thin principled BSDF at n.v = 0.3, of an albedo of 0.72."""

FITTED_LOBES = 0.97
"""L2 cosine of three round lobes with a reflection 2.6 times as long as it is wide; 0.98 to 0.99 were seen."""

FITTED_STEPS = 0.9
"""L2 cosine of the lobes in the table nearest to a place of a smooth texture with those fitted to that place."""

PEAK_SHAPE = 0.05
"""Shape of a lobe near its peak, where Fresnel and masking vary by some per cent."""

SHARE = 2e-4
"""A ratio of two single-precision BSDF values."""

Z_USUAL = 3.0
"""Standard errors that pixels rarely exceed."""

FRACTION_BEYOND = 0.05
"""How many may: 0.003 were they Gaussian. Within a block the brighter pixels vary more, and small lights and caustics
leave long tails: 0.006 to 0.035 were seen."""

Z_BLOCK = 5.0
"""Largest z of 108 means over 4x4 pixels, skewed by rare bright samples."""

Z_MEAN = 4.0
"""Largest z of the mean over an image, which is Gaussian."""
