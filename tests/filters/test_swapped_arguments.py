"""Two arguments of a kernel's call swapped: either the call is refused, or what comes out is something else.

So a mistake at a call cannot pass unseen: that what comes out is right is held against oracles by the tests of each
filter.
"""

from __future__ import annotations

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

pytestmark = [pytest.mark.slow, pytest.mark.processor]  # kernels of every recipe

SHAPE = (24, 40)
Call = tuple[Kernel, dict[str, Any]]
SYMMETRIC: set[tuple[str, frozenset[str]]] = set()
"""Kernels and pairs of arguments that mean the same."""


def make_frame(seed: int = 0) -> lobewise.Frame:
    """Return a scene in which a pixel has a place but no normal: else its surfaces tell by both alike."""
    frame = make_scene(SHAPE, seed=seed)
    normal = np.array(frame.gbuffer.normal)
    normal[5, 7] = 0.0
    return frame.with_changes(gbuffer=replace(frame.gbuffer, normal=normal))


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
    order = sorted(range(array.ndim), key=lambda axis: -array.strides[axis])
    copied = np.ascontiguousarray(array.transpose(order)).transpose(np.argsort(order))
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


def compute(kernel: Kernel, arguments: dict[str, Any]) -> list[np.ndarray]:
    """Return what a call writes where it should, NaN where it writes nothing."""
    given = {name: copy_argument(value) for name, value in arguments.items()}
    for each in kernel.outputs:
        array = arguments[each.name].array
        given[each.name].array[...] = np.nan if array.dtype.kind == "f" else 7
    places = [given[each.name].array for each in kernel.outputs]
    return run_with(kernel, given, places)


def run_with(kernel: Kernel, given: dict[str, Any], places: list[np.ndarray]) -> list[np.ndarray]:
    kernel(**given)
    return [place.copy() for place in places]


def is_same(one: Any, other: Any) -> bool:
    """Return whether two arguments are the same number, or images of the same content."""
    if isinstance(one, Buffer) and isinstance(other, Buffer):
        return one.array.shape == other.array.shape and np.array_equal(one.array, other.array, equal_nan=True)
    return not isinstance(one, Buffer) and not isinstance(other, Buffer) and one == other


@pytest.mark.parametrize("recipe", RECIPES)
def test_swapped_arguments_are_refused_or_seen(recipe: str, monkeypatch: pytest.MonkeyPatch) -> None:
    unseen: list[str] = []
    refused = differing = 0
    for kernel, arguments in record(monkeypatch, RECIPES[recipe]):
        expected = compute(kernel, arguments)
        outputs = {each.name for each in kernel.outputs}
        for one, other in combinations(arguments, 2):
            fixed = (kernel.name, frozenset((one, other))) in SYMMETRIC
            if fixed or ({one, other} - outputs and is_same(arguments[one], arguments[other])):
                continue
            given = {name: copy_argument(value) for name, value in arguments.items()}
            for name in outputs:
                given[name].array[...] = np.nan if given[name].array.dtype.kind == "f" else 7
            places = [given[each.name].array for each in kernel.outputs]
            given[one], given[other] = given[other], given[one]
            try:
                found = run_with(kernel, given, places)
            except TypeError:
                refused += 1
                continue
            if all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found, expected, strict=True)):
                unseen.append(f"{kernel.name}: {one}, {other}")
            else:
                differing += 1
    assert unseen == []
    assert refused > 20
    assert differing > 3
