"""The picture through a lens, of a camera that stands still. While it moves, the scene is seen through a pinhole."""

from __future__ import annotations

from dataclasses import dataclass, field

from lobewise.interactive.resting import Resting
from lobewise.interactive.samples import choose_pixels
from lobewise.interactive.settings import InteractiveSettings
from lobewise.records.frame import FloatArray, Radiance
from lobewise.records.sparse_frame import SparseFrame
from lobewise.render.stages import FirstHits, Stages

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
        place, grid, shape = choose_pixels((width, height), scale, number)
        color = stages.shade_through_lens(hits.camera, *grid, settings.spp, seed)
        radiance = Radiance(color.reshape(*shape, 3))
        self.mean.frames += 1
        return self.mean.add_indirect(image, SparseFrame(radiance, hits.gbuffer, scale, place, hits.camera), None)
