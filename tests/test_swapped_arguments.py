"""Two arguments of a kernel's call swapped: either the call is refused, or what comes out is something else.

So a mistake at a call cannot pass unseen: that what comes out is right is held against oracles by the tests of each
filter.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.backend.buffers import Buffer
from lobewise.backend.jit import Kernel
from tests.streaming.frames import make_scene

pytestmark = [pytest.mark.nightly, pytest.mark.processor]  # kernels of every recipe

SHAPE = (24, 40)
Call = tuple[Kernel, dict[str, Any]]
SYMMETRIC = {
    # Means and differences of both halves of the samples.
    *((name, "a", "b") for name in ("light sums", "noise guide")),
    *((name, "half_a", "half_b") for name in ("dual buffer", "excess", "difference")),
    # Their difference, squared, over what both are.
    ("excess", "filtered", "noisy"),
    # Without a history the samples are all that a sum has.
    ("accumulation", "weight", "weight_sum"),
    # A sum.
    ("joined", "variance0", "variance1"),
    ("composite", "light0", "light1"),
    # Products.
    ("dual buffer", "exponent", "lobes_feature0_scalar0"),
    *((name, "alpha_u", "alpha_v") for name in ("lobes", "tolerances")),
}
"""Kernels and pairs of arguments that they take alike."""
LAYERS = {"convolution of the refining network", "filter of the refining network"}
"""Kernels whose whole numbers say where the weights of a layer begin: others lead beyond the weights."""


def make_frame(seed: int = 0) -> lobewise.Frame:
    """Return a scene in which a pixel has a place but no normal: else its surfaces tell by both alike.

    Of place and depth it has the depth alone, so that rays and eye are read.
    """
    frame = make_scene(SHAPE, seed=seed)
    normal = np.array(frame.gbuffer.normal)
    normal[5, 7] = 0.0
    return frame.with_changes(gbuffer=replace(frame.gbuffer, normal=normal, position=None))


def run_history() -> None:
    history = lobewise.TemporalFilter(device="cpu", radius=2)
    for seed in range(3):
        history.add(make_frame(seed))
    sparse = lobewise.TemporalFilter(device="cpu", radius=2)
    for seed in range(3):
        sparse.add(lobewise.make_sparse(make_frame(seed), 2, (seed % 2, 1)))


RECIPES: dict[str, Callable[[], object]] = {
    "fast": lambda: lobewise.denoise(make_frame(), quality="fast", device="cpu"),
    "separable": lambda: lobewise.denoise(make_frame(), quality="fast", form="separable", device="cpu"),
    "balanced": lambda: lobewise.denoise(make_frame(), quality="balanced", device="cpu"),
    "high": lambda: lobewise.denoise(make_frame(), quality="high", device="cpu"),
    "upsampling": lambda: lobewise.upsample(lobewise.make_sparse(make_frame(), 2), device="cpu", radius=2),
    "history": run_history,
}


def copy_argument(value: Any) -> Any:
    """Return a buffer of a copy that lies in memory as the array did, or a number as it is."""
    if not isinstance(value, Buffer):
        return value
    array = value.array
    # What is repeated along an axis has no step there.
    order = sorted(range(array.ndim), key=lambda axis: -(array.strides[axis] or np.inf))
    copied = array.transpose(order).copy(order="C").transpose(np.argsort(order))
    return Buffer(copied, value.first)


def record(monkeypatch: pytest.MonkeyPatch, run: Callable[[], object]) -> list[Call]:
    """Return one call of every kernel that a recipe runs: the last, when histories are there."""
    calls: dict[int, Call] = {}
    call = Kernel.__call__

    def keep(kernel: Kernel, **arguments: Any) -> None:
        calls[id(kernel)] = kernel, {name: copy_argument(value) for name, value in arguments.items()}
        call(kernel, **arguments)

    with monkeypatch.context() as patch:
        patch.setattr(Kernel, "__call__", keep)
        run()
    return list(calls.values())


def vary(kernel: Kernel, arguments: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return arguments of which no two are alike: real frames have guides that are flat and views along an axis."""
    varied = {}
    written = {each.name for each in kernel.outputs}
    for name, value in arguments.items():
        varied[name] = copy_argument(value)
        if isinstance(value, Buffer) and name not in written:
            array = varied[name].array
            if array.dtype.kind == "f":
                shift = rng.uniform(0.98, 1.02, array.shape) * array + rng.uniform(0.0, 0.02, array.shape)
                array[...] = np.where(array == 0.0, array, shift)
            else:
                array[...] &= rng.random(array.shape) < 0.9
        elif isinstance(value, float):
            varied[name] = value * rng.uniform(0.9, 1.1) + rng.uniform(0.01, 0.05)
    return varied


def swap(kernel: Kernel, arguments: dict[str, Any], **taken: str) -> list[np.ndarray]:
    """Return what a call writes that takes for some arguments, by name, what others are."""
    given = {name: copy_argument(value) for name, value in arguments.items()}
    for each in kernel.outputs:
        array = given[each.name].array
        array[...] = np.nan if array.dtype.kind == "f" else 7
    places = [given[each.name].array for each in kernel.outputs]
    kernel(**{name: given[taken.get(name, name)] for name in given})
    return places


def is_same(found: list[np.ndarray], expected: list[np.ndarray]) -> bool:
    """Return whether two calls wrote the same."""
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("recipe", RECIPES)
def test_swapped_arguments_are_refused_or_seen(recipe: str, monkeypatch: pytest.MonkeyPatch) -> None:
    unseen: list[str] = []
    refused = differing = 0
    rng = np.random.default_rng(5)
    for kernel, recorded in record(monkeypatch, RECIPES[recipe]):
        arguments = vary(kernel, recorded, rng)
        expected = swap(kernel, arguments)
        numbers = {name for name, value in arguments.items() if isinstance(value, int)}
        for one, other in combinations(arguments, 2):
            if kernel.name in LAYERS and {one, other} <= numbers:
                continue
            try:
                found = swap(kernel, arguments, **{one: other, other: one})
            except TypeError:
                refused += 1
                continue
            if not is_same(found, expected):
                differing += 1
            elif (kernel.name, one, other) not in SYMMETRIC and (
                # An argument that a kernel of this key does not read may be anything.
                not is_same(swap(kernel, arguments, **{one: other}), expected)
                or not is_same(swap(kernel, arguments, **{other: one}), expected)
            ):
                unseen.append(f"{kernel.name}: {one}, {other}")
    assert unseen == []
    assert refused > 20
    assert differing > 3
