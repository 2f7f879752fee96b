"""Denoise renders of glossy things by comparing what each pixel reflects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lobewise.errors import LobewiseError
from lobewise.frame import Camera, Frame, GBuffer, LobeKind, Radiance, Result
from lobewise.lobe_table import LobeTable

if TYPE_CHECKING:
    from lobewise.denoising import DenoiseSettings, denoise
    from lobewise.io.exr import read_frame, write_frame, write_result
    from lobewise.kernels.features import Feature

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "DenoiseSettings",
    "Feature",
    "Frame",
    "GBuffer",
    "LobeKind",
    "LobeTable",
    "LobewiseError",
    "Radiance",
    "Result",
    "__version__",
    "denoise",
    "read_frame",
    "write_frame",
    "write_result",
]

# Halide and OpenEXR load on first use, so that importing the package stays cheap.
_LAZY = {
    "DenoiseSettings": "lobewise.denoising",
    "Feature": "lobewise.kernels.features",
    "denoise": "lobewise.denoising",
    "read_frame": "lobewise.io.exr",
    "write_frame": "lobewise.io.exr",
    "write_result": "lobewise.io.exr",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        value = getattr(importlib.import_module(_LAZY[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'lobewise' has no attribute {name!r}")
