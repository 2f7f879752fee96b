"""A finished interactive frame: its image, its times and the views of its parts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from lobewise.errors import require_choice
from lobewise.interactive.settings import VIEWS, InteractiveSettings
from lobewise.interactive.views import Parts, make_view
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, Radiance, Result

STAGES = ("gbuffer", "indirect", "upsampling", "adaptive", "composite")
"""Stages that are timed, in their order. Direct light counts as part of "gbuffer"."""


@contextmanager
def watch(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Add the wall time of a ``with`` block to the seconds of a stage."""
    start = time.perf_counter()
    yield
    seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start


@dataclass(frozen=True)
class InteractiveFrame:
    """A finished frame and how it was made.

    Parameters
    ----------
    image : array, shape (height, width, 3)
        Linear radiance.
    seconds : dict of float
        Wall time of each of the `STAGES`, and of all of them as ``total``.
    settings : InteractiveSettings
    camera : Camera
    accumulated : int
        Consecutive frames with this camera and these settings, this one included.
    recomputed : int
        Pixels that were shaded again.
    parts : Parts
        The arrays that `get_view` shows; they must not be changed.
    """

    image: FloatArray
    seconds: dict[str, float]
    settings: InteractiveSettings
    camera: Camera
    accumulated: int
    recomputed: int
    parts: Parts = field(repr=False)

    def get_view(self, name: str) -> FloatArray:
        """Return one of the `VIEWS`: radiance or colours, (height, width, 3), or numbers in [0, 1], (height, width).

        Raises
        ------
        InputError
            If there is no view of that name.
        """
        require_choice("view", name, VIEWS)
        return make_view(name, self.image, self.parts)

    def make_frame(self) -> Frame:
        """Return the noisy frame of this image's size, with all guides, as `lobewise.write_frame` takes it.

        Its radiance is the view "noisy".
        """
        hits = self.parts.hits
        return Frame(Radiance(self.get_view("noisy")), hits.gbuffer, self.camera, lobe_tables=hits.lobe_tables)

    def make_result(self) -> Result:
        """Return this image as `lobewise.write_result` takes it."""
        return replace(self.parts.result, image=self.image, diffuse=None, specular=None, variance=None)
