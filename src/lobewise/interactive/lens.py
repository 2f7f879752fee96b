"""The picture through a lens, of a camera that stands still. While it moves, the scene is seen through a pinhole."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lobewise.frame import FloatArray, Radiance
from lobewise.interactive.resting import Resting
from lobewise.interactive.settings import InteractiveSettings
from lobewise.render.stages import FirstHits, Stages
from lobewise.sparse_frame import SparseFrame, list_places

SHARP_WORTH = 4.0
"""Weight of the picture without the lens in the mean, in samples of the pixel itself. It shows other light than the
lens does, so that it must vanish soon."""


@dataclass
class LensMean:
    """The mean of the light through a lens over the frames since the camera stands still."""

    mean: Resting = field(default_factory=lambda: Resting(SHARP_WORTH))

    def add(
        self, image: FloatArray, stages: Stages, hits: FirstHits, settings: InteractiveSettings, number: int, seed: int
    ) -> FloatArray:
        """Return the mean of all frames, (height, width, 3), after some pixels were shaded through the lens.

        ``image`` is the picture without the lens, and ``number`` chooses the pixel of every block.
        """
        height, width = image.shape[:2]
        scale = max(1, min(settings.scale, width, height) // 2)
        places = list_places(scale)
        place = places[number % len(places)]
        rows, columns = np.arange(place[0], height, scale), np.arange(place[1], width, scale)
        grid = np.repeat(rows, columns.size), np.tile(columns, rows.size)
        color = stages.shade_through_lens(hits.camera, *grid, settings.spp, seed)
        radiance = Radiance(color.reshape(rows.size, columns.size, 3))
        self.mean.frames += 1
        return self.mean.add_indirect(image, SparseFrame(radiance, hits.gbuffer, scale, place, hits.camera), None)
