"""Other people's denoisers behind our frame: to compare with, and to mix with when asked."""

from __future__ import annotations

import importlib.util
import time
from functools import lru_cache
from typing import Any

import numpy as np

from lobewise.errors import MissingChannelError, MissingDependencyError, require_choice
from lobewise.frame import FloatArray, Frame

OIDN_GUIDES = ("prefiltered", "mean", "centre")


def has_oidn() -> bool:
    """Return whether Open Image Denoise (the ``pyoidn`` wheel) is installed."""
    return importlib.util.find_spec("pyoidn") is not None


def require_oidn() -> None:
    """Raise MissingDependencyError if Open Image Denoise is not installed."""
    if not has_oidn():
        raise MissingDependencyError("Open Image Denoise is not installed; pip install 'lobewise[compare]'.")


def denoise_oidn(frame: Frame, *, quality: str = "high", guides: str = "prefiltered") -> tuple[FloatArray, float]:
    """Denoise with Intel Open Image Denoise, given what it asks for: HDR colour, first-hit albedo and normal.

    Source: its manual, "Open Image Denoise Overview", on albedos and normals, on prefiltering, and on ``cleanAux``,
    which tells the network that its guides are free of noise: it is set with all of ``guides``.

    Parameters
    ----------
    frame : Frame
        With normals; albedos are used where the frame has them (sum of diffuse and specular, clipped to [0, 1]).
        ``mean_diffuse_albedo`` and ``mean_specular_albedo``, which have no noise of samples, come before the means over
        the samples that the plain albedos are; not so with "centre".
    quality : {"fast", "balanced", "high"}
        "high" is the library's default. It holds for the radiance; guides are always prefiltered at "high".
    guides : {"prefiltered", "mean", "centre"}
        "prefiltered": the means over a pixel of albedo and of normal, each through the library's own filter for such
        images. "mean": the same as they come. "centre": the normal of the ray through the pixel's centre, which a frame
        without ``mean_normal`` is given with the two others as well.

    Returns
    -------
    image : (height, width, 3)
    seconds : float
        Wall time of the calls, the networks' setup for this size included if it is the first.

    Raises
    ------
    InputError
        If ``guides`` is none of the three.
    MissingDependencyError
        If ``pyoidn`` is not installed.
    MissingChannelError
        If the frame has no normals.
    """
    require_choice("guides", guides, OIDN_GUIDES)
    require_oidn()
    from pyoidn.denoise import denoise

    albedo, normal = _find_guides(frame, guides)
    color = np.array(frame.radiance.color)
    start = time.perf_counter()
    if guides == "prefiltered":
        albedo, normal = _prefilter("albedo", albedo), _prefilter("normal", normal)
    image = denoise(color, albedo, normal, hdr=True, clean_aux=True, quality=quality)
    return np.asarray(image, dtype=np.float32), time.perf_counter() - start


def _find_guides(frame: Frame, guides: str) -> tuple[FloatArray, FloatArray]:
    """Return albedo and normal as the library takes them: in [0, 1] and [-1, 1], writable."""
    gbuffer = frame.gbuffer

    def find(name: str) -> FloatArray | None:
        """Return the mean over the pixel's area where it is there and asked for."""
        mean: FloatArray | None = getattr(gbuffer, f"mean_{name}") if guides != "centre" else None
        own: FloatArray | None = getattr(gbuffer, name)
        return own if mean is None else mean

    normal = find("normal")
    if normal is None:
        raise MissingChannelError("channel normal", expected="one", got="none", action="render it with the frame")
    albedo = np.ones((*frame.shape, 3), dtype=np.float32)
    parts = [part for part in (find("diffuse_albedo"), find("specular_albedo")) if part is not None]
    if parts:
        albedo = np.clip(np.sum(parts, axis=0, dtype=np.float32), 0.0, 1.0)
    return albedo, np.array(normal)


@lru_cache(maxsize=2)
def _open_prefilter(name: str) -> tuple[Any, Any]:
    """Return the library's device and its filter for guides of one kind, kept for the next frame as the network is."""
    from pyoidn import OIDN_FILTER_TYPE_RT, Device, Filter

    device = Device()
    device.commit()
    return device, Filter(device, OIDN_FILTER_TYPE_RT)


def _prefilter(name: str, image: FloatArray) -> FloatArray:
    """Return an albedo or normal image without its noise: the filter is given the one image and nothing else."""
    from pyoidn import OIDN_FORMAT_FLOAT3, OIDN_IMAGE_OUTPUT, OIDN_QUALITY_HIGH

    _, network = _open_prefilter(name)
    output = np.empty_like(image)
    network.set_image(name, image, OIDN_FORMAT_FLOAT3)
    network.set_image(OIDN_IMAGE_OUTPUT, output, OIDN_FORMAT_FLOAT3)
    network.set_quality(OIDN_QUALITY_HIGH)
    network.commit()
    network.execute()
    return output
