"""Denoise renders of glossy things by comparing what each pixel reflects."""

from lobewise.errors import LobewiseError
from lobewise.frame import Camera, Frame, GBuffer, LobeKind, Radiance, Result

__version__ = "0.1.0"

__all__ = ["Camera", "Frame", "GBuffer", "LobeKind", "LobewiseError", "Radiance", "Result", "__version__"]
