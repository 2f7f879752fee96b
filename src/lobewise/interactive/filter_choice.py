"""The settings of the filter of indirect light, from those of a frame and from how noisy its method is."""

from __future__ import annotations

import math
from dataclasses import replace

from lobewise.interactive.changes import SceneChanges
from lobewise.interactive.methods import Methods
from lobewise.interactive.settings import InteractiveSettings
from lobewise.render.stages import Stages
from lobewise.settings import DenoiseSettings

MIN_PATHS_FOR_INTERPOLATION = 8.0
"""Paths per pixel, counted by the worth of a sample, from which samples have so little noise that the kernel need only
interpolate between them."""
INTERPOLATION_SIGMA = 1.25
"""Standard deviation of the screen distance for that, in distances between samples. Of 0.75, 1.25 and 2 it has the
lowest error of a single frame in showroom and brushed. Over eight frames a lower value would do there, but it leaves
more noise in other scenes."""
LIMIT_TOLERANCE = 0.25
"""Relative change of a method's band-limit below which the former one is kept, so that a light that moves does not
change the settings of the filter, and end its history, in every frame."""


class FilterChoice:
    """Chooses the settings of the filter for the sessions of one scene."""

    def __init__(self, stages: Stages, methods: Methods, changes: SceneChanges) -> None:
        self._stages = stages
        self._methods = methods
        self._changes = changes
        self._limits: dict[tuple[str, int], tuple[int, float]] = {}

    def forget(self) -> None:
        """Measure the band-limits of all methods again."""
        self._limits.clear()

    def choose(self, settings: InteractiveSettings) -> DenoiseSettings:
        """Return the settings of the filter.

        Samples with little noise get a narrower kernel, and sparse virtual lights get wider lobes.
        """
        chosen, method = settings.make_filter_settings(), self._methods.get(settings.method)
        if settings.screen_sigma == "auto" and settings.spp * method.worth >= MIN_PATHS_FOR_INTERPOLATION:
            chosen = replace(chosen, screen_sigma=INTERPOLATION_SIGMA * settings.scale)
        if settings.tau != "auto" or not settings.limit_lobes:
            return chosen
        limit = self._measure_limit(settings.method, settings.spp)
        return replace(chosen, tau=limit) if limit > 0.0 else chosen

    def _measure_limit(self, name: str, spp: int) -> float:
        """Return the band-limit of a method, radians, measured again after a change of the scene."""
        measured_at, limit = self._limits.get((name, spp), (-1, math.inf))
        if measured_at != self._changes.count and limit > 0.0:  # a method without limit never gets one
            measured = self._stages.get_band_limit(self._methods.get(name), spp)
            if not abs(measured - limit) <= LIMIT_TOLERANCE * limit < math.inf:
                limit = measured
            self._limits[name, spp] = self._changes.count, limit
        return limit
