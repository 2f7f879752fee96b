"""No kernel reads or writes beyond a buffer: every form of filter, between pages that nobody may touch.

Tests of the filters run again, each in a process of its own, which an access out of bounds ends.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

pytestmark = [
    pytest.mark.processor,
    pytest.mark.skipif(os.name == "nt", reason="Windows has neither mprotect nor fork"),
]
# Narrower than any vector, and with a rest behind the last whole one.
SHAPES = [(1, 1), (1, 7), (3, 17)]


def each_shape(call: str, shapes: Sequence[tuple[int, int]] = SHAPES) -> str:
    """Return the calls of a test with every shape."""
    return ", ".join(call.replace("SHAPE", str(shape)) for shape in shapes)


CASES = {
    "full": each_shape("test_cross_filter.check_definition('lobes', 'full', SHAPE)"),
    "separable": each_shape("test_cross_filter.check_definition('lobes', 'separable', SHAPE)"),
    "atrous": each_shape("test_cross_filter.check_definition('lobes', 'atrous', SHAPE)"),
    "tiles": "test_cross_filter.test_tiles_change_nothing(pytest.MonkeyPatch())",
    "pixel by pixel": each_shape("test_pointwise.test_every_pixel_of_every_size(random.default_rng(1), SHAPE)"),
    "neighbours": each_shape("test_pointwise.test_neighbours(random.default_rng(1), SHAPE)"),
    "strictness and moment": "test_cross_filter.check_definition('strict', 'full', (1, 7))",
    "albedo": "test_cross_filter.test_demodulation('full')",
    "dual buffer": each_shape("test_dual_buffer.check_definition('standard', SHAPE)", [(1, 1), (1, 9)]),
    "own sample": each_shape("test_dual_buffer.check_definition('own sample', SHAPE)", [(1, 9), (40, 2)]),
    "refinement": each_shape("test_refinement.test_the_kernels_agree_with_the_definition(SHAPE)"),
    "noise guide": each_shape("test_noise_guides.check_guide(SHAPE)"),
    "measured light": each_shape("test_noise_guides.check_light(SHAPE, True)"),
    "fireflies": each_shape("test_fireflies.check_definition(SHAPE, True)"),
    "reprojection": each_shape("test_reprojection.check_own_places(SHAPE)"),
    "vectors that move": "test_reprojection.test_vectors_that_move_together_agree_with_oracle((), (-5.25, 1.0))",
    "two places": "test_reprojection.test_of_two_places_the_better_counts_more(('plane', 'ggx'), 1)",
    "accumulation": each_shape("test_accumulation.check_definition(1, (0, 0), SHAPE)", [(1, 1), (3, 5)]),
    "sampled accumulation": each_shape("test_accumulation.check_definition(2, (1, 0), SHAPE)", [(3, 5)]),
    "upsampling": each_shape("test_upsampling.check_definition(2, (1, 0), SHAPE)"),
}
# A process that has imported everything and run no kernel, and so has no threads of Halide's, is copied for every case.
PROGRAM = """
import json, os, sys, traceback
from importlib import import_module
from numpy import random
import pytest
from tests.filters.guard_pages import guard_kernels

modules = {"random": random, "pytest": pytest}
for name in {case.partition(".")[0] for case in json.loads(sys.argv[1])}:
    modules[name] = import_module(f"tests.{'backend' if name == 'test_pointwise' else 'filters'}.{name}")
for line in sys.stdin:
    case, place, shift = json.loads(line)
    told, tell = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            called = guard_kernels(place, shift)
            eval(f"[{case}]", modules)
            os.write(tell, str(len(called)).encode())
            os._exit(0)
        except BaseException:
            os.write(tell, traceback.format_exc()[-4000:].encode())
            os._exit(1)
    os.close(tell)
    with open(told) as stream:
        text = stream.read()
    print(json.dumps([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text]), flush=True)
"""


@pytest.fixture(scope="module")
def run_guarded() -> Iterator[Callable[..., tuple[int, str]]]:
    """Return a function that runs a case with guarded buffers, and returns an exit code and what the process told."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, json.dumps(list(CASES.values()))],
        cwd=Path(__file__).parents[2],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:

        def run(case: str, place: str, shift: int = 0) -> tuple[int, str]:
            process.stdin.write(json.dumps([case, place, shift]) + "\n")
            process.stdin.flush()
            code, text = json.loads(process.stdout.readline())
            return code, text

        yield run
        process.stdin.close()


# Loops run over an end sooner than over a start.
@pytest.mark.sampled(*(f"{name}-end" for name in CASES), "separable-start", "dual buffer-start", "reprojection-start")
@pytest.mark.parametrize("place", ["start", "end"])
@pytest.mark.parametrize("name", CASES)
def test_no_access_out_of_bounds(name: str, place: str, run_guarded: Any) -> None:
    code, told = run_guarded(CASES[name], place)
    assert code == 0, f"{name}: {signal.Signals(-code).name if code < 0 else told}"
    assert int(told) > 0, "no kernel was called"


@pytest.mark.nightly
@pytest.mark.parametrize(("place", "shift"), [("start", -1), ("end", 1)])
def test_one_entry_out_of_bounds_ends_the_process(place: str, shift: int, run_guarded: Any) -> None:
    code, told = run_guarded(CASES["noise guide"], place, shift)
    assert -code in (signal.SIGSEGV, signal.SIGBUS), told
