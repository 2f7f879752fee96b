"""Train the network that says, pixel by pixel, how much of our image enters that of Open Image Denoise.

The frames are those of a folder that ``make_frames.py`` fills: each is rendered again from its seed, because the files
lack what filters look at, and denoised by both with guides missing at random. A fifth of the scenes is kept aside. What
is minimised is the mean logarithm of the mixture's error over that of Open Image Denoise, and twice what exceeds 1, so
that the mixture is hardly ever worse. The weights go into the package's file beside those of `train.py`.

    python -m benchmarks.training.peer_share --frames FOLDER --cache OTHER_FOLDER --collect
    python -m benchmarks.training.peer_share --frames FOLDER --cache OTHER_FOLDER

The first needs ``lobewise[mitsuba,best]``, the second ``lobewise[train]``.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.training.frames import is_validation, list_frames, make_half, parse_file_name, read_frame_file
from benchmarks.training.train import replace_networks
from lobewise.denoising.combining import find_level
from lobewise.denoising.high import WEIGHTS
from lobewise.filters.mixing import LEAK, Network
from lobewise.filters.noise.agreement import COUNT, find_agreement
from lobewise.frame import Frame, GBuffer, Radiance
from lobewise.metrics import EPSILON

KINDS = ("all", "plain", "passes", "shared")
"""Sets of guides: all; one albedo, normal and depth beside light together; split light with albedos and roughness, but
no halves; all guides, no halves, and a pixel filter by which neighbours share samples."""
MAX_FRAMES = 2
"""Of a scene."""
SHARED_SIGMA = 0.6
"""Standard deviation of that pixel filter, pixels."""
PIXELS = 12288
"""Of a frame, that are trained on."""
UNITS = 24
STEPS, BATCH_FRAMES, BATCH_PIXELS = 1500, 8, 2048
RATE, LAST_RATE_SHARE = 3e-3, 0.02
CAP = 20.0
"""Error, over the mean error of Open Image Denoise, above which a pixel pulls no harder."""
SMALLEST_RATIO = 0.03
PENALTY = 2.0
"""Of what a frame's error exceeds that of Open Image Denoise by, in units of that."""

Array = NDArray[np.float32]


def blur(image: Array) -> Array:
    """Return an image as a wide pixel filter makes it."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, (SHARED_SIGMA, SHARED_SIGMA, 0.0), mode="nearest"), dtype=np.float32)


def vary_guides(frame: Frame, rng: np.random.Generator) -> Iterator[tuple[str, Frame]]:
    """Yield a frame with three of the four sets of guides."""
    yield "all", frame
    guides, light = frame.gbuffer, frame.radiance
    without = replace(frame, half_a=None, half_b=None, variance=None)
    assert guides.diffuse_albedo is not None
    assert guides.specular_albedo is not None
    albedo = np.clip(guides.diffuse_albedo + guides.specular_albedo, 0.0, 1.0)
    plain = GBuffer(normal=guides.normal, depth=guides.depth, diffuse_albedo=albedo)
    yield "plain", replace(without, gbuffer=plain, radiance=Radiance(light.color))
    if rng.random() < 0.5:
        assert light.diffuse is not None
        assert light.specular is not None
        soft = Radiance(blur(light.color), diffuse=blur(light.diffuse), specular=blur(light.specular))
        yield "shared", replace(without, radiance=soft, noise_is_shared=True)
        return
    names = ("normal", "depth", "position", "diffuse_albedo", "specular_albedo", "alpha_u", "alpha_v", "lobe_kind")
    kept = {name: getattr(guides, name) for name in (*names, "tangent")}
    yield "passes", replace(without, gbuffer=GBuffer(**kept))


def collect_scene(files: list[Path], seed: int, cache: Path) -> list[Path]:
    """Denoise the frames of a scene and write what is not there yet; return what was written."""
    from benchmarks.training.kinds import make_kind
    from benchmarks.training.make_frames import expose
    from benchmarks.training.scenes import build_scene
    from lobewise.denoising.recipe import filter_frame, resolve_all
    from lobewise.peers import denoise_oidn
    from lobewise.render import render_frame
    from lobewise.settings import DenoiseSettings

    rng = np.random.default_rng(seed)
    # One sample per pixel tells little of the noise, so such frames come last.
    chosen = [path for path in files if not path.stem.endswith("-0001")] or files
    if len(chosen) > MAX_FRAMES:
        chosen = [chosen[k] for k in sorted(rng.choice(len(chosen), MAX_FRAMES, replace=False))]
    written: list[Path] = []
    scene: Any = None
    for path in chosen:
        found = parse_file_name(path)
        assert found is not None
        spp = found[1]
        if (cache / f"{seed:05d}-{spp:04d}-plain.npz").exists():
            continue
        example = read_frame_file(path)
        scene = build_scene(make_kind(seed, *example.color.shape[1::-1])) if scene is None else scene
        frame = render_frame(scene, spp=spp, seed=1000 * seed + spp)
        lit = (frame.radiance.color > 1e-3) & (example.color < 5e4)
        frame = expose(frame, float(np.median(example.color[lit].astype(np.float64) / frame.radiance.color[lit])))
        for kind, each in vary_guides(frame, rng):
            # With Open Image Denoise to follow, ours is what is mixed with it: no evidence was looked at.
            settings = resolve_all(each, DenoiseSettings(quality="high", with_oidn=True))
            ours = filter_frame(each, settings).image
            images = {"noisy": each.radiance.color, "ours": ours, "peer": denoise_oidn(each)[0]}
            if each.half_a is not None and each.half_b is not None:
                images |= {"half_a": each.half_a.color, "half_b": each.half_b.color}
            halves = {name: make_half(image) for name, image in images.items()}
            target = cache / f"{seed:05d}-{spp:04d}-{kind}.npz"
            np.savez(target, reference=example.reference, shared=np.array(kind == "shared"), **halves)
            written.append(target)
    return written


@dataclass
class Examples:
    """What is known of some pixels of a frame, one a row, as tensors: what is seen, both images and their target."""

    seed: int
    kind: str
    seen: Any
    peer: Any
    ours: Any
    reference: Any
    weight: Any


def read_examples(path: Path, rng: np.random.Generator) -> Examples:
    """Return some pixels of a file that `collect_scene` wrote."""
    import torch

    seed, _, kind = path.stem.split("-")
    with np.load(path) as arrays:
        images = {name: arrays[name].astype(np.float32) for name in arrays.files if name != "shared"}
    halves = (images["half_a"], images["half_b"]) if "half_a" in images else None
    peer, ours = images["peer"], images["ours"]
    seen = find_agreement(
        peer, ours, images["noisy"], halves=halves, level=find_level(peer), shared=kind == "shared"
    ).reshape(-1, COUNT)
    chosen = rng.choice(len(seen), min(PIXELS, len(seen)), replace=False)
    flat = [each.reshape(-1, 3)[chosen] for each in (peer, ours, images["reference"])]
    weight = 1.0 / (flat[2] ** 2 + EPSILON)
    return Examples(int(seed), kind, *(torch.from_numpy(each) for each in (seen[chosen], *flat, weight)))


class ShareNetwork:
    """The network of `lobewise.denoising.combining.find_our_share` in PyTorch, with one output instead of two."""

    def __init__(self, examples: list[Examples]) -> None:
        import torch

        every = torch.cat([each.seen for each in examples])
        self.mean, self.scale = every.mean(0), 1.0 / every.std(0).clamp_min(1e-2)
        sizes = [COUNT, UNITS, UNITS, 1]
        self.layers = [torch.nn.Linear(before, after) for before, after in pairwise(sizes)]
        with torch.no_grad():
            # It begins with nearly a quarter of ours everywhere.
            self.layers[-1].weight.mul_(0.1)
            self.layers[-1].bias.fill_(-1.2)

    def find_share(self, seen: Any) -> Any:
        """Return the share of ours, (pixels, 1)."""
        import torch

        values = (seen - self.mean) * self.scale
        for layer in self.layers[:-1]:
            values = torch.nn.functional.leaky_relu(layer(values), LEAK)
        return torch.sigmoid(self.layers[-1](values))

    def export(self) -> Network:
        """Return it as the package runs it: the second output, of the peer, is 0."""
        weights = [layer.weight.detach().numpy().T for layer in self.layers]
        biases = [layer.bias.detach().numpy() for layer in self.layers]
        weights[-1] = np.concatenate([weights[-1], np.zeros_like(weights[-1])], axis=1)
        biases[-1] = np.concatenate([biases[-1], np.zeros_like(biases[-1])])
        arrays = [np.ascontiguousarray(each, np.float32) for each in (self.mean.numpy(), self.scale.numpy())]
        return Network(*arrays, tuple(map(np.ascontiguousarray, weights)), tuple(biases))  # type: ignore[arg-type]


def find_ratio(network: ShareNetwork, each: Examples, chosen: Any = slice(None)) -> Any:
    """Return the error of the mixture over the peer's, both bounded by `CAP`."""
    import torch

    peer, reference, weight = each.peer[chosen], each.reference[chosen], each.weight[chosen]
    mixed = peer + network.find_share(each.seen[chosen]) * (each.ours[chosen] - peer)
    errors = [((image - reference).square() * weight).sum(-1) for image in (mixed, peer)]
    bound = CAP * errors[1].mean()
    mine, theirs = (torch.minimum(error, bound).sum() for error in errors)
    return mine / theirs


def train(examples: list[Examples], steps: int, seed: int) -> ShareNetwork:
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
        for number in rng.choice(len(examples), min(BATCH_FRAMES, len(examples)), replace=False):
            each = examples[number]
            chosen = torch.from_numpy(rng.integers(0, len(each.seen), BATCH_PIXELS))
            ratio = find_ratio(network, each, chosen)
            loss = loss + torch.log(ratio + SMALLEST_RATIO) + PENALTY * torch.relu(ratio - 1.0)
        optimiser.zero_grad()
        (loss / BATCH_FRAMES).backward()
        optimiser.step()
    return network


def measure(network: ShareNetwork, examples: list[Examples]) -> dict[str, dict[str, float]]:
    """Return of every set of guides the geometric mean and the largest of the frames' ratios."""
    import torch

    table: dict[str, dict[str, float]] = {}
    with torch.no_grad():
        for kind in KINDS:
            ratios = [float(find_ratio(network, each)) for each in examples if each.kind == kind]
            if ratios:
                mean = math.exp(float(np.mean(np.log(ratios))))
                table[kind] = {"mean": round(mean, 4), "largest": round(max(ratios), 4), "frames": len(ratios)}
    return table


def main(words: list[str] | None = None) -> None:
    """Collect what is missing; or train, measure on scenes kept aside, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, required=True, help="folder that make_frames.py filled")
    parser.add_argument("--cache", type=Path, required=True, help="folder for both denoised images of every frame")
    parser.add_argument("--collect", action="store_true", help="render and denoise what the cache lacks, no more")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=0)
    default = ROOT / "src" / "lobewise" / "denoising" / WEIGHTS
    parser.add_argument("-o", "--output", type=Path, default=default)
    parser.add_argument("--results", type=Path, default=RESULTS / "peer_share.json")
    arguments = parser.parse_args(words)
    if arguments.collect:
        from benchmarks.training.make_frames import limit_threads

        limit_threads(1)
        arguments.cache.mkdir(parents=True, exist_ok=True)
        by_seed: dict[int, list[Path]] = {}
        for path in list_frames(arguments.frames):
            found = parse_file_name(path)
            assert found is not None
            by_seed.setdefault(found[0], []).append(path)
        for seed, files in by_seed.items():
            written = collect_scene(files, seed, arguments.cache)
            print(f"scene {seed}: {len(written)} written", flush=True)
        return
    import torch

    torch.set_num_threads(1)
    rng = np.random.default_rng(arguments.seed)
    examples = [read_examples(path, rng) for path in sorted(arguments.cache.glob("*.npz"))]
    shown = [each for each in examples if not is_validation(each.seed)]
    aside = [each for each in examples if is_validation(each.seed)]
    network = train(shown, arguments.steps, arguments.seed)
    tables = {"trained": measure(network, shown), "kept aside": measure(network, aside)}
    for name, table in tables.items():
        print(name, table, flush=True)
    replace_networks(arguments.output, {"peer": network.export()})
    write_json(
        arguments.results,
        {
            "what": "squared relative error of the mixture over that of Open Image Denoise with the same guides; "
            "references of 128 samples per pixel or more that Open Image Denoise cleaned",
            "scenes": len({each.seed for each in examples}),
            "scenes_kept_aside": len({each.seed for each in aside}),
            "steps": arguments.steps,
            "ratios": tables,
            "machine": describe_machine(),
        },
    )


if __name__ == "__main__":
    main()
