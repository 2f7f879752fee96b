"""Paths, first hits and direct light."""
