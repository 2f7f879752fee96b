"""The mathematics of reflection lobes: NumPy, no images."""
