"""Second definitions, in NumPy and mostly float64, that only tests use: what the package computes is held against."""
