"""Filtering over time: a history per pixel, found again in every frame."""

from lobewise.recipes.temporal.recipe import TemporalFilter

__all__ = ["TemporalFilter"]
