"""Measured materials become lobes."""
