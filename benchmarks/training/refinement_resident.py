"""Train the refining network on a GPU that holds all frames in its memory.

`refinement.py` uses this module with the option ``--device cuda``. A processor draws a few crops a step and changes
them; this module does the same with tensors, so that thousands of crops a second are drawn. On CUDA a whole step, from
drawing to the averaged weights, is recorded once as a graph: the step has thousands of small kernels, and starting them
one by one takes several times as long as running them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from benchmarks.training.refinement_batches import (
    BRIGHTNESS_SPREAD,
    CHANGE_DROPPED_SHARE,
    CHANNELS,
    COLORS,
    EXPOSURE_SPREAD,
    LIGHTS,
    LOG_DEPTH_SPREAD,
    calm,
    read_frame,
    spoil,
)
from benchmarks.training.refinement_model import Batch

if TYPE_CHECKING:
    from benchmarks.training.refinement import State

WARM_UPS = 3
"""Steps before the graph is recorded, in which libraries choose their kernels."""


@dataclass(frozen=True)
class ResidentFrames:
    """Square windows of frames in the memory of a device.

    Parameters
    ----------
    pixels : half tensor, (windows, channels, rows * columns)
        All images of `CHANNELS`, one after the other; 0 where a frame lacks one.
    side : int
        Rows of a window, and columns.
    known : tensor, (windows, images)
        1 where a frame has an image of `CHANNELS`.
    numbers : tensor, (windows, 3)
        Brightness, mean logarithm of the depth, and 1 where pixels share samples, all of the whole frame.
    shares : tensor, (windows)
        Cumulative share of the crops that are drawn from a window.
    """

    pixels: Tensor
    side: int
    known: Tensor
    numbers: Tensor
    shares: Tensor


def load_frames(
    shown: Mapping[str, Sequence[Path]], shares: Mapping[str, float], device: torch.device
) -> ResidentFrames:
    """Return the frames of some files, by set of guides, in the memory of a device.

    All are cut to squares as large as the smallest frame allows; together they cover every frame.
    """
    pixels, known, numbers, weights = [], [], [], []
    total = sum(shares[guides] for guides in shown)
    stored = {path: read_frame.__wrapped__(path) for paths in shown.values() for path in paths}
    side = min(min(each.images["noisy"].shape[1:]) for each in stored.values())
    for guides, paths in shown.items():
        for path in paths:
            frame = stored.pop(path)
            rows, columns = frame.images["noisy"].shape[1:]
            images = [
                torch.from_numpy(frame.images[name])
                if name in frame.images
                else torch.zeros(channels, rows, columns, dtype=torch.half)
                for name, channels in CHANNELS.items()
            ]
            image, windows = torch.cat(images), [(y, x) for y in place(rows, side) for x in place(columns, side)]
            for y, x in windows:
                pixels.append(image[:, y : y + side, x : x + side].flatten(1).to(device))
                known.append([float(name in frame.images) for name in CHANNELS])
                numbers.append([frame.brightness, frame.log_depth, float(frame.shared)])
                weights.append(shares[guides] / total / len(paths) / len(windows))
    cumulative = torch.tensor(weights, dtype=torch.float64).cumsum(0)
    cumulative[-1] = 2.0  # Rounding may leave the last sum below the largest number that is drawn.
    return ResidentFrames(
        torch.stack(pixels),
        side,
        torch.tensor(known, device=device),
        torch.tensor(numbers, device=device),
        cumulative.float().to(device),
    )


def place(length: int, side: int) -> list[int]:
    """Return where windows of a length begin, so that they cover it."""
    count = -(-length // side)
    return [number * (length - side) // max(count - 1, 1) for number in range(count)]


def draw_resident(frames: ResidentFrames, count: int, side: int) -> Batch:
    """Return random crops of at most ``side`` rows and columns, changed as `refinement_batches.vary` does."""
    device = frames.pixels.device
    side = min(side, frames.side)
    number = torch.searchsorted(frames.shares, torch.rand(count, device=device))
    index = draw_pixels(count, side, frames.side, device)
    # Gather in half floats: the crops of a batch, not its frames, become floats.
    crops = frames.pixels[number].gather(2, index[:, None].expand(-1, frames.pixels.shape[1], -1)).float()
    crops = crops.view(count, -1, side, side)
    images = dict(zip(CHANNELS, crops.split(list(CHANNELS.values()), dim=1), strict=True))
    known = {name: frames.known[number, k].view(-1, 1, 1, 1) for k, name in enumerate(CHANNELS)}
    kept = (torch.rand(count, 1, 1, 1, device=device) >= CHANGE_DROPPED_SHARE).float()
    known["change"] = known["change"] * kept
    images["change"] = images["change"] * kept
    calm(images)
    spoil(images)
    order = torch.rand(count, 3, device=device).argsort(dim=1).view(-1, 3, 1, 1).expand(-1, -1, side, side)
    factor = torch.exp(EXPOSURE_SPREAD * torch.randn(count, 1, 1, 1, device=device))
    for name in COLORS:
        images[name] = images[name].gather(1, order)
    for name in LIGHTS:
        images[name] = images[name] * factor
    turn = draw_turns(count, device)
    images["normal"] = torch.einsum("nij,njyx->niyx", turn, images["normal"])
    axis = torch.einsum("nij,njyx->niyx", turn, images["lobe"][:, :3])
    images["lobe"] = torch.cat([axis, images["lobe"][:, 3:]], dim=1)
    brightness, depth, shared = (frames.numbers[number, k].view(-1, 1, 1, 1) for k in range(3))
    brightness = brightness * factor * torch.exp(BRIGHTNESS_SPREAD * torch.randn_like(factor))
    return Batch(images, known, brightness, depth + LOG_DEPTH_SPREAD * torch.randn_like(depth), shared)


def draw_pixels(count: int, side: int, whole: int, device: torch.device) -> Tensor:
    """Return the pixels of crops, (count, side * side): at random places, mirrored and transposed at random."""
    corner = (torch.rand(2, count, 1, device=device) * (whole - side + 1)).long().clamp_max(whole - side)
    along = torch.arange(side, device=device).expand(2, count, side)
    mirrored = torch.rand(2, count, 1, device=device) < 0.5
    rows, columns = corner + torch.where(mirrored, side - 1 - along, along)
    index = rows[:, :, None] * whole + columns[:, None, :]
    swapped = torch.rand(count, 1, 1, device=device) < 0.5
    return torch.where(swapped, index.transpose(1, 2), index).flatten(1)


def draw_turns(count: int, device: torch.device) -> Tensor:
    """Return random rotations, half of them mirrored, (count, 3, 3): three drawn vectors made orthogonal."""
    first, second = (torch.nn.functional.normalize(torch.randn(count, 3, device=device), dim=1) for _ in range(2))
    third = torch.nn.functional.normalize(torch.linalg.cross(first, second), dim=1)
    sign = torch.where(torch.rand(count, 1, device=device) < 0.5, -1.0, 1.0)
    return torch.stack([first, torch.linalg.cross(third, first), sign * third], dim=1)


class ResidentTrainer:
    """Takes steps on a device.

    Parameters
    ----------
    state : State
        Its networks lie on the device; its optimiser is replaced by one whose rate lies there.
    frames : ResidentFrames
    batch : int
        Crops of a step.
    crop : int
        Rows and columns of a crop.
    """

    def __init__(self, state: State, frames: ResidentFrames, batch: int, crop: int) -> None:
        self.state, self.frames, self.batch, self.crop = state, frames, batch, crop
        device = frames.pixels.device
        cuda = device.type == "cuda"
        self.rate = torch.zeros((), device=device)
        self.kept = torch.zeros((), device=device)
        self.loss = torch.zeros((), device=device)
        told = state.optimiser.state_dict()
        group = told["param_groups"][0]
        self.optimiser = torch.optim.Adam(state.network.parameters(), betas=group["betas"], capturable=cuda)
        group["capturable"] = cuda
        if told["state"]:
            self.optimiser.load_state_dict(told)
        for each in self.optimiser.param_groups:
            each.update(lr=self.rate, capturable=cuda)
        state.optimiser = self.optimiser
        self.graph: Any = torch.cuda.CUDAGraph() if cuda else None
        self.taken = 0

    def take_step(self, rate: float, kept: float) -> Tensor:
        """Take one step; return its loss, on the device. ``kept`` is the share of the averaged weights that is kept."""
        self.rate.fill_(rate)
        self.kept.fill_(kept)
        if self.graph is None:
            self._compute()
        elif self.taken == WARM_UPS:
            with torch.cuda.graph(self.graph):
                self._compute()
            self.graph.replay()
        elif self.taken > WARM_UPS:
            self.graph.replay()
        else:
            stream = torch.cuda.Stream()
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                self._compute()
            torch.cuda.current_stream().wait_stream(stream)
        self.taken += 1
        self.state.steps += 1
        return self.loss

    def _compute(self) -> None:
        from benchmarks.training.refinement import MAX_GRADIENT, compute_loss

        network, average = self.state.network, self.state.average
        batch = draw_resident(self.frames, self.batch, self.crop)
        images = batch.images
        loss = compute_loss(network(batch), images["noisy"], images["filtered"], images["reference"])
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT, foreach=True)
        for each in network.parameters():
            # A loss that is not finite teaches nothing: the step then follows the momentum alone.
            each.grad = torch.nan_to_num(each.grad, nan=0.0, posinf=0.0, neginf=0.0)
        self.optimiser.step()
        with torch.no_grad():
            for mean, each in zip(average.parameters(), network.parameters(), strict=True):
                mean.add_((each - mean) * (1.0 - self.kept))
            self.loss.copy_(loss.detach())
