"""The band-limit: how wide every lobe is at least, so that a mirror's is finite."""

from __future__ import annotations

import numpy as np

from lobewise.camera import Camera

NORMAL_ERROR = 1e-3
"""Standard deviation of the guides' normals, radians; a normal that is off by e turns the reflection by 2 e."""


def default_tau(camera: Camera, height: int) -> float:
    """Return the band-limit in radians: the angle of a pixel and the error of the normals, added in square."""
    return float(np.hypot(camera.get_pixel_angle(height), 2.0 * NORMAL_ERROR))
