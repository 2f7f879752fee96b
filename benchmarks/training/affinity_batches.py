"""Batches to train the affinity network on: crops of stored frames, changed at random in ways that keep them true."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.training.frames import Example, read_frame_file

Array = NDArray[np.float32]
Images = dict[str, Array]
"""Images of an `Example` by name, (channels, rows, columns)."""

CROP = 128
"""Rows and columns of a crop, where a frame has as many."""
MULTIPLE = 8
"""Pixels that rows and columns are a multiple of: the network halves its images three times."""
KEPT_FRAMES = 200
"""Frames that stay in memory, about 5 MB each."""

LIGHTS = ("color", "diffuse", "specular", "reference", "diffuse_a", "diffuse_b", "specular_a", "specular_b")
COLORS = (
    *LIGHTS,
    "mean_diffuse_albedo",
    "mean_specular_albedo",
    "diffuse_albedo",
    "specular_albedo",
    "hit_albedo",
)
DIRECTIONS = ("mean_normal", "normal", "hit_normal", "lobe_axis")
HALVES = ("diffuse_a", "diffuse_b", "specular_a", "specular_b")
GUIDES = ("depth", "alpha_u", "alpha_v", "hit_inverse", "lobe_sharpness")

EXPOSURE_SPREAD = 0.7
"""Standard deviation of the natural logarithm of the factor that all light of a crop is multiplied by."""
HALVES_DROPPED_SHARE = 0.2
"""Share of the crops that come without halves, though their frame has them."""
ONE_HALF_SHARE = 0.15
"""Share of the crops with halves whose light is that of one half: half as many samples."""
THINNED_SHARE = 0.35
"""Share of the crops of few samples whose pixels are dropped at random."""
MAX_THINNED_SPP = 8
MIN_KEPT_SHARE, MAX_KEPT_SHARE = 0.04, 0.8
"""Of the pixels of a thinned crop; those that are kept count by one over their share, so that the mean stays."""


@dataclass(frozen=True)
class Batch:
    """Crops of some frames.

    Parameters
    ----------
    images : dict of str to tensor, (batch, channels, rows, columns)
        Images of an `Example`; halves are 0 where a crop has none.
    spp, brightness, depth, halves : tensor, (batch,)
        Samples per pixel; squared mean of the roots of the whole frame's light; mean depth of what it shows; 1 where
        there are halves, else 0.
    """

    images: dict[str, Tensor]
    spp: Tensor
    brightness: Tensor
    depth: Tensor
    halves: Tensor

    def move(self, device: str) -> Batch:
        """Return the batch on a device of PyTorch."""
        numbers = (each.to(device) for each in (self.spp, self.brightness, self.depth, self.halves))
        return Batch({name: image.to(device) for name, image in self.images.items()}, *numbers)


@dataclass
class Crop:
    """A part of a frame, on its way to a batch."""

    images: Images
    spp: float
    brightness: float
    depth: float
    has_halves: bool


@dataclass(frozen=True)
class Frame:
    """A frame in memory, with the numbers of the whole of it that every crop has."""

    example: Example
    brightness: float
    depth: float

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns, cut to a multiple of `MULTIPLE`."""
        rows, columns = self.example.color.shape[:2]
        return rows - rows % MULTIPLE, columns - columns % MULTIPLE

    def cut(self, top: int, left: int, rows: int, columns: int) -> Crop:
        """Return a part of the frame as it is."""
        images: Images = {}
        for name in (*COLORS, *DIRECTIONS, *GUIDES):
            image = getattr(self.example, name)
            if image is not None:
                part = image[top : top + rows, left : left + columns].astype(np.float32)
                images[name] = part[None] if part.ndim == 2 else np.moveaxis(part, -1, 0)
        return Crop(images, float(self.example.spp), self.brightness, self.depth, self.example.has_halves)


def make_frame(example: Example) -> Frame:
    """Return an example with its numbers."""
    light = np.maximum(example.color.astype(np.float32).mean(axis=-1), 0.0)
    depth = example.depth.astype(np.float32)
    seen = depth[depth > 0.0]
    return Frame(example, float(np.sqrt(light).mean() ** 2), float(seen.mean()) if seen.size else 1.0)


@lru_cache(maxsize=KEPT_FRAMES)
def fetch_frame(path: Path) -> Frame:
    """Return the frame in a file."""
    return make_frame(read_frame_file(path))


def join_crops(crops: Sequence[Crop]) -> Batch:
    """Return crops of one size as a batch."""
    images: dict[str, Tensor] = {}
    for name in (*COLORS, *DIRECTIONS, *GUIDES):
        empty = np.zeros_like(crops[0].images["color"])
        images[name] = torch.from_numpy(np.stack([crop.images.get(name, empty) for crop in crops]))

    def list_numbers(read: Callable[[Crop], float]) -> Tensor:
        return torch.tensor([read(crop) for crop in crops], dtype=torch.float32)

    return Batch(
        images,
        list_numbers(lambda crop: crop.spp),
        list_numbers(lambda crop: crop.brightness),
        list_numbers(lambda crop: crop.depth),
        list_numbers(lambda crop: float(crop.has_halves)),
    )


def draw_batch(paths: Sequence[Path], count: int, rng: np.random.Generator) -> Batch:
    """Return crops of frames that are drawn from files."""
    return join_crops([draw_crop(fetch_frame(paths[rng.integers(len(paths))]), rng) for _ in range(count)])


def draw_crop(frame: Frame, rng: np.random.Generator) -> Crop:
    """Return a part of a frame, turned, coloured, exposed and thinned at random."""
    side = min(CROP, *frame.size)
    top, left = (int(rng.integers(length - side + 1)) for length in frame.size)
    crop = frame.cut(top, left, side, side)
    drop_samples(crop, rng)
    _move_pixels(crop.images, rng)
    _permute_colors(crop.images, rng)
    _turn_world(crop.images, rng)
    _expose(crop, rng)
    return crop


def drop_samples(crop: Crop, rng: np.random.Generator) -> None:
    """Leave out halves or samples of some crops; what is in neither part of the light stays."""
    images = crop.images
    rest = images["color"] - images["diffuse"] - images["specular"]
    if crop.has_halves and rng.random() < ONE_HALF_SHARE:
        images["diffuse"], images["specular"] = images["diffuse_a"], images["specular_a"]
        crop.spp, crop.has_halves = 0.5 * crop.spp, False
    elif rng.random() < HALVES_DROPPED_SHARE:
        crop.has_halves = False
    if not crop.has_halves:
        for name in HALVES:
            images.pop(name, None)
    if crop.spp <= MAX_THINNED_SPP and rng.random() < THINNED_SHARE:
        _thin_pixels(crop, rng)
    images["color"] = rest + images["diffuse"] + images["specular"]


def _thin_pixels(crop: Crop, rng: np.random.Generator) -> None:
    """Drop pixels of the light at random, those of the halves independently."""
    share = float(np.exp(rng.uniform(np.log(MIN_KEPT_SHARE), np.log(MAX_KEPT_SHARE))))
    together, images = rng.random() < 0.5, crop.images
    shape = images["color"].shape[1:]

    def draw_mask() -> Array:
        return (rng.random(shape) < share).astype(np.float32) / np.float32(share)

    for half in ("_a", "_b") if crop.has_halves else ("",):
        mask = draw_mask()
        images[f"diffuse{half}"] = images[f"diffuse{half}"] * mask
        images[f"specular{half}"] = images[f"specular{half}"] * (mask if together else draw_mask())
    if crop.has_halves:
        for name in ("diffuse", "specular"):
            images[name] = np.float32(0.5) * (images[f"{name}_a"] + images[f"{name}_b"])


def _move_pixels(images: Images, rng: np.random.Generator) -> None:
    """Mirror and transpose the image plane; directions stay, for the world is turned at random as well."""
    down, across, swapped = rng.random(3) < 0.5
    for name, image in images.items():
        moved = image[:, :: -1 if down else 1, :: -1 if across else 1]
        images[name] = moved.transpose(0, 2, 1) if swapped else moved


def _permute_colors(images: Images, rng: np.random.Generator) -> None:
    order = rng.permutation(3)
    for name in COLORS:
        if name in images:
            images[name] = images[name][order]


def _turn_world(images: Images, rng: np.random.Generator) -> None:
    """Turn and mirror the world."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0].astype(np.float32)
    for name in DIRECTIONS:
        images[name] = np.einsum("ij,jyx->iyx", turn, images[name])


def _expose(crop: Crop, rng: np.random.Generator) -> None:
    factor = np.float32(np.exp(rng.normal(0.0, EXPOSURE_SPREAD)))
    for name in LIGHTS:
        if name in crop.images:
            crop.images[name] = factor * crop.images[name]
    crop.brightness *= float(factor)
