"""benchmarks/training/kinds.py and make_frames.py: every kind builds, the same seed gives the same scene and files."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.common import ROOT
from benchmarks.training import frames
from lobewise.errors import InputError
from lobewise.peers import has_oidn

SIZE = 32

pytestmark = pytest.mark.mitsuba


@pytest.fixture(scope="session")
def make_frames(mi: Any) -> Any:
    """Return the program, or skip where what it cleans references with is missing."""
    if not has_oidn():
        pytest.skip("needs Open Image Denoise: pip install 'lobewise[compare]'")
    return importlib.import_module("benchmarks.training.make_frames")


@pytest.fixture(scope="session")
def kinds(mi: Any) -> Any:
    """Return the module of the scenes."""
    return importlib.import_module("benchmarks.training.kinds")


def find_quick_seed(make_frames: Any, *, validation: bool) -> int:
    """Return a seed whose scene is quick to render: a stand, with the short reference."""
    return next(
        seed
        for seed in range(1, 5000)
        if frames.is_validation(seed) == validation
        and make_frames.choose_kind(seed) == "layered"
        and 1 in make_frames.draw_samples(seed)
        and max(make_frames.draw_samples(seed)) <= 16
    )


def flatten(item: Any, path: str = "") -> dict[str, Any]:
    """Return every leaf of a description by its path."""
    if isinstance(item, (tuple, list)):
        item = dict(enumerate(item))
    if isinstance(item, dict):
        return {at: leaf for key, value in item.items() for at, leaf in flatten(value, f"{path}/{key}").items()}
    return {path: item}


@pytest.fixture(scope="session")
def rendered(make_frames: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the frames of one scene to train on and of one to validate with."""
    folder = tmp_path_factory.mktemp("frames")
    for validation in (False, True):
        seed = find_quick_seed(make_frames, validation=validation)
        assert make_frames.render_scene(folder, seed, SIZE) == make_frames.draw_samples(seed)
    return folder


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


def test_scenes_have_two_or_three_sample_counts_and_a_reference_far_above_them(make_frames: Any) -> None:
    drawn = [make_frames.draw_samples(seed) for seed in range(1, 200)]
    assert {len(each) for each in drawn} == {2, 3}
    assert {spp for each in drawn for spp in each} == {1, 2, 4, 8, 16, 32, 64}
    for samples in drawn:
        assert list(samples) == sorted(set(samples))
        assert make_frames.choose_reference_spp(samples) == (512 if max(samples) > 16 else 128)


def test_what_is_rendered_is_what_the_reader_of_frames_expects(make_frames: Any, rendered: Path) -> None:
    for path in frames.list_frames(rendered):
        found = frames.read_frame_file(path)
        assert frames.parse_file_name(path) == (found.seed, found.spp)
        assert found.color.shape == (SIZE, SIZE, 3)
        assert found.kind == "layered"
        assert found.reference_spp == 128
        assert found.has_halves == (found.spp > 1)
        assert (found.peer_all is not None) == (found.peer_plain is not None) == frames.is_validation(found.seed)
        if found.diffuse_a is not None and found.diffuse_b is not None:
            halves = 0.5 * (found.diffuse_a.astype(np.float64) + found.diffuse_b)
            np.testing.assert_allclose(halves, found.diffuse, rtol=2e-3, atol=1e-3)
        # The light is scaled, also that of the parts, and the median of the reference lies where the seed draws it.
        parts = found.diffuse.astype(np.float64) + found.specular
        assert (parts <= found.color * 1.01 + 1e-3).all()
        assert 0.01 < np.median(found.reference) < 1.0
        lobes = found.lobe_sharpness > 0.0
        length = np.linalg.norm(found.lobe_axis.astype(np.float64), axis=-1)
        np.testing.assert_allclose(length, lobes, atol=2e-3)
        assert lobes.any()


def test_references_are_nearer_to_each_other_than_to_what_they_clean(make_frames: Any, rendered: Path) -> None:
    from lobewise.render import render_reference
    from lobewise.render.loading import build_scene

    seed = find_quick_seed(make_frames, validation=False)
    found = frames.read_frame_file(rendered / frames.make_file_name(seed, 1))
    scene = build_scene(make_frames.make_kind(seed, SIZE, SIZE))
    color = render_reference(scene, spp=128, seed=1000 * seed + 500).radiance.color
    other = render_reference(scene, spp=128, seed=77).radiance.color * make_frames.find_exposure(seed, color)

    def measure_error(image: Any) -> float:
        return float(np.mean((image.astype(np.float64) - other) ** 2 / (other + 0.01) ** 2))

    assert measure_error(found.reference) < 0.1 * measure_error(found.color)


def test_what_is_there_is_not_rendered_again(make_frames: Any, rendered: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seed = find_quick_seed(make_frames, validation=False)
    before = {path: path.stat().st_mtime_ns for path in frames.list_frames(rendered)}
    monkeypatch.setattr(make_frames, "build_scene", lambda *_: pytest.fail("a scene was built"))
    assert make_frames.render_scene(rendered, seed, SIZE) == ()
    assert {path: path.stat().st_mtime_ns for path in frames.list_frames(rendered)} == before


def test_a_frame_that_is_missing_is_made_again_with_the_same_bits(make_frames: Any, rendered: Path) -> None:
    seed = find_quick_seed(make_frames, validation=True)
    gone = rendered / frames.make_file_name(seed, make_frames.draw_samples(seed)[-1])
    before = frames.read_frame_file(gone)
    gone.unlink()
    assert make_frames.render_scene(rendered, seed, SIZE) == (before.spp,)
    again = frames.read_frame_file(gone)
    for name in frames.list_images():
        np.testing.assert_array_equal(getattr(again, name), getattr(before, name), err_msg=name)


def test_frames_of_another_size_are_not_mixed(make_frames: Any, rendered: Path, tmp_path: Path) -> None:
    make_frames.check_size(rendered, SIZE)
    make_frames.check_size(tmp_path, SIZE)
    with pytest.raises(InputError, match="--size"):
        make_frames.check_size(rendered, SIZE + 1)


def test_the_program_refuses_a_folder_inside_the_repository(
    make_frames: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["make_frames", "--cache", str(ROOT / "frames")])
    with pytest.raises(SystemExit) as refused:
        make_frames.main()
    assert refused.value.code == 2
    assert "outside the repository" in capsys.readouterr().err
