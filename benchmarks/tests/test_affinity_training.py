"""benchmarks/training/affinity*.py: steps repeat, go on and are exported; what crops keep, what sets of guides hide."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.training.frames import Example, list_images, make_half, write_frame_file
from lobewise.errors import InputError

NAMES = ("affinity", "affinity_batches", "affinity_model", "affinity_validation")

HALF = 2e-3
"""Relative: images are stored as half floats, with 11 binary digits, and some are sums."""

SINGLE = ("depth", "alpha_u", "alpha_v", "hit_inverse", "lobe_sharpness")

SWAPPED = ("diffuse", "specular")

HIDDEN = {
    "all": {"diffuse_albedo", "specular_albedo", "normal"},
    "unsplit": {"diffuse", "specular", "diffuse_albedo", "specular_albedo", "normal"},
    "passes": {
        *("diffuse_albedo", "specular_albedo", "normal", "hit_albedo", "hit_normal", "hit_inverse"),
        *("diffuse_a", "diffuse_b", "specular_a", "specular_b"),
    },
}
PLAIN = {"color", "diffuse_albedo", "specular_albedo", "normal", "depth"}


@pytest.fixture
def program(torch: Any) -> Any:
    """Return the modules of the trainer, by the last part of their names."""
    return SimpleNamespace(**{name: importlib.import_module(f"benchmarks.training.{name}") for name in NAMES})


def make_example(seed: int, spp: int = 4, side: int = 32) -> Example:
    """Return a frame of noise about a smooth reference, its guides random, and a peer that is off by a tenth."""
    rng = np.random.default_rng(seed)
    images: dict[str, Any] = {}
    for name in list_images():
        images[name] = rng.uniform(0.1, 1.0, (side, side) if name in SINGLE else (side, side, 3))
    for name in ("normal", "mean_normal", "hit_normal", "lobe_axis"):
        images[name] = images[name] / np.linalg.norm(images[name], axis=-1, keepdims=True)
    images["lobe_sharpness"] = 8.0 * images["lobe_sharpness"]
    for name in ("diffuse", "specular"):
        means = rng.uniform(0.5, 1.5) * images[f"mean_{name}_albedo"]
        for half in "ab":
            images[f"{name}_{half}"] = means * rng.gamma(1.0, 1.0, (side, side, 1))
        images[name] = 0.5 * (images[f"{name}_a"] + images[f"{name}_b"])
        images[f"{name}_mean"] = means
    emitted = rng.uniform(0.0, 0.2, (side, side, 3))
    images["color"] = images["diffuse"] + images["specular"] + emitted
    images["reference"] = images.pop("diffuse_mean") + images.pop("specular_mean") + emitted
    images["peer_all"] = images["peer_plain"] = 1.1 * images["reference"]
    halves = {name: make_half(image) for name, image in images.items()}
    return Example(seed=seed, spp=spp, reference_spp=128, kind="synthetic", **halves)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Return a folder with frames of two scenes, and of one that is kept aside."""
    folder = tmp_path / "frames"
    for seed in (1, 2, 5):
        write_frame_file(folder, make_example(seed))
    return folder


@pytest.fixture
def train(program: Any, frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[float]]:
    """Return the trainer with the options that every test gives."""
    # The program sets it for good; after the test it is what it was.
    monkeypatch.setenv("HL_NUM_THREADS", "1")

    def call(*more: str, checkpoint: str = "checkpoint.pt", steps: int = 20) -> list[float]:
        words = ["--frames", str(frames), "--checkpoint", str(tmp_path / checkpoint), "--steps", str(steps)]
        return list(program.affinity.main([*words, "--curve", str(tmp_path / "curve.json"), *more]))

    return call


def test_the_same_seed_takes_the_same_steps(train: Callable[..., list[float]]) -> None:
    first, again = train(), train(checkpoint="again.pt")
    assert len(first) == 20
    assert np.isfinite(first).all()
    np.testing.assert_array_equal(first, again)
    other = train("--seed", "2", checkpoint="other.pt", steps=2)
    assert not np.isin(other, first).any()


def test_a_run_goes_on_with_the_checkpoint(
    program: Any, torch: Any, train: Callable[..., list[float]], tmp_path: Path
) -> None:
    train(steps=3)
    state = program.affinity.make_state(7, "cpu", lobes=True, halves=True)
    program.affinity.load_checkpoint(tmp_path / "checkpoint.pt", state, "cpu")
    program.affinity.save_checkpoint(tmp_path / "copy.pt", state)
    first, second = (torch.load(tmp_path / name, weights_only=True) for name in ("checkpoint.pt", "copy.pt"))
    torch.testing.assert_close(first, second, rtol=0.0, atol=0.0)
    assert first["steps"] == 3
    assert first["optimiser"]["state"][0]["step"] == 3
    train(steps=2)
    points = json.loads((tmp_path / "curve.json").read_text())["points"]
    assert [point["steps"] for point in points] == [3, 5]
    # Rounded, two steps may take no time; the checkpoint counts on.
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["minutes"] > first["minutes"] > 0.0
    assert points[0]["frames"] == points[0]["scenes"] == 2
    assert points[0]["frames_aside"] == 1
    assert set(points[0]["errors"]) == {"all", "unsplit", "passes", "plain", "color"}
    with pytest.raises(InputError, match="lobes"):
        train("--no-lobes", steps=1)


def test_a_run_that_is_ended_keeps_its_steps(
    program: Any, torch: Any, monkeypatch: pytest.MonkeyPatch, train: Callable[..., list[float]], tmp_path: Path
) -> None:
    take_step = program.affinity.take_step

    def end_third(state: Any, *more: Any) -> Any:
        if state.steps == 2:
            raise KeyboardInterrupt
        return take_step(state, *more)

    monkeypatch.setattr(program.affinity, "take_step", end_third)
    with pytest.raises(KeyboardInterrupt):
        train(steps=4)
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["steps"] == 2


def test_exported_weights_are_the_averaged_ones(
    program: Any, torch: Any, train: Callable[..., list[float]], tmp_path: Path
) -> None:
    train("--export", str(tmp_path / "weights.npz"), steps=2)
    assert (tmp_path / "weights.npz").stat().st_size <= program.affinity.MAX_EXPORTED_BYTES
    kept = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    with np.load(tmp_path / "weights.npz") as arrays:
        assert set(arrays.files) == {*kept["average"], "options"}
        for name, weights in kept["average"].items():
            assert arrays[name].dtype == np.float16
            np.testing.assert_allclose(arrays[name], weights.numpy(), rtol=HALF, atol=1e-7)
        assert json.loads(str(arrays["options"]))["steps"] == [1, 2, 4, 8, 16]
    moved = [(kept["average"][name] != kept["network"][name]).any() for name in kept["network"]]
    assert any(moved)


def test_there_must_be_frames(program: Any, tmp_path: Path) -> None:
    write_frame_file(tmp_path, make_example(5))
    with pytest.raises(InputError, match="make_frames"):
        program.affinity.find_frames(tmp_path)


def test_new_frames_are_picked_up(
    program: Any, monkeypatch: pytest.MonkeyPatch, train: Callable[..., list[float]], frames: Path, tmp_path: Path
) -> None:
    take_step, counts = program.affinity.take_step, []

    def watch(state: Any, paths: list[Path], *more: Any) -> Any:
        counts.append(len(paths))
        if state.steps == 1:
            write_frame_file(frames, make_example(3))
        return take_step(state, paths, *more)

    monkeypatch.setattr(program.affinity, "STEPS_BETWEEN_REPORTS", 2)
    monkeypatch.setattr(program.affinity, "take_step", watch)
    train(steps=4)
    assert counts == [2, 2, 3, 3]


def test_the_rate_rises_and_falls_to_its_last(program: Any) -> None:
    find, rate = program.affinity.find_rate, program.affinity.RATE
    assert find(0.0, 0) == pytest.approx(rate / program.affinity.WARM_STEPS)
    assert find(0.0, 1000) == pytest.approx(rate)
    assert find(1.0, 1000) == pytest.approx(0.02 * rate)


@pytest.mark.parametrize("seed", range(6))
def test_crops_keep_what_is_true(program: Any, seed: int) -> None:
    batches = program.affinity_batches
    frame = batches.make_frame(make_example(3, spp=16, side=40))
    crop = batches.draw_crop(frame, np.random.default_rng(seed))
    images, before = crop.images, frame.cut(0, 0, 40, 40).images
    assert images["color"].shape == (3, 40, 40)
    # Neither an angle between two directions nor a light over its albedo depends on the changes, but for their places.
    for parts in (("normal", "lobe_axis"), ("hit_normal", "mean_normal")):
        cosines = [np.sort((each[parts[0]] * each[parts[1]]).sum(axis=0).ravel()) for each in (images, before)]
        np.testing.assert_allclose(*cosines, atol=HALF)
    spread = [
        np.sort((each["reference"] / each["mean_diffuse_albedo"]).ravel()) / np.sqrt(brightness)
        for each, brightness in ((images, crop.brightness**2), (before, frame.brightness**2))
    ]
    np.testing.assert_allclose(*spread, rtol=HALF)
    rest = [np.sort((each["color"] - each["diffuse"] - each["specular"]).ravel()) for each in (images, before)]
    scale = crop.brightness / frame.brightness
    np.testing.assert_allclose(rest[0], scale * rest[1], atol=HALF * scale)
    if crop.has_halves:
        np.testing.assert_allclose(images["diffuse"], 0.5 * (images["diffuse_a"] + images["diffuse_b"]), rtol=HALF)
    else:
        assert not set(batches.HALVES) & set(images)


def test_one_half_has_half_the_samples_and_thinning_keeps_the_mean(
    program: Any, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    batches = program.affinity_batches
    frame = batches.make_frame(make_example(3, spp=4, side=64))
    for name, value in (("ONE_HALF_SHARE", 1.0), ("THINNED_SHARE", 0.0)):
        monkeypatch.setattr(batches, name, value)
    crop = frame.cut(0, 0, 64, 64)
    first = crop.images["diffuse_a"]
    batches.drop_samples(crop, rng)
    assert crop.spp == 2.0
    assert not crop.has_halves
    np.testing.assert_array_equal(crop.images["diffuse"], first)
    for name, value in (("ONE_HALF_SHARE", 0.0), ("THINNED_SHARE", 1.0), ("MIN_KEPT_SHARE", 0.5)):
        monkeypatch.setattr(batches, name, value)
    crop, before = frame.cut(0, 0, 64, 64), frame.cut(0, 0, 64, 64).images
    batches.drop_samples(crop, rng)
    dropped = (crop.images["diffuse_a" if crop.has_halves else "diffuse"] == 0.0).mean()
    assert 0.1 < dropped < 0.6
    # 4096 pixels of which half are kept: the mean is known to 2 or 3 percent.
    assert crop.images["diffuse"].mean() == pytest.approx(before["diffuse"].mean(), rel=0.1)


@pytest.mark.parametrize("name", ["all", "unsplit", "passes", "plain", "color"])
def test_what_a_set_of_guides_hides_changes_nothing(torch: Any, program: Any, name: str) -> None:
    guides = program.affinity_model.GuideSet(name)
    torch.manual_seed(1)
    network = program.affinity_model.AffinityNetwork()
    example, other = make_example(1), make_example(2)
    used = set(list_images()) - {"reference", "peer_all", "peer_plain"}
    hidden = HIDDEN.get(name, used - (PLAIN if name == "plain" else {"color"}))

    def run(changed: set[str]) -> Any:
        mixed = replace(example, **{each: getattr(other, each) for each in changed})
        batch = program.affinity_batches.join_crops([program.affinity_batches.make_frame(mixed).cut(0, 0, 32, 32)])
        # The depth's mean is a number of its own.
        batch = replace(batch, depth=torch.ones(1))
        with torch.no_grad():
            return network(batch, guides).numpy()

    plain = run(set())
    np.testing.assert_array_equal(run(hidden), plain)
    for each in sorted(used - hidden):
        assert np.abs(run({each}) - plain).max() > 1e-6, each


def test_halves_of_light_in_one_image_are_not_told_apart(torch: Any, program: Any) -> None:
    batches, sets = program.affinity_batches, program.affinity_model.GuideSet
    batch = batches.join_crops([batches.make_frame(make_example(1)).cut(0, 0, 32, 32)])
    names = {f"{first}_{half}": f"{second}_{half}" for half in "ab" for first, second in (SWAPPED, SWAPPED[::-1])}
    swapped = replace(batch, images=batch.images | {name: batch.images[other] for name, other in names.items()})
    found = {
        each: [program.affinity_model.prepare(b, sets(each)).inputs for b in (batch, swapped)]
        for each in ("unsplit", "all")
    }
    torch.testing.assert_close(*found["unsplit"])
    assert (found["all"][0] != found["all"][1]).any()


def test_lobes_and_halves_can_be_left_out(torch: Any, program: Any) -> None:
    guides, batches = program.affinity_model.GuideSet("all"), program.affinity_batches
    batch = batches.join_crops([batches.make_frame(make_example(1)).cut(0, 0, 32, 32)])
    for option, hidden in (
        ("lobes", ("lobe_axis", "lobe_sharpness")),
        ("halves", ("diffuse_a", "diffuse_b", "specular_a", "specular_b")),
    ):
        torch.manual_seed(1)
        network = program.affinity_model.AffinityNetwork(**{option: False})
        images = batch.images | {name: torch.rand_like(batch.images[name]) for name in hidden}
        with torch.no_grad():
            found = [network(each, guides).numpy() for each in (batch, replace(batch, images=images))]
        np.testing.assert_array_equal(*found)


def test_errors_are_over_those_of_the_peer(torch: Any, program: Any) -> None:
    example = make_example(5)
    frame = program.affinity_batches.make_frame(example)
    guides = program.affinity_model.GuideSet("all")

    def give_image(image: Any) -> Callable[..., Any]:
        return lambda batch, guides: torch.from_numpy(np.moveaxis(image.astype(np.float32), -1, 0))[None]

    measure = program.affinity_validation.compare_with_peer
    # The peer is off by a tenth, and this by a fifth: four times the squared error.
    assert measure(give_image(1.2 * example.reference), frame, guides, "cpu") == pytest.approx(4.0, rel=0.02)
    assert measure(give_image(example.reference), frame, guides, "cpu") == pytest.approx(0.0, abs=1e-6)
    assert measure(None, program.affinity_batches.make_frame(replace(example, peer_all=None)), guides, "cpu") is None
