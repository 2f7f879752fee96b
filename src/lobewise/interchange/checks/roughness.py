"""Check of a roughness: its range, and whether it is perceptual or alpha if a second pass of the file shows it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.geometry import MIN_PIXELS, choose_centers
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.interchange.values import convert_plain, undo_mean_roughness
from lobewise.records.frame import FloatArray

MIN_DIFFERENCE_OF_WRONG = 0.05
"""Median difference between the roughness and the second pass, from which on the meaning of the roughness is wrong."""
MAX_DIFFERENCE_OF_RIGHT = 0.02
"""Largest median difference from the second pass at which a meaning is right."""
COMPARED_RANGE = (0.1, 0.9)
"""Range of roughness that is compared. Values near 0 and 1 differ too little from their squares."""
MAX_SHARE_OUTSIDE = 0.2
"""Largest share of pixels outside [0, 1] in a roughness. An image with more of them is something else."""
MAX_ROUNDING_ERROR = 1e-3
"""Largest distance of a roughness from [0, 1] that the rounding of 16-bit floats explains."""
MEANINGS: dict[str, tuple[str, ...]] = {
    "perceptual roughness": ("square",),
    "microfacet alpha": (),
    "glossiness": ("invert", "square"),
}
"""Meanings of a roughness, and the conversions from each to microfacet alpha."""


def name_assumption(channels: ChannelMap) -> list[str]:
    """Return a sentence on the assumed meaning of a roughness, if neither a known renderer nor the user gives it."""
    found = channels.roles.get("roughness")
    if channels.preset.name != "generic" or found is None or "square" not in found.convert:
        return []
    return [
        f"{found.label} is taken for perceptual roughness, as nothing in a frame tells; if it is microfacet alpha, "
        f"--map roughness={','.join(found.channels)} takes it for that."
    ]


def check_range(roughness: FloatArray, label: str) -> list[Finding]:
    """Return a finding if a roughness leaves [0, 1], to which reading clamps it."""
    high, low = float(roughness.max()), float(roughness.min())
    if high <= 1.0 + MAX_ROUNDING_ERROR and low >= -MAX_ROUNDING_ERROR:
        return []
    outside = float(((roughness > 1.0 + MAX_ROUNDING_ERROR) | (roughness < -MAX_ROUNDING_ERROR)).mean())
    note = f"{label} goes from {low:.3g} to {high:.3g} and lies outside [0, 1] at {100.0 * outside:.2g} % of the pixels"
    if outside > MAX_SHARE_OUTSIDE:
        note += ", too many for a roughness: it was clamped (--map roughness=..., for percent with :hundredth)."
        return [Finding("not a roughness", note, mended=False)]
    return [Finding("roughness out of range", f"{note}: clamped.", mended=True)]


def look_up_second(channels: ChannelMap) -> Found | None:
    """Return the pass of the mean roughness over all lobes, if another pass is used as the roughness."""
    rules = [rule for rule in channels.preset.roles.get("roughness", ()) if "cycles_roughness" in rule.convert]
    taken = channels.roles.get("roughness")
    if not rules or taken is None or "cycles_roughness" in taken.convert:
        return None
    for one in channels.beside:
        single = one.pick_single(rules[0].component)
        if single and one.matches(rules[0].source) and one.get_prefix(rules[0].source) == channels.prefix:
            return Found(one, single)
    return None


def check_roughness(
    alpha: FloatArray,
    raw: FloatArray,
    found: Found,
    second: Found,
    read: Callable[[Found], FloatArray],
    albedos: tuple[FloatArray | None, FloatArray | None],
) -> tuple[FloatArray, list[Finding]]:
    """Return microfacet alphas, corrected if the roughness has another meaning than assumed, and findings.

    Parameters
    ----------
    alpha : (height, width)
        Alphas by the assumed meaning of the roughness.
    raw : (height, width)
        Roughness as the file stores it.
    found, second : Found
        The pass used as the roughness, and the pass of the mean over all lobes.
    read : callable
        Returns an image of the file.
    albedos : pair of (height, width, 3)
        Diffuse and specular albedo, the weights of the mean.
    """
    undone = undo_mean_roughness(read(second), *albedos)
    if undone is None:
        return alpha, []
    centers = choose_centers((alpha.shape[0], alpha.shape[1]), 0)
    expected, known, taken = undone[0][centers], undone[1][centers], raw[centers]
    compared = known & (expected > COMPARED_RANGE[0]) & (expected < COMPARED_RANGE[1])
    if compared.sum() < MIN_PIXELS:
        return alpha, []

    def measure(words: tuple[str, ...]) -> float:
        return float(np.median(np.abs(np.sqrt(convert_plain(taken[compared], words).clip(0.0)) - expected[compared])))

    best = min(MEANINGS, key=lambda name: measure(MEANINGS[name]))
    if measure(found.convert) < MIN_DIFFERENCE_OF_WRONG or measure(MEANINGS[best]) > MAX_DIFFERENCE_OF_RIGHT:
        return alpha, []
    note = f"{found.label} is {best}, as {second.label} shows, so it was taken for that."
    converted = convert_plain(raw, MEANINGS[best])
    return np.clip(np.nan_to_num(converted, nan=1.0), 0.0, 1.0), [
        Finding("roughness of another meaning", note, mended=True)
    ]
