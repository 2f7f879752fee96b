"""The printed plan of a frame: its stages and steps, and what they will cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from lobewise.denoising.automatic import ask, needs_peer_alone, resolve_all
from lobewise.denoising.combining import describe_peer_alone, name_method
from lobewise.denoising.planning.frame_plans import FramePlan, FrameTraits, describe_frame, plan_frame
from lobewise.denoising.planning.layer_plans import LayerTraits
from lobewise.frame import Frame
from lobewise.peers import require_oidn
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality

GIB = float(2**30)
MEASURED_RADIUS = 8
"""Radius of the settings with which the times of the qualities were measured, pixels."""
MEASURED_FRAME = FrameTraits({"diffuse": LayerTraits(is_diffuse=True), "specular": LayerTraits(is_diffuse=False)})
"""Layers of the frame with which the times of the qualities were measured."""


def foretell_method(frame: Frame, settings: DenoiseSettings, *, whole: bool = True) -> str:
    """Return how `lobewise.denoise` would make the image of a frame, in a sentence without a full stop.

    The frame was checked by `lobewise.guides.usable.check_guides`. ``whole`` says that it would not be filtered in
    bands; in bands, ``frame`` may be some of its rows. The errors are those of `foretell`.
    """
    if whole and needs_peer_alone(settings):
        return describe_peer_alone(frame)
    return name_method(frame, settings, resolve_all(frame, ask(settings, {}, whole=whole)), whole=whole)


def foretell(frame: Frame, settings: DenoiseSettings, *, height: int | None = None) -> list[str]:
    """Return the lines of the plan by which `lobewise.denoise` would filter a frame: method, steps, memory and time.

    Parameters
    ----------
    frame : Frame
        A frame that `lobewise.guides.usable.check_guides` has seen. No pixel of it is filtered.
    settings : DenoiseSettings
        As of `lobewise.denoise`.
    height : int, optional
        Rows of the image, if `lobewise.denoise_file` filters it in bands and ``frame`` is only some of its rows.

    Raises
    ------
    MissingChannelError, InputError, DeviceError
        As `lobewise.denoise`, if the frame lacks a guide that the similarity needs, or a setting does not fit.
    MissingDependencyError
        If the settings ask for Open Image Denoise and it is not installed.
    """
    whole = height is None
    chosen = resolve_all(frame, ask(settings, {}, whole=whole))
    if chosen.with_oidn:
        require_oidn()
    plan = plan_frame(describe_frame(frame), chosen)
    method = name_method(frame, settings, chosen, whole=whole)
    rows, width = frame.shape
    height = height or rows
    held = count_bytes(frame) * height // rows
    working = get_quality(chosen.quality).work_bytes_per_pixel * height * width
    seconds = height * width / 1e6 * estimate_seconds_per_megapixel(plan, chosen)
    alone = ", without Open Image Denoise" if chosen.with_oidn else ""
    bands = "" if whole else " Bands of rows take less."
    return [
        f"{width} x {height} pixels, by {method}.",
        *plan.describe(),
        f"Memory: about {(held + working) / GIB:.2g} GiB, {held / GIB:.2g} GiB of it for the frame.{bands}",
        f"Time: about {seconds:.2g} s on two processor threads{alone}. The first run on a machine compiles kernels as "
        "well.",
    ]


def estimate_seconds_per_megapixel(plan: FramePlan, settings: ResolvedSettings) -> float:
    """Return the time of a plan on two threads: the measured time of its quality, in proportion to the taps."""
    measured = plan_frame(MEASURED_FRAME, replace(settings, radius=MEASURED_RADIUS, form="full"))
    return get_quality(settings.quality).seconds_per_megapixel * count_taps(plan) / count_taps(measured)


def count_taps(plan: FramePlan) -> int:
    """Return how many taps of kernels the layers of a plan have for a pixel."""
    return sum(step.taps for layer in plan.layers.values() for step in layer.steps)


def count_bytes(record: Any) -> int:
    """Return the bytes of all arrays of a frame, of the records and collections in it."""
    if isinstance(record, np.ndarray):
        return record.nbytes
    if isinstance(record, Mapping):
        return sum(map(count_bytes, record.values()))
    if isinstance(record, tuple):
        return sum(map(count_bytes, record))
    return sum(count_bytes(getattr(record, item.name)) for item in fields(record)) if is_dataclass(record) else 0
