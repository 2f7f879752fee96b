"""How many pixels a moving camera gets: fewer while frames take too long, all of them when it stands still."""

from __future__ import annotations

import math

TARGET = 0.2
"""Seconds that a frame may take while the camera moves."""
STEPS = (1.0, 0.71, 0.5, 0.35, 0.25)
"""Factors of width and height, each about half the pixels of the one before."""
_ROOM = 0.6
"""A larger picture is tried when it would take no longer than this part of the target."""
_SMOOTHING = 0.5


class Pace:
    """Chooses the step for one browser from the times of its frames.

    Parameters
    ----------
    target : float
        Seconds that a frame may take.
    fixed : bool
        Always all pixels.
    """

    def __init__(self, target: float = TARGET, fixed: bool = False) -> None:
        self.fixed = fixed
        self._target = target
        self._step = 0
        self._seconds: float | None = None

    @property
    def factor(self) -> float:
        """Factor of width and height while the camera moves."""
        return 1.0 if self.fixed else STEPS[self._step]

    def add(self, seconds: float, factor: float) -> None:
        """Take the time of a frame that was rendered at a factor while the camera moved."""
        if self.fixed or factor != self.factor:
            return
        before = seconds if self._seconds is None else self._seconds
        self._seconds = before + _SMOOTHING * (seconds - before)
        # One slow frame is a kernel that was compiled; two are slow.
        if min(self._seconds, seconds) > self._target and self._step + 1 < len(STEPS):
            self._go(self._step + 1)
        elif self._step > 0:
            larger = (STEPS[self._step - 1] / STEPS[self._step]) ** 2
            if max(self._seconds, seconds) * larger < _ROOM * self._target:
                self._go(self._step - 1)

    def _go(self, step: int) -> None:
        self._step, self._seconds = step, None


def fit_size(pixels: int, aspect: float, factor: float = 1.0) -> tuple[int, int]:
    """Return columns and rows, multiples of 8, of a picture of an aspect with about so many pixels.

    >>> fit_size(512 * 512, 1.0)
    (512, 512)
    >>> fit_size(512 * 512, 16 / 9, 0.5)
    (344, 192)
    """
    height = math.sqrt(pixels / aspect) * factor
    return tuple(max(8 * round(value / 8), 8) for value in (height * aspect, height))  # type: ignore[return-value]
