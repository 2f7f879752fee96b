"""Train the refining network on the frames in a folder, for some minutes, and go on where the last run stopped.

    python -m benchmarks.training.refinement --minutes 150 --frames FOLDER --checkpoint FILE --export

Frames are those of `refinement_frames.py`, also while that program runs. A fifth of the scenes is kept aside: the error
on them, over that of Open Image Denoise with the same guides, is printed and added to a curve. Every run begins with a
high learning rate and ends with a low one. What is judged and exported are weights averaged over the last steps.
``--device cuda`` trains on a GPU, many times as many crops a second; the frames must fit in its memory.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.common import RESULTS, write_json
from benchmarks.training.frames import is_validation
from benchmarks.training.refinement_batches import CROP, draw_batch, make_whole, read_frame
from benchmarks.training.refinement_frames import DRAWN, parse_file_name
from benchmarks.training.refinement_model import RefiningNetwork
from benchmarks.training.refinement_resident import ResidentTrainer, load_frames
from lobewise.errors import InputError
from lobewise.metrics import rel_mse

CURVE = RESULTS / "refinement_curve.json"
BATCH = 4
"""Crops of a step, unless ``--batch`` tells another number."""
RATE, LAST_RATE_SHARE, WARM_STEPS = 1e-3, 0.02, 200
"""Learning rate at its highest, what is left of it at the end of a run, and steps until it is reached."""
MOMENTS = 0.9, 0.99
MAX_GRADIENT = 1.0
MAX_AVERAGING = 0.998
"""Share of the averaged weights that a step keeps."""
BORDER = 4
"""Pixels at the edges of a crop that do not count: they lack neighbours that whole frames have."""
BLOCK_SIDES_PIXELS = 8, 32
"""Sides of the blocks whose mean light is compared. A network that is judged by pixels alone gets too dark, because
the median of a pixel's light, given its noisy neighbourhood, is below the mean."""
BLOCKS_WEIGHT = 0.5
"""Weight of the error of blocks of one size, beside the error of pixels."""
TYPICAL_LOSS, MIN_LOSS_BEFORE = 0.15, 0.05
"""Loss of a crop to which all crops are scaled, and what is added to a crop's loss before it is refined."""
SQUARED_WEIGHT = 3.0
"""Weight of the squared error of pixels, beside their error: results are judged by the squared one."""
EXCESS_WEIGHT, MIN_LOSS_NOISY = 0.05, 0.01
"""Weight of the loss by which a crop is worse than its input, over the input's loss, and what is added to this loss."""
CHECKPOINT_MINUTES, VALIDATION_MINUTES = 5.0, 20.0
STEPS_BETWEEN_REPORTS = 200
MAX_JUDGED = 24
"""Frames of each set of guides that are judged."""
SHARES = {
    "all": 0.13, "unsplit": 0.03, "passes": 0.08, "plain": 0.1, "color": 0.06, DRAWN: 0.05,
    "cycles_all": 0.26, "cycles_passes": 0.04, "cycles_plain": 0.16, "cycles_color": 0.09,
}  # fmt: skip
"""How often each set of guides is trained."""

Errors = dict[str, dict[str, float]]


@dataclass
class State:
    """All that goes on from one run to the next."""

    network: RefiningNetwork
    average: RefiningNetwork
    optimiser: torch.optim.Adam
    steps: int = 0
    minutes: float = 0.0


def compute_loss(found: Tensor, noisy: Tensor, before: Tensor, reference: Tensor) -> Tensor:
    """Return how far refined crops are from their references, over how far they were before: noisy, or filtered.

    So a crop of many samples, whose errors are small, counts as much as one of few samples. What is worse than its
    input counts more.
    """
    with torch.no_grad():
        of_noisy = compute_crop_losses(noisy, reference)
        level = torch.minimum(of_noisy, compute_crop_losses(before, reference))
    losses = compute_crop_losses(found, reference)
    excess = (losses - of_noisy).clamp_min(0.0) / (MIN_LOSS_NOISY + of_noisy)
    return (losses * (TYPICAL_LOSS / (MIN_LOSS_BEFORE + level)) + EXCESS_WEIGHT * excess).mean()


def compute_crop_losses(found: Tensor, reference: Tensor) -> Tensor:
    """Return how far each crop is from its reference: relative, squared relative, of the slopes, and of blocks."""
    inner = (..., slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    found, reference = found[inner], reference[inner]
    # A dark result may not make its own error large: what errors are relative to has no gradient.
    level = found.detach().abs()
    relative = (found - reference).abs() / (level + reference + 0.04)
    squared = (found - reference).square() / (0.15 * level.square() + 0.85 * reference.square() + 0.02)
    ratio = torch.log(found.clamp_min(0.0) + 0.1) - torch.log(reference + 0.1)
    slopes = ratio.diff(dim=-1).abs().mean((1, 2, 3)) + ratio.diff(dim=-2).abs().mean((1, 2, 3))
    total: Tensor = (relative + SQUARED_WEIGHT * squared).mean((1, 2, 3)) + 0.25 * slopes
    for side in BLOCK_SIDES_PIXELS:
        total = total + BLOCKS_WEIGHT * compute_block_losses(found, reference, side)
    return total


def compute_block_losses(found: Tensor, reference: Tensor, side: int) -> Tensor:
    """Return how far the mean light of blocks is from the reference's, relative, for each crop."""
    side = min(side, *reference.shape[-2:])
    average = torch.nn.functional.avg_pool2d(reference, side)
    apart = torch.nn.functional.avg_pool2d(found - reference, side)
    total: Tensor = (apart.abs() / (average + 0.02)).mean((1, 2, 3))
    return total


def compute_rate(share: float, steps: int, highest: float = RATE) -> float:
    """Return the learning rate after a share of a run, and some steps of it."""
    fall = 0.5 * (1.0 + math.cos(math.pi * share))
    return highest * min(1.0, (steps + 1) / WARM_STEPS) * (LAST_RATE_SHARE + (1.0 - LAST_RATE_SHARE) * fall)


def compute_averaging(steps: int) -> float:
    """Return the share of the averaged weights that a step keeps, after some steps."""
    return min(MAX_AVERAGING, (1 + steps) / (10 + steps))


def make_state(seed: int, *, compares: bool = True, device: str = "cpu") -> State:
    """Return an untrained network."""
    torch.manual_seed(seed)
    network = RefiningNetwork(compares=compares).to(device)
    return State(network, copy.deepcopy(network).eval(), torch.optim.Adam(network.parameters(), RATE, betas=MOMENTS))


def save_checkpoint(path: Path, state: State) -> None:
    """Write everything that the next run goes on with, through a temporary file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    told = {name: getattr(state, name).state_dict() for name in ("network", "average", "optimiser")}
    torch.save(told | {"steps": state.steps, "minutes": state.minutes}, temporary)
    temporary.replace(path)


def load_checkpoint(path: Path, state: State) -> None:
    """Go on with what a run before wrote, on any device."""
    told: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
    for name in ("network", "average", "optimiser"):
        getattr(state, name).load_state_dict(told[name])
    for group in state.optimiser.param_groups:
        # A trainer on a GPU keeps its rate there.
        group.update(lr=RATE, capturable=False)
    state.steps, state.minutes = told["steps"], told["minutes"]


def load_weights(path: Path, state: State) -> None:
    """Begin with exported weights."""
    with np.load(path) as arrays:
        told = {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in arrays.files}
    state.network.load_state_dict(told)
    state.average.load_state_dict(told)


def export_weights(path: Path, state: State, start: Path | None = None, share: float = 1.0) -> None:
    """Write the averaged weights as half floats; of those that the run began with, 1 minus the share."""
    arrays = {name: each.cpu().numpy() for name, each in state.average.state_dict().items()}
    if start is not None and share < 1.0:
        with np.load(start) as old:
            arrays = {
                name: share * each + (1.0 - share) * old[name].astype(np.float32) for name, each in arrays.items()
            }
    arrays = {name: each.astype(np.float16) for name, each in arrays.items()}
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    temporary.replace(path)


def list_frames(folder: Path) -> tuple[dict[str, list[Path]], dict[str, list[Path]]]:
    """Return the files to train on and those that are kept aside, by their set of guides.

    Raises
    ------
    InputError
        If there is nothing to train on.
    """
    shown: dict[str, list[Path]] = defaultdict(list)
    aside: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.glob("*.npz")):
        told = parse_file_name(path)
        if told is not None:
            kept_aside = told[2] != DRAWN and is_validation(told[0])
            (aside if kept_aside else shown)[told[2]].append(path)
    if not shown:
        action = "make some with python -m benchmarks.training.refinement_frames"
        raise InputError("frames", expected="a folder with frames to train on", got=f"none in {folder}", action=action)
    return shown, aside


def take_step(state: State, shown: dict[str, list[Path]], rate: float, *, seed: int, batch: int, side: int) -> float:
    """Train on some crops; return their loss, NaN where the step was left out."""
    # Every step has random numbers of its own, so that a run that goes on draws what it would have drawn.
    rng = np.random.default_rng([seed, state.steps])
    names = [name for name in SHARES if shown.get(name)]
    shares = np.array([SHARES[name] for name in names])
    drawn = rng.choice(len(names), batch, p=shares / shares.sum())
    crops = draw_batch([shown[names[k]][rng.integers(len(shown[names[k]]))] for k in drawn], rng, side)
    for group in state.optimiser.param_groups:
        group["lr"] = rate
    images = crops.images
    loss = compute_loss(state.network(crops), images["noisy"], images["filtered"], images["reference"])
    state.optimiser.zero_grad()
    state.steps += 1
    loss.backward()
    size = torch.nn.utils.clip_grad_norm_(state.network.parameters(), MAX_GRADIENT)
    if not torch.isfinite(loss) or not torch.isfinite(size):
        print(f"step {state.steps}: the loss is not finite; the step is left out", flush=True)
        return math.nan
    state.optimiser.step()
    kept = compute_averaging(state.steps)
    with torch.no_grad():
        for mean, each in zip(state.average.parameters(), state.network.parameters(), strict=True):
            mean.lerp_(each, 1.0 - kept)
    return float(loss.detach())


def measure_errors(network: RefiningNetwork, aside: dict[str, list[Path]]) -> Errors:
    """Return errors over the peer's by set of guides and samples, "before" for what the network starts from.

    They are geometric means over frames. "mean" is over all samples.
    """
    logs: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for guides, paths in sorted(aside.items()):
        count = min(len(paths), MAX_JUDGED)
        for path in (paths[k * len(paths) // count] for k in range(count)):
            stored = read_frame.__wrapped__(path)
            batch = make_whole(stored)
            with torch.no_grad():
                found = network(batch)[0]
            rows, columns = found.shape[1:]
            reference = batch.images["reference"][0]
            peer = torch.from_numpy(stored.images["peer"][:, :rows, :columns].astype(np.float32))
            before = batch.images["filtered"][0]
            own, base, other = (_measure(image, reference) for image in (found, before, peer))
            for key, value in ((f"{stored.spp}", own / other), ("mean", own / other), ("before", base / other)):
                logs[guides][key].append(math.log(max(value, 1e-9)))
    return {
        guides: {key: round(math.exp(float(np.mean(values))), 4) for key, values in sorted(found.items())}
        for guides, found in logs.items()
    }


def _measure(image: Tensor, reference: Tensor) -> float:
    return rel_mse(*(np.moveaxis(each.numpy(), 0, -1) for each in (image, reference)))


def judge(state: State, aside: dict[str, list[Path]], shown: dict[str, list[Path]], curve: Path) -> None:
    """Print the errors of the averaged weights on frames kept aside, and add them to the curve."""
    errors = measure_errors(copy.deepcopy(state.average).cpu(), aside)
    print(f"after {state.minutes:.1f} minutes, {state.steps} steps", flush=True)
    for guides, found in errors.items():
        print(f"  {guides:8}" + "".join(f" {key} {value:.2f}" for key, value in found.items()), flush=True)
    points = json.loads(curve.read_text())["points"] if curve.exists() else []
    point = {
        "minutes": round(state.minutes, 2),
        "steps": state.steps,
        "frames": sum(map(len, shown.values())),
        "frames_aside": sum(map(len, aside.values())),
        "errors": errors,
    }
    metric = "rel_mse over that of Open Image Denoise with the same guides"
    write_json(curve, {"metric": metric, "points": [*points, point]})


def make_step(state: State, shown: dict[str, list[Path]], arguments: argparse.Namespace) -> Callable[[float], float]:
    """Return the function that takes a step at a learning rate and returns the loss."""
    if arguments.device == "cpu":
        return lambda rate: take_step(
            state,
            shown,
            rate,
            seed=arguments.seed,
            batch=arguments.batch,
            side=arguments.crop,
        )
    shares, device = {name: SHARES[name] for name in shown}, torch.device(arguments.device)
    frames = load_frames(shown, shares, device)
    trainer = ResidentTrainer(state, frames, arguments.batch, arguments.crop)
    return lambda rate: float(trainer.take_step(rate, compute_averaging(state.steps + 1)))


def run(state: State, arguments: argparse.Namespace) -> None:
    """Train until the run's minutes or steps are over; what ends it early loses no step."""
    shown, aside = list_frames(arguments.frames)
    print(f"{sum(map(len, shown.values()))} files to train on, {sum(map(len, aside.values()))} kept aside", flush=True)
    spent = saved = judged = 0.0
    losses: list[float] = []
    step = make_step(state, shown, arguments)
    try:
        while (
            share := len(losses) / arguments.steps if arguments.steps else spent / max(arguments.minutes, 1e-9)
        ) < 1.0:
            began = time.perf_counter()
            losses.append(step(compute_rate(share, len(losses), arguments.rate)))
            passed = (time.perf_counter() - began) / 60.0
            spent, state.minutes = spent + passed, state.minutes + passed
            if len(losses) % STEPS_BETWEEN_REPORTS == 0:
                mean = np.nanmean(losses[-STEPS_BETWEEN_REPORTS:])
                print(f"step {state.steps}, {spent:.1f} min: {mean:.4f}", flush=True)
                if arguments.device == "cpu":
                    shown, aside = list_frames(arguments.frames)
                    step = make_step(state, shown, arguments)
            if spent - saved >= CHECKPOINT_MINUTES:
                saved = spent
                save_checkpoint(arguments.checkpoint, state)
            if spent - judged >= VALIDATION_MINUTES:
                judged = spent
                judge(state, aside, shown, arguments.curve)
    finally:
        if losses:
            save_checkpoint(arguments.checkpoint, state)
    if losses:
        judge(state, aside, shown, arguments.curve)


def parse_arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, required=True, help="folder that refinement_frames.py fills")
    parser.add_argument("--checkpoint", type=Path, required=True, help="file to go on with, and to write")
    parser.add_argument("--minutes", type=float, default=150.0, help="of training, in this run")
    parser.add_argument("--steps", type=int, help="in this run, in place of minutes")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--batch", type=int, default=BATCH, help="crops of a step")
    parser.add_argument("--crop", type=int, default=CROP, help="rows and columns of a crop, a multiple of 16")
    parser.add_argument("--rate", type=float, default=RATE, help="learning rate at its highest")
    parser.add_argument("--device", default="cpu", help="of PyTorch: cpu, or cuda with all frames in its memory")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=Path, help="exported weights to begin with, where there is no checkpoint")
    parser.add_argument("--no-guides", action="store_true", help="weights are learned alone")
    parser.add_argument("--curve", type=Path, default=CURVE, help="JSON that errors are added to")
    parser.add_argument("--mix", type=float, default=1.0, help="share of the new weights, beside those of --start")
    parser.add_argument("--export", type=Path, help="write the weights as half floats")
    arguments = parser.parse_args(words)
    if arguments.mix < 1.0 and arguments.start is None:
        parser.error("--mix needs the old weights: name them by --start")
    return arguments


def main(words: Sequence[str] | None = None) -> None:
    """Train, judge, write."""
    arguments = parse_arguments(words)
    torch.set_num_threads(arguments.threads)
    state = make_state(arguments.seed, compares=not arguments.no_guides, device=arguments.device)
    if arguments.checkpoint.exists():
        load_checkpoint(arguments.checkpoint, state)
        print(f"going on after {state.minutes:.1f} minutes, {state.steps} steps", flush=True)
    elif arguments.start is not None:
        load_weights(arguments.start, state)
    run(state, arguments)
    if arguments.export is not None:
        export_weights(arguments.export, state, arguments.start, arguments.mix)
        print(f"wrote {arguments.export}", flush=True)


if __name__ == "__main__":
    # Whoever ends the program by SIGTERM keeps the checkpoint, as with Ctrl-C.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    main()
