"""Whether guides lie upside down or mirrored under the image: how well they explain it tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.interchange.checks.finding import Finding, list_names
from lobewise.interchange.values import FARTHEST

SIZE = 256
"""Pixels to which the longer side of the images is thinned out."""
BLOCK = 8
"""Width of the blocks, in pixels of the thinned images, in each of which the image is fitted by a guide."""
LEAST_GAIN = 0.02
"""Share of the image's variance which a flipped guide must explain beyond what it does as it lies."""
LEAST_RATIO = 1.25
"""Factor by which it must explain more."""
LEAST_SCORE = 4.0
"""Standard errors, over the blocks, by which it must explain more."""
STAYS = -2.0
"""Standard errors by which a guide must explain less, not to be flipped where all guides together are."""
RIDGE = 1e-3
BACK = slice(None, None, -1)
FLIPS = {
    "as it lies": (slice(None), slice(None)),
    "upside down": (BACK, slice(None)),
    "mirrored left to right": (slice(None), BACK),
    "turned by half a turn": (BACK, BACK),
}
LIES, *TURNS = FLIPS

Numbers = NDArray[np.float32]


@dataclass(frozen=True)
class Fit:
    """How well a guide explains an image.

    Parameters
    ----------
    fitted : mapping of str to (blocks,)
        For each orientation of `FLIPS` the variance of the image that it explains in every block.
    whole : float
        The variance of the image.
    """

    fitted: Mapping[str, Numbers]
    whole: float

    def get_explained(self, flip: str) -> float:
        """Return the share of the image's variance that the guide explains."""
        return float(self.fitted[flip].sum()) / self.whole

    def get_score(self, flip: str) -> float:
        """Return by how many standard errors the guide explains more if it is flipped.

        Compared are standard deviations, of which a few strong edges are not all.
        """
        gain = np.sqrt(self.fitted[flip]) - np.sqrt(self.fitted[LIES])
        return float(gain.sum() / (np.sqrt(len(gain)) * gain.std() + 1e-30))

    def find_flip(self) -> str:
        """Return how the guide is surely flipped, else how it lies."""
        best = max(FLIPS, key=self.get_explained)
        better, worse = self.get_explained(best), self.get_explained(LIES)
        sure = better > max(worse + LEAST_GAIN, LEAST_RATIO * worse) and self.get_score(best) > LEAST_SCORE
        return best if sure else LIES


def check_flips(
    color: FloatArray, images: Mapping[str, FloatArray], labels: Mapping[str, str]
) -> tuple[dict[str, FloatArray], list[Finding]]:
    """Return the guides that lie otherwise than the image, turned over, and what was found.

    In small blocks the image is fitted by each guide, linearly; a guide that lies right explains more of it than one
    that is flipped, whatever the light is.

    Parameters
    ----------
    color : (height, width, 3)
        The image.
    images : mapping of str to array
        Guides by role, as in the file.
    labels : mapping of str to str
        Their channels.
    """
    height, width = color.shape[:2]
    if min(height, width) < 3 * BLOCK or not images:
        return {}, []
    step = max(1, round(max(height, width) / SIZE))
    brightness = _compress(color, step)
    colors = {flip: _cut_blocks(brightness[slices]) for flip, slices in FLIPS.items()}
    features = {role: _cut_blocks(_make_feature(role, _thin(image, step))) for role, image in images.items()}
    features = {role: feature for role, feature in features.items() if feature.std() > 1e-6}
    if not features or not colors[LIES].std() > 0.0:
        return {}, []
    together = _fit(np.concatenate(list(features.values()), axis=-1), colors).find_flip()
    flipped: dict[str, str] = {}
    for role, feature in features.items():
        alone = _fit(feature, colors)
        flip = alone.find_flip()
        if flip == LIES and together != LIES and alone.get_score(together) > STAYS:
            flip = together
        if flip != LIES:
            flipped[role] = flip
    findings = []
    for flip in dict.fromkeys(flipped.values()):
        names = [labels[role] for role, found in flipped.items() if found == flip]
        verb, fate = ("lie", "they were") if len(names) > 1 else ("lies", "it was")
        told = f"{list_names(names)} {verb} {flip} under the image, so {fate} turned over."
        findings.append(Finding("guides flipped", told, mended=True))
    return {role: np.ascontiguousarray(images[role][FLIPS[flip]]) for role, flip in flipped.items()}, findings


def _thin(image: FloatArray, step: int, down: int = 0, right: int = 0) -> FloatArray:
    """Return the pixels in the middles of squares ``step`` wide, or some pixels off."""
    starts = [(size % step + step) // 2 + off for size, off in zip(image.shape[:2], (down, right), strict=True)]
    rows, columns = (size // step for size in image.shape[:2])
    return image[starts[0] :: step, starts[1] :: step][:rows, :columns]


def _compress(color: FloatArray, step: int) -> Numbers:
    """Return brightness in [0, 1), in which fireflies are no brighter than lamps, as means of some pixels."""
    shifts = sorted({-(step // 3), step // 4})
    grays = []
    for down in shifts:
        for right in shifts:
            thin = np.ascontiguousarray(_thin(color, step, down, right))
            gray = thin[..., 0] + thin[..., 1] + thin[..., 2]
            grays.append(np.where(np.isfinite(gray) & (gray > 0.0), gray, np.float32(0.0)))
    lit = grays[0][grays[0] > 0.0]
    middle = np.median(lit) if lit.size else np.float32(1.0)
    return np.asarray(np.mean([gray / (gray + middle) for gray in grays], axis=0, dtype=np.float32))


def _make_feature(role: str, thin: FloatArray) -> Numbers:
    """Return what an image is fitted by, (height, width, components)."""
    values = thin if thin.ndim == 3 else thin[..., None]
    far = ~(np.abs(values) < FARTHEST).all(axis=-1, keepdims=True)
    if role == "depth":
        there = ~far & (values > 0.0)
        return np.where(there, np.log(np.where(there, values, np.float32(1.0))), np.float32(0.0))
    values = np.where(far, np.float32(0.0), values)
    if role == "position":
        return np.asarray(values / (np.abs(values - values.mean(axis=(0, 1))).mean() + 1e-30))
    return np.asarray(values.clip(-1.0, 1.0))


def _cut_blocks(image: Numbers) -> Numbers:
    """Return the blocks of an image less their means, (blocks, pixels, components)."""
    planes = image if image.ndim == 3 else image[..., None]
    down, across = (size // BLOCK for size in planes.shape[:2])
    top, left = (size % BLOCK // 2 for size in planes.shape[:2])
    inner = planes[top : top + down * BLOCK, left : left + across * BLOCK]
    parts = inner.reshape(down, BLOCK, across, BLOCK, -1).transpose(0, 2, 1, 3, 4).reshape(down * across, BLOCK**2, -1)
    return np.asarray(parts - parts.mean(axis=1, keepdims=True))


def _fit(feature: Numbers, colors: Mapping[str, Numbers]) -> Fit:
    """Return how well the components of a guide, each by a factor for every block, make up the image."""
    turned = feature.transpose(0, 2, 1)
    products = turned @ feature + np.float32(RIDGE * feature.shape[1]) * np.eye(feature.shape[2], dtype=np.float32)
    fitted = {}
    for flip, color in colors.items():
        shared = turned @ color
        factors = np.linalg.solve(products, shared)
        fitted[flip] = (shared * factors).sum(axis=(1, 2), dtype=np.float32).clip(0.0)
    return Fit(fitted, float(np.square(colors[LIES]).sum()))
