"""The mean of frames whose camera stands still. It converges to the mean of each pixel's own samples."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import mark_good
from lobewise.records.frame import FloatArray
from lobewise.records.sparse_frame import SparseFrame

FILTERED_WORTH = 32.0
"""Weight of the filtered light in the mean, in samples of the pixel itself."""
HALF_TRUST_SAMPLES = 16.0
"""Number of a pixel's own samples at which their mean counts with half its weight. The mean of fewer samples may show a
firefly."""

Again = tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]
"""Rows and columns of pixels that were shaded again, and their radiance, (count, parts, 3)."""


@dataclass
class Resting:
    """Sums over the frames since the camera stands still.

    A pixel's own samples have no bias but much noise. Filtered light has a bias and at first less noise. Their weighted
    mean moves from filtered light to the pixel's own samples as these become more.
    """

    worth: float = FILTERED_WORTH
    """Weight of the filtered light, in samples of the pixel itself."""
    frames: int = 0
    direct: list[FloatArray] = field(default_factory=list)
    """Means of the parts of direct light."""
    filtered: FloatArray | None = None
    """Mean of the filtered indirect light."""
    own: FloatArray | None = None
    """Sum of each pixel's own samples."""
    own_count: FloatArray | None = None
    first: tuple[SparseFrame, Again | None] | None = None
    """The samples of the first frame, as long as they are not in ``own``."""

    def add_direct(self, parts: list[FloatArray]) -> list[FloatArray]:
        """Count a new frame, add the parts of its direct light, and return their means over all frames."""
        self.frames += 1
        if self.frames == 1:
            self.direct = parts
        else:
            step = np.float32(1.0 / self.frames)
            self.direct = [old + step * (new - old) for old, new in zip(self.direct, parts, strict=True)]
        return self.direct

    def add_indirect(self, filtered: FloatArray, sparse: SparseFrame, again: Again | None) -> FloatArray:
        """Return the mean of indirect light over all frames, (height, width, 3).

        ``filtered`` is the filtered light of this frame, ``sparse`` and ``again`` are its samples.
        """
        if self.frames == 1 or self.filtered is None:
            # Save the sums while the camera moves: they are needed from the second frame on.
            self.filtered, self.first = filtered, (sparse, again)
            return filtered
        if self.own is None or self.own_count is None:
            self.own, self.own_count = np.zeros_like(filtered), np.zeros(filtered.shape[:2], np.float32)
        if self.first is not None:
            _add_samples(self.own, self.own_count, *self.first)
            self.first = None
        _add_samples(self.own, self.own_count, sparse, again)
        self.filtered = self.filtered + np.float32(1.0 / self.frames) * (filtered - self.filtered)
        # n samples have the weight n^2 / (n + HALF_TRUST_SAMPLES).
        trusted = self.own_count / (self.own_count + np.float32(HALF_TRUST_SAMPLES))
        worth = np.float32(self.worth)
        total = worth * self.filtered + trusted[..., None] * self.own
        return np.asarray(total / (worth + trusted * self.own_count)[..., None])


def _add_samples(own: FloatArray, own_count: FloatArray, sparse: SparseFrame, again: Again | None) -> None:
    """Add the samples of a frame to the sums, in place."""
    color = sparse.radiance.color
    good = mark_good(color)
    own[sparse.shaded] += np.where(good[..., None], color, np.float32(0.0))
    own_count[sparse.shaded] += good
    if again is not None:
        rows, columns, radiance = again
        good = mark_good(radiance)
        own[rows, columns] += np.where(good[..., None], radiance, np.float32(0.0)).sum(axis=1)
        own_count[rows, columns] += good.sum(axis=1)
