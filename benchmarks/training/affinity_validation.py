"""How far the affinity network is from Open Image Denoise with the same guides, on frames that it never trains on."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.training.affinity_batches import Frame, join_crops, make_frame
from benchmarks.training.affinity_model import AffinityNetwork, GuideSet
from benchmarks.training.frames import read_frame_file
from lobewise.metrics import rel_mse

MAX_FRAMES = 40
"""Frames that are judged: more would take longer than they tell."""
PEERS = {
    GuideSet.ALL: "peer_all",
    GuideSet.UNSPLIT: "peer_all",
    GuideSet.PASSES: "peer_all",
    GuideSet.PLAIN: "peer_plain",
    GuideSet.COLOR: "peer_plain",
}
"""Which image of a frame each set of guides is compared with."""

Errors = dict[str, dict[int, float]]
"""Geometric mean of the error over the peer's, by set of guides and samples per pixel."""


def choose_frames(paths: Sequence[Path]) -> list[Path]:
    """Return at most `MAX_FRAMES` of the paths, evenly apart."""
    count = min(len(paths), MAX_FRAMES)
    return [paths[k * len(paths) // count] for k in range(count)]


def measure_errors(network: AffinityNetwork, paths: Sequence[Path], device: str) -> Errors:
    """Return the relative squared error of every set of guides over the peer's; empty without frames of a peer."""
    logarithms: dict[tuple[str, int], list[float]] = defaultdict(list)
    for path in choose_frames(paths):
        frame = make_frame(read_frame_file(path))
        for guides in GuideSet:
            ratio = compare_with_peer(network, frame, guides, device)
            if ratio is not None:
                logarithms[guides.value, frame.example.spp].append(np.log(ratio))
    errors: Errors = {}
    for guides in GuideSet:
        found = {spp: logs for (name, spp), logs in sorted(logarithms.items()) if name == guides.value}
        if found:
            errors[guides.value] = {spp: round(float(np.exp(np.mean(logs))), 4) for spp, logs in found.items()}
    return errors


def compare_with_peer(network: AffinityNetwork, frame: Frame, guides: GuideSet, device: str) -> float | None:
    """Return the error of a frame over the peer's with the same guides, or None where the frame lacks the peer's."""
    peer = getattr(frame.example, PEERS[guides])
    if peer is None:
        return None
    rows, columns = frame.size
    crop = frame.cut(0, 0, rows, columns)
    with torch.no_grad():
        found = network(join_crops([crop]).move(device), guides)[0].cpu().numpy()
    reference = np.moveaxis(crop.images["reference"], 0, -1)
    own = rel_mse(np.moveaxis(found, 0, -1), reference)
    return own / max(rel_mse(peer[:rows, :columns].astype(np.float32), reference), 1e-9)


def describe_errors(errors: Errors) -> str:
    """Return a table of errors in lines, a set of guides each."""
    counts = sorted({spp for row in errors.values() for spp in row})
    lines = ["error over the peer".ljust(20) + "".join(f"{spp:>8} spp" for spp in counts)]
    for name, row in errors.items():
        cells = (f"{row[spp]:>12.2f}" if spp in row else " " * 12 for spp in counts)
        lines.append(name.ljust(20) + "".join(cells))
    return "\n".join(lines)
