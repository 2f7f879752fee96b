"""What will happen to a frame: its steps, how far they reach, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from lobewise.denoising.also import has_passes, list_alone
from lobewise.denoising.automatic import ask, needs_peer_alone, resolve_all
from lobewise.denoising.combining import count_plain_calls, describe_peer_alone, list_peer_costs, name_method
from lobewise.denoising.evidence import takes_back
from lobewise.denoising.passes import LayerPass, make_passes
from lobewise.denoising.refining.lamps import EDGE_PIXELS
from lobewise.filters.compositing import COVERAGE_REACH
from lobewise.filters.fireflies import FIREFLY_REACH
from lobewise.filters.forms import ATROUS_REACH, count_taps, describe_form
from lobewise.filters.highlights import HIGHLIGHT_REACH
from lobewise.filters.noise.detail import DETAIL_REACH
from lobewise.filters.noise.residuals import RESIDUAL_REACH
from lobewise.filters.noise_guides import BLUR_RADIUS as GUIDE_REACH
from lobewise.filters.refinement.shape import REFINEMENT_REACH
from lobewise.guides.lobe_fields import SPREAD_REACH
from lobewise.peers import LIBRARY_BYTES_PER_PIXEL, MIN_LIBRARY_BYTES, bound_library_memory, require_oidn
from lobewise.records.frame import Frame
from lobewise.records.sparse_frame import AnyFrame
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality
from lobewise.work.limits import GIB, get_limits, require_memory
from lobewise.work.progress.stages import (
    FILL,
    FILTER_HALVES,
    FILTER_ONCE,
    FILTER_OTHERS,
    MIX_PEER,
    MIX_UNGUIDED,
    REFINE,
    SECONDS_PER_MEGAPIXEL,
    SHARE_OUT,
    TAKE_BACK,
    describe_alone,
)

PEER_BYTES_PER_PIXEL = 320
"""Memory of images that are held for Open Image Denoise, beside the frame and what the library works on, bytes."""
LAYER_BYTES_PER_PIXEL = 65
"""The same for every named layer of light; measured on a Blender frame of 1920x1080 with three."""
MEASURED_RADIUS = 8
"""Radius of the settings with which the times of the qualities were measured, pixels."""
MEASURED_LAYERS = {"diffuse": True, "specular": False}
"""Layers of the frame with which these times were measured, and whether each is diffuse."""
SAMPLES_REACH = FIREFLY_REACH + HIGHLIGHT_REACH + RESIDUAL_REACH + SPREAD_REACH
"""Reach of everything that happens to the samples and to the lobes before the first pass, pixels."""


class Step(NamedTuple):
    """A step of `lobewise.denoising.chain`: what it does, its reach in pixels, its taps for a pixel, and its parts."""

    text: str
    reach: int = 0
    taps: int = 0
    parts: tuple[str, ...] = ()


def list_steps(
    settings: ResolvedSettings, layers: Mapping[str, bool], *, taken_back: bool = True
) -> tuple[list[Step], list[Step]]:
    """Return the steps that need only the surroundings of a pixel, and those that need the whole image.

    Parameters
    ----------
    settings : ResolvedSettings
    layers : mapping of str to bool
        The layers by name, and whether each is diffuse.
    taken_back : bool
        Whether the noisy image is taken back; see `takes_back`.
    """
    quality = get_quality(settings.quality)
    refines = quality.refines and settings.radius > 0
    if not quality.reads_halves:
        reach = ATROUS_REACH if settings.form == "atrous" else settings.radius
        taps, kernel = count_taps(settings.form, settings.radius), describe_form(settings.form, settings.radius)
        parts = tuple(f"{name}: {kernel}" for name in layers)
        near = [Step(FILTER_ONCE, reach, len(layers) * taps, parts)]
    else:
        passes = {name: make_passes(settings.radius, is_diffuse=is_diffuse) for name, is_diffuse in layers.items()}
        near = [
            Step(
                FILTER_HALVES,
                max(map(compute_passes_reach, passes.values())),
                sum(layer_pass.taps for layer_passes in passes.values() for layer_pass in layer_passes),
                tuple(
                    f"{name}: {layer_pass.text}" for name, layer_passes in passes.items() for layer_pass in layer_passes
                ),
            )
        ]
        if refines:
            near.append(Step(REFINE, REFINEMENT_REACH + EDGE_PIXELS))
        if taken_back:
            near.append(Step(TAKE_BACK, DETAIL_REACH))
    far = [Step(FILL)]
    if quality.reads_halves:
        far.insert(0, Step(SHARE_OUT))
    if refines:
        far.append(Step(MIX_UNGUIDED))
    if settings.with_oidn:
        far.append(Step(MIX_PEER))
    return near, far


def compute_passes_reach(passes: list[LayerPass]) -> int:
    """Return how far the passes over a layer reach, pixels.

    The first pass is guided by the samples, and the second one by what the first has found.
    """
    return SAMPLES_REACH + sum(GUIDE_REACH + layer_pass.radius for layer_pass in passes) + COVERAGE_REACH


def compute_steps_reach(settings: ResolvedSettings) -> int:
    """Return from how many pixels away a pixel of the steps near it depends on anything, for any frame."""
    near, _ = list_steps(settings, MEASURED_LAYERS)
    return sum(step.reach for step in near)


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
    near, far = list_frame_steps(frame, chosen)
    rows, width = frame.shape
    height = height or rows
    held = count_bytes(frame) * height // rows
    pixels = height * width * (2 if frame.wraps else 1)
    working = estimate_work_bytes(frame, pixels, chosen.quality, with_oidn=bool(chosen.with_oidn))
    images = 1 + (len(list_alone(frame.also)) if whole else 0)
    seconds = images * pixels / 1e6 * estimate_seconds_per_megapixel(near, chosen)
    peer = ""
    if chosen.with_oidn:
        calls = images * count_plain_calls(frame, is_best=chosen.needs_oidn)
        peer = f", and {calls:.2g} times the time of one call of Open Image Denoise with albedo and normal"
    bands = "" if whole else " Bands of rows take less."
    return [
        f"{width} x {height} pixels, by {name_method(frame, settings, chosen, whole=whole)}.",
        *describe_steps(near, far),
        f"Memory: about {(held + working) / GIB:.2g} GiB, {held / GIB:.2g} GiB of it for the frame.{bands}",
        f"Time: about {seconds:.2g} s on two processor threads{peer}. The first run on a machine compiles kernels as "
        "well.",
    ]


def count_peer_bytes(frame: AnyFrame | None) -> int:
    """Return the memory of a pixel for Open Image Denoise, beside the frame and what the library works on, bytes."""
    return PEER_BYTES_PER_PIXEL + LAYER_BYTES_PER_PIXEL * len(getattr(frame, "layers", ()))


def estimate_work_bytes(
    frame: AnyFrame | None, pixels: int, quality: str, *, with_oidn: bool, small: bool = False
) -> float:
    """Return the memory that filters take beside a frame, bytes.

    ``pixels`` are those of the whole image, of which ``frame`` may be a part. ``quality`` is empty where Open Image
    Denoise works alone; ``small`` is the memory with its smallest tiles.
    """
    ours = get_quality(quality).work_bytes_per_pixel * pixels if quality else 0
    if not with_oidn:
        return ours
    library = LIBRARY_BYTES_PER_PIXEL * pixels
    return max(ours, count_peer_bytes(frame) * pixels + (min(library, MIN_LIBRARY_BYTES) if small else library))


@contextmanager
def bound_memory(frame: AnyFrame, quality: str, *, with_oidn: bool) -> Iterator[None]:
    """Let Open Image Denoise take what the limits of the call leave for it; see `estimate_work_bytes`.

    Raises LimitError if a frame and the work on it would take more than the limits allow.
    """
    held, pixels = count_bytes(frame), math.prod(frame.shape)
    require_memory(held + estimate_work_bytes(frame, pixels, quality, with_oidn=with_oidn, small=True))
    left = get_limits().left_gib
    with bound_library_memory(math.inf if left is None else left * GIB - held - count_peer_bytes(frame) * pixels):
        yield


def list_frame_steps(frame: Frame, settings: ResolvedSettings) -> tuple[list[Step], list[Step]]:
    """Return the steps of a frame; see `list_steps`."""
    if frame.radiance.parts is None:
        layers = {"color": False}
    elif frame.layers:
        layers = {layer.name: layer.is_diffuse for layer in frame.layers}
    else:
        layers = MEASURED_LAYERS
    taken_back = takes_back(frame, settings)
    near, far = list_steps(settings, layers, taken_back=taken_back)
    if has_passes(frame):
        far.append(Step(FILTER_OTHERS))
    far += [Step(describe_alone(name)) for name in list_alone(frame.also)]
    return near, far


def compute_costs(frame: Frame, settings: ResolvedSettings) -> dict[str, float]:
    """Return the steps of a frame and the seconds that each takes for a megapixel, for `lobewise.work.progress`."""
    near, far = list_frame_steps(frame, settings)
    costs = SECONDS_PER_MEGAPIXEL | {MIX_PEER: sum(list_peer_costs(frame, is_best=settings.needs_oidn).values())}
    by_layer = 1 if frame.radiance.parts is None else len(frame.layers) or len(MEASURED_LAYERS)
    return {
        step.text: costs[step.text] * (by_layer if step.text in (FILTER_ONCE, FILTER_HALVES) else 1)
        for step in (*near, *far)
    }


def describe_steps(near: list[Step], far: list[Step]) -> Iterator[str]:
    """Yield the lines of the printed plan."""
    for number, step in enumerate([*near, *far], 1):
        reach = f" (reaches {step.reach} pixels)" if step.reach else ""
        yield f"{number}. {step.text}{reach}"
        yield from (f"   {part}" for part in step.parts)


def estimate_seconds_per_megapixel(near: list[Step], settings: ResolvedSettings) -> float:
    """Return the time of steps on two threads: the measured time of their quality, in proportion to the taps."""
    measured, _ = list_steps(replace(settings, radius=MEASURED_RADIUS, form="full"), MEASURED_LAYERS)
    share = sum(step.taps for step in near) / sum(step.taps for step in measured)
    return get_quality(settings.quality).seconds_per_megapixel * share


def count_bytes(record: Any) -> int:
    """Return the bytes of all arrays of a frame, of the records and collections in it, without its origin.

    Fields that do not count when records are compared say where a record comes from.
    """
    if isinstance(record, np.ndarray):
        return record.nbytes
    if isinstance(record, Mapping):
        return sum(map(count_bytes, record.values()))
    if isinstance(record, tuple):
        return sum(map(count_bytes, record))
    if is_dataclass(record):
        return sum(count_bytes(getattr(record, item.name)) for item in fields(record) if item.compare)
    return 0
