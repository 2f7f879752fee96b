"""Bring the images of another frame to the pixels of a frame, where surface and lobe are recognised."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lobewise.filters.history.reprojection import reproject_images
from lobewise.filters.windows.following import sample_cubic
from lobewise.recipes.windows.layers import LayerImages
from lobewise.recipes.windows.places import compute_reflections
from lobewise.recipes.windows.shots import Shot
from lobewise.records.frame import FloatArray

MAX_SHARE_EQUAL = 0.2
"""Share of the lit surface pixels that may have exactly the same light in two frames. Above it both have one noise."""
MIN_GATHERED_AGREEMENT = 0.02
"""Agreement below which a pixel counts as not found."""
SHARP_AGREEMENT = 0.8
"""Agreement above which a reflection is interpolated: half a pixel would show on a sharp one."""
SURFACE = "rest"
"""Kind of light whose features compare place and normal alone."""


class Shown(NamedTuple):
    """Where another frame shows the surfaces of a frame."""

    places: FloatArray
    """Column and row in the other frame, (height, width, 2)."""
    agreement: FloatArray
    """How well the surfaces match, (height, width), 0 to 1."""

    def gather(self, image: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return an image of the other frame at the pixels of the frame, and how well the surfaces match."""
        values, known = sample_cubic(image, self.places)
        return values, np.where(known, self.agreement, np.float32(0.0))


class Neighbour:
    """Another frame of a window, seen from the frame that is filtered.

    Parameters
    ----------
    shot, other : Shot
        The frame, and the other one.
    places : array, shape (height, width, 2)
        Where the pixels' surface points are in the other frame.
    """

    def __init__(self, shot: Shot, other: Shot, places: FloatArray) -> None:
        self._shot = shot
        self._other = other
        self._places = places

    @cached_property
    def surface_agreement(self) -> FloatArray:
        """How well the surfaces match, (height, width), 0 to 1."""
        black = np.zeros((*self._shot.frame.shape, 3), np.float32)
        return self._gather([black], SURFACE)[1]

    @cached_property
    def reflections(self) -> FloatArray:
        """Where reflections are in the other frame, (height, width, 2); NaN where they are unknown or wide.

        Wide lobes show the same light at the surface's own place. Places of reflections are less even, so that pixels
        would take one sample twice, and share its noise.
        """
        places = compute_reflections(self._shot, self._other)
        if places is None:
            return np.full_like(self._places, np.nan)
        return np.where(self._shot.is_sharp[..., None], places, np.float32(np.nan))

    @cached_property
    def repeats(self) -> bool:
        """Whether the other frame has the noise of this frame: both were rendered with one seed, and nothing moved."""
        one, other = self._shot.frame.radiance.color, self._other.frame.radiance.color
        lit = self._shot.features[SURFACE].mask & (one > 0.0).all(axis=-1)
        return bool(lit.any() and np.mean((one == other).all(axis=-1)[lit]) > MAX_SHARE_EQUAL)

    def gather_layer(self, layer: LayerImages, slots: Sequence[str]) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return images of a layer of the other frame at the pixels of this frame, and how well the pixels match.

        Images are radiance over albedo.

        Parameters
        ----------
        layer : LayerImages
            The layer in the other frame.
        slots : sequence of str
            Names of the wanted images.

        Returns
        -------
        dict of array, shape (height, width, 3)
        array, shape (height, width)
            Agreement, 0 to 1.
        """
        even = [layer.even[slot] for slot in slots]
        gathered, agreement = self._gather(even, layer.kind)
        if layer.kind == "specular":
            # A mirror that moves shows other things, and nobody knows how fast they pass.
            agreement = np.where(self._shot.moves, np.float32(0.0), agreement)
            gathered = self._sharpen(even, gathered, agreement)
        return dict(zip(slots, gathered, strict=True)), agreement

    @cached_property
    def shown(self) -> Shown:
        """Where the other frame shows the surfaces of the frame."""
        return Shown(self._places, self.surface_agreement)

    def _gather(self, images: Sequence[FloatArray], kind: str) -> tuple[list[FloatArray], FloatArray]:
        """Return images at the pixels nearest to the places, 0 where they do not match, and the agreement.

        Each pixel is taken whole: samples that were interpolated share their noise, and denoisers take shared noise for
        texture.
        """
        now, before = self._shot.features[kind], self._other.features[kind]
        places, virtual = self._places, None
        if kind == "specular":
            known = np.asarray(np.isfinite(self.reflections).all(axis=-1))
            places = np.where(known[..., None], np.float32(np.nan), places)
            virtual = np.rint(self.reflections), len(now.surface) - 1
        places = np.rint(places)
        sums, weight = reproject_images(images, places, before.pixels, now.pixels, virtual=virtual)
        agreement = np.clip(weight, np.float32(0.0), np.float32(1.0))
        seen = agreement > MIN_GATHERED_AGREEMENT
        inverse = np.divide(np.float32(1.0), weight, out=np.zeros_like(agreement), where=seen)
        return [summed * inverse[..., None] for summed in sums], np.where(seen, agreement, np.float32(0.0))

    def _sharpen(
        self, images: Sequence[FloatArray], gathered: Sequence[FloatArray], agreement: FloatArray
    ) -> list[FloatArray]:
        """Return gathered reflections, interpolated where they match well."""
        sharp = (agreement > SHARP_AGREEMENT) & self._shot.is_sharp
        if not sharp.any():
            return list(gathered)
        known = np.asarray(np.isfinite(self.reflections).all(axis=-1))
        places = np.where(known[..., None], self.reflections, self._places)
        samples = (sample_cubic(image, places) for image in images)
        return [
            np.where((inside & sharp)[..., None], np.maximum(values, np.float32(0.0)), blurred)
            for (values, inside), blurred in zip(samples, gathered, strict=True)
        ]
