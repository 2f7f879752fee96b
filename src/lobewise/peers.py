"""Denoisers of others, called with frames of lobewise: to compare with, and to mix with."""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache, reduce
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any, NamedTuple

import numpy as np

from lobewise.errors import DeviceError, MissingDependencyError, make_printable, require_choice, require_kind
from lobewise.guides.survey import STRIDE
from lobewise.records.frame import FloatArray, Frame, GBuffer
from lobewise.records.images import make_array
from lobewise.work.chunks import make_fork_lock
from lobewise.work.limits import GIB, check_limits
from lobewise.work.progress import enter_stage, follow_stage

LIBRARY_BYTES_PER_PIXEL = 520
"""Memory that the library may work on, bytes. Without a bound it takes 700, for 3 % less time at 1920x1080."""
MIN_LIBRARY_BYTES = 0.45 * GIB
"""Memory of the library's smallest tiles, bytes."""
OIDN_GUIDES = ("prefiltered", "mean", "noisy", "centre")
OIDN_QUALITIES = ("fast", "balanced", "high")
MIN_SIDE_PIXELS, WIDENED_SIDE_PIXELS = 16, 32
"""Side below which the library loses light, and the side to which shorter ones are widened by mirrored pixels."""


_library_lock = make_fork_lock()


@dataclass
class _Opened:
    """The library's device, its filters by the names of their images, and how many calls keep the filters."""

    device: Any = None
    filters: dict[tuple[str, ...], Any] = field(default_factory=dict)
    keepers: int = 0


_opened = _Opened()


_most_bytes: ContextVar[float] = ContextVar("most_bytes", default=math.inf)


@contextmanager
def bound_library_memory(most_bytes: float) -> Iterator[None]:
    """Let the library work in tiles that fit ``most_bytes``, where it takes more. The bits stay the same."""
    token = _most_bytes.set(most_bytes)
    try:
        yield
    finally:
        _most_bytes.reset(token)


@contextmanager
def keep_library_memory() -> Iterator[None]:
    """Keep the memory of the library from call to call inside the context, and free it at the end.

    All filters work on one device: they then share one piece of memory. Fresh memory for every call would cost a fifth
    of its time.
    """
    with _library_lock:
        _opened.keepers += 1
    try:
        yield
    finally:
        with _library_lock:
            _opened.keepers -= 1
            if not _opened.keepers:
                for network in _opened.filters.values():
                    network.release()
                _opened.filters.clear()


class OidnFault(NamedTuple):
    """Why Open Image Denoise cannot be used, and what to do."""

    reason: str
    action: str
    is_installed: bool = True


def has_oidn() -> bool:
    """Return whether Open Image Denoise (the ``pyoidn`` wheel) is installed and can be loaded."""
    return look_up_oidn_fault() is None


def explain_no_oidn() -> str:
    """Return why Open Image Denoise cannot be used and what to do, without a full stop; empty where it can be used."""
    fault = look_up_oidn_fault()
    return f"{fault.reason}; {fault.action}" if fault else ""


@cache
def look_up_oidn_fault() -> OidnFault | None:
    """Return why Open Image Denoise cannot be used; None where it can be."""
    try:
        importlib.import_module("pyoidn")
    except ModuleNotFoundError:
        return OidnFault("Open Image Denoise is not installed", "pip install 'lobewise[best]'", is_installed=False)
    except (ImportError, OSError) as problem:
        # The library was built for another processor or system.
        reason = make_printable(str(problem)).removesuffix(".")
        return OidnFault(f"Open Image Denoise is installed but cannot be loaded ({reason})", "reinstall pyoidn")
    return None


def require_oidn() -> None:
    """Raise MissingDependencyError if Open Image Denoise cannot be used."""
    if fault := look_up_oidn_fault():
        raise MissingDependencyError(fault.reason, action=fault.action)


def name_oidn_guides(frame: Frame) -> tuple[str, ...]:
    """Return the guides of a frame that `denoise_oidn` passes on: "albedo", "normal", both or none."""
    albedos, normal = _choose_guides(frame.gbuffer, OIDN_GUIDES[0])
    return tuple(name for name, is_there in (("albedo", bool(albedos)), ("normal", normal is not None)) if is_there)


def has_clean_guides(frame: Frame) -> bool:
    """Return whether all guides that `denoise_oidn` passes on are means without the noise of samples."""
    guides = frame.gbuffer
    if guides.denoiser_albedo is not None or guides.denoiser_normal is not None:
        return False
    pairs = (
        (guides.normal, guides.mean_normal),
        (guides.diffuse_albedo, guides.mean_diffuse_albedo),
        (guides.specular_albedo, guides.mean_specular_albedo),
    )
    return all(noisy is None or mean is not None for noisy, mean in pairs)


@keep_library_memory()
def denoise_oidn(
    frame: Frame,
    *,
    quality: str = "high",
    guides: str = "prefiltered",
) -> tuple[FloatArray, float]:
    """Denoise with Intel Open Image Denoise, which takes HDR colour and albedo and normal of the first hit.

    Source: its manual, "Open Image Denoise Overview", on albedos and normals, on prefiltering, and on ``cleanAux``.
    ``cleanAux`` declares the guides free of noise; it is set for every value of ``guides`` but "noisy".

    Parameters
    ----------
    frame : Frame
        NaN and infinite values count as 0. Albedos and normals are passed on if the frame has them. The albedo is
        ``denoiser_albedo``, or else the sum of diffuse and specular albedo, clipped to [0, 1]. The normal is
        ``denoiser_normal``, or else the frame's normal. Images over the pixel's area (``mean_...``) are preferred to
        the plain images, which have the noise of samples. With "centre" only the plain images are used. Normals that
        are equal everywhere carry no information and are left out: some readers fill in missing normals so. The library
        takes normals only together with an albedo, so a frame without albedo gets a white one. Where color and albedo
        are gray, so is the result. Sides of less than `MIN_SIDE_PIXELS` are continued by mirrored pixels, because the
        library darkens small images.
    quality : {"fast", "balanced", "high"}
        Quality of the filters of radiance and guides; "high" is the library's default.
    guides : {"prefiltered", "mean", "noisy", "centre"}
        "prefiltered": the means of albedo and normal over the pixel, each denoised by the library's filter for guides.
        "mean": these means as they are. "noisy": the same, and the library takes them for noisy, which costs half the
        time. "centre": albedo and normal of the ray through the pixel's centre. A frame without ``mean_normal`` has
        only the normal of the centre.

    Returns
    -------
    image : (height, width, 3)
        Of the type that the frame's color had.
    seconds : float
        Wall time of the library's calls. The first call for a size includes the setup of the networks.

    Raises
    ------
    InputError
        If ``guides`` or a quality is unknown.
    MissingDependencyError
        If ``pyoidn`` is not installed.
    DeviceError
        If the library reports a problem.
    """
    require_kind("frame", frame, Frame)
    require_choice("guides", guides, OIDN_GUIDES)
    require_choice("quality", quality, OIDN_QUALITIES)
    require_oidn()
    color, given = _make_finite(frame.radiance.color), _take_guides(frame.gbuffer, guides)
    is_gray = _is_gray(color) and _is_gray(given.get("albedo", color))
    start = time.perf_counter()
    if guides == "prefiltered":
        given = _prefilter(given, quality)
    if "normal" in given:
        given = {"albedo": np.ones_like(color), **given}
    image = _run_library(quality, is_clean=guides != "noisy", color=color, **given)
    seconds = time.perf_counter() - start
    return make_array(frame.radiance.maker, _drop_chroma(image) if is_gray else image), seconds


def reduce_guides(guides: GBuffer) -> GBuffer:
    """Return the albedo and the normal that `denoise_oidn` takes of guides; no other images."""
    given = _take_guides(guides, "prefiltered")
    return GBuffer(denoiser_albedo=given.get("albedo"), denoiser_normal=given.get("normal"))


@keep_library_memory()
def prefilter_guides(guides: GBuffer, quality: str) -> GBuffer:
    """Return what the library's filter for guides makes of the images of `reduce_guides`; no other images."""
    given = _prefilter(_take_guides(guides, "prefiltered"), quality)
    return GBuffer(denoiser_albedo=given.get("albedo"), denoiser_normal=given.get("normal"))


def _prefilter(guides: Mapping[str, FloatArray], quality: str) -> dict[str, FloatArray]:
    return {name: _run_library(quality, is_clean=True, **{name: image}) for name, image in guides.items()}


def _take_guides(gbuffer: GBuffer, guides: str) -> dict[str, FloatArray]:
    """Return the guides that the library gets, finite."""
    albedos, normal = _choose_guides(gbuffer, guides)
    albedo = np.clip(_make_finite(reduce(np.add, albedos)), 0.0, 1.0) if albedos else None
    given = {"albedo": albedo, "normal": None if normal is None else _make_finite(normal)}
    return {name: image for name, image in given.items() if image is not None}


def _locate_inside(side: int) -> slice:
    """Return the place of an image within the image that `_widen` makes, along one side."""
    before = (WIDENED_SIDE_PIXELS - side) // 2 if side < MIN_SIDE_PIXELS else 0
    return slice(before, before + side)


def _widen(image: FloatArray) -> FloatArray:
    """Return an image (height, width, 3) whose short sides are continued by mirrored pixels."""
    edges = []
    for side in image.shape[:2]:
        more = WIDENED_SIDE_PIXELS - side if side < MIN_SIDE_PIXELS else 0
        edges.append((more // 2, more - more // 2))
    return np.pad(image, [*edges, (0, 0)], mode="symmetric") if any(map(any, edges)) else image


def _is_gray(image: FloatArray) -> bool:
    return bool((image == image[..., :1]).all())


def _drop_chroma(image: FloatArray) -> FloatArray:
    """Return an image whose three channels are their mean."""
    return np.repeat(image.mean(axis=-1, keepdims=True, dtype=np.float32), 3, axis=-1)


def _choose_guides(gbuffer: GBuffer, guides: str) -> tuple[list[FloatArray], FloatArray | None]:
    """Return the albedos whose sum is passed on, and the normal or None."""

    def find(name: str) -> FloatArray | None:
        """Return the mean over the pixel's area if the frame has it and ``guides`` wants it, else the plain image."""
        mean: FloatArray | None = getattr(gbuffer, f"mean_{name}") if guides != "centre" else None
        own: FloatArray | None = getattr(gbuffer, name)
        return own if mean is None else mean

    normal = find("normal")
    if gbuffer.denoiser_normal is not None and guides != "centre":
        normal = gbuffer.denoiser_normal
    if gbuffer.denoiser_albedo is not None and guides != "centre":
        return [gbuffer.denoiser_albedo], normal if normal is not None and _varies(normal) else None
    albedos = [part for part in (find("diffuse_albedo"), find("specular_albedo")) if part is not None]
    return albedos, normal if normal is not None and _varies(normal) else None


def _varies(normal: FloatArray) -> bool:
    """Return whether the normals of surfaces, those that are not 0, differ."""
    # A few pixels settle it for most images.
    for part in (normal[::STRIDE, ::STRIDE], normal):
        there = part[(part != 0.0).any(axis=-1)]
        if (there != there[:1]).any():
            return True
    return False


def _make_finite(image: FloatArray) -> FloatArray:
    """Return an image in which NaN and infinite values are 0."""
    return image if np.isfinite(image).all() else np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)


def name_call(images: Iterable[str]) -> str:
    """Return the name of a call of the library, as a stage of a call that is watched."""
    return f"Open Image Denoise with {', '.join(images)}"


@cache
def _load_monitor() -> Any:
    """Return the function of the library that sets the monitor of a filter, which pyoidn does not declare."""
    capi = importlib.import_module("pyoidn.capi")
    capi.oidn_ffi.cdef("void oidnSetFilterProgressMonitorFunction(OIDNFilter, OIDNProgressMonitorFunction, void*);")
    return capi.oidn_Capi.oidnSetFilterProgressMonitorFunction


@contextmanager
def _watch(network: Any) -> Iterator[Callable[[], None]]:
    """Give what runs a filter of the library and tells its share, so that the caller can cancel it.

    The library calls its monitor in threads of its own. It runs in a thread, so that this one tells the share.
    """
    follow = follow_stage()
    if follow is None:
        yield network.execute
        return
    ffi, monitor = importlib.import_module("pyoidn.capi").oidn_ffi, _load_monitor()
    shares: SimpleQueue[float | None] = SimpleQueue()
    is_cancelled = Event()

    def tell(_user: Any, share: float) -> bool:
        shares.put(share)
        return not is_cancelled.is_set()

    def run() -> None:
        network.execute()
        shares.put(None)

    def execute() -> None:
        thread = Thread(target=run)
        thread.start()
        try:
            while (share := shares.get()) is not None:
                follow(share)
        finally:
            is_cancelled.set()
            thread.join()

    held = ffi.callback("OIDNProgressMonitorFunction", tell)
    monitor(network._filter, held, ffi.NULL)
    try:
        yield execute
    finally:
        monitor(network._filter, ffi.NULL, ffi.NULL)


def _run_library(quality: str, *, is_clean: bool = True, **images: FloatArray) -> FloatArray:
    """Return the first of the images denoised: ``color``, with guides, or a guide by itself.

    ``is_clean`` says whether the guides have no noise.

    Raises
    ------
    DeviceError
        If the library reports a problem.
    """
    import pyoidn

    check_limits()
    enter_stage(name_call(images))
    name, (height, width, _) = next(iter(images)), next(iter(images.values())).shape
    inside = _locate_inside(height), _locate_inside(width)
    images = {each: _widen(image) for each, image in images.items()}
    source = images[name]
    output = np.empty_like(source)
    # A filter holds the images of one call: another thread would replace them before the library reads them.
    with _library_lock:
        if _opened.device is None:
            _opened.device = pyoidn.Device()
            _opened.device.commit()
        network = _opened.filters.get(tuple(images))
        if network is None:
            network = _opened.filters[tuple(images)] = pyoidn.Filter(_opened.device, pyoidn.OIDN_FILTER_TYPE_RT)
        held = {each: np.ascontiguousarray(image) for each, image in images.items()}
        for each, image in (*held.items(), (pyoidn.OIDN_IMAGE_OUTPUT, output)):
            network.set_image(each, image, pyoidn.OIDN_FORMAT_FLOAT3)
        network.set_bool("hdr", name == "color")
        network.set_bool("cleanAux", is_clean and len(images) > 1)
        most_bytes = min(_most_bytes.get(), LIBRARY_BYTES_PER_PIXEL * math.prod(source.shape[:2]))
        network.set_int("maxMemoryMB", int(max(most_bytes, MIN_LIBRARY_BYTES) / 1e6))
        network.set_quality(getattr(pyoidn, f"OIDN_QUALITY_{quality.upper()}"))
        try:
            with _watch(network) as execute:
                network.commit()
                execute()
        finally:
            problem = _opened.device.get_error()
    if problem:
        raise DeviceError(
            "device",
            expected=f"Open Image Denoise to filter the {name}",
            got=make_printable(problem),
            action="try a smaller image, or with_oidn=False",
        )
    return np.ascontiguousarray(output[inside])
