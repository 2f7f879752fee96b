"""benchmarks/training/kinds.py and refinement_frames.py: every kind builds, a seed gives the same scene and files."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.common import ROOT
from benchmarks.training import frames
from lobewise.peers import has_oidn

SIZE = 32

pytestmark = pytest.mark.mitsuba


@pytest.fixture(scope="session")
def program(mi: Any) -> Any:
    """Return the program that makes frames, or skip where it cannot clean references."""
    if not has_oidn():
        pytest.skip("needs Open Image Denoise: pip install 'lobewise[compare]'")
    return importlib.import_module("benchmarks.training.refinement_frames")


@pytest.fixture(scope="session")
def kinds(mi: Any) -> Any:
    """Return the module of the scenes."""
    return importlib.import_module("benchmarks.training.kinds")


def choose_quick_seed(program: Any, kinds: Any, *, validation: bool) -> int:
    """Return a seed whose scene is quick to render: a stand, with the short reference."""
    return next(
        seed
        for seed in range(1, 5000)
        if frames.is_validation(seed) == validation
        and kinds.choose_kind(seed) == "layered"
        and 1 in program.draw_samples(seed)
        and max(program.draw_samples(seed)) <= 16
    )


def flatten(item: Any, path: str = "") -> dict[str, Any]:
    """Return every leaf of a description by its path."""
    if isinstance(item, (tuple, list)):
        item = dict(enumerate(item))
    if isinstance(item, dict):
        return {at: leaf for key, value in item.items() for at, leaf in flatten(value, f"{path}/{key}").items()}
    return {path: item}


@pytest.fixture(scope="session")
def rendered(program: Any, kinds: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the frames of one scene to train on and of one to validate with."""
    folder = tmp_path_factory.mktemp("frames")
    for validation in (False, True):
        seed = choose_quick_seed(program, kinds, validation=validation)
        assert program.render_scene(folder, seed, SIZE) == list(program.draw_samples(seed))
    return folder


def read(path: Path) -> dict[str, Any]:
    """Return the arrays of a file."""
    with np.load(path) as arrays:
        return {name: arrays[name].astype(np.float32) for name in arrays.files}


@pytest.mark.nightly
def test_every_kind_builds_and_keeps_its_things_from_the_camera(kinds: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from lobewise.render.loading import build_scene

    # The textures of the older kinds take most of the time.
    monkeypatch.setattr("benchmarks.training.materials.TEXELS", 32)
    for number, (kind, make) in enumerate(kinds.KINDS.items()):
        stage = make(np.random.default_rng([1, number]), 1.0)
        assert any("emitter" in item or item["type"] == "envmap" for item in stage.items.values()), kind
        assert len(stage.places) >= 3, kind
        for middle, radius in stage.places:
            assert np.linalg.norm(np.subtract(middle, stage.origin)) > radius, kind
        # Plugins refuse what they do not know; textures as large as the scene's would only take their time.
        shapes = {name: item for name, item in stage.items.items() if item["type"] != "mesh"}
        assert build_scene({"type": "scene", **shapes}).shapes(), kind


def test_a_scene_has_the_camera_and_the_things_of_its_kind(kinds: Any) -> None:
    from lobewise.render.loading import build_scene

    description = kinds.make_kind(5, 8, 6)
    assert kinds.choose_kind(5) == "garden"
    scene = build_scene(description)
    assert tuple(scene.sensors()[0].film().size()) == (8, 6)
    assert len(scene.shapes()) == sum("bsdf" in item for item in description.values() if isinstance(item, dict))


def test_the_same_seed_is_the_same_scene_and_another_is_not(kinds: Any) -> None:
    first, again, other = (flatten(kinds.make_kind(seed, 8, 8, "desk")) for seed in (3, 3, 4))
    assert first.keys() == again.keys()
    for path, value in first.items():
        np.testing.assert_array_equal(value, again[path], err_msg=path)
    assert first.keys() != other.keys()


def test_the_seeds_for_validation_go_through_every_kind(kinds: Any) -> None:
    seeds = [seed for seed in range(1, 5 * len(kinds.KINDS) + 1) if frames.is_validation(seed)]
    assert {kinds.choose_kind(seed) for seed in seeds} == set(kinds.KINDS)


def test_scenes_have_two_or_three_sample_counts_and_a_reference_far_above_them(program: Any) -> None:
    drawn = [program.draw_samples(seed) for seed in range(1, 200)]
    assert {len(each) for each in drawn} == {2, 3}
    assert {spp for each in drawn for spp in each} == {1, 2, 4, 8, 16, 32, 64}
    for samples in drawn:
        assert list(samples) == sorted(set(samples))
        assert program.choose_reference_spp(samples) == (512 if max(samples) > 16 else 128)


@pytest.mark.nightly
def test_files_hold_what_the_trainer_reads(program: Any, rendered: Path) -> None:
    for path in sorted(rendered.glob("*.npz")):
        seed, _, guides = program.parse_file_name(path)
        found = read(path)
        for name in ("noisy", "filtered", "reference"):
            assert found[name].shape == (SIZE, SIZE, 3)
        assert ("peer" in found) == frames.is_validation(seed)
        assert ("rest" in found) == (guides in ("all", "passes"))
        # The light is scaled, so that the median of the reference lies where the seed draws it.
        assert 0.01 < np.median(found["reference"]) < 1.0
        if "lobe" in found:
            there = found["lobe"][..., 3] > 0.0
            np.testing.assert_allclose(np.linalg.norm(found["lobe"][..., :3], axis=-1)[there], 1.0, atol=2e-3)


@pytest.mark.nightly
def test_lamps_are_as_bright_with_all_guides_as_with_few(program: Any, rendered: Path) -> None:
    """Emission averaged over the pixel's area is exposed like all other light."""
    for path in rendered.glob("*-all.npz"):
        rest, sampled = (read(each)["rest"] for each in (path, path.with_name(path.name.replace("all", "passes"))))
        assert rest.sum() == pytest.approx(sampled.sum(), rel=0.1, abs=1e-3)


@pytest.mark.nightly
def test_references_are_nearer_to_each_other_than_to_what_they_clean(program: Any, kinds: Any, rendered: Path) -> None:
    from lobewise.render import render_reference
    from lobewise.render.loading import build_scene

    seed = choose_quick_seed(program, kinds, validation=False)
    found = [read(path) for path in sorted(rendered.glob(f"{seed:06d}-*-plain.npz"))]
    scene = build_scene(kinds.make_kind(seed, SIZE, SIZE))
    color = render_reference(scene, spp=128, seed=1000 * seed + 500).radiance.color
    other = render_reference(scene, spp=128, seed=77).radiance.color * program.choose_exposure(seed, color)

    def measure_error(image: Any) -> float:
        return float(np.mean((image.astype(np.float64) - other) ** 2 / (other + 0.01) ** 2))

    # A frame that shares samples between pixels has a blurred reference.
    assert min(measure_error(each["reference"]) for each in found) < 0.1 * measure_error(found[0]["noisy"])


@pytest.mark.nightly
def test_what_is_there_is_not_rendered_again(
    program: Any, kinds: Any, rendered: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seed = choose_quick_seed(program, kinds, validation=False)
    before = {path: path.stat().st_mtime_ns for path in rendered.glob("*.npz")}
    monkeypatch.setattr("lobewise.render.loading.build_scene", lambda *_: pytest.fail("a scene was built"))
    assert program.render_scene(rendered, seed, SIZE) == []
    assert {path: path.stat().st_mtime_ns for path in rendered.glob("*.npz")} == before


@pytest.mark.nightly
def test_a_frame_that_is_missing_is_made_again_with_the_same_bits(program: Any, kinds: Any, rendered: Path) -> None:
    seed = choose_quick_seed(program, kinds, validation=True)
    spp = program.draw_samples(seed)[-1]
    gone = sorted(rendered.glob(f"{seed:06d}-{spp:04d}-*.npz"))
    before = {path: read(path) for path in gone}
    for path in gone:
        path.unlink()
    assert program.render_scene(rendered, seed, SIZE) == [spp]
    for path, images in before.items():
        again = read(path)
        assert again.keys() == images.keys()
        for name, image in images.items():
            np.testing.assert_array_equal(again[name], image, err_msg=name)


def test_the_program_refuses_a_folder_inside_the_repository(program: Any, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        program.main(["--cache", str(ROOT / "frames")])
    assert refused.value.code == 2
    assert "outside the repository" in capsys.readouterr().err
