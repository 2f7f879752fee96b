"""Exported filters as a C programmer meets them: built by the system's compiler, run, and held against Python."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from lobewise.backend.devices import list_devices
from lobewise.cli.main import run
from lobewise.errors import DeviceError, FileError, InputError
from lobewise.exporting.example import MAX_DIFFERENCE, choose_bound
from lobewise.exporting.names import TARGETS
from lobewise.exporting.native import export_library
from lobewise.exporting.plan import FilterPlan
from lobewise.exporting.sample import make_sample
from lobewise.exporting.targets import parse_target

WARNINGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"]
QUICK = FilterPlan("sg", "separable", 3)


def build(folder: Path, command: str, compiler: str, source: str = "example.c") -> Path:
    """Build a program as the README says, with every warning an error; return its path."""
    words = command.split(" && ")[0].replace("example.c", source).split()
    assert words[0] == "cc"
    done = subprocess.run([compiler, *WARNINGS, *words[1:]], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "example"


def run_example(folder: Path) -> tuple[int, float]:
    """Return the exit code of the example and the difference that it prints."""
    settings = {**os.environ, "HL_VK_ALLOC_CONFIG": "0:256:0:0:256", "XDG_RUNTIME_DIR": str(folder)}
    done = subprocess.run([folder / "example"], cwd=folder, capture_output=True, text=True, env=settings)
    found = re.search(r"largest relative difference: (\S+)", done.stdout)
    assert found is not None, done.stderr
    return done.returncode, float(found[1])


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory, compiler: str) -> Path:
    """Return the folder of one export, its example built."""
    folder = tmp_path_factory.mktemp("quick") / "export"
    build(folder, export_library(folder, QUICK, target="host", name="quick"), compiler)
    return folder


def test_example_agrees_with_python(quick: Path) -> None:
    code, difference = run_example(quick)
    assert code == 0
    assert difference <= MAX_DIFFERENCE
    written = np.fromfile(quick / "output.raw", np.float32)
    expected = make_sample(QUICK).expected
    np.testing.assert_allclose(written.reshape(expected.shape), expected, rtol=MAX_DIFFERENCE)
    # Most pixels are filtered, by many neighbours; those without a lobe are 0.
    assert np.mean(expected[..., 4] > 4.0) > 0.5
    assert 0.01 < np.mean(expected[..., 3] == 0.0) < 0.5


def test_example_notices_a_difference(quick: Path) -> None:
    path = quick / "expected.raw"
    before = path.read_bytes()
    values = np.frombuffer(before, np.float32).copy()
    values[np.flatnonzero(values)[1000]] *= 1.0 + 3.0 * MAX_DIFFERENCE
    path.write_bytes(values.tobytes())
    code, difference = run_example(quick)
    values[0] = np.nan
    path.write_bytes(values.tobytes())
    undefined, _ = run_example(quick)
    path.write_bytes(before)
    assert code == 1
    assert difference == pytest.approx(3.0 * MAX_DIFFERENCE, rel=0.1)
    assert undefined == 1


PROGRAM = """
#include <stdio.h>
#include "quick.h"
static char last[300];
static void on_error(void *context, const char *message) { (void)context; snprintf(last, sizeof last, "%s", message); }
static float floats[8 * 64 * 32], results[8 * 64 * 32];
static uint8_t bytes[64 * 32];
int main(void)
{
    halide_dimension_t d[8][3];
    halide_buffer_t three = quick_floats(d[0], floats, 3, 40, 20), plane = quick_floats(d[1], floats, 0, 40, 20);
    halide_buffer_t mask = quick_bytes(d[2], bytes, 40, 20), out = quick_floats(d[3], results, 5, 40, 20);
    halide_buffer_t four = quick_floats(d[4], floats, 4, 40, 20), low = quick_floats(d[5], floats, 0, 40, 19);
    halide_buffer_t narrow = quick_floats(d[6], floats, 3, 39, 20), small = quick_floats(d[7], results, 5, 39, 20);
    halide_set_error_handler(on_error);
#define CALL(radiance, mask, depth, axis, screen, beta, out) \\
    last[0] = 0; \\
    printf("%d %s\\n", quick_filter(radiance, &three, mask, &three, depth, axis, &plane, screen, 16.0f, 0.002f, beta, \\
        out), last)
    CALL(&three, &mask, &plane, &three, 2.0f, 4.0f, &out);
    CALL(&four, &mask, &plane, &three, 2.0f, 4.0f, &out);
    CALL(&three, &plane, &plane, &three, 2.0f, 4.0f, &out);
    CALL(&three, &mask, &low, &three, 2.0f, 4.0f, &out);
    CALL(&narrow, &mask, &plane, &three, 2.0f, 4.0f, &out);
    CALL(&three, &mask, &plane, &four, 2.0f, 4.0f, &out);
    CALL(&three, &mask, &plane, &three, 0.0f, 4.0f, &out);
    CALL(&three, &mask, &plane, &three, 2.0f, -1.0f, &out);
    CALL(&three, &mask, &plane, &three, 2.0f, 4.0f, &small);
    CALL((halide_buffer_t *)0, &mask, &plane, &three, 2.0f, 4.0f, &out);
    last[0] = 0;
    printf("%d %s\\n", quick_lobes(&three, &three, &plane, &plane, 0.0f, 0.0f, 0.0f, 0.0f, &mask, &three, &plane),
        last);
    three.dim[1].extent = plane.dim[0].extent = mask.dim[0].extent = 3;
    printf("%d %s\\n", quick_lobes(&three, &three, &plane, &plane, 0.0f, 0.0f, 0.0f, 0.1f, &mask, &three, &plane),
        last);
    return 0;
}
"""


def test_wrong_buffers_are_refused(quick: Path, compiler: str) -> None:
    (quick / "wrong.c").write_text(PROGRAM)
    command = "cc wrong.c quick_lobes.o libquick.a -o wrong -lpthread -ldl -lm"
    build(quick, command, compiler)
    done = subprocess.run([quick / "wrong"], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    told = [(int(line.split(" ", 1)[0]), line.split(" ", 1)[1]) for line in lines]
    assert [code for code, _ in told[:2]] == [0, 0]
    assert all(code < 0 for code, _ in told[2:])
    for (_, message), word in zip(
        told[2:],
        ["mask", "depth", "radiance", "axis", "screen_sigma", "beta", "ut", "radiance", "tau", "ut"],
        strict=True,
    ):
        assert word in message


LAYOUTS = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "quick.h"
enum { W = 40, H = 20, ROOM = 8 * 64 * 32 };
static float *make(int channels, int stride, int row, unsigned seed)
{
    float *pixels = calloc(ROOM, sizeof(float));
    int x, y, c;
    for (y = 0; y < H; y++)
        for (x = 0; x < W; x++)
            for (c = 0; c < channels; c++) {
                seed = seed * 1664525u + 1013904223u;
                pixels[y * row + x * stride + c] = 0.5f + (float)(seed >> 8) / 16777216.0f;
            }
    return pixels;
}
static void filter(int stride, int padding, float *result)
{
    halide_dimension_t d[7][3];
    uint8_t *bytes = malloc(ROOM);
    halide_buffer_t colors, three, plane, sharp, mask, out, places;
    memset(bytes, 1, ROOM);
    colors = quick_floats(d[0], make(3, stride, stride * (W + padding), 1), stride, W, H);
    three = quick_floats(d[1], make(3, 3, 3 * (W + padding), 2), 3, W, H);
    plane = quick_floats(d[2], make(1, 1, W + padding, 3), 0, W, H);
    sharp = quick_floats(d[3], make(1, 1, W + padding, 4), 0, W, H);
    places = quick_floats(d[6], make(3, 3, 3 * (W + padding), 5), 3, W, H);
    mask = quick_bytes(d[4], bytes, W, H);
    out = quick_floats(d[5], result, 5, W, H);
    d[0][2].stride = stride * (W + padding);
    d[1][2].stride = d[6][2].stride = 3 * (W + padding);
    d[2][1].stride = d[3][1].stride = d[4][1].stride = W + padding;
    if (quick_filter(&colors, &three, &mask, &places, &plane, &three, &sharp, 2.0f, 16.0f, 0.1f, 4.0f, &out)) abort();
}
int main(void)
{
    float *tight = calloc(ROOM, sizeof(float)), *other = calloc(ROOM, sizeof(float));
    filter(3, 0, tight);
    filter(4, 0, other);
    printf("%d\\n", memcmp(tight, other, 5 * W * H * sizeof(float)));
    filter(3, 7, other);
    printf("%d\\n", memcmp(tight, other, 5 * W * H * sizeof(float)));
    printf("%d\\n", tight[5 * W + 20] > 0.4f && tight[5 * W + 23] > 2.0f);
    return 0;
}
"""


def test_padded_rows_and_four_channels_change_nothing(quick: Path, compiler: str) -> None:
    (quick / "layouts.c").write_text(LAYOUTS)
    build(quick, "cc layouts.c quick_lobes.o libquick.a -o layouts -lpthread -ldl -lm", compiler)
    done = subprocess.run([quick / "layouts"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "0", "1"]


def test_folder_says_what_is_there(quick: Path) -> None:
    readme, header = (quick / "README.md").read_text(), (quick / "quick.h").read_text()
    arguments = [*QUICK.filter_arguments, *QUICK.lobe_arguments]
    for argument in arguments:
        assert f"| `{argument.name}` |" in readme
        assert re.search(rf"(\*|float ){argument.name}[,)]", header)
        assert argument.text in readme
    assert re.search(r"\{\w*\}", readme) is None
    for word in re.findall(r"^\| `([^`*]+)`", readme.split("## Build")[0], flags=re.M):
        assert (quick / word).exists(), word
    told = json.loads((quick / "lobewise-export.json").read_text())
    assert [each["name"] for each in told["functions"]["quick_filter"]] == [
        argument.name for argument in QUICK.filter_arguments
    ]
    sample = make_sample(QUICK)
    numbers = re.findall(r"^        ([\d.e+-]+)f,? /\* (\w+) \*/$", (quick / "example.c").read_text(), flags=re.M)
    assert {name: np.float32(value) for value, name in numbers} == {
        name: np.float32(value) for name, value in sample.numbers.items()
    }


def test_constants_are_those_of_the_recipe(quick: Path) -> None:
    from lobewise.denoising import resolve_settings
    from lobewise.io import read_frame
    from lobewise.settings import DenoiseSettings

    frame = read_frame(Path(__file__).parents[2] / "src" / "lobewise" / "data" / "sample.exr")
    assert frame.camera is not None
    settings = resolve_settings(frame, DenoiseSettings(form="separable", radius=QUICK.radius))
    numbers = make_sample(QUICK).numbers
    assert numbers["position_sigma"] == settings.position_sigma
    assert numbers["pixel_angle"] == pytest.approx(frame.camera.get_pixel_angle(frame.height))
    for name in ("beta", "screen_sigma", "tau"):
        assert numbers[name] == pytest.approx(getattr(settings, name), rel=1e-6)


def test_folder_is_written_whole_or_not_at_all(quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileError, match="not empty"):
        export_library(quick, QUICK)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "thesis.tex").write_text("years of work")
    with pytest.raises(FileError, match="other things"):
        export_library(tmp_path / "own", QUICK, force=True)
    (tmp_path / "file").write_text("")
    for path in ("file", "none/export"):
        with pytest.raises(FileError):
            export_library(tmp_path / path, QUICK)

    (tmp_path / "here").mkdir()
    with monkeypatch.context() as context:
        context.chdir(tmp_path / "here")
        with pytest.raises(FileError, match="the current one"):
            export_library(".", QUICK)
    (tmp_path / "here").rmdir()

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "lobewise-export.json").write_text("{}")
    (tmp_path / "new").mkdir()
    monkeypatch.setattr("lobewise.exporting.native.compile_filter", fail)
    for path in ("old", "new", "fresh"):
        with pytest.raises(FileError, match="no space left"):
            export_library(tmp_path / path, QUICK, force=True)
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
    "plan",
    [
        FilterPlan("ggx", "separable", 8),
        pytest.param(FilterPlan("ggx", "full", 2, anisotropic=True, albedo=False), marks=pytest.mark.nightly),
        FilterPlan("asg", "separable", 4, anisotropic=True),
        FilterPlan("sg", "atrous", albedo=False),
        FilterPlan("sg_mixture", "full", 2, lobes=4),
        FilterPlan("normal", "full", 0),
        pytest.param(FilterPlan("diffuse", "separable", 8), marks=pytest.mark.nightly),
    ],
    ids=lambda plan: f"{plan.similarity}-{plan.form}",
)
def test_every_similarity_agrees_with_python(plan: FilterPlan, tmp_path: Path, compiler: str) -> None:
    folder = tmp_path / "export"
    target = "x86-64-linux-avx2-fma" if _has_avx2() else "host"
    build(folder, export_library(folder, plan, target=target), compiler)
    code, difference = run_example(folder)
    assert code == 0
    assert difference <= choose_bound(plan, parse_target(target).to_string())


def _has_avx2() -> bool:
    return "avx2" in parse_target("host").to_string().split("-")


@pytest.mark.nightly
@pytest.mark.vulkan
def test_example_runs_on_a_device(tmp_path: Path, compiler: str) -> None:
    vulkan = next(device for device in list_devices() if device.name == "vulkan")
    if not vulkan.available:
        assert "CI" not in os.environ, vulkan.reason
        pytest.skip(vulkan.reason)
    folder = tmp_path / "export"
    command = export_library(folder, FilterPlan("ggx", "separable", 4), target="host-vulkan")
    assert "HL_VK_ALLOC_CONFIG=0:256:0:0:256 ./example" in command
    build(folder, command, compiler)
    code, difference = run_example(folder)
    assert code == 0
    # Another arithmetic, but not another filter.
    assert 0.0 < difference < 1e-3


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


@pytest.mark.sampled("x86-64-linux")
@pytest.mark.parametrize("target", TARGETS)
def test_every_target_compiles(target: str, tmp_path: Path) -> None:
    folder = tmp_path / "export"
    apis = [api for api in MARKS if api in target.split("-")]
    # Lobes are made on the processor: where a device is named too, their code is that of the target without.
    export_library(folder, FilterPlan("normal" if apis else "sg", "full", 1), target=target, name="f")
    library = (folder / ("f.lib" if "windows" in target else "libf.a")).read_bytes()
    assert library.startswith(b"!<arch>\n")
    assert all(MARKS[api] in library for api in apis)
    assert apis or not any(mark in library for mark in MARKS.values())
    if target == "host" or apis:
        return
    processor, bits, system = target.split("-")[:3]
    kind = {"linux": "elf", "android": "elf", "osx": "macho", "ios": "macho", "windows": "coff", "wasmrt": "wasm"}
    lobes = folder / ("f_lobes.obj" if system == "windows" else "f_lobes.o")
    assert _name_machine(lobes.read_bytes()) == f"{processor}-{bits}-{kind[system]}"


@pytest.mark.parametrize(
    ("target", "word"),
    [
        ("amiga", "processor"),
        ("x86-64-linux-warp", "Halide knows"),
        ("x86-64-linux-metal", "another system"),
        ("arm-64-osx-d3d12compute", "another system"),
        ("x86-64-linux-cuda-vulkan", "at once"),
        ("hexagon-32-noos", "processor"),
    ],
)
def test_targets_that_are_none(target: str, word: str) -> None:
    with pytest.raises((InputError, DeviceError), match=word):
        parse_target(target)


def test_a_target_that_halide_cannot_compile_for(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"riscv-64-linux.*vector_bits.*lobewise export --help lists\.$"):
        export_library(tmp_path / "export", QUICK, target="riscv-64-linux")
    assert list(tmp_path.iterdir()) == []


def fail(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Run a line that must fail with the user's exit code; return its one sentence."""
    assert run(["export", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("lobewise: ")
    assert err.count("\n") == 1
    return err


def test_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = str(tmp_path / "out")
    assert "radius" in fail(capsys, "-o", folder, "--radius", "65")
    assert "lobes" in fail(capsys, "-o", folder, "--lobes", "1")
    assert "ggx" in fail(capsys, "-o", folder, "--similarity", "gxx")
    assert "separable" in fail(capsys, "-o", folder, "--form", "seperable")
    assert "anisotropic" in fail(capsys, "-o", folder, "--similarity", "sg", "--anisotropic")
    assert "identifier" in fail(capsys, "-o", folder, "--name", "my-filter")
    assert "--radius" in fail(capsys, "-o", folder, "--target", "wgsl", "--radius", "8")
    assert "--output" in fail(capsys, "--target", "wgsl")
    assert list(tmp_path.iterdir()) == []
    assert run(["export", "-o", folder, "--target", "glsl"]) == 0
    assert "lobewise.glsl" in capsys.readouterr().out
    assert run(["export", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for target in TARGETS:
        assert target in text


def test_arguments_of_every_plan_are_described() -> None:
    for similarity in ("normal", "diffuse", "sg", "sg_mixture", "asg", "ggx"):
        for anisotropic in (False, True) if similarity in ("asg", "ggx") else (False,):
            plan = FilterPlan(similarity, anisotropic=anisotropic)
            assert plan.filter_arguments[-1].channels == 5
            made = {argument.name for argument in plan.lobe_arguments if argument.role == "output"}
            needed = {argument.name for argument in plan.filter_arguments}
            assert made <= needed
