"""Limits of memory and time: what would take more is refused in a sentence, and what fits has the same bits."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise import peers
from lobewise.cli.program import run
from lobewise.denoising.plan import count_bytes, estimate_work_bytes
from lobewise.errors import InputError, LimitError
from lobewise.peers import MIN_LIBRARY_BYTES, bound_library_memory, denoise_oidn, has_oidn
from lobewise.records.frame import Frame
from lobewise.work import limits
from lobewise.work.limits import GIB, get_limits, limit_call, require_memory, set_aside
from tests.cli.lines import fail
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

SHAPE = (83, 19)


@pytest.fixture
def frame(make_frame: Callable[..., Frame]) -> Frame:
    """Return a small frame."""
    return make_frame(height=24, width=32)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], float]:
    """Return a function that makes the smallest limit, 1 GiB, leave so many bytes for frames and filters."""

    def leave(count: float) -> float:
        monkeypatch.setattr(limits, "PROGRAM_GIB", limits.MAX_SHARE_OF_MEMORY - count / GIB)
        return 1.0

    return leave


def test_a_frame_that_needs_more_memory_is_refused_before_it_is_filtered(
    frame: Frame, tiny: Callable[[float], float]
) -> None:
    needed = count_bytes(frame) + estimate_work_bytes(frame, 24 * 32, "fast", with_oidn=False)
    expected = lobewise.denoise(frame, quality="fast").image
    with limit_call(max_memory=tiny(1.01 * needed)):
        np.testing.assert_array_equal(lobewise.denoise(frame, quality="fast").image, expected)
    with limit_call(max_memory=tiny(0.99 * needed)):
        with refuses(LimitError, "memory", "one that needs 1.1 GiB"):
            lobewise.denoise(frame, quality="fast")
        with pytest.raises(LimitError):
            lobewise.TemporalFilter().add(frame)
        with pytest.raises(LimitError):
            lobewise.WindowFilter(1, quality="fast").denoise([frame, frame], 0)
    with limit_call(max_memory=tiny(1000.0)), pytest.raises(LimitError):
        lobewise.upsample(lobewise.make_sparse(frame, 2))
    assert get_limits() == limits.Limits()


def test_files_are_refused_before_they_are_decoded(tmp_path: Path, tiny: Callable[[float], float]) -> None:
    own, foreign = tmp_path / "own.exr", Path(__file__).parent / "data" / "foreign" / "blender_4.5_seed1.exr"
    lobewise.write_frame(own, make_scene(SHAPE))
    for path in (own, foreign):
        with (
            limit_call(max_memory=tiny(1000.0)),
            refuses(LimitError, expected="a frame that can be filtered within 1 GiB"),
        ):
            lobewise.read_frame(path)


def test_bands_fit_the_limit(tmp_path: Path, tiny: Callable[[float], float]) -> None:
    source, target = tmp_path / "in.exr", tmp_path / "out.exr"
    lobewise.write_frame(source, make_scene((500, 19)))
    asked: dict[str, Any] = {"quality": "fast", "similarity": "normal", "radius": 2, "with_oidn": False}
    whole = lobewise.denoise_file(source, target, **asked)
    expected = target.read_bytes()
    with limit_call(max_memory=tiny(19 * 300 * 400)):
        assert lobewise.denoise_file(source, target, **asked).bands > whole.bands == 1
    assert target.read_bytes() == expected
    with limit_call(max_memory=tiny(1000.0)), pytest.raises(LimitError):
        lobewise.denoise_file(source, target, **asked)
    assert target.read_bytes() == expected


def test_time_ends_calls(frame: Frame, tmp_path: Path) -> None:
    path, target = tmp_path / "in.exr", tmp_path / "out.exr"
    lobewise.write_frame(path, frame)
    target.write_bytes(b"before")
    with limit_call(max_seconds=1e-6):
        for call in (
            lambda: lobewise.denoise(frame, quality="fast"),
            lambda: lobewise.read_frame(path),
            lambda: lobewise.write_frame(target, frame),
            lambda: lobewise.denoise_file(path, target, quality="fast"),
        ):
            with refuses(LimitError, "max_seconds", expected="an end within 1e-06 seconds"):
                call()
    assert target.read_bytes() == b"before"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["in.exr", "out.exr"]


def test_inner_limits_only_tighten() -> None:
    with limit_call(max_memory=4.0, max_seconds=100.0):
        outer = get_limits()
        with limit_call(max_memory=8.0, max_seconds=1000.0):
            assert get_limits() == outer
        with limit_call(max_memory=2.0):
            assert get_limits() == replace(outer, memory=2.0)
        with limit_call(max_seconds=10.0):
            assert get_limits().deadline < outer.deadline
        with set_aside(2.0 * GIB):
            # 4 * 0.9 - 0.5 - 2
            require_memory(1.0 * GIB)
            with refuses(LimitError, "memory", "one that needs 4.2 GiB", "a frame that can be filtered within 4 GiB"):
                require_memory(1.2 * GIB)


def test_limits_are_checked() -> None:
    wrong: list[dict[str, Any]] = [{"max_memory": value} for value in (0.5, -1.0, float("nan"))]
    wrong += [{"max_seconds": value} for value in (0.0, -1.0, float("nan"))]
    for each in wrong:
        with refuses(InputError, next(iter(each))), limit_call(**each):
            pass


@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[compare]'")
def test_open_image_denoise_works_in_tiles_that_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The library's tiles have the bits of the whole."""
    monkeypatch.setattr(peers, "LIBRARY_BYTES_PER_PIXEL", 2000)
    light = np.random.default_rng(0).random((900, 1000, 3), dtype=np.float32)
    whole, _ = denoise_oidn(Frame(lobewise.Radiance(light)), quality="fast")
    with bound_library_memory(MIN_LIBRARY_BYTES):
        tiles, _ = denoise_oidn(Frame(lobewise.Radiance(light)), quality="fast")
    np.testing.assert_array_equal(tiles, whole)


@pytest.mark.skipif(sys.platform != "linux", reason="measures memory as Linux does")
@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[compare]'")
@pytest.mark.nightly
def test_a_process_stays_within_its_limit() -> None:
    program = """
import sys
import numpy as np
import lobewise
from tests.fuzz.worker import read_status
light = np.random.default_rng(0).random((1500, 2000, 3), dtype=np.float32)
with lobewise.limit_call(max_memory=float(sys.argv[1])):
    lobewise.denoise(lobewise.Frame(lobewise.Radiance(light), lobewise.GBuffer(normal=light, diffuse_albedo=light)))
print(read_status("VmHWM") / 2**30)
"""

    def measure_peak(limit: float) -> float:
        command = [sys.executable, "-c", program, str(limit)]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    assert measure_peak(2.2) < min(2.2, 0.9 * measure_peak(100.0))


def test_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = Path(__file__).parent / "data" / "foreign" / "blender_4.5_seed1.exr"
    target = tmp_path / "out.exr"
    words = ["denoise", str(source), "-o", str(target), "--quality", "fast", "--progress", "off"]
    fail(capsys, *words, "--max-seconds", "0.000001", what="--max-seconds", expected="an end within 1e-06 seconds")
    assert not target.exists()
    assert run([*words, "--max-seconds", "100", "--max-memory", "2GiB"]) == 0
