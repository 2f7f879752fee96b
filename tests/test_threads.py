"""No bit of a result depends on threads: those of a kernel, and those that call the library at the same time."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from lobewise import Frame, TemporalFilter, WindowFilter, make_sparse, upsample
from lobewise.denoising import denoise
from lobewise.filters.fireflies import bound_fireflies
from lobewise.filters.noise_guides import make_noise_guide, measure_light
from tests.denoising.test_denoising import make_frame
from tests.features.frames import make_mask
from tests.filters import test_accumulation, test_dual_buffer, test_fireflies, test_noise_guides, test_refinement
from tests.filters.test_reprojection import make_pair, make_past, make_places
from tests.filters.test_reprojection import run_reprojection as reproject

SHAPE = (131, 67)


def run_reprojection() -> bytes:
    masks = make_mask(SHAPE), make_mask(SHAPE)
    return reproject(make_past(SHAPE), make_places(SHAPE), masks, make_pair((), SHAPE)).tobytes()


def run_trust() -> bytes:
    given = test_accumulation.make_given(SHAPE, 2, (1, 0))
    grid = test_accumulation.make_grid(given, 2, (1, 0))
    return grid.compute_trust(given["samples"], given["history"], 1.4).tobytes()


def run_accumulation() -> bytes:
    given = test_accumulation.make_given(SHAPE, 2, (1, 0))
    return test_accumulation.accumulate(given, 2, (1, 0)).sums.tobytes()


def run_fireflies() -> bytes:
    bounded = bound_fireflies(*test_fireflies.make_case(SHAPE))
    return bounded.a.tobytes() + bounded.b.tobytes() + bounded.tally.tobytes()


def run_refinement() -> bytes:
    return test_refinement.refine(test_refinement.make_images(SHAPE)).tobytes()


def run_noise_guide() -> bytes:
    return make_noise_guide(*test_noise_guides.make_halves(SHAPE), test_noise_guides.LEVEL).tobytes()


def run_light() -> bytes:
    return measure_light(*test_noise_guides.make_samples(SHAPE)).tobytes()


def run_dual_buffer() -> bytes:
    return test_dual_buffer.get_bits(test_dual_buffer.make_given(test_dual_buffer.STANDARD, SHAPE).run())


def run_denoise(form: str, similarity: str, quality: str) -> bytes:
    result = denoise(make_frame((133, 87)), similarity=similarity, form=form, quality=quality)
    return result.image.tobytes() + result.weight_sum.tobytes()


CALLS: dict[str, Callable[[], bytes]] = {
    "accumulation": run_accumulation,
    "reprojection": run_reprojection,
    "trust": run_trust,
    "fireflies": run_fireflies,
    "refinement": run_refinement,
    "noise guide": run_noise_guide,
    "light": run_light,
    "dual buffer": run_dual_buffer,
    "full": partial(run_denoise, "full", "ggx", "fast"),
    "separable": partial(run_denoise, "separable", "ggx", "fast"),
    "atrous": partial(run_denoise, "atrous", "ggx", "fast"),
    "mixture": partial(run_denoise, "full", "sg_mixture", "fast"),
    "balanced": partial(run_denoise, "full", "ggx", "balanced"),
}
PROGRAM = """
import sys
import numpy as np
from tests.test_threads import CALLS
np.savez(sys.argv[1], **{name: np.frombuffer(call(), np.uint8) for name, call in CALLS.items()})
"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return what every call gives in a process of one thread."""
    path: Path = tmp_path_factory.mktemp("threads") / "alone.npz"
    environment = {**os.environ, "HL_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", PROGRAM, str(path)], check=True, env=environment)
    with np.load(path) as stored:
        return {name: stored[name].tobytes() for name in stored.files}


@pytest.mark.nightly
@pytest.mark.processor
@pytest.mark.parametrize("name", CALLS)
def test_threads_and_another_run_change_nothing(name: str, alone: dict[str, bytes]) -> None:
    expected = CALLS[name]()
    assert CALLS[name]() == expected
    assert alone[name] == expected


CALLERS = 8
"""Threads that call the library at the same time."""
CALLS_OF_A_TEST = int(os.environ.get("LOBEWISE_THREAD_CALLS", "32"))
"""Rare faults need more calls: set the variable to 1000 after a change of what threads share."""
FRAMES = [make_frame((37, 43), seed=seed) for seed in range(4)]


def denoise_bits(quality: str, frame: Frame) -> bytes:
    return denoise(frame, quality=quality).image.tobytes()


def filter_with_past(frame: Frame) -> bytes:
    """Return the second image of a history: a thread has a filter of its own."""
    history = TemporalFilter()
    history.add(FRAMES[0])
    return history.add(frame).image.tobytes()


def filter_window(frame: Frame) -> bytes:
    """Return the image of a frame that is filtered with the frame before it: a thread has a filter of its own."""
    return WindowFilter(1, quality="balanced").denoise([FRAMES[0], frame], 1).image.tobytes()


def upsample_sparse(frame: Frame) -> bytes:
    return upsample(make_sparse(frame, 2)).image.tobytes()


RECIPES: dict[str, Callable[[Frame], bytes]] = {
    **{quality: partial(denoise_bits, quality) for quality in ("auto", "fast", "balanced", "high")},
    "upsample": upsample_sparse,
    "history": filter_with_past,
    "window": filter_window,
}


@pytest.mark.sampled(*(name for name in RECIPES if name != "window"))
@pytest.mark.parametrize("name", RECIPES)
def test_calls_from_several_threads_give_the_bits_of_a_loop(name: str) -> None:
    run = RECIPES[name]
    expected = [run(frame) for frame in FRAMES]
    with ThreadPoolExecutor(CALLERS) as pool:
        found = list(pool.map(run, FRAMES * (CALLS_OF_A_TEST // len(FRAMES))))
    wrong = [number for number, bits in enumerate(found) if bits != expected[number % len(FRAMES)]]
    assert not wrong, f"{len(wrong)} of {len(found)} calls"
