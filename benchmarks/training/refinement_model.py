"""The refining network in PyTorch: a U-Net gives every pixel the weights of a pyramid of filters.

The network reads the noisy image, the image after the quality "balanced" and the guides. Each level of the pyramid has
half the size of the one below. A pixel of a level becomes a weighted mean of its 5x5 noisy neighbours, of its 3x3
filtered neighbours and of the 3x3 nearest pixels of the level above. The weights are learned, and multiplied by the
similarity of place, normal and lobe. A pixel's source weight says how much it counts for others, so that a firefly
counts little. Light is divided by the albedo before, and multiplied by it after, as far as the network trusts it:
albedos have noise where a lens blurs, or where fog hides a surface.
Predicting kernels follows Bako et al., "Kernel-Predicting Convolutional Networks for Denoising Monte Carlo
Renderings", 2017; kernels on the levels of a pyramid follow Vogels et al., "Denoising with Kernel Prediction and
Asymmetric Loss Functions", 2018, and Balint et al., "Neural Partitioning Pyramids for Denoising Monte Carlo
Renderings", 2023.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

PLANES = 21
"""Channels that the network reads of a pixel; see `prepare`."""
LEVELS = 5
MULTIPLE = 2 ** (LEVELS - 1)
NOISY_TAPS, FILTERED_TAPS, COARSE_TAPS = 25, 9, 9
LEAK = 0.1
MIN_TINT = 0.1
"""Smallest albedo that light is divided by."""
MAX_LOG_DEPTH = 4.0
MAX_LOGIT = 20.0
NORMAL_SCALE, DEPTH_SCALE, LOBE_SCALE = 0.66, 1.2, 0.37
VECTORS = (4, 4)
MAX_EXPONENT = 3.0
MIN_SOURCE = 1e-3
SOURCE_BIAS, TRUST_BIAS = 2.0, 4.0
"""Added before the logistic functions: an untrained network weighs all pixels alike, and trusts albedos."""
LIGHT_GAIN, LIGHT_SCALE = 10.0, 0.5
FINEST_LOGITS = 3
"""Outputs that only the finest level has: the source weights of both images, and the trust in the albedo."""
START_FILTERED = 3.0
"""Logit of the pixel's own filtered value, untrained: the network begins as the filter."""


@dataclass(frozen=True)
class Batch:
    """Crops as tensors, (batch, channels, rows, columns); what a crop lacks is 0, and its flag is 0.

    Parameters
    ----------
    images : dict of str to tensor
        By the names of `RefinementInputs`, with "lobe" and "reference".
    known : dict of str to tensor
        1 where a crop has the image of this name, (batch, 1, 1, 1).
    brightness, log_depth : tensor, (batch, 1, 1, 1)
        Of the whole frame; see `compute_brightness` and `compute_mean_log_depth`.
    shared : tensor, (batch, 1, 1, 1)
        1 where neighbouring pixels share samples.
    """

    images: dict[str, Tensor]
    known: dict[str, Tensor]
    brightness: Tensor
    log_depth: Tensor
    shared: Tensor


class Prepared(NamedTuple):
    """What the network reads, both images over the tint, the tint, and the vectors that taps compare."""

    planes: Tensor
    noisy: Tensor
    filtered: Tensor
    tint: Tensor
    vectors: Tensor


def compress(light: Tensor, brightness: Tensor) -> Tensor:
    """Return light on a scale that is linear for dark pixels and logarithmic for bright ones."""
    return LIGHT_SCALE * torch.log1p(LIGHT_GAIN / brightness * light)


def prepare(batch: Batch) -> Prepared:
    """Return what the network reads of a batch."""
    images, known = batch.images, batch.known
    one = torch.ones_like(images["noisy"][:, :1])
    tint = torch.where(known["albedo"] > 0.0, images["albedo"].clamp_min(MIN_TINT), torch.ones_like(images["albedo"]))
    noisy, filtered = images["noisy"] / tint, images["filtered"] / tint
    depth = images["depth"]
    log_depth = (torch.log(depth.clamp_min(1e-20)) - batch.log_depth).clamp(-MAX_LOG_DEPTH, MAX_LOG_DEPTH)
    log_depth = torch.where(depth > 0.0, log_depth, torch.full_like(log_depth, MAX_LOG_DEPTH)) * known["depth"]
    planes = [
        compress(noisy, batch.brightness),
        compress(filtered, batch.brightness),
        images["albedo"],
        images["normal"],
        0.25 * log_depth,
        images["roughness"],
        images["specular_share"],
        compress((images["change"] / tint).mean(dim=1, keepdim=True), batch.brightness),
        *(known[name] * one for name in ("albedo", "depth", "roughness", "change")),
        batch.shared * one,
    ]
    sharpness = images["lobe"][:, 3:]
    lobes = LOBE_SCALE * torch.cat([torch.exp2(0.5 * (sharpness - 1.0)) * images["lobe"][:, :3], sharpness], dim=1)
    place = torch.cat([NORMAL_SCALE * images["normal"], DEPTH_SCALE * log_depth], dim=1)
    return Prepared(torch.cat(planes, dim=1), noisy, filtered, tint, torch.cat([place, known["lobe"] * lobes], dim=1))


class RefiningNetwork(nn.Module):
    """The network and its pyramid of filters.

    Parameters
    ----------
    units : tuple of int
        Channels of the features on every level, the finest first.
    """

    def __init__(self, units: tuple[int, ...] = (24, 32, 48, 64, 80), *, compares: bool = True) -> None:
        super().__init__()
        self.units, self.compares = units, compares

        def convolve(before: int, after: int, size: int = 3, stride: int = 1) -> nn.Conv2d:
            layer = nn.Conv2d(before, after, size, padding=size // 2 if stride == 1 else 0, stride=stride)
            nn.init.kaiming_normal_(layer.weight, a=LEAK)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
            return layer

        self.stem = convolve(PLANES, units[1], 2, 2)
        self.down = nn.ModuleList(
            nn.ModuleList([convolve(units[max(level - 1, 1)], units[level]), convolve(units[level], units[level])])
            for level in range(1, LEVELS)
        )
        self.up = nn.ModuleList(
            nn.ModuleList(
                [convolve(units[level + 1] + units[level], units[level]), convolve(units[level], units[level])]
            )
            for level in range(1, LEVELS - 1)
        )
        self.squeeze = convolve(units[1], 16, 1)
        self.fine = nn.ModuleList([convolve(16 + PLANES, units[0]), convolve(units[0], units[0])])
        self.heads = nn.ModuleList(nn.Conv2d(units[level], count_logits(level), 1) for level in range(LEVELS))
        with torch.no_grad():
            for head in self.heads:
                head.weight.mul_(0.25)  # type: ignore[operator]
                head.bias.zero_()  # type: ignore[operator]
                head.bias[NOISY_TAPS + FILTERED_TAPS // 2] = START_FILTERED  # type: ignore[index]

    def compute_features(self, planes: Tensor) -> list[Tensor]:
        """Return the features of every level, the finest first."""
        found, seen = activate(self.stem(planes)), []
        for number, (first, second) in enumerate(self.down):  # type: ignore[misc]
            if number:
                found = functional.max_pool2d(found, 2)
            found = activate(second(activate(first(found))))
            seen.append(found)
        features = [seen[-1]]
        for level in reversed(range(1, LEVELS - 1)):
            first, second = self.up[level - 1]  # type: ignore[misc]
            joined = torch.cat([enlarge(features[0]), seen[level - 1]], dim=1)
            features.insert(0, activate(second(activate(first(joined)))))
        fine = torch.cat([enlarge(activate(self.squeeze(features[0]))), planes], dim=1)
        for layer in self.fine:
            fine = activate(layer(fine))
        return [fine, *features]

    def forward(self, batch: Batch) -> Tensor:
        """Return the refined frames, (batch, 3, rows, columns)."""
        prepared = prepare(batch)
        # Half the digits are enough to learn from. Processors without such instructions take twenty times as long.
        device = prepared.planes.device.type
        is_fast = device != "cpu" or "AVX512" in torch.backends.cpu.get_cpu_capability()
        with torch.autocast(device, torch.bfloat16, self.training and is_fast, cache_enabled=False):
            logits = [head(each) for head, each in zip(self.heads, self.compute_features(prepared.planes), strict=True)]
        vectors = prepared.vectors if self.compares else None
        return filter_pyramid(prepared, [each.float() for each in logits], vectors)


def count_logits(level: int) -> int:
    """Return the outputs of the head of a level."""
    taps = NOISY_TAPS + FILTERED_TAPS + (COARSE_TAPS if level < LEVELS - 1 else 0)
    return taps + len(VECTORS) + (FINEST_LOGITS if level == 0 else 0)


def activate(tensor: Tensor) -> Tensor:
    """Return the leaky ReLU."""
    return functional.leaky_relu(tensor, LEAK)


def enlarge(tensor: Tensor) -> Tensor:
    """Return every pixel four times."""
    return functional.interpolate(tensor, scale_factor=2, mode="nearest")


def filter_pyramid(prepared: Prepared, logits: list[Tensor], vectors: Tensor | None) -> Tensor:
    """Return the filtered light of the finest level, times the albedo as far as it is trusted.

    Parameters
    ----------
    prepared : Prepared
    logits : list of tensors
        Outputs of the heads, the finest level first; see `FINEST_LOGITS`.
    vectors : tensor, optional
        What taps compare; None for learned weights alone.
    """
    *sources, trust = torch.split(logits[0][:, -FINEST_LOGITS:], 1, dim=1)
    tint = 1.0 + torch.sigmoid(trust + TRUST_BIAS) * (prepared.tint - 1.0)
    weights = [MIN_SOURCE + torch.sigmoid(source + SOURCE_BIAS) for source in sources]
    change = prepared.tint / tint
    sums = [
        torch.cat([light * change * weight, weight], dim=1)
        for light, weight in zip((prepared.noisy, prepared.filtered), weights, strict=True)
    ]
    pyramid = [sums]
    for _ in range(LEVELS - 1):
        pyramid.append([functional.avg_pool2d(each, 2) for each in pyramid[-1]])
    scales = [vectors]
    for _ in range(LEVELS - 1):
        scales.append(None if scales[-1] is None else functional.avg_pool2d(scales[-1], 2))
    coarse: Tensor | None = None
    for level in reversed(range(LEVELS)):
        found = logits[level].clamp(-MAX_LOGIT, MAX_LOGIT)
        first, second = pyramid[level]
        taps = NOISY_TAPS + FILTERED_TAPS
        more = taps + (COARSE_TAPS if level < LEVELS - 1 else 0)
        near = found[:, :taps]
        if scales[level] is not None:
            near = near - compute_distances(scales[level], found[:, more : more + len(VECTORS)])
        weights = torch.exp(near)
        total = gather(first, weights[:, :NOISY_TAPS])
        total = total + gather(second, weights[:, NOISY_TAPS:])
        if coarse is not None:
            own = torch.exp(found[:, taps:more])
            total = total + gather_coarse(torch.cat([coarse, torch.ones_like(coarse[:, :1])], dim=1), own)
        coarse = total[:, :3] / total[:, 3:]
    return coarse * tint


def compute_distances(vectors: Tensor, logits: Tensor) -> Tensor:
    """Return the weighted squared distance of a pixel to its neighbours: 5x5, then the 3x3 of these again."""
    rows, columns = vectors.shape[-2:]
    padded = functional.pad(vectors, (2,) * 4)
    exponents = torch.exp((2.0 * logits - 1.0).clamp(max=MAX_EXPONENT))
    squares = []
    for k in range(NOISY_TAPS):
        v, u = divmod(k, 5)
        parts = (vectors - padded[..., v : v + rows, u : u + columns]).square().split(VECTORS, dim=1)
        squares.append(torch.stack([part.sum(dim=1) for part in parts], dim=1))
    distances = (exponents[:, None] * torch.stack(squares, dim=1)).sum(dim=2)
    inner = [5 * v + u for v in range(1, 4) for u in range(1, 4)]
    return torch.cat([distances, distances[:, inner]], dim=1)


class SumOfTaps(torch.autograd.Function):
    """Weighted sums over a square of neighbours. PyTorch's own gradient of the loop takes three times as long."""

    @staticmethod
    def forward(context: Any, padded: Tensor, weights: Tensor, step: int) -> Tensor:
        """Return the sums; neighbours are ``step`` pixels apart in what is padded."""
        context.save_for_backward(padded, weights)
        context.step = step
        total = torch.zeros((*padded.shape[:2], *weights.shape[2:]), dtype=padded.dtype, device=padded.device)
        for k, taps in enumerate(list_taps(padded, weights, step)):
            total.addcmul_(weights[:, k : k + 1], taps)
        return total

    @staticmethod
    def backward(context: Any, gradient: Tensor) -> tuple[Tensor, Tensor, None]:
        """Return the gradients of what is padded and of the weights."""
        padded, weights = context.saved_tensors
        of_padded, of_weights = torch.zeros_like(padded), torch.empty_like(weights)
        pairs = zip(list_taps(padded, weights, context.step), list_taps(of_padded, weights, context.step), strict=True)
        for k, (taps, target) in enumerate(pairs):
            target.addcmul_(weights[:, k : k + 1], gradient)
            torch.sum(gradient * taps, dim=1, out=of_weights[:, k])
        return of_padded, of_weights, None


def list_taps(padded: Tensor, weights: Tensor, step: int) -> list[Tensor]:
    """Return the image of each neighbour, a view of what is padded."""
    side = int(weights.shape[1] ** 0.5)
    rows, columns = weights.shape[-2:]
    offsets = [(step * v, step * u) for v in range(side) for u in range(side)]
    return [padded[..., v : v + rows, u : u + columns] for v, u in offsets]


def gather(sums: Tensor, weights: Tensor) -> Tensor:
    """Return weighted sums over a square of neighbours; pixels outside the image count nothing."""
    padded = functional.pad(sums, (int(weights.shape[1] ** 0.5) // 2,) * 4)
    return SumOfTaps.apply(padded, weights, 1)  # type: ignore[no-any-return, no-untyped-call]


def gather_coarse(sums: Tensor, weights: Tensor) -> Tensor:
    """Return weighted sums over the 3x3 pixels of the level above around each pixel's parent."""
    padded = enlarge(functional.pad(sums, (1, 1, 1, 1)))
    return SumOfTaps.apply(padded, weights, 2)  # type: ignore[no-any-return, no-untyped-call]
