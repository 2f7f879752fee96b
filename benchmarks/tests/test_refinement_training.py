"""benchmarks/training/refinement*.py: the trainer's network is the package's, steps go on, frames are as users have."""

import importlib
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.training import refinement_frames
from benchmarks.training.frames import is_validation, make_half
from benchmarks.training.refinement_frames import name_file, parse_file_name, write_arrays
from lobewise.denoising.refining.network import load_weights
from lobewise.errors import InputError
from lobewise.filters.refinement.run import pack_weights, refine_image
from lobewise.filters.refinement.shape import LAYERS
from tests.filters.test_refinement import make_images
from tests.streaming.frames import make_scene

NAMES = ("refinement", "refinement_batches", "refinement_model", "refinement_resident")


@pytest.fixture
def program(torch: Any) -> Any:
    """Return the modules of the trainer, by name."""
    return SimpleNamespace(**{name: importlib.import_module(f"benchmarks.training.{name}") for name in NAMES})


def write_frame(folder: Path, seed: int, guides: str = "all", side: int = 32) -> None:
    """Write a frame of noise about a smooth reference, with a peer that is off by a tenth."""
    rng = np.random.default_rng(seed)
    images = make_images((side, side), seed)
    reference = np.broadcast_to(np.linspace(0.2, 1.0, side)[:, None, None], (side, side, 3))
    for name, spread in (("noisy", 0.5), ("filtered", 0.1)):
        images[name] = (reference * rng.gamma(1.0 / spread, spread, (side, side, 3))).astype(np.float32)
    lobe = np.concatenate([images.pop("lobe_axis"), images.pop("lobe_sharpness")[..., None]], axis=-1)
    known = {**images, "lobe": lobe, "rest": 0.1 * reference, "reference": 1.1 * reference, "peer": 1.2 * reference}
    if guides == "color":
        known = {name: known[name] for name in ("noisy", "filtered", "reference", "peer")}
    known["shared"] = np.float32(1.0)
    write_arrays(folder / name_file(seed, 4, guides), {name: make_half(image) for name, image in known.items()})


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Return a folder with frames of two scenes, and of one that is kept aside."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for seed in (1, 2, 5):
        for guides in ("all", "color"):
            write_frame(folder, seed, guides)
    return folder


def train(program: Any, frames: Path, steps: int, *more: str) -> None:
    """Run the trainer."""
    folder = frames.parent
    options = {"--frames": frames, "--checkpoint": folder / "checkpoint.pt", "--curve": folder / "curve.json"}
    words = [str(word) for pair in options.items() for word in pair]
    program.refinement.main([*words, "--steps", str(steps), *more])


def test_the_network_of_the_trainer_is_that_of_the_package(program: Any, torch: Any) -> None:
    torch.manual_seed(1)
    network = program.refinement_model.RefiningNetwork().eval()
    arrays = {name: each.detach().numpy() for name, each in network.state_dict().items()}
    images = make_images((48, 32))
    crop = {name: np.moveaxis(np.atleast_3d(image), -1, 0) for name, image in images.items()}
    crop["lobe"] = np.concatenate([crop.pop("lobe_axis"), crop.pop("lobe_sharpness")])
    batch = program.refinement_batches.join([crop], [(0.7, 0.5, True)])
    with torch.no_grad():
        found = np.moveaxis(network(batch)[0].numpy(), 0, -1)
    own = refine_image(images, pack_weights(arrays), brightness=0.7, mean_log_depth=0.5, shared=True)
    np.testing.assert_allclose(own, found, rtol=3e-4)


def test_training_lowers_the_loss_and_goes_on(program: Any, torch: Any, frames: Path) -> None:
    train(program, frames, 3)
    first = torch.load(frames.parent / "checkpoint.pt", weights_only=True)
    train(program, frames, 12, "--export", str(frames.parent / "weights.npz"))
    second = torch.load(frames.parent / "checkpoint.pt", weights_only=True)
    assert (first["steps"], second["steps"]) == (3, 15)
    points = json.loads((frames.parent / "curve.json").read_text())["points"]
    assert [point["steps"] for point in points] == [3, 15]
    assert set(points[0]["errors"]) == {"all", "color"}
    assert points[1]["errors"]["all"]["mean"] < points[0]["errors"]["all"]["mean"]
    with np.load(frames.parent / "weights.npz") as exported:
        flat = pack_weights({name: exported[name].astype(np.float32) for name in exported.files})
        assert set(exported.files) == {f"{name}.{part}" for name in LAYERS for part in ("weight", "bias")}
    assert flat.shape == load_weights().shape
    (frames.parent / "checkpoint.pt").unlink()
    train(program, frames, 1, "--start", str(frames.parent / "weights.npz"))
    points = json.loads((frames.parent / "curve.json").read_text())["points"]
    assert points[2]["errors"]["all"]["mean"] < points[0]["errors"]["all"]["mean"]


def test_an_untrained_network_keeps_the_filtered_image(program: Any, torch: Any, frames: Path) -> None:
    network = program.refinement.make_state(1).network.eval()
    batch = program.refinement_batches.make_whole(
        program.refinement_batches.read_frame(frames / name_file(1, 4, "color"))
    )
    with torch.no_grad():
        found = network(batch)
    filtered, noisy = batch.images["filtered"], batch.images["noisy"]
    assert (found - filtered).abs().mean() < 0.5 * (found - noisy).abs().mean()


def test_errors_count_for_every_crop_alike(program: Any, torch: Any) -> None:
    reference, found, before = torch.ones(2, 3, 16, 16), torch.ones(2, 3, 16, 16), torch.ones(2, 3, 16, 16)
    found[0], before[0] = 2.0, 3.0
    compute_loss = program.refinement.compute_loss
    few = compute_loss(found, before, before, reference)
    found[1], before[1] = 1.02, 1.02
    many = compute_loss(found, before, before, reference)
    assert many > few
    better = found.clone()
    better[1] = 1.0
    assert compute_loss(better, before, before, reference) < many


def test_errors_above_those_of_the_noisy_crop_count_more(program: Any, torch: Any) -> None:
    reference, found, before = (
        torch.ones(1, 3, 16, 16),
        torch.full((1, 3, 16, 16), 1.1),
        torch.full((1, 3, 16, 16), 1.2),
    )
    compute_loss = program.refinement.compute_loss
    assert compute_loss(found, reference + 0.01, before, reference) > compute_loss(found, before, before, reference)


def test_what_is_worse_than_its_input_counts_once_more(
    program: Any, torch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference, worse = torch.ones(1, 3, 16, 16), torch.full((1, 3, 16, 16), 1.3)
    losses = []
    for weight in (program.refinement.EXCESS_WEIGHT, 0.0):
        monkeypatch.setattr(program.refinement, "EXCESS_WEIGHT", weight)
        losses += [
            float(program.refinement.compute_loss(worse, reference * noise, worse, reference)) for noise in (1.1, 1.5)
        ]
    assert losses[0] > losses[2]
    assert losses[1] == losses[3]


def test_sums_of_taps_have_the_gradients_of_their_definition(torch: Any, program: Any) -> None:
    model = program.refinement_model
    sums = torch.rand(1, 2, 5, 6, dtype=torch.float64, requires_grad=True)
    weights = torch.rand(1, 9, 5, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(model.gather, (sums, weights))
    coarse = torch.rand(1, 9, 10, 12, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(model.gather_coarse, (sums, coarse))


def test_every_fifth_shot_of_blender_is_kept_aside() -> None:
    aside = [seed for seed in range(10) if is_validation(refinement_frames.number_shot(f"glass_{seed}"))]
    assert aside == [4, 9]


def test_shots_for_validation_are_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("fog_1", "glass_1"):
        (tmp_path / name).mkdir()
        for file in ("shot.json", "4.exr", "reference_1.exr", "reference_2.exr", "reference_3.exr"):
            (tmp_path / name / file).touch()
    converted: list[str] = []
    monkeypatch.setattr(refinement_frames, "convert_shot", lambda _, scene: converted.append(scene.name))
    refinement_frames.main(["--cache", str(tmp_path / "frames"), "--shots", str(tmp_path)])
    assert converted == ["glass_1"]


def test_exported_weights_may_be_a_mean_of_old_and_new(program: Any, torch: Any, tmp_path: Path) -> None:
    first, second = program.refinement.make_state(1), program.refinement.make_state(2)
    old, both = tmp_path / "old.npz", tmp_path / "both.npz"
    program.refinement.export_weights(old, first)
    program.refinement.export_weights(both, second, old, 0.25)
    with np.load(both) as arrays:
        mean = 0.75 * first.average.stem.weight.detach().numpy() + 0.25 * second.average.stem.weight.detach().numpy()
        np.testing.assert_allclose(arrays["stem.weight"], mean, atol=2e-3)


def test_crops_stay_true(program: Any, frames: Path) -> None:
    stored = program.refinement_batches.read_frame(frames / name_file(1, 4, "all"))
    images = program.refinement_batches.cut(stored, 4, 8, 16, 16)
    before = {name: image.copy() for name, image in images.items()}
    factor = program.refinement_batches.vary(images, np.random.default_rng(3))
    assert np.isclose(images["reference"].sum(), factor * before["reference"].sum(), rtol=1e-4)
    assert np.isclose(images["albedo"].sum(), before["albedo"].sum(), rtol=1e-4)
    lengths = [np.sort(np.linalg.norm(each["normal"], axis=0), axis=None) for each in (images, before)]
    np.testing.assert_allclose(*lengths, rtol=1e-4)


def test_there_must_be_frames(program: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="refinement_frames"):
        program.refinement.list_frames(tmp_path)


def test_file_names_come_back() -> None:
    assert parse_file_name(Path(name_file(17, 64, "plain"))) == (17, 64, "plain")
    assert parse_file_name(Path("scene-00001-0004.npz")) is None


def test_frames_have_the_guides_that_users_have() -> None:
    frame = make_scene((40, 32))
    reference = frame.radiance.color
    found = {guides: each for guides, each, _ in refinement_frames.vary_frame(frame, reference, 3)}
    assert tuple(found) == refinement_frames.GUIDE_SETS
    assert found["unsplit"].radiance.parts is None
    assert found["plain"].camera is None
    for guides, each in found.items():
        images = refinement_frames.filter_frame(each)
        assert ("lobe" in images) == (guides in ("all", "unsplit", "passes"))
        assert ("rest" in images) == (guides in ("all", "passes"))
        assert all(np.isfinite(image).all() for image in images.values())


def test_shared_samples_are_a_blur() -> None:
    frame = make_scene((40, 32))
    shared = refinement_frames.share_samples(frame, 0.7)
    assert shared.noise_is_shared
    assert shared.half_a is None
    assert np.abs(np.diff(shared.radiance.color, axis=0)).mean() < np.abs(np.diff(frame.radiance.color, axis=0)).mean()


def test_resident_crops_are_those_of_the_frames(
    program: Any, torch: Any, frames: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CALMED_SHARE", "SPOILED_SHARE"):
        monkeypatch.setattr(program.refinement_batches, name, 0.0)
    torch.manual_seed(2)
    shown, _ = program.refinement.list_frames(frames)
    resident = program.refinement_resident.load_frames(shown, program.refinement.SHARES, torch.device("cpu"))
    batch = program.refinement_resident.draw_resident(resident, 64, 128)
    stored = [program.refinement_batches.read_frame(path) for paths in shown.values() for path in paths]
    sums = [{name: image.astype(np.float32).sum() for name, image in each.images.items()} for each in stored]
    ratios = {round(float(each["filtered"] / each["reference"]), 4) for each in sums}
    found = batch.images["filtered"].sum((1, 2, 3)) / batch.images["reference"].sum((1, 2, 3))
    assert {round(float(each), 4) for each in found} == ratios
    lengths = torch.linalg.norm(batch.images["normal"], dim=1)
    known = batch.known["normal"][:, 0, 0, 0] > 0
    assert 0 < known.sum() < 64
    assert torch.isfinite(lengths).all()
    assert (lengths[~known] == 0).all()


def test_spoiled_guides_are_noise_and_the_light_there_is_left_noisy(program: Any, torch: Any, frames: Path) -> None:
    batches = program.refinement_batches
    batch = batches.make_whole(batches.read_frame(frames / name_file(1, 4, "all")))
    before = {name: torch.cat(8 * [image]) for name, image in batch.images.items()}
    images = dict(before)
    generator = torch.Generator().manual_seed(3)
    for _ in range(4):
        batches.spoil(images, generator)
    spoiled = (images["normal"] != before["normal"]).any(dim=1, keepdim=True)
    assert 0.0 < spoiled.float().mean() < 1.0
    lengths = torch.linalg.norm(images["normal"], dim=1)[spoiled[:, 0]]
    assert (lengths >= 1.0 - batches.MAX_SHORTER - 1e-5).all()
    for name, unlike in (("depth", spoiled), ("filtered", spoiled | (before["normal"] == 0).all(dim=1, keepdim=True))):
        assert (images[name] == before[name]).all(dim=1, keepdim=True)[~unlike].all()
        assert (images[name] != before[name]).any(dim=1, keepdim=True)[spoiled].any()
    assert all((images[name] == before[name]).all() for name in ("noisy", "reference", "albedo"))


def test_windows_on_a_device_cover_larger_frames(program: Any, torch: Any, frames: Path) -> None:
    write_frame(frames, 3, "color", side=70)
    shown, _ = program.refinement.list_frames(frames)
    resident = program.refinement_resident.load_frames(shown, program.refinement.SHARES, torch.device("cpu"))
    assert resident.side == 32
    assert len(resident.pixels) == sum(map(len, shown.values())) - 1 + 9
    assert program.refinement_resident.place(70, 32) == [0, 19, 38]


def test_turns_keep_lengths_and_mirror_half(program: Any, torch: Any) -> None:
    torch.manual_seed(1)
    turns = program.refinement_resident.draw_turns(200, torch.device("cpu"))
    torch.testing.assert_close(turns @ turns.transpose(1, 2), torch.eye(3).expand(200, 3, 3), atol=1e-5, rtol=0)
    assert 60 < (torch.linalg.det(turns) > 0).sum() < 140


def test_the_resident_trainer_lowers_the_loss_and_goes_on(program: Any, torch: Any, frames: Path) -> None:
    shown, _ = program.refinement.list_frames(frames)
    resident = program.refinement_resident.load_frames(shown, program.refinement.SHARES, torch.device("cpu"))
    state = program.refinement.make_state(1)
    trainer = program.refinement_resident.ResidentTrainer(state, resident, 8, 16)
    losses = [float(trainer.take_step(1e-3, 0.9)) for _ in range(15)]
    assert sum(losses[-4:]) < sum(losses[:4])
    path = frames.parent / "resident.pt"
    program.refinement.save_checkpoint(path, state)
    again = program.refinement.make_state(2)
    program.refinement.load_checkpoint(path, again)
    assert again.steps == 15
    train(program, frames, 1, "--checkpoint", str(path))
    more = program.refinement_resident.ResidentTrainer(again, resident, 8, 32)
    assert float(more.take_step(1e-4, 0.9)) < losses[0]
    assert {float(each["step"]) for each in again.optimiser.state_dict()["state"].values()} == {16.0}
