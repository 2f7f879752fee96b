"""The mathematics of reflection lobes: one text per formula, for numbers of any kind, without images."""
