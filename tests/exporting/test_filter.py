"""Exported filters as a C programmer meets them: built by the system's compiler, run, and held against Python."""

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.performance.pipelines import Library, pack_frame
from lobewise.backend.devices import list_devices
from lobewise.cli.program import run
from lobewise.denoising import resolve_settings
from lobewise.errors import DeviceError, FileError, InputError
from lobewise.exporting.names import TARGETS
from lobewise.exporting.pipeline.recording import filter_alone, make_pipeline
from lobewise.exporting.pipeline.sample import collect_images, make_settings, prepare_frame
from lobewise.exporting.pipeline.scene import SPP, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.pipeline.writing import (
    MAX_DIFFERENCE,
    choose_bound,
    compile_kernels,
    export_pipeline,
    write_texts,
)
from lobewise.exporting.targets import parse_target
from tests.exporting.conftest import lack, locate_program
from tests.exporting.pipelines import run_example
from tests.mistakes import refuses

QUICK = PipelineSettings(plan="filter", similarity="sg", form="separable", radius=3)


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory, compiler: str) -> Path:
    """Return the folder of one export, its example built."""
    folder = tmp_path_factory.mktemp("quick") / "export"
    export_pipeline(folder, QUICK)
    run_example(folder, locate_program("g++", "g++"))
    return folder


def test_c_finds_what_python_finds(quick: Path) -> None:
    """The filtered light, the sum of the weights and the effective samples; the last two only if they are wanted."""
    frame = prepare_frame(QUICK, make_frame(0))
    resolved, guides = resolve_settings(frame, make_settings(QUICK)), frame.gbuffer
    expected = filter_alone(frame, QUICK, resolved, (), frame.radiance.color, guides.diffuse_albedo)
    given = {
        name: np.ascontiguousarray(each) for name, each in collect_images(make_pipeline(QUICK).graph, frame).items()
    }
    told = json.loads((quick / "lobewise-export.json").read_text())
    camera, library = frame.require_camera("a filter"), Library(quick, frame.shape)
    library.set(samples_per_pixel=SPP)
    for is_wanted in (False, True):
        found = [np.zeros((*frame.shape, 3), np.float32), *(np.zeros(frame.shape, np.float32) for _ in range(2))]
        packed = pack_frame(given, (0, 0), found[0], told)
        if is_wanted:
            packed.weight_sum, packed.effective_samples = (each.ctypes.data for each in found[1:])
        view = [*camera.position, *camera.forward, *camera.up, camera.fov_y, 0.0, *camera.shift]
        library.run(view, packed)
        np.testing.assert_allclose(found[0], expected.image, rtol=MAX_DIFFERENCE)
        for image, other in zip(found[1:], (expected.weight_sum, expected.effective_samples), strict=True):
            np.testing.assert_allclose(image, other if is_wanted else 0.0, rtol=MAX_DIFFERENCE)
    library.free()
    # Most pixels are filtered, by many neighbours; those without a lobe are 0.
    assert np.mean(expected.effective_samples > 4.0) > 0.5
    assert 0.01 < np.mean(expected.weight_sum == 0.0) < 0.5


def test_example_notices_a_difference(quick: Path) -> None:
    path = quick / "expected.raw"
    before = path.read_bytes()
    values = np.frombuffer(before, np.float32).copy()
    codes = []
    for changed in (values[np.flatnonzero(values)[1000]] * (1.0 + 10.0 * MAX_DIFFERENCE), np.nan):
        values[np.flatnonzero(values)[1000]] = changed
        path.write_bytes(values.tobytes())
        codes.append(subprocess.run(["./example"], cwd=quick, capture_output=True).returncode)
    path.write_bytes(before)
    assert codes == [1, 1]


def test_folder_says_what_is_there(quick: Path) -> None:
    readme, header = (quick / "README.md").read_text(), (quick / "lobewise.h").read_text()
    told = json.loads((quick / "lobewise-export.json").read_text())
    names = [each["name"] for each in (*told["inputs"], *told["results"])]
    assert names == [*("radiance", "albedo", "normal", "alpha", "depth"), *("image", "weight_sum", "effective_samples")]
    for each in names:
        assert f"| `{each}` |" in readme
        assert f"float *{each};" in header
    assert "image_i = sum_j" in readme
    assert "${" not in readme


def test_folder_is_written_whole_or_not_at_all(quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with refuses(FileError, "output 'export'", "one that is not empty"):
        export_pipeline(quick, QUICK)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "thesis.tex").write_text("years of work")
    with refuses(FileError, "output 'own'"):
        export_pipeline(tmp_path / "own", QUICK, force=True)
    (tmp_path / "file").write_text("")
    for path in ("file", "none/export"):
        with pytest.raises(FileError):
            export_pipeline(tmp_path / path, QUICK)

    (tmp_path / "here").mkdir()
    with monkeypatch.context() as context:
        context.chdir(tmp_path / "here")
        with refuses(FileError, "output '.'"):
            export_pipeline(".", QUICK)
    (tmp_path / "here").rmdir()

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "lobewise-export.json").write_text("{}")
    (tmp_path / "new").mkdir()
    monkeypatch.setattr("lobewise.exporting.pipeline.writing.compile_kernels", fail)
    for path in ("old", "new", "fresh"):
        with refuses(FileError, expected="a folder that can be written"):
            export_pipeline(tmp_path / path, QUICK, force=True)
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
        "file",
        "new",
        "old",
        "old/lobewise-export.json",
        "own",
        "own/thesis.tex",
    ]


@pytest.mark.nightly
@pytest.mark.parametrize(
    "settings",
    [
        {"similarity": "ggx", "form": "separable", "radius": 8},
        {"similarity": "ggx", "anisotropic": True, "albedo": False},
        {"similarity": "ggx", "form": "atrous", "anisotropic": True, "lobe_kind": True, "position": True},
        {"similarity": "sg", "form": "atrous", "albedo": False},
        {"similarity": "sg_mixture", "lobes": 4},
        {"similarity": "normal", "radius": 0},
        {"similarity": "diffuse", "form": "separable"},
    ],
    ids=str,
)
def test_every_similarity_agrees_with_python(settings: dict[str, Any], tmp_path: Path, compiler: str) -> None:
    made = PipelineSettings(**{"plan": "filter", "radius": 2, **settings})
    export_pipeline(tmp_path / "export", made)
    found = run_example(tmp_path / "export", locate_program("g++", "g++"))
    assert max(found) <= choose_bound(parse_target("host").to_string())


@pytest.mark.nightly
@pytest.mark.vulkan
def test_a_filter_runs_on_a_device(tmp_path: Path, compiler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    vulkan = next(device for device in list_devices() if device.name == "vulkan")
    if not vulkan.available:
        lack(vulkan.reason)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    export_pipeline(tmp_path / "export", replace(QUICK, similarity="normal", radius=1), target="host-vulkan")
    # Another arithmetic, but not another filter.
    assert 0.0 < max(run_example(tmp_path / "export", locate_program("g++", "g++"))) < 1e-3
    nowhere = {**os.environ, "VK_DRIVER_FILES": "/none", "VK_ICD_FILENAMES": "/none"}
    done = subprocess.run(["./example"], cwd=tmp_path / "export", env=nowhere, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert "the device of the target cannot be used" in done.stderr


def test_programs_are_linked_with_what_a_device_needs() -> None:
    texts = write_texts(make_pipeline(QUICK, target="arm-64-osx-metal"))
    for name in ("lobewiseConfig.cmake", "lobewise.pc"):
        assert "-Wl,-framework,Metal" in texts[name]
        assert "Metal" not in write_texts(make_pipeline(QUICK))[name]


MARKS = {
    "cuda": b".visible .entry",
    "vulkan": b"\x03\x02\x23\x07",
    "opencl": b"__kernel",
    "d3d12compute": b"numthreads",
    "metal": b"kernel void",
    "webgpu": b"@compute",
}
"""What tells that a library holds code for a device."""


def _name_machine(code: bytes) -> str:
    """Return processor and system of an object file, from its first bytes."""
    if code[:4] == b"\x7fELF":
        return {62: "x86-64", 183: "arm-64"}[int.from_bytes(code[18:20], "little")] + "-elf"
    if code[:4] == b"\xcf\xfa\xed\xfe":
        return {0x01000007: "x86-64", 0x0100000C: "arm-64"}[int.from_bytes(code[4:8], "little")] + "-macho"
    if code[:4] == b"\0asm":
        return "wasm-32-wasm"
    return {0x8664: "x86-64", 0xAA64: "arm-64"}[int.from_bytes(code[:2], "little")] + "-coff"


@pytest.mark.sampled("x86-64-linux", "arm-64-osx-metal")
@pytest.mark.parametrize("target", TARGETS)
def test_every_target_compiles(target: str) -> None:
    apis = [api for api in MARKS if api in target.split("-")]
    pipeline = make_pipeline(replace(QUICK, similarity="normal", form="full", radius=1), target=target, name="f")
    objects = compile_kernels(pipeline, target)
    content = b"".join(each for _, each in objects)
    assert all(kernel.symbol.encode() in content for kernel in pipeline.kernels)
    kernels = b"".join(each for name, each in objects if "runtime" not in name)
    assert all(MARKS[api] in kernels for api in apis)
    assert apis or not any(mark in kernels for mark in MARKS.values())
    if target == "host":
        return
    processor, bits, system = target.split("-")[:3]
    kind = {"linux": "elf", "android": "elf", "osx": "macho", "ios": "macho", "windows": "coff", "wasmrt": "wasm"}
    assert {_name_machine(each) for _, each in objects} == {f"{processor}-{bits}-{kind[system]}"}


@pytest.mark.parametrize(
    ("target", "refused"),
    [
        ("amiga", ("target", "'amiga'")),
        ("x86-64-linux-warp", ("target", "'x86-64-linux-warp'")),
        ("x86-64-linux-metal", ("target 'x86-64-linux-metal'",)),
        ("arm-64-osx-d3d12compute", ("target 'arm-64-osx-d3d12compute'",)),
        ("x86-64-linux-cuda-vulkan", ("target 'x86-64-linux-cuda-vulkan-vk_v13-vk_int8-vk_int16'",)),
        ("hexagon-32-noos", ("target", "'hexagon-32-noos'")),
    ],
)
def test_targets_that_are_none(target: str, refused: tuple[str, ...]) -> None:
    with refuses((InputError, DeviceError), *refused):
        parse_target(target)


def test_a_target_that_halide_cannot_compile_for(tmp_path: Path) -> None:
    with refuses(DeviceError, "target 'riscv-64-linux'"):
        export_pipeline(tmp_path / "export", QUICK, target="riscv-64-linux")
    assert list(tmp_path.iterdir()) == []


def test_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = str(tmp_path / "out")
    assert run(["export", "functions", "glsl", "-o", folder]) == 0
    assert "lobewise.glsl" in capsys.readouterr().out
    assert run(["export", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for target in TARGETS:
        assert target in text
