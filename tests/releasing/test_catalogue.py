"""The list of kernels that wheels bring along holds all that the verbs ask for on the test files."""

import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

import lobewise
from lobewise.backend import jit
from lobewise.cli.doctor.machine import examine_kernels
from lobewise.cli.program import run
from lobewise.filters.cross_pass import PassKey
from lobewise.settings.choices import FORM_NAMES, QUALITIES, SIMILARITIES
from releasing.catalogue import follow, list_kernels
from releasing.frames import SIZE, make_frame
from releasing.recording import Wanted, record_kernels

TESTS = Path(__file__).parents[1]
FILES = sorted((TESTS / "data" / "foreign").rglob("*.exr"))
SINGLE_IMAGES = sorted((TESTS / "data" / "foreign" / "luxcore").glob("*.exr"))
"""Files without guides, which have nothing to compare but the image."""
BUNDLED = Path(lobewise.__file__).parent / "data" / "demo.exr"


@pytest.fixture(scope="module")
def catalogue() -> set[str]:
    """Return the identities of all kernels of the list."""
    return set(list_kernels())


def list_missing(catalogue: set[str], *commands: list[str]) -> list[str]:
    """Return the makers of kernels that commands ask for and the list lacks."""
    found: dict[str, Wanted] = {}
    for words in commands:
        with record_kernels(seed=6) as recorded, warnings.catch_warnings():
            # Recorded kernels return random numbers, on which recipes divide by zero.
            warnings.simplefilter("ignore")
            assert run(words) == 0, words
        assert recorded, words
        found |= recorded
    return [f"{wanted.make} {wanted.key}" for name, wanted in found.items() if name not in catalogue]


@contextmanager
def note_kernels() -> Iterator[dict[str, Wanted]]:
    """Note the kernels that are asked for inside the ``with`` block, by identity; they compute."""
    found: dict[str, Wanted] = {}
    look_up = jit._look_up_prebuilt

    def note(key: Any, make: Any, *, strict: bool) -> Any:
        identity = jit.identify_kernel(key, make, strict=strict)
        if identity is not None:
            found[identity] = Wanted(key, make, strict)
        return look_up(key, make, strict=strict)

    with patch.object(jit, "_look_up_prebuilt", note), patch.object(jit, "_kernels", {}):
        yield found


@pytest.fixture
def own_file(tmp_path: Path) -> Path:
    """Return a file with every guide that lobewise writes."""
    path = tmp_path / "own.exr"
    lobewise.write_frame(path, make_frame((50, 70), seed=9))
    return path


@pytest.mark.nightly
@pytest.mark.mitsuba
class TestVerbs:
    """Run before a release: `releasing/wheels.py` does."""

    @pytest.mark.parametrize("file", FILES, ids=lambda path: path.stem)
    def test_denoise(self, file: Path, catalogue: set[str], tmp_path: Path) -> None:
        words = ["denoise", str(file), "-o", str(tmp_path / "out.exr"), "--offline", "--device", "cpu"]
        assert list_missing(catalogue, *([*words, "--quality", name] for name in QUALITIES)) == []

    @pytest.mark.parametrize("file", [BUNDLED, *FILES], ids=lambda path: path.stem)
    def test_what_pixels_ask_for(self, file: Path, catalogue: set[str], tmp_path: Path) -> None:
        words = [str(file), "-o", str(tmp_path / "out.exr"), "--overwrite", "--device", "cpu"]
        commands = [["denoise", *words, "--quality", name] for name in QUALITIES]
        if file not in SINGLE_IMAGES:
            commands += [
                ["denoise", *words, "--quality", quality, "--similarity", name]
                for quality in ("fast", "balanced")
                for name in SIMILARITIES
            ]
            commands += [["upsample", *words, "--scale", "2"]]
            for number in range(1, 4):
                shutil.copy(file, tmp_path / f"in.{number:04}.exr")
            frames = [str(tmp_path / "in.####.exr"), "-o", str(tmp_path / "out.####.exr"), "--device", "cpu"]
            commands += [["upsample", *frames, "--scale", "2", "--temporal"], ["denoise", *frames, "--window", "1"]]
        with note_kernels() as found:
            for command in commands:
                assert run(command) == 0, command
        assert found
        assert [wanted.key for name, wanted in found.items() if name not in catalogue] == []

    def test_denoise_own_files(self, own_file: Path, catalogue: set[str], tmp_path: Path) -> None:
        words = ["denoise", str(own_file), "-o", str(tmp_path / "out.exr"), "--offline", "--device", "cpu"]
        commands = [[*words, "--similarity", name] for name in SIMILARITIES]
        commands += [[*words, "--quality", "fast", "--form", name] for name in FORM_NAMES]
        commands += [[*words, "--radius", str(radius)] for radius in (2, 12)]
        commands += [[*words, "--bands", "20"]]
        assert list_missing(catalogue, *commands) == []

    @pytest.mark.parametrize("option", [["--temporal"], ["--window", "1"]], ids=str)
    def test_sequences(self, option: list[str], catalogue: set[str], tmp_path: Path) -> None:
        for number in range(1, 4):
            lobewise.write_frame(tmp_path / f"in.{number:04}.exr", make_frame((50, 70), seed=number))
        words = ["denoise", str(tmp_path / "in.####.exr"), "-o", str(tmp_path / "out.####.exr"), "--device", "cpu"]
        assert list_missing(catalogue, [*words, *option]) == []

    def test_doctor(self, catalogue: set[str]) -> None:
        with record_kernels() as found:
            examine_kernels()
        assert found
        assert found.keys() <= catalogue

    def test_upsample(self, catalogue: set[str], tmp_path: Path) -> None:
        sparse = tmp_path / "sparse.exr"
        lobewise.write_sparse_frame(sparse, lobewise.make_sparse(make_frame((50, 70)), 4, (1, 2)))
        words = ["upsample", str(sparse), "-o", str(tmp_path / "out.exr"), "--device", "cpu"]
        assert list_missing(catalogue, words) == []


@pytest.mark.sampled("fast", "balanced")
@pytest.mark.parametrize("quality", [name for name, each in QUALITIES.items() if not each.needs_oidn])
def test_even_and_odd_seeds_record_what_pixels_ask_for(quality: str) -> None:
    frame, recorded = lobewise.read_frame(BUNDLED), set()
    for seed in (0, 1):
        with record_kernels(seed) as found:
            lobewise.denoise(frame, quality=quality, device="cpu", with_oidn=False)
        recorded |= found.keys()
    with note_kernels() as asked:
        lobewise.denoise(frame, quality=quality, device="cpu", with_oidn=False)
    assert asked
    assert [wanted.key for name, wanted in asked.items() if name not in recorded] == []


def test_recorded_histories_go_on() -> None:
    run_history = follow(make_frame((32, 48)), 4)
    with record_kernels() as recorded:
        run_history()
    with note_kernels() as asked:
        run_history()
    assert asked
    assert [wanted.key for name, wanted in asked.items() if name not in recorded] == []


def test_recording_runs_recipes_to_their_end() -> None:
    frame = make_frame()
    with record_kernels() as found:
        clean = lobewise.denoise(frame, quality="balanced", device="cpu")
    assert clean.image.shape == frame.radiance.color.shape
    assert len(found) > 20
    assert all(len(name) == 24 for name in found)


class OwnPlaces(lobewise.Feature):
    """A feature of another package: this test."""

    def get_arrays(self) -> tuple[np.ndarray, ...]:
        return (np.zeros(SIZE, np.float32),)

    def log2_similarity(self, i: Any, j: Any, parameters: Any, offset: Any, stage: Any) -> Any:
        return -1.0 * (i[0] - j[0]) * (i[0] - j[0])


def test_kernels_with_features_of_others_are_not_recorded() -> None:
    frame, settings = make_frame(), {"quality": "fast", "device": "cpu"}
    with record_kernels() as usual:
        lobewise.denoise(frame, **settings)
    with record_kernels() as found:
        clean = lobewise.denoise(frame, features=[OwnPlaces()], **settings)
    assert clean.image.shape == (*SIZE, 3)
    passes = {name for name, wanted in usual.items() if isinstance(wanted.key, PassKey)}
    assert passes
    assert found.keys() == usual.keys() - passes
