"""Frames as OpenEXR files; a module for each thing that is done with them, from bytes to frames."""

from __future__ import annotations

from lobewise.io.exr.frames import read_frame, read_image, read_whole, write_frame, write_image

__all__ = ["read_frame", "read_image", "read_whole", "write_frame", "write_image"]
