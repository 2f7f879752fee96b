"""The mathematics of reflection lobes: each formula once, for numbers of any kind, without images."""
