"""Train the networks that mix images pixel by pixel, on what `candidates.py` and `textures.py` collected.

    python -m benchmarks.training.candidates --cache FOLDER
    python -m benchmarks.training.textures --cache FOLDER
    python -m benchmarks.training.shares --cache FOLDER

"noisy" tells how much of the noisy image a result of `balanced` or `high` takes back. "peer" tells how much of our
image, which took back what the first network says, and of the noisy one enter that of Open Image Denoise. A fifth of
the scenes is kept aside and tells the errors. Drawn textures train the first alone. The weights go into the package's
file. Needs ``lobewise[train]``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.training.candidates import COLOR, DRAWN, FEW_SPP, Candidates, read_candidates
from benchmarks.training.frames import is_validation
from benchmarks.training.share_network import Examples, ShareNetwork, make_examples, measure, train
from lobewise.denoising.combining import find_level, see_mixture
from lobewise.denoising.evidence import find_share_taken_back
from lobewise.denoising.networks import WEIGHTS, pack_network
from lobewise.filters.mixing import Network
from lobewise.filters.noise.detail import find_detail

STEPS = 9000
MAX_LEVEL = 4.0
"""The level that differences are relative to is drawn up to so many times the mean luminance: where light is divided by
albedo it is larger."""
FILTERED = ("balanced", "high")

Array = NDArray[np.float32]


def describe_group(found: Candidates) -> tuple[str, str]:
    """Return what errors are told apart by: whether all guides and halves are there or none, and samples per pixel."""
    if found.kind == DRAWN:
        return DRAWN, "0 spp"
    few = found.spp in FEW_SPP
    guides = found.kind if found.kind in ("all", COLOR) else "less"
    return guides, f"{FEW_SPP[0]} to {FEW_SPP[-1]} spp" if few else f"{found.spp} spp"


def list_noisy(found: Candidates, rng: np.random.Generator) -> list[Examples]:
    """Return examples for the network "noisy": each result, and the noisy image."""
    examples = []
    for name in FILTERED:
        image = getattr(found, name)
        level = find_level(image) * MAX_LEVEL ** rng.random()
        rows = find_detail(image, found.noisy, halves=found.halves, level=level, shared=found.kind == "shared")
        seen = np.concatenate([features for _, features in rows])
        references = found.reference_a, found.reference_b
        images = image, found.noisy
        group = name, *describe_group(found)
        examples.append(make_examples(found.seed, group, seen, images, references, found.clean, rng))
    return examples


def list_peer(found: Candidates, network: Network, rng: np.random.Generator) -> list[Examples]:
    """Return the example for the network "peer": the image of Open Image Denoise, ours, and the noisy one."""
    shared = found.kind == "shared"
    share = find_share_taken_back(
        found.high, found.noisy, network, halves=found.halves, level=find_level(found.high), shared=shared
    )
    ours = found.high + share[..., None] * (found.noisy - found.high)
    rows = see_mixture(found.noisy, ours, found.peer, halves=found.halves, shared=shared)
    seen = np.concatenate([features for _, features in rows])
    references = found.reference_a, found.reference_b
    images = found.peer, ours, found.noisy
    group = "peer", found.kind, describe_group(found)[1]
    return [make_examples(found.seed, group, seen, images, references, found.clean, rng)]


def train_aside(examples: Sequence[Examples], steps: int, seed: int) -> tuple[ShareNetwork, dict[str, object]]:
    """Return a network that was trained on four fifths of the scenes, and its errors on these and on the others."""
    shown = [each for each in examples if not is_validation(each.seed)]
    aside = [each for each in examples if is_validation(each.seed)]
    network = train(shown, steps, seed)
    tables = {"trained": measure(network, shown), "kept aside": measure(network, aside)}
    return network, tables


def replace_networks(path: Path, networks: dict[str, Network]) -> dict[str, Array]:
    """Write networks into a file that keeps its others, and return all arrays of it."""
    arrays: dict[str, Array] = dict(np.load(path, allow_pickle=False)) if path.exists() else {}
    for kind, each in networks.items():
        arrays |= pack_network(each, kind)
    temporary = path.with_suffix(".tmp.npz")
    np.savez(temporary, **arrays)  # type: ignore[arg-type]
    temporary.replace(path)
    return arrays


def main(words: list[str] | None = None) -> None:
    """Train both networks, one after the other, and write them with their errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder that candidates.py filled")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=0)
    default = ROOT / "src" / "lobewise" / "denoising" / WEIGHTS
    parser.add_argument("-o", "--output", type=Path, default=default)
    parser.add_argument("--results", type=Path, default=RESULTS / "shares.json")
    arguments = parser.parse_args(words)
    import torch

    torch.set_num_threads(1)
    paths, rng = sorted(arguments.cache.glob("*.npz")), np.random.default_rng(arguments.seed)
    examples = [each for path in paths for each in list_noisy(read_candidates(path), rng)]
    noisy, noisy_ratios = train_aside(examples, arguments.steps, arguments.seed)
    print("noisy", noisy_ratios["kept aside"], flush=True)
    first = noisy.export()
    # Of drawn textures Open Image Denoise loses more than of rendered ones: they would teach to distrust it. Of frames
    # without guides its image is taken as it is.
    rendered = [path for path in paths if not path.stem.endswith((DRAWN, COLOR))]
    drawn = sum(path.stem.endswith(DRAWN) for path in paths)
    examples = [each for path in rendered for each in list_peer(read_candidates(path), first, rng)]
    peer, peer_ratios = train_aside(examples, arguments.steps, arguments.seed)
    print("peer", peer_ratios["kept aside"], flush=True)
    replace_networks(arguments.output, {"noisy": first, "peer": peer.export()})
    seeds = {each.seed for each in examples}
    write_json(
        arguments.results,
        {
            "what": "squared relative error of the mixture over that of the image which others enter, and over "
            "that of the noisy image: geometric means, and the largest of any image; without the references' noise",
            "scenes": len(seeds),
            "scenes_kept_aside": sum(map(is_validation, seeds)),
            "drawn_frames": drawn,
            "steps": arguments.steps,
            "noisy": noisy_ratios,
            "peer": peer_ratios,
            "machine": describe_machine(),
        },
    )


if __name__ == "__main__":
    main()
