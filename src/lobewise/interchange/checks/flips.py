"""Checks of the orientation of guides: a guide that is upside down or mirrored explains the image worse."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.stand_ins import compute_normals
from lobewise.interchange.checks.finding import Finding, list_names
from lobewise.interchange.values import MIN_EMPTY_DISTANCE
from lobewise.records.frame import FloatArray

MAX_SIDE = 256
"""Longer side of the thinned images, pixels."""
BLOCK = 8
"""Width of a block, pixels of the thinned images. In each block a guide is fitted to the image."""
MIN_GAIN = 0.02
"""Share of the image's variance that a flipped guide must explain beyond the share of the guide as it is."""
MIN_RATIO = 1.25
"""Ratio of the variance that a flipped guide must explain to the variance that the guide explains as it is."""
MIN_SCORE = 4.0
"""Standard errors, over the blocks, by which a flipped guide must explain more."""
MIN_SCORE_OF_DISSENT = 1.0
"""Standard errors by which the orientation of a minority of the guides must explain more, where guides disagree."""
MIN_DEVIATION = 1e-4
"""Standard deviation within blocks up to which a guide shows nothing."""
RIDGE = 1e-3
"""Variance that is added to the components of a guide, so that a fit to few pixels stays finite."""
ANCHORS = ("normal", "position", "depth")
"""Guides that the other guides are compared with, the best first: they have no noise."""
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
    """The variance of an image that a guide explains.

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

    def get_score(self, flip: str, base: str = LIES) -> float:
        """Return by how many standard errors the guide explains more in orientation ``flip`` than in ``base``.

        The score compares standard deviations, so that a few strong edges do not dominate.
        """
        gain = np.sqrt(self.fitted[flip]) - np.sqrt(self.fitted[base])
        return float(gain.sum() / (np.sqrt(len(gain)) * gain.std() + 1e-30))

    def choose_flip(self, base: str = LIES) -> str:
        """Return the orientation that explains clearly more than ``base``, else ``base``."""
        best = max(FLIPS, key=self.get_explained)
        better, worse = self.get_explained(best), self.get_explained(base)
        sure = better > max(worse + MIN_GAIN, MIN_RATIO * worse) and self.get_score(best, base) > MIN_SCORE
        return best if sure else base

    def is_bound(self, flip: str) -> bool:
        """Return whether the guide explains clearly more in this orientation than in any other."""
        return all(self.get_score(flip, other) > MIN_SCORE for other in FLIPS if other != flip)


def check_flips(
    color: FloatArray,
    images: Mapping[str, FloatArray],
    labels: Mapping[str, str],
    known: Mapping[str, str] | None = None,
) -> tuple[dict[str, str], list[Finding]]:
    """Return the flips of the guides that lie in a wrong orientation, by role, and findings.

    A guide is fitted to the image in small blocks, linearly. In the right orientation it explains more of the image
    than flipped, whatever the light is. Guides have no noise, so they are first compared with each other, and then
    together with the image.

    Parameters
    ----------
    color : (height, width, 3)
        The image.
    images : mapping of str to array
        Guides of the file by role.
    labels : mapping of str to str
        Channels of the guides by role.
    known : mapping of str to str, optional
        The flips, where the sequence of the frame has told them.
    """
    flips = _measure_flips(color, images) if known is None else known
    flipped = {role: flip for role, flip in flips.items() if flip != LIES and role in images}
    findings = []
    for flip in dict.fromkeys(flipped.values()):
        names = [labels[role] for role, its_flip in flipped.items() if its_flip == flip]
        verb, fate = ("lie", "they were") if len(names) > 1 else ("lies", "it was")
        note = f"{list_names(names)} {verb} {flip} under the image, so {fate} turned over."
        findings.append(Finding("guides flipped", note, mended=True))
    return flipped, findings


def turn_over(image: FloatArray, flip: str) -> FloatArray:
    """Return an image in another orientation."""
    return np.ascontiguousarray(image[FLIPS[flip]])


def _measure_flips(color: FloatArray, images: Mapping[str, FloatArray]) -> dict[str, str]:
    """Return the orientation of each guide that shows anything."""
    height, width = color.shape[:2]
    if min(height, width) < 3 * BLOCK or not images:
        return {}
    step = max(1, round(max(height, width) / MAX_SIDE))
    whole = {role: _make_feature(role, _thin(image, step)) for role, image in images.items()}
    whole = {role: feature for role, feature in whole.items() if _cut_blocks(feature).std() > MIN_DEVIATION}
    light = _cut_flipped(_compress(color, step))
    return _choose_flips(whole, light) if whole and light[LIES].std() > 0.0 else {}


def _choose_flips(whole: Mapping[str, Numbers], light: Mapping[str, Numbers]) -> dict[str, str]:
    """Return the orientation of each guide; ``light`` are the blocks of the image in every orientation."""
    blocks = {role: _cut_blocks(feature) for role, feature in whole.items()}
    alone = {role: _fit(feature, light) for role, feature in blocks.items()}
    anchor = next((role for role in ANCHORS if role in whole), None)
    if anchor is None:
        return {role: fit.choose_flip() for role, fit in alone.items()}
    # Compare each guide with the anchor, and then all guides that agree with the anchor with the image.
    target = _cut_flipped(whole[anchor])
    fits = {role: _fit(blocks[role], target) for role in whole if role != anchor}
    turns = {anchor: LIES} | {role: fit.choose_flip() for role, fit in fits.items()}
    bound = [anchor, *(role for role, fit in fits.items() if fit.is_bound(turns[role]))]
    joined = np.concatenate([_cut_blocks(whole[role][FLIPS[turns[role]]]) for role in bound], axis=-1)
    together = _fit(joined, light)
    base = max(FLIPS, key=lambda flip: sum(combine(turns[role], flip) == LIES for role in bound))
    for turn in dict.fromkeys(turns[role] for role in bound):
        # Where guides disagree, the orientation of some of them is likely to be right.
        if together.get_score(turn, base) > MIN_SCORE_OF_DISSENT:
            base = turn
    votes = {together.choose_flip(base): together.get_score(together.choose_flip(base), base)}
    for role in bound:
        own = combine(turns[role], base)
        chosen = alone[role].choose_flip(own)
        if chosen != own:
            votes[combine(turns[role], chosen)] = alone[role].get_score(chosen, own)
    flip = max(votes, key=lambda voted: votes[voted])
    flips = {role: combine(turn, flip) for role, turn in turns.items()}
    return flips | {role: fit.choose_flip(flips[role]) for role, fit in alone.items() if role not in bound}


def combine(first: str, second: str) -> str:
    """Return the flip that two flips, one after the other, make."""
    slices = [FLIPS[flip] for flip in (first, second)]
    turned = tuple(BACK if a != b else slice(None) for a, b in zip(*slices, strict=True))
    return next(name for name, flip in FLIPS.items() if flip == turned)


def _thin(image: FloatArray, step: int, down: int = 0, right: int = 0) -> FloatArray:
    """Return the middle pixels of squares that are ``step`` wide, moved by ``down`` and ``right`` pixels."""
    starts = [(size % step + step) // 2 + off for size, off in zip(image.shape[:2], (down, right), strict=True)]
    rows, columns = (size // step for size in image.shape[:2])
    return image[starts[0] :: step, starts[1] :: step][:rows, :columns]


def _compress(color: FloatArray, step: int) -> Numbers:
    """Return means of a few pixels of the brightness, compressed to [0, 1) so that fireflies do not dominate."""
    shifts = sorted({-(step // 3), step // 4})
    grays = []
    for down in shifts:
        for right in shifts:
            thin = np.ascontiguousarray(_thin(color, step, down, right))
            with np.errstate(all="ignore"):
                gray = thin[..., 0] + thin[..., 1] + thin[..., 2]
            grays.append(np.where(np.isfinite(gray) & (gray > 0.0), gray, np.float32(0.0)))
    lit = grays[0][grays[0] > 0.0]
    middle = np.median(lit) if lit.size else np.float32(1.0)
    return np.asarray(np.mean([gray / (gray + middle) for gray in grays], axis=0, dtype=np.float32))


def _make_feature(role: str, thin: FloatArray) -> Numbers:
    """Return the components of a guide that are fitted to the image, (height, width, components)."""
    values = thin if thin.ndim == 3 else thin[..., None]
    far = ~(np.abs(values) < MIN_EMPTY_DISTANCE).all(axis=-1, keepdims=True)
    if role == "depth":
        there = ~far & (values > 0.0)
        return np.where(there, np.log(np.where(there, values, np.float32(1.0))), np.float32(0.0))
    values = np.where(far, np.float32(0.0), values)
    if role == "position":
        return _compute_facing(values)
    return np.asarray(values.clip(-1.0, 1.0))


def _compute_facing(position: Numbers) -> Numbers:
    """Return the normals of the surface through positions, (height, width, 3)."""
    across, down = (np.gradient(position, axis=axis) for axis in (1, 0))
    facing, length = compute_normals(across, down)
    return np.asarray(np.where(length > 0.0, facing, np.float32(0.0)), dtype=np.float32)


def _cut_flipped(image: Numbers) -> dict[str, Numbers]:
    """Return the blocks of an image in every orientation."""
    return {flip: _cut_blocks(image[slices]) for flip, slices in FLIPS.items()}


def _cut_blocks(image: Numbers) -> Numbers:
    """Return the blocks of an image minus their means, (blocks, pixels, components)."""
    planes = image if image.ndim == 3 else image[..., None]
    down, across = (size // BLOCK for size in planes.shape[:2])
    top, left = (size % BLOCK // 2 for size in planes.shape[:2])
    inner = planes[top : top + down * BLOCK, left : left + across * BLOCK]
    parts = inner.reshape(down, BLOCK, across, BLOCK, -1).transpose(0, 2, 1, 3, 4).reshape(down * across, BLOCK**2, -1)
    return np.asarray(parts - parts.mean(axis=1, keepdims=True))


def _fit(feature: Numbers, images: Mapping[str, Numbers]) -> Fit:
    """Return the fit of a guide's components to an image in each orientation, with one factor for each block."""
    turned = feature.transpose(0, 2, 1)
    products = turned @ feature
    products += np.float32(RIDGE * feature.shape[1]) * np.eye(feature.shape[2], dtype=np.float32)
    every = np.concatenate([images[flip] for flip in FLIPS], axis=-1)
    shared = turned @ every
    fitted = (shared * np.linalg.solve(products, shared)).sum(axis=1).reshape(len(feature), len(FLIPS), -1)
    sums = fitted.sum(axis=-1).clip(0.0)
    return Fit(dict(zip(FLIPS, sums.T, strict=True)), float(np.square(images[LIES]).sum()))
