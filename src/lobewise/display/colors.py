"""Light in the primaries of screens, and the one way from light to the values of a picture."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lobewise.work.arrays import FloatArray

Chromaticities = tuple[float, ...]
"""x and y of red, green, blue and white, as the attribute ``chromaticities`` of EXR files has them."""

REC709: Chromaticities = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""Source: ITU-R BT.709-6, item 1.3 and 1.4. Files without ``chromaticities`` have them, says OpenEXR."""
AP0: Chromaticities = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
"""Source: SMPTE ST 2065-1, the primaries of ACES2065-1, by which OpenColorIO names the light of other primaries."""
_AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
_REC2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
_P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
_ADOBE = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329)
PRIMARIES_OF_SPACES: dict[str, Chromaticities] = {
    **dict.fromkeys(("lin_rec709_scene", "lin_rec709", "lin_srgb", "linear rec.709 (srgb)", "linear rec.709"), REC709),
    **dict.fromkeys(("lin_ap0_scene", "lin_ap0", "aces2065-1", "aces - aces2065-1"), AP0),
    **dict.fromkeys(("lin_ap1_scene", "lin_ap1", "acescg", "aces - acescg"), _AP1),
    **dict.fromkeys(("lin_rec2020_scene", "lin_rec2020", "linear rec.2020"), _REC2020),
    **dict.fromkeys(("lin_p3d65_scene", "lin_p3d65", "linear p3-d65"), _P3),
    **dict.fromkeys(("lin_adobergb_scene", "lin_adobergb", "linear adobergb"), _ADOBE),
}
"""Primaries of spaces of linear light, by their names in lower case. Sources: the names of the Color Interop Forum and
those of OpenColorIO's configurations; Academy S-2014-004, ITU-R BT.2020-2, SMPTE EG 432-1, Adobe RGB (1998)."""
MIN_PRIMARIES_AREA = 1e-4
"""Least area, twice, of the triangle of plausible primaries."""
MAX_CHROMATICITY_ROUNDING = 1e-3
"""Chromaticities that differ by less are the same: writers round them."""
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""Source: Lam 1985, "Metamerism and Colour Constancy", as ICC.1:2022, annex E, has it."""


def are_plausible(chromaticities: Chromaticities) -> bool:
    """Return whether chromaticities span a triangle around a white that is no imaginary light."""
    points = np.array(chromaticities).reshape(4, 2)
    spans = abs(np.linalg.det(points[1:3] - points[0])) >= MIN_PRIMARIES_AREA if np.isfinite(points).all() else False
    return bool(spans and points[3, 1] > MIN_PRIMARIES_AREA)


def convert_light(
    image: FloatArray, chromaticities: Chromaticities | None, target: Chromaticities = REC709
) -> FloatArray:
    """Return linear light, (..., 3), in the primaries ``target``; the same image where nothing changes.

    White becomes white, by the Bradford transform. ``chromaticities`` are those of the image, None for unknown ones,
    which are taken to be the target's. Pixels that are not finite stay as they are.
    """
    if chromaticities is None or np.allclose(chromaticities, target, rtol=0.0, atol=MAX_CHROMATICITY_ROUNDING):
        return image
    matrix = np.linalg.inv(_compute_to_xyz(target)) @ _compute_to_xyz(chromaticities)
    with np.errstate(invalid="ignore", over="ignore"):
        converted = image @ matrix.T.astype(np.float32)
    return np.where(np.isfinite(image).all(axis=-1, keepdims=True), converted, image)


@lru_cache(maxsize=8)
def _compute_to_xyz(chromaticities: Chromaticities) -> NDArray[np.float64]:
    """Return the matrix from linear RGB to CIE XYZ under the white of Rec. 709.

    Source: SMPTE RP 177-1993, "Derivation of Basic Television Color Equations".
    """
    points = np.array(chromaticities, dtype=np.float64).reshape(4, 2)
    columns = np.column_stack([points, 1.0 - points.sum(axis=1)]).T
    own, white = columns[:, 3] / columns[1, 3], np.array([REC709[6], REC709[7], 1.0 - REC709[6] - REC709[7]])
    to_xyz = columns[:, :3] * np.linalg.solve(columns[:, :3], own)
    gains = (_BRADFORD @ (white / REC709[7])) / (_BRADFORD @ own)
    adapted: NDArray[np.float64] = np.linalg.inv(_BRADFORD) @ (gains[:, None] * _BRADFORD) @ to_xyz
    return adapted
