"""benchmarks/training/frames.py: what is written is what is read, and nothing else passes for a frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.training import frames
from benchmarks.training.make_frames import expose
from lobewise.errors import FileError, InputError
from tests.streaming.frames import make_scene

SIZE = (6, 5)
SINGLE = ("depth", "alpha_u", "alpha_v", "hit_inverse", "lobe_sharpness")


def make_example(rng: np.random.Generator, seed: int = 7, spp: int = 4) -> frames.Example:
    """Return a frame of random numbers with every image."""
    images = {
        name: frames.make_half(rng.normal(size=SIZE if name in SINGLE else (*SIZE, 3))) for name in frames.list_images()
    }
    return frames.Example(seed=seed, spp=spp, reference_spp=128, kind="attic", **images)


def test_a_frame_is_read_as_it_was_written(tmp_path: Path, rng: np.random.Generator) -> None:
    whole = make_example(rng)
    path = frames.write_frame_file(tmp_path / "new", whole)
    assert path.name == "scene-00007-0004.npz"
    found = frames.read_frame_file(path)
    assert (found.seed, found.spp, found.reference_spp, found.kind) == (7, 4, 128, "attic")
    for name in frames.list_images():
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name), err_msg=name)
        assert getattr(found, name).dtype == np.float16
    assert found.has_halves


def test_halves_and_peers_may_be_absent(tmp_path: Path, rng: np.random.Generator) -> None:
    absent = dict.fromkeys(("diffuse_a", "diffuse_b", "specular_a", "specular_b", "peer_all", "peer_plain"))
    found = frames.read_frame_file(frames.write_frame_file(tmp_path, replace(make_example(rng), **absent)))
    assert found.peer_all is None
    assert found.diffuse_a is None
    assert not found.has_halves


def test_frames_are_listed_by_seed_and_samples_and_nothing_else_is(tmp_path: Path, rng: np.random.Generator) -> None:
    assert frames.list_frames(tmp_path / "missing") == []
    wanted = [(2, 1), (2, 16), (10, 4), (123456, 2)]
    for seed, spp in reversed(wanted):
        frames.write_frame_file(tmp_path, make_example(rng, seed, spp))
    (tmp_path / "scene-00003-0004.99.tmp").write_bytes(b"half of it")
    (tmp_path / "scene-notes.npz").write_bytes(b"")
    assert [frames.parse_file_name(path) for path in frames.list_frames(tmp_path)] == wanted


def test_bad_pixels_are_stored_as_0_and_large_ones_clipped() -> None:
    image = np.array([np.nan, np.inf, -np.inf, 1e6, -1e6, 0.5])
    np.testing.assert_array_equal(frames.make_half(image), [0.0, 0.0, 0.0, 60000.0, -60000.0, 0.5])


def test_an_image_of_another_size_or_precision_is_refused(rng: np.random.Generator) -> None:
    whole = make_example(rng)
    with pytest.raises(InputError, match="depth"):
        replace(whole, depth=whole.normal)
    with pytest.raises(InputError, match="reference"):
        replace(whole, reference=whole.reference.astype(np.float32))
    with pytest.raises(InputError, match="normal"):
        replace(whole, normal=None)


def test_a_file_that_is_no_frame_is_named(tmp_path: Path, rng: np.random.Generator) -> None:
    path = frames.write_frame_file(tmp_path, make_example(rng))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(FileError, match="scene-00007-0004"):
        frames.read_frame_file(path)
    with pytest.raises(FileError, match="missing"):
        frames.read_frame_file(tmp_path / "missing.npz")
    np.savez(tmp_path / "other.npz", seed=1)
    with pytest.raises(FileError, match="other"):
        frames.read_frame_file(tmp_path / "other.npz")


def test_a_fifth_of_the_seeds_is_for_validation() -> None:
    assert [seed for seed in range(1, 21) if frames.is_validation(seed)] == [5, 10, 15, 20]


def test_all_light_of_a_frame_is_exposed(rng: np.random.Generator) -> None:
    frame = make_scene((24, 16))
    emission = rng.random((*frame.shape, 3), dtype=np.float32)
    frame = replace(frame, gbuffer=replace(frame.gbuffer, mean_emission=emission))
    found = expose(frame, 4.0)
    np.testing.assert_array_equal(found.gbuffer.mean_emission, 4.0 * emission)
    np.testing.assert_array_equal(found.radiance.color, 4.0 * frame.radiance.color)
    np.testing.assert_array_equal(found.gbuffer.diffuse_albedo, frame.gbuffer.diffuse_albedo)
