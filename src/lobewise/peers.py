"""Other people's denoisers behind our frame, for benchmarks and comparisons only."""

from __future__ import annotations

import importlib.util
import time

import numpy as np

from lobewise.errors import MissingChannelError, MissingDependencyError, describe_problem
from lobewise.frame import FloatArray, Frame

OIDN_QUALITIES = ("fast", "balanced", "high")


def has_oidn() -> bool:
    """Return whether Open Image Denoise (the ``pyoidn`` wheel) is installed."""
    return importlib.util.find_spec("pyoidn") is not None


def denoise_oidn(frame: Frame, *, quality: str = "high") -> tuple[FloatArray, float]:
    """Denoise with Intel Open Image Denoise, given what it asks for: HDR colour, first-hit albedo and normal.

    The guides of our renderer are free of noise, so it is told so (``cleanAux``), its best mode for such guides.

    Parameters
    ----------
    frame : Frame
        With normals; albedos are used where the frame has them (sum of diffuse and specular, clipped to [0, 1]).
    quality : {"fast", "balanced", "high"}
        "high" is the library's default.

    Returns
    -------
    image : (height, width, 3)
    seconds : float
        Wall time of the call, the network's setup for this size included if it is the first.

    Raises
    ------
    MissingDependencyError
        If ``pyoidn`` is not installed.
    MissingChannelError
        If the frame has no normals.
    """
    if not has_oidn():
        raise MissingDependencyError("Open Image Denoise is not installed; pip install 'lobewise[compare]'.")
    from pyoidn.denoise import denoise

    guides = frame.gbuffer
    if guides.normal is None:
        raise MissingChannelError(
            describe_problem("channel normal", expected="one", got="none", action="render it with the frame")
        )
    albedo = np.ones((*frame.shape, 3), dtype=np.float32)
    parts = [part for part in (guides.diffuse_albedo, guides.specular_albedo) if part is not None]
    if parts:
        albedo = np.clip(np.sum(parts, axis=0, dtype=np.float32), 0.0, 1.0)
    color, normal = np.array(frame.radiance.color), np.array(guides.normal)
    start = time.perf_counter()
    image = denoise(color, albedo, normal, hdr=True, clean_aux=True, quality=quality)
    return np.asarray(image, dtype=np.float32), time.perf_counter() - start
