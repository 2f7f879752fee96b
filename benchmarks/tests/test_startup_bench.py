"""The benchmark of whole processes gives both programs the same pixels, and its page says what it found."""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from lobewise.io import read_frame
from lobewise.peers import has_oidn
from lobewise.records.frame import FloatArray, Frame


@pytest.fixture
def startup() -> ModuleType:
    """Return benchmarks/performance/startup.py."""
    pytest.importorskip("mitsuba")
    pytest.importorskip("scipy")
    from benchmarks.performance import startup

    return startup


@pytest.fixture
def page() -> ModuleType:
    """Return benchmarks/pages/bench.py."""
    from benchmarks.pages import bench

    return bench


def make_gradient() -> FloatArray:
    """Return an image without noise whose four corners differ."""
    y, x = np.mgrid[0:48, 0:64] / 64.0
    return np.stack([0.2 + x, 0.2 + y, 0.5 + 0.0 * x], axis=-1).astype(np.float32)


def test_pfm_files_are_as_their_format_says(startup: ModuleType, tmp_path: Path) -> None:
    image = make_gradient()
    startup.write_pfm(tmp_path / "a.pfm", image)
    data = (tmp_path / "a.pfm").read_bytes()
    assert data.startswith(b"PF\n64 48\n-1.0\n")
    # The first row of the file is the lowest.
    assert data[len(b"PF\n64 48\n-1.0\n") :][: 64 * 12] == image[-1].tobytes()
    np.testing.assert_array_equal(startup.read_pfm(tmp_path / "a.pfm"), image)


def test_both_programs_get_the_same_pixels(startup: ModuleType, full_frame: Frame, tmp_path: Path) -> None:
    startup.write_inputs(full_frame, tmp_path)
    lean = read_frame(tmp_path / "lean.exr")
    for name in ("color", "diffuse", "specular"):
        # Halves have 11 bits, and none of a value below 1e-7.
        image, whole = getattr(lean.radiance, name), getattr(full_frame.radiance, name)
        np.testing.assert_allclose(image, whole, rtol=5e-4, atol=1e-7)
    np.testing.assert_array_equal(startup.read_pfm(tmp_path / "color.pfm"), full_frame.radiance.color)
    np.testing.assert_array_equal(startup.read_pfm(tmp_path / "normal.pfm"), full_frame.gbuffer.normal)
    assert startup.describe_input(tmp_path / "lean.exr")["channels"] == 9 + 16
    assert lean.half_a is None


@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[compare]'")
def test_the_peer_leaves_an_image_without_noise_where_it_was(startup: ModuleType, tmp_path: Path) -> None:
    image = make_gradient()
    startup.write_pfm(tmp_path / "color.pfm", image)
    startup.write_pfm(tmp_path / "albedo.pfm", np.ones_like(image))
    startup.write_pfm(tmp_path / "normal.pfm", np.zeros_like(image) + np.float32([0.0, 0.0, 1.0]))
    startup.make_oidn_call(tmp_path, "fast")()
    found = startup.read_pfm(tmp_path / "oidn-fast.pfm")
    # The network is no identity, but it turns nothing round.
    for turned in (image[::-1], image[:, ::-1]):
        assert np.abs(found - image).mean() < 0.1 * np.abs(found - turned).mean()


def test_a_program_that_fails_ends_the_run(startup: ModuleType) -> None:
    with pytest.raises(SystemExit, match="failed"):
        startup.run_program([sys.executable, "-c", "raise SystemExit(3)"])


def make_startup(help_milliseconds: float) -> dict[str, Any]:
    """Return figures as the benchmark writes them."""
    return {
        "machine": {"processor": "Abacus", "threads": 2, "commit": "abc"},
        "help": {"lobewise --help": {"milliseconds": help_milliseconds, "ratio_to_python": 15.0}},
        "width": 1920,
        "height": 1080,
        "files": {name: {"megabytes": 12.4, "channels": 33} for name in ("whole", "lean")},
        "denoise": {
            "fast, sg, again": {"seconds": 2.5, "seconds_filtering": 0.75, "times oidnDenoise": 2.75},
            "oidnDenoise": {"seconds": 6.875, "times oidnDenoise": 1.0},
        },
    }


def test_the_page_says_what_was_measured(page: ModuleType) -> None:
    figures = page.make_startup(make_startup(250.0))
    text = "\n".join(figures.values())
    assert "| `lobewise --help` | 250 ms | 15.0 |" in text
    assert "| fast, sg, again | 2.50 s | 0.75 s | 2.75 |" in text
    assert "| `oidnDenoise` | 6.88 s |  | 1.00 |" in text
    assert "12 MB, 33 channels" in text
    assert "at most 300 ms for `lobewise --help`, met" in text
    assert "`lobewise --help`, missed" in page.make_startup(make_startup(301.0))["processes-run"]


def test_every_machine_has_its_chapter(page: ModuleType) -> None:
    row = {"part": "upsampling", "name": "bilinear", "device": "cpu", "width": 64, "height": 48, "milliseconds": 12.0}
    machine = {
        "machine": {"processor": "Abacus", "threads": 1, "version": "0.1.0"},
        "devices": {"cpu": "beads"},
        "skipped": ["Nothing."],
        "rows": [row, {**row, "name": "normal", "milliseconds": 20.0}],
    }
    text = page.make_machines({"old": machine, "older": machine})
    assert text.count("## old\n") == text.count("## older\n") == 1
    assert text.count("### Upsampling, 64x48") == 2
    assert "| bilinear | cpu | 12.0 | 0.60 |" in text
    assert "Left out: Nothing." in text
