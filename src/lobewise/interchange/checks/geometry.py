"""Surfaces measured from positions at some pixels. Other guides are compared with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.stand_ins import compute_normals
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

MAX_PIXELS = 12000
"""Largest number of pixels that are measured."""
MIN_PIXELS = 60
"""Smallest number of measured pixels from which a check draws conclusions."""
MAX_PLANE_DISTANCE = 0.1
"""Largest distance of a flat surface's points from the plane through them, over the distance between the points."""

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Patches:
    """Pixels around which the surface is flat.

    Parameters
    ----------
    rows, columns : (n,)
        Pixel coordinates.
    normal : (n, 3)
        Unit normal of the plane through the points of the neighbours, on the camera's side.
    view : (n, 3)
        Unit direction to the camera.
    """

    rows: Indices
    columns: Indices
    normal: FloatArray
    view: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, image: FloatArray) -> FloatArray:
        """Return the values of an image at these pixels."""
        return np.asarray(image[self.rows, self.columns])

    def thin_out(self, max_count: int) -> Patches:
        """Return at most ``max_count`` of the pixels, evenly spread."""
        step = slice(None, None, -(-len(self) // max_count) or 1)
        return Patches(self.rows[step], self.columns[step], self.normal[step], self.view[step])


def choose_centers(shape: tuple[int, int], reach: int, max_count: int = MAX_PIXELS) -> tuple[Indices, Indices]:
    """Return rows and columns of a regular grid over an image that keeps ``reach`` pixels away from the edges."""
    height, width = shape
    step = max(1, int(np.ceil(np.sqrt(height * width / max_count))))
    rows, columns = np.arange(reach, height - reach, step), np.arange(reach, width - reach, step)
    # Shift every second row by half a step, so that the grid does not miss patterns that repeat with its columns.
    grid_rows, grid_columns = np.meshgrid(rows, columns, indexing="ij")
    grid_columns = grid_columns + (np.arange(len(rows)) % 2)[:, None] * (step // 2)
    inside = grid_columns < width - reach
    return grid_rows[inside], grid_columns[inside]


def list_patches(position: FloatArray, camera: Camera) -> Patches:
    """Return the pixels whose positions lie on flat surfaces, and the normals of these surfaces.

    Parameters
    ----------
    position : (height, width, 3)
        World positions. They are 0 or not finite where there is no surface.
    camera : Camera
        The camera towards which the normals are turned.
    """
    height, width = position.shape[:2]
    reach = 1 if height * width < 250_000 else 2
    rows, columns = choose_centers((height, width), reach)
    steps = ((0, 0), (0, reach), (0, -reach), (reach, 0), (-reach, 0))
    points = np.stack([position[rows + down, columns + right] for down, right in steps]).astype(np.float64)
    there = (np.isfinite(points).all(axis=-1) & (points != 0.0).any(axis=-1)).all(axis=0)
    rows, columns, points = rows[there], columns[there], points[:, there]
    center, right, left, down, up = points
    across, along = right - left, down - up
    to_camera = camera.position - center
    normal, length = compute_normals(across, along, to_camera)
    scale = np.minimum(np.linalg.norm(across, axis=-1), np.linalg.norm(along, axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        view = to_camera / np.linalg.norm(to_camera, axis=-1, keepdims=True)
        apart = np.abs(((points[1:] - center) * normal).sum(axis=-1)).max(axis=0)
        flat = (
            (length[:, 0] > 1e-3 * scale * scale)
            & (apart < MAX_PLANE_DISTANCE * scale)
            & np.isfinite(view).all(axis=-1)
        )
    return Patches(rows[flat], columns[flat], normal[flat].astype(np.float32), view[flat].astype(np.float32))
