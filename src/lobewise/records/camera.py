"""The pinhole camera, the rays of its pixels, and the motion of surface points between two cameras."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import MAX_GOT_LETTERS, InputError, name_value, require_kind, require_number
from lobewise.work.chunks import Chunk, run_chunks

MAX_COORDINATE = float(np.finfo(np.float32).max)
"""Largest coordinate of a camera: images hold positions in single precision."""

PINHOLE_DISTANCE_OVER_VIEW = 3000.0
"""Distance of the pinhole that replaces an orthographic camera, over the size of its view. The slopes of its rays
differ by at most 1/3000. The image is off by at most half a pixel if the scene is as deep as the image is high."""


def _as_vector(name: str, value: ArrayLike) -> NDArray[np.float64]:
    try:
        # A conversion to float would accept strings of digits and drop the imaginary part of complex numbers.
        vector = np.asarray(value)
        vector = vector.astype(np.float64) if vector.dtype.kind in "fiu" else np.empty(0)
    except (TypeError, ValueError, OverflowError):
        vector = np.empty(0)
    if vector.shape != (3,) or not (np.abs(vector) <= MAX_COORDINATE).all():
        expected = f"three finite numbers, of which none is beyond {MAX_COORDINATE:.2g}"
        raise InputError(name, expected=expected, got=name_value(value, MAX_GOT_LETTERS), action="pass (x, y, z)")
    vector = vector.copy()
    vector.flags.writeable = False
    return vector


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in world space.

    Parameters
    ----------
    position : array_like, shape (3,)
        Centre of projection, in the world unit of the G-buffer's positions.
    forward : array_like, shape (3,)
        Viewing direction; normalised on construction.
    up : array_like, shape (3,)
        Any vector that is not parallel to ``forward``; made orthogonal to it and normalised on construction.
    fov_y : float
        Full vertical angle of view, radians, in (0, pi).
    fov_x : float, optional
        Full horizontal angle of view, radians; by default pixels are square.
    shift : (float, float)
        Offset of the image's centre on the plane at distance 1 from the camera, to the right and upwards from the point
        where ``forward`` meets the plane. A shifted lens and a part of a larger image have an offset.

    Raises
    ------
    InputError
        If a vector is not three finite numbers within `MAX_COORDINATE`, is zero, or ``up`` is parallel to ``forward``,
        or an angle or the shift is out of range.
    """

    position: NDArray[np.float64]
    forward: NDArray[np.float64]
    up: NDArray[np.float64]
    fov_y: float
    fov_x: float | None = None
    shift: tuple[float, float] = (0.0, 0.0)
    band: tuple[int, int] | None = field(default=None, init=False, repr=False, compare=False)
    """First row and height of the whole image, if images hold only some of its rows; see `crop_rows`."""

    if TYPE_CHECKING:  # the constructor takes more types than the fields have

        def __init__(
            self,
            position: ArrayLike,
            forward: ArrayLike,
            up: ArrayLike,
            fov_y: float,
            fov_x: float | None = None,
            shift: tuple[float, float] = (0.0, 0.0),
        ) -> None: ...

    def __post_init__(self) -> None:
        position = _as_vector("camera position", self.position)
        forward = _as_vector("camera forward", self.forward)
        up = _as_vector("camera up", self.up)
        for name, vector in (("forward", forward), ("up", up)):
            if not vector.any():
                raise InputError(
                    f"camera {name}", expected="a direction", got="a vector of length 0", action="pass another"
                )
        right = np.cross(forward, up)
        if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
            raise InputError(
                "camera up",
                expected="a vector that is not parallel to forward",
                got=str(tuple(map(float, up))),
                action="pass another up",
            )
        for name, angle in (("fov_y", self.fov_y), ("fov_x", self.fov_x)):
            if angle is not None and not 0.0 < require_number(f"camera {name}", angle) < np.pi:
                fits = np.pi <= angle < 180.0
                action = f"{angle:g} degrees are {np.radians(angle):.4g} radians" if fits else "pass another"
                raise InputError(
                    f"camera {name}", expected="an angle in (0, pi) radians", got=name_value(angle), action=action
                )
        require_kind("camera shift", self.shift, tuple, list, np.ndarray)
        shift = tuple(require_number("camera shift", part) for part in self.shift)
        if len(shift) != 2 or not np.isfinite(shift).all():
            raise InputError(
                "camera shift", expected="two finite numbers", got=name_value(self.shift), action="pass (x, y)"
            )
        object.__setattr__(self, "shift", shift)
        forward = forward / np.linalg.norm(forward)
        up = np.cross(right / np.linalg.norm(right), forward)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "forward", _as_vector("camera forward", forward))
        object.__setattr__(self, "up", _as_vector("camera up", up))

    @property
    def right(self) -> NDArray[np.float64]:
        """Direction of increasing column in the image, shape (3,), unit length."""
        return np.cross(self.forward, self.up)

    def crop_rows(self, first: int, height: int) -> Camera:
        """Return this camera for images that hold only the rows from ``first`` on of an image of ``height`` rows.

        Rays and angles have the same bits as in the whole image.
        """
        camera = copy(self)
        object.__setattr__(camera, "band", (first, height))
        return camera

    def get_rows(self, height: int) -> tuple[int, int]:
        """Return the first row and the height of the whole image, for images of ``height`` rows."""
        return (0, height) if self.band is None else self.band

    def get_half_extent(self, width: int, height: int) -> tuple[float, float]:
        """Return the half width and half height of the image plane at distance 1."""
        _, rows = self.get_rows(height)
        half_height = float(np.tan(0.5 * self.fov_y))
        half_width = half_height * width / rows if self.fov_x is None else float(np.tan(0.5 * self.fov_x))
        return half_width, half_height

    def with_pixel_aspect(self, width: int, height: int, aspect: float) -> Camera:
        """Return the camera of an image whose pixels are ``aspect`` times as wide as they are high.

        Square pixels, and a camera with ``fov_x``, need no change.
        """
        if aspect == 1.0 or self.fov_x is not None:
            return self
        half_width = float(np.tan(0.5 * self.fov_y)) * aspect * width / height
        return replace(self, fov_x=float(2.0 * np.arctan(half_width)))

    @property
    def middle(self) -> NDArray[np.float64]:
        """Vector to the image's centre on the plane at distance 1, shape (3,)."""
        if self.shift == (0.0, 0.0):
            return self.forward
        return self.forward + self.shift[0] * self.right + self.shift[1] * self.up

    def get_pixel_angle(self, height: int) -> float:
        """Return the angle that one pixel at the image centre subtends vertically, radians."""
        return float(2.0 * np.tan(0.5 * self.fov_y) / self.get_rows(height)[1])

    def get_ray_numbers(self, size: tuple[int, int]) -> dict[str, NDArray[np.float64]]:
        """Return the numbers of the rays through pixels of an image, (height, width), for kernels.

        They are the ray of the first pixel, the steps per pixel right and down, and the number of the first row.
        """
        height, width = size
        first_row, rows = self.get_rows(height)
        half_width, half_height = self.get_half_extent(width, height)
        right, down = 2.0 * half_width / width * self.right, -2.0 * half_height / rows * self.up
        corner = self.middle - half_width * self.right + half_height * self.up
        first_ray = corner + 0.5 * (right + down)
        return {
            "first_ray": first_ray,
            "ray_right": right,
            "ray_down": down,
            "first_row": np.array([float(first_row)]),
        }

    def get_projection_numbers(self, size: tuple[int, int]) -> dict[str, NDArray[np.float64]]:
        """Return the numbers by which kernels project places to an image, (height, width).

        They are the camera's position and direction, and its axes in units of the half image.
        """
        height, width = size
        half_width, half_height = self.get_half_extent(width, height)
        return {
            "before": self.position,
            "before_forward": self.forward,
            # Kernels divide a step by its depth, so the shift of the image is subtracted per unit of depth.
            "before_right": (self.right - self.shift[0] * self.forward) / half_width,
            "before_up": (self.up - self.shift[1] * self.forward) / half_height,
        }

    def get_plane(self, width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the coordinates of pixel centres on the plane at distance 1, x of columns and y (upwards) of rows."""
        first, rows = self.get_rows(height)
        half_width, half_height = self.get_half_extent(width, height)
        x = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * half_width
        y = (1.0 - (np.arange(first, first + height) + 0.5) / rows * 2.0) * half_height
        return x + self.shift[0], y + self.shift[1]

    def make_ray_directions(self, width: int, height: int) -> NDArray[np.float32]:
        """Return the unit directions through the pixel centres, shape (height, width, 3), row 0 on top."""
        x, y = self.get_plane(width, height)
        rays = self.forward + x[None, :, None] * self.right + y[:, None, None] * self.up
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return rays.astype(np.float32)

    def make_positions(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the world positions, shape (height, width, 3), of ray distances ``depth``, shape (height, width)."""
        rays = self.make_ray_directions(depth.shape[1], depth.shape[0])
        return np.asarray(self.position.astype(np.float32) + depth[..., None] * rays, dtype=np.float32)


def project_points(camera: Camera, points: NDArray[np.floating[Any]], width: int, height: int) -> NDArray[np.float32]:
    """Return the pixel coordinates of world points, shape (..., 2): column and row, pixel centres at .5.

    The coordinates of a point behind the camera are not finite.
    """
    half_width, half_height = camera.get_half_extent(width, height)
    # Coordinates of points that are not finite are not finite either.
    with np.errstate(invalid="ignore", over="ignore"):
        offset = points - camera.position
        ahead = offset @ camera.forward
        scale = np.divide(1.0, ahead, out=np.full_like(ahead, np.nan), where=ahead > 0)
        x = ((offset @ camera.right) * scale - camera.shift[0]) / half_width
        y = ((offset @ camera.up) * scale - camera.shift[1]) / half_height
        return np.stack([(x + 1.0) * 0.5 * width, (1.0 - y) * 0.5 * height], axis=-1).astype(np.float32)


def compute_motion(
    camera: Camera, previous: Camera, position: NDArray[np.float32], depth: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return where each pixel's surface point was in the previous frame, relative to the pixel.

    A pixel without a surface (depth 0) shows the background, which is infinitely far. A point that lay behind the
    previous camera moves by twice the size of the image, so that it is outside.

    Parameters
    ----------
    position : (height, width, 3)
        World positions of the surface points in the previous frame; ignored where the depth is 0.
    depth : (height, width)
        Distances along the rays; 0, or not finite, for the background.

    Returns
    -------
    (height, width, 2)
        Pixels, previous minus current place, x right and y down.
    """
    height, width = depth.shape
    is_hit = (depth > 0) & np.isfinite(depth)
    rays = None if is_hit.all() else camera.make_ray_directions(width, height)
    outside = np.array([2.0 * width, 2.0 * height])
    motion = np.empty((height, width, 2), np.float32)

    def work(chunk: Chunk) -> None:
        points = position[chunk].astype(np.float64)
        if rays is not None:
            points = np.where(is_hit[chunk][..., None], points, rays[chunk] + previous.position)
        step = project_points(previous, points, width, height).astype(np.float64)
        step[..., 0] -= np.arange(width)[chunk[1]] + 0.5
        step[..., 1] -= np.arange(height)[chunk[0], None] + 0.5
        motion[chunk] = np.where(np.isfinite(step), step, outside)

    run_chunks(work, height, width)
    return motion
