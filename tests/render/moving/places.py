"""Matrices that slide, turn and stretch."""

from collections.abc import Sequence

import numpy as np


def slide(x: float, y: float, z: float) -> np.ndarray:
    """Return the matrix of a translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def stretch(x: float, y: float, z: float) -> np.ndarray:
    """Return the matrix of a scaling."""
    return np.diag([x, y, z, 1.0])


def turn(degrees: float, about: Sequence[float]) -> np.ndarray:
    """Return the matrix of a turn about the vertical through a point."""
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    matrix = np.eye(4)
    matrix[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    point = np.asarray(about, dtype=np.float64)
    return slide(*point) @ matrix @ slide(*-point)
