"""Frames of a picture that stands still, averaged until nothing of the filters remains in it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import find_good
from lobewise.frame import FloatArray
from lobewise.sparse_frame import SparseFrame

BORROWED = 32.0
"""Samples of its own that the mean of what a pixel was given by the filter is worth."""


Again = tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]
"""Rows and columns of pixels that were shaded once more, and their radiance, (count, 3)."""


HESITATION = 16.0
"""Samples of its own from which a pixel counts half of them: one of few may be a firefly, and stand out."""


@dataclass
class Resting:
    """The mean of what was seen since the picture stands still.

    A pixel's own samples have no bias and much noise, what the filter gives has both but less of it at first; the
    mean of the former, with that of the latter as if it were `BORROWED` samples more, goes from one to the other.
    """

    frames: int = 0
    direct: list[FloatArray] = field(default_factory=list)
    given: FloatArray | None = None
    own: FloatArray | None = None
    own_count: FloatArray | None = None
    first: tuple[SparseFrame, Again | None] | None = None

    def add_direct(self, parts: list[FloatArray]) -> list[FloatArray]:
        """Return the means of images that every frame has anew, these included; begins the frame."""
        self.frames += 1
        if self.frames == 1:
            self.direct = parts
        else:
            step = np.float32(1.0 / self.frames)
            self.direct = [old + step * (new - old) for old, new in zip(self.direct, parts, strict=True)]
        return self.direct

    def add_indirect(self, given: FloatArray, sparse: SparseFrame, again: Again | None) -> FloatArray:
        """Return the best estimate of indirect light, (height, width, 3).

        The filter made ``given``, of the same shape, of this frame's samples; some pixels may be shaded ``again``.
        """
        if self.frames == 1 or self.given is None:
            # While things move there is no second frame to ask for the sums.
            self.given, self.first = given, (sparse, again)
            return given
        if self.own is None or self.own_count is None:
            self.own, self.own_count = np.zeros_like(given), np.zeros(given.shape[:2], np.float32)
        if self.first is not None:
            _count(self.own, self.own_count, *self.first)
            self.first = None
        _count(self.own, self.own_count, sparse, again)
        self.given = self.given + np.float32(1.0 / self.frames) * (given - self.given)
        # The sum of n samples counts as one of n^2 / (n + h).
        trusted = self.own_count / (self.own_count + np.float32(HESITATION))
        borrowed = np.float32(BORROWED)
        total = borrowed * self.given + trusted[..., None] * self.own
        return np.asarray(total / (borrowed + trusted * self.own_count)[..., None])


def _count(own: FloatArray, own_count: FloatArray, sparse: SparseFrame, again: Again | None) -> None:
    """Add the samples of a frame to the sums, in place."""
    where = slice(sparse.place[0], None, sparse.scale), slice(sparse.place[1], None, sparse.scale)
    color = sparse.radiance.color
    good = find_good(color)
    own[where] += np.where(good[..., None], color, np.float32(0.0))
    own_count[where] += good
    if again is not None:
        rows, columns, radiance = again
        good = find_good(radiance[:, None])[:, 0]
        own[rows, columns] += np.where(good[:, None], radiance, np.float32(0.0))
        own_count[rows, columns] += good
