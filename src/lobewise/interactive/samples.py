"""The samples of a frame: indirect light, and the light through a lens of a camera that stands still."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lobewise.interactive.resting import Resting
from lobewise.interactive.settings import InteractiveSettings
from lobewise.records.frame import FloatArray, Radiance
from lobewise.records.sparse_frame import Rays, SparseFrame, list_places
from lobewise.render.stages import FirstHits, IndirectLight, Stages
from lobewise.render.tracing.own_samples import OwnLight
from lobewise.render.tracing.points import IndirectMethod


def choose_pixels(
    size: tuple[int, int], scale: int, number: int
) -> tuple[tuple[int, int], tuple[NDArray[np.intp], NDArray[np.intp]], tuple[int, int]]:
    """Return the place in every block of ``scale`` x ``scale`` pixels that a frame shades, by the frame's number.

    With it come rows and columns of the shaded pixels, row by row, and how many rows and columns they form. ``size`` is
    columns and rows of the image.
    """
    places = list_places(scale)
    place = places[number % len(places)]
    rows, columns = np.arange(place[0], size[1], scale), np.arange(place[1], size[0], scale)
    return place, (np.repeat(rows, columns.size), np.tile(columns, rows.size)), (rows.size, columns.size)


def make_radiance(method: IndirectMethod, light: IndirectLight, shape: tuple[int, int]) -> Radiance:
    """Return the light of some pixels as an image of (rows, columns) pixels, split by lobe if the method splits it."""
    diffuse, specular = (part.reshape(*shape, 3) for part in (light.diffuse, light.specular))
    split = {} if isinstance(method, OwnLight) else {"diffuse": diffuse, "specular": specular}
    return Radiance(diffuse + specular, **split)


def make_rays(light: IndirectLight, shape: tuple[int, int]) -> Rays | None:
    """Return the weights of the rays of some pixels as an image of (rows, columns) pixels.

    There are none if the method tells none. The weight of several samples is their mean.
    """
    if light.ray_weight is None:
        return None
    known = np.isfinite(light.ray_weight)
    return Rays(np.where(known, light.ray_weight, np.float32(1.0)).reshape(shape))


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
