"""A finished interactive frame, and its intermediate results as images to look at."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from lobewise.errors import MissingChannelError, require_choice
from lobewise.guides.lobe_fields import default_tau, make_sg_field
from lobewise.interactive.settings import (
    MAX_SHOWN_FRAMES,
    MAX_SHOWN_SAMPLES,
    MAX_SHOWN_SHARPNESS,
    VIEWS,
    InteractiveSettings,
)
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance, Result
from lobewise.records.sparse_frame import SparseFrame

if TYPE_CHECKING:
    # The viewer of finished frames imports this module, and must not need Mitsuba.
    from lobewise.render.stages import DirectLight, FirstHits


@dataclass(frozen=True)
class Parts:
    """The intermediate images of a frame. Their arrays must not be changed."""

    hits: FirstHits
    noisy_direct: DirectLight
    """Direct light before its filter."""
    direct: DirectLight
    """Direct light after its filter."""
    sparse: SparseFrame
    """The samples of indirect light."""
    before: Result
    """Indirect light before pixels were shaded again."""
    result: Result
    """Indirect light with the pixels that were shaded again."""
    indirect: FloatArray
    """Indirect light as it is shown, (height, width, 3)."""
    history: FloatArray | None
    """Length of each pixel's history, frames, (height, width); None for a frame without history."""


def make_view(name: str, image: FloatArray, parts: Parts) -> FloatArray:
    """Return a view of a frame; see `lobewise.interactive.InteractiveFrame.get_view`."""
    if name == "image":
        return image
    hits = parts.hits
    view = _MAKERS[name](parts) if name in _MAKERS else show_guide(name, hits.gbuffer, parts.before, hits.camera, None)
    return np.asarray(view, dtype=np.float32)


def spread_samples(samples: FloatArray, scale: int, shape: tuple[int, int], start: tuple[int, int]) -> FloatArray:
    """Return sparse samples at the full size, (height, width, 3): each fills ``scale`` x ``scale`` pixels.

    ``start`` is the row and column where the block of the first sample begins.
    """
    rows, columns = (
        np.clip((np.arange(size) - first) // scale, 0, count - 1)
        for size, first, count in zip(shape, start, samples.shape, strict=False)
    )
    return np.asarray(samples[rows[:, None], columns[None, :]])


def show_guide(name: str, gbuffer: GBuffer, result: Result, camera: Camera | None, tau: float | None) -> FloatArray:
    """Return a view of guides, or of how much supports a result: colours or numbers in [0, 1].

    Parameters
    ----------
    name : str
        "sharpness": the band-limited sharpness of every lobe, logarithmic: 0 for 1, 1 for `MAX_SHOWN_SHARPNESS`.
        "weight_sum": ``W / (1 + W)``, so that one sample that matches fully is one half. "effective_samples":
        logarithmic, 1 for `MAX_SHOWN_SAMPLES`. "hit_distance": ``t / (t + depth)`` of the hit distance t, 0 for a hit
        on the surface itself, 1 at infinity. "normal": x, y and z from -1 to 1 as colours from 0 to 1, black where
        there is no surface. "albedo": the sum of both albedos.
    gbuffer : GBuffer
    result : Result
    camera : Camera, optional
        Needed by "sharpness".
    tau : float, optional
        The band-limit, radians; by default that of `default_tau`.

    Raises
    ------
    MissingChannelError
        If a guide of the view is missing.
    """
    if name == "weight_sum":
        return np.asarray(result.weight_sum / (1.0 + result.weight_sum))
    if name == "effective_samples":
        count = np.clip(result.effective_samples, 1.0, MAX_SHOWN_SAMPLES)
        return np.asarray(np.log(count) / math.log(MAX_SHOWN_SAMPLES))
    if name == "sharpness":
        if camera is None:
            raise MissingChannelError(
                "lobe sharpness", expected="a camera in the header", got="none", action="write one"
            )
        tau = default_tau(camera, result.image.shape[0]) if tau is None else tau
        lobes = make_sg_field(gbuffer, camera, tau=tau, diffuse_fallback=True)
        shown = np.log(np.maximum(lobes.sharpness, 1.0)) / np.log(MAX_SHOWN_SHARPNESS)
        return np.asarray(np.where(lobes.valid, np.clip(shown, 0.0, 1.0), 0.0))
    if name == "hit_distance":
        distance, depth = (gbuffer.require(one, "this view") for one in ("hit_distance", "depth"))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = distance / (distance + depth)
        return np.where(np.isinf(distance), np.float32(1.0), np.nan_to_num(share))
    if name == "normal":
        normal = gbuffer.require("normal", "this view")
        return np.where(np.any(normal != 0.0, axis=-1, keepdims=True), 0.5 + 0.5 * normal, np.float32(0.0))
    diffuse, specular = (gbuffer.require(f"{part}_albedo", "this view") for part in ("diffuse", "specular"))
    return np.asarray(np.clip(diffuse + specular, 0.0, 1.0))


def _make_noisy(parts: Parts) -> FloatArray:
    sparse = parts.sparse
    samples = spread_samples(sparse.radiance.color, sparse.scale, sparse.shape, (0, 0))
    return np.asarray(parts.noisy_direct.total + samples)


def _make_history(parts: Parts) -> FloatArray:
    if parts.history is None:
        return np.zeros(parts.sparse.shape, np.float32)
    return np.asarray(np.clip(parts.history / MAX_SHOWN_FRAMES, 0.0, 1.0))


_MAKERS: dict[str, Callable[[Parts], FloatArray]] = {
    "noisy": _make_noisy,
    "direct": lambda parts: parts.direct.total,
    "indirect": lambda parts: parts.indirect,
    "history": _make_history,
    "recomputed": lambda parts: parts.result.weight_sum != parts.before.weight_sum,
}
"""The views that finished frames have not."""


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
