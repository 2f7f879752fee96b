"""Denoise renders of glossy things by comparing what each pixel reflects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lobewise.errors import LobewiseError

if TYPE_CHECKING:
    from lobewise.adaptive import find_unsupported, recompute
    from lobewise.camera import Camera
    from lobewise.denoising import denoise
    from lobewise.features.base import Feature
    from lobewise.frame import Frame, GBuffer, LobeKind, Radiance, Result
    from lobewise.io.exr import read_frame, write_frame, write_result
    from lobewise.io.exr.sparse import read_sparse_frame, write_sparse_frame
    from lobewise.lobe_table import LobeTable
    from lobewise.settings import DenoiseSettings, TemporalSettings
    from lobewise.sparse_frame import SparseFrame, make_sparse
    from lobewise.streaming import DenoisedFile, denoise_file
    from lobewise.temporal import TemporalFilter
    from lobewise.upsampling import upsample

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "DenoiseSettings",
    "DenoisedFile",
    "Feature",
    "Frame",
    "GBuffer",
    "LobeKind",
    "LobeTable",
    "LobewiseError",
    "Radiance",
    "Result",
    "SparseFrame",
    "TemporalFilter",
    "TemporalSettings",
    "__version__",
    "denoise",
    "denoise_file",
    "find_unsupported",
    "make_sparse",
    "read_frame",
    "read_sparse_frame",
    "recompute",
    "upsample",
    "write_frame",
    "write_result",
    "write_sparse_frame",
]

# NumPy, Halide and OpenEXR load on first use, so that importing the package and asking the program for help are cheap.
_LAZY = {
    "Camera": "lobewise.camera",
    "DenoiseSettings": "lobewise.settings",
    "DenoisedFile": "lobewise.streaming",
    "Feature": "lobewise.features.base",
    "Frame": "lobewise.frame",
    "GBuffer": "lobewise.frame",
    "LobeKind": "lobewise.frame",
    "LobeTable": "lobewise.lobe_table",
    "Radiance": "lobewise.frame",
    "Result": "lobewise.frame",
    "SparseFrame": "lobewise.sparse_frame",
    "TemporalFilter": "lobewise.temporal",
    "TemporalSettings": "lobewise.settings",
    "denoise": "lobewise.denoising",
    "denoise_file": "lobewise.streaming",
    "find_unsupported": "lobewise.adaptive",
    "make_sparse": "lobewise.sparse_frame",
    "read_frame": "lobewise.io.exr",
    "read_sparse_frame": "lobewise.io.exr.sparse",
    "recompute": "lobewise.adaptive",
    "upsample": "lobewise.upsampling",
    "write_frame": "lobewise.io.exr",
    "write_result": "lobewise.io.exr",
    "write_sparse_frame": "lobewise.io.exr.sparse",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        value = getattr(importlib.import_module(_LAZY[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'lobewise' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
