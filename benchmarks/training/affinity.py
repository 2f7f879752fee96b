"""Train the affinity network on the frames in a folder, for some minutes, and go on where the last run stopped.

Frames are those that `make_frames.py` writes, also while this program runs. A fifth of the scenes is kept aside: the
error on them, over that of Open Image Denoise with the same guides, is printed and added to a curve. Every run begins
with a high learning rate and ends with a low one. What is judged and exported are weights averaged over the last steps.

    python -m benchmarks.training.affinity --minutes 150 --frames FOLDER --checkpoint FILE
    python -m benchmarks.training.affinity --minutes 0 --frames FOLDER --checkpoint FILE --export
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import os
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.common import RESULTS, ROOT, write_json
from benchmarks.training.affinity_batches import draw_batch
from benchmarks.training.affinity_model import REST_STEPS, STEPS, AffinityNetwork, GuideSet
from benchmarks.training.affinity_validation import Errors, describe_errors, measure_errors
from benchmarks.training.frames import is_validation, list_frames, parse_file_name
from lobewise.errors import InputError

EXPORTED = ROOT / "benchmarks" / "training" / "affinity.npz"
CURVE = RESULTS / "affinity_curve.json"
MAX_EXPORTED_BYTES = 2_000_000

BATCH = 4
RATE, LAST_RATE_SHARE, WARM_STEPS = 1.5e-3, 0.02, 100
"""Learning rate at its highest, what is left of it at the end of a run, and steps until it is reached."""
MOMENTS = 0.9, 0.99
MAX_GRADIENT = 1.0
MAX_AVERAGING = 0.998
"""Share of the averaged weights that a step keeps."""
BORDER = 4
"""Pixels at the edges of a crop that do not count: they lack neighbours that whole frames have."""
CHECKPOINT_MINUTES, VALIDATION_MINUTES = 5.0, 15.0
STEPS_BETWEEN_REPORTS = 100
"""After so many steps losses are printed, and the folder is looked at for new frames."""
SHARES = {
    GuideSet.ALL: 0.4,
    GuideSet.UNSPLIT: 0.1,
    GuideSet.PASSES: 0.15,
    GuideSet.PLAIN: 0.25,
    GuideSet.COLOR: 0.1,
}
"""How often each set of guides is trained."""


@dataclass
class State:
    """All that goes on from one run to the next."""

    network: AffinityNetwork
    average: AffinityNetwork
    optimiser: torch.optim.Adam
    steps: int = 0
    minutes: float = 0.0
    """Of training, in all runs."""


@dataclass
class Progress:
    """How far a run is."""

    minutes: float
    steps: int | None
    done: int = 0
    spent: float = 0.0
    """Minutes, of steps alone: neither reading nor judging counts."""
    losses: dict[str, list[float]] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """How much of the run is done, in [0, 1]."""
        if self.steps is not None:
            return min(1.0, self.done / max(self.steps, 1))
        return min(1.0, self.spent / self.minutes) if self.minutes > 0.0 else 1.0

    def add(self, guides: str, loss: float, minutes: float) -> None:
        """Count a step."""
        self.done, self.spent = self.done + 1, self.spent + minutes
        self.losses.setdefault(guides, []).append(loss)

    def report(self) -> str:
        """Return the mean losses since the last report, and forget them."""
        told = ", ".join(f"{name} {np.mean(values):.4f}" for name, values in sorted(self.losses.items()))
        self.losses.clear()
        return told


def find_loss(found: Tensor, reference: Tensor) -> Tensor:
    """Return how far filtered crops are from their references: relative, squared relative, and of the slopes."""
    inner = (..., slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    found, reference = found[inner], reference[inner]
    # A dark result may not make its own error large: what errors are relative to has no gradient.
    level = found.detach().abs()
    relative = ((found - reference).abs() / (level + reference + 0.04)).mean()
    squared = ((found - reference).square() / (0.15 * level.square() + 0.85 * reference.square() + 0.02)).mean()
    ratio = torch.log(found.clamp_min(0.0) + 0.1) - torch.log(reference + 0.1)
    slopes = ratio.diff(dim=-1).abs().mean() + ratio.diff(dim=-2).abs().mean()
    total: Tensor = relative + squared + 0.25 * slopes
    return total


def find_rate(share: float, steps: int) -> float:
    """Return the learning rate after a share of a run, and some steps of it."""
    fall = 0.5 * (1.0 + math.cos(math.pi * share))
    return RATE * min(1.0, (steps + 1) / WARM_STEPS) * (LAST_RATE_SHARE + (1.0 - LAST_RATE_SHARE) * fall)


def make_state(seed: int, device: str, *, lobes: bool, halves: bool) -> State:
    """Return an untrained network."""
    torch.manual_seed(seed)
    network = AffinityNetwork(lobes=lobes, halves=halves).to(device)
    return State(network, copy.deepcopy(network), torch.optim.Adam(network.parameters(), RATE, betas=MOMENTS))


def save_checkpoint(path: Path, state: State) -> None:
    """Write everything that the next run goes on with, through a temporary file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    told = {
        "network": state.network.state_dict(),
        "average": state.average.state_dict(),
        "optimiser": state.optimiser.state_dict(),
        "steps": state.steps,
        "minutes": state.minutes,
        "lobes": state.network.lobes,
        "halves": state.network.halves,
    }
    torch.save(told, temporary)
    temporary.replace(path)


def load_checkpoint(path: Path, state: State, device: str) -> None:
    """Go on with what a run before wrote.

    Raises
    ------
    InputError
        If the checkpoint is of a network with other options.
    """
    told: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
    options = {"lobes": state.network.lobes, "halves": state.network.halves}
    before = {name: told[name] for name in options}
    if before != options:
        raise InputError("checkpoint", expected=f"{options}", got=f"{before}", action="name another --checkpoint")
    state.network.load_state_dict(told["network"])
    state.average.load_state_dict(told["average"])
    state.optimiser.load_state_dict(told["optimiser"])
    state.steps, state.minutes = told["steps"], told["minutes"]


def export_weights(path: Path, state: State) -> None:
    """Write the averaged weights as half floats, with what the network is made of."""
    arrays = {name: each.cpu().numpy().astype(np.float16) for name, each in state.average.state_dict().items()}
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise InputError("weights", expected="numbers within half floats", got="larger ones", action="train anew")
    told = {"lobes": state.average.lobes, "halves": state.average.halves, "steps": STEPS, "rest_steps": REST_STEPS}
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("wb") as stream:
        np.savez_compressed(stream, options=np.array(json.dumps(told)), **arrays)
    size = temporary.stat().st_size
    if size > MAX_EXPORTED_BYTES:
        temporary.unlink()
        raise InputError(
            "weights", expected=f"at most {MAX_EXPORTED_BYTES} bytes", got=f"{size}", action="use less units"
        )
    temporary.replace(path)


def take_step(state: State, paths: list[Path], seed: int, rate: float, device: str) -> tuple[GuideSet, float]:
    """Train on one batch; return its set of guides and its loss, which is NaN where the step was left out."""
    # Every step has random numbers of its own, so that a run that goes on draws what it would have drawn.
    rng = np.random.default_rng([seed, state.steps])
    guides = list(SHARES)[rng.choice(len(SHARES), p=list(SHARES.values()))]
    batch = draw_batch(paths, BATCH, rng).move(device)
    for group in state.optimiser.param_groups:
        group["lr"] = rate
    loss = find_loss(state.network(batch, guides), batch.images["reference"])
    state.optimiser.zero_grad()
    state.steps += 1
    loss.backward()
    size = torch.nn.utils.clip_grad_norm_(state.network.parameters(), MAX_GRADIENT)
    if not torch.isfinite(loss) or not torch.isfinite(size):
        print(f"step {state.steps}: the loss is not finite; the step is left out", flush=True)
        return guides, math.nan
    state.optimiser.step()
    kept = min(MAX_AVERAGING, (1 + state.steps) / (10 + state.steps))
    with torch.no_grad():
        for mean, each in zip(state.average.parameters(), state.network.parameters(), strict=True):
            mean.lerp_(each, 1.0 - kept)
    return guides, float(loss.detach())


def find_frames(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the files to train on and those that are kept aside.

    Raises
    ------
    InputError
        If there is nothing to train on.
    """
    seeds = {path: found[0] for path in list_frames(folder) if (found := parse_file_name(path))}
    shown = [path for path, seed in seeds.items() if not is_validation(seed)]
    aside = [path for path, seed in seeds.items() if is_validation(seed)]
    if not shown:
        action = "make some with python -m benchmarks.training.make_frames"
        raise InputError("frames", expected="a folder with frames to train on", got=f"none in {folder}", action=action)
    return shown, aside


def judge(state: State, paths: list[Path], shown: list[Path], curve: Path, device: str) -> Errors:
    """Print the errors of the averaged weights on frames kept aside, and add them to the curve."""
    errors = measure_errors(state.average, paths, device)
    print(f"after {state.minutes:.1f} minutes, {state.steps} steps:", describe_errors(errors), sep="\n", flush=True)
    rows = json.loads(curve.read_text())["points"] if curve.exists() else []
    scenes = {parse_file_name(path) for path in shown}
    point = {
        "minutes": round(state.minutes, 2),
        "steps": state.steps,
        "frames": len(shown),
        "scenes": len({found[0] for found in scenes if found}),
        "frames_aside": len(paths),
        "errors": {name: {str(spp): value for spp, value in row.items()} for name, row in errors.items()},
    }
    write_json(
        curve, {"metric": "rel_mse over that of Open Image Denoise with the same guides", "points": [*rows, point]}
    )
    return errors


def run(state: State, arguments: argparse.Namespace, device: str) -> list[float]:
    """Train until the run's minutes or steps are over, and return all losses; what ends it early loses no step."""
    shown, aside = find_frames(arguments.frames)
    print(f"{len(shown)} frames to train on, {len(aside)} kept aside; on {device}", flush=True)
    progress, losses = Progress(arguments.minutes, arguments.steps), []
    saved = judged = 0.0
    try:
        while progress.share < 1.0:
            began = time.perf_counter()
            rate = find_rate(progress.share, progress.done)
            guides, loss = take_step(state, shown, arguments.seed, rate, device)
            spent = (time.perf_counter() - began) / 60.0
            progress.add(guides.value, loss, spent)
            state.minutes += spent
            losses.append(loss)
            if progress.done % STEPS_BETWEEN_REPORTS == 0:
                print(f"step {state.steps}, {progress.spent:.1f} min, rate {rate:.1e}: {progress.report()}", flush=True)
                shown, aside = find_frames(arguments.frames)
            if progress.spent - saved >= CHECKPOINT_MINUTES:
                saved = progress.spent
                save_checkpoint(arguments.checkpoint, state)
            if progress.spent - judged >= VALIDATION_MINUTES:
                judged = progress.spent
                judge(state, aside, shown, arguments.curve, device)
    finally:
        if losses:
            save_checkpoint(arguments.checkpoint, state)
    if losses:
        judge(state, aside, shown, arguments.curve, device)
    return losses


def parse_arguments(words: list[str] | None = None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, required=True, help="folder that make_frames.py fills")
    parser.add_argument("--checkpoint", type=Path, required=True, help="file to go on with, and to write")
    parser.add_argument("--minutes", type=float, default=150.0, help="of training, in this run")
    parser.add_argument("--steps", type=int, help="in this run, in place of minutes")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-lobes", action="store_true", help="weights compare features alone")
    parser.add_argument("--no-halves", action="store_true", help="halves of the samples are not looked at")
    parser.add_argument("--curve", type=Path, default=CURVE, help="JSON that errors are added to")
    parser.add_argument("--export", type=Path, nargs="?", const=EXPORTED, help="write the weights as half floats")
    return parser.parse_args(words)


def main(words: list[str] | None = None) -> list[float]:
    """Train, judge, write; return the losses of all steps."""
    arguments = parse_arguments(words)
    torch.set_num_threads(arguments.threads)
    # Halide reads it when its first kernel runs.
    os.environ["HL_NUM_THREADS"] = str(arguments.threads)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    state = make_state(arguments.seed, device, lobes=not arguments.no_lobes, halves=not arguments.no_halves)
    if arguments.checkpoint.exists():
        load_checkpoint(arguments.checkpoint, state, device)
        print(f"going on after {state.minutes:.1f} minutes, {state.steps} steps", flush=True)
    losses = run(state, arguments, device)
    if arguments.export is not None:
        export_weights(arguments.export, state)
        print(f"wrote {arguments.export}", flush=True)
    return losses


if __name__ == "__main__":
    # Whoever ends the program by SIGTERM keeps the checkpoint, as with Ctrl-C.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    main()
