"""What the first call of each recipe compiles without a cache of kernels, in this version and in an older one.

Each recipe runs in a process of its own on the frame that comes with the package, with an empty cache of kernels. The
times are processor time of compiling, on one thread, and of the whole call.

    python -m benchmarks.performance.first_calls --before CHECKOUT
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, ROOT, SAMPLE, describe_machine, write_json

RESULT = RESULTS / "first_calls.json"
CALLS = {
    "fast": "lobewise.denoise(frame, quality='fast')",
    "fast, separable": "lobewise.denoise(frame, quality='fast', form='separable')",
    "balanced": "lobewise.denoise(frame, quality='balanced')",
    "high": "lobewise.denoise(frame, quality='high')",
    "auto": "lobewise.denoise(frame)",
    "upsampling": "lobewise.upsample(lobewise.make_sparse(frame, 4))",
    "history": "[history.add(frame) for history in [lobewise.TemporalFilter()] for _ in range(2)]",
}
PROGRAM = """
import json, os, sys
import lobewise
from lobewise.backend import jit

def measure():
    times = os.times()
    return times.user + times.system

compiled = []
compile_kernel = jit.compile_kernel

def compile_timed(*given):
    start = measure()
    found = compile_kernel(*given)
    compiled.append([found[1]["name"], round(measure() - start, 2)])
    return found

jit.compile_kernel = compile_timed
frame = lobewise.read_frame("SAMPLE")
start = measure()
CALL
print(json.dumps({"call_seconds": round(measure() - start, 2), "kernels": compiled}))
"""


def measure_call(call: str, checkout: Path) -> dict[str, Any]:
    """Return how many kernels a call of a version compiles, in how many seconds, and each of them."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {
            **os.environ,
            "PYTHONPATH": str(checkout / "src"),
            "LOBEWISE_CACHE": cache,
            "HL_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
        }
        command = [sys.executable, "-c", PROGRAM.replace("CALL", call).replace("SAMPLE", str(SAMPLE))]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    seconds = round(sum(each for _, each in found["kernels"]), 2)
    return {"count": len(found["kernels"]), "compile_seconds": seconds, **found}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, required=True, help="checkout of the older version")
    parser.add_argument("--only", nargs="+", choices=CALLS, help="measure these again and leave the others")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    chosen = parser.parse_args(arguments)
    versions = {"before": chosen.before.resolve(), "after": ROOT}
    calls = json.loads(chosen.output.read_text())["calls"] if chosen.only and chosen.output.exists() else {}
    what = "kernels that the first call of a recipe compiles without a cache, and processor seconds"
    for name in chosen.only or CALLS:
        calls[name] = {version: measure_call(CALLS[name], checkout) for version, checkout in versions.items()}
        write_json(chosen.output, {"what": what, "machine": describe_machine(), "calls": calls})
        told = [f"{version} {each['count']} in {each['compile_seconds']} s" for version, each in calls[name].items()]
        print(f"{name:20} {', '.join(told)}", flush=True)


if __name__ == "__main__":
    main()
