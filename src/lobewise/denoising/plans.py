"""The passes that the quality "balanced" makes over a layer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Pass:
    """One pass over both halves.

    Parameters
    ----------
    radius : int
        Taps from the centre to the edge of the kernel, at radius 8 of the settings.
    sigma : float
        Standard deviation of the distance on the screen, pixels, and in the scene, pixel footprints, at radius 8.
    noise : float
        Variances that a squared difference of the guide is divided by. The first pass is guided by the samples
        themselves, where every pixel has some in both halves: so weakly that noise is no difference, but that what is
        far brighter on both (a lamp in a mirror) stays where it is.
    lobes : float
        Exponent of the lobe similarity, over that of the settings.
    lobes_with_seen : float
        The same where the frame tells what reflections see, which then says more than the lobes do.
    step : int
        Pixels from tap to tap, at radius 8. Above 1 the pass averages what the one before gave, else the samples.
    """

    radius: int
    sigma: float
    noise: float
    lobes: float = 1.0
    lobes_with_seen: float = 1.0
    step: int = 1

    def get_kernel(self, radius: int, *, follows: bool) -> tuple[int, int]:
        """Return the radius in taps and the step in pixels at ``radius`` of the settings.

        ``follows`` tells whether a pass came before; one that is sparse averages what that gave.
        """
        scale = radius / 8.0
        if self.step == 1:
            return round(self.radius * scale), 1
        return min(self.radius, radius) if follows else round(self.radius * scale), max(round(self.step * scale), 1)


@dataclass(frozen=True)
class Plan:
    """The passes of a layer, each guided by the one before, and what "auto" is as exponent of its lobe similarity."""

    passes: tuple[Pass, ...]
    beta: float


DIFFUSE = Plan(
    (Pass(3, 6.0, 40.0, lobes=4.0), Pass(6, 30.0, 12.0), Pass(3, 30.0, 6.0, step=4)),
    beta=2.0,
)
SPECULAR = Plan(
    (
        Pass(4, 6.0, 40.0, lobes=4.0),
        Pass(5, 22.0, 6.0, lobes_with_seen=0.5),
        Pass(3, 30.0, 6.0, lobes=64.0, lobes_with_seen=64.0, step=4),
    ),
    beta=1.0,
)
"""Tuned on the scenes that ``benchmarks/quality/measure.py`` calls train (docs/quality.md). Diffuse light varies
slowly: a second, sparse pass over what the first gave reaches as far as a dense kernel of three times the cost. Of
reflections only the rough take part in it: the axes of sharp lobes are too far apart, 4 pixels on, for so high a
power."""
