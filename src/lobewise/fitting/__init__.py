"""Lobes fitted to measured materials."""
