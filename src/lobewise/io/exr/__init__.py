"""Read and write frames as OpenEXR files; one module for each step from bytes to frames."""

from __future__ import annotations

from lobewise.io.exr.frames import read_frame, read_whole, write_frame, write_image

__all__ = ["read_frame", "read_whole", "write_frame", "write_image"]
