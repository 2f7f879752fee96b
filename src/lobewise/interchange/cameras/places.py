"""Where the pixels of a file lie in the image of its camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lobewise.io.exr.container import Part
from lobewise.records.camera import Camera


@dataclass(frozen=True)
class Place:
    """Where pixels lie in the image of their camera: the data window of a file in its display window.

    Parameters
    ----------
    height, width : int
        Size of the camera's image, pixels.
    top, left : int
        Row and column of the first pixel in it; below 0 where the pixels reach beyond it.
    """

    height: int
    width: int
    top: int = 0
    left: int = 0

    @classmethod
    def of(cls, part: Part, shape: tuple[int, int] | None = None) -> Place:
        """Return the place of the pixels of a part; images of another ``shape`` show some of its pixels, from all."""
        whole, window = part.display_window, part.data_window
        if shape not in (None, (window.height, window.width)):
            return cls(*shape)
        return cls(whole.height, whole.width, window.y_min - whole.y_min, window.x_min - whole.x_min)

    def crop(self, camera: Camera, height: int, width: int) -> Camera:
        """Return the camera of the image as the camera of the pixels, which have this height and width."""
        if self == Place(height, width):
            return camera
        half_width, half_height = camera.get_half_extent(self.width, self.height)
        across, down = half_width / self.width, half_height / self.height
        return replace(
            camera,
            fov_y=float(2.0 * np.arctan(height * down)),
            fov_x=float(2.0 * np.arctan(width * across)),
            shift=(
                camera.shift[0] + (2 * self.left + width - self.width) * across,
                camera.shift[1] - (2 * self.top + height - self.height) * down,
            ),
        )
