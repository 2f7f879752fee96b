"""How near is near enough, and why."""

QUADRATURE = 1e-9
"""Gauss-Legendre polar grids on smooth lobes; what is left is float64 rounding over some ten thousand nodes."""

HORIZON = 5e-4
"""The same on lobes that the horizon cuts off: the integrand has a kink there."""

SIMILARITY = 3e-4
"""Similarity of two full BRDF lobes by the grids of `measure_similarity` (60x64 nodes against 200x256)."""


ROUNDING = 1e-12
"""Two float64 evaluations of one formula."""
