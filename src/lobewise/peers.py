"""Other people's denoisers behind our frame: to compare with, and to mix with."""

from __future__ import annotations

import importlib
import time
from functools import cache, lru_cache
from typing import Any

import numpy as np

from lobewise.errors import MissingDependencyError, make_printable, require_choice
from lobewise.frame import FloatArray, Frame

OIDN_GUIDES = ("prefiltered", "mean", "centre")


def has_oidn() -> bool:
    """Return whether Open Image Denoise (the ``pyoidn`` wheel) is installed and can be loaded."""
    return not explain_no_oidn()


def explain_no_oidn() -> str:
    """Return why Open Image Denoise cannot be used here and what to do, without a stop; empty where it can."""
    return _try_to_load()


@cache
def _try_to_load() -> str:
    try:
        importlib.import_module("pyoidn")
    except ModuleNotFoundError:
        return "Open Image Denoise is not installed; pip install 'lobewise[best]'"
    except (ImportError, OSError) as problem:
        # Its library is made for other processors or systems.
        told = make_printable(str(problem)).removesuffix(".")
        return f"Open Image Denoise is installed but cannot be loaded ({told}); reinstall pyoidn"
    return ""


def require_oidn() -> None:
    """Raise MissingDependencyError if Open Image Denoise cannot be used."""
    if not has_oidn():
        raise MissingDependencyError(f"{explain_no_oidn()}.")


def name_oidn_guides(frame: Frame) -> tuple[str, ...]:
    """Return which guides of a frame `denoise_oidn` hands over, of "albedo" and "normal"."""
    albedos, normal = _find_guides(frame, OIDN_GUIDES[0])
    return tuple(name for name, is_there in (("albedo", bool(albedos)), ("normal", normal is not None)) if is_there)


def denoise_oidn(frame: Frame, *, quality: str = "high", guides: str = "prefiltered") -> tuple[FloatArray, float]:
    """Denoise with Intel Open Image Denoise, given what it asks for: HDR colour, first-hit albedo and normal.

    Source: its manual, "Open Image Denoise Overview", on albedos and normals, on prefiltering, and on ``cleanAux``,
    which tells the network that its guides are free of noise: it is set with all of ``guides``.

    Parameters
    ----------
    frame : Frame
        Albedos and normals are handed over where the frame has them. The albedo is the sum of diffuse and specular,
        clipped to [0, 1]. ``denoiser_albedo`` comes before that sum, ``denoiser_normal`` before other normals.
        ``mean_diffuse_albedo`` and ``mean_specular_albedo``, which have no noise of samples, come before the means over
        the samples that the plain albedos are. With "centre" neither does. Normals that are the same everywhere tell
        nothing, and stand for none where a reader had to make some up: they are left out. The library takes normals
        only beside an albedo, so a frame without one gives it a white one.
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
    """
    require_choice("guides", guides, OIDN_GUIDES)
    require_oidn()
    from pyoidn.denoise import denoise

    albedos, normal = _find_guides(frame, guides)
    albedo = np.clip(_make_finite(np.sum(albedos, axis=0, dtype=np.float32)), 0.0, 1.0) if albedos else None
    normal = None if normal is None else _make_finite(normal)
    color = np.array(frame.radiance.color)
    start = time.perf_counter()
    if guides == "prefiltered":
        albedo = None if albedo is None else _prefilter("albedo", albedo)
        normal = None if normal is None else _prefilter("normal", normal)
    if albedo is None and normal is not None:
        albedo = np.ones((*frame.shape, 3), dtype=np.float32)
    image = denoise(color, albedo, normal, hdr=True, clean_aux=albedo is not None, quality=quality)
    return np.asarray(image, dtype=np.float32), time.perf_counter() - start


def _find_guides(frame: Frame, guides: str) -> tuple[list[FloatArray], FloatArray | None]:
    """Return the albedos of which the sum is handed over, and the normal; none and None where there are none."""
    gbuffer = frame.gbuffer

    def find(name: str) -> FloatArray | None:
        """Return the mean over the pixel's area where it is there and asked for."""
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
    """Return whether normals, (height, width, 3), that are not 0 are more than one."""
    there = normal[(normal != 0.0).any(axis=-1)]
    return bool((there != there[:1]).any())


def _make_finite(image: FloatArray) -> FloatArray:
    """Return a copy in which what is no number, or infinite, is 0."""
    return np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)


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
