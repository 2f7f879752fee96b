"""A small network that says how much of other images enters an image, pixel by pixel, and how it is trained.

What is minimised is the mean logarithm of the mixture's error over the smallest error of all images, and what exceeds 1
several times more, so that the mixture is hardly ever worse than one of them. Errors are products of the differences to
two independent references, so that the noise of these is in none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.filters.mixing import PERCEPTRON_LEAK, Perceptron
from lobewise.metrics import EPSILON

PIXELS = 8192
"""Of an image, that are trained on."""
UNITS = 24
BATCH_IMAGES, BATCH_PIXELS = 8, 2048
RATE, LAST_RATE_SHARE = 3e-3, 0.02
CAP = 20.0
"""Error, over the mean of the best image, beyond which a pixel's error counts by its logarithm only."""
SMALLEST_RATIO = 0.03
SMALLEST_ERROR = 0.002
"""Of the best image, over its cap: below, the references' noise rules the ratio."""
PENALTY, PENALTY_OVER_IMAGE = 2.0, 8.0
"""Of what a mixture's error exceeds that of the best image by, in units of that; and that of the image which the others
enter: who has the image alone shall not lose by the mixture."""
FIRST_SHARE = 0.05
"""Of all other images together, that the network begins with everywhere."""

Array = NDArray[np.float32]


@dataclass
class Examples:
    """Some pixels of an image, one a row, as tensors: what is seen, the image, the others and both references.

    Parameters
    ----------
    seed : int
        Of the scene.
    group : tuple of str
        What errors are told apart by.
    seen : tensor, (pixels, features)
    images : list of tensors, (pixels, 3)
        The image, then the others.
    reference_a, reference_b, weight : tensor, (pixels, 3)
        Errors are multiplied by the weight.
    cap : float
        From which size on products of differences grow as their logarithm.
    """

    seed: int
    group: tuple[str, ...]
    seen: Any
    images: list[Any]
    reference_a: Any
    reference_b: Any
    weight: Any
    cap: float

    def compute_error(self, image: Any, chosen: Any = slice(None)) -> Any:
        """Return the error of an image's chosen pixels."""
        apart = (image - self.reference_a[chosen]) * (image - self.reference_b[chosen])
        return soften((apart * self.weight[chosen]).sum(-1), self.cap).mean()


def make_examples(
    seed: int,
    group: tuple[str, ...],
    seen: Array,
    images: Sequence[Array],
    references: Sequence[Array],
    clean: Array,
    rng: np.random.Generator,
) -> Examples:
    """Return some pixels of an image.

    Parameters
    ----------
    seed, group
        See `Examples`.
    seen : (height, width, features)
    images : sequence of arrays, (height, width, 3)
        The image, then the others.
    references : two arrays, (height, width, 3)
        Independent and noisy.
    clean : (height, width, 3)
        What errors are relative to.
    rng : numpy.random.Generator
        Chooses the pixels.
    """
    import torch

    count = clean.shape[0] * clean.shape[1]
    chosen = rng.choice(count, min(PIXELS, count), replace=False)
    weight = 1.0 / (clean**2 + np.float32(EPSILON))
    flat = [each.reshape(count, -1)[chosen] for each in (*images, *references, weight)]
    *candidates, first, second, there = flat
    errors = [np.abs((image - first) * (image - second) * there).sum(-1).mean() for image in candidates]
    known = torch.from_numpy(np.ascontiguousarray(seen.reshape(count, -1)[chosen]))
    tensors = [torch.from_numpy(np.ascontiguousarray(each)) for each in flat]
    cap = CAP * max(float(min(errors)), 1e-5)
    return Examples(seed, group, known, tensors[: len(images)], *tensors[len(images) :], cap=cap)


def soften(errors: Any, cap: float) -> Any:
    """Return errors of which those beyond a cap, of either sign, grow as their logarithm: they still have a slope."""
    import torch

    sizes = errors.abs()
    return torch.where(sizes > cap, torch.sign(errors) * cap * (1.0 + torch.log(sizes.clamp_min(cap) / cap)), errors)


class ShareNetwork:
    """The network of `lobewise.filters.mixing.compute_shares` in PyTorch; the score of the image itself is 0."""

    def __init__(self, examples: Sequence[Examples]) -> None:
        import torch

        every = torch.cat([each.seen[::8] for each in examples])
        self.mean, self.scale = every.mean(0), 1.0 / every.std(0).clamp_min(1e-2)
        sizes = [every.shape[1], UNITS, UNITS, len(examples[0].images) - 1]
        self.layers = [torch.nn.Linear(before, after) for before, after in pairwise(sizes)]
        with torch.no_grad():
            self.layers[-1].weight.mul_(0.1)
            self.layers[-1].bias.fill_(math.log(FIRST_SHARE / sizes[-1] / (1.0 - FIRST_SHARE)))

    def compute_shares(self, seen: Any) -> Any:
        """Return the shares of the other images, (pixels, others)."""
        import torch

        values = (seen - self.mean) * self.scale
        for layer in self.layers[:-1]:
            values = torch.nn.functional.leaky_relu(layer(values), PERCEPTRON_LEAK)
        scores = self.layers[-1](values)
        return torch.softmax(torch.cat([scores, torch.zeros_like(scores[:, :1])], dim=1), dim=1)[:, :-1]

    def mix(self, each: Examples, chosen: Any = slice(None)) -> Any:
        """Return the mixture of all images at the chosen pixels."""
        base, *others = (image[chosen] for image in each.images)
        mixed, shares = base, self.compute_shares(each.seen[chosen])
        for number, other in enumerate(others):
            mixed = mixed + shares[:, number, None] * (other - base)
        return mixed

    def export(self) -> Perceptron:
        """Return the network as the package runs it: its last output, of the image itself, is 0."""
        weights = [layer.weight.detach().numpy().T for layer in self.layers]
        biases = [layer.bias.detach().numpy() for layer in self.layers]
        weights[-1] = np.concatenate([weights[-1], np.zeros_like(weights[-1][:, :1])], axis=1)
        biases[-1] = np.concatenate([biases[-1], np.zeros_like(biases[-1][:1])])
        arrays = [np.ascontiguousarray(each, np.float32) for each in (self.mean.numpy(), self.scale.numpy())]
        return Perceptron(*arrays, tuple(map(np.ascontiguousarray, weights)), tuple(biases))  # type: ignore[arg-type]


def train(examples: Sequence[Examples], steps: int, seed: int) -> ShareNetwork:
    """Return a network trained on the examples."""
    import torch

    torch.manual_seed(seed)
    rng, network = np.random.default_rng(seed), ShareNetwork(examples)
    optimiser = torch.optim.Adam([value for layer in network.layers for value in layer.parameters()], RATE)
    for step in range(steps):
        fall = 0.5 * (1.0 + math.cos(math.pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = RATE * (LAST_RATE_SHARE + (1.0 - LAST_RATE_SHARE) * fall)
        loss = torch.zeros(())
        for number in rng.choice(len(examples), min(BATCH_IMAGES, len(examples)), replace=False):
            each = examples[number]
            chosen = torch.from_numpy(rng.integers(0, len(each.seen), BATCH_PIXELS))
            error = each.compute_error(network.mix(each, chosen), chosen)
            base, *others = (each.compute_error(image[chosen], chosen) for image in each.images)
            least = SMALLEST_ERROR * each.cap
            ratio = error / torch.stack([base, *others]).min().clamp_min(least)
            loss = loss + torch.log(ratio.clamp_min(0.0) + SMALLEST_RATIO) + PENALTY * torch.relu(ratio - 1.0)
            loss = loss + PENALTY_OVER_IMAGE * torch.relu(error / base.clamp_min(least) - 1.0)
        optimiser.zero_grad()
        (loss / BATCH_IMAGES).backward()
        optimiser.step()
    return network


def measure(network: ShareNetwork, examples: Sequence[Examples]) -> dict[str, dict[str, float]]:
    """Return by group the geometric means and largest ratios of the mixture's error over the image's and the last's."""
    import torch

    found: dict[str, list[tuple[float, float]]] = {}
    with torch.no_grad():
        for each in examples:
            errors = [
                float(each.compute_error(image)) for image in (network.mix(each), each.images[0], each.images[-1])
            ]
            mixed, base, other = (max(error, 1e-7) for error in errors)
            found.setdefault(" ".join(each.group), []).append((mixed / base, mixed / other))
    table = {}
    for group, pairs in sorted(found.items(), key=lambda pair: (pair[0].split()[:2], int(pair[0].split()[2]))):
        means = np.exp(np.mean(np.log(pairs), axis=0))
        largest = np.max(pairs, axis=0)
        table[group] = {
            "over_image": round(float(means[0]), 4),
            "over_image_largest": round(float(largest[0]), 4),
            "over_other": round(float(means[1]), 4),
            "over_other_largest": round(float(largest[1]), 4),
            "images": len(pairs),
        }
    return table
