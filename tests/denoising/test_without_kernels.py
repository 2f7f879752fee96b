"""Where no kernel can be had, Open Image Denoise denoises alone, and the user is told."""

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

import lobewise
from lobewise.backend import compiler, jit, prebuilt
from lobewise.cli.doctor import machine
from lobewise.denoising.combining import denoise_with_peer
from lobewise.denoising.plan import foretell_method
from lobewise.errors import InputError, MissingDependencyError
from lobewise.peers import has_oidn
from lobewise.records.frame import Frame, Radiance
from lobewise.settings import DenoiseSettings
from tests.mistakes import refuses

needs_oidn = pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[compare]'")


@pytest.fixture(autouse=True)
def no_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the compiler, the compiled kernels and those that are loaded already away."""
    monkeypatch.setattr(compiler, "is_installed", lambda: False)
    monkeypatch.setattr(prebuilt, "has_compiler", lambda: False)
    monkeypatch.setattr(prebuilt, "choose_library", lambda: None)
    monkeypatch.setattr(jit, "has_compiler", lambda: False)
    monkeypatch.setattr(jit, "choose_library", lambda: None)
    monkeypatch.setattr(jit, "_kernels", {})


@pytest.fixture
def frame(make_frame: Callable[..., Frame]) -> Frame:
    """Return a frame with albedo and normals, without light below 0."""
    return make_frame(height=20, width=24)


@needs_oidn
def test_the_result_is_the_image_of_the_peer(frame: Frame) -> None:
    result = lobewise.denoise(frame)
    np.testing.assert_array_equal(
        result.image, denoise_with_peer(frame, frame.radiance.color, frame.radiance.color, has_kernels=False).image
    )
    assert result.method == foretell_method(frame, DenoiseSettings())
    assert "alone, because no filter of lobewise can run here" in result.method
    assert "`lobewise doctor` says what to do" in result.notes[-1]
    assert not result.bad_pixels.any()


@needs_oidn
def test_bad_pixels_are_filled_and_light_below_0_is_kept(frame: Frame) -> None:
    color = frame.radiance.color.copy()
    color[3, 4], color[10:14, 10:14, 2] = np.nan, -0.25
    result = lobewise.denoise(frame.with_changes(radiance=Radiance(color)))
    assert result.bad_pixel_count == 1
    assert np.isfinite(result.image).all()
    without = np.where(color < 0.0, np.float32(0.0), color)
    above = lobewise.denoise(frame.with_changes(radiance=Radiance(without))).image
    np.testing.assert_allclose(above - result.image, np.where(color < 0.0, 0.25, 0.0), atol=1e-6)
    with refuses(InputError, "radiance"):
        lobewise.denoise(frame.with_changes(radiance=Radiance(np.full_like(color, np.nan))))


@needs_oidn
@pytest.mark.parametrize("settings", [{"quality": "fast"}, {"with_oidn": False}, {"form": "separable"}])
def test_filters_that_were_asked_for_are_refused(frame: Frame, settings: dict[str, str]) -> None:
    with refuses(MissingDependencyError, "kernels"):
        lobewise.denoise(frame, **settings)


def test_without_the_peer_the_compiler_is_asked_for(frame: Frame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lobewise.denoising.automatic.has_oidn", lambda: False)
    with refuses(MissingDependencyError, "kernels"):
        lobewise.denoise(frame)


@pytest.mark.parametrize(
    ("here", "words"),
    [
        (((3, 13), "linux", "x86_64"), "pip install 'lobewise[jit]'"),
        (((3, 14), "win32", "AMD64"), "use Python 3.10 to 3.13, for which Halide has wheels"),
        (((3, 12), "linux", "aarch64"), "use another machine: Halide has no wheel for Linux on aarch64"),
    ],
)
def test_the_remedy_is_one_that_works(here: tuple[tuple[int, int], str, str], words: str) -> None:
    assert compiler.choose_remedy(*here) == words


@pytest.mark.parametrize("peer", [True, False])
def test_doctor_says_what_to_do(peer: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lobewise.peers.has_oidn", lambda: peer)
    (found,) = machine.examine_kernels().problems
    assert found.action == "pip install 'lobewise[jit]'"
    assert found.fatal is not peer
    assert ("so Open Image Denoise denoises alone" in found.what) is peer


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is read from /proc")
def test_a_limit_of_memory_is_not_taken_for_a_missing_package() -> None:
    """A process gets 8 MiB more than it has: LLVM is installed, and larger than this."""
    script = """
import re, resource
from pathlib import Path
from lobewise.backend.compiler import load_llvm
used = int(re.search(r"VmSize:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) << 10
resource.setrlimit(resource.RLIMIT_AS, (used + (8 << 20), used + (8 << 20)))
load_llvm()
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    last = run.stderr.strip().splitlines()[-1]
    assert "they are installed, but do not load: raise the memory limit of this process (ulimit -v)" in last
    assert "pip install" not in last
