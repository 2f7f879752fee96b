"""How near the filter's kernels come to what one core can do: operations and bytes of a tap, and the machine's peaks.

The peaks are measured by loops of nothing but independent vector operations or loads, written as LLVM assembly. What
a tap asks for is counted in the machine code of the kernel: the loops over taps, found by what stands in them.

    python -m benchmarks.performance.roofline -o benchmarks/results/roofline.json
"""

from __future__ import annotations

import os

os.environ["HL_NUM_THREADS"] = "1"

import argparse
import ctypes
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import halide as hl
import llvmlite.binding as llvm
import numpy as np

from benchmarks.common import describe_machine, write_json
from lobewise.backend.devices import make_target
from lobewise.bench.kernels import count_taps, make_kernel_calls
from lobewise.bench.plane import make_features, make_frame
from lobewise.bench.timing import time_best
from lobewise.features.base import describe_structure
from lobewise.filters.cross_pass import PassKey, Reads, Writes, make_pass
from lobewise.filters.forms import Taps

NAMES = ("normal", "sg", "asg", "ggx", "sg_mixture, 3 coaxial")
SIZE = 256
RADIUS = 16
"""So large that what is done once for a pixel hardly counts."""
CHAINS = 12
"""Independent operations of a kind: more than any latency."""
CACHED = 1 << 14
"""Bytes that loads go over: half of a first-level cache."""
OTHER = re.compile(r"perm|insert|extract|vcmp|kand|ptest|pcmp|shuf|unpck|gather|scatter")
"""What no loop over taps has: taking interleaved channels apart, and choosing where a pixel is bad."""
MOVES = re.compile(r"^vmov|broadcast")
TINY = re.compile(r"(ss|sd)$")


def make_peak_program(lanes: int, adds: int, fused: int, loads: int) -> str:
    """Return LLVM assembly of a loop of independent additions, fused multiplications and loads."""
    vector = f"<{lanes} x float>"
    lines = [
        f"declare {vector} @llvm.fma.v{lanes}f32({vector}, {vector}, {vector})",
        "define float @run(i64 %count, ptr %data) {",
        "entry:",
        *(f"  %{name} = load {vector}, ptr %data, align 4" for name in "ab"),
        "  br label %loop",
        "loop:",
        "  %i = phi i64 [ 0, %entry ], [ %next, %loop ]",
    ]
    lines += [f"  %s{k} = phi {vector} [ %a, %entry ], [ %t{k}, %loop ]" for k in range(adds + fused)]
    for k in range(adds):
        lines.append(f"  %t{k} = fadd {vector} %s{k}, %b")
    for k in range(adds, adds + fused):
        lines.append(f"  %t{k} = call {vector} @llvm.fma.v{lanes}f32({vector} %s{k}, {vector} %a, {vector} %b)")
    for k in range(loads):
        lines.append(f"  %p{k} = getelementptr i8, ptr %data, i64 {k * 4 * lanes}")
        lines.append(f"  %l{k} = load volatile {vector}, ptr %p{k}, align 4")
    lines += [
        "  %next = add i64 %i, 1",
        "  %more = icmp ult i64 %next, %count",
        "  br i1 %more, label %loop, label %end",
    ]
    lines += ["end:"]
    total = "0.0"
    for k in range(adds + fused):
        lines.append(f"  %e{k} = extractelement {vector} %t{k}, i32 0")
        lines.append(f"  %f{k} = fadd float %e{k}, {total}")
        total = f"%f{k}"
    return "\n".join([*lines, f"  ret float {total}", "}"])


def measure_peak(lanes: int, adds: int, fused: int, loads: int, seconds: float) -> float:
    """Return how many of these vector instructions one core runs in a second."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    text = make_peak_program(lanes, adds, fused, loads)
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=features + ",-prefer-256-bit", opt=2
    )
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(text), target)
    engine.finalize_object()
    run = ctypes.CFUNCTYPE(ctypes.c_float, ctypes.c_int64, ctypes.c_void_p)(engine.get_function_address("run"))
    memory = np.zeros(CACHED // 4 + 16, np.float32)
    # Loads of the peak cross no cache line.
    data = memory[-(memory.ctypes.data // 4) % 16 :]
    count = 1_000_000
    best = time_best({"run": lambda: run(count, data.ctypes.data)}, seconds)["run"]
    return count * (adds + fused + loads) / best


def count_tap(name: str, lanes: int) -> dict[str, Any]:
    """Return what the loops over the taps of a row ask for, by tap and vector, from the kernel's machine code."""
    features = make_features(make_frame(64, 64), ("normal", name))[name]
    structure = tuple(describe_structure(feature) for feature in features)
    key = PassKey(Taps.SQUARE, structure, Reads.RADIANCE, Writes.PIXELS)
    target = make_target("cpu").with_feature(hl.TargetFeature.NoRuntime)
    made = make_pass(key, features, target)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kernel.s"
        hl.Pipeline(made.out).compile_to_assembly(str(path), made.signature.arguments, "kernel", target)
        loops = list_tap_loops(path.read_text())
    counts = Counter(line.split()[0] for loop in loops for line in loop)
    lines = [line for loop in loops for line in loop if not TINY.search(line.split()[0])]
    wide = [line for line in lines if "mm" in line]
    operations = [line for line in wide if not MOVES.search(line.split()[0])]
    loads = [line for line in wide if re.search(r"\(%", line) and not re.search(r"%[xyz]mm\d+, [^#]*\(%", line)]
    stores = [line for line in wide if re.search(r"%[xyz]mm\d+, [^#]*\(%", line)]
    return {
        "loops": len(loops),
        "operations": len(operations),
        "bytes_loaded": 4 * lanes * len(loads),
        "bytes_stored": 4 * lanes * len(stores),
        "instructions": dict(sorted(counts.items())),
    }


def list_tap_loops(text: str) -> list[list[str]]:
    """Return the instructions of every innermost loop that is one over taps."""
    places: dict[str, int] = {}
    lines: list[str] = []
    for line in text.splitlines():
        label = re.match(r"^(\.\w+):", line)
        if label:
            places[label.group(1)] = len(lines)
        elif line.startswith("\t") and not line.startswith("\t."):
            lines.append(line.split("#")[0].strip())
    loops: list[list[str]] = []
    for end, line in enumerate(lines):
        jump = re.match(r"j\w+\s+(\.\w+)", line)
        if jump is None or places.get(jump.group(1), end) >= end:
            continue
        body = lines[places[jump.group(1)] : end]
        is_innermost = not any(re.match(r"(j|call)", each) for each in body)
        sums = sum("fmadd" in each or "fmsub" in each for each in body)
        if is_innermost and sums >= 3 and not any(OTHER.search(each.split()[0]) for each in body):
            loops.append(body)
    return loops


def measure(seconds: float, report: Callable[[str], None]) -> dict[str, Any]:
    """Return peaks, counts, times and what share of the roofline each kernel reaches."""
    lanes = int(hl.get_host_target().natural_vector_size(hl.Float(32)))
    peaks = {
        "fused": measure_peak(lanes, 0, CHAINS, 0, seconds),
        "additions": measure_peak(lanes, CHAINS, 0, 0, seconds),
        "both": measure_peak(lanes, CHAINS, CHAINS, 0, seconds),
        "loads": measure_peak(lanes, 0, 0, CHAINS, seconds),
    }
    report(str({name: f"{value:.3g}" for name, value in peaks.items()}))
    operations, loads = max(peaks["fused"], peaks["additions"], peaks["both"]), peaks["loads"]
    frame = make_frame(SIZE, SIZE)
    calls = make_kernel_calls(frame, make_features(frame, NAMES), RADIUS, "full")
    best = time_best(calls, seconds * len(calls))
    kernels: dict[str, Any] = {}
    for name in NAMES:
        asked = count_tap(name, lanes)
        taken = best[name] / (count_taps("full", RADIUS) * SIZE * SIZE) * lanes
        bounds = {
            "operations": asked["operations"] / operations,
            "loads": asked["bytes_loaded"] / (4 * lanes) / loads,
        }
        limit = max(bounds, key=lambda each: bounds[each])
        kernels[name] = {
            **asked,
            "nanoseconds": round(1e9 * taken, 3),
            "bounds_nanoseconds": {each: round(1e9 * value, 3) for each, value in bounds.items()},
            "limit": limit,
            "share_of_roofline": round(bounds[limit] / taken, 3),
        }
        report(f"{name}: {kernels[name]['share_of_roofline']:.2f} of {limit}")
    return {
        "what": "one core, full form, radius 16, a tap of a vector of pixels; peaks: 1e9 vector instructions a second",
        "machine": describe_machine(),
        "lanes": lanes,
        "peaks": {name: round(value / 1e9, 3) for name, value in peaks.items()},
        "kernels": kernels,
    }


def main() -> None:
    """Measure and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--seconds", type=float, default=4.0, help="for each measurement")
    arguments = parser.parse_args()
    start = time.perf_counter()
    found = measure(arguments.seconds, print)
    print(f"{time.perf_counter() - start:.0f} s")
    if arguments.output:
        write_json(arguments.output, found)


if __name__ == "__main__":
    main()
