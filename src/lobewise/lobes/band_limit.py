"""The band-limit: the smallest width of a lobe, which keeps the lobe of a mirror finite."""

from __future__ import annotations

import numpy as np

from lobewise.camera import Camera

NORMAL_ERROR = 1e-3
"""Standard deviation of the guides' normals, radians. An error e of the normal turns the reflection by 2 e."""


def default_tau(camera: Camera, height: int) -> float:
    """Return the band-limit, radians: the angle of a pixel and twice `NORMAL_ERROR`, added in square."""
    return float(np.hypot(camera.get_pixel_angle(height), 2.0 * NORMAL_ERROR))
