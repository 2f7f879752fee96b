"""The place of the camera of a panorama by latitude and longitude, found from the positions of its pixels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.cameras.fitting import MAX_FIT_ERROR, MIN_POINTS, CameraFit, Matrix, choose_pixels
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

ROUNDS = 8
"""Rounds in which rotation and eye are found from each other."""
MIN_COLUMNS_SEEN = 0.9
"""Share of the columns that show surfaces. Below it positions do not tell that an image shows all around."""


def fit_panorama(position: FloatArray, mask: NDArray[np.bool_]) -> CameraFit | None:
    """Return a camera where a panorama of 360 degrees was taken, None if the positions are not those of one.

    A point P that is seen in the direction d of its pixel lies on a ray from the eye e: ``(P - e) x R d = 0``, with a
    rotation R. This is linear in R and in ``[e]x R``. From this first estimate on, the rotation that brings the
    directions to the points (Kabsch 1976) and the place that is nearest to all rays are found in turn. Points that are
    far off do not count, as at silhouettes.

    Parameters
    ----------
    position : array, shape (height, width, 3)
        World positions.
    mask : array, shape (height, width)
        Pixels that have a position.

    Returns
    -------
    CameraFit or None
        A pinhole at the eye, whose pixels span the angle of those of the panorama. Its rays are others.
    """
    rows, columns = choose_pixels(mask)
    points = position[rows, columns].astype(np.float64)
    if len(rows) < MIN_POINTS or np.mean(mask.any(axis=0)) < MIN_COLUMNS_SEEN or not np.isfinite(points).all():
        return None
    center, spread = points.mean(axis=0), points.std()
    if not spread > 0.0:
        return None
    scaled, seen = (points - center) / spread, _make_directions(rows, columns, mask.shape)
    turn, eye = _estimate(scaled, seen)
    for _ in range(ROUNDS):
        angle = _measure_angles(scaled - eye, seen @ turn.T)
        near = angle <= 3.0 * np.median(angle) + 1e-12
        turn = _compute_rotation(seen[near], _normalise(scaled[near] - eye))
        eye = _intersect(scaled[near], seen[near] @ turn.T, eye)
    error = float(np.median(_measure_angles(scaled - eye, seen @ turn.T))) / (math.pi / mask.shape[0])
    if not error < MAX_FIT_ERROR:
        return None
    # A pixel at the centre of this pinhole subtends pi / height.
    camera = Camera(center + spread * eye, turn[:, 0], turn[:, 2], 2.0 * math.atan(0.5 * math.pi))
    return CameraFit(camera, error)


def _make_directions(rows: NDArray[np.intp], columns: NDArray[np.intp], size: tuple[int, int]) -> Matrix:
    """Return the directions of pixels, (count, 3): towards the image's centre, to the right of it, and up."""
    height, width = size
    longitude = ((columns + 0.5) / width * 2.0 - 1.0) * np.pi
    latitude = (0.5 - (rows + 0.5) / height) * np.pi
    flat = np.cos(latitude)
    return np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)], axis=1)


def _estimate(points: Matrix, seen: Matrix) -> tuple[Matrix, Matrix]:
    """Return the rotation, or reflection, and the eye that fit best, from equations that are linear in 18 numbers."""
    x, y, z = (points[:, axis, None] * seen for axis in range(3))
    none = np.zeros_like(seen)
    rows = np.vstack(
        [
            np.hstack([none, -z, y, -seen, none, none]),
            np.hstack([z, none, -x, none, -seen, none]),
            np.hstack([-y, x, none, none, none, -seen]),
        ]
    )
    _, axes = np.linalg.eigh(rows.T @ rows)
    turn, moved = axes[:9, 0].reshape(3, 3), axes[9:, 0].reshape(3, 3)
    cross = moved @ np.linalg.pinv(turn)
    eye = 0.5 * np.array([cross[2, 1] - cross[1, 2], cross[0, 2] - cross[2, 0], cross[1, 0] - cross[0, 1]])
    # The equations do not tell in which direction along their rays the points lie.
    ahead = ((points - eye) * (seen @ turn.T)).sum(axis=1)
    left, _, right = np.linalg.svd(turn if np.median(ahead) > 0.0 else -turn)
    return np.asarray(left @ right), eye


def _compute_rotation(seen: Matrix, toward: Matrix) -> Matrix:
    """Return the rotation, or reflection, that brings directions nearest to others."""
    left, _, right = np.linalg.svd(toward.T @ seen)
    return np.asarray(left @ right)


def _intersect(points: Matrix, rays: Matrix, eye: Matrix) -> Matrix:
    """Return the place that is nearest to lines through points, in angles as seen from ``eye``."""
    weight = 1.0 / np.maximum(((points - eye) ** 2).sum(axis=1), 1e-12)
    across = weight[:, None, None] * (np.eye(3) - rays[:, :, None] * rays[:, None, :])
    place: Matrix = np.linalg.pinv(across.sum(axis=0)) @ np.einsum("nij,nj->i", across, points)
    return place


def _measure_angles(steps: Matrix, rays: Matrix) -> Matrix:
    """Return the angles between steps and rays, radians."""
    cosine = (_normalise(steps) * rays).sum(axis=1)
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(_normalise(steps), rays), axis=1), cosine))


def _normalise(vectors: Matrix) -> Matrix:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))
