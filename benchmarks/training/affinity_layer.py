"""The affinity filter as a layer of PyTorch: compiled on the processor, of plain tensors on a graphics card."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.training.affinity_gradients import find_gradients
from lobewise.filters.affinity import RADIUS, AffinityInputs, run_affinity
from lobewise.filters.cross_pass import COLORS


class Maps(NamedTuple):
    """What the filter reads, as tensors (batch, channels, height, width); see `AffinityInputs`."""

    light: Tensor
    features: Tensor
    centre: Tensor
    source: Tensor
    lobes: Tensor | None = None
    exponent: Tensor | None = None


def filter_maps(maps: Maps, step: int) -> Tensor:
    """Return the filtered light, (batch, 3, height, width), with gradients of all maps but the lobes."""
    if maps.light.device.type == "cpu":
        filtered: Tensor = _Compiled.apply(*maps, step)
        return filtered
    return filter_plainly(maps, step)


def filter_plainly(maps: Maps, step: int) -> Tensor:
    """Return what `filter_maps` returns, by its definition in tensors."""
    height, width = maps.light.shape[-2:]
    margin = RADIUS * step

    def pad(tensor: Tensor | None) -> Tensor | None:
        return None if tensor is None else functional.pad(tensor, (margin,) * 4)

    def find_squares(tensor: Tensor | None, padded: Tensor | None, at: tuple[Any, ...]) -> Tensor | float:
        if tensor is None or padded is None:
            return 0.0
        return (tensor - padded[at]).square().sum(dim=1, keepdim=True)

    light, features, source, lobes = (pad(each) for each in (maps.light, maps.features, maps.source, maps.lobes))
    assert light is not None
    assert source is not None
    total, sums = maps.centre, maps.centre * maps.light
    exponent = 0.0 if maps.exponent is None else maps.exponent
    for v in range(2 * RADIUS + 1):
        for u in range(2 * RADIUS + 1):
            if (u, v) == (RADIUS, RADIUS):
                continue
            at = (..., slice(v * step, v * step + height), slice(u * step, u * step + width))
            lobe_squares = find_squares(maps.lobes, lobes, at)
            distance = find_squares(maps.features, features, at) + exponent * lobe_squares
            weight = torch.exp(-distance) * source[at]
            total, sums = total + weight, sums + weight * light[at]
    return sums / total


class _Compiled(torch.autograd.Function):
    """The filter and its gradients by compiled kernels, image by image."""

    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> Tensor:
        """Return the filtered light of `Maps` and a step."""
        *maps, step = arguments
        images = [list_inputs(Maps(*maps), number) for number in range(len(maps[0]))]
        found = torch.from_numpy(np.stack([np.asarray(run_affinity(each, step=step)) for each in images]))
        ctx.save_for_backward(*maps, found)
        ctx.step = step
        return found[:, :COLORS].contiguous()

    @staticmethod
    def backward(ctx: Any, *slopes: Any) -> Any:
        """Return the gradients of all arguments."""
        *maps, found = ctx.saved_tensors
        slope = slopes[0].contiguous()
        gradients = [
            find_gradients(list_inputs(Maps(*maps), k), found[k].numpy(), slope[k].numpy(), step=ctx.step)
            for k in range(len(found))
        ]

        def join(name: str, like: Tensor | None) -> Tensor | None:
            if like is None:
                return None
            return torch.from_numpy(np.stack([getattr(each, name) for each in gradients])).reshape(like.shape)

        before = [join(name, getattr(Maps(*maps), name)) for name in ("light", "features", "centre", "source")]
        return (*before, None, join("exponent", maps[-1]), None)


def list_inputs(maps: Maps, number: int) -> AffinityInputs:
    """Return one image of a batch as arrays of the same memory."""
    arrays = [None if each is None else each[number].detach().numpy() for each in maps]
    light, features, centre, source, lobes, exponent = arrays
    assert centre is not None
    assert source is not None
    return AffinityInputs(light, features, centre[0], source[0], lobes, None if exponent is None else exponent[0])
