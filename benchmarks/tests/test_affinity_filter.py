"""The affinity filter as a layer to train: its gradients and values against plain tensors with autograd."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

import halide as hl
import numpy as np
import pytest

from lobewise.backend import jit
from lobewise.backend.devices import make_target

AGREEMENT = 1e-4
"""Of the largest gradient: the kernels' exp2 is good to 1e-5, and sums of 48 terms are in float32."""


@pytest.fixture
def layer(torch: Any) -> ModuleType:
    """Return the module of the layer."""
    return importlib.import_module("benchmarks.training.affinity_layer")


def make_maps(torch: Any, layer: Any, rng: np.random.Generator, lobes: bool) -> Any:
    """Return random maps of two images, all but the lobes with gradients."""

    def draw(channels: int, scale: float = 1.0) -> Any:
        return torch.from_numpy((scale * rng.random((2, channels, 21, 37))).astype(np.float32))

    maps = [draw(3, 4.0), draw(8), draw(1) + 0.05, draw(1)]
    for each in maps:
        each.requires_grad_()
    return layer.Maps(*maps, *((draw(4), draw(1, 3.0).requires_grad_()) if lobes else ()))


@pytest.mark.parametrize("lobes", [True, False], ids=["lobes", "no lobes"])
@pytest.mark.parametrize("step", [1, 3, 16])
def test_gradients_are_those_of_autograd(
    torch: Any, layer: Any, rng: np.random.Generator, step: int, lobes: bool
) -> None:
    maps = make_maps(torch, layer, rng, lobes)
    slope = torch.from_numpy(rng.normal(size=(2, 3, 21, 37)).astype(np.float32))
    free = [each for each in maps if each is not None and each.requires_grad]
    assert len(free) == 4 + lobes
    results = [run(maps, step) for run in (layer.filter_maps, layer.filter_plainly)]
    np.testing.assert_allclose(*(each.detach().numpy() for each in results), rtol=2e-5)
    found, expected = (torch.autograd.grad((each * slope).sum(), free) for each in results)
    for one, other in zip(found, expected, strict=True):
        scale = float(other.abs().max())
        assert scale > 0.01
        np.testing.assert_allclose(one.numpy(), other.numpy(), rtol=0.0, atol=AGREEMENT * scale)


def test_no_memory_beside_the_images_is_touched(
    torch: Any, layer: Any, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Kernels have no checks of their own; here they have, and say which image they would read beside."""
    monkeypatch.setattr(jit, "_kernels", {})
    monkeypatch.setattr(
        jit, "make_target", lambda device: make_target(device).without_feature(hl.TargetFeature.NoAsserts)
    )
    maps = make_maps(torch, layer, rng, True)
    layer.filter_maps(maps, 2).sum().backward()
    assert maps.features.grad is not None
