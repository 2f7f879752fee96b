"""The network that mixes with Open Image Denoise, trained on small images, takes what is nearer to the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.training import peer_share
from lobewise.denoising.combining import find_our_share
from lobewise.denoising.high import unpack_network
from lobewise.filters.noise.agreement import find_agreement

SIZE = 40


def write_example(path: Path, rng: np.random.Generator, ours: float, peer: float) -> None:
    """Write a frame of which both images are so far from the truth."""
    truth = np.float32(0.5) + rng.random((SIZE, SIZE, 3), np.float32)
    halves = [truth * rng.gamma(4.0, 0.25, truth.shape).astype(np.float32) for _ in range(2)]
    images = {
        "noisy": 0.5 * (halves[0] + halves[1]),
        "half_a": halves[0],
        "half_b": halves[1],
        "ours": truth * (1.0 + ours * rng.normal(size=truth.shape)),
        "peer": truth * (1.0 + peer * rng.normal(size=truth.shape)),
        "reference": truth,
    }
    np.savez(path, shared=np.array(False), **{name: each.astype(np.float16) for name, each in images.items()})


@pytest.mark.usefixtures("torch")
def test_it_takes_what_is_nearer(tmp_path: Path, rng: np.random.Generator) -> None:
    for seed in range(1, 6):
        write_example(tmp_path / f"{seed:05d}-0004-all.npz", rng, ours=0.02, peer=0.2)
    output, results = tmp_path / "out" / "weights.npz", tmp_path / "results.json"
    output.parent.mkdir()
    np.savez(output, other=np.ones(3, np.float32))
    words = ["--frames", str(tmp_path), "--cache", str(tmp_path), "--steps", "60", "-o", str(output)]
    peer_share.main([*words, "--results", str(results)])
    told = json.loads(results.read_text())
    assert (told["scenes"], told["scenes_kept_aside"]) == (5, 1)
    assert told["ratios"]["kept aside"]["all"]["mean"] < 0.3
    with np.load(output) as arrays:
        network = unpack_network(arrays, "peer")
        # What else the file holds stays.
        np.testing.assert_array_equal(arrays["other"], 1.0)
    with np.load(tmp_path / "00005-0004-all.npz") as arrays:
        images = {name: arrays[name].astype(np.float32) for name in arrays.files if name != "shared"}
    seen = find_agreement(
        images["peer"],
        images["ours"],
        images["noisy"],
        halves=(images["half_a"], images["half_b"]),
        level=float(images["peer"].mean()),
    )
    assert find_our_share(seen, network).mean() > 0.7


def test_guides_are_taken_away_by_the_seed() -> None:
    from tests.streaming.frames import make_scene

    frame = make_scene((8, 9))
    found = [dict(peer_share.vary_guides(frame, np.random.default_rng(seed))) for seed in range(6)]
    assert {tuple(each) for each in found} == {("all", "plain", "passes"), ("all", "plain", "shared")}
    for each in found:
        assert each["all"] is frame
        assert each["plain"].gbuffer.alpha_u is None
        assert each["plain"].radiance.parts is None
        assert all(one.half_a is None for name, one in each.items() if name != "all")
        assert ("shared" in each) == any(one.noise_is_shared for one in each.values())
