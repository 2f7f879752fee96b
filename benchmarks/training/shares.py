"""Train the networks that mix images pixel by pixel, on what `candidates.py` and `textures.py` collected.

    python -m benchmarks.training.candidates --cache FOLDER
    python -m benchmarks.training.textures --cache FOLDER
    python -m benchmarks.training.shares --cache FOLDER

"noisy" tells how much of the noisy image a result of `balanced` takes back, "refined" how much a result of `high`.
"peer" tells how much of the image of `high`, after "refined", and of the noisy image enters the image of Open Image
Denoise. A fifth of the scenes is kept aside and tells the errors. Drawn textures do not train "peer". The weights go
into the package's file; ``--networks`` names those to train, and the others stay. Needs ``lobewise[train]``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.training.candidates import COLOR, DRAWN, FEW_SPP, Candidates, read_candidates
from benchmarks.training.frames import is_validation
from benchmarks.training.share_network import Examples, ShareNetwork, make_examples, measure, train
from lobewise.denoising.combining import compute_mean_luminance, see_mixture
from lobewise.denoising.evidence import NAMES, SHARE_WEIGHTS, load_networks
from lobewise.filters.mixing import Perceptron
from lobewise.filters.noise.detail import compute_detail, predict_shares

STEPS = 9000
MAX_LEVEL = 4.0
"""The level that differences are relative to is drawn up to so many times the mean luminance: where light is divided by
albedo it is larger."""
FILTERED = {"noisy": "balanced", "refined": "high"}
"""The quality whose results each network mixes with the noisy image."""

Array = NDArray[np.float32]


def describe_group(found: Candidates) -> tuple[str, str]:
    """Return what errors are told apart by: whether all guides and halves are there or none, and samples per pixel."""
    if found.kind == DRAWN:
        return DRAWN, "0 spp"
    few = found.spp in FEW_SPP
    guides = found.kind if found.kind in ("all", COLOR) else "less"
    return guides, f"{FEW_SPP[0]} to {FEW_SPP[-1]} spp" if few else f"{found.spp} spp"


def make_noisy(found: Candidates, quality: str, rng: np.random.Generator) -> Examples:
    """Return the example for the network of a quality: its result, and the noisy image."""
    image = getattr(found, quality)
    level = compute_mean_luminance(image) * MAX_LEVEL ** rng.random()
    rows = compute_detail(image, found.noisy, halves=found.halves, level=level, shared=found.kind == "shared")
    seen = np.concatenate([features for _, features in rows])
    references = found.reference_a, found.reference_b
    group = quality, *describe_group(found)
    return make_examples(found.seed, group, seen, (image, found.noisy), references, found.clean, rng)


def make_peer(found: Candidates, network: Perceptron, rng: np.random.Generator) -> Examples:
    """Return the example for the network "peer": the image of Open Image Denoise, ours, and the noisy one."""
    shared = found.kind == "shared"
    level = compute_mean_luminance(found.high)
    shares = predict_shares(found.high, found.noisy, network, halves=found.halves, level=level, shared=shared)
    ours = found.high + shares[..., :1] * (found.noisy - found.high)
    rows = see_mixture(found.noisy, ours, found.peer, shared=shared)
    seen = np.concatenate([features for _, features in rows])
    references = found.reference_a, found.reference_b
    images = found.peer, ours, found.noisy
    group = "peer", found.kind, describe_group(found)[1]
    return make_examples(found.seed, group, seen, images, references, found.clean, rng)


def train_aside(examples: Sequence[Examples], steps: int, seed: int) -> tuple[ShareNetwork, dict[str, object]]:
    """Return a network that was trained on four fifths of the scenes, and its errors on these and on the others."""
    shown = [each for each in examples if not is_validation(each.seed)]
    aside = [each for each in examples if is_validation(each.seed)]
    network = train(shown, steps, seed)
    tables = {"trained": measure(network, shown), "kept aside": measure(network, aside)}
    return network, tables


def train_all(paths: Sequence[Path], arguments: argparse.Namespace) -> tuple[dict[str, Perceptron], dict[str, object]]:
    """Return the trained networks and their errors, by name."""
    rng, networks, errors = np.random.default_rng(arguments.seed), {}, {}
    for name, quality in FILTERED.items():
        if name in arguments.networks:
            examples = [make_noisy(read_candidates(path), quality, rng) for path in paths]
            network, errors[name] = train_aside(examples, arguments.steps, arguments.seed)
            networks[name] = network.export()
            print(name, errors[name]["kept aside"], flush=True)
    if "peer" in arguments.networks:
        first = networks.get("refined") or load_networks()["refined"]
        # Of drawn textures Open Image Denoise loses more than of rendered ones: they would teach to distrust it. Of
        # frames without guides its image is taken as it is.
        rendered = [path for path in paths if not path.stem.endswith((DRAWN, COLOR))]
        examples = [make_peer(read_candidates(path), first, rng) for path in rendered]
        network, errors["peer"] = train_aside(examples, arguments.steps, arguments.seed)
        networks["peer"] = network.export()
        print("peer", errors["peer"]["kept aside"], flush=True)
    return networks, errors


def pack_network(network: Perceptron, kind: str) -> dict[str, Array]:
    """Return a network as arrays by name."""
    arrays = {f"{kind}_mean": network.mean, f"{kind}_scale": network.scale}
    arrays |= {f"{kind}_weights_{number}": each for number, each in enumerate(network.weights)}
    arrays |= {f"{kind}_biases_{number}": each for number, each in enumerate(network.biases)}
    return arrays


def replace_networks(path: Path, networks: dict[str, Perceptron]) -> dict[str, Array]:
    """Write networks into a file that keeps its others, and return all arrays of it."""
    arrays: dict[str, Array] = dict(np.load(path, allow_pickle=False)) if path.exists() else {}
    for kind, each in networks.items():
        arrays |= pack_network(each, kind)
    temporary = path.with_suffix(".tmp.npz")
    np.savez(temporary, **arrays)  # type: ignore[arg-type]
    temporary.replace(path)
    return arrays


def main(words: list[str] | None = None) -> None:
    """Train the networks, one after the other, and write them with their errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder that candidates.py filled")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--networks", nargs="+", choices=NAMES, default=NAMES, help="those to train")
    default = ROOT / "src" / "lobewise" / "denoising" / SHARE_WEIGHTS
    parser.add_argument("-o", "--output", type=Path, default=default)
    parser.add_argument("--results", type=Path, default=RESULTS / "shares.json")
    arguments = parser.parse_args(words)
    import torch

    torch.set_num_threads(1)
    paths = sorted(arguments.cache.glob("*.npz"))
    networks, errors = train_all(paths, arguments)
    replace_networks(arguments.output, networks)
    seeds = {int(path.stem.split("-")[0]) for path in paths if not path.stem.endswith(DRAWN)}
    before = json.loads(arguments.results.read_text()) if arguments.results.exists() else {}
    frames = {
        "scenes": len(seeds),
        "scenes_kept_aside": sum(map(is_validation, seeds)),
        "drawn_frames": sum(path.stem.endswith(DRAWN) for path in paths),
        "steps": arguments.steps,
        "machine": describe_machine(),
    }
    what = (
        "squared relative error of the mixture over that of the image which others enter, and over that of the noisy "
        "image: geometric means, and the largest of any image; without the references' noise"
    )
    write_json(
        arguments.results, {**before, "what": what, **{name: {**frames, **found} for name, found in errors.items()}}
    )


if __name__ == "__main__":
    main()
