"""Exported pipelines on a graphics processor: Vulkan in software agrees with Python."""

import os
from pathlib import Path
from typing import Any

import pytest

from lobewise.backend.devices import list_devices
from lobewise.engine.graph import Operation
from lobewise.exporting.pipeline.driver import write_driver, write_header
from lobewise.exporting.pipeline.recording import make_pipeline
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.pipeline.writing import export_pipeline
from lobewise.exporting.targets import get_runtime_headers
from tests.exporting.conftest import lack, locate_program
from tests.exporting.pipelines import STRICT, build, run_example

VULKAN = "host-vulkan"


@pytest.mark.nightly
@pytest.mark.vulkan
@pytest.mark.parametrize(
    "settings",
    [
        {"form": "separable"},
        {"history": True, "hit_distance": True},
        {"history": True, "upsample": 2, "similarity": "sg"},
        {"plan": "balanced"},
        {"plan": "high", "halves": False},
    ],
    ids=str,
)
def test_pipelines_on_vulkan_agree_with_python(settings: dict[str, Any], compiler: str, tmp_path: Path) -> None:
    vulkan = next(device for device in list_devices() if device.name == "vulkan")
    if not vulkan.available:
        lack(vulkan.reason)
    export_pipeline(tmp_path / "out", PipelineSettings(radius=2, **settings), target=VULKAN)
    os.environ.setdefault("XDG_RUNTIME_DIR", "/tmp")
    found = run_example(tmp_path / "out", locate_program("g++", "g++"))
    # Another arithmetic, but not another filter.
    assert 0.0 < max(found) < 1e-3


def test_driver_for_a_device_is_c99_without_warnings(compiler: str, tmp_path: Path) -> None:
    pipeline = make_pipeline(PipelineSettings(history=True, hit_distance=True), target=VULKAN)
    (tmp_path / "lobewise.c").write_text(write_driver(pipeline))
    (tmp_path / "lobewise.h").write_text(write_header(pipeline))
    headers = get_runtime_headers(pipeline.target)[0].parent
    build(tmp_path, compiler, "-std=c99", "-O2", *STRICT, f"-I{headers}", "-c", "lobewise.c", "-o", "strict.o")


@pytest.mark.parametrize("plan", ["fast", "balanced"])
def test_neighbours_are_read_on_the_device_and_pixels_on_the_processor(plan: str) -> None:
    operations = make_pipeline(PipelineSettings(plan=plan), target=VULKAN).graph.operations
    there = {each.text for each in operations if each.on_device}
    assert not any(each.on_device for each in operations if each.in_box or not each.is_kernel)
    assert any("kernel" in text or "taps" in text for text in there)
    assert "bad pixels" not in there


def test_images_between_kernels_of_the_device_are_not_copied() -> None:
    """The sums of a row pass go to the column pass, which alone reads them."""
    pipeline = make_pipeline(PipelineSettings(form="separable"), target=VULKAN)
    steps: list[Operation] = [each for each in pipeline.graph.operations if each.on_device]
    driver = write_driver(pipeline)
    for first, second in zip(steps[::2], steps[1::2], strict=True):
        (sums,) = first.writes
        assert sums in second.reads
        assert f"begin_on_host(p, (const int[]){{IMAGE_{sums.name}" not in driver
