"""Write the folder of a pipeline: kernels, driver, headers, packages for build systems, and the example."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import lobewise
from lobewise.backend.compiler import hl
from lobewise.backend.objects import catch_file
from lobewise.exporting.folder import MARK, fill_template, open_folder, require_folder
from lobewise.exporting.names import require_identifier
from lobewise.exporting.pipeline.contents import describe_contents, write_readme
from lobewise.exporting.pipeline.driver import write_driver, write_header
from lobewise.exporting.pipeline.frame import Features, no_features
from lobewise.exporting.pipeline.pipeline import Pipeline
from lobewise.exporting.pipeline.recording import make_pipeline
from lobewise.exporting.pipeline.sample import FRAMES, make_sample
from lobewise.exporting.pipeline.scene import HEIGHT, SPP, WIDTH
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.targets import get_gpu_api, get_runtime_headers, parse_target, refusing_target
from lobewise.io.files import PathLike

Place = Callable[[str], Path]
MAX_DIFFERENCE = 1e-5
"""Largest relative difference between C++ and Python on processors with fused multiply-add."""
MAX_PLAIN_DIFFERENCE = 5e-5
"""Largest relative difference on processors without fused multiply-add, where products are rounded once more."""
MAX_DEVICE_DIFFERENCE = 1e-3
"""Largest relative difference where kernels run on a graphics processor, which rounds in its own way."""
LIBRARIES = ("-lpthread", "-ldl", "-lm")
"""Libraries of the system that Halide's runtime calls."""


def export_pipeline(
    output: PathLike,
    settings: PipelineSettings,
    *,
    target: str = "host",
    name: str = "lobewise",
    force: bool = False,
    features: Features = no_features,
) -> str:
    """Write a folder with a pipeline; return the command that builds its example.

    Parameters
    ----------
    output : path
        The folder, new or empty.
    settings : PipelineSettings
    target : str
        A name from `lobewise.exporting.names.TARGETS`, or another target that Halide knows.
    name : str
        Prefix of files and functions: an identifier of C.
    force : bool
        Replace an earlier export and everything in its folder.
    features : callable, optional
        Returns more features of every layer, of your own or from `lobewise.features`, from the guides of a frame:
        ``lambda frame: [MyFeature(frame.gbuffer.depth)]``. The pipeline has an input for each guide that they read.

    Raises
    ------
    InputError, DeviceError
        If name or target cannot be used.
    FileError
        If the folder is not empty or cannot be written.
    """
    require_identifier(name, "my_pipeline")
    require_folder(output, force=force)
    with refusing_target(target):
        pipeline = make_pipeline(settings, target=target, name=name, features=features)
    frames, expected = make_sample(settings, pipeline.graph, features)
    with open_folder(output, force=force) as place:
        place("kernels").mkdir()
        with refusing_target(target):
            objects = compile_kernels(pipeline, target)
        for file, content in objects:
            place(f"kernels/{file}").write_bytes(content)
        for header in get_runtime_headers(pipeline.target):
            shutil.copyfile(header, place(header.name))
        place("frames.raw").write_bytes(frames)
        place("expected.raw").write_bytes(expected)
        for file, text in write_texts(pipeline).items():
            place(file).write_text(text, encoding="utf-8")
        command = describe_build(pipeline, build_libraries(pipeline, place))
        place("README.md").write_text(write_readme(pipeline, command), encoding="utf-8")
    return command


def name_objects(pipeline: Pipeline) -> list[str]:
    """Return the files of the compiled kernels and of Halide's runtime, inside of the folder ``kernels``."""
    end = "obj" if "windows" in pipeline.target else "o"
    return [f"{kernel.symbol}.{end}" for kernel in pipeline.kernels] + [f"{pipeline.name}_runtime.{end}"]


def compile_kernels(pipeline: Pipeline, target: str) -> list[tuple[str, bytes]]:
    """Return the object files of a pipeline by name."""
    contents = [kernel.compile() for kernel in pipeline.kernels] + [compile_runtime(target)]
    return list(zip(name_objects(pipeline), contents, strict=True))


def compile_runtime(target: str) -> bytes:
    """Return Halide's runtime for a target as an object file: threads, memory, errors."""
    return catch_file(lambda path: hl.compile_standalone_runtime(path, parse_target(target)))


def write_texts(pipeline: Pipeline) -> dict[str, str]:
    """Return the text files of an export by name."""
    name, version = pipeline.name, lobewise.__version__
    objects = ['    "$' + f'{{_{name}_folder}}/kernels/{each}"' for each in name_objects(pipeline)]
    options = list_link_options(pipeline)
    parts = {
        "name": name,
        "title": pipeline.title,
        "version": version,
        "guard": f"{name.upper()}_HPP",
        "objects": "\n".join(objects),
        "link_options": f"\ntarget_link_options({name} PUBLIC {' '.join(options)})" if options else "",
        "libraries": "".join(f" {each}" for each in options),
        # Variables of CMake and pkg-config.
        **{each: f"${{{each}}}" for each in ("CMAKE_CURRENT_LIST_FILE", "pcfiledir", "includedir", "libdir")},
    }
    templates = {
        f"{name}.hpp": "wrapper.hpp",
        f"{name}Config.cmake": "config.cmake",
        f"{name}ConfigVersion.cmake": "version.cmake",
        "CMakeLists.txt": "CMakeLists.txt",
        f"{name}.pc": "pkgconfig.pc",
    }
    return {
        f"{name}.h": write_header(pipeline),
        f"{name}.c": write_driver(pipeline),
        "example.cpp": write_example(pipeline),
        MARK: json.dumps(describe_contents(pipeline), indent=1) + "\n",
        **{file: fill_template(f"pipeline/{template}", **parts) for file, template in templates.items()},
    }


def choose_bound(target: str) -> float:
    """Return the largest relative difference to Python that the example accepts."""
    if get_gpu_api(target) is not None:
        return MAX_DEVICE_DIFFERENCE
    words = target.split("-")
    fused = words[0] == "arm" or "fma" in words
    return MAX_DIFFERENCE if fused else MAX_PLAIN_DIFFERENCE


def list_link_options(pipeline: Pipeline) -> list[str]:
    """Return what a program that contains the pipeline is linked with because of its device."""
    if pipeline.api == "metal":
        return ["-Wl,-framework,Metal", "-Wl,-framework,Foundation"]
    return ["-sUSE_WEBGPU", "-sASYNCIFY"] if pipeline.api == "webgpu" and "wasm" in pipeline.target else []


def write_example(pipeline: Pipeline) -> str:
    """Return the example in C++."""
    indent, scale = "            ", pipeline.settings.upsample
    lines = []
    for image in pipeline.graph.inputs.values():
        count = str(image.channels)
        count += " * samples" if "rows" in image.shape else " * width * height"
        lines.append(f"{indent}const std::vector<float> {image.name} = read<float>(input, {count});")
        lines.append(f"{indent}frame.{image.name} = {image.name}.data();")
    return fill_template(
        "pipeline/example.cpp",
        name=pipeline.name,
        width=WIDTH,
        height=HEIGHT,
        frames=FRAMES,
        spp=f"{SPP:g}",
        places=fill_template("pipeline/place.cpp", scale=scale, last=scale - 1) if scale > 1 else "",
        reading="\n".join(lines),
        bound=f"{choose_bound(pipeline.target):g}",
    )


def build_libraries(pipeline: Pipeline, place: Place) -> bool:
    """Build the static and the shared library where this machine has a C compiler for the target."""
    compiler, archiver = shutil.which("cc"), shutil.which("ar")
    host = parse_target("host")
    target = hl.Target(pipeline.target)
    fits = (target.os, target.arch, target.bits) == (host.os, host.arch, host.bits) and host.os != hl.TargetOS.Windows
    if compiler is None or archiver is None or not fits:
        return False
    folder, name = place("."), pipeline.name
    kernels = [f"kernels/{each}" for each in name_objects(pipeline)]
    shared = f"lib{name}.dylib" if host.os == hl.TargetOS.OSX else f"lib{name}.so"
    commands = [
        [compiler, "-std=c99", "-O2", "-fPIC", "-c", f"{name}.c", "-o", f"{name}.o"],
        [archiver, "rcs", f"lib{name}.a", f"{name}.o", *kernels],
        [compiler, "-shared", f"{name}.o", *kernels, "-o", shared, *LIBRARIES, *list_link_options(pipeline)],
    ]
    for command in commands:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            for file in (f"lib{name}.a", shared, f"{name}.o"):
                (folder / file).unlink(missing_ok=True)
            return False
    (folder / f"{name}.o").unlink()
    return True


def describe_build(pipeline: Pipeline, built: bool) -> str:
    """Return the command that builds and runs the example."""
    name = pipeline.name
    if not built:
        return "cmake -B build && cmake --build build && build/example"
    words = " ".join((*LIBRARIES, *list_link_options(pipeline)))
    return f"c++ -std=c++11 example.cpp lib{name}.a -o example {words} && ./example"
