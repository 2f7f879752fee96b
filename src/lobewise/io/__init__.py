"""Files: OpenEXR images with the G-buffer, camera and sample count that a frame needs."""

from __future__ import annotations

from lobewise.io.exr import read_frame, write_frame, write_image
from lobewise.io.exr.describe import FileDescription
from lobewise.io.exr.sparse import read_sparse_frame, write_sparse_frame

__all__ = [
    "FileDescription",
    "read_frame",
    "read_sparse_frame",
    "write_frame",
    "write_image",
    "write_sparse_frame",
]
