"""Checks of guides as a file stores them: NaN and infinity, normals encoded as colors, albedos out of range."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.survey import decode_normals, is_uniform
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.geometry import MIN_PIXELS, choose_centers
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.interchange.values import MIN_EMPTY_DISTANCE
from lobewise.records.frame import FloatArray

MAX_ROUNDING_ERROR = 1e-3
"""Largest distance of an albedo from [0, 1] that the rounding of 16-bit floats explains."""
MAX_SHARE_ABOVE_ONE = 0.2
"""Largest share of pixels above 1 in an albedo. An image with more of them is probably light."""
MAX_LENGTH_ERROR = 0.1
"""Largest difference from 1 of the lengths of three quarters of the normals. Averaged bumps have shorter normals."""
MAX_NORMAL_LENGTH = 1.05
"""Length above which a normal is too long to be a mean of unit normals."""
MAX_SHARE_OF_EXCEPTIONS = 0.01
"""Largest share of the pixels that may contradict an encoding of normals."""

SURFACES = ("normal", "denoiser_normal", "position", "depth", "roughness")
"""Roles that are left out where they are 0 everywhere."""
PLACES = ("position", "depth")
"""Roles that are left out where they have one value everywhere."""
LOBE_ALBEDOS = ("diffuse_albedo", "specular_albedo")
ALBEDOS = ("albedo", *LOBE_ALBEDOS)

Mask = NDArray[np.bool_]


def leave_out_empty(channels: ChannelMap, read: Callable[[Found], FloatArray]) -> ChannelMap:
    """Return the channels without guides that hold nothing, and the reason for each in ``refused``.

    A renderer writes a pass of zeros where nobody filled it. An albedo may be black where it has no light to scatter.

    Parameters
    ----------
    channels : ChannelMap
        The images of the file.
    read : callable
        Returns an image of the file.
    """
    refused, roles = dict(channels.refused), dict(channels.roles)
    for role in (*SURFACES, *ALBEDOS):
        found = roles.get(role)
        if found is None:
            continue
        image = read(found)
        # NumPy's `any` warns of a signalling NaN.
        if not np.count_nonzero(image):
            refused[role] = f"{found.label} is not used as {role}: it is 0 everywhere."
        elif role in PLACES and is_uniform(image) and image[..., 0].size > 1:
            refused[role] = f"{found.label} is not used as {role}: it has the same value everywhere."
    albedos = [layer.albedo for layer in channels.layers if layer.albedo]
    is_used = any(role in roles and role not in refused for role in LOBE_ALBEDOS)
    if is_used or any(np.count_nonzero(read(albedo)) for albedo in albedos):
        # Of the albedos of lobes some may be black, as in a scene of metals.
        refused = {role: reason for role, reason in refused.items() if role not in LOBE_ALBEDOS or role not in roles}
    if len(refused) == len(channels.refused):
        return channels
    return replace(channels, refused=refused, roles={role: one for role, one in roles.items() if role not in refused})


def check_values(
    images: Mapping[str, FloatArray], labels: Mapping[str, str]
) -> tuple[dict[str, FloatArray], list[Finding]]:
    """Return guides whose NaN and infinite values were filled from neighbouring pixels, and findings.

    Infinite depths and positions are left alone: they mean that there is no surface.
    """
    changed, findings = {}, []
    for role, image in images.items():
        bad = _mark_bad(image, infinite=role not in ("depth", "position"))
        if bad is None:
            continue
        count = int(bad.sum())
        changed[role], filled = fill_bad(image, bad)
        rest = f", {count - filled} have none around them and count as 0" if filled < count else ""
        note = f"{labels[role]} is no number at {count} pixels: {filled} were filled from their neighbours{rest}."
        findings.append(Finding("guides without numbers", note, mended=True))
    return changed, findings


def _mark_bad(image: FloatArray, *, infinite: bool) -> Mask | None:
    """Return which pixels are NaN, or with ``infinite`` also infinite. Return None if no pixel is."""
    with np.errstate(all="ignore"):
        # One fast sum is enough for most images. A comparison with NaN is false.
        if np.vdot(image, image) < MIN_EMPTY_DISTANCE:
            return None
        bad = ~(np.abs(image) < MIN_EMPTY_DISTANCE) if infinite else np.isnan(image)
    bad = np.asarray(bad.any(axis=-1)) if bad.ndim == 3 else bad
    return bad if bad.any() else None


def fill_bad(image: FloatArray, bad: Mask) -> tuple[FloatArray, int]:
    """Return an image whose bad pixels are the mean of their good neighbours, and the number of pixels filled.

    A pixel is filled if at least five of its eight neighbours are good. Other bad pixels become 0, as those at the
    border of a region without any values.
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
    """Return findings on albedos outside [0, 1], which reading clamps. ``images`` has them by their channels."""
    findings = []
    for label, image in images.items():
        high, low = float(image.max()), float(image.min())
        if high <= 1.0 + MAX_ROUNDING_ERROR and low >= -MAX_ROUNDING_ERROR:
            continue
        above = int((image > 1.0 + MAX_ROUNDING_ERROR).any(axis=-1).sum())
        below = int((image < -MAX_ROUNDING_ERROR).any(axis=-1).sum())
        if above > MAX_SHARE_ABOVE_ONE * image.shape[0] * image.shape[1]:
            note = (
                f"{label} is above 1 at {above} pixels (up to {high:.3g}), too many for an albedo: is it light? "
                "It was clamped; another pass is chosen by --map."
            )
            findings.append(Finding("not an albedo", note, mended=False))
            continue
        parts = [f"above 1 at {above} pixels (up to {high:.3g})"] if above else []
        parts += [f"below 0 at {below} pixels (down to {low:.3g})"] if below else []
        findings.append(Finding("albedo out of range", f"{label} is {' and '.join(parts)}: clamped.", mended=True))
    return findings


def check_encoding(normal: FloatArray, label: str, *, encoded: bool) -> tuple[FloatArray | None, list[Finding]]:
    """Return normals as [-1, 1], or None if they need no change of encoding, and findings.

    Parameters
    ----------
    normal : (height, width, 3)
        Normals as the file stores them.
    label : str
        Channels of the normals.
    encoded : bool
        Whether the preset or the user says that they are stored in [0, 1].
    """
    sample = normal[choose_centers((normal.shape[0], normal.shape[1]), 0)].astype(np.float64)
    # Pixels without a surface are black, or the gray that encodes 0.
    gray = (np.abs(2.0 * sample - 1.0) < 0.02).all(axis=-1)
    sample = sample[np.isfinite(sample).all(axis=-1) & (sample != 0.0).any(axis=-1) & ~gray]
    if len(sample) < MIN_PIXELS:
        return (decode_normals(normal) if encoded else None), []
    plain, decoded = np.linalg.norm(sample, axis=-1), np.linalg.norm(2.0 * sample - 1.0, axis=-1)
    if not encoded and (sample >= -MAX_ROUNDING_ERROR).all() and _is_unit(decoded) and not _is_unit(plain):
        note = f"{label} is stored in [0, 1], so it was decoded to [-1, 1]."
        return decode_normals(normal), [Finding("normals encoded", note, mended=True)]
    if (
        encoded
        and (sample < -0.05).any(axis=-1).mean() > MAX_SHARE_OF_EXCEPTIONS
        and _is_unit(plain)
        and not _is_unit(decoded)
    ):
        note = f"{label} was taken to be stored in [0, 1] but is not, so it was not decoded."
        return normal, [Finding("normals not encoded", note, mended=True)]
    lengths = decoded if encoded else plain
    if (lengths > MAX_NORMAL_LENGTH).mean() > MAX_SHARE_OF_EXCEPTIONS and not encoded:
        note = f"{label} has lengths up to {np.quantile(lengths, 0.99):.3g}, so it was normalised."
        return None, [Finding("normals not of unit length", note, mended=True)]
    return (decode_normals(normal) if encoded else None), []


def _is_unit(lengths: NDArray[np.float64]) -> bool:
    """Return whether most lengths are those of unit normals. Some may be shorter, because they are means."""
    return bool(abs(np.median(lengths) - 1.0) < 0.03 and np.quantile(np.abs(lengths - 1.0), 0.75) < MAX_LENGTH_ERROR)
