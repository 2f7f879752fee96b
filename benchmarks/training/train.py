"""Train the networks of the quality "high" on scenes made at random, and write their weights into the package.

The frames and references are those of `scenes.py` (none of the scenes that results are judged on). For every
pixel the networks of both layers say in which proportions thirteen filtered images are mixed; what is minimised is the
relative squared error of the sum of both layers, each frame counting by its error before. A fifth of the scenes is
kept aside to tell when the networks only learn their scenes by heart. The third network of the file, which mixes what
comes out with what Open Image Denoise makes of the frame, stays as it is: `shares.py` trains that.

    python -m benchmarks.training.scenes --cache DIR --count 24 --size 384 --reference-spp 256
    python -m benchmarks.training.train --cache DIR
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from lobewise.denoising.automatic import resolve_guided
from lobewise.denoising.networks import WEIGHTS, pack_network
from lobewise.denoising.noisy import make_noisy_layers
from lobewise.denoising.planning.layer_plans import MIDDLE
from lobewise.denoising.running import find_candidates, finish_layer
from lobewise.filters.mixing import Network, find_features
from lobewise.filters.mixing_pass import LEAK
from lobewise.frame import Frame
from lobewise.io.exr import read_frame, read_image
from lobewise.metrics import EPSILON
from lobewise.settings import DenoiseSettings

Array = NDArray[np.float32]

KINDS = ("diffuse", "specular")
SAMPLES = (1, 4, 16, 64)
UNITS = (32, 32)
BATCH = 8192
STEPS = 3000
RATE = 3e-3
CAP = 20.0
"""Squared relative error, over the frame's mean, above which a pixel pulls no harder: fireflies teach nothing."""
SHARE = 0.15
"""Share of the pixels that are taken as examples."""
HELD_OUT_EVERY = 5
"""Every fifth scene is not trained on."""


@dataclass
class Examples:
    """What is known of some pixels of a frame, one a row."""

    features: dict[str, Array]
    """By network, (pixels, features)."""
    candidates: dict[str, Array]
    """By network, (pixels, candidates, 3): radiance, over the pixel's area; the networks' mixtures are added."""
    target: Array
    """The reference without what is in none of them, (pixels, 3)."""
    weight: Array
    """One over squared reference and the frame's own mean error, (pixels, 3)."""
    noise: float
    """What the noise of the reference alone adds to the mean weighted error."""


@dataclass
class Scene:
    """Both halves of a reference, their mean and where examples are taken."""

    halves: tuple[Array, Array]
    chosen: NDArray[np.bool_]

    @property
    def reference(self) -> Array:
        """Mean of both halves, (height, width, 3)."""
        return np.asarray(0.5 * (self.halves[0] + self.halves[1]), dtype=np.float32)


def resolve(frame: Frame) -> DenoiseSettings:
    """Return the settings of the quality "high"."""
    asked = DenoiseSettings(quality="high")
    return resolve_guided(frame, asked)


def make_examples(
    scene: Scene, rest: Array, features: dict[str, Array], candidates: dict[str, list[Array]], before: Array
) -> Examples:
    """Return the examples of a frame; ``before`` is what the error is relative to, ``rest`` what is not filtered."""
    chosen, reference = scene.chosen, scene.reference
    relative = 1.0 / (reference**2 + EPSILON)
    # Both halves of the reference have noise of their own, so their product has none.
    unbiased = float(np.mean((before - scene.halves[0]) * (before - scene.halves[1]) * relative))
    biased = float(np.mean(np.square(before - reference) * relative))
    return Examples(
        {kind: each[chosen] for kind, each in features.items()},
        {kind: np.stack([image[chosen] for image in images], axis=1) for kind, images in candidates.items()},
        (reference - rest)[chosen].astype(np.float32),
        (relative[chosen] / unbiased).astype(np.float32),
        (biased - unbiased) / unbiased,
    )


def find_rest(frame: Frame) -> Array:
    """Return what is in neither layer."""
    radiance = frame.radiance
    assert radiance.diffuse is not None
    assert radiance.specular is not None
    return np.asarray(np.maximum(radiance.color - radiance.diffuse - radiance.specular, np.float32(0.0)))


def collect(frame: Frame, scene: Scene) -> Examples:
    """Return the examples of a frame whose radiance is told apart by lobe."""
    settings = resolve(frame)
    features, candidates = {}, {}
    for noisy in make_noisy_layers(frame, settings, ()):
        found = find_candidates(frame, noisy, settings)
        features[noisy.name] = find_features(found.pairs, MIDDLE, found.extras, noisy.level)
        candidates[noisy.name] = [finish_layer(frame, noisy, pair, found.middle).image for pair in found.pairs]
    rest = find_rest(frame)
    return make_examples(scene, rest, features, candidates, sum((candidates[kind][MIDDLE] for kind in KINDS), rest))


def join(examples: list[Examples]) -> Examples:
    """Return the examples of many frames as one."""
    kinds = examples[0].features
    return Examples(
        {kind: np.concatenate([each.features[kind] for each in examples]) for kind in kinds},
        {kind: np.concatenate([each.candidates[kind] for each in examples]) for kind in kinds},
        np.concatenate([each.target for each in examples]),
        np.concatenate([each.weight for each in examples]),
        float(np.mean([each.noise for each in examples])),
    )


def make_network(features: Array, candidates: int, rng: np.random.Generator) -> Network:
    """Return an untrained network: near-equal shares for all candidates."""
    sizes = [features.shape[1], *UNITS, candidates]
    pairs = list(pairwise(sizes))
    gains = [np.sqrt(2.0 / before) for before, _ in pairs[:-1]] + [0.1 / np.sqrt(pairs[-1][0])]
    weights = [(gain * rng.normal(size=pair)).astype(np.float32) for gain, pair in zip(gains, pairs, strict=True)]
    biases = [np.zeros(after, dtype=np.float32) for _, after in pairs]
    scale = 1.0 / np.maximum(features.std(axis=0), 1e-3)
    return Network(features.mean(axis=0), scale.astype(np.float32), tuple(weights), tuple(biases))  # type: ignore[arg-type]


def run_forward(network: Network, features: Array) -> tuple[Array, list[Array]]:
    """Return the shares (pixels, candidates) and what every layer of units gave."""
    values = [(features - network.mean) * network.scale]
    for number, (weights, biases) in enumerate(zip(network.weights, network.biases, strict=True)):
        total = values[-1] @ weights + biases
        values.append(total if number == len(network.weights) - 1 else np.maximum(total, LEAK * total))
    scores = np.exp(values[-1] - values[-1].max(axis=1, keepdims=True))
    return scores / scores.sum(axis=1, keepdims=True), values


def run_backward(network: Network, values: list[Array], shares: Array, slope: Array) -> list[Array]:
    """Return the derivatives of the loss by weights and biases, given those by the shares."""
    slope = shares * (slope - (slope * shares).sum(axis=1, keepdims=True))
    found: list[Array] = []
    for number in reversed(range(len(network.weights))):
        if number < len(network.weights) - 1:
            slope = slope * np.where(values[number + 1] > 0.0, np.float32(1.0), np.float32(LEAK))
        found = [values[number].T @ slope, slope.sum(axis=0), *found]
        slope = slope @ network.weights[number].T
    return found


class Adam:
    """Kingma and Ba 2015, with its usual constants."""

    def __init__(self, parameters: list[Array]) -> None:
        self.parameters = parameters
        self.means = [np.zeros_like(each) for each in parameters]
        self.squares = [np.zeros_like(each) for each in parameters]
        self.steps = 0

    def move(self, slopes: list[Array], rate: float) -> None:
        """Take one step down."""
        self.steps += 1
        for value, slope, mean, square in zip(self.parameters, slopes, self.means, self.squares, strict=True):
            mean += 0.1 * (slope - mean)
            square += 0.001 * (slope * slope - square)
            length = np.sqrt(square / (1.0 - 0.999**self.steps)) + 1e-8
            value -= np.float32(rate / (1.0 - 0.9**self.steps)) * mean / length


def list_parameters(network: Network) -> list[Array]:
    """Return weights and biases in the order of `run_backward`."""
    return [each for pair in zip(network.weights, network.biases, strict=True) for each in pair]


def train(examples: Examples, steps: int, seed: int) -> dict[str, Network]:
    """Return the networks of both layers."""
    rng = np.random.default_rng(seed)
    counts = {kind: candidates.shape[1] for kind, candidates in examples.candidates.items()}
    networks = {kind: make_network(seen, counts[kind], rng) for kind, seen in examples.features.items()}
    optimisers = {kind: Adam(list_parameters(network)) for kind, network in networks.items()}
    loss = 1.0
    for step in range(steps):
        chosen = rng.integers(0, len(examples.target), BATCH)
        mixed = np.zeros((BATCH, 3), dtype=np.float32)
        state = {}
        for kind, network in networks.items():
            candidates = examples.candidates[kind][chosen]
            shares, values = run_forward(network, examples.features[kind][chosen])
            mixed += (shares[..., None] * candidates).sum(axis=1)
            state[kind] = candidates, shares, values
        error, weight = mixed - examples.target[chosen], examples.weight[chosen]
        each = (error * error * weight).mean(axis=1)
        loss += 0.01 * (float(np.minimum(each, CAP).mean()) - loss)
        slope = (2.0 / (3.0 * BATCH)) * error * weight * np.minimum(1.0, CAP / np.maximum(each, 1e-6))[:, None]
        rate = RATE * 0.5 * (1.0 + np.cos(np.pi * step / steps)) + 1e-5
        for kind, (candidates, shares, values) in state.items():
            by_share = (slope[:, None, :] * candidates).sum(axis=-1)
            optimisers[kind].move(run_backward(networks[kind], values, shares, by_share), rate)
        if step % 500 == 0:
            print(f"step {step}: {loss:.3f} of the error before", flush=True)
    return networks


def measure(networks: dict[str, Network], examples: Examples) -> float:
    """Return the mean error over that before, of one frame, without the noise of its reference."""
    mixed = np.zeros_like(examples.target)
    for kind in examples.features:
        shares, _ = run_forward(networks[kind], examples.features[kind])
        mixed += (shares[..., None] * examples.candidates[kind]).sum(axis=1)
    return float((np.square(mixed - examples.target) * examples.weight).mean()) - examples.noise


def train_and_measure(
    frames: dict[tuple[int, int], Examples], kept: list[int], arguments: argparse.Namespace
) -> tuple[dict[str, Network], dict[str, Any]]:
    """Return the networks of all scenes, and the errors of networks that have not seen those ``kept`` aside."""
    shown = join([each for (seed, _), each in frames.items() if seed not in kept])
    networks = train(shown, arguments.steps, arguments.seed)
    table: dict[str, dict[str, float]] = {}
    for spp in SAMPLES:
        of_spp = {seed: each for (seed, count), each in frames.items() if count == spp}
        for name, group in (("trained", set(of_spp) - set(kept)), ("kept aside", set(of_spp) & set(kept))):
            ratios = [max(measure(networks, of_spp[seed]), 1e-3) for seed in sorted(group)]
            table.setdefault(str(spp), {})[name] = float(np.exp(np.mean(np.log(ratios))))
        print(
            f"{spp:>2} spp: " + ", ".join(f"{name} {value:.3f}" for name, value in table[str(spp)].items()), flush=True
        )
    del shown
    return train(join(list(frames.values())), arguments.steps, arguments.seed), table


def replace_networks(path: Path, networks: dict[str, Network]) -> dict[str, Array]:
    """Write networks into a file that keeps its others, and return all arrays of it."""
    arrays: dict[str, Array] = dict(np.load(path, allow_pickle=False)) if path.exists() else {}
    for kind, each in networks.items():
        arrays |= pack_network(each, kind)
    temporary = path.with_suffix(".tmp.npz")
    np.savez(temporary, **arrays)  # type: ignore[arg-type]
    temporary.replace(path)
    return arrays


def main() -> None:
    """Collect, train, measure on scenes kept aside, train again on all, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder that scenes.py filled")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=1)
    default = ROOT / "src" / "lobewise" / "denoising" / WEIGHTS
    parser.add_argument("-o", "--output", type=Path, default=default)
    results = RESULTS / "training.json"
    parser.add_argument("--results", type=Path, default=results)
    arguments = parser.parse_args()
    cache, rng = arguments.cache, np.random.default_rng(arguments.seed)
    seeds = sorted(int(path.name.split("-")[1]) for path in cache.glob("train-*-reference-b.exr"))
    scenes: dict[int, Scene] = {}
    frames: dict[tuple[int, int], Examples] = {}
    for seed in seeds:
        a, b = (read_image(cache / f"train-{seed}-reference-{half}.exr") for half in "ab")
        scenes[seed] = Scene((a, b), rng.random(a.shape[:2]) < SHARE)
        for spp in SAMPLES:
            frames[seed, spp] = collect(read_frame(cache / f"train-{seed}-{spp}.exr"), scenes[seed])
        print(f"scene {seed} collected", flush=True)
    kept = [seed for seed in seeds if seed % HELD_OUT_EVERY == 0]
    networks, table = train_and_measure(frames, kept, arguments)
    arrays = replace_networks(arguments.output, networks)
    write_json(
        arguments.results,
        {
            "what": "error of the mixture over that of the middle candidate; geometric means over scenes, noise of the "
            "references subtracted",
            "scenes": seeds,
            "kept_aside": kept,
            "weights": int(sum(array.size for array in arrays.values())),
            "steps": arguments.steps,
            "ratios": table,
            "machine": describe_machine(),
        },
    )


if __name__ == "__main__":
    main()
