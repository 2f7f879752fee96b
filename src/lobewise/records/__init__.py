"""Frozen records that rooms pass to each other, checked once."""
