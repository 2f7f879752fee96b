"""Runs the exported shader functions on a device: one kernel that calls all of them on rows of numbers."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.exporting.shaders.language import translate_line

INPUTS = {
    "pixel_i": 2,
    "pixel_j": 2,
    "position_i": 3,
    "position_j": 3,
    "depth_i": 1,
    "depth_j": 1,
    "pixel_angle": 1,
    "sigma": 1,
    "exponent": 1,
    "beta": 1,
    "axis_i": 3,
    "axis_j": 3,
    "sharpness_i": 1,
    "sharpness_j": 1,
    "many_i": 4,
    "many_j": 4,
    "amplitude_i": 4,
    "amplitude_j": 4,
    "diagonal_i": 3,
    "diagonal_j": 3,
    "beside_i": 3,
    "beside_j": 3,
    "determinant_i": 1,
    "determinant_j": 1,
    "normal": 3,
    "raw_normal": 3,
    "view": 3,
    "tangent": 3,
    "alpha": 2,
    "tau": 1,
}
"""Numbers of a row, by name."""

WEIGHTS = {
    "screen": "lobewise_screen_weight(pixel_i, pixel_j, sigma)",
    "position": "lobewise_position_weight(position_i, depth_i, position_j, depth_j, pixel_angle, sigma)",
    "normal": "lobewise_normal_weight(axis_i, axis_j, exponent)",
    "diffuse": "lobewise_diffuse_weight(axis_i, axis_j, beta)",
    "sg": "lobewise_sg_weight(sg_i, sg_j, beta)",
    "mixture": "lobewise_mixture_weight(mixture_i, mixture_j, beta)",
    "ggx": "lobewise_ggx_weight(lobe_i, lobe_j, beta)",
}
COVARIANCES = {
    "make_ggx": "lobewise_make_ggx(normal, view, alpha.x, tau)",
    "make_anisotropic_ggx": "lobewise_make_anisotropic_ggx(normal, tangent, view, alpha, tau)",
}
OUTPUTS = {**dict.fromkeys(WEIGHTS, 1), "face": 3, "make_sg": 4, "make_mixture": 11, **dict.fromkeys(COVARIANCES, 10)}

_FRAMES = {
    "wgsl": (
        "@group(0) @binding(0) var<storage, read> given: array<f32>;\n"
        "@group(0) @binding(1) var<storage, read_write> found: array<f32>;\n"
        "@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) thread: vec3<u32>) {\n"
        "    let at = thread.x * WIDTHu;\n    let to = thread.x * RESULTSu;\n"
    ),
    "glsl": (
        "layout(local_size_x = 64) in;\n"
        "layout(std430, set = 0, binding = 0) readonly buffer Given { float given[]; };\n"
        "layout(std430, set = 0, binding = 1) buffer Found { float found[]; };\n"
        "void main() {\n    uint at = gl_GlobalInvocationID.x * WIDTHu;\n"
        "    uint to = gl_GlobalInvocationID.x * RESULTSu;\n"
    ),
    "hlsl": (
        "[[vk::binding(0, 0)]] StructuredBuffer<float> given;\n"
        "[[vk::binding(1, 0)]] RWStructuredBuffer<float> found;\n"
        "[numthreads(64, 1, 1)]\nvoid main(uint3 thread : SV_DispatchThreadID) {\n"
        "    uint at = thread.x * WIDTHu;\n    uint to = thread.x * RESULTSu;\n"
    ),
}


def make_program(language: str, functions: str) -> str:
    """Return a compute shader that calls every function on its row."""
    body, offset = [], 0
    for name, count in INPUTS.items():
        reads = ", ".join(f"given[at + {offset + k}u]" for k in range(count))
        kind = "float" if count == 1 else f"vec{count}"
        body.append(f"    let {kind} {name} = {reads if count == 1 else f'{kind}({reads})'};")
        offset += count
    for side in "ij":
        body += [f"    var LobewiseSg sg_{side};", f"    sg_{side}.axis = axis_{side};"]
        body += [f"    sg_{side}.sharpness = sharpness_{side};"]
        body += [f"    var LobewiseMixture mixture_{side};", f"    mixture_{side}.axis = axis_{side};"]
        body += [f"    mixture_{side}.sharpness = many_{side};", f"    mixture_{side}.amplitude = amplitude_{side};"]
        body += [f"    var LobewiseCovariance lobe_{side};", f"    lobe_{side}.axis = axis_{side};"]
        body += [f"    lobe_{side}.{field} = {field}_{side};" for field in ("diagonal", "beside", "determinant")]
    body += [f"    let float got_{name} = {call};" for name, call in WEIGHTS.items()]
    results = [f"got_{name}" for name in WEIGHTS]
    body += ["    let vec3 face = lobewise_face_viewer(raw_normal, view);"]
    body += ["    let LobewiseSg made = lobewise_make_sg(normal, view, alpha.x, tau);"]
    body += ["    let LobewiseMixture mixed = lobewise_make_mixture(normal, view, alpha.x, tau);"]
    body += [f"    let LobewiseCovariance got_{name} = {call};" for name, call in COVARIANCES.items()]
    results += [f"face.{c}" for c in "xyz"] + [f"made.axis.{c}" for c in "xyz"] + ["made.sharpness"]
    results += [f"mixed.axis.{c}" for c in "xyz"] + [f"mixed.{field}.{c}" for field in FIELDS for c in "xyzw"]
    for name in COVARIANCES:
        results += [f"got_{name}.{field}.{c}" for field in ("axis", "diagonal", "beside") for c in "xyz"]
        results += [f"got_{name}.determinant"]
    body += [f"    found[to + {place}u] = {result};" for place, result in enumerate(results)]
    assert len(results) == sum(OUTPUTS.values())
    frame = re.sub("RESULTS", str(len(results)), re.sub("WIDTH", str(offset), _FRAMES[language]))
    program = frame + "\n".join(translate_line(line, language) for line in body) + "\n}\n"
    version = "#version 450\n" if language == "glsl" else ""
    return version + functions + program


FIELDS = ("sharpness", "amplitude")


def compile_spirv(language: str, program: str, folder: Path) -> bytes:
    """Return what the reference compiler makes of a program in GLSL or HLSL."""
    compiler = shutil.which("glslangValidator")
    source, binary = folder / f"program.{language}", folder / f"{language}.spv"
    source.write_text(program)
    words = ["-D", "-e", "main"] if language == "hlsl" else []
    done = subprocess.run(
        [compiler, *words, "-V", "-S", "comp", "-o", str(binary), str(source)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    return binary.read_bytes()


def dispatch(device: Any, pipeline: Any, layout: Any, entries: list[dict[str, Any]], groups: list[int]) -> None:
    """Run a pipeline on buffers and images, by as many groups of threads along each axis."""
    encoder = device.create_command_encoder()
    step = encoder.begin_compute_pass()
    step.set_pipeline(pipeline)
    step.set_bind_group(0, device.create_bind_group(layout=layout, entries=entries))
    step.dispatch_workgroups(*groups)
    step.end()
    device.queue.submit([encoder.finish()])


def run_program(device: Any, code: str | bytes, given: NDArray[np.float32]) -> dict[str, NDArray[np.float64]]:
    """Run a program on rows (count, inputs); return its outputs by name."""
    import wgpu

    count, width = given.shape
    assert count % 64 == 0
    assert width == sum(INPUTS.values())
    results = sum(OUTPUTS.values())
    module = device.create_shader_module(code=code, label="comp")
    usage = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC
    buffers = [
        device.create_buffer_with_data(data=np.ascontiguousarray(given), usage=usage),
        device.create_buffer(size=count * results * 4, usage=usage),
    ]
    pipeline = device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})
    entries = [{"binding": k, "resource": {"buffer": buffer}} for k, buffer in enumerate(buffers)]
    dispatch(device, pipeline, pipeline.get_bind_group_layout(0), entries, [count // 64])
    raw = np.frombuffer(device.queue.read_buffer(buffers[1]), np.float32)
    rows = raw.reshape(count, results).astype(np.float64)
    split = np.split(rows, np.cumsum(list(OUTPUTS.values()))[:-1], axis=1)
    return {name: part[:, 0] if part.shape[1] == 1 else part for name, part in zip(OUTPUTS, split, strict=True)}
