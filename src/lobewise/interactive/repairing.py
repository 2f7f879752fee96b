"""Pixels of an interactive frame that nothing supports, shaded again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lobewise.interactive.filter_choice import MIN_PATHS_FOR_INTERPOLATION
from lobewise.interactive.resting import Again
from lobewise.interactive.settings import InteractiveSettings
from lobewise.recipes.adaptive import recompute
from lobewise.recipes.temporal.recipe import TemporalFilter
from lobewise.records.frame import Radiance, Result
from lobewise.records.sparse_frame import SparseFrame

NOISY_PARTS = 4
"""How often a pixel is shaded again where samples are noisy. A quarter of the pixels, each shaded four times, has less
error than all of them once; see docs/developers/interactive.md."""


def repair(
    result: Result,
    sparse: SparseFrame,
    settings: InteractiveSettings,
    worth: float,
    history: TemporalFilter | None,
    shade: Callable[[NDArray[np.intp], NDArray[np.intp], int], Radiance],
) -> tuple[Result, Again | None]:
    """Return the result of a frame with its least supported pixels shaded again, and the new samples.

    Parameters
    ----------
    result : Result
        The upsampled light of ``sparse``.
    worth : float
        Paths that the samples of a shaded pixel are worth, > 0.
    history : TemporalFilter, optional
        What made the result; the new samples enter it.
    shade : callable
        Takes rows, columns and the number of parts, and returns the radiance of these pixels, (count, parts).
    """
    is_noisy = worth < MIN_PATHS_FOR_INTERPOLATION
    parts = settings.adaptive_parts if settings.adaptive_parts != "auto" else NOISY_PARTS if is_noisy else 1
    again: list[Again] = []

    def shade_again(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Radiance:
        shaded = shade(rows, columns, parts)
        again.append((rows, columns, shaded.color))
        if history is not None and parts == 1:
            # A noisy sample counts little in this frame; over time it counts fully.
            history.add_samples(rows, columns, shaded, np.ones(rows.size, np.float32))
        return shaded

    budget = settings.adaptive / parts
    if parts > 1:
        mended = recompute(
            result, shade_again, samples=float(parts), frame=sparse, budget=budget, filter_new=False, history=history
        )
    else:
        # Only the sum is shown, so diffuse and specular light need no repair.
        whole = replace(result, diffuse=None, specular=None)
        samples = min(1.0, worth / MIN_PATHS_FOR_INTERPOLATION)
        mended = recompute(whole, shade_again, frame=sparse, budget=budget, filter_new=False, samples=samples)
    return mended, again[0] if again else None
