"""Whether a roughness is perceptual or alpha, where a second pass of the file tells it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from lobewise.frame import FloatArray
from lobewise.interchange.channels import keep_beside, list_passes
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.geometry import FEWEST_SAMPLES, choose_centers
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.interchange.values import convert_plain, undo_mean_roughness

if TYPE_CHECKING:
    from lobewise.io.exr.container import Container

APART = 0.05
"""Median difference from the roughness that the second pass tells, from which on the first is another number."""
ALIKE = 0.02
"""That up to which it is the same."""
MIDDLE = (0.1, 0.9)
"""Roughnesses which differ enough from their squares."""
NOT_ROUGHNESS = 0.2
"""Share of the pixels above 1 from which on numbers are hardly roughnesses."""
ROUNDING = 1e-3
MEANINGS: dict[str, tuple[str, ...]] = {
    "perceptual roughness": ("square",),
    "microfacet alpha": (),
    "glossiness": ("invert", "square"),
}
"""What a roughness may be, and how it becomes alpha."""


def name_assumption(channels: ChannelMap) -> list[str]:
    """Return the sentence for a roughness of which neither a renderer nor the user says what it is."""
    found = channels.roles.get("roughness")
    if channels.preset.name != "generic" or found is None or "square" not in found.convert:
        return []
    return [
        f"{found.label} is taken for perceptual roughness, as nothing in a frame tells; if it is microfacet alpha, "
        f"--map roughness={','.join(found.channels)} takes it for that."
    ]


def check_range(roughness: FloatArray, label: str) -> list[Finding]:
    """Return what was found of numbers that are clamped to [0, 1] when they are read."""
    high, low = float(roughness.max()), float(roughness.min())
    if high <= 1.0 + ROUNDING and low >= -ROUNDING:
        return []
    outside = float(((roughness > 1.0 + ROUNDING) | (roughness < -ROUNDING)).mean())
    told = f"{label} goes from {low:.3g} to {high:.3g} and lies outside [0, 1] at {100.0 * outside:.2g} % of the pixels"
    if outside > NOT_ROUGHNESS:
        told += ", too many for a roughness: it was clamped (--map roughness=..., for percent with :hundredth)."
        return [Finding("not a roughness", told, mended=False)]
    return [Finding("roughness out of range", f"{told}: clamped.", mended=True)]


def find_second(container: Container, channels: ChannelMap) -> Found | None:
    """Return the pass that holds the mean roughness of all lobes, where another one is taken for the roughness."""
    rules = [rule for rule in channels.preset.roles.get("roughness", ()) if "cycles_roughness" in rule.convert]
    taken = channels.roles.get("roughness")
    if not rules or taken is None or "cycles_roughness" in taken.convert:
        return None
    for one in keep_beside(list_passes(container), channels.roles["color"].source.part):
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
    """Return microfacet alphas, and what was found of the pass that they are made of.

    Parameters
    ----------
    alpha : (height, width)
        Alphas if that pass is what it was taken for.
    raw : (height, width)
        As in the file.
    found, second : Found
        The pass, and that of the mean over all lobes.
    read : callable
        Gives the pixels of an image of the file.
    albedos : pair of (height, width, 3)
        Diffuse and specular, by which the mean is undone.
    """
    undone = undo_mean_roughness(read(second), *albedos)
    if undone is None:
        return alpha, []
    centers = choose_centers((alpha.shape[0], alpha.shape[1]), 0)
    wanted, known, taken = undone[0][centers], undone[1][centers], raw[centers]
    kept = known & (wanted > MIDDLE[0]) & (wanted < MIDDLE[1])
    if kept.sum() < FEWEST_SAMPLES:
        return alpha, []

    def measure(words: tuple[str, ...]) -> float:
        return float(np.median(np.abs(np.sqrt(convert_plain(taken[kept], words).clip(0.0)) - wanted[kept])))

    best = min(MEANINGS, key=lambda name: measure(MEANINGS[name]))
    if measure(found.convert) < APART or measure(MEANINGS[best]) > ALIKE:
        return alpha, []
    told = f"{found.label} is {best}, as {second.label} shows, so it was taken for that."
    converted = convert_plain(raw, MEANINGS[best])
    return np.clip(np.nan_to_num(converted, nan=1.0), 0.0, 1.0), [
        Finding("roughness of another meaning", told, mended=True)
    ]
