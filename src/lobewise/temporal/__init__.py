"""Filtering over time: a history per pixel, found again in every frame."""

from lobewise.temporal.recipe import TemporalFilter
from lobewise.temporal.settings import TemporalSettings

__all__ = ["TemporalFilter", "TemporalSettings"]
