"""What upsampled frames are judged by: pixels told apart by roughness and by what came into view."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.upsampling.shots import (
    Mask,
)
from lobewise.frame import FloatArray
from lobewise.metrics import find_disoccluded, find_specular_pixels, rel_mse
from lobewise.sparse_frame import AnyFrame

ALPHA_BINS = (0.0, 0.045, 0.1, 0.2, 0.35, 1.0)
"""Limits between which roughness is counted together; the floor's tiles have 0.03 to 0.6."""


def select_bins(frame: AnyFrame) -> dict[str, Mask]:
    """Return the masks of which errors are told: specular pixels, those of similar roughness, the others."""
    specular = find_specular_pixels(frame.gbuffer)
    alpha = frame.gbuffer.alpha_u
    assert alpha is not None
    masks = {"specular": specular, "others": ~specular}
    for low, high in itertools.pairwise(ALPHA_BINS):
        masks[f"alpha {low:g} to {high:g}"] = specular & (alpha >= low) & (alpha < high)
    return {name: mask for name, mask in masks.items() if mask.any()}


def measure(image: FloatArray, reference: FloatArray, masks: Mapping[str, Mask]) -> dict[str, Any]:
    """Return the errors of an image."""
    return {
        "rel_mse": rel_mse(image, reference),
        **{f"rel_mse, {name}": rel_mse(image, reference, mask) for name, mask in masks.items()},
    }


def mark_new(frames: Sequence[AnyFrame], index: int) -> Mask:
    """Return which pixels of a frame came into view in it."""
    now, before = frames[index], frames[index - 1]
    assert now.camera is not None
    assert before.camera is not None
    return find_disoccluded(now.gbuffer, now.camera, before.gbuffer, before.camera)


def mark_changed_reflections(frames: Sequence[AnyFrame], index: int) -> Mask:
    """Return which mirrors that stand still see something else than in the frame before, at another distance."""
    guides, before = frames[index].gbuffer, frames[index - 1].gbuffer
    assert guides.alpha_u is not None
    assert guides.hit_distance is not None
    assert before.hit_distance is not None
    mirrors = find_specular_pixels(guides) & (guides.alpha_u < 0.1)
    near = np.minimum(guides.hit_distance, before.hit_distance)
    far = np.maximum(guides.hit_distance, before.hit_distance)
    return mirrors & (far > 1.2 * near) & mark_still(frames, index)


def mark_still(frames: Sequence[AnyFrame], index: int) -> Mask:
    """Return which pixels show a surface that did not move on the screen since the frame before."""
    motion = frames[index].gbuffer.motion
    assert motion is not None
    return np.asarray(np.hypot(motion[..., 0], motion[..., 1]) < 0.01)


def make_ghost_masks(frames: Sequence[AnyFrame], index: int) -> dict[str, Mask]:
    """Return the pixels where ghosts would be: what came into view some frames ago and was in view since."""
    masks = {}
    for name, find in (("surfaces", mark_new), ("reflections", mark_changed_reflections)):
        for age in (0, 1, 2):
            mask = find(frames, index - age) & mark_still(frames, index - age)
            for later in range(index - age + 1, index + 1):
                mask &= mark_still(frames, later) & ~find(frames, later)
            masks[f"{name}, {age} ago"] = mask
    return masks
