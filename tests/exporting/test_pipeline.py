"""Exported pipelines: C++ agrees with Python, the steps are those of the plan, and memory is shared out safely."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.performance.pipelines import Library, pack_frame
from lobewise.cli.program import run
from lobewise.denoising.automatic import choose_beta, choose_screen_sigma, choose_tau
from lobewise.engine.graph import Graph, group_bands
from lobewise.engine.memory import check_places, list_spans, plan_memory
from lobewise.engine.numbers import Number, choose_larger, raise_to, round_single, write_number
from lobewise.errors import InputError
from lobewise.exporting.pipeline.constants import Constants
from lobewise.exporting.pipeline.driver import write_driver, write_header
from lobewise.exporting.pipeline.recording import make_pipeline
from lobewise.exporting.pipeline.sample import FRAMES, collect_images, prepare_frame, run_recipe
from lobewise.exporting.pipeline.scene import HEIGHT, SPP, WIDTH, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.guides.lobe_fields import default_tau
from tests.exporting.conftest import locate_program
from tests.exporting.pipelines import LIBRARIES, STRICT, build, export, run_example
from tests.mistakes import refuses

RADIUS = 3


@pytest.fixture(scope="module")
def fast(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the plan fast."""
    return export(tmp_path_factory.mktemp("fast") / "out", radius=RADIUS)


def test_numbers_keep_their_expressions() -> None:
    number = Number(3.0, "p->x")
    assert write_number(2.0 / (number * number) - 1) == "((2.0 / (p->x * p->x)) - 1.0)"
    assert write_number(number**2) == "(p->x * p->x)"
    assert write_number(choose_larger(raise_to(number, 0.5), -1.0)) == "fmax(pow(p->x, 0.5), (-1.0))"
    assert float(2.0 / (number * number) - 1) == pytest.approx(2.0 / 9.0 - 1.0)
    third = round_single(1.0 / number)
    assert float(third) == float(np.float32(1.0 / 3.0))
    assert third.is_single


@pytest.mark.parametrize("spp", [0.5, 1.0, 4.0, 64.0, 4096.0])
@pytest.mark.parametrize("radius", [0, 8])
def test_automatic_numbers_are_those_of_the_recipe(spp: float, radius: int) -> None:
    constants = Constants(1, radius, False, spp=spp)
    pixel_tau = default_tau(constants.camera, constants.size[0])
    assert float(constants.beta) == choose_beta(spp)
    assert float(constants.screen_sigma) == choose_screen_sigma(spp, radius)
    assert float(constants.tau) == pytest.approx(choose_tau(spp, pixel_tau), rel=1e-15)


@pytest.mark.sampled("settings0", "settings4", "settings5")
@pytest.mark.parametrize(
    "settings",
    [
        PipelineSettings(),
        PipelineSettings(layers="color", form="separable"),
        PipelineSettings(history=True, hit_distance=True),
        PipelineSettings(upsample=4, radius=5),
        PipelineSettings(upsample=4, radius=5, history=True),
        PipelineSettings(plan="balanced"),
    ],
)
def test_no_number_of_a_frame_is_compiled_in(settings: PipelineSettings) -> None:
    """The program is the same whatever example values its numbers had."""
    other = Constants(settings.upsample, settings.radius, settings.is_guided, size=(30, 500), spp=77.0)
    pipelines = [make_pipeline(settings), make_pipeline(settings, constants=other)]
    assert write_driver(pipelines[0]) == write_driver(pipelines[1])
    assert write_header(pipelines[0]) == write_header(pipelines[1])


@pytest.mark.parametrize("history", [False, True])
def test_images_that_are_needed_at_once_lie_apart(history: bool) -> None:
    graph = make_pipeline(PipelineSettings(history=history)).graph
    plan, spans = plan_memory(graph, 1.0), list_spans(graph)
    for image, (first, last) in spans.items():
        for other, (start, stop) in spans.items():
            if other is not image and plan.slots[other.name] == plan.slots[image.name]:
                assert last < start or stop < first, f"{image.name} and {other.name}"
    whole = sum(image.count_bytes(1.0) for image in spans)
    assert plan.made_bytes < 0.6 * whole


@pytest.mark.sampled("high-named-halves", "balanced-color-whole")
@pytest.mark.parametrize("halves", [True, False], ids=["halves", "whole"])
@pytest.mark.parametrize("layers", ["apart", "color", "named"])
@pytest.mark.parametrize("plan", ["balanced", "high"])
def test_what_the_next_band_reads_keeps_its_place(plan: Any, layers: Any, halves: bool) -> None:
    graph = make_pipeline(PipelineSettings(plan=plan, layers=layers, halves=halves)).graph
    # Bands serve what is taken back.
    assert any(operation.in_band for operation in graph.operations)
    plan_memory(graph, 1.0)


def test_a_place_that_is_taken_too_early_is_noticed() -> None:
    """Without groups of bands, the result of the first band would overwrite what the second one reads."""
    graph = make_pipeline(PipelineSettings(plan="balanced")).graph
    plan = plan_memory(graph, 1.0)
    (group,) = (group for group in group_bands(graph.operations) if group[0].in_band)
    read, written = group[0].reads[0].memory, group[-1].writes[0].memory
    assert plan.slots[read.name] != plan.slots[written.name]
    with pytest.raises(AssertionError, match=f"reads {read.name} from the place of {written.name}"):
        check_places(graph, {**plan.slots, written.name: plan.slots[read.name]})


def test_a_call_must_fit_its_kernel() -> None:
    graph = Graph()
    pipeline = make_pipeline(PipelineSettings())
    kernel = next(each for each in pipeline.kernels if each.name == "cross pass")
    image = graph.make("image", "height", "width")
    with pytest.raises(AssertionError, match="source"):
        graph.call(
            kernel.symbol, dict.fromkeys((each.name for each in kernel.parameters), image), kernel.parameters, ""
        )


def test_cpp_agrees_with_python(fast: Path, cpp: str) -> None:
    found = run_example(fast, cpp)
    assert len(found) == FRAMES
    assert max(found) <= 1e-5
    made, expected = (np.fromfile(fast / f"{name}.raw", np.float32) for name in ("output", "expected"))
    images = made.reshape(FRAMES, HEIGHT, WIDTH, 3)
    assert made.size == expected.size
    assert np.isfinite(images).all()
    assert (images.std(axis=(1, 2, 3)) > 0.05).all()


BALANCED: dict[str, Any] = {"plan": "balanced"}
HISTORY: dict[str, Any] = {"history": True}
SAME_BITS: list[dict[str, Any]] = [
    {"layers": "named"},
    {"upsample": 2, "coverage": True, "rays": True},
]
SETTINGS: list[dict[str, Any]] = [
    *SAME_BITS,
    {"emission": True},
    {**BALANCED, "emission": True},
    BALANCED,
    {**BALANCED, "layers": "color", "similarity": "normal"},
    {**BALANCED, "layers": "color", "halves": False},
    {**BALANCED, "halves": False},
    {**BALANCED, "layers": "named"},
    {**BALANCED, "coverage": True},
    {"plan": "high"},
    {"plan": "high", "halves": False, "layers": "color"},
    {"plan": "high", "layers": "named"},
    {"upsample": 2},
    {**HISTORY, "upsample": 3, "hit_distance": True},
    {**HISTORY, "layers": "color", "form": "separable", "similarity": "sg"},
    {**HISTORY, "motion": False, "position": True, "similarity": "normal", "form": "atrous"},
    {**HISTORY, "anisotropic": True, "lobe_kind": True},
]


@pytest.mark.nightly
@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_every_plan_and_option_agrees_with_python(settings: dict[str, Any], cpp: str, tmp_path: Path) -> None:
    folder = export(tmp_path / "out", radius=2, **settings)
    assert max(run_example(folder, cpp)) <= (0.0 if settings in SAME_BITS else 1e-5)
    images = np.fromfile(folder / "output.raw", np.float32).reshape(FRAMES, HEIGHT, WIDTH, 3)
    assert (images.std(axis=(1, 2, 3)) > 0.05).all()
    shapes = {
        each["name"]: each["shape"] for each in json.loads((folder / "lobewise-export.json").read_text())["inputs"]
    }
    halves = "plan" in settings and settings.get("halves", True)
    assert ({"half_a_color", "half_b_color"} <= set(shapes)) == (halves and "emission" not in settings)
    assert ("color" in shapes) == (not halves and "emission" not in settings)
    assert ("emission" in shapes) == ("emission" in settings or "upsample" in settings)
    if "upsample" in settings:
        assert shapes["diffuse"] == ["rows", "columns", 3]
        assert shapes["normal"] == ["height", "width", 3]


def test_holes_are_filled_inside_a_box(fast: Path) -> None:
    """A frame larger than the reach of the filling: only the box around the holes is computed."""
    size = (200, 320)
    settings = PipelineSettings(radius=RADIUS)
    frame = prepare_frame(settings, make_frame(0, size=size))
    (expected,) = run_recipe(settings, [frame])
    pipeline, image = Library(fast, size), np.empty((*size, 3), np.float32)
    given = {
        name: np.ascontiguousarray(each) for name, each in collect_images(make_pipeline(settings).graph, frame).items()
    }
    told = json.loads((fast / "lobewise-export.json").read_text())
    camera = frame.require_camera("a pipeline")
    view = [*camera.position, *camera.forward, *camera.up, camera.fov_y, 0.0, *camera.shift]
    pipeline.set(samples_per_pixel=SPP)
    pipeline.run(view, pack_frame(given, (0, 0), image, told))
    pipeline.free()
    assert np.isnan(given["color"]).any()
    np.testing.assert_allclose(image, expected, rtol=1e-5)


def test_driver_is_c99_without_warnings(fast: Path, compiler: str) -> None:
    build(fast, compiler, "-std=c99", "-O2", *STRICT, "-c", "lobewise.c", "-o", "strict.o")


CHECKS = """
#include <stdio.h>
#include <string.h>
#include "lobewise.h"
static int failures;
static void expect(lobewise_status found, lobewise_status wanted, const char *what) {
    if (found != wanted) { printf("%s: %s\\n", what, lobewise_explain(found)); failures++; }
}
static int stop(void *user, int done, int parts) {
    int *calls = user;
    if (done != *calls || parts != lobewise_stages) { failures++; }
    return ++*calls == 2;
}
int main(void) {
    static float image[3 * 64 * 64], result[3 * 64 * 64];
    int calls = 0;
    lobewise_pipeline *p, *other;
    lobewise_settings settings;
    lobewise_camera camera = {{0, 1, 4}, {0, 0, -1}, {0, 1, 0}, 0.8, 0, {0, 0}};
    lobewise_frame frame;
    memset(&frame, 0, sizeof frame);
    expect(lobewise_create(1, 64, &p), lobewise_bad_size, "a narrow image");
    expect(lobewise_create(64, 0, &p), lobewise_bad_size, "no rows");
    expect(lobewise_create(64, 64, NULL), lobewise_no_image, "no pointer");
    expect(lobewise_create(64, 64, &p), lobewise_ok, "a pipeline");
    expect(lobewise_run(p, &camera, &frame), lobewise_no_image, "no images");
    if (!strstr(lobewise_get_message(p), "NULL")) { puts(lobewise_get_message(p)); failures++; }
    frame.color = frame.diffuse = frame.specular = frame.normal = frame.diffuse_albedo = image;
    frame.specular_albedo = frame.depth = frame.alpha = image;
    frame.image = result;
    camera.up[1] = 0; camera.up[2] = 2;
    expect(lobewise_run(p, &camera, &frame), lobewise_bad_camera, "up along forward");
    camera.up[1] = 1; camera.fov_y = 3.2;
    expect(lobewise_run(p, &camera, &frame), lobewise_bad_camera, "a wide angle");
    camera.fov_y = 0.8;
    lobewise_get_settings(p, &settings);
    settings.beta = -1.0;
    expect(lobewise_set_settings(p, &settings), lobewise_bad_setting, "a negative beta");
    settings.beta = 0.0; settings.samples_per_pixel = 0.0;
    expect(lobewise_set_settings(p, &settings), lobewise_bad_setting, "no samples");
    failures += !strstr(lobewise_get_message(p), "samples_per_pixel must be above 0");
    settings.samples_per_pixel = 2.0; settings.position_sigma = 0.0;
    expect(lobewise_set_settings(p, &settings), lobewise_bad_setting, "no position sigma");
    settings.position_sigma = 16.0;
    expect(lobewise_run(NULL, &camera, &frame), lobewise_no_image, "no pipeline");
    expect(lobewise_set_settings(p, &settings), lobewise_ok, "settings");
    expect(lobewise_run(p, &camera, &frame), lobewise_ok, "a black frame");
    lobewise_set_progress(p, stop, &calls);
    expect(lobewise_run(p, &camera, &frame), lobewise_cancelled, "a frame that is cancelled");
    failures += calls != 2 || !strstr(lobewise_get_message(p), "cancelled");
    lobewise_set_progress(p, NULL, NULL);
    expect(lobewise_run(p, &camera, &frame), lobewise_ok, "a frame after one that was cancelled");
    expect(lobewise_create_within(64, 64, lobewise_count_bytes(p) - 1, &other), lobewise_no_memory, "too little");
    failures += other != NULL;
    expect(lobewise_create_within(64, 64, lobewise_count_bytes(p), &other), lobewise_ok, "just enough memory");
    lobewise_destroy(other);
    printf("%lu\\n", (unsigned long)lobewise_count_bytes(p));
    lobewise_reset(p);
    lobewise_destroy(p);
    lobewise_destroy(NULL);
    return failures;
}
"""


def test_bad_input_is_refused(fast: Path, compiler: str) -> None:
    (fast / "checks.c").write_text(CHECKS)
    build(fast, compiler, "-std=c99", *STRICT, "checks.c", "liblobewise.a", "-o", "checks", *LIBRARIES)
    told = json.loads((fast / "lobewise-export.json").read_text())["bytes_per_pixel"]
    expected = sum(told.values()) * 64 * 64
    assert expected < int(build(fast, "./checks")) < expected + 40_000


@pytest.mark.nightly
def test_cmake_finds_the_package(fast: Path, cpp: str, tmp_path: Path) -> None:
    cmake = locate_program("cmake", "cmake")
    build(tmp_path, cmake, "-S", str(fast), "-B", "build", "-DCMAKE_BUILD_TYPE=Release")
    build(tmp_path, cmake, "--build", "build")
    build(fast, str(tmp_path / "build" / "example"))


def test_pkg_config_and_shared_library(fast: Path, cpp: str) -> None:
    program = locate_program("pkg-config", "pkg-config")
    words = [program, "--cflags", "--libs", "lobewise"]
    told = subprocess.run(words, env={"PKG_CONFIG_PATH": str(fast)}, capture_output=True, text=True, check=True)
    build(fast, cpp, "-std=c++11", "example.cpp", "-o", "shared", *told.stdout.split(), f"-Wl,-rpath,{fast}")
    assert "liblobewise.so" in build(fast, "ldd", "shared")
    build(fast, "./shared")


def test_contents_name_every_step(fast: Path) -> None:
    told = json.loads((fast / "lobewise-export.json").read_text())
    driver = (fast / "lobewise.c").read_text()
    functions = {step["function"] for stage in told["stages"] for step in stage["steps"]}
    assert set(told["kernels"]) <= functions
    assert all(f"{function}(" in driver for function in functions)
    assert {each["name"] for each in told["inputs"]} >= {"color", "diffuse", "specular", "normal", "depth", "alpha"}
    readme = (fast / "README.md").read_text()
    assert all(f"`{each['name']}`" in readme for each in told["inputs"])


def test_a_change_of_the_plan_changes_the_export() -> None:
    texts = {write_driver(make_pipeline(PipelineSettings(form=form))) for form in ("full", "separable", "atrous")}
    assert len(texts) == 3


def test_list_prints_the_contents(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", "pipeline", "--list"]) == 0
    out = capsys.readouterr().out
    assert "specular_albedo: height x width x 3" in out
    assert "full kernel, 17x17 pixels" in out


@pytest.mark.parametrize(
    "settings",
    [
        {"history": True, "hit_distance": True},
        {"upsample": 2, "coverage": True, "rays": True},
        {"plan": "balanced", "coverage": True},
        {"plan": "high", "halves": False, "layers": "named"},
    ],
    ids=str,
)
def test_every_step_says_what_it_does(settings: dict[str, Any]) -> None:
    for _, operations in make_pipeline(PipelineSettings(**settings)).stages:
        for each in operations:
            assert each.text, each.function
            assert "`" not in each.text


def test_settings_name_no_unknown_layers() -> None:
    with refuses(InputError, "layers"):
        PipelineSettings(layers="three")  # type: ignore[arg-type]
