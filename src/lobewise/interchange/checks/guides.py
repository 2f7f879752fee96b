"""Guides as they stand in a file: values that are none, normals stored as colors, albedos out of range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.geometry import FEWEST_SAMPLES, choose_centers
from lobewise.interchange.values import FARTHEST

ROUNDING = 1e-3
"""How far beyond [0, 1] an albedo may be by the rounding of 16-bit floats."""
NOT_ALBEDO = 0.2
"""Share of the pixels above 1 from which on an image is hardly an albedo."""
UNIT = 0.1
"""How far the length of most normals may be from 1: means of bumps are shorter."""
LONGEST = 1.05
FEW = 0.01

Mask = NDArray[np.bool_]


def check_values(
    images: Mapping[str, FloatArray], labels: Mapping[str, str]
) -> tuple[dict[str, FloatArray], list[Finding]]:
    """Return the guides that had values that are none, those filled from their neighbours, and what was found.

    Infinite depths and positions stand for no surface and are none of them.
    """
    changed, findings = {}, []
    for role, image in images.items():
        bad = _find_bad(image, infinite=role not in ("depth", "position"))
        if bad is None:
            continue
        count = int(bad.sum())
        changed[role], filled = fill_bad(image, bad)
        rest = f", {count - filled} have none around them and count as 0" if filled < count else ""
        told = f"{labels[role]} is no number at {count} pixels: {filled} were filled from their neighbours{rest}."
        findings.append(Finding("guides without numbers", told, mended=True))
    return changed, findings


def _find_bad(image: FloatArray, *, infinite: bool) -> Mask | None:
    """Return which pixels are NaN (or infinite), None where none is; most images need but one fast sum."""
    with np.errstate(all="ignore"):
        # Not so for NaN.
        if np.vdot(image, image) < FARTHEST:
            return None
        bad = ~(np.abs(image) < FARTHEST) if infinite else np.isnan(image)
    bad = np.asarray(bad.any(axis=-1)) if bad.ndim == 3 else bad
    return bad if bad.any() else None


def fill_bad(image: FloatArray, bad: Mask) -> tuple[FloatArray, int]:
    """Return an image whose bad pixels are the mean of their neighbours, and how many are; the others become 0.

    A pixel is filled if at least five of its eight neighbours are good: at the border of a region that has no
    values at all it is left alone.
    """
    height, width = bad.shape
    filled = image.copy()
    filled[bad] = 0.0
    rows, columns = np.nonzero(bad)
    total = np.zeros((len(rows), *image.shape[2:]), np.float64)
    count = np.zeros(len(rows), np.intp)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            y, x = (rows + down).clip(0, height - 1), (columns + right).clip(0, width - 1)
            good = (
                ~bad[y, x] & ((y != rows) | (x != columns)) & (np.abs(image[y, x]) < np.inf).reshape(len(y), -1).all(1)
            )
            count += good
            total[good] += filled[y[good], x[good]]
    enough = count >= 5
    divisor = count[enough].reshape(-1, *[1] * (image.ndim - 2))
    filled[rows[enough], columns[enough]] = total[enough] / divisor
    return filled, int(enough.sum())


def check_albedos(images: Mapping[str, FloatArray]) -> list[Finding]:
    """Return what was found of albedos, by their channels: reading clamps them to [0, 1] whatever they are."""
    findings = []
    for label, image in images.items():
        high, low = float(image.max()), float(image.min())
        if high <= 1.0 + ROUNDING and low >= -ROUNDING:
            continue
        above = int((image > 1.0 + ROUNDING).any(axis=-1).sum())
        below = int((image < -ROUNDING).any(axis=-1).sum())
        if above > NOT_ALBEDO * image.shape[0] * image.shape[1]:
            told = (
                f"{label} is above 1 at {above} pixels (up to {high:.3g}), too many for an albedo: is it light? "
                "It was clamped; another pass is chosen by --map."
            )
            findings.append(Finding("not an albedo", told, mended=False))
            continue
        parts = [f"above 1 at {above} pixels (up to {high:.3g})"] if above else []
        parts += [f"below 0 at {below} pixels (down to {low:.3g})"] if below else []
        findings.append(Finding("albedo out of range", f"{label} is {' and '.join(parts)}: clamped.", mended=True))
    return findings


def check_encoding(normal: FloatArray, label: str, *, encoded: bool) -> tuple[FloatArray | None, list[Finding]]:
    """Return normals decoded, or None where they stand as they are, and what was found.

    Parameters
    ----------
    normal : (height, width, 3)
        As in the file.
    label : str
        Its channels.
    encoded : bool
        Whether they were taken to lie in [0, 1].
    """
    sample = normal[choose_centers((normal.shape[0], normal.shape[1]), 0)].astype(np.float64)
    # Nothing is stored as black, or as the gray that stands for 0.
    gray = (np.abs(2.0 * sample - 1.0) < 0.02).all(axis=-1)
    sample = sample[np.isfinite(sample).all(axis=-1) & (sample != 0.0).any(axis=-1) & ~gray]
    if len(sample) < FEWEST_SAMPLES:
        return (_decode(normal) if encoded else None), []
    plain, decoded = np.linalg.norm(sample, axis=-1), np.linalg.norm(2.0 * sample - 1.0, axis=-1)
    if not encoded and (sample >= -ROUNDING).all() and _is_unit(decoded) and not _is_unit(plain):
        told = f"{label} is stored in [0, 1], so it was decoded to [-1, 1]."
        return _decode(normal), [Finding("normals encoded", told, mended=True)]
    if encoded and (sample < -0.05).any(axis=-1).mean() > FEW and _is_unit(plain) and not _is_unit(decoded):
        told = f"{label} was taken to be stored in [0, 1] but is not, so it was not decoded."
        return normal, [Finding("normals not encoded", told, mended=True)]
    lengths = decoded if encoded else plain
    if (lengths > LONGEST).mean() > FEW and not encoded:
        told = f"{label} has lengths up to {np.quantile(lengths, 0.99):.3g}, so it was normalised."
        return None, [Finding("normals not of unit length", told, mended=True)]
    return (_decode(normal) if encoded else None), []


def _decode(normal: FloatArray) -> FloatArray:
    """Return normals that are stored in [0, 1], and black where there is none."""
    nothing = ~(normal != 0.0).any(axis=-1, keepdims=True)
    return np.asarray(np.where(nothing, np.float32(0.0), np.float32(2.0) * normal - np.float32(1.0)))


def _is_unit(lengths: NDArray[np.float64]) -> bool:
    """Return whether these are lengths of unit normals, but for those that are means."""
    return bool(abs(np.median(lengths) - 1.0) < 0.03 and np.quantile(np.abs(lengths - 1.0), 0.75) < UNIT)
