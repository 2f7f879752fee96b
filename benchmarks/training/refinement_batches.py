"""Batches to train the refining network on: crops of stored frames, changed at random in ways that keep them true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.training.frames import make_half
from benchmarks.training.refinement_frames import parse_file_name
from benchmarks.training.refinement_model import MULTIPLE, Batch

Array = NDArray[np.float32]
CROP = 128
"""Rows and columns of a crop, unless ``--crop`` tells another number, where a frame has as many."""
KEPT_FRAMES = 400
CHANNELS = {
    "noisy": 3,
    "filtered": 3,
    "albedo": 3,
    "normal": 3,
    "depth": 1,
    "roughness": 1,
    "specular_share": 1,
    "change": 3,
    "lobe": 4,
    "reference": 3,
}
LIGHTS = ("noisy", "filtered", "change", "reference")
COLORS = (*LIGHTS, "albedo")
EXPOSURE_SPREAD, BRIGHTNESS_SPREAD = 0.7, 0.5
"""Standard deviations of natural logarithms: of what all light of a crop is multiplied by, and its brightness alone."""
LOG_DEPTH_SPREAD = 0.3
"""Standard deviation of what is added to the mean logarithm of a crop's depth."""
CHANGE_DROPPED_SHARE = 0.2
"""Share of the crops with halves that come without them."""
CALMED_SHARE, LEAST_NOISE = 0.3, 1.0 / 16.0
"""Share of the crops whose noise is made smaller, and the smallest factor: so calm is a frame of 256 times as many
samples, whose reference would take hours."""
SPOILED_SHARE, WHOLLY_SPOILED_SHARE = 0.2, 0.4
"""Share of the crops whose guides are made noise in places, as where a lens blurs, in fog, in hair and in grass, and
the share of these crops that are such a place from edge to edge."""
SPOILED_PATCH_PIXELS, SPOILED_PATCHES = 16, 0.4
"""Side of the squares that such places are made of, and how many of the squares are such places."""
LOG_DEPTH_NOISE, MAX_SHORTER = 0.5, 0.7
"""Standard deviation of the logarithm of a depth that is noise, and by how much a normal that is noise is shorter."""


@dataclass(frozen=True)
class Stored:
    """A frame of a file: its images (channels, rows, columns), and the numbers of the whole frame."""

    images: dict[str, NDArray[np.float16]]
    brightness: float
    log_depth: float
    shared: bool
    guides: str
    spp: int


def compute_brightness(color: Array) -> float:
    """Return the squared mean of the root of the light, (channels, rows, columns)."""
    return float(np.sqrt(np.maximum(color, 0.0).mean(axis=0)).mean() ** 2) + 1e-6


def compute_mean_log_depth(depth: Array | None) -> float:
    """Return the mean logarithm of the depth of surfaces, 0 where there are none."""
    seen = depth[depth > 0.0] if depth is not None else np.zeros(0)
    return float(np.log(seen).mean()) if seen.size else 0.0


@lru_cache(maxsize=KEPT_FRAMES)
def read_frame(path: Path) -> Stored:
    """Return the frame in a file."""
    told = parse_file_name(path)
    assert told is not None
    with np.load(path) as arrays:
        images = {}
        shared = bool(arrays["shared"])
        for name in arrays.files:
            each = arrays[name]
            if not each.shape:
                continue
            images[name] = each[None] if each.ndim == 2 else np.ascontiguousarray(np.moveaxis(each, -1, 0))
    if "rest" in images:
        # The network reads all light; files have the light of lamps and of the sky apart.
        rest = images.pop("rest").astype(np.float32)
        images |= {name: make_half(images[name] + rest) for name in ("noisy", "filtered")}
    noisy = images["noisy"].astype(np.float32)
    depth = images["depth"].astype(np.float32) if "depth" in images else None
    return Stored(images, compute_brightness(noisy), compute_mean_log_depth(depth), shared, told[2], told[1])


def cut(stored: Stored, top: int, left: int, rows: int, columns: int) -> dict[str, Array]:
    """Return a part of a frame."""
    return {
        name: image[:, top : top + rows, left : left + columns].astype(np.float32)
        for name, image in stored.images.items()
        if name in CHANNELS
    }


def calm(images: dict[str, Tensor], generator: torch.Generator | None = None) -> None:
    """Make the noise of some crops of a batch smaller in place, and the error of the filtered light by less."""
    chosen, exponents, shares = (_draw(images, generator) for _ in range(3))
    noise = LEAST_NOISE ** (exponents * (chosen < CALMED_SHARE))
    for name, left in (("noisy", noise), ("filtered", noise**shares)):
        images[name] = images["reference"] + left * (images[name] - images["reference"])
    images["change"] = noise * images["change"]


def spoil(images: dict[str, Tensor], generator: torch.Generator | None = None) -> None:
    """Make guides noise in places of some crops, in place; there a filter that compares guides leaves noise."""
    chosen, wholly, left = (_draw(images, generator) for _ in range(3))
    normal = images["normal"]
    rows, columns = normal.shape[2:]
    size = len(normal), 1, -(-rows // SPOILED_PATCH_PIXELS), -(-columns // SPOILED_PATCH_PIXELS)
    coarse = torch.rand(size, generator=generator, device=normal.device) < SPOILED_PATCHES
    near = torch.nn.functional.interpolate(coarse.float(), scale_factor=SPOILED_PATCH_PIXELS)[..., :rows, :columns] > 0
    places = (near | (wholly < WHOLLY_SPOILED_SHARE)) & (chosen < SPOILED_SHARE)
    surface = places & (normal.square().sum(dim=1, keepdim=True) > 0.0)

    def draw_normal(like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=generator, device=like.device)

    # As a mean over the samples of a pixel, a normal is shorter than 1.
    lengths = 1.0 - MAX_SHORTER * torch.rand(normal[:, :1].shape, generator=generator, device=normal.device)
    axis, lobe = (torch.nn.functional.normalize(draw_normal(normal), dim=1) for _ in range(2))
    images["normal"] = torch.where(surface, lengths * axis, normal)
    images["lobe"] = torch.cat([torch.where(surface, lobe, images["lobe"][:, :3]), images["lobe"][:, 3:]], dim=1)
    depth = images["depth"]
    images["depth"] = torch.where(surface, torch.exp(LOG_DEPTH_NOISE * draw_normal(depth)) * depth, depth)
    filtered = images["filtered"]
    images["filtered"] = torch.where(places, filtered + left * (images["noisy"] - filtered), filtered)


def _draw(images: dict[str, Tensor], generator: torch.Generator | None) -> Tensor:
    """Return a number in [0, 1) for each crop."""
    return torch.rand(len(images["noisy"]), 1, 1, 1, generator=generator, device=images["noisy"].device)


def vary(images: dict[str, Array], rng: np.random.Generator) -> float:
    """Mirror, transpose, turn, recolour and expose a crop in place; return the factor of its light."""
    down, across, swapped = rng.random(3) < 0.5
    order, turn = rng.permutation(3), np.linalg.qr(rng.normal(size=(3, 3)))[0].astype(np.float32)
    factor = np.float32(np.exp(rng.normal(0.0, EXPOSURE_SPREAD)))
    if "change" in images and rng.random() < CHANGE_DROPPED_SHARE:
        del images["change"]
    for name, image in images.items():
        moved = image[:, :: -1 if down else 1, :: -1 if across else 1]
        moved = moved.transpose(0, 2, 1) if swapped else moved
        if name in COLORS:
            moved = moved[order]
        if name in LIGHTS:
            moved = moved * factor
        if name == "normal":
            moved = np.einsum("ij,jyx->iyx", turn, moved)
        if name == "lobe":
            moved = np.concatenate([np.einsum("ij,jyx->iyx", turn, moved[:3]), moved[3:]])
        images[name] = moved
    return float(factor)


def join(crops: Sequence[dict[str, Array]], numbers: Sequence[tuple[float, float, bool]]) -> Batch:
    """Return crops of one size as a batch; numbers are brightness, mean logarithm of the depth, and what is shared."""
    images, known = {}, {}
    rows, columns = crops[0]["noisy"].shape[1:]
    for name, channels in CHANNELS.items():
        empty = np.zeros((channels, rows, columns), np.float32)
        images[name] = torch.from_numpy(np.stack([crop.get(name, empty) for crop in crops]))
        known[name] = _column([float(name in crop) for crop in crops])
    brightness, depth, shared = (_column([float(each) for each in column]) for column in zip(*numbers, strict=True))
    return Batch(images, known, brightness, depth, shared)


def _column(values: Sequence[float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float32).view(-1, 1, 1, 1)


def draw_batch(paths: Sequence[Path], rng: np.random.Generator, most: int = CROP) -> Batch:
    """Return a crop of each of some frames, of at most so many rows and columns."""
    crops, numbers = [], []
    for path in paths:
        stored = read_frame(path)
        rows, columns = stored.images["noisy"].shape[1:]
        side = min(most, rows, columns)
        images = cut(stored, int(rng.integers(rows - side + 1)), int(rng.integers(columns - side + 1)), side, side)
        factor = vary(images, rng)
        brightness = stored.brightness * factor * float(np.exp(rng.normal(0.0, BRIGHTNESS_SPREAD)))
        crops.append(images)
        numbers.append((brightness, stored.log_depth + float(rng.normal(0.0, LOG_DEPTH_SPREAD)), stored.shared))
    batch, generator = join(crops, numbers), torch.Generator().manual_seed(int(rng.integers(2**31)))
    calm(batch.images, generator)
    spoil(batch.images, generator)
    return batch


def make_whole(stored: Stored) -> Batch:
    """Return a whole frame as a batch of one, cut to a size that the network can halve."""
    rows, columns = (length - length % MULTIPLE for length in stored.images["noisy"].shape[1:])
    return join([cut(stored, 0, 0, rows, columns)], [(stored.brightness, stored.log_depth, stored.shared)])
